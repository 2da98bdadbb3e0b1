//! Acts out episodes and demonstrations for those who show and check them.

use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use case_book::CaseVariant;
use case_book::act::{
    ActAnswer, ActRequest, ActedDemonstration, ActedEpisode, ActedReference, DemonstrationsRequest,
    EpisodeRequest, EpisodeScenery, Scene, StreamBlockPlace, Target, WorldDescription,
};
use domain::camera::CameraSetup;
use domain::{Action, ActionCode, Cell, DemonstrationKind, Feedback, Pose, Route, State};
use serde_json::{Map, Value};

use crate::case::{Case, History, TrajectoryKind};
use crate::case_book::{case_facts, converted};
use crate::dynamics::{Variant, step};
use crate::ended::EndedEpisode;
use crate::event_recorder::EventRecorder;
use crate::map;
use crate::progress::Progress;
use crate::sight::cells;
use crate::state::WorldState;
use crate::swapped::{GREY_VARIANT, SwappedPoses};
use crate::task::Task;
use crate::trajectory::Trajectory;
use crate::world::{Item, Warehouse};
use crate::worlds::RunWorlds;

/// Answers requests about the worlds of a run.
#[derive(Debug)]
pub struct Stage {
    worlds: RunWorlds,
    /// Variants that were asked for.
    variants: HashMap<u32, Rc<WorldState>>,
    /// References that were planned, by variant, case and begin.
    planned: HashMap<(u32, usize, Pose), Option<Trajectory>>,
    swapped: Option<SwappedPoses>,
}

/// Why a request cannot be met.
type Refusal = String;

impl Stage {
    /// For the worlds of a run.
    pub fn new(worlds: RunWorlds) -> Self {
        Self { worlds, variants: HashMap::new(), planned: HashMap::new(), swapped: None }
    }

    /// The answer to `request`.
    pub fn answer(&mut self, request: &ActRequest) -> ActAnswer {
        let answer = match request {
            ActRequest::World => Ok(ActAnswer::World(self.describe())),
            ActRequest::Episode(request) => {
                self.episode(request).map(|acted| ActAnswer::Episode(Box::new(acted)))
            }
            ActRequest::Demonstrations(request) => {
                self.demonstrations(request).map(ActAnswer::Demonstrations)
            }
            ActRequest::Scene(variant) => self.scene(*variant).map(ActAnswer::Scene),
            ActRequest::Swapped(variant, poses) => {
                self.swapped(*variant, poses).map(ActAnswer::Swapped)
            }
        };
        answer.unwrap_or_else(ActAnswer::Error)
    }

    fn describe(&self) -> WorldDescription {
        let RunWorlds { facts, warehouse, cases, streams, states } = &self.worlds;
        let (cases, count) = (&cases.cases, cases.cases.len());
        let states = 0..states.len() as u32;
        let of_state = |world| streams.as_ref().map_or(0, |set| set.variant(world, count));
        WorldDescription {
            world: facts.clone(),
            cases: case_facts(warehouse, cases),
            blocked: (1..=count as u32).collect(),
            states: states.map(of_state).collect(),
        }
    }

    fn variant(&mut self, number: u32) -> Result<Rc<WorldState>, Refusal> {
        if let Some(known) = self.variants.get(&number) {
            return Ok(Rc::clone(known));
        }
        let found = self.worlds.variant(number);
        let found = Rc::new(found.ok_or_else(|| format!("there is no world variant {number}"))?);
        self.variants.insert(number, Rc::clone(&found));
        Ok(found)
    }

    fn case(&self, id: &str) -> Result<usize, Refusal> {
        self.worlds.cases.index(id).ok_or_else(|| format!("there is no case {id}"))
    }

