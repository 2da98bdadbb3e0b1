//! What frames show: plates, barricades, and whether two frames show the same view.
//!
//! The pixels of a frame never change, so each frame is read once.

use std::sync::Arc;

use domain::{Cell, Pose};
use peer::{FrameId, FrameView};
use plates::{Landmark, Sighting};

use super::barricade;
use super::cache::BoundedCache;
use super::geometry::sorted;

/// What a frame shows, relative to its camera.
#[derive(Debug)]
pub(super) struct FrameContent {
    hash: [u8; 16],
    /// All pixels have the same colour.
    pub(super) is_blank: bool,
    pub(super) plates: Vec<Sighting>,
    /// Cells with a barricade, as (cells ahead, cells to the right).
    barricades: Vec<(i8, i8)>,
}

impl FrameContent {
    pub(super) fn of(frame: &FrameView<'_>) -> Self {
        let mut pixels = frame.pixels.chunks_exact(4);
        let first = pixels.next();
        Self {
            hash: frame.content_hash,
            is_blank: pixels.all(|pixel| Some(pixel) == first),
            plates: plates::read(frame.width, frame.height, frame.pixels),
            barricades: barricade::read(frame),
        }
    }

    /// Whether both frames have the same content, and one that tells where they were taken.
    pub(super) fn shows_same(&self, other: &Self) -> bool {
        self.hash == other.hash && !self.is_blank
    }
}

/// A frame from a known pose, and what it shows of the world.
#[derive(Debug)]
pub(super) struct PlacedFrame {
    pub(super) pose: Pose,
    pub(super) content: Arc<FrameContent>,
    pub(super) landmarks: Vec<Landmark>,
    /// Cells without an obstacle, sorted: those before plates, and those between them and the camera.
    pub(super) free: Vec<Cell>,
    /// Cells with a rack or a barricade, sorted.
    pub(super) occupied: Vec<Cell>,
}

impl PlacedFrame {
    pub(super) fn new(content: Arc<FrameContent>, pose: Pose) -> Self {
        let landmarks: Vec<Landmark> =
            content.plates.iter().filter_map(|plate| plate.seen_from(pose)).collect();
        let lines = content.plates.iter().flat_map(|plate| line_of_sight(plate.ahead, plate.right));
        let free = lines.filter_map(|(ahead, right)| pose.cell_at(ahead, right));
        let free = sorted(free.chain(landmarks.iter().map(|landmark| landmark.standpoint)));
        let barricades = content.barricades.iter();
        let barricades = barricades.filter_map(|&(ahead, right)| pose.cell_at(ahead, right));
        let occupied = sorted(barricades.chain(landmarks.iter().filter_map(rack_of)));
        Self { pose, content, landmarks, free, occupied }
    }
}

/// The cell of the rack that carries a plate.
pub(super) fn rack_of(landmark: &Landmark) -> Option<Cell> {
    landmark.standpoint.step(landmark.face)
}

/// The cells, as (ahead, right), on the line from the camera to a standpoint: a plate that can be read has
/// nothing in front of it.
fn line_of_sight(ahead: i8, right: i8) -> impl Iterator<Item = (i8, i8)> {
    let steps = (2 * ahead.unsigned_abs().max(right.unsigned_abs())).max(1);
    (0..=steps).map(move |i| {
        let share = f32::from(i) / f32::from(steps);
        ((f32::from(ahead) * share).round() as i8, (f32::from(right) * share).round() as i8)
    })
}

/// What frames show. Each frame is read once.
#[derive(Debug, Default)]
pub(super) struct FrameCache {
    contents: BoundedCache<FrameId, FrameContent, 16_384>,
    placed: BoundedCache<(FrameId, Pose), PlacedFrame, 16_384>,
}

impl FrameCache {
    pub(super) fn content(&mut self, frame: &FrameView<'_>) -> Arc<FrameContent> {
        self.contents.get(frame.id, || FrameContent::of(frame))
    }

    /// What `frame` shows if it was taken from `pose`.
    pub(super) fn placed(&mut self, frame: &FrameView<'_>, pose: Pose) -> Arc<PlacedFrame> {
        let contents = &mut self.contents;
        self.placed.get((frame.id, pose), || {
            PlacedFrame::new(contents.get(frame.id, || FrameContent::of(frame)), pose)
        })
    }
}
