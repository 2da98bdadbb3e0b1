//! A path that was demonstrated: where it is followed, and where it is joined.

use domain::{Action, Cell, Heading};

use super::geometry::{PathStep, after, move_towards, turn_towards};
use super::local_map::{LocalMap, LocalRoutes};
use super::recent::{PastPose, RecentSteps};

/// Steps of a tour that have to be passable where it is joined.
const CLEAR_AHEAD: usize = 8;

/// The length of a straight stretch that is worth the turn to face it.
const LONG_STRETCH: usize = 3;

/// Poses and actions, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tour {
    steps: Vec<PathStep>,
    /// The step at which the first goal is reached.
    first_goal: usize,
}

impl Tour {
    /// The tour along a demonstrated path. It reaches the last goal at its end.
    pub(super) fn along(steps: Vec<PathStep>, goals: &[Cell]) -> Self {
        let first_goal = steps.iter().position(|step| goals.contains(&step.pose.cell));
        let first_goal = first_goal.unwrap_or(steps.len());
        Self { steps, first_goal }
    }

    pub(super) fn len(&self) -> usize {
        self.steps.len()
    }

    pub(super) fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        self.steps.iter().map(|step| step.pose.cell)
    }

    /// The action of the tour in the current pose, and how many of the last steps followed the tour up to it.
    /// Where the tour passes the pose more than once, the last steps decide, then the order of the tour.
    pub(super) fn action_here(&self, recent: &RecentSteps) -> Option<(usize, Action)> {
        let here = self.steps.iter().enumerate().filter(|(_, step)| step.pose == recent.here);
        let actions = here.filter_map(|(at, step)| Some((at, step.action?)));
        let followed = actions.map(|(at, action)| (self.followed_to(at, recent), at, action));
        let best = followed.max_by_key(|&(followed, at, _)| (followed, std::cmp::Reverse(at)));
        best.map(|(followed, _, action)| (followed, action))
    }

    /// How many of the last steps were those of the tour before step `at`.
    fn followed_to(&self, at: usize, recent: &RecentSteps) -> usize {
        let is_same = |(past, step): &(&PastPose, &PathStep)| {
            past.pose == step.pose && past.action == step.action
        };
        recent.past.iter().rev().zip(self.steps[..at].iter().rev()).take_while(is_same).count()
    }

    /// The action that leads onto the tour where that makes the whole path past all goals shortest, and the
    /// cost of that path. The way there costs `limit` at most.
    pub(super) fn join(
        &self,
        recent: &RecentSteps,
        map: &LocalMap,
        routes: &LocalRoutes,
        limit: u32,
    ) -> Option<(u32, Action)> {
        let here = recent.here;
        let is_clear = |at: usize| {
            let mut ahead = self.steps[at..].iter().take(CLEAR_AHEAD);
            !ahead.any(|step| map.is_occupied(step.pose.cell))
        };
        let cost = |(at, step): (usize, &PathStep)| {
            step.action?;
            let way = routes.cost(step.pose.cell)? + u32::from(step.pose.heading != here.heading);
            (way <= limit).then(|| (way + self.remaining(at), at))
        };
        let costs = self.steps.iter().enumerate().filter_map(cost);
        let (cost, at) = costs.filter(|&(_, at)| is_clear(at)).min()?;
        let PathStep { pose, action } = self.steps[at];
        let on_the_spot = turn_towards(here.heading, pose.heading).or(action);
        Some((cost, stride(here.heading, &routes.moves_to(pose.cell)).or(on_the_spot)?))
    }

    /// Steps from step `at` until all goals are passed: after the first goal, another round is needed.
    fn remaining(&self, at: usize) -> u32 {
        let again = if at <= self.first_goal { 0 } else { self.steps.len() };
        (again + self.steps.len() - at) as u32
    }
}

/// The first action of a route: a turn if the route leads straight on for long, so that the agent sees what
/// lies ahead, else a move; `None` where the route is empty.
pub(super) fn stride(heading: Heading, moves: &[Heading]) -> Option<Action> {
    let direction = *moves.first()?;
    let straight = moves.iter().take_while(|&&heading| heading == direction).count();
    let turn = turn_towards(heading, direction).filter(|_| straight >= LONG_STRETCH);
    Some(turn.unwrap_or_else(|| move_towards(heading, direction)))
}

/// Whether `action` leads somewhere useful: not into an occupied cell, and not to a pose that occurs twice in
/// the last steps already.
pub(super) fn makes_progress(action: Action, recent: &RecentSteps, map: &LocalMap) -> bool {
    after(recent.here, action).is_some_and(|pose| {
        let stays = pose.cell == recent.here.cell;
        recent.times_in(pose) < 2 && (stays || !map.is_occupied(pose.cell))
    })
}
