//! Deciding one step: follow what memory offers, go to what is asked for and in sight, or explore.

use shm_types::{Action, Cell, Pose};

use super::explore;
use super::geometry::{after, move_towards, turn_towards};
use super::history::History;
use super::instruction::{Ending, Goal, Visit, Want};
use super::percept::Percepts;
use super::recognise;
use super::surroundings::Surroundings;
use crate::Request;
use shm_types::plate::Landmark;

/// Farthest remembered pose that is walked to, in steps.
const FARTHEST_JOIN: u32 = 6;

/// The action for `request`.
pub(super) fn action(request: &Request<'_>, percepts: &mut Percepts) -> Action {
    let history = History::of(request);
    if !percepts.of(&request.frame).sketch.has_texture() {
        // Nothing can be seen: walking on would be walking blind.
        return Action::TurnRight;
    }
    let path = remembered_path(request, percepts);
    if let Some(action) = path.first().and_then(|step| exactly_here(step, &history)) {
        return action;
    }
    let scene = Scene::of(request, &history, percepts);
    join_path(&path, &history, &scene).or_else(|| seek(request, &history, &scene)).unwrap_or_else(
        || explore::action(&history, &scene.surroundings, request.episode_seed, request.step),
    )
}

/// A remembered pose and what the expert did in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PathStep {
    pose: Pose,
    action: Option<Action>,
}

/// The expert's poses and actions from the remembered view on, in the world of here and now; empty when
/// memory offers nothing or its view does not fit what is seen.
fn remembered_path(request: &Request<'_>, percepts: &mut Percepts) -> Vec<PathStep> {
    let Some([first, ..]) = request.segment.map(|segment| segment.steps) else {
        return Vec::new();
    };
    let (remembered, current) = (percepts.of(&first.frame), percepts.of(&request.frame));
    let mut pose = recognise::pose_of(&remembered, &current, request.pose);
    let mut path = Vec::new();
    for view in request.segment.map_or(&[][..], |segment| segment.steps) {
        let Some(at) = pose else { break };
        path.push(PathStep { pose: at, action: view.action });
        pose = view.action.and_then(|action| after(at, action));
    }
    path
}

/// The expert's action when the agent is in the very pose, unless it failed here or leads in circles.
fn exactly_here(step: &PathStep, history: &History) -> Option<Action> {
    let action = step.action.filter(|_| step.pose == history.here)?;
    leads_on(action, history).then_some(action)
}

/// Whether `action` did not fail here lately, and does not lead where the agent has been twice lately.
fn leads_on(action: Action, history: &History) -> bool {
    after(history.here, action).is_some_and(|pose| {
        history.times_in(pose) < 2 && !history.blocked().any(|cell| cell == pose.cell)
    })
}

/// The action that brings the agent onto the remembered path, or along it past what blocks the way.
fn join_path(path: &[PathStep], history: &History, scene: &Scene) -> Option<Action> {
    let here = history.here;
    // The last view of a segment that ends a demonstration leads nowhere, but is where it ends.
    let reach = |step: &PathStep| {
        let turn = turn_towards(here.heading, step.pose.heading);
        if step.pose.cell == here.cell {
            let action = turn.or(step.action)?;
            return Some((u32::from(turn.is_some()), action));
        }
        let (direction, length) = scene.surroundings.way_to(step.pose.cell)?;
        Some((length + u32::from(turn.is_some()), move_towards(here.heading, direction)))
    };
    let (_, action) = path
        .iter()
        .rev()
        .filter_map(reach)
        .filter(|&(length, action)| length <= FARTHEST_JOIN && leads_on(action, history))
        .min_by_key(|&(length, _)| length)?;
    Some(action)
}

/// What the last frames showed, put together.
struct Scene {
    landmarks: Vec<Landmark>,
    surroundings: Surroundings,
}

