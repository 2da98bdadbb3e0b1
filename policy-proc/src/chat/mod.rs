//! Asking a model: the project's only HTTP.
//!
//! - [`Endpoint`]: where, and with which key ([`Secret`]);
//! - [`Question`]: messages of text, or of text and images; [`Reply`]: what came back and what it cost;
//! - [`Client`]: asks, with a deadline for each attempt, and again when a failure may pass;
//! - [`pipe`]: the same for other processes, as lines of JSON (`policy-proc ask`).
//!
//! What is not here: what a question says. Whoever asks words it.

mod client;
mod endpoint;
mod message;
pub mod pipe;
mod reply;
mod retry;
#[cfg(any(test, feature = "scripted-server"))]
pub mod scripted;
mod secret;

pub use client::{ChatError, Client, Passing, Settings};
pub use endpoint::{BASE_URL_VARIABLES, ENV_FILE, Endpoint, EndpointError, KEY_VARIABLE};
pub use message::{Content, ImageUrl, Message, Part, Question, Speaker};
pub use reply::{Outcome, Reply};
pub use secret::Secret;