    fn episode(&mut self, request: &EpisodeRequest) -> Result<ActedEpisode, Refusal> {
        let state = self.variant(request.variant)?;
        let index = self.case(&request.case)?;
        let case = &self.worlds.cases.cases[index];
        let task = case.task;
        let listed = request
            .reference
            .map(|(start, route)| case.trajectory(TrajectoryKind::reference(start, route)).clone());
        let begin = match request.begin {
            Some(begin) => Some(Pose::try_from(begin).map_err(|error| error.to_string())?),
            None => listed.as_ref().map(|listed| listed.start),
        };
        let begin = begin.ok_or("an episode needs a begin, or a reference that has one")?;
        let is_read = |action: Option<ActionCode>| action.map(Action::try_from).transpose();
        let actions: Vec<Option<Action>> = request
            .actions
            .iter()
            .map(|&action| is_read(action))
            .collect::<Result<_, _>>()
            .map_err(|error| error.to_string())?;
        let actions = &actions;
        let WorldState { warehouse, variant } = &*state;
        if !warehouse.layout.is_free(begin.cell) {
            return Err(format!("the cell of pose {begin} is not free floor"));
        }
        let mismatched = CaseVariant::with_mismatch(request.variant);
        let camera = mismatched.map_or(CameraSetup::STANDARD, |of| CameraSetup::of(of.mismatch));
        let parts = request.parts;
        let steps = Steps::take(&state, &task, begin, actions);
        let scenery = parts.scenery.then(|| EpisodeScenery {
            came_into_view: came_into_view(warehouse, camera, &steps.poses),
            closed: variant.closed().to_vec(),
            targets: targets(&task, warehouse),
            changes: request.stream.map_or(Vec::new(), |place| self.changes(place)),
        });
        let reference = match parts.reference {
            true => self.reference(request, index, listed, begin)?,
            false => None,
        };
        let is_blocked_route = request.reference.is_some_and(|(_, route)| route == Route::Blocked);
        let conflict_at = conflict_at(variant, actions, &steps).filter(|_| is_blocked_route);
        // Paths are compared in streams.
        let of_stream = reference.as_ref().filter(|_| request.reference.is_none());
        let of_stream = of_stream.map_or(&[][..], |reference| &reference.states);
        let of_stream: Vec<Pose> =
            of_stream.iter().filter_map(|&state| state.try_into().ok()).collect();
        let facts = parts.facts.then(|| EndedEpisode {
            task: &task,
            poses: &steps.poses,
            sub_goals: &steps.sub_goals,
            required: steps.required,
            events: events(warehouse, (&task, camera), &steps.poses),
            blocked_moves: blocked_moves(&steps),
            conflict_at,
            reference: &of_stream,
            completes_in: None,
        });
        let facts = facts.and_then(as_object);
        Ok(ActedEpisode {
            task: task.task_type().number(),
            instruction: task.instruction(&warehouse.catalogue),
            facts,
            conflict_at,
            reference,
            scenery,
            states: converted(&steps.poses),
            feedback: converted(&steps.feedback),
            sub_goals: steps.sub_goals,
            required: steps.required,
        })
    }

    /// What the expert does: the case's own trajectory, or in a stream one that is planned.
    fn reference(
        &mut self,
        request: &EpisodeRequest,
        index: usize,
        listed: Option<Trajectory>,
        begin: Pose,
    ) -> Result<Option<ActedReference>, Refusal> {
        let state = self.variant(request.variant)?;
        let case = &self.worlds.cases.cases[index];
        let trajectory = match listed {
            Some(listed) => Some(listed),
            None => {
                let planned = self.planned.entry((request.variant, index, begin));
                let plan = || Some(state.reference(&state.expert(), &case.task, begin)?.0);
                planned.or_insert_with(plan).clone()
            }
        };
        Ok(trajectory.map(|trajectory| {
            let replay = trajectory.replay(&state.warehouse, &case.task, &state.variant);
            ActedReference {
                actions: converted(&trajectory.actions),
                states: converted(&replay.poses),
                length: replay.length.unwrap_or(0),
                invalidated: !state.completes(&case.original, &case.task),
            }
        }))
    }

    /// How the world of a block differs from that of the block before in the order of its sequence, in words.
    fn changes(&self, at: StreamBlockPlace) -> Vec<String> {
        let RunWorlds { warehouse, streams, .. } = &self.worlds;
        let changes = streams.as_ref().and_then(|set| {
            let before = match at.place.checked_sub(1) {
                Some(before) => *set.order(at.stream, at.order).get(before as usize)?,
                None => 0,
            };
            let stream = set.streams.get(at.stream as usize)?;
            Some(stream.changes(before, at.block, warehouse))
        });
        changes.unwrap_or_default()
    }

