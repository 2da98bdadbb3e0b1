//! Decides one step: follow what memory offers, go to a target, or explore.

use std::cell::OnceCell;

use domain::{Action, Cell, Heading};
use peer::Request;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::beliefs::Beliefs;
use super::geometry::turn_towards;
use super::instruction::{FinalCell, NavigationGoal, VisitOrder};
use super::local_map::LocalRoutes;
use super::tour::{Tour, makes_progress, stride};

/// The cost of the longest way to a retrieved segment.
const FARTHEST_SEGMENT: u32 = 6;

/// Steps beyond its own length for which a demonstration is followed.
const PATIENCE: usize = 40;

/// In every other period of this many steps, items in sight are ignored: they may have been visited before the window
/// began.
const RESTLESS_STEPS: u32 = 24;

/// The action for `request`.
pub(super) fn next_action(
    request: &Request<'_>,
    goal: Option<&NavigationGoal<'_>>,
    beliefs: &Beliefs,
) -> Action {
    RoutePlanner { request, goal, beliefs, routes: OnceCell::new() }.next_action()
}

struct RoutePlanner<'a> {
    request: &'a Request<'a>,
    goal: Option<&'a NavigationGoal<'a>>,
    beliefs: &'a Beliefs,
    /// Routes from the current cell to all others.
    routes: OnceCell<LocalRoutes>,
}

