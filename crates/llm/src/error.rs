//! Why there is no reply: failures that may pass, and those that will not.

use std::time::Duration;

/// Why there is no reply. None of these is the model's doing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChatError {
    /// The server does not take this request, and will not later.
    #[error("{endpoint} refused the request with status {status}: {message}; {advice}")]
    Refused {
        /// Who.
        endpoint: String,
        /// The HTTP status.
        status: u16,
        /// What the server says.
        message: String,
        /// What to do.
        advice: &'static str,
    },
    /// What answers there is no chat endpoint.
    #[error(
        "{endpoint} is no chat endpoint: it answered with {what}; check the base URL, which usually ends in /v1"
    )]
    NotChat {
        /// Who.
        endpoint: String,
        /// What came instead.
        what: String,
    },
    /// The question has no form in which it could be sent.
    #[error("the question cannot be written as JSON: {0}")]
    Unsaid(String),
    /// It failed every time, for reasons that might have passed.
    #[error("{endpoint} gave no reply (attempts: {attempts}); the last time: {last}")]
    GaveUp {
        /// Who.
        endpoint: String,
        /// How many times it was asked.
        attempts: u32,
        /// What was wrong the last time.
        last: Passing,
    },
}

/// A failure that may be over when the same is asked again.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Passing {
    /// A status that says so.
    #[error("status {status}: {message}")]
    Status {
        /// The HTTP status.
        status: u16,
        /// What the server says.
        message: String,
    },
    /// The server is busy for longer than anybody waits.
    #[error("status {status}: {message}; it wants to be left alone for {} s: start again then", wish.as_secs())]
    Busy {
        /// The HTTP status.
        status: u16,
        /// What the server says.
        message: String,
        /// How long.
        wish: Duration,
    },
    /// The answer was not there in time.
    #[error("no answer within {} s; is the server running, and is --timeout long enough for it?", .0.as_secs_f64())]
    Timeout(Duration),
    /// There was no connection at all.
    #[error("there is no connection: {0}; is the server running?")]
    Unreachable(String),
    /// The connection broke.
    #[error("the connection failed: {0}; is the server running?")]
    Connection(String),
    /// An answer came that cannot be read.
    #[error("the answer cannot be used: {0}")]
    Unreadable(String),
}

/// What one attempt came to, when not to a reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Failure {
    /// Asked again, the same may do better; not before the server's wish, where it has one.
    Passing(Passing, Option<Duration>),
    /// It will not.
    Final(ChatError),
}
