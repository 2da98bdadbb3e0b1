//! Asking a model: the project's only HTTP.
//!
//! - [`Endpoint`]: where, and with which key ([`Secret`]);
//! - [`Question`]: messages of text, or of text and images; [`Reply`]: what came back and what it cost;
//! - [`Client`]: asks, with a deadline for each attempt, and again when a failure may pass;
//! - [`Pool`]: the same for many questions at once, which share what is learnt about the server;
//! - [`ResponseCache`]: replies on disk;
//! - [`probe`]: what a server can do, and [`fingerprint`]: who it is;
//! - [`pipe`]: the same for other processes, as lines of JSON (`policy-proc ask`).
//!
//! What is not here: what a question says. Whoever asks words it.

mod cache;
mod client;
mod endpoint;
mod error;
pub mod fingerprint;
mod message;
pub mod pipe;
mod pool;
pub mod probe;
mod reply;
mod retry;
#[cfg(any(test, feature = "scripted-server"))]
pub mod scripted;
mod secret;

pub use cache::{Amount, Held, Listing, Pruned, ResponseCache};
pub use client::{Client, Settings};
pub use endpoint::{BASE_URL_VARIABLES, ENV_FILE, Endpoint, EndpointError, KEY_VARIABLE};
pub use error::{ChatError, Passing};
pub use fingerprint::Fingerprint;
pub use message::{Content, ImageUrl, Message, Part, Question, Speaker};
pub use pool::{Asked, Job, Pool, PoolError, PoolSettings};
pub use reply::{Outcome, Reply};
pub use secret::Secret;
