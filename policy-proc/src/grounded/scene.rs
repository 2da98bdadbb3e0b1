//! One picture of the world, put together from everything a request holds: what the last views show, what
//! was walked and bumped into, what memory's walks and documents say. Where it came from is forgotten here.

use std::sync::Arc;

use domain::{Cell, Pose};
use plates::Landmark;

use super::Mind;
use super::chart::{Chart, PathStep};
use super::history::History;
use super::instruction::{Goal, Want};
use super::lasting::{Lasting, WholeWalk, rack, wanted};
use super::locate::relocated_landmark;
use super::percept::{Percept, PlacedView};
use super::surroundings::{Doubt, Surroundings};
use crate::Request;

/// Steps after which ways that have not led to the end are doubted.
const PATIENCE: u32 = 45;

/// What was retrieved for this step, in the world of here and now.
#[derive(Debug, Clone)]
pub(super) struct Retrieved {
    pub(super) steps: Vec<PathStep>,
    /// What comes into view after it, when nobody said what was done at its end.
    pub(super) beyond: Option<Arc<Percept>>,
}

/// What is known.
pub(super) struct Scene {
    /// Plates in the last views, and in what was retrieved for this one: known now, perhaps not at the next
    /// step. In no order, and some more than once.
    pub(super) seen: Vec<Landmark>,
    /// What memory tells, and does not change from step to step.
    pub(super) lasting: Arc<Lasting>,
    /// Of its whole walks, those that pass the most of what is wanted, by position: only they are walked.
    pub(super) kept: Vec<u16>,
    pub(super) ground: Surroundings,
    pub(super) retrieved: Option<Retrieved>,
    /// Where the episode began, if that is known.
    pub(super) origin: Option<Cell>,
    pub(super) doubt: Doubt,
}

impl Scene {
    pub(super) fn of(
        request: &Request<'_>,
        history: &History,
        goal: Option<&Goal<'_>>,
        mind: &mut Mind,
    ) -> Self {
        let views = views(request, history, mind);
        let mut seen = Vec::new();
        views.iter().for_each(|view| seen.extend_from_slice(&view.landmarks));
        let mut origin = history.origin.map(|pose| pose.cell);
        let doubt = Doubt::at(request.step, PATIENCE, request.episode_seed);
        let mut ground = Surroundings::new(request.pose, doubt);

        let mut retrieved = None;
        if let Some(segment) = request.segment {
            let supplied = segment.steps.iter().map(|step| (Some(step.frame), step.action));
            let chart = mind.charts.of(supplied, &mut mind.percepts);
            if let Some(start) = mind.locator.start_of(&chart, &views) {
                let (steps, beyond) = (chart.begun_in(start), chart.beyond.clone());
                retrieved = Some(Retrieved { steps, beyond });
                let landmarks = chart.landmarks.iter();
                let there = landmarks.filter_map(|landmark| relocated_landmark(landmark, start));
                let known = seen.len();
                seen.extend(there);
                lay_landmarks(&seen[known..], &mut ground);
            }
        }
        let recognised = recognise(request, history, &views, mind, &mut origin);
        let lore = mind.lores.of(request);
        let lasting = mind.lastings.of(&recognised, lore, request.instruction);
        let kept = lasting.best_walks(goal, &seen);

        lasting.lay(&kept, &mut ground);
        for view in &views {
            ground.lay_free(&view.free);
            ground.lay_solid(&view.solid);
        }
        history.stood_on().for_each(|cell| ground.mark_free(cell));
        history.blocked().for_each(|cell| ground.mark_solid(cell));
        Self { seen, lasting, kept, ground, retrieved, origin, doubt }
    }

    /// The whole walks that are walked, with their positions.
    pub(super) fn whole_walks(&self) -> impl Iterator<Item = (u16, &WholeWalk)> {
        self.kept.iter().map(|&at| (at, &self.lasting.walks[usize::from(at)]))
    }

    /// Standpoints of the `nth` thing wanted that memory knows, sorted.
    pub(super) fn remembered_standpoints(&self, nth: usize) -> &[Cell] {
        self.lasting.standpoints.get(nth).map_or(&[], Vec::as_slice)
    }

    /// All known standpoints of the `nth` thing wanted.
    pub(super) fn standpoints(&self, nth: usize, want: Want<'_>) -> Vec<Cell> {
        let mut cells = self.remembered_standpoints(nth).to_vec();
        cells.extend(wanted(&self.seen, want));
        cells
    }
}

/// Whole walks that memory supplies as views, where they are recognised, and where each began. Where the
/// episode began, one of them may tell.
fn recognise(
    request: &Request<'_>,
    history: &History,
    views: &[Arc<PlacedView>],
    mind: &mut Mind,
    origin: &mut Option<Cell>,
) -> Vec<(Arc<Chart>, Pose)> {
    let mut recognised = Vec::new();
    for (at, trajectory) in request.trajectories.iter().enumerate() {
        let supplied = trajectory.steps.iter().map(|step| (step.frame, step.action));
        let chart = mind.charts.of(supplied, &mut mind.percepts);
        let is_hinted = request.starts_as_demonstrated && at == 0;
        let hinted = history.origin.filter(|_| is_hinted && chart.begins_with(views));
        let start = hinted.or_else(|| mind.locator.start_of(&chart, views));
        if let Some(start) = start {
            recognised.push((chart, start));
            if is_hinted {
                *origin = origin.or(Some(start.cell));
            }
        }
    }
    recognised
}

fn lay_landmarks(landmarks: &[Landmark], ground: &mut Surroundings) {
    for landmark in landmarks {
        ground.mark_free(landmark.standpoint);
        if let Some(rack) = rack(landmark) {
            ground.mark_solid(rack);
        }
    }
}

/// The last views with their poses, oldest first, the present one last.
fn views(request: &Request<'_>, history: &History, mind: &mut Mind) -> Vec<Arc<PlacedView>> {
    let past = request.window.iter().zip(&history.past);
    let frames = past.map(|(view, past)| (&view.frame, past.pose));
    let frames = frames.chain([(&request.frame, history.here)]);
    frames.map(|(frame, pose)| mind.percepts.placed(frame, pose)).collect()
}
