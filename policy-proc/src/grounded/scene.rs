//! One picture of the world, put together from everything a request holds: what the last views show, what
//! was walked and bumped into, what memory's walks and documents say. Where it came from is forgotten here.

use std::sync::Arc;

use shm_types::plate::Landmark;
use shm_types::{Cell, Pose};

use super::Mind;
use super::chart::{Chart, PathStep, START};
use super::history::History;
use super::instruction::{Goal, Want};
use super::locate::{PlacedView, relocated, relocated_landmark};
use super::lore::Lore;
use super::percept::Percept;
use super::surroundings::{Doubt, Surroundings};
use crate::Request;

/// Steps after which ways that have not led to the end are doubted.
const PATIENCE: u32 = 45;

/// A remembered walk in the world of here and now.
#[derive(Debug, Clone)]
pub(super) struct Walk {
    pub(super) steps: Vec<PathStep>,
    /// It begins where a task began and ends where that ended.
    pub(super) is_whole: bool,
    /// How many of the things wanted it is known to pass, in order.
    pub(super) passes: usize,
    /// What comes into view after it, when nobody said what was done at its end.
    pub(super) beyond: Option<Arc<Percept>>,
    /// Names it as long as it lies where it lies.
    pub(super) name: (u64, Pose),
}

/// What is known.
pub(super) struct Scene {
    /// Plates in the last views, and in what was retrieved for this one: known now, perhaps not at the next
    /// step.
    pub(super) seen: Vec<Landmark>,
    /// Plates in the views of whole walks.
    pub(super) remembered: Vec<Landmark>,
    /// What documents say.
    pub(super) lore: Arc<Lore>,
    pub(super) ground: Surroundings,
    pub(super) walks: Vec<Walk>,
    /// Names of the whole walks that were recognised, those that were not kept included: what they show is
    /// known all the same.
    pub(super) recognised: Vec<(u64, Pose)>,
    /// Where the episode began, if that is known.
    pub(super) origin: Option<Cell>,
    pub(super) doubt: Doubt,
    /// Where memory knows something wanted.
    goals: Vec<Cell>,
}

impl Scene {
    pub(super) fn of(request: &Request<'_>, history: &History, mind: &mut Mind) -> Self {
        let views = views(request, history, mind);
        let mut scene = Self {
            seen: seen(&views),
            remembered: Vec::new(),
            lore: mind.lores.of(request),
            ground: Surroundings::new(request.pose, Doubt::default()),
            walks: Vec::new(),
            recognised: Vec::new(),
            origin: history.origin.map(|pose| pose.cell),
            doubt: Doubt::at(request.step, PATIENCE, request.episode_seed),
            goals: Vec::new(),
        };
        scene.ground = Surroundings::new(request.pose, scene.doubt);
        scene.recall_walks(request, history, &views, mind);
        for (at, route) in scene.lore.routes.iter().enumerate() {
            let name = (scene.lore.serial << 16 | at as u64, START);
            let steps = route.clone();
            let walk = Walk { steps, is_whole: true, passes: 0, beyond: None, name };
            scene.walks.push(walk);
        }
        scene.judge_walks(request.instruction);
        scene.lay_ground(history, &views);
        scene
    }

    /// Walks that memory supplies as views, where they are recognised.
    fn recall_walks(
        &mut self,
        request: &Request<'_>,
        history: &History,
        views: &[PlacedView],
        mind: &mut Mind,
    ) {
        if let Some(segment) = request.segment {
            let supplied: Vec<_> =
                segment.steps.iter().map(|step| (Some(step.frame), step.action)).collect();
            let chart = mind.charts.of(&supplied, &mut mind.percepts);
            if let Some(start) = mind.locator.start_of(&chart, views) {
                self.add_walk(&chart, start, false);
            }
        }
        for (at, trajectory) in request.trajectories.iter().enumerate() {
            let supplied: Vec<_> =
                trajectory.steps.iter().map(|step| (step.frame, step.action)).collect();
            let chart = mind.charts.of(&supplied, &mut mind.percepts);
            let is_hinted = request.starts_as_demonstrated && at == 0;
            let hinted = history.origin.filter(|_| is_hinted && chart.begins_with(views));
            let start = hinted.or_else(|| mind.locator.start_of(&chart, views));
            if let Some(start) = start {
                self.add_walk(&chart, start, true);
                if is_hinted {
                    self.origin = self.origin.or(Some(start.cell));
                }
            }
        }
        for known in [&mut self.remembered, &mut self.seen] {
            known.sort_unstable();
            known.dedup();
        }
    }

    fn add_walk(&mut self, chart: &Chart, start: Pose, is_whole: bool) {
        let place =
            |step: &PathStep| Some(PathStep { pose: relocated(step.pose, START, start)?, ..*step });
        let steps = chart.steps.iter().map_while(place).collect();
        let (beyond, name) = (chart.beyond.clone(), (chart.serial, start));
        self.walks.push(Walk { steps, is_whole, passes: 0, beyond, name });
        if is_whole {
            self.recognised.push(name);
        }
        let known = if is_whole { &mut self.remembered } else { &mut self.seen };
        let landmarks = chart.landmarks.iter();
        known.extend(landmarks.filter_map(|landmark| relocated_landmark(landmark, start)));
    }

