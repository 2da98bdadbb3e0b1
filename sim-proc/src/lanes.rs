//! The lanes: which episode each runs, how far it is, and how commands change that.

use std::collections::HashMap;
use std::hash::{Hash, Hasher};

use case_book::{CaseVariant, EpisodeFacts};
use domain::camera::CameraSetup;
use domain::{Action, Cell, Feedback, Pose, Start, UnknownCode};
use shm_types::message::{EpisodeEnd, StepCommand, StepKind, WorldEpisodeConfig, read_flag};
use warehouse::{EndedEpisode, EventRecorder, Progress, step};

use crate::lived::LivedEpisodes;
use crate::worlds::{WorldParts, Worlds};

/// What follows from the beginning of an episode, or from a command.
#[derive(Debug, Clone, PartialEq)]
pub struct Stepped {
    /// The lane.
    pub lane: usize,
    /// World of its episode.
    pub world: WorldParts,
    /// The agent's pose.
    pub pose: Pose,
    /// The response to the action.
    pub feedback: Feedback,
    /// Sub-goals completed so far.
    pub sub_goals: u32,
    /// All sub-goals of the task.
    pub required: u32,
    /// Whether the agent tried to enter a cell that the variant closes.
    pub conflict: bool,
    /// Whether the episode has ended, and how.
    pub ended: EpisodeEnd,
    /// The facts of the episode, if it has ended.
    pub facts: Option<EpisodeFacts>,
    /// Of the state of the world, at the begin and at the end; otherwise 0.
    pub state_hash: u64,
}

/// An episode under way.
#[derive(Debug, Clone)]
struct SimulatedEpisode {
    config: WorldEpisodeConfig,
    world: WorldParts,
    pose: Pose,
    step: u32,
    /// The poses, the begin first.
    poses: Vec<Pose>,
    progress: Progress,
    /// The steps at which sub-goals were completed, in order.
    sub_goals: Vec<u32>,
    /// The first step that tried to enter a closed cell.
    conflict_at: Option<u32>,
    events: EventRecorder,
    blocked_moves: Vec<u32>,
    actions: Vec<Action>,
}

/// All lanes of a run, and the worlds that their episodes are in.
#[derive(Debug)]
pub struct SimulatedLanes {
    worlds: Worlds,
    lanes: Vec<Option<SimulatedEpisode>>,
    /// The episodes that memories learn from.
    lived: LivedEpisodes,
    references: References,
}

impl SimulatedLanes {
    /// `lanes` idle lanes in `worlds`, after the episodes `lived` that memories have learned from before.
    pub fn new(lived: LivedEpisodes, worlds: Worlds, lanes: usize) -> Self {
        Self { worlds, lanes: vec![None; lanes], lived, references: References::default() }
    }

    /// The episodes that memories learn from.
    pub fn lived(&self) -> &LivedEpisodes {
        &self.lived
    }

    /// The worlds.
    pub fn worlds(&self) -> &Worlds {
        &self.worlds
    }

    /// World variant `number`, if an agent can stand at `pose` in it.
    ///
    /// # Errors
    /// When there is no such variant, or no agent can stand there.
    pub fn standing(&self, number: u32, pose: Pose) -> Result<WorldParts, String> {
        let world = self.worlds.variant(number).ok_or_else(|| {
            format!("variant {number} is not one of {}", self.worlds.variant_count())
        })?;
        if !self.worlds.layout_of(world).is_free(pose.cell)
            || self.worlds.closed(world).is_closed(pose.cell)
        {
            return Err(format!("an agent cannot stand at {pose}"));
        }
        Ok(world)
    }

    /// Begins an episode, in place of the one that the lane may be in.
    ///
    /// # Errors
    /// What is wrong with it. The lane is unchanged then.
    pub fn begin(&mut self, config: &WorldEpisodeConfig) -> Result<Stepped, String> {
        let &WorldEpisodeConfig { lane, episode, .. } = config;
        let begun = self.begun(config);
        let (episode, stepped) =
            begun.map_err(|problem| format!("episode {episode} in lane {lane}: {problem}"))?;
        if let Some(of) = episode.learned_as() {
            self.lived.begin(of, episode.world, episode.pose);
        }
        self.lanes[lane as usize] = Some(episode);
        Ok(stepped)
    }

