//! What is seen in a frame, worked out once.
//!
//! A frame's pixels never change, so neither does what is seen in them: keeping it is no memory of an
//! episode.

use std::sync::Arc;

use domain::Pose;
use rustc_hash::FxHashMap;

use shm_types::message::FrameId;

use super::barricade;
use super::lasting::rack;
use super::sketch::Sketch;
use super::surroundings::Marks;
use crate::FrameView;
use plates::{self, Landmark, Sighting};

/// Frames whose percepts are kept; about a kilobyte each.
const MOST_KEPT: usize = 16_384;

/// What is seen in a frame.
#[derive(Debug, PartialEq)]
pub(super) struct Percept {
    pub(super) sightings: Vec<Sighting>,
    pub(super) sketch: Sketch,
    /// Cells with a barricade, as (cells ahead, cells to the right).
    pub(super) barricades: Vec<(i8, i8)>,
}

impl Percept {
    pub(super) fn of(frame: &FrameView<'_>) -> Self {
        Self {
            sightings: plates::read(frame.width, frame.height, frame.pixels),
            sketch: Sketch::of(frame),
            barricades: barricade::read(frame),
        }
    }

    /// Whether both show something, and the same.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.sightings == other.sightings && self.sketch.is_like(&other.sketch)
    }
}

/// A view with the pose it was taken from.
#[derive(Debug)]
pub(super) struct PlacedView {
    pub(super) frame: FrameId,
    pub(super) pose: Pose,
    pub(super) percept: Arc<Percept>,
    /// Plates in the view.
    pub(super) landmarks: Vec<Landmark>,
    /// Cells that it shows to be floor.
    pub(super) free: Marks,
    /// Cells that it shows nobody can be on.
    pub(super) solid: Marks,
}

impl PlacedView {
    pub(super) fn of(frame: FrameId, pose: Pose, percept: Arc<Percept>) -> Self {
        let sightings = percept.sightings.iter();
        let landmarks: Vec<Landmark> =
            sightings.clone().filter_map(|sighting| sighting.seen_from(pose)).collect();
        let lines = sightings.flat_map(|sighting| in_sight(sighting.ahead, sighting.right));
        let floor = lines.filter_map(|(ahead, right)| pose.cell_at(ahead, right));
        let free = Marks::on(floor.chain(landmarks.iter().map(|landmark| landmark.standpoint)));
        let barricades = percept.barricades.iter();
        let blocked = barricades.filter_map(|&(ahead, right)| pose.cell_at(ahead, right));
        let solid = Marks::on(blocked.chain(landmarks.iter().filter_map(rack)));
        Self { frame, pose, percept, landmarks, free, solid }
    }
}

/// Cells, as (ahead, right), on the straight line from the camera to a standpoint: what is seen through is
/// not solid.
fn in_sight(ahead: i8, right: i8) -> impl Iterator<Item = (i8, i8)> + Clone {
    let (far, wide) = (f32::from(ahead), f32::from(right));
    let steps = (2 * ahead.unsigned_abs().max(right.unsigned_abs())).max(1);
    (0..=steps).map(move |i| {
        let share = f32::from(i) / f32::from(steps);
        ((far * share).round() as i8, (wide * share).round() as i8)
    })
}

/// Percepts by frame, and placed views by frame and pose.
#[derive(Debug, Default)]
pub(super) struct Percepts {
    kept: FxHashMap<FrameId, Arc<Percept>>,
    placed: FxHashMap<(FrameId, Pose), Arc<PlacedView>>,
}

impl Percepts {
    /// What is seen in `frame`.
    pub(super) fn of(&mut self, frame: &FrameView<'_>) -> Arc<Percept> {
        if let Some(percept) = self.kept.get(&frame.id) {
            return Arc::clone(percept);
        }
        if self.kept.len() >= MOST_KEPT {
            // Ids are never used again, so most of these are of frames that are gone.
            self.kept.clear();
        }
        let percept = Arc::new(Percept::of(frame));
        self.kept.insert(frame.id, Arc::clone(&percept));
        percept
    }

    /// What is seen in `frame`, which was taken from `pose`.
    pub(super) fn placed(&mut self, frame: &FrameView<'_>, pose: Pose) -> Arc<PlacedView> {
        if let Some(view) = self.placed.get(&(frame.id, pose)) {
            return Arc::clone(view);
        }
        if self.placed.len() >= MOST_KEPT {
            self.placed.clear();
        }
        let view = Arc::new(PlacedView::of(frame.id, pose, self.of(frame)));
        self.placed.insert((frame.id, pose), Arc::clone(&view));
        view
    }
}
