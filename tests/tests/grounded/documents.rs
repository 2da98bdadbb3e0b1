//! Documents of the extractive builder, from views rendered here.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use domain::{DocumentKind, Pose};
use memory_proc::documents::sources::Sources;
use memory_proc::documents::{Builder, Extractive, Seen};
use warehouse::{Demonstrations, Variant};

use crate::views::Views;

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
        Arc::new(Seen { frame: [0; 16], landmarks: landmarks.collect() })
    };
    let poses = sources.poses(demonstrations);
    let seen: HashMap<Pose, Arc<Seen>> = poses.into_iter().map(|pose| (pose, look(pose))).collect();
    let transcripts = sources.transcripts(demonstrations, |pose| seen.get(&pose).cloned()).unwrap();
    Extractive.build(kind, &transcripts, Path::new(""), &mut |_, _| ()).unwrap().text
}