    fn demonstrations(
        &mut self,
        request: &DemonstrationsRequest,
    ) -> Result<Vec<ActedDemonstration>, Refusal> {
        let state = self.variant(request.variant)?;
        let cases = &self.worlds.cases;
        let mut histories = cases.histories(self.case(&request.case)?, request.set);
        for (case, kind) in &request.more {
            let more = cases.index(case).map(|case| History { case, kind: *kind });
            histories.extend(more.filter(|more| !histories.contains(more)));
        }
        let acted = histories.into_iter().filter_map(|history| {
            let planned = request.planned.then(|| self.planned(history, &state)).flatten();
            match planned {
                Some(trajectory) => {
                    let case = &cases.cases[history.case];
                    let variant = request.variant;
                    Some(demonstration(case, history.kind, variant, &state, &case.task, trajectory))
                }
                None => self.demonstrated(history, (!request.planned).then_some(&state)),
            }
        });
        Ok(acted.collect())
    }

    /// What an expert who knows `state` does from the begin of a demonstration of the file of cases.
    fn planned(&self, history: History, state: &WorldState) -> Option<Trajectory> {
        let case = self.worlds.cases.cases.get(history.case)?;
        let from = case.trajectory(TrajectoryKind::demonstration(history.kind)?).start;
        Some(state.reference(&state.expert(), &case.task, from)?.0)
    }

    /// A demonstration where it takes place; whether it is stale is judged in `state`.
    fn demonstrated(
        &self,
        history: History,
        state: Option<&Rc<WorldState>>,
    ) -> Option<ActedDemonstration> {
        let RunWorlds { warehouse, cases, .. } = &self.worlds;
        let found = cases.demonstrated(warehouse, history)?;
        let case = &cases.cases[history.case];
        let place = WorldState {
            warehouse: found.warehouse.clone(),
            variant: Variant::closing(found.closed.iter().copied()),
        };
        let trajectory = found.trajectory.into_owned();
        let can_be_stale = history.kind != DemonstrationKind::Elsewhere;
        let is_stale =
            can_be_stale && state.is_some_and(|state| !state.completes(&trajectory, &case.task));
        let acted =
            demonstration(case, history.kind, found.variant, &place, found.task, trajectory);
        Some(ActedDemonstration { is_stale, ..acted })
    }

    fn swapped(&mut self, variant: u32, states: &[State]) -> Result<Vec<State>, Refusal> {
        let state = self.variant(variant)?;
        let poses = states.iter().map(|&state| Pose::try_from(state));
        let poses: Vec<Pose> =
            poses.collect::<Result<_, _>>().map_err(|error| error.to_string())?;
        let layout = &self.worlds.warehouse.layout;
        let swapped = self.swapped.get_or_insert_with(|| SwappedPoses::new(layout));
        Ok(poses.iter().map(|pose| swapped.shown(&state.variant, *pose).into()).collect())
    }

    fn scene(&mut self, variant: u32) -> Result<Scene, Refusal> {
        // Grey shows no world: it has a view wherever the tested one has.
        let state = self.variant(if variant == GREY_VARIANT { 0 } else { variant })?;
        let WorldState { warehouse, variant } = &*state;
        let layout = &warehouse.layout;
        let mark = |cell: Cell| match (layout.is_free(cell), variant.is_closed(cell)) {
            (true, false) => '.',
            (true, true) => 'x',
            (false, _) => '#',
        };
        let row = |y| (0..layout.width()).map(|x| mark(Cell { x, y })).collect();
        let (cell, margin) = map::MEASURES;
        Ok(Scene {
            floor: (0..layout.height()).map(row).collect(),
            svg: map::ground_svg(warehouse),
            measures: (cell as u32, margin as u32),
        })
    }
}

/// The steps of an episode. Index 0 is its begin.
struct Steps {
    poses: Vec<Pose>,
    feedback: Vec<Feedback>,
    sub_goals: Vec<u32>,
    required: u32,
}

