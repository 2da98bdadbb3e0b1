//! The policy SDK: the trait a policy implements, and the loop that puts it on the wire.
//!
//! A policy of one's own is a type with [`Policy`] and a `main` that calls [`serve_from_environment`].
//! Reading messages, joining what belongs together, holding frames, checking what came and
//! saying what could not be used is all done here.
//!
//! ```no_run
//! use peer::{Decision, Policy, Request, serve_from_environment};
//! use shm_types::Action;
//!
//! struct AlwaysForward;
//!
//! impl Policy for AlwaysForward {
//!     fn name(&self) -> &str {
//!         "always-forward"
//!     }
//!
//!     fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
//!         batch.iter().map(|request| Decision::act(request, Action::Forward)).collect()
//!     }
//! }
//!
//! serve_from_environment(&mut AlwaysForward)?;
//! # Ok::<(), peer::ServeError>(())
//! ```
//!
//! A policy that has to wait for its decisions, and should not make others wait meanwhile, is a
//! [`Decider`] instead: it takes requests, and gives its [`Answers`] whenever it has them.

mod answers;
mod attend;
mod join;
mod prompt_log;
pub mod request;
mod serve;
mod shown;

pub use answers::Answers;
pub use attend::{ServeError, serve, serve_from_environment};

pub use request::{
    Answer, Decision, DocumentView, FrameView, PastView, Request, RequestId, Segment, SegmentView,
    Trajectory, TrajectoryView, Usage,
};
// The words that requests and decisions are made of: a policy needs no other crate.
pub use domain::{Action, Cell, DocumentKind, Feedback, Heading, Pose};
pub use shm_types::message::{DocumentId, FrameId};

/// Something that decides at once. The built-in policies without a model are written against this and
/// nothing else.
pub trait Policy {
    /// What the run's manifest calls it.
    fn name(&self) -> &str;

    /// What else the manifest says about it, as names and values.
    fn facts(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// One decision for each request, in the same order. The requests are of different lanes: all that
    /// wait for an answer at this moment. A decision may not depend on what else is in the batch.
    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision>;

    /// A new episode begins in `lane`: forget whatever was kept for it.
    fn reset(&mut self, lane: u32) {
        let _ = lane;
    }
}

/// Something that decides in its own time. Every [`Policy`] is one.
pub trait Decider {
    /// As [`Policy::name`].
    fn name(&self) -> &str;

    /// As [`Policy::facts`].
    fn facts(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// Takes requests of different lanes, and returns without waiting. Each is answered once, now or later and
    /// in any order, through `answers`; a lane has no further request until it is.
    ///
    /// # Errors
    /// When the policy is broken and serving has to end.
    fn take(&mut self, batch: &[Request<'_>], answers: &Answers) -> Result<(), ServeError>;

    /// As [`Policy::reset`]. A request of the lane that was not answered yet is over.
    fn reset(&mut self, lane: u32) {
        let _ = lane;
    }
}

impl<P: Policy + ?Sized> Decider for P {
    fn name(&self) -> &str {
        Policy::name(self)
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        Policy::facts(self)
    }

    fn take(&mut self, batch: &[Request<'_>], answers: &Answers) -> Result<(), ServeError> {
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
