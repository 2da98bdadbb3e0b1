//! What is seen in a frame, worked out once.
//!
//! A frame's pixels never change, so neither does what is seen in them: keeping it is no memory of an
//! episode.

use std::collections::HashMap;
use std::sync::Arc;

use shm_types::message::FrameId;

use super::barricade;
use super::sketch::Sketch;
use crate::FrameView;
use shm_types::plate::{self, Sighting};

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
            sightings: plate::read(frame.width, frame.height, frame.pixels),
            sketch: Sketch::of(frame),
            barricades: barricade::read(frame),
        }
    }

    /// Whether both show something, and the same.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.sightings == other.sightings && self.sketch.is_like(&other.sketch)
    }
}

/// Percepts by frame.
#[derive(Debug, Default)]
pub(super) struct Percepts {
    kept: HashMap<FrameId, Arc<Percept>>,
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
}