impl Steps {
    fn take(state: &WorldState, task: &Task, begin: Pose, actions: &[Option<Action>]) -> Self {
        let mut progress = Progress::new(&state.warehouse, task, begin.cell);
        let mut steps = Self {
            poses: vec![begin],
            feedback: vec![Feedback::Start],
            sub_goals: vec![0; progress.stage() as usize],
            required: progress.total(),
        };
        let mut pose = begin;
        for (taken, action) in (1..).zip(actions) {
            let feedback;
            (pose, feedback) = match action {
                Some(action) => step(&state.warehouse.layout, &state.variant, pose, *action),
                None => (pose, Feedback::NotUnderstood),
            };
            let met = progress.visit(pose.cell);
            steps.poses.push(pose);
            steps.feedback.push(feedback);
            steps.sub_goals.extend((0..met).map(|_| taken));
        }
        steps
    }
}

/// The facts of an episode as a JSON object.
fn as_object(ended: EndedEpisode<'_>) -> Option<Map<String, Value>> {
    match serde_json::to_value(ended.facts()?) {
        Ok(Value::Object(facts)) => Some(facts),
        _ => None,
    }
}

/// Whether or not a visit counted, and what was in view, the last step excepted.
fn events(
    warehouse: &Warehouse,
    (task, camera): (&Task, CameraSetup),
    poses: &[Pose],
) -> EventRecorder {
    let mut recorder = EventRecorder::new(warehouse, task, camera);
    for (taken, pose) in (0_u32..).zip(poses) {
        recorder.stands(taken, *pose);
        if taken == 0 || (taken as usize) + 1 < poses.len() {
            recorder.looks(warehouse, taken, *pose);
        }
    }
    recorder
}

/// The steps whose move was blocked.
fn blocked_moves(steps: &Steps) -> Vec<u32> {
    let feedback = (0..).zip(&steps.feedback);
    feedback.filter(|(_, feedback)| **feedback == Feedback::Blocked).map(|(at, _)| at).collect()
}

/// The first step that tried to enter a cell that is closed in `variant`.
fn conflict_at(variant: &Variant, actions: &[Option<Action>], steps: &Steps) -> Option<u32> {
    let tried = |(action, pose): (&Option<Action>, &Pose)| {
        let direction = action.and_then(Action::move_direction);
        let entered = direction.and_then(|it| pose.cell.step(pose.heading.turned(it)));
        entered.is_some_and(|cell| variant.is_closed(cell))
    };
    let index = actions.iter().zip(&steps.poses).position(tried)?;
    Some(index as u32 + 1)
}

/// By step, the cells that came into view for the first time.
fn came_into_view(warehouse: &Warehouse, camera: CameraSetup, poses: &[Pose]) -> Vec<Vec<Cell>> {
    let mut known = HashSet::new();
    let new = |pose: &Pose| {
        cells(&warehouse.layout, camera, *pose).filter(|cell| known.insert(*cell)).collect()
    };
    poses.iter().map(new).collect()
}

fn targets(task: &Task, warehouse: &Warehouse) -> Vec<Target> {
    let target = |item: &Item| {
        let name = warehouse.catalogue.types[item.item_type].name.clone();
        Some(Target { letter: task.letter(warehouse, item)?, name, cell: item.standpoint })
    };
    task.targets(warehouse).into_iter().filter_map(target).collect()
}

/// A demonstration in `state`, which is the variant with this number.
fn demonstration(
    case: &Case,
    kind: DemonstrationKind,
    variant: u32,
    state: &WorldState,
    task: &Task,
    trajectory: Trajectory,
) -> ActedDemonstration {
    let replay = trajectory.replay(&state.warehouse, task, &state.variant);
    ActedDemonstration {
        case: case.id.clone(),
        kind,
        variant,
        task: task.task_type().number(),
        instruction: task.instruction(&state.warehouse.catalogue),
        states: converted(&replay.poses),
        feedback: converted(&replay.feedback),
        actions: converted(&trajectory.actions),
        sub_goals: replay.goal_steps,
        length: replay.length,
        is_stale: false,
        closed: state.variant.closed().to_vec(),
        targets: targets(task, &state.warehouse),
    }
}

#[cfg(test)]
mod tests {
    use case_book::act::EpisodeParts;
    use domain::{Demonstrations, FeedbackCode, Start};
    use serde_json::json;

    use super::*;

