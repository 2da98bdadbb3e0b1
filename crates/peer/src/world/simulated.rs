//! A [`Simulator`] in the role of a run's world: an environment for each lane, and one that acts out demonstrations.

use std::cell::RefCell;
use std::rc::Rc;

use case_book::{CaseVariant, DemonstrationBook, WorldDeclaration, looped_at, loops};
use domain::{ActionCode, Mismatch, Start, State};
use serde_json::{Map, Value, json};
use shm_types::Attach;
use shm_types::message::{
    EpisodeEnd, StepCommand, StepKind, ViewRequest, WorldEpisodeConfig, read_action, read_flag,
};

use super::simulator::{
    CaseDeclaration, Environment, EpisodeBegin, Observed, Simulator, TrajectoryName,
};
use super::stage::{Stage, StageBegin, check, is_complete};
use super::{
    Moment, Refusal, RenderSetup, RenderTask, RenderWorker, Renderers, World, WorldFailure,
};
use crate::error::ServeError;

/// A picture of an environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EnvironmentView {
    /// What is seen in a state with this hash, in episodes with this mismatch.
    State(u64, Mismatch),
    /// What is seen after a step of an episode, of a world that tells no hashes.
    Step {
        /// The lane.
        lane: u32,
        /// The episode.
        episode: u64,
        /// The step.
        step: u32,
    },
    /// The picture with this number among those of the demonstrations.
    Remembered(u32),
}

/// All lanes of a run in a simulator.
pub struct SimulatedWorld<'s, S: ?Sized> {
    simulator: &'s S,
    declaration: WorldDeclaration,
    mismatches: Vec<Mismatch>,
    demonstrations: Rc<DemonstrationBook>,
    environments: Rc<RefCell<Environments>>,
}

/// What steps and what draws need.
struct Environments {
    cases: Vec<CaseDeclaration>,
    lanes: Vec<Lane>,
    stage: Option<Stage>,
}

#[derive(Default)]
struct Lane {
    /// Made when the lane begins its first episode.
    environment: Option<Box<dyn Environment>>,
    episode: Option<RunningEpisode>,
}

struct RunningEpisode {
    config: WorldEpisodeConfig,
    mismatch: Mismatch,
    step: u32,
    /// The states, the begin first.
    states: Vec<State>,
    /// The sub-goals completed in each of them.
    completed: Vec<u32>,
    now: Observed,
}

impl<'s, S: Simulator + ?Sized> SimulatedWorld<'s, S> {
    /// The world of the run in `attach`, whose memories ask for views of `demonstrations`.
    ///
    /// # Errors
    /// When the simulator has no cases.
    pub fn new(
        simulator: &'s S,
        attach: &Attach,
        demonstrations: DemonstrationBook,
    ) -> Result<Self, WorldFailure> {
        let lanes = (0..attach.lanes).map(|_| Lane::default()).collect();
        let environments = Environments { cases: simulator.cases()?, lanes, stage: None };
        Ok(Self {
            simulator,
            declaration: simulator.declaration(),
            mismatches: simulator.mismatches(),
            demonstrations: Rc::new(demonstrations),
            environments: Rc::new(RefCell::new(environments)),
        })
    }

    /// What the world renders with: its environments, on its own thread.
    ///
    /// # Errors
    /// When an environment cannot be made.
    pub fn rendering(&self, attach: &Attach) -> Result<RenderSetup<EnvironmentView>, WorldFailure> {
        self.environments.borrow_mut().stage = Some(Stage::new(self.simulator.environment()?));
        let WorldDeclaration { name, version, .. } = &self.declaration;
        Ok(RenderSetup {
            renderers: Renderers::Caller(Box::new(EnvironmentRenderer {
                environments: Rc::clone(&self.environments),
                demonstrations: Rc::clone(&self.demonstrations),
                size: (attach.frame.width, attach.frame.height),
            })),
            facts: vec![("world", format!("{name} {version}"))],
        })
    }

    /// The moment of the lane's episode, after `action`.
    fn moment(
        &self,
        lane: &mut Lane,
        action: Option<ActionCode>,
    ) -> Result<Moment<EnvironmentView>, Refusal> {
        let Lane { environment: Some(environment), episode: Some(episode) } = lane else {
            return Err("the lane is in no episode".to_owned().into());
        };
        let RunningEpisode { config, mismatch, step, states, completed, now } = episode;
        check(&self.declaration, now).map_err(Refusal::Episode)?;
        let ended = if is_complete(now) {
            EpisodeEnd::Complete
        } else if now.has_failed {
            EpisodeEnd::Failed
        } else if *step >= config.max_steps {
            EpisodeEnd::StepLimit
        } else {
            EpisodeEnd::GoesOn
        };
        let has_ended = ended != EpisodeEnd::GoesOn;
        let moment = Moment {
            state: now.state,
            action,
            feedback: now.feedback,
            view: match now.state_hash {
                Some(hash) => EnvironmentView::State(hash, *mismatch),
                None => EnvironmentView::Step {
                    lane: config.lane,
                    episode: config.episode,
                    step: *step,
                },
            },
            sub_goals: now.sub_goals,
            required: now.required,
            conflict: now.conflict,
            ended,
            facts: if has_ended {
                let own = environment.facts().map_err(Refusal::of)?;
                Some(Value::Object(facts(states, completed, own)).to_string())
            } else {
                None
            },
            state_hash: if *step == 0 || has_ended { state_hash(now) } else { 0 },
        };
        if has_ended {
            lane.episode = None;
        }
        Ok(moment)
    }
}

