//! What memory lastingly tells: the whole walks that were recognised and what documents say, put together once
//! and not at every step.

use std::sync::Arc;

use domain::{Cell, Pose};
use plates::Landmark;
use rustc_hash::FxHashMap;

use super::chart::{Chart, PathStep};
use super::instruction::{Goal, Want};
use super::locate::{relocated, relocated_landmark};
use super::lore::Lore;
use super::surroundings::{Marks, Surroundings};

/// What is kept; some tens of kilobytes each.
const MOST_KEPT: usize = 512;

/// A whole walk in the world of here and now: it begins where a task began and ends where that ended.
#[derive(Debug)]
pub(super) struct WholeWalk {
    pub(super) steps: Vec<PathStep>,
    /// How many of the things wanted it passes, in order, as far as memory knows where they are.
    passes: usize,
    floor: Marks,
}

/// A walk that was recognised: its chart, and where it began.
pub(super) type Recognised = (Arc<Chart>, Pose);

/// What is lastingly known for one instruction.
#[derive(Debug)]
pub(super) struct Lasting {
    /// Names it among those of one policy; never used again.
    pub(super) serial: u64,
    /// What was recognised and what documents tell, in the order they were supplied.
    pub(super) walks: Vec<WholeWalk>,
    /// What documents say.
    pub(super) lore: Arc<Lore>,
    /// For each thing wanted, in order: cells to stand on, sorted.
    pub(super) standpoints: Vec<Vec<Cell>>,
    floor: Marks,
    racks: Marks,
}

impl Lasting {
    fn of(serial: u64, recognised: &[Recognised], lore: Arc<Lore>, instruction: &str) -> Self {
        let mut landmarks: Vec<Landmark> = Vec::new();
        let mut walks = Vec::new();
        for (chart, start) in recognised {
            walks.push(chart.begun_in(*start));
            let known = chart.landmarks.iter();
            landmarks.extend(known.filter_map(|known| relocated_landmark(known, *start)));
        }
        walks.extend(lore.routes.iter().cloned());
        let wants = Goal::parse(instruction).map(|goal| goal.wants()).unwrap_or_default();
        let standpoints = wants.iter().enumerate().map(|(nth, &want)| {
            let told = lore.standpoints.get(nth).into_iter().flatten().copied();
            let mut cells: Vec<Cell> = told.chain(wanted(&landmarks, want)).collect();
            cells.sort_unstable();
            cells.dedup();
            cells
        });
        let standpoints: Vec<Vec<Cell>> = standpoints.collect();
        let walks = walks.into_iter().map(|steps| WholeWalk {
            passes: passed(&steps, &standpoints),
            floor: Marks::on(steps.iter().map(|step| step.pose.cell)),
            steps,
        });
        let walks = walks.collect();
        let in_front = landmarks.iter().map(|landmark| landmark.standpoint);
        let floor = Marks::on(lore.floor.iter().copied().chain(in_front));
        let racks = Marks::on(landmarks.iter().filter_map(rack));
        Self { serial, walks, lore, standpoints, floor, racks }
    }

    /// Of the whole walks, those that pass the most of what is wanted, by position. `seen` are plates that are
    /// known besides.
    pub(super) fn best_walks(&self, goal: Option<&Goal<'_>>, seen: &[Landmark]) -> Vec<u16> {
        let everything = 0..self.walks.len().min(usize::from(u16::MAX)) as u16;
        if everything.len() < 2 {
            return everything.collect();
        }
        let wants = goal.map(Goal::wants).unwrap_or_default();
        let known = wants.iter().zip(&self.standpoints);
        let mut is_news = false;
        let standpoints = known.map(|(&want, known)| {
            let mut cells = known.clone();
            cells.extend(wanted(seen, want).filter(|cell| known.binary_search(cell).is_err()));
            is_news |= cells.len() > known.len();
            cells
        });
        let standpoints: Vec<Vec<Cell>> = standpoints.collect();
        let passes = |walk: &WholeWalk| {
            if is_news { passed(&walk.steps, &standpoints) } else { walk.passes }
        };
        let passes: Vec<usize> = self.walks.iter().map(passes).collect();
        let most = passes.iter().max();
        everything.filter(|&at| passes.get(usize::from(at)) == most).collect()
    }

    /// Marks on `ground` what is known from memory alone, and so does not change from step to step. Of the whole
    /// walks, those in the positions `kept` count.
    pub(super) fn lay(&self, kept: &[u16], ground: &mut Surroundings) {
        ground.lay_free(&self.floor);
        for &at in kept {
            ground.lay_free(&self.walks[usize::from(at)].floor);
        }
        ground.lay_solid(&self.racks);
        self.standpoints.iter().flatten().for_each(|&goal| ground.mark_approach(goal));
    }
}

/// How many things wanted are passed, one after another, that stand at `standpoints`.
fn passed(steps: &[PathStep], standpoints: &[Vec<Cell>]) -> usize {
    let mut cells = steps.iter().map(|step| step.pose.cell);
    let passed = |wanted: &&Vec<Cell>| cells.any(|cell| wanted.contains(&cell));
    standpoints.iter().take_while(passed).count()
}

/// Where the plates that are wanted hang.
pub(super) fn wanted(landmarks: &[Landmark], want: Want<'_>) -> impl Iterator<Item = Cell> {
    let meets = move |landmark: &&Landmark| want.is_met_by(landmark.plate);
    landmarks.iter().filter(meets).map(|landmark| landmark.standpoint)
}

/// The cell of the rack that a plate hangs on.
pub(super) fn rack(landmark: &Landmark) -> Option<Cell> {
    landmark.standpoint.step(landmark.face)
}

impl Chart {
    /// The steps of the walk, begun in `start`.
    pub(super) fn begun_in(&self, start: Pose) -> Vec<PathStep> {
        let place = |step: &PathStep| {
            let pose = relocated(step.pose, super::chart::START, start)?;
            Some(PathStep { pose, ..*step })
        };
        self.steps.iter().map_while(place).collect()
    }
}

/// What something lastingly known is made from: names of the walks that were recognised and of what documents
/// say, and the instruction.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Source {
    recognised: Vec<(u64, Pose)>,
    lore: u64,
    instruction: String,
}

/// What is lastingly known by what it is made from.
#[derive(Debug, Default)]
pub(super) struct Lastings {
    kept: FxHashMap<Source, Arc<Lasting>>,
    made: u64,
}

impl Lastings {
    /// What `recognised` walks and `lore` say about `instruction`.
    pub(super) fn of(
        &mut self,
        recognised: &[Recognised],
        lore: Arc<Lore>,
        instruction: &str,
    ) -> Arc<Lasting> {
        if self.kept.len() >= MOST_KEPT {
            self.kept.clear();
        }
        let names = recognised.iter().map(|(chart, start)| (chart.serial, *start));
        let source = Source {
            recognised: names.collect(),
            lore: lore.serial,
            instruction: instruction.to_owned(),
        };
        let lasting = self.kept.entry(source).or_insert_with(|| {
            self.made += 1;
            Arc::new(Lasting::of(self.made, recognised, lore, instruction))
        });
        Arc::clone(lasting)
    }
}
