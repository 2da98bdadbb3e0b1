//! Why a request got no reply. None of these errors counts against the model.

use std::time::Duration;

/// Why [`ChatClient::ask`](crate::ChatClient::ask) returned no reply.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AskError {
    /// This request failed; others may succeed.
    #[error(transparent)]
    Failed(RequestError),
    /// No request can succeed now. The text says what happened and what to do.
    #[error("{0}")]
    Stopped(String),
}

/// Why one request failed for good.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// The server refused the request with a status that another attempt would not change.
    #[error("{endpoint} refused the request with status {status}: {message}; {advice}")]
    Refused {
        /// The address.
        endpoint: String,
        /// The HTTP status.
        status: u16,
        /// The server's message.
        message: String,
        /// What to do.
        advice: String,
        /// Whether every other request would meet the same refusal.
        permanent: bool,
    },
    /// No connection to the server can be made, now or later.
    #[error("{endpoint} cannot be reached: {problem}")]
    OutOfReach {
        /// The address.
        endpoint: String,
        /// Why, and what to do.
        problem: String,
    },
    /// The address answers, but not as a chat endpoint does.
    #[error(
        "{endpoint} is no chat endpoint: it answered with {what}; check the base URL, which usually ends in /v1"
    )]
    NotChat {
        /// The address.
        endpoint: String,
        /// What came instead of a reply.
        what: String,
    },
    /// The request cannot be written as JSON.
    #[error("the request cannot be written as JSON: {0}")]
    Unserializable(String),
    /// Every attempt failed for a reason that might have passed.
    #[error("{endpoint} gave no reply (attempts: {attempts}); the last time: {last}")]
    GaveUp {
        /// The address.
        endpoint: String,
        /// Attempts made.
        attempts: u32,
        /// Why the last one failed.
        last: Transient,
    },
}

/// A failure of one attempt that another attempt may not meet.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Transient {
    /// Status 408, 409, 421, 424, 425, 429, 499 or 5xx.
    #[error("status {status}: {message}")]
    Status {
        /// The HTTP status.
        status: u16,
        /// The server's message.
        message: String,
    },
    /// The server asks for a longer pause than ten minutes.
    #[error("status {status}: {message}; it asks for a pause of {} s: start again then", retry_after.as_secs())]
    Busy {
        /// The HTTP status.
        status: u16,
        /// The server's message.
        message: String,
        /// The pause that it asks for.
        retry_after: Duration,
    },
    /// There was no answer before the attempt's deadline.
    #[error("no answer within {:.3} s: the server is slow or hangs; a longer --request-timeout gives it more time", .0.as_secs_f64())]
    Timeout(Duration),
    /// No connection could be opened.
    #[error("there is no connection: {0}; is the server running?")]
    Unreachable(String),
    /// The connection broke.
    #[error("the connection failed: {0}; is the server running?")]
    Connection(String),
    /// The answer cannot be read.
    #[error("the answer cannot be used: {0}")]
    Unreadable(String),
}

/// How one attempt failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum AttemptError {
    /// Another attempt may succeed, after the pause that the server asks for.
    Transient(Transient, Option<Duration>),
    /// No other attempt can.
    Final(RequestError),
}
