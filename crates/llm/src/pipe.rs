//! Questions and answers as lines of JSON, one answer for each question, in order.
//!
//! This is how another process of the project asks a model without HTTP of its own.

use std::io::{self, BufRead, Write};

use serde::{Deserialize, Serialize};

use super::cache::{Key, ResponseCache};
use super::client::Client;
use super::error::ChatError;
use super::message::Question;
use super::reply::{Outcome, Reply};

/// The line that answers a question.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Answer {
    /// The model replied.
    Replied {
        /// What it said: the answer, or for a refusal what was said about it.
        text: String,
        /// How to take the text.
        outcome: Kind,
        /// The model's name as the server reports it.
        model: Option<String>,
        /// Tokens of the prompt; `null` when the server did not count.
        prompt_tokens: Option<u64>,
        /// Tokens of the answer, likewise.
        completion_tokens: Option<u64>,
        /// Whether the reply was known: what it cost was counted when it was new.
        from_cache: bool,
    },
    /// There is no reply.
    Failed {
        /// Why, and what to do.
        error: String,
    },
}

/// [`Outcome`] without its text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A whole answer.
    Text,
    /// Nothing, or blanks.
    Empty,
    /// The model or the server's filter refused.
    Refusal,
    /// Cut off at the bound on its tokens.
    Length,
}

impl Answer {
    fn of(reply: Reply, from_cache: bool) -> Self {
        let Reply { outcome, model, prompt_tokens, completion_tokens, .. } = reply;
        let (outcome, text) = match outcome {
            Outcome::Text(text) => (Kind::Text, text),
            Outcome::Empty => (Kind::Empty, String::new()),
            Outcome::Refusal(text) => (Kind::Refusal, text),
            Outcome::Length(text) => (Kind::Length, text),
        };
        Self::Replied { text, outcome, model, prompt_tokens, completion_tokens, from_cache }
    }
}

/// Answers every line of `input` with a line on `output`, which is complete before the next line is read;
/// a blank line is passed over. Replies are looked for in `cache` first, and kept there. The number of questions
/// that got no reply.
///
/// # Errors
/// When a line cannot be read or written.
pub fn run(
    client: &Client,
    cache: Option<&ResponseCache>,
    input: impl BufRead,
    mut output: impl Write,
) -> io::Result<u64> {
    let mut failed = 0;
    for line in input.lines() {
        let line = line?;
        if line.trim().is_empty() {
            continue;
        }
        let answer = match serde_json::from_str::<Question>(&line) {
            Err(error) => Answer::Failed {
                error: format!(
                    "this line is no question ({error}): write {{\"messages\": [{{\"role\": \"user\", \
                     \"content\": \"...\"}}], \"max_tokens\": 30}}"
                ),
            },
            Ok(question) => match ask(client, cache, &question) {
                Ok((reply, from_cache)) => Answer::of(reply, from_cache),
                Err(error) => Answer::Failed { error: error.to_string() },
            },
        };
        failed += u64::from(matches!(answer, Answer::Failed { .. }));
        serde_json::to_writer(&mut output, &answer)?;
        output.write_all(b"\n")?;
        output.flush()?;
    }
    Ok(failed)
}

/// The reply to a question, and whether it was known.
fn ask(
    client: &Client,
    cache: Option<&ResponseCache>,
    question: &Question,
) -> Result<(Reply, bool), ChatError> {
    let model = &client.settings().model;
    let place = cache.and_then(|cache| Some((cache, Key::of(model, question, 0)?)));
    if let Some(reply) = place.as_ref().and_then(|(cache, key)| cache.get(key)) {
        return Ok((reply, true));
    }
    let reply = client.ask(question)?;
    if let Some((cache, key)) = place
        && let Err(error) = cache.put(&key, model, &reply)
    {
        tracing::warn!("the reply cannot be kept in {}: {error}", cache.folder().display());
    }
    Ok((reply, false))
}
