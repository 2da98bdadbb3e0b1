//! Documents of the extractive builder, from views rendered here.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use documents::Sources;
use domain::{Demonstrations, DocumentKind, Pose};
use memory_proc::builders::{DocumentBuilder, Extractive, FrameReading, transcripts};
use warehouse::{Variant, Viewpoint};

use super::views::Views;

/// The document of `kind`, built from `demonstrations` of all cases.
pub(crate) fn document(
    kind: DocumentKind,
    demonstrations: Demonstrations,
    views: &mut Views,
) -> String {
    let sources = Sources::load(None).unwrap();
    let mut look = |pose: Pose| {
        let image = views.of(pose, &Variant::UNCHANGED);
        let frame = image.frame();
        let sightings = plates::read(frame.width, frame.height, frame.pixels);
        let landmarks = sightings.into_iter().filter_map(|sighting| sighting.seen_from(pose));
        Arc::new(FrameReading { frame: [0; 16], landmarks: landmarks.collect() })
    };
    let viewpoints = sources.viewpoints(demonstrations);
    let seen: HashMap<Viewpoint, Arc<FrameReading>> =
        viewpoints.into_iter().map(|from| (from, look(from.pose))).collect();
    let transcripts =
        transcripts(&sources, demonstrations, |from| seen.get(&from).cloned()).unwrap();
    Extractive.build(kind, &transcripts, Path::new(""), &mut |_, _| ()).unwrap().text
}
