//! Deciding one step: follow what memory offers, go to what is asked for, or explore.
//!
//! One procedure for whatever is known and wherever it is known from.

use std::cell::RefCell;
use std::sync::Arc;

use domain::{Action, Cell, Pose};

use super::Mind;
use super::course::{self, Course, Plan, Source, leads_on, stride};
use super::explore;
use super::geometry::{after, move_towards, turn_towards};
use super::history::History;
use super::instruction::{Ending, Goal, Visit};
use super::lasting::WholeWalk;
use super::percept::Percept;
use super::scene::Scene;
use super::surroundings::{Surroundings, Ways};
use crate::Request;
use plates::Landmark;

/// Farthest part of a retrieved walk that is walked to, in steps.
const FARTHEST_JOIN: u32 = 6;

/// Steps beyond its own length for which a whole remembered walk is followed to the letter.
const TRUST: usize = 40;

/// Most cells that a round is made through of one kind.
const MOST_STOPS: usize = 10;

/// Steps between times in which what is in sight is gone to and times in which it is passed by.
const RESTLESSNESS: u32 = 24;

/// The action for `request`.
pub(super) fn action(request: &Request<'_>, mind: &mut Mind) -> Action {
    let history = History::of(request);
    if !mind.percepts.of(&request.frame).sketch.has_texture() {
        // Nothing can be seen: walking on would be walking blind.
        return Action::TurnRight;
    }
    let goal = Goal::parse(request.instruction);
    let scene = Scene::of(request, &history, goal.as_ref(), mind);
    Situation::new(request, &history, &scene, goal.as_ref()).decide(mind)
}

/// What is decided on.
struct Situation<'a> {
    request: &'a Request<'a>,
    history: &'a History,
    scene: &'a Scene,
    goal: Option<&'a Goal<'a>>,
    /// Ways over the scene's ground: one search, which each question takes as much further as it needs.
    ways: RefCell<Ways>,
}

impl<'a> Situation<'a> {
    fn new(
        request: &'a Request<'a>,
        history: &'a History,
        scene: &'a Scene,
        goal: Option<&'a Goal<'a>>,
    ) -> Self {
        Self { request, history, scene, goal, ways: RefCell::new(scene.ground.ways()) }
    }

    fn decide(&self, mind: &mut Mind) -> Action {
        let walks = self.whole_walks(mind);
        self.retrieved_here()
            .or_else(|| self.whole_walk_here(&walks))
            .or_else(|| self.single_goal())
            .or_else(|| self.join_retrieved())
            .or_else(|| self.join_whole_walk(&walks))
            .or_else(|| self.go_round(mind))
            .or_else(|| self.seek())
            .or_else(|| self.look_around(mind))
            .unwrap_or_else(|| self.explore())
    }

    fn explore(&self) -> Action {
        let Request { episode_seed, step, .. } = *self.request;
        explore::action(self.history, &self.scene.ground, episode_seed, step)
    }

    fn leads_on(&self, action: &Action) -> bool {
        leads_on(*action, self.history, &self.scene.ground)
    }

    /// What the expert did in the retrieved view, where that is the pose the agent is in.
    fn retrieved_here(&self) -> Option<Action> {
        let walk = self.scene.retrieved.as_ref()?;
        let first = walk.steps.first().filter(|step| step.pose == self.history.here)?;
        let action = first.action.or_else(|| self.turn_towards(walk.beyond.as_ref()?));
        action.filter(|action| self.leads_on(action))
    }

    /// The turn that brings `view` into sight. A move leaves much of a view in sight, so what shares nothing
    /// with it was seen after a turn; which one, the known plates and the known floor tell.
    fn turn_towards(&self, view: &Percept) -> Option<Action> {
        let (here, scene) = (self.history.here, self.scene);
        let known = |turn: &Action| {
            let there = after(here, *turn)?;
            if self.history.times_in(there) > 0 {
                return None;
            }
            let ahead = there.cell.step(there.heading);
            let is_open = ahead.is_some_and(|cell| scene.ground.is_free(cell));
            let seen = view.sightings.iter().filter_map(|sighting| sighting.seen_from(there));
            let weigh = |landmark: Landmark| {
                let place = |known: &&Landmark| {
                    (known.standpoint, known.face) == (landmark.standpoint, landmark.face)
                };
                match scene.seen.iter().filter(place).min() {
                    Some(known) if *known == landmark => 2,
                    Some(_) => -8,
                    None => -i32::from(scene.ground.is_solid(landmark.standpoint)) * 8,
                }
            };
            Some((seen.map(weigh).sum::<i32>(), is_open))
        };
        let turns = [Action::TurnAround, Action::TurnLeft, Action::TurnRight];
        turns
            .into_iter()
            .filter_map(|turn| Some((known(&turn)?, turn)))
            .max_by_key(|&(known, _)| known)
            .map(|(_, turn)| turn)
    }

