//! A client for chat completions of the OpenAI interface. The only crate that uses HTTP.
//!
//! - [`Endpoint`]: the address of a server and the key for it ([`ApiKey`]); [`Servers`]: those of a model, from flags,
//!   environment, `.env` or a suite;
//! - [`ChatRequest`] and [`ChatReply`]: messages of text and images; an answer and the tokens it took;
//! - [`ChatClient`]: sends requests, many at once, with retries, a deadline for each attempt and a cache. What one
//!   request learns about a server holds for all, and several servers of one model share the requests;
//! - [`EndpointLimit`]: a limit on requests in flight that holds for all processes;
//! - [`ReplyCache`]: replies on disk;
//! - [`probe`]: what a server can do.
//!
//! The wording of requests is left to the crates that link this one.

mod api_key;
mod body;
mod cache;
mod client;
mod endpoint;
mod error;
#[doc(hidden)]
pub mod fuzzing;
mod http;
mod pool;
pub mod probe;
mod proxy;
mod refusal;
mod reply;
mod request;
mod server;
mod settings;
mod slots;

pub use api_key::ApiKey;
pub use cache::{CacheListing, CacheSize, ModelReplies, Pruned, ReplyCache};
pub use client::{ChatAnswer, ChatClient};
pub use endpoint::{
    BASE_URL_VARIABLES, ENV_FILE, Endpoint, EndpointError, KEY_VARIABLE, Servers, Source,
};
pub use error::{AskError, RequestError, Transient};
pub use reply::{ChatReply, ReplyContent};
pub use request::{
    CONSTRAINTS, ChatMessage, ChatRequest, ChatRole, ContentPart, ImageUrl, MessageContent,
};
pub use settings::{ChatSettings, RequestOptions, extra_body};
pub use slots::EndpointLimit;