    fn begun(&self, config: &WorldEpisodeConfig) -> Result<(SimulatedEpisode, Stepped), String> {
        let &WorldEpisodeConfig { lane, case, variant, start, .. } = config;
        let count = self.lanes.len();
        if lane as usize >= count {
            return Err(format!("there are {count} lanes"));
        }
        let is_new = read_flag(start).map_err(|unknown| unknown.to_string())?;
        let start = if is_new { Start::New } else { Start::Original };
        let case = self.worlds.case(case).ok_or_else(|| format!("there is no case {case}"))?;
        let of_other = |of: CaseVariant| of.case != config.case;
        if CaseVariant::with_mismatch(variant).is_some_and(of_other) {
            return Err(format!("variant {variant} is not one of case {}", config.case));
        }
        let is_blocked = CaseVariant::without_mismatch(variant) == 1 + config.case;
        let pose = case.start(start, is_blocked);
        let world = self.standing(variant, pose)?;
        let warehouse = self.worlds.warehouse(world);
        let mut events = EventRecorder::new(warehouse, &case.task, CameraSetup::of(world.look));
        events.stands(0, pose);
        events.looks(warehouse, 0, pose);
        let progress = Progress::new(warehouse, &case.task, pose.cell);
        let episode = SimulatedEpisode {
            config: *config,
            world,
            pose,
            step: 0,
            poses: vec![pose],
            sub_goals: vec![0; progress.stage() as usize],
            progress,
            conflict_at: None,
            events,
            blocked_moves: Vec::new(),
            actions: Vec::new(),
        };
        let stepped = episode.stepped(Feedback::Start, false, EpisodeEnd::GoesOn);
        Ok((episode, stepped))
    }

    /// Executes a command. `None` if it is about another episode of the lane, which is over: a config is taken before the commands
    /// that follow it.
    ///
    /// # Errors
    /// What is wrong, if the command is invalid or out of order. The lane is unchanged then.
    pub fn apply(&mut self, command: &StepCommand) -> Result<Option<Stepped>, String> {
        let &StepCommand { lane, episode, step, .. } = command;
        self.try_apply(command).map_err(|problem| {
            format!("command for lane {lane}, episode {episode}, step {step}: {problem}")
        })
    }

    fn try_apply(&mut self, command: &StepCommand) -> Result<Option<Stepped>, String> {
        let count = self.lanes.len();
        let lane = self.lanes.get_mut(command.lane as usize);
        let lane = lane.ok_or_else(|| format!("there are {count} lanes"))?;
        let text = |unknown: UnknownCode| unknown.to_string();
        let action = match StepKind::try_from(command.kind).map_err(text)? {
            StepKind::Act => Some(Action::try_from(command.action).map_err(text)?),
            StepKind::Stay => None,
        };
        let Some(episode) = lane else { return Err("the lane is in no episode".to_owned()) };
        if command.episode != episode.config.episode {
            return Ok(None);
        }
        if Some(command.step) != episode.step.checked_add(1) {
            let SimulatedEpisode { config, step, .. } = episode;
            return Err(format!("the lane is in episode {} after step {step}", config.episode));
        }
        let mut stepped = episode.step(&self.worlds, action);
        if let Some(of) = episode.learned_as() {
            self.lived.step(of, stepped.pose);
        }
        if stepped.ended != EpisodeEnd::GoesOn {
            let references = &mut self.references;
            let ended = lane.take();
            stepped.facts = ended.and_then(|episode| episode.facts(&self.worlds, references));
        }
        Ok(Some(stepped))
    }
}

impl SimulatedEpisode {
    /// The sequence and the position of an episode that a memory learns from.
    fn learned_as(&self) -> Option<(u64, u32)> {
        let WorldEpisodeConfig { sequence, position, learns, .. } = self.config;
        (learns != 0).then_some((sequence, position))
    }

