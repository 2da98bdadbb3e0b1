//! The policy role: what a policy is given, what it answers, and the two traits that it can implement.

mod answers;
#[doc(hidden)]
pub mod fuzzing;
mod join;
mod pinned;
mod prompt_log;
mod request;
mod session;

use std::path::Path;

use shm_types::message::Role;

pub use self::answers::Answers;
pub use self::pinned::{Batch, PinnedStep};
pub use self::request::{
    Answer, CaptionedView, Decision, FrameView, Item, PastView, PlanView, PlannedActions, Request,
    StepView, StepsView, TextView, Usage,
};
use crate::connection::{Connection, Service};
use crate::error::ServeError;
use crate::program_code::own_code;
use crate::run::{Until, folder_from_environment, serve_role};

/// A policy that decides at once.
pub trait Policy {
    /// Its name in the run's manifest.
    fn name(&self) -> &str;

    /// Further facts for the manifest, as names and values.
    fn facts(&self) -> Vec<(&str, String)> {
        Vec::new()
    }

    /// Decides all requests that wait, each of another lane. Returns one decision for each, in the same order. A
    /// decision must not depend on the other requests of the batch.
    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision>;

    /// A new episode begins in `lane`: state of the lane's earlier episode is out of date.
    fn reset(&mut self, lane: u32) {
        let _ = lane;
    }
}

/// A policy that decides later. Every [`Policy`] is one.
pub trait Decider {
    /// As [`Policy::name`].
    fn name(&self) -> &str;

    /// As [`Policy::facts`].
    fn facts(&self) -> Vec<(&str, String)> {
        Vec::new()
    }

    /// Takes requests of different lanes and returns without waiting. Each is answered once through `answers`: now or
    /// later, in any order, from any thread. Until then its lane has no other request.
    ///
    /// # Errors
    /// When the policy cannot go on and serving has to end; with [`ServeError::Interrupted`] the run waits for it.
    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError>;

    /// As [`Policy::reset`]. An open request of the lane is dropped.
    fn reset(&mut self, lane: u32) {
        let _ = lane;
    }

    /// Called a few times a second while there is nothing to do.
    ///
    /// # Errors
    /// When serving has to end, as for [`Self::take`].
    fn idle(&mut self) -> Result<(), ServeError> {
        Ok(())
    }

    /// Called when the policy keeps too many evicted frames, before the run is asked to stop: a policy whose language
    /// collects garbage collects it now.
    fn release_frames(&mut self) {}
}

impl<P: Policy + ?Sized> Decider for P {
    fn name(&self) -> &str {
        Policy::name(self)
    }

    fn facts(&self) -> Vec<(&str, String)> {
        Policy::facts(self)
    }

    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError> {
        let decisions = self.act(batch);
        if decisions.len() != batch.len() {
            return Err(ServeError::Answers {
                policy: Policy::name(self).to_owned(),
                requests: batch.len(),
                answers: decisions.len(),
            });
        }
        for (request, decision) in batch.iter().zip(decisions) {
            answers.decide(request.id(), decision);
        }
        Ok(())
    }

    fn reset(&mut self, lane: u32) {
        Policy::reset(self, lane);
    }
}

/// Serves `policy` in the run that `MEMTRANSFER_ATTACH` names, as [`serve`] does. Its facts have `code`, the hash of the program's
/// file, unless it tells another: a run is not continued with another program.
///
/// # Errors
/// As [`serve`], and when the variable is not set.
pub fn serve_from_environment(policy: &mut (impl Decider + ?Sized)) -> Result<(), ServeError> {
    let folder = folder_from_environment(Role::Policy)?;
    let code = Some(own_code().map_err(ServeError::OwnCode)?);
    serve_role(&mut PolicyService { policy, code }, &folder, Until::RunEnds)
}

/// Serves `policy` in the run whose folder is `folder` until the orchestrator sends a stop message, as
/// [`serve_role`] does. Messages that cannot be used are reported and dropped.
///
/// # Errors
/// As [`serve_role`].
pub fn serve(policy: &mut (impl Decider + ?Sized), folder: &Path) -> Result<(), ServeError> {
    serve_until(policy, folder, Until::RunEnds)
}

/// As [`serve`], but `until` can end it with the generation.
///
/// # Errors
/// As [`serve_role`].
pub fn serve_until(
    policy: &mut (impl Decider + ?Sized),
    folder: &Path,
    until: Until,
) -> Result<(), ServeError> {
    serve_role(&mut PolicyService { policy, code: None }, folder, until)
}

/// The fact that tells a program's code.
const CODE: &str = "code";

/// A policy as a [`Service`].
struct PolicyService<'p, P: ?Sized> {
    policy: &'p mut P,
    /// The hash of the program's file, if the policy reports it.
    code: Option<String>,
}

impl<P: Decider + ?Sized> Service for PolicyService<'_, P> {
    const ROLE: Role = Role::Policy;

    type Session<'s>
        = session::PolicySession<'s, P>
    where
        Self: 's;

    fn facts(&self) -> Vec<(&str, String)> {
        let name = ("policy", self.policy.name().to_owned());
        let mut facts: Vec<_> = std::iter::once(name).chain(self.policy.facts()).collect();
        if let Some(code) = &self.code
            && facts.iter().all(|(fact, _)| *fact != CODE)
        {
            facts.push((CODE, code.clone()));
        }
        facts
    }

    fn start<'s>(&'s mut self, connection: &Connection) -> Result<Self::Session<'s>, ServeError> {
        session::PolicySession::new(self.policy, connection)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Idle;

    impl Policy for Idle {
        fn name(&self) -> &str {
            "idle"
        }

        fn act(&mut self, _: &[Request<'_>]) -> Vec<Decision> {
            Vec::new()
        }
    }

    #[test]
    fn without_a_run_the_error_says_what_to_do() {
        let error = ServeError::NoRun(Role::Policy).to_string();
        assert!(error.starts_with("MEMTRANSFER_ATTACH is not set"), "{error}");
        assert!(error.contains("`memtransfer run --policy-cmd COMMAND`"), "{error}");
        let error = serve(&mut Idle, "/nowhere".as_ref()).unwrap_err().to_string();
        assert_eq!(error, "/nowhere is not the folder of a run, or that run is over");
    }
}