/// A hash of what an environment is in: its own, or that of the agent's state.
pub(super) fn state_hash(observed: &Observed) -> u64 {
    observed.state_hash.unwrap_or_else(|| {
        let numbers = observed.state.numbers().iter().flat_map(|number| number.to_le_bytes());
        let hash = blake3::hash(&numbers.collect::<Vec<u8>>());
        hash.as_bytes().first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes))
    })
}

/// The facts of an episode: those of the environment, with the states of begin and end, and its loops. `completed` has the number of
/// sub-goals completed in each of `states`.
pub(super) fn facts(
    states: &[State],
    completed: &[u32],
    own: Map<String, Value>,
) -> Map<String, Value> {
    let mut facts = Map::new();
    facts.insert("start_state".to_owned(), json!(states.first()));
    facts.insert("final_state".to_owned(), json!(states.last()));
    if let Some(step) = looped_at(states) {
        facts.insert("looped_at".to_owned(), json!(step));
    }
    let situations: Vec<(u32, State)> =
        completed.iter().copied().zip(states.iter().copied()).collect();
    facts.insert("loops".to_owned(), json!(loops(&situations)));
    facts.extend(own);
    facts
}

impl<S: Simulator + ?Sized> World for SimulatedWorld<'_, S> {
    type View = EnvironmentView;
    type Picture = EnvironmentView;

    fn begin(&mut self, config: &WorldEpisodeConfig) -> Result<Moment<EnvironmentView>, Refusal> {
        let &WorldEpisodeConfig { lane: number, case, variant, start, seed, .. } = config;
        let environments = &mut *self.environments.borrow_mut();
        let Environments { cases, lanes, .. } = environments;
        let count = lanes.len();
        let lane = lanes.get_mut(number as usize);
        let lane = lane.ok_or_else(|| format!("episode config: there are {count} lanes"))?;
        let named = cases.get(case as usize).ok_or_else(|| format!("there is no case {case}"))?;
        let has_blocked = named.trajectories.contains_key(&TrajectoryName::Blocked);
        let mismatch = match CaseVariant::with_mismatch(variant) {
            Some(of) if of.case != case || !self.mismatches.contains(&of.mismatch) => {
                return Err(format!("case {case} has no variant {variant}").into());
            }
            Some(of) => of.mismatch,
            None => Mismatch::None,
        };
        let is_blocked = match CaseVariant::without_mismatch(variant) {
            0 => false,
            blocked if blocked == 1 + case && has_blocked => true,
            blocked if blocked == 1 + case => {
                return Err(Refusal::Episode(format!("case {} has no blocked route", named.id)));
            }
            _ => return Err(format!("case {case} has no variant {variant}").into()),
        };
        let is_new = read_flag(start).map_err(|unknown| unknown.to_string())?;
        let start = if is_new || is_blocked { Start::New } else { Start::Original };
        let start = match start {
            Start::New => TrajectoryName::New,
            Start::Original => TrajectoryName::Original,
        };
        lane.episode = None;
        let environment = match &mut lane.environment {
            Some(environment) => environment,
            none => none.insert(self.simulator.environment().map_err(Refusal::of)?),
        };
        let begin = EpisodeBegin { case: named, start, is_blocked, mismatch, seed };
        let now = environment.reset(&begin).map_err(Refusal::of)?;
        lane.episode = Some(RunningEpisode {
            config: *config,
            mismatch,
            step: 0,
            states: vec![now.state],
            completed: vec![now.sub_goals],
            now,
        });
        self.moment(lane, None)
    }

    fn apply(&mut self, command: &StepCommand) -> Result<Option<Moment<EnvironmentView>>, Refusal> {
        let &StepCommand { lane: number, episode: id, step, .. } = command;
        let invalid = |problem: String| {
            format!("command for lane {number}, episode {id}, step {step}: {problem}")
        };
        let environments = &mut *self.environments.borrow_mut();
        let count = environments.lanes.len();
        let lane = environments.lanes.get_mut(number as usize);
        let lane = lane.ok_or_else(|| invalid(format!("there are {count} lanes")))?;
        let kind =
            StepKind::try_from(command.kind).map_err(|unknown| invalid(unknown.to_string()))?;
        let action = match kind {
            StepKind::Act => read_action(command.action)
                .and_then(|action| self.declaration.read_action(action))
                .map_err(|unknown| invalid(unknown.to_string()))?,
            StepKind::Stay => None,
        };
        let Lane { environment: Some(environment), episode: Some(episode) } = &mut *lane else {
            return Err(invalid("the lane is in no episode".to_owned()).into());
        };
        if id != episode.config.episode {
            return Ok(None);
        }
        if Some(step) != episode.step.checked_add(1) {
            let RunningEpisode { config, step, .. } = episode;
            let at = format!("the lane is in episode {} after step {step}", config.episode);
            return Err(invalid(at).into());
        }
        episode.now = match action {
            Some(action) => environment.step(action).map_err(Refusal::of)?,
            None => Observed {
                feedback: self.declaration.not_understood(),
                conflict: false,
                ..episode.now.clone()
            },
        };
        episode.step = step;
        episode.states.push(episode.now.state);
        episode.completed.push(episode.now.sub_goals);
        self.moment(lane, action).map(Some)
    }

    fn remembered(&mut self, request: &ViewRequest) -> Result<EnvironmentView, String> {
        let &ViewRequest { sequence, demonstration, step, .. } = request;
        let of = self.demonstrations.demonstrations.get(demonstration as usize);
        let view = of.and_then(|of| of.views.get(step as usize)).filter(|_| sequence == 0);
        let view = view.copied().map(EnvironmentView::Remembered);
        view.ok_or_else(|| format!("there is no step {step} of demonstration {demonstration}"))
    }

    fn picture(&self, view: EnvironmentView) -> EnvironmentView {
        view
    }

    fn check(&self) -> Result<(), ServeError> {
        self.simulator.check()
    }
}

