//! The policy: turns an observation, a window and a recall into an action (DESIGN section 5).
//!
//! - [`request`]: what a policy is given, and what it answers. Nothing else reaches it.
//! - [`sdk`]: the traits [`Policy`] and [`Decider`], and [`serve`], which puts an implementation on the wire.
//! - `chat`: asking a model behind an OpenAI-compatible endpoint.
//! - `prompt`: what a model is told about a request, and how its answer is read.
//! - `openai`: the policy that asks a model.
//! - [`random`] and [`grounded`]: two policies that use nothing but the SDK.
//!
//! `chat`, `prompt`, `openai` and the program are behind the feature `model`, which is on unless somebody says
//! `default-features = false`.
//!
//! What is not here: the map. This crate does not link the one that knows it, so a policy can only
//! have seen what its requests showed.

#[cfg(feature = "model")]
pub mod chat;
pub mod grounded;
#[cfg(feature = "model")]
pub mod openai;
#[cfg(feature = "model")]
pub mod prompt;
pub mod random;
pub mod request;
pub mod sdk;

pub use request::{
    Answer, Decision, DocumentView, FrameView, PastView, Request, Segment, SegmentView, Ticket,
    Trajectory, TrajectoryView, Usage,
};
pub use sdk::{Answers, Decider, Policy, ServeError, serve, serve_from_environment};
// The words that requests and decisions are made of: a policy needs no other crate.
pub use shm_types::message::DocumentKind;
pub use shm_types::{Action, Cell, Feedback, Heading, Pose};
