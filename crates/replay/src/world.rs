//! The worlds that the episodes of a run took place in.

use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::io;

use anyhow::{Context, Result};
use domain::{Cell, Pose};
use results::conditions::{Frames, Route};
use results::log::{ELSEWHERE_FILE, ELSEWHERE_HASH, EpisodeRecord, RunLog, STREAMS_FILE};
use warehouse::{
    Case, CaseSet, ELSEWHERE_VARIANT, Elsewhere, GREY_VARIANT, Layout, StreamSet, SwappedPoses,
    Trajectory, TrajectoryKind, Variant, Warehouse, WorldState,
};

use crate::changes::changes;
use crate::frames::ViewKey;

/// The warehouse and the cases of a run, and its streams if it has any.
#[derive(Debug)]
pub struct RunWorld {
    /// The unchanged warehouse.
    pub warehouse: Warehouse,
    /// The cases.
    pub cases: CaseSet,
    streams: Option<StreamSet>,
    /// What frames showed.
    frames: Frames,
    swapped: OnceCell<SwappedPoses>,
    /// Those of the streams.
    states: Vec<WorldState>,
    /// References in worlds of the streams, by world and case: planned when they are needed.
    references: RefCell<BTreeMap<(u32, usize), Option<Trajectory>>>,
}

impl RunWorld {
    /// The worlds of the run `log`, which ran in `warehouse` with `cases`.
    ///
    /// # Errors
    /// When the file of the run's streams, or of its other warehouse, is missing or does not fit.
    pub fn new(log: &RunLog, warehouse: Warehouse, mut cases: CaseSet) -> Result<Self> {
        let mut streams = None;
        if log.manifest.settings.stream.is_some() {
            let file = log.dir.join(STREAMS_FILE);
            let text = durable::read(&file)
                .and_then(|bytes| String::from_utf8(bytes).map_err(io::Error::other))
                .with_context(|| format!("cannot read {}", file.display()))?;
            let set = StreamSet::parse(&text, &warehouse, &cases);
            streams = Some(set.with_context(|| file.display().to_string())?);
        }
        if log.manifest.hashes.contains_key(ELSEWHERE_HASH) {
            let file = log.dir.join(ELSEWHERE_FILE);
            cases.elsewhere = Some(Elsewhere::read(&file, &warehouse, &cases)?);
        }
        let states = streams.as_ref().map(|set| set.states(&warehouse)).transpose()?;
        let states = states.unwrap_or_default();
        Ok(Self {
            warehouse,
            cases,
            streams,
            frames: log.manifest.settings.frames,
            swapped: OnceCell::new(),
            states,
            references: RefCell::default(),
        })
    }

    /// The states of its streams' worlds: world variants after those of the cases.
    pub fn states(&self) -> &[WorldState] {
        &self.states
    }

    /// The case of `record`.
    ///
    /// # Errors
    /// When there is no such case.
    pub fn case(&self, record: &EpisodeRecord) -> Result<(usize, &Case)> {
        let index = self.cases.index(&record.case);
        let index = index.with_context(|| format!("there is no case {}", record.case))?;
        Ok((index, &self.cases.cases[index]))
    }

    /// The number of the world variant in which the episode of `record`, of case number `case`, took place: as the simulator
    /// counts them.
    pub fn variant(&self, record: &EpisodeRecord, case: usize) -> u32 {
        match (&record.stream, &self.streams, record.route) {
            (Some(stream), Some(set), _) => set.variant(stream.world, self.cases.cases.len()),
            (_, _, Route::Blocked) => 1 + case as u32,
            (_, _, Route::Unchanged) => 0,
        }
    }

    /// The view that the policy was shown at `pose` in the world variant `variant`: another one than the true one where frames
    /// were a control.
    pub fn seen(&self, variant: u32, pose: Pose) -> ViewKey {
        match self.frames {
            Frames::Rendered => (variant, pose),
            Frames::Blank | Frames::BlankAll => (GREY_VARIANT, pose),
            Frames::Swapped => {
                let swapped =
                    self.swapped.get_or_init(|| SwappedPoses::new(&self.warehouse.layout));
                (variant, swapped.shown(&self.closed(variant), pose))
            }
        }
    }

    /// The view from `pose` in the world variant `variant` that memory was given.
    pub fn supplied(&self, variant: u32, pose: Pose) -> ViewKey {
        match self.frames {
            Frames::BlankAll => (GREY_VARIANT, pose),
            Frames::Rendered | Frames::Blank | Frames::Swapped => (variant, pose),
        }
    }

