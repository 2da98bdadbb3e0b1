//! The policy SDK: the trait a policy implements, and the loop that puts it on the wire.
//!
//! A policy of one's own is a type with [`Policy`] and a `main` that calls [`serve`] with the folder of
//! the run. Reading messages, joining what belongs together, holding frames, checking what came and
//! saying what could not be used is all done here.
//!
//! ```no_run
//! use policy_proc::{Decision, Policy, Request, serve};
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
//! let run_folder = std::env::args_os().nth(1).expect("the run's folder");
//! serve(&mut AlwaysForward, run_folder.as_ref())?;
//! # Ok::<(), policy_proc::ServeError>(())
//! ```

mod join;
mod serve;
mod shown;

pub use serve::{ServeError, serve};

use crate::{Decision, Request};

/// Something that decides. The built-in policies are written against this and nothing else.
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