/// Draws the views of all lanes and demonstrations.
struct EnvironmentRenderer {
    environments: Rc<RefCell<Environments>>,
    demonstrations: Rc<DemonstrationBook>,
    size: (u32, u32),
}

impl RenderWorker<EnvironmentView> for EnvironmentRenderer {
    fn render_into(
        &mut self,
        tasks: &mut [RenderTask<'_, EnvironmentView>],
    ) -> Result<u64, WorldFailure> {
        let Self { environments, demonstrations, size } = self;
        let Environments { cases, lanes, stage } = &mut *environments.borrow_mut();
        for RenderTask { picture, slot, .. } in tasks {
            let pixels = slot.pixels_mut();
            if let EnvironmentView::Remembered(number) = **picture {
                let stage = stage.as_mut().ok_or("the world does not render yet")?;
                let (begin, actions) = remembered(demonstrations, number)
                    .ok_or_else(|| format!("no demonstration has picture {number}"))?;
                stage.render(cases, begin, actions, *size, pixels)?;
                continue;
            }
            // The lane that waits for this picture has not taken another step.
            let shows = lanes.iter_mut().find_map(|lane| {
                let RunningEpisode { config, mismatch, step, now, .. } = lane.episode.as_ref()?;
                let is_seen = match **picture {
                    EnvironmentView::State(hash, seen_with) => {
                        (now.state_hash, *mismatch) == (Some(hash), seen_with)
                    }
                    EnvironmentView::Step { lane, episode, step: of } => {
                        (config.lane, config.episode, *step) == (lane, episode, of)
                    }
                    EnvironmentView::Remembered(_) => false,
                };
                lane.environment.as_mut().filter(|_| is_seen)
            });
            let environment = shows.ok_or("a view that no lane sees any more is asked for")?;
            environment.render(size.0, size.1, pixels)?;
        }
        Ok(0)
    }
}

/// How to come to the picture with this number: the begin of a demonstration, and actions of it.
fn remembered(book: &DemonstrationBook, number: u32) -> Option<(StageBegin, &[ActionCode])> {
    book.demonstrations.iter().find_map(|of| {
        let step = of.views.iter().position(|view| *view == number)?;
        let name = TrajectoryName::of(of.kind)?;
        Some((StageBegin::of(of.case, name), of.actions.get(..step)?))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_facts_of_an_episode_tell_its_loops_in_states_and_sub_goals() {
        // Two states in turn; a sub-goal is completed at step 24.
        let states: Vec<State> =
            (0..50_u8).map(|step| State::new(&[f32::from(step % 2)]).unwrap()).collect();
        let completed: Vec<u32> = (0..50).map(|step| u32::from(step >= 24)).collect();
        let told = facts(&states, &completed, Map::new());
        assert_eq!(told["loops"], json!([{"from": 2, "to": 23}, {"from": 26, "to": 49}]));
        assert_eq!(facts(&states[..9], &completed[..9], Map::new())["loops"], json!([]));
    }
}
