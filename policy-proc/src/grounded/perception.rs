//! What frames show: plates, barricades, and whether two frames show the same view.
//!
//! The pixels of a frame never change, so each frame is looked at once.

use std::sync::Arc;

use domain::{Cell, Pose};
use plates::{Landmark, Sighting};

use super::barricade;
use super::cache::Cache;
use peer::{FrameId, FrameView};

/// What one frame shows, relative to its camera.
#[derive(Debug)]
pub(super) struct View {
    content: [u8; 16],
    /// All pixels have the same colour.
    pub(super) is_blank: bool,
    pub(super) plates: Vec<Sighting>,
    /// Cells with a barricade, as (cells ahead, cells to the right).
    pub(super) barricades: Vec<(i8, i8)>,
}

impl View {
    pub(super) fn of(frame: &FrameView<'_>) -> Self {
        let mut pixels = frame.pixels.chunks_exact(4);
        let first = pixels.next();
        Self {
            content: frame.content_hash,
            is_blank: pixels.all(|pixel| Some(pixel) == first),
            plates: plates::read(frame.width, frame.height, frame.pixels),
            barricades: barricade::read(frame),
        }
    }

    /// Whether both frames have the same content, and one that tells where they were taken.
    pub(super) fn shows_same(&self, other: &Self) -> bool {
        self.content == other.content && !self.is_blank
    }
}

/// A view from a known pose, and what it says about the world.
#[derive(Debug)]
pub(super) struct PlacedView {
    pub(super) pose: Pose,
    pub(super) view: Arc<View>,
    pub(super) landmarks: Vec<Landmark>,
    pub(super) free: Vec<Cell>,
    pub(super) occupied: Vec<Cell>,
}

impl PlacedView {
    pub(super) fn new(view: Arc<View>, pose: Pose) -> Self {
        let landmarks: Vec<Landmark> =
            view.plates.iter().filter_map(|plate| plate.seen_from(pose)).collect();
        let lines = view.plates.iter().flat_map(|plate| line_of_sight(plate.ahead, plate.right));
        let mut free: Vec<Cell> =
            lines.filter_map(|(ahead, right)| pose.cell_at(ahead, right)).collect();
        free.sort_unstable();
        free.dedup();
        let barricades = view.barricades.iter();
        let barricades = barricades.filter_map(|&(ahead, right)| pose.cell_at(ahead, right));
        let occupied = barricades.chain(landmarks.iter().filter_map(rack_of)).collect();
        Self { pose, view, landmarks, free, occupied }
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

/// What frames show, each frame looked at once.
#[derive(Debug, Default)]
pub(super) struct Views {
    views: Cache<FrameId, View, 16_384>,
    placed: Cache<(FrameId, Pose), PlacedView, 16_384>,
}

impl Views {
    pub(super) fn view(&mut self, frame: &FrameView<'_>) -> Arc<View> {
        self.views.get(frame.id, || View::of(frame))
    }

    /// The view in `frame`, which was taken from `pose`.
    pub(super) fn placed(&mut self, frame: &FrameView<'_>, pose: Pose) -> Arc<PlacedView> {
        let views = &mut self.views;
        self.placed.get((frame.id, pose), || {
            PlacedView::new(views.get(frame.id, || View::of(frame)), pose)
        })
    }
}