    /// The step that brings the agent onto a retrieved walk, or along it past what blocks the way.
    fn join_retrieved(&self) -> Option<Action> {
        let here = self.history.here;
        let steps = self.scene.retrieved.as_ref()?.steps.iter().rev();
        // The last view of a segment that ends a demonstration leads nowhere, but is where it ends.
        let mut ways = self.ways.borrow_mut();
        let reach = |step: &super::chart::PathStep| {
            let turn = turn_towards(here.heading, step.pose.heading);
            if step.pose.cell == here.cell {
                let action = turn.or(step.action)?;
                return Some((u32::from(turn.is_some()), action));
            }
            if step.pose.cell.distance(here.cell) > FARTHEST_JOIN {
                return None;
            }
            let way = ways.to(step.pose.cell)?;
            Some((
                way.length + u32::from(turn.is_some()),
                move_towards(here.heading, way.direction),
            ))
        };
        steps
            .filter_map(reach)
            .filter(|(length, action)| *length <= FARTHEST_JOIN && self.leads_on(action))
            .min_by_key(|&(length, _)| length)
            .map(|(_, action)| action)
    }

    /// Courses of whole walks, as long as they are trusted.
    fn whole_walks(&self, mind: &mut Mind) -> Vec<Arc<Course>> {
        let is_trusted = |walk: &WholeWalk| self.request.step as usize <= walk.steps.len() + TRUST;
        let walks = self.scene.whole_walks().filter(|(_, walk)| is_trusted(walk));
        let courses = walks.filter_map(|(at, walk)| {
            mind.courses.of(self.source(Plan::Walk(at)), || {
                let course = Course::of_walk(&walk.steps, &self.scene.lasting.standpoints.concat());
                let is_round = !self.is_single();
                Some(if is_round {
                    course.closed(|pose| self.lasting_ground(pose))
                } else {
                    course
                })
            })
        });
        courses.collect()
    }

    fn whole_walk_here(&self, courses: &[Arc<Course>]) -> Option<Action> {
        let here = courses.iter().filter_map(|course| course.action_here(self.history));
        let (_, action) =
            here.filter(|(_, action)| self.leads_on(action)).max_by_key(|&(led, _)| led)?;
        Some(action)
    }

    fn join_whole_walk(&self, courses: &[Arc<Course>]) -> Option<Action> {
        let mut ways = self.ways.borrow_mut();
        let joins = courses
            .iter()
            .filter_map(|course| course.join(self.history, &self.scene.ground, &mut ways));
        let (_, action) =
            joins.filter(|(_, action)| self.leads_on(action)).min_by_key(|&(cost, _)| cost)?;
        Some(action)
    }

    /// Whether one thing has to be reached, and nothing more.
    fn is_single(&self) -> bool {
        matches!(self.goal, Some(Goal { visit: Visit::One(_), ending: Ending::There }))
    }

    fn single_goal(&self) -> Option<Action> {
        self.is_single().then(|| self.seek()).flatten()
    }

    /// The ground around `pose` as far as it is lastingly known.
    fn lasting_ground(&self, pose: Pose) -> Surroundings {
        let mut ground = Surroundings::new(pose, self.scene.doubt);
        self.scene.lasting.lay(&self.scene.kept, &mut ground);
        ground
    }

    fn source(&self, plan: Plan) -> Source {
        let Scene { lasting, kept, doubt, .. } = self.scene;
        let origin = self.origin();
        Source { plan, lasting: lasting.serial, kept: kept.clone(), origin, doubt: *doubt }
    }

    /// Where the episode began; where that is not known, where a remembered walk for the task began.
    fn origin(&self) -> Option<Cell> {
        let mut whole = self.scene.whole_walks();
        let begun = || whole.find_map(|(_, walk)| walk.steps.first()).map(|step| step.pose.cell);
        self.scene.origin.or_else(begun)
    }

    /// On the round through everything wanted, if memory knows where it is.
    fn go_round(&self, mind: &mut Mind) -> Option<Action> {
        let goal = self.goal?;
        let groups = &self.scene.lasting.standpoints;
        if groups.iter().any(Vec::is_empty) {
            return None;
        }
        let round = self.round(mind, Plan::Stops, |ground| {
            let mut groups = groups.clone();
            groups.iter_mut().for_each(|group| group.truncate(MOST_STOPS));
            let origin = self.origin().filter(|_| goal.ending == Ending::Origin);
            match goal.visit {
                Visit::Every(_) => {
                    let mut cells = groups.concat();
                    cells.extend(origin);
                    Some(course::round_trip(cells, ground))
                }
                _ => {
                    groups.extend(origin.map(|cell| vec![cell]));
                    course::best_choice(&groups, ground)
                }
            }
        })?;
        self.walk_round(&round)
    }

