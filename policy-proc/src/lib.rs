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

pub mod grounded;
#[cfg(feature = "model")]
pub mod openai;
#[cfg(feature = "model")]
pub mod prompt;
pub mod random;
#[cfg(feature = "model")]
pub use llm as chat;

pub use peer::*;