    /// Of whole walks, those that pass the most of what is wanted are kept, and only they.
    fn judge_walks(&mut self, instruction: &str) {
        let wants = Goal::parse(instruction).map(|goal| goal.wants()).unwrap_or_default();
        let standpoints: Vec<Vec<Cell>> =
            wants.iter().enumerate().map(|(nth, &want)| self.standpoints(nth, want)).collect();
        let remembered = |(nth, &want)| self.remembered_standpoints(nth, want);
        self.goals = wants.iter().enumerate().flat_map(remembered).collect();
        for walk in &mut self.walks {
            let mut cells = walk.steps.iter().map(|step| step.pose.cell);
            let passed = |wanted: &&Vec<Cell>| cells.any(|cell| wanted.contains(&cell));
            walk.passes = standpoints.iter().take_while(passed).count();
        }
        let most = self.walks.iter().filter(|walk| walk.is_whole).map(|walk| walk.passes).max();
        self.walks.retain(|walk| !walk.is_whole || Some(walk.passes) == most);
    }

    fn lay_ground(&mut self, history: &History, views: &[PlacedView]) {
        let mut ground = self.ground.clone();
        self.lay_lasting(&mut ground);
        for view in views {
            for sighting in &view.percept.sightings {
                let line = in_sight(sighting.ahead, sighting.right);
                let cells = line.filter_map(|(ahead, right)| view.pose.cell_at(ahead, right));
                cells.for_each(|cell| ground.mark_free(cell));
            }
        }
        lay_landmarks(&self.seen, &mut ground);
        history.stood_on().for_each(|cell| ground.mark_free(cell));
        history.blocked().for_each(|cell| ground.mark_solid(cell));
        for view in views {
            let barricades = view.percept.barricades.iter();
            let cells = barricades.filter_map(|&(ahead, right)| view.pose.cell_at(ahead, right));
            cells.for_each(|cell| ground.mark_solid(cell));
        }
        self.ground = ground;
    }

    /// Marks on `ground` what is known from memory alone, and so does not change from step to step.
    pub(super) fn lay_lasting(&self, ground: &mut Surroundings) {
        self.lore.floor.iter().for_each(|&cell| ground.mark_free(cell));
        for walk in self.walks.iter().filter(|walk| walk.is_whole) {
            walk.steps.iter().for_each(|step| ground.mark_free(step.pose.cell));
        }
        lay_landmarks(&self.remembered, ground);
        self.goals.iter().for_each(|&goal| ground.mark_approach(goal));
    }

    /// Standpoints of the `nth` thing wanted that memory knows, sorted.
    pub(super) fn remembered_standpoints(&self, nth: usize, want: Want<'_>) -> Vec<Cell> {
        let told = self.lore.standpoints.get(nth).into_iter().flatten().copied();
        let mut cells: Vec<Cell> = told.chain(wanted(&self.remembered, want)).collect();
        cells.sort_unstable();
        cells.dedup();
        cells
    }

    /// All known standpoints of the `nth` thing wanted.
    pub(super) fn standpoints(&self, nth: usize, want: Want<'_>) -> Vec<Cell> {
        let mut cells = self.remembered_standpoints(nth, want);
        cells.extend(wanted(&self.seen, want));
        cells
    }
}

fn wanted(landmarks: &[Landmark], want: Want<'_>) -> impl Iterator<Item = Cell> {
    let meets = move |landmark: &&Landmark| want.is_met_by(landmark.plate);
    landmarks.iter().filter(meets).map(|landmark| landmark.standpoint)
}

fn lay_landmarks(landmarks: &[Landmark], ground: &mut Surroundings) {
    for landmark in landmarks {
        ground.mark_free(landmark.standpoint);
        if let Some(rack) = landmark.standpoint.step(landmark.face) {
            ground.mark_solid(rack);
        }
    }
}

/// The last views with their poses, oldest first, the present one last.
fn views(request: &Request<'_>, history: &History, mind: &mut Mind) -> Vec<PlacedView> {
    let past = request.window.iter().zip(&history.past);
    let frames = past.map(|(view, past)| (&view.frame, past.pose));
    let frames = frames.chain([(&request.frame, history.here)]);
    let placed = |(frame, pose): (&crate::FrameView<'_>, Pose)| PlacedView {
        frame: frame.id,
        pose,
        percept: mind.percepts.of(frame),
    };
    frames.map(placed).collect()
}

fn seen(views: &[PlacedView]) -> Vec<Landmark> {
    let placed = |view: &PlacedView| {
        let pose = view.pose;
        let sightings = view.percept.sightings.clone();
        sightings.into_iter().filter_map(move |sighting| sighting.seen_from(pose))
    };
    let mut seen: Vec<Landmark> = views.iter().flat_map(placed).collect();
    seen.sort_unstable();
    seen.dedup();
    seen
}

/// Cells, as (ahead, right), on the straight line from the camera to a standpoint: what is seen through is
/// not solid.
fn in_sight(ahead: i8, right: i8) -> impl Iterator<Item = (i8, i8)> {
    let (far, wide) = (f32::from(ahead), f32::from(right));
    let steps = (2 * ahead.unsigned_abs().max(right.unsigned_abs())).max(1);
    (0..=steps).map(move |i| {
        let share = f32::from(i) / f32::from(steps);
        ((far * share).round() as i8, (wide * share).round() as i8)
    })
}