    /// The closed passages of the world variant with this number; none in the other warehouse.
    fn closed(&self, variant: u32) -> Variant {
        let Some(index) = variant.checked_sub(1).map(|index| index as usize) else {
            return Variant::UNCHANGED;
        };
        match self.cases.cases.get(index) {
            Some(case) => Variant::closing(case.barricade.iter().copied()),
            None => {
                let state = self.states.get(index - self.cases.cases.len());
                state.map_or(Variant::UNCHANGED, |state| state.variant.clone())
            }
        }
    }

    /// The state of the world in which it took place.
    ///
    /// # Errors
    /// When a stream has no such world.
    pub fn state(&self, record: &EpisodeRecord, case: &Case) -> Result<WorldState> {
        if let Some(stream) = &record.stream {
            let state = self.states.get(stream.world as usize);
            return state.cloned().with_context(|| format!("there is no world {}", stream.world));
        }
        let variant = match record.route {
            Route::Blocked => Variant::closing(case.barricade.iter().copied()),
            Route::Unchanged => Variant::UNCHANGED,
        };
        Ok(WorldState { warehouse: self.warehouse.clone(), variant })
    }

    /// How the world of an episode of a stream differs from that of the block before in the order of its sequence, in words; for
    /// the first block, from the unchanged world.
    pub fn changes(&self, record: &EpisodeRecord) -> Vec<String> {
        let found = record.stream.as_ref().zip(self.streams.as_ref());
        let changes = found.and_then(|(part, set)| {
            let before = match part.place.checked_sub(1) {
                Some(before) => *set.order(part.stream, part.order).get(before as usize)?,
                None => 0,
            };
            let stream = set.streams.get(part.stream as usize)?;
            Some(changes(stream, before, part.block, &self.warehouse))
        });
        changes.unwrap_or_default()
    }

    /// The floor plan of the world variant with this number, if there is one.
    pub fn layout(&self, variant: u32) -> Option<&Layout> {
        if variant == ELSEWHERE_VARIANT {
            return self.cases.elsewhere.as_ref().map(|elsewhere| &elsewhere.warehouse().layout);
        }
        let count = 1 + self.cases.cases.len() + self.states.len();
        (variant == GREY_VARIANT || (variant as usize) < count).then_some(&self.warehouse.layout)
    }

    /// Whether a robot can stand on `cell` in the world variant with this number: it is floor, and not closed. `None` if there is
    /// no such variant.
    pub fn is_free(&self, variant: u32, cell: Cell) -> Option<bool> {
        let layout = self.layout(variant)?;
        Some(layout.is_free(cell) && !self.closed(variant).is_closed(cell))
    }

    /// The index of the drawing of the floor with the items of its world: 0 is the unchanged one.
    pub fn ground(record: &EpisodeRecord) -> u32 {
        record.stream.as_ref().map_or(0, |stream| stream.world)
    }

    /// The warehouse of drawing `ground`.
    pub fn stock(&self, ground: u32) -> Option<&Warehouse> {
        match self.states.get(ground as usize) {
            Some(state) => Some(&state.warehouse),
            None => (ground == 0).then_some(&self.warehouse),
        }
    }

    /// The reference of the episode of `record`, of case number `case`: what the expert does from the same start in the same
    /// world. `None` if the task cannot be completed there.
    pub fn reference(&self, record: &EpisodeRecord, case: usize) -> Option<Trajectory> {
        let found = self.cases.cases.get(case)?;
        let Some(stream) = &record.stream else {
            return Some(
                found.trajectory(TrajectoryKind::reference(record.start, record.route)).clone(),
            );
        };
        let state = self.states.get(stream.world as usize)?;
        let mut known = self.references.borrow_mut();
        let planned = known.entry((stream.world, case)).or_insert_with(|| {
            let expert = state.expert();
            Some(state.reference(&expert, &found.task, record.start_pose)?.0)
        });
        planned.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RecordedRun;

    #[test]
    fn a_closed_passage_is_not_free_in_its_variant_alone() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../results/tests/rq2-version-1");
        let RecordedRun { log, world, .. } = RecordedRun::read(folder.as_ref()).unwrap();
        let blocked = log.episodes.iter().find(|record| record.route == Route::Blocked).unwrap();
        let (index, case) = world.case(blocked).unwrap();
        let closing = world.variant(blocked, index);
        assert!(!case.barricade.is_empty());
        for &cell in &case.barricade {
            assert_eq!(world.is_free(closing, cell), Some(false));
            assert_eq!(world.is_free(0, cell), Some(true));
        }
        let start = case.blocked.start.cell;
        assert_eq!(world.is_free(closing, start), Some(true));
        let beyond = 1 + world.cases.cases.len() as u32;
        assert_eq!(world.is_free(beyond, start), None, "the run has no streams");
    }
}
