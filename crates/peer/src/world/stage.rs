//! An environment that acts out trajectories outside of an episode: for the case book, for views that memory asks for, and for
//! those who show or check recorded episodes.

use case_book::WorldDeclaration;
use domain::{ActionCode, Mismatch};
use serde_json::{Map, Value};

use super::WorldFailure;
use super::simulator::{CaseDeclaration, Environment, EpisodeBegin, Observed, TrajectoryName};

/// The begin of a trajectory, without its seed: what is acted out has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct StageBegin {
    /// The index of the case.
    pub(super) case: u32,
    /// Where it begins.
    pub(super) start: TrajectoryName,
    /// Whether the way is blocked.
    pub(super) is_blocked: bool,
    /// In what the world differs from the demonstrations, beside that.
    pub(super) mismatch: Mismatch,
}

impl StageBegin {
    /// That of a trajectory of case number `case`.
    pub(super) fn of(case: u32, name: TrajectoryName) -> Self {
        let (start, is_blocked) = (name.start(), name.is_blocked());
        Self { case, start, is_blocked, mismatch: Mismatch::None }
    }
}

/// A trajectory that was acted out. Index 0 is its begin.
#[derive(Debug, Clone)]
pub(super) struct ActedTrajectory {
    pub(super) moments: Vec<Observed>,
    /// The steps at which sub-goals were completed, in order.
    pub(super) sub_goals: Vec<u32>,
}

impl ActedTrajectory {
    /// The first step at which the agent ran into what blocks the way.
    pub(super) fn conflict_at(&self) -> Option<u32> {
        self.moments.iter().position(|moment| moment.conflict).map(|step| step as u32)
    }

    /// The steps that complete the task; `None` if they do not.
    pub(super) fn length(&self) -> Option<u32> {
        self.moments.iter().position(is_complete).map(|step| step as u32)
    }
}

/// Whether the task is complete.
pub(super) fn is_complete(observed: &Observed) -> bool {
    observed.sub_goals >= observed.required
}

/// Checks what an environment of `world` says.
///
/// # Errors
/// What is wrong with it.
pub(super) fn check(world: &WorldDeclaration, observed: &Observed) -> Result<(), String> {
    let Observed { state, feedback, sub_goals, required, .. } = observed;
    world.check_state(state).map_err(|foreign| foreign.to_string())?;
    world.read_feedback(feedback.0).map_err(|unknown| unknown.to_string())?;
    if *required == 0 || sub_goals > required {
        return Err(format!("{sub_goals} of {required} sub-goals cannot be complete"));
    }
    Ok(())
}

/// An environment, and where it is.
pub(super) struct Stage {
    environment: Box<dyn Environment>,
    /// The begin, the actions so far, and what followed from them.
    at: Option<(StageBegin, Vec<ActionCode>)>,
}

impl Stage {
    pub(super) fn new(environment: Box<dyn Environment>) -> Self {
        Self { environment, at: None }
    }

    fn reset(
        &mut self,
        cases: &[CaseDeclaration],
        begin: StageBegin,
    ) -> Result<Observed, WorldFailure> {
        let StageBegin { case, start, is_blocked, mismatch } = begin;
        let case = cases.get(case as usize).ok_or_else(|| format!("there is no case {case}"))?;
        self.at = None;
        let begun = EpisodeBegin { case, start, is_blocked, mismatch, seed: 0 };
        let observed = self.environment.reset(&begun)?;
        self.at = Some((begin, Vec::new()));
        Ok(observed)
    }

    /// Acts out `actions`, to the end of the episode if that comes first. `None` is an answer that could not be read: nothing
    /// happens, and the feedback is that of `world` for it.
    ///
    /// # Errors
    /// When there is no such case or action, or the environment fails or says what is not of `world`.
    pub(super) fn act(
        &mut self,
        cases: &[CaseDeclaration],
        begin: StageBegin,
        actions: impl IntoIterator<Item = Option<ActionCode>>,
        world: &WorldDeclaration,
    ) -> Result<ActedTrajectory, WorldFailure> {
        let first = self.reset(cases, begin)?;
        check(world, &first)?;
        let mut acted =
            ActedTrajectory { sub_goals: vec![0; first.sub_goals as usize], moments: vec![first] };
        for (step, action) in (1..).zip(actions) {
            let before = &acted.moments[acted.moments.len() - 1];
            if is_complete(before) || before.has_failed {
                break;
            }
            let action = world.read_action(action)?;
            let observed = match action {
                Some(action) => self.step(action)?,
                None => {
                    Observed { feedback: world.not_understood(), conflict: false, ..before.clone() }
                }
            };
            check(world, &observed)?;
            let met = observed.sub_goals.saturating_sub(before.sub_goals);
            acted.sub_goals.extend((0..met).map(|_| step));
            acted.moments.push(observed);
        }
        Ok(acted)
    }

    /// The facts of what was acted out last.
    ///
    /// # Errors
    /// When the environment fails.
    pub(super) fn facts(&mut self) -> Result<Map<String, Value>, WorldFailure> {
        self.environment.facts()
    }

    fn step(&mut self, action: ActionCode) -> Result<Observed, WorldFailure> {
        let (begin, mut taken) = self.at.take().ok_or("the environment has not begun")?;
        let observed = self.environment.step(action)?;
        taken.push(action);
        self.at = Some((begin, taken));
        Ok(observed)
    }

    /// Draws what is seen after `actions` from `begin`. Goes on from where it is, if that is on the way.
    ///
    /// # Errors
    /// When there is no such case, or the environment fails.
    pub(super) fn render(
        &mut self,
        cases: &[CaseDeclaration],
        begin: StageBegin,
        actions: &[ActionCode],
        (width, height): (u32, u32),
        pixels: &mut [u8],
    ) -> Result<(), WorldFailure> {
        let on_the_way = self.at.as_ref().and_then(|(from, taken)| {
            (*from == begin && actions.starts_with(taken)).then_some(taken.len())
        });
        let done = match on_the_way {
            Some(done) => done,
            None => {
                self.reset(cases, begin)?;
                0
            }
        };
        for action in &actions[done..] {
            self.step(*action)?;
        }
        self.environment.render(width, height, pixels)
    }
}