impl Scene {
    fn of(request: &Request<'_>, history: &History, percepts: &mut Percepts) -> Self {
        let past = request.window.iter().zip(&history.past);
        let views = past.map(|(view, past)| (&view.frame, past.pose));
        let mut landmarks = Vec::new();
        for (frame, pose) in views.chain([(&request.frame, history.here)]) {
            let percept = percepts.of(frame);
            landmarks.extend(percept.sightings.iter().filter_map(|seen| seen.seen_from(pose)));
        }
        landmarks.sort_unstable();
        landmarks.dedup();
        let mut surroundings = Surroundings::new(history.here);
        for landmark in &landmarks {
            surroundings.mark_free(landmark.standpoint);
            if let Some(rack) = landmark.standpoint.step(landmark.face) {
                surroundings.mark_solid(rack);
            }
        }
        history.stood_on().for_each(|cell| surroundings.mark_free(cell));
        history.blocked().for_each(|cell| surroundings.mark_solid(cell));
        Self { landmarks, surroundings }
    }

    /// Standpoints of what `want` asks for.
    fn standpoints(&self, want: Want) -> impl Iterator<Item = Cell> + '_ {
        let meets = move |landmark: &&Landmark| want.is_met_by(landmark.plate);
        self.landmarks.iter().filter(meets).map(|landmark| landmark.standpoint)
    }

    /// The step, counted as in [`History::stood_on`] from `from`, at which a standpoint of `want` was stood on.
    fn visit(&self, want: Want, history: &History, from: usize) -> Option<(usize, Cell)> {
        let mut stood_on = history.stood_on().enumerate().skip(from);
        stood_on.find(|(_, cell)| self.standpoints(want).any(|standpoint| standpoint == *cell))
    }
}

/// A step towards the nearest thing in sight that is still asked for.
fn seek(request: &Request<'_>, history: &History, scene: &Scene) -> Option<Action> {
    let goal = Goal::parse(request.instruction)?;
    let heading = history.here.heading;
    let towards = |goals: Vec<Cell>| {
        let ways = goals.into_iter().filter_map(|cell| {
            let (direction, length) = scene.surroundings.way_to(cell)?;
            Some((length, cell, direction))
        });
        ways.min_by_key(|&(length, cell, _)| (length, cell))
            .map(|(.., direction)| move_towards(heading, direction))
    };
    still_asked_for(&goal, history, scene).into_iter().find_map(towards)
}

/// Cells to go to, in groups: any of the first group, or if it is empty or out of reach, of the next.
fn still_asked_for(goal: &Goal, history: &History, scene: &Scene) -> Vec<Vec<Cell>> {
    let all = |want| scene.standpoints(want).collect::<Vec<_>>();
    let origin = || history.origin.into_iter().collect::<Vec<_>>();
    let at_the_end = |first: Cell| match goal.ending {
        Ending::There => Vec::new(),
        Ending::Origin => vec![origin()],
        Ending::FirstItem => vec![vec![first]],
    };
    match goal.visit {
        Visit::One(want) => match scene.visit(want, history, 0) {
            Some((_, cell)) => at_the_end(cell),
            None => vec![all(want)],
        },
        Visit::Every(want) => {
            let new = |cell: &Cell| !history.stood_on().any(|stood_on| stood_on == *cell);
            vec![all(want).into_iter().filter(new).collect()]
        }
        Visit::Both(a, b) => [a, b]
            .into_iter()
            .filter(|&want| scene.visit(want, history, 0).is_none())
            .map(all)
            .collect(),
        // Without a first visit in the window there may have been one before: the second is worth a
        // visit too, when there is nothing better to do.
        Visit::InOrder(a, b) => match scene.visit(a, history, 0) {
            None if scene.visit(b, history, 0).is_some() => vec![all(a)],
            None => vec![all(a), all(b)],
            Some((step, first)) => match scene.visit(b, history, step + 1) {
                None => vec![all(b)],
                Some(_) => at_the_end(first),
            },
        },
    }
}

#[cfg(test)]
mod tests;
