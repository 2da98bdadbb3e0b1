//! A conversation with a model, without saying how it is carried.

use serde::{Deserialize, Serialize};

/// Who says something.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Speaker {
    /// The one who sets the rules.
    System,
    /// The one who asks.
    User,
}

/// One message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Message {
    /// Who says it.
    pub role: Speaker,
    /// What is said.
    pub content: String,
}

/// What a model is asked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// The conversation so far.
    pub messages: Vec<Message>,
    /// Most tokens of the answer.
    pub max_tokens: u32,
}

/// How an answer is to be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// As a whole answer.
    Text,
    /// As no answer: there is nothing in it.
    Empty,
    /// As a refusal to answer.
    Refusal,
    /// As the beginning of an answer that was cut off at its bound.
    Length,
}

/// What a model answered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// What it said.
    pub text: String,
    /// How to take it.
    pub outcome: Outcome,
    /// The model, as the server calls it; `None` when it does not.
    pub model: Option<String>,
    /// Tokens of the prompt; `None` when nobody counted.
    pub prompt_tokens: Option<u64>,
    /// Tokens of the answer, likewise.
    pub completion_tokens: Option<u64>,
}

/// Why there is no reply.
#[derive(Debug, thiserror::Error)]
pub enum ChatError {
    /// Whoever carries the conversation does not start.
    #[error("cannot start {program}: {cause}")]
    Start {
        /// The program.
        program: String,
        /// What the system said.
        cause: std::io::Error,
    },
    /// It has ended, and said why on its standard error.
    #[error("{program} has ended ({status}) without an answer; what it said last is above")]
    Ended {
        /// The program.
        program: String,
        /// How it ended.
        status: String,
    },
    /// It answers with something else.
    #[error(
        "{program} answered with a line that cannot be read ({problem}): is it of this version?"
    )]
    Unreadable {
        /// The program.
        program: String,
        /// What is wrong with the line.
        problem: String,
    },
    /// The endpoint gave none. The text says why, and what to do.
    #[error("{0}")]
    NoReply(String),
}

/// Somebody to ask.
pub trait Chat {
    /// Asks, and waits for the answer; calls `waiting` now and then in the meantime.
    ///
    /// # Errors
    /// When there is none.
    fn ask(&mut self, request: &Request, waiting: &mut dyn FnMut()) -> Result<Reply, ChatError>;
}