    /// An episode from a case's original start on a route that takes these steps.
    fn request(case: &str, variant: u32, actions: Vec<Option<Action>>) -> EpisodeRequest {
        EpisodeRequest {
            case: case.to_owned(),
            variant,
            reference: Some((Start::Original, Route::Unchanged)),
            begin: None,
            actions: actions.into_iter().map(|action| action.map(Into::into)).collect(),
            stream: None,
            parts: EpisodeParts { facts: true, reference: true, scenery: true },
        }
    }

    #[test]
    fn visits_first_sights_and_sub_goals_are_told() {
        let mut stage = Stage::new(RunWorlds::read(None, None, None).unwrap());
        let reference =
            stage.episode(&request("t06-01", 0, Vec::new())).unwrap().reference.unwrap();
        let steps = reference.actions.iter().take(reference.length as usize);
        let steps = steps.map(|action| Action::try_from(*action).ok()).collect();
        let acted = stage.episode(&request("t06-01", 0, steps)).unwrap();
        assert_eq!((acted.sub_goals, acted.required), (vec![22, 57], 2));
        let facts = Value::from(acted.facts.unwrap());
        assert_eq!(facts["visits"], json!(["22A@6,28", "57B@6,1"]));
        assert_eq!(facts["first_seen"], json!({"A": 8, "B": 52}));
        assert_eq!((&facts["blocked_moves"], facts.get("failure")), (&json!([]), None));
    }

    #[test]
    fn a_try_to_enter_a_closed_cell_and_an_answer_that_was_not_read_leave_the_agent_in_place() {
        let worlds = RunWorlds::read(None, None, None).unwrap();
        let case = worlds.cases.cases[0].clone();
        let closed = case.barricade[0];
        let beside = domain::Heading::ALL.into_iter().find_map(|heading| {
            let cell = closed.step(heading.opposite())?;
            let is_free = worlds.warehouse.layout.is_free(cell) && !case.barricade.contains(&cell);
            is_free.then_some(Pose { cell, heading })
        });
        let mut stage = Stage::new(worlds);
        let steps = vec![None, Some(Action::Forward)];
        let mut acted = |variant| {
            let route = if variant == 0 { Route::Unchanged } else { Route::Blocked };
            let request = EpisodeRequest {
                begin: beside.map(Into::into),
                reference: Some((Start::New, route)),
                ..request(&case.id, variant, steps.clone())
            };
            stage.episode(&request).unwrap()
        };
        let blocked = acted(1);
        let facts = Value::from(blocked.facts.unwrap());
        assert_eq!(blocked.states, [State::from(beside.unwrap()); 3]);
        assert_eq!(
            blocked.feedback[1..],
            [Feedback::NotUnderstood, Feedback::Blocked].map(FeedbackCode::from)
        );
        assert_eq!((&facts["blocked_moves"], blocked.conflict_at), (&json!([2]), Some(2)));
        assert_eq!(facts["failure"], json!({"kind": "blocked", "step": 2}));
        assert_eq!(blocked.scenery.unwrap().closed, case.barricade);
        assert_eq!(Pose::try_from(acted(0).states[2]).unwrap().cell, closed);
    }

    #[test]
    fn demonstrations_are_those_of_the_set_and_more_and_what_does_not_exist_is_left_out() {
        let mut stage = Stage::new(RunWorlds::read(None, None, None).unwrap());
        let of = |case: &str, kind| (case.to_owned(), kind);
        let acted = stage.demonstrations(&DemonstrationsRequest {
            case: "t01-01".to_owned(),
            set: Demonstrations::ORIGINAL,
            more: vec![
                of("t01-01", DemonstrationKind::Original),
                of("t01-02", DemonstrationKind::After),
                of("t01-02", DemonstrationKind::Elsewhere),
                of("t99-01", DemonstrationKind::Original),
            ],
            variant: 1,
            planned: false,
        });
        let acted = acted.unwrap();
        let named: Vec<_> = acted.iter().map(|one| (one.case.as_str(), one.kind)).collect();
        let expected =
            [("t01-01", DemonstrationKind::Original), ("t01-02", DemonstrationKind::After)];
        assert_eq!(named, expected);
        assert_eq!((acted[0].variant, acted[1].variant), (0, 2));
        assert!(acted.iter().all(|one| one.states.len() == one.actions.len() + 1));
        assert!(acted[0].is_stale, "the passage of the first case is on its way");
    }
}
