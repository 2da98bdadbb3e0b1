//! Documents of the extractive builder, from views rendered here.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use case_book::{BookRequest, ViewPlace};
use documents::Sources;
use domain::{Appearance, Demonstrations, DocumentKind, Pose};
use memory_proc::builders::{DocumentBuilder, Extractive, FrameReading, transcripts};
use warehouse::Variant;
use warehouse::case_book::write_books;

use super::views::Views;

/// The document of `kind`, built from `demonstrations` of all cases.
pub(crate) fn document(
    kind: DocumentKind,
    demonstrations: Demonstrations,
    views: &mut Views,
) -> String {
    let book = write_books(&BookRequest::default()).unwrap().demonstrations;
    let sources = Sources::new(book, 448, Appearance::WITH_PLATES);
    let mut look = |pose: Pose| {
        let image = views.of(pose, &Variant::UNCHANGED);
        let frame = image.frame();
        let sightings = plates::read(frame.width, frame.height, frame.pixels);
        let landmarks = sightings.into_iter().filter_map(|sighting| sighting.seen_from(pose));
        Arc::new(FrameReading { frame: [0; 16], landmarks: landmarks.collect() })
    };
    let pose = |ViewPlace { demonstration, step }: ViewPlace| {
        let of = &sources.book().demonstrations[demonstration as usize];
        Pose::try_from(of.states[step as usize]).unwrap()
    };
    let views = sources.views(demonstrations).into_iter();
    let seen: HashMap<u32, Arc<FrameReading>> =
        views.map(|(view, place)| (view, look(pose(place)))).collect();
    let transcripts =
        transcripts(&sources, demonstrations, |view| seen.get(&view).cloned()).unwrap();
    Extractive.build(kind, &transcripts, Path::new(""), &mut |_, _| ()).unwrap().text
}