    /// Takes a step.
    fn step(&mut self, worlds: &Worlds, action: Option<Action>) -> Stepped {
        self.step += 1;
        let closed = worlds.closed(self.world);
        let mut conflict = false;
        let feedback = match action {
            Some(action) => {
                conflict = entered(self.pose, action).is_some_and(|cell| closed.is_closed(cell));
                self.actions.push(action);
                let feedback;
                let layout = worlds.layout_of(self.world);
                (self.pose, feedback) = step(layout, closed, self.pose, action);
                feedback
            }
            None => Feedback::NotUnderstood,
        };
        if feedback == Feedback::Blocked {
            self.blocked_moves.push(self.step);
        }
        if conflict {
            self.conflict_at.get_or_insert(self.step);
        }
        self.poses.push(self.pose);
        self.events.stands(self.step, self.pose);
        let met = self.progress.visit(self.pose.cell);
        self.sub_goals.extend((0..met).map(|_| self.step));
        let ended = if self.progress.is_complete() {
            EpisodeEnd::Complete
        } else if self.step >= self.config.max_steps {
            EpisodeEnd::StepLimit
        } else {
            // What the last step leads to is not shown.
            self.events.looks(worlds.warehouse(self.world), self.step, self.pose);
            EpisodeEnd::GoesOn
        };
        self.stepped(feedback, conflict, ended)
    }

    fn stepped(&self, feedback: Feedback, conflict: bool, ended: EpisodeEnd) -> Stepped {
        Stepped {
            lane: self.config.lane as usize,
            world: self.world,
            pose: self.pose,
            feedback,
            sub_goals: self.progress.stage(),
            required: self.progress.total(),
            conflict,
            ended,
            facts: None,
            state_hash: if self.step == 0 || ended != EpisodeEnd::GoesOn { self.hash() } else { 0 },
        }
    }

    /// A hash of the state: variant, pose and progress.
    fn hash(&self) -> u64 {
        let mut hasher = StateHasher::default();
        (self.config.variant, self.pose, &self.progress).hash(&mut hasher);
        hasher.finish()
    }

    /// The facts of the episode, which has ended.
    fn facts(self, worlds: &Worlds, references: &mut References) -> Option<EpisodeFacts> {
        let Self { config, poses, sub_goals, progress, .. } = self;
        let WorldEpisodeConfig { case: number, variant, learns, .. } = config;
        let case = worlds.case(number)?;
        let begin = *poses.first()?;
        let reference = references.poses(worlds, number, variant, begin);
        let ended = EndedEpisode {
            task: &case.task,
            poses: &poses,
            sub_goals: &sub_goals,
            required: progress.total(),
            events: self.events,
            blocked_moves: self.blocked_moves,
            conflict_at: self
                .conflict_at
                .filter(|_| CaseVariant::without_mismatch(variant) == 1 + number),
            reference,
            completes_in: (learns != 0).then(|| worlds.completed_in(number, begin, self.actions)),
        };
        ended.facts()
    }
}

/// What the expert does in the streams of a run, planned when the first episode of a case in a variant ends.
#[derive(Debug, Default)]
struct References {
    /// The poses by case and variant; empty for a case that cannot be solved there.
    planned: HashMap<(u32, u32), Vec<Pose>>,
}

impl References {
    /// The poses of the reference of case number `case` from `begin` in `variant`; empty if that is not of a stream.
    fn poses(&mut self, worlds: &Worlds, case: u32, variant: u32, begin: Pose) -> &[Pose] {
        if !worlds.is_of_streams(variant) {
            return &[];
        }
        let plan = || worlds.reference_poses(case, variant, begin).unwrap_or_default();
        self.planned.entry((case, variant)).or_insert_with(plan)
    }
}

/// A hash that is the same in every build.
#[derive(Default)]
struct StateHasher(blake3::Hasher);

impl Hasher for StateHasher {
    fn write(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    fn finish(&self) -> u64 {
        let hash = self.0.finalize();
        hash.as_bytes().first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes))
    }
}