    /// On a round through the regions in which what is wanted has been seen.
    fn look_around(&self, mind: &mut Mind) -> Option<Action> {
        let lore = &self.scene.lasting.lore;
        let regions = lore.regions.iter().flatten();
        let round = self.round(mind, Plan::Regions, |ground| {
            let cells = regions.flat_map(|region| {
                let floor = || lore.floor.iter().copied().filter(|&cell| region.contains(cell));
                [floor().min(), floor().max()].into_iter().flatten()
            });
            let mut cells: Vec<Cell> = cells.take(MOST_STOPS).collect();
            cells.sort_unstable();
            cells.dedup();
            Some(course::round_trip(cells, ground))
        })?;
        self.walk_round(&round)
    }

    fn round(
        &self,
        mind: &mut Mind,
        plan: Plan,
        stops: impl FnOnce(&dyn Fn(Pose) -> Surroundings) -> Option<Vec<Cell>>,
    ) -> Option<Arc<Course>> {
        mind.courses.of(self.source(plan), || {
            let ground = |pose| self.lasting_ground(pose);
            Course::through(&stops(&ground)?, ground)
        })
    }

    fn walk_round(&self, round: &Course) -> Option<Action> {
        if let Some((_, action)) = round.action_here(self.history)
            && self.leads_on(&action)
        {
            return Some(action);
        }
        let mut ways = self.ways.borrow_mut();
        let (_, action) = round.join(self.history, &self.scene.ground, &mut ways)?;
        self.leads_on(&action).then_some(action)
    }

    /// A step towards the nearest known thing that is still asked for.
    fn seek(&self) -> Option<Action> {
        let goal = self.goal?;
        let is_restless = self.request.step / RESTLESSNESS % 2 == 1;
        if is_restless && matches!(goal.visit, Visit::Every(_) | Visit::InOrder(..)) {
            return None;
        }
        let here = self.history.here;
        let mut ways = self.ways.borrow_mut();
        let towards = |goals: Vec<Cell>| {
            if goals.contains(&here.cell) {
                return None;
            }
            let mut nearest: Option<(u32, Cell)> = None;
            for goal in goals {
                let dearest = nearest.map_or(u32::MAX, |(cost, _)| cost);
                let found = ways.cost_within(goal, dearest).map(|cost| (cost, goal));
                nearest = nearest.into_iter().chain(found).min();
            }
            let (_, goal) = nearest?;
            ways.to(goal).map(|way| stride(here.heading, way))
        };
        self.still_asked_for(goal).into_iter().find_map(towards)
    }

    /// Cells to go to, in groups: any of the first group, or if it is empty or out of reach, of the next.
    fn still_asked_for(&self, goal: &Goal<'_>) -> Vec<Vec<Cell>> {
        let (history, scene) = (self.history, self.scene);
        let origin = || scene.origin.into_iter().collect::<Vec<_>>();
        let at_the_end = |first: Cell| match goal.ending {
            Ending::There => Vec::new(),
            Ending::Origin => vec![origin()],
            Ending::FirstItem => vec![vec![first]],
        };
        let all = |nth, want| scene.standpoints(nth, want);
        // The step, counted as in `History::stood_on`, at which a standpoint was stood on.
        let visit = |nth, want, from| {
            let standpoints = all(nth, want);
            let mut stood_on = history.stood_on().enumerate().skip(from);
            stood_on.find(|(_, cell)| standpoints.contains(cell))
        };
        match goal.visit {
            Visit::One(want) => match visit(0, want, 0) {
                Some((_, cell)) => at_the_end(cell),
                None => vec![all(0, want)],
            },
            Visit::Every(want) => {
                let new = |cell: &Cell| !history.stood_on().any(|stood_on| stood_on == *cell);
                vec![all(0, want).into_iter().filter(new).collect()]
            }
            Visit::Both(a, b) => [(0, a), (1, b)]
                .into_iter()
                .filter(|&(nth, want)| visit(nth, want, 0).is_none())
                .map(|(nth, want)| all(nth, want))
                .collect(),
            // Without a first visit in the window there may have been one before: the second is worth a
            // visit too, when there is nothing better to do.
            Visit::InOrder(a, b) => match visit(0, a, 0) {
                None if visit(1, b, 0).is_some() => vec![all(0, a)],
                None => vec![all(0, a), all(1, b)],
                Some((step, first)) => match visit(1, b, step + 1) {
                    None => vec![all(1, b)],
                    Some(_) => at_the_end(first),
                },
            },
        }
    }
}

#[cfg(test)]
mod tests;
