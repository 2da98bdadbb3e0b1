//! The SDK for the replaceable processes of a run: a policy or a memory of one's own.
//!
//! A policy is a type that implements [`Policy`] and a `main` that calls [`serve_from_environment`]. The SDK joins the
//! run, receives messages, joins those that belong together, pins frames, checks values and reports errors.
//!
//! ```no_run
//! use peer::{Action, Decision, Policy, Request, serve_from_environment};
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
//! A policy that waits for its decisions, for example for a model server, implements [`Decider`] instead: it takes
//! requests and answers them later, from any thread.
//!
//! [`run`] and [`connection`] know no role: they attach, join each generation of a run, and serve a [`Service`]. The
//! roles are the modules [`policy`] and [`memory`].

pub mod connection;
mod error;
pub mod memory;
pub mod policy;
mod program_code;
pub mod run;
mod watched_run;
pub mod world;

pub use connection::{Connection, Service, Session};
pub use error::ServeError;
pub use policy::{
    Answer, Answers, Batch, CaptionedView, Decider, Decision, FrameView, Item, PastView,
    PinnedStep, PlanView, PlannedActions, Policy, Request, StepView, StepsView, TextView, Usage,
    serve, serve_from_environment, serve_until,
};
pub use run::Until;
// The vocabulary of requests and decisions, so that a policy needs no other crate.
pub use case_book::{ActionDeclaration, StateField, WorldDeclaration};
pub use domain::{
    Action, ActionCode, Cell, DocumentKind, Feedback, FeedbackCode, Heading, Mismatch, Pose, State,
};
pub use shm_types::message::{FrameId, RequestId};