/// The cell that `action` tries to enter from `pose`, if it is a move.
fn entered(pose: Pose, action: Action) -> Option<Cell> {
    pose.cell.step(pose.heading.turned(action.move_direction()?))
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use domain::Route;
    use proptest::prelude::*;
    use shm_types::message::NO_ACTION;
    use warehouse::{CaseSet, TrajectoryKind, Warehouse, WorldChange, WorldState};

    use super::*;

    fn lanes() -> SimulatedLanes {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        SimulatedLanes::new(
            LivedEpisodes::default(),
            Worlds::new(&warehouse, &cases, Vec::new(), &[]),
            2,
        )
    }

    fn config(lane: u32, episode: u64) -> WorldEpisodeConfig {
        WorldEpisodeConfig { lane, episode, max_steps: 200, ..Zeroable::zeroed() }
    }

    fn act(lane: u32, episode: u64, step: u32, action: Action) -> StepCommand {
        let (kind, action) = (StepKind::Act as u8, action as u8);
        StepCommand { lane, episode, step, kind, action, ..Zeroable::zeroed() }
    }

    fn stay(lane: u32, episode: u64, step: u32) -> StepCommand {
        let (kind, action) = (StepKind::Stay as u8, NO_ACTION);
        StepCommand { lane, episode, step, kind, action, ..Zeroable::zeroed() }
    }

    #[test]
    fn an_episode_runs_by_the_dynamics_and_ends_at_its_limit() {
        let mut lanes = lanes();
        let from = CaseSet::shipped().cases[0].original.start;
        let begun = lanes.begin(&WorldEpisodeConfig { max_steps: 2, ..config(1, 7) }).unwrap();
        assert_eq!((begun.pose, begun.feedback, begun.sub_goals), (from, Feedback::Start, 0));
        let turned = lanes.apply(&act(1, 7, 1, Action::TurnLeft)).unwrap().unwrap();
        assert_eq!(turned.pose, Pose { heading: from.heading.left(), ..from });
        assert_eq!((turned.feedback, turned.ended), (Feedback::Turned, EpisodeEnd::GoesOn));
        let stayed = lanes.apply(&stay(1, 7, 2)).unwrap().unwrap();
        assert_eq!((stayed.pose, stayed.feedback), (turned.pose, Feedback::NotUnderstood));
        assert_eq!(stayed.ended, EpisodeEnd::StepLimit);
        let facts = stayed.facts.unwrap();
        assert_eq!((facts.start_pose, facts.final_pose), (from, turned.pose));
        assert_eq!((facts.completes_in, facts.blocked_moves.len()), (None, 0));
        let error = lanes.apply(&act(1, 7, 3, Action::Forward)).unwrap_err();
        assert_eq!(error, "command for lane 1, episode 7, step 3: the lane is in no episode");
    }

    #[test]
    fn a_failure_a_loop_and_in_streams_the_path_are_told() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let spin = |states: Vec<WorldState>, variant: u32| {
            let worlds = Worlds::new(&warehouse, &cases, states, &[]);
            let mut lanes = SimulatedLanes::new(LivedEpisodes::default(), worlds, 1);
            let config = WorldEpisodeConfig { max_steps: 20, start: 1, variant, ..config(0, 7) };
            lanes.begin(&config).unwrap();
            let mut steps = (1..=20).map(|step| act(0, 7, step, Action::TurnLeft));
            steps.find_map(|command| lanes.apply(&command).unwrap()?.facts).unwrap()
        };
        let unchanged = || WorldState::new(&warehouse, &WorldChange::default()).unwrap();
        let first = cases.cases.len() as u32 + 1;
        let case = &cases.cases[0];
        let reference = case.replay(&warehouse, TrajectoryKind::Test);
        let mut cells: Vec<_> = reference.poses.iter().map(|pose| pose.cell).collect();
        cells.dedup();
        for (states, variant, length) in [
            (vec![], 0, None),
            (vec![unchanged()], 0, Some(cells.len())),
            (vec![unchanged()], first, Some(cells.len())),
        ] {
            let facts = spin(states, variant);
            // The begin, and every fourth turn.
            assert_eq!(facts.looped_at, Some(16));
            assert!(facts.failure.is_some_and(|failure| failure.step <= 20));
            assert_eq!(facts.path.map(|path| path.length as usize), length);
        }
    }

    #[test]
    fn the_expert_completes_every_case_and_what_is_closed_is_told() {
        let (mut lanes, cases) = (lanes(), CaseSet::shipped());
        let tested = [
            (Start::Original, Route::Unchanged),
            (Start::New, Route::Unchanged),
            (Start::New, Route::Blocked),
        ];
        let mut episode = 0;
        for (number, case) in (0..).zip(&cases.cases) {
            for (start, route) in tested {
                let from = TrajectoryKind::reference(start, route);
                let (expert, closed) = (case.trajectory(from), route == Route::Blocked);
                let replay = case.replay(&Warehouse::shipped(), from);
                episode += 1;
                let variant = if closed { 1 + number } else { 0 };
                let start = start as u8;
                let config = WorldEpisodeConfig {
                    case: number,
                    variant,
                    start,
                    learns: 1,
                    ..config(0, episode)
                };
                assert_eq!(lanes.begin(&config).unwrap().pose, expert.start);
                let mut last = None;
                for (step, &action) in (1..).zip(&expert.actions) {
                    let stepped = lanes.apply(&act(0, episode, step, action)).unwrap().unwrap();
                    assert_eq!(stepped.pose, replay.poses[step as usize]);
                    assert!(!stepped.conflict);
                    if stepped.ended != EpisodeEnd::GoesOn {
                        assert_eq!(Some(step), replay.length, "{}", case.id);
                        last = Some(stepped);
                        break;
                    }
                }
                let last = last.unwrap();
                assert_eq!((last.ended, last.sub_goals), (EpisodeEnd::Complete, last.required));
                let facts = last.facts.unwrap();
                // Only a return is no visit: it may lead to any cell.
                assert!(!facts.visits.is_empty() && !facts.first_seen.is_empty());
                assert_eq!(facts.completes_in, Some([].into()), "there are no streams");
            }
            // The unblocked reference runs into the passage that was closed on it.
            episode += 1;
            let variant = 1 + number;
            let config =
                WorldEpisodeConfig { case: number, variant, start: 1, ..config(0, episode) };
            lanes.begin(&config).unwrap();
            let steps = (1..).zip(&case.test.actions);
            let mut stepped =
                steps.map(|(step, &action)| lanes.apply(&act(0, episode, step, action)).unwrap());
            assert!(stepped.any(|stepped| stepped.unwrap().conflict), "{}", case.id);
        }
    }

    #[test]
    fn invalid_messages_are_reported_and_change_nothing() {
        let mut lanes = lanes();
        let good = config(0, 7);
        lanes.begin(&good).unwrap();
        for (config, problem) in [
            (WorldEpisodeConfig { lane: 2, ..good }, "there are 2 lanes"),
            (WorldEpisodeConfig { variant: 999, ..good }, "variant 999 is not one of 101"),
            (WorldEpisodeConfig { case: 999, ..good }, "there is no case 999"),
            (WorldEpisodeConfig { start: 2, ..good }, "2 is not a flag"),
        ] {
            let error = lanes.begin(&config).unwrap_err();
            assert!(error.contains(problem), "{error}");
        }
        let good = act(0, 7, 1, Action::Left);
        for (command, problem) in [
            (StepCommand { lane: 2, ..good }, "there are 2 lanes"),
            (StepCommand { kind: 9, ..good }, "9 is not a step kind"),
            (StepCommand { action: 7, ..good }, "7 is not an action"),
            (act(0, 7, 2, Action::Left), "the lane is in episode 7 after step 0"),
            (act(1, 7, 1, Action::Left), "the lane is in no episode"),
        ] {
            let error = lanes.apply(&command).unwrap_err();
            assert!(error.contains(problem), "{error}");
        }
        for other in [6, 8] {
            assert_eq!(lanes.apply(&act(0, other, 9, Action::Left)), Ok(None), "it is late");
        }
        assert!(lanes.apply(&act(0, 7, 1, Action::TurnLeft)).is_ok());
    }

    proptest! {
        #[test]
        fn no_message_panics_and_an_agent_stands_on_free_floor(
            messages in proptest::collection::vec((0..3_u32, 0..2_u64, 0..4_u32, 0..3_u32,
                0..101_u32, 0..3_u8, 0..3_u8, 0..9_u8, any::<bool>()), 0..64)
        ) {
            let mut lanes = lanes();
            for (lane, episode, step, variant, case, start, kind, action, begins) in messages {
                let stepped = if begins {
                    let limits = config(lane, episode);
                    let config =
                        WorldEpisodeConfig { variant, case, start, learns: start, ..limits };
                    lanes.begin(&config).map(Some)
                } else {
                    let command =
                        StepCommand { lane, episode, step, kind, action, ..Zeroable::zeroed() };
                    lanes.apply(&command)
                };
                if let Ok(Some(stepped)) = stepped {
                    let closed = lanes.worlds.closed(stepped.world);
                    prop_assert!(lanes.worlds.layout().is_free(stepped.pose.cell));
                    prop_assert!(!closed.is_closed(stepped.pose.cell));
                }
            }
        }
    }
}