impl RoutePlanner<'_> {
    fn next_action(&self) -> Action {
        if self.beliefs.is_blind {
            return Action::TurnRight;
        }
        let is_single = self.goal.is_some_and(|goal| {
            goal.visit == VisitOrder::One && goal.ending == FinalCell::LastItem
        });
        let segments = &self.beliefs.segments;
        // Memory supplies the most important segment first.
        let in_order = |step: &dyn Fn(&Tour) -> Option<Action>| segments.iter().find_map(step);
        in_order(&|segment| self.follow(std::iter::once(segment)))
            .or_else(|| self.follow(self.demonstrations()))
            .or_else(|| is_single.then(|| self.approach_target()).flatten())
            .or_else(|| in_order(&|tour| self.join(std::iter::once(tour), FARTHEST_SEGMENT)))
            .or_else(|| self.join(self.demonstrations(), u32::MAX))
            .or_else(|| self.approach_target())
            .unwrap_or_else(|| self.explore())
    }

    fn makes_progress(&self, action: &Action) -> bool {
        makes_progress(*action, &self.beliefs.recent, &self.beliefs.map)
    }

    fn routes(&self) -> &LocalRoutes {
        let Beliefs { recent, map, .. } = self.beliefs;
        self.routes.get_or_init(|| map.routes(recent.here, &[]))
    }

    /// The demonstrations, except those that have been followed for too long without success.
    fn demonstrations(&self) -> impl Iterator<Item = &Tour> {
        let demonstrations = self.beliefs.knowledge.demonstrations.iter();
        demonstrations.filter(|tour| self.request.step as usize <= tour.len() + PATIENCE)
    }

    /// The next step of the tour that the last steps followed longest, if the agent is on one.
    fn follow<'t>(&self, tours: impl Iterator<Item = &'t Tour>) -> Option<Action> {
        let actions = tours.filter_map(|tour| tour.action_here(&self.beliefs.recent));
        let useful = actions.filter(|(_, action)| self.makes_progress(action));
        useful.max_by_key(|&(followed, _)| followed).map(|(_, action)| action)
    }

    /// A step towards the tour that costs least from here, if one can be joined within `limit`.
    fn join<'t>(&self, tours: impl Iterator<Item = &'t Tour>, limit: u32) -> Option<Action> {
        let Beliefs { recent, map, .. } = self.beliefs;
        let joins = tours.filter_map(|tour| tour.join(recent, map, self.routes(), limit));
        let useful = joins.filter(|(_, action)| self.makes_progress(action));
        useful.min_by_key(|&(cost, _)| cost).map(|(_, action)| action)
    }

    /// A step towards the nearest known target that is still wanted.
    fn approach_target(&self) -> Option<Action> {
        let goal = self.goal?;
        let is_restless = self.request.step / RESTLESS_STEPS % 2 == 1;
        if is_restless && matches!(goal.visit, VisitOrder::Every | VisitOrder::InOrder) {
            return None;
        }
        self.wanted(goal).into_iter().find_map(|cells| self.approach(&cells))
    }

    /// A step towards the nearest of `cells`; `None` on one of them.
    fn approach(&self, cells: &[Cell]) -> Option<Action> {
        let Beliefs { recent, map, .. } = self.beliefs;
        if cells.is_empty() || cells.contains(&recent.here.cell) {
            return None;
        }
        let routes = map.routes(recent.here, cells);
        stride(recent.here.heading, &routes.moves_to(routes.nearest?))
    }

    /// Cells to visit next, as far as the window tells: any of the first group, or if that cannot be
    /// reached, of the next.
    fn wanted(&self, goal: &NavigationGoal<'_>) -> Vec<Vec<Cell>> {
        let recent = &self.beliefs.recent;
        let groups = goal.targets.iter().enumerate();
        let mut groups: Vec<Vec<Cell>> =
            groups.map(|(nth, &target)| self.beliefs.standpoints(nth, target)).collect();
        // The first visit to one of `cells`, not earlier than the `from`th cell of the window.
        let visit = |cells: &[Cell], from: usize| {
            recent.cells().enumerate().skip(from).find(|(_, cell)| cells.contains(cell))
        };
        let ending = |first: Cell| match goal.ending {
            FinalCell::LastItem => Vec::new(),
            FinalCell::Origin => vec![recent.origin.map(|pose| pose.cell).into_iter().collect()],
            FinalCell::FirstItem => vec![vec![first]],
        };
        match goal.visit {
            VisitOrder::One => match visit(&groups[0], 0) {
                Some((_, cell)) => ending(cell),
                None => groups,
            },
            VisitOrder::Every => {
                groups[0].retain(|cell| !recent.cells().any(|visited| visited == *cell));
                groups
            }
            VisitOrder::AnyOrder => {
                groups.retain(|cells| visit(cells, 0).is_none());
                groups
            }
            // The first visit may have been before the window: the second target is worth a visit, too.
            VisitOrder::InOrder => match visit(&groups[0], 0) {
                None if visit(&groups[1], 0).is_some() => groups[..1].to_vec(),
                None => groups,
                Some((at, first)) => match visit(&groups[1], at + 1) {
                    None => groups[1..].to_vec(),
                    Some(_) => ending(first),
                },
            },
        }
    }

    /// Moves ahead while that is possible, turns now and then, and prefers cells that were not visited recently. The
    /// episode's seed and the step decide between equals.
    fn explore(&self) -> Action {
        let mut rng = ChaCha8Rng::seed_from_u64(self.request.episode_seed);
        rng.set_stream(u64::from(self.request.step));
        let heading = self.beliefs.recent.here.heading;
        let directions = [0, 1, 3, 2].map(|quarters| heading.turned(quarters));
        let scored = directions
            .map(|direction| (self.appeal(direction) + (rng.next_u32() % 12) as i32, direction));
        let best = scored.into_iter().max_by_key(|&(score, _)| score);
        let direction = best.map_or(heading, |(_, direction)| direction);
        turn_towards(heading, direction).unwrap_or(Action::Forward)
    }

    /// How attractive it is to explore in `direction`.
    fn appeal(&self, direction: Heading) -> i32 {
        const IMPOSSIBLE: i32 = -100;
        let Beliefs { recent, map, .. } = self.beliefs;
        let here = recent.here;
        let Some(cell) = here.cell.step(direction).filter(|&cell| !map.is_occupied(cell)) else {
            return IMPOSSIBLE;
        };
        let has_just_turned = recent.past.last().is_some_and(|past| past.pose.cell == here.cell);
        let inertia = match here.heading.quarters_to(direction) {
            0 if has_just_turned => 20,
            0 => 8,
            2 => -8,
            _ => 0,
        };
        let known = if map.is_free(cell) { 3 } else { 0 };
        let steps_ago = recent.cells().rev().position(|visited| visited == cell);
        inertia + known - steps_ago.map_or(0, |steps| (12 - steps as i32).max(2))
    }
}
