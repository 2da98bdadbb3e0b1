//! What is sent: messages of text or of parts, and the body of a request.
//!
//! Temperature is 0 and reasoning is off in every request (SPEC section 5). There is no common way to turn
//! reasoning off, so a request carries each of the ways that servers understand; most servers pass over a
//! field that they do not know, and one that refuses it is asked without it ([`Dialect`]).

use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD as BASE64;
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};

/// Who says something.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Speaker {
    /// The one who sets the rules.
    System,
    /// The one who asks.
    User,
    /// The model, earlier.
    Assistant,
}

/// One message of a conversation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Message {
    /// Who says it.
    pub role: Speaker,
    /// What is said.
    pub content: Content,
}

impl Message {
    /// A message of plain text.
    pub fn text(role: Speaker, text: impl Into<String>) -> Self {
        Self { role, content: Content::Text(text.into()) }
    }
}

/// Plain text, or parts in the order in which the model reads them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Content {
    /// Plain text.
    Text(String),
    /// Text and images.
    Parts(Vec<Part>),
}

/// A piece of a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Part {
    /// Text.
    Text {
        /// It.
        text: String,
    },
    /// An image.
    ImageUrl {
        /// Where it is.
        image_url: ImageUrl,
    },
}

/// Where an image is: in the URL itself (`data:image/png;base64,...`), or somewhere that the server can reach.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageUrl {
    /// The URL. Questions that show the same image share it.
    #[serde(with = "shared_text")]
    pub url: Arc<str>,
}

impl ImageUrl {
    /// An image that stands in the URL itself.
    pub fn of_bytes(media_type: &str, bytes: &[u8]) -> Self {
        Self { url: format!("data:{media_type};base64,{}", BASE64.encode(bytes)).into() }
    }
}

mod shared_text {
    use std::sync::Arc;

    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(text: &str, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(text)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Arc<str>, D::Error> {
        String::deserialize(from).map(Arc::from)
    }
}

/// A question to a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// The conversation so far.
    pub messages: Vec<Message>,
    /// Most tokens of the answer.
    pub max_tokens: u32,
}

/// How a server wants to be spoken to, as far as its refusals have told: bit i is set when it does not take
/// field i of [`reasoning_off`], the highest bit when it wants the bound on the answer under its newer name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Dialect(pub(super) u32);

/// Fields that turn reasoning off, and who reads them.
fn reasoning_off() -> [(&'static str, Value); 5] {
    [
        // OpenAI, Ollama, OpenRouter, Gemini.
        ("reasoning_effort", json!("none")),
        // vLLM, SGLang, llama.cpp: handed to the model's own template.
        ("chat_template_kwargs", json!({"enable_thinking": false, "thinking": false})),
        // LMDeploy, DashScope.
        ("enable_thinking", json!(false)),
        // The servers of Intern's makers.
        ("thinking_mode", json!(false)),
        // DeepSeek, GLM.
        ("thinking", json!({"type": "disabled"})),
    ]
}

/// The bit for servers that want the bound on the answer under its newer name.
const NEWER_BOUND: u32 = 1 << 31;

const BOUND: &str = "max_tokens";
const NEWER_BOUND_NAME: &str = "max_completion_tokens";

/// The body of a request, which borrows what it says: images are copied once, into the bytes that are sent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Body<'a> {
    dialect: Dialect,
    model: &'a str,
    question: &'a Question,
}

impl Serialize for Body<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let Self { dialect: Dialect(dialect), model, question: Question { messages, max_tokens } } =
            self;
        let mut body = to.serialize_map(None)?;
        body.serialize_entry("model", model)?;
        body.serialize_entry("temperature", &0.0)?;
        body.serialize_entry("stream", &false)?;
        let bound = if dialect & NEWER_BOUND == 0 { BOUND } else { NEWER_BOUND_NAME };
        body.serialize_entry(bound, max_tokens)?;
        for (bit, (field, off)) in reasoning_off().into_iter().enumerate() {
            if dialect & (1 << bit) == 0 {
                body.serialize_entry(field, &off)?;
            }
        }
        body.serialize_entry("messages", messages)?;
        body.end()
    }
}

impl Dialect {
    /// The body of a request.
    pub(super) const fn body<'a>(self, model: &'a str, question: &'a Question) -> Body<'a> {
        Body { dialect: self, model, question }
    }

    /// What a server understands that refused a request of this dialect with `message`; `None` when the
    /// message names nothing that can be said in another way.
    pub(super) fn after(self, message: &str) -> Option<(Self, Vec<&'static str>)> {
        let named = |field: &str| {
            let mut words = message.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            words.any(|word| word == field)
        };
        let mut next = self;
        let mut changed = Vec::new();
        for (bit, (field, _)) in reasoning_off().into_iter().enumerate() {
            if self.0 & (1 << bit) == 0 && named(field) {
                next.0 |= 1 << bit;
                changed.push(field);
            }
        }
        if self.0 & NEWER_BOUND == 0 && named(NEWER_BOUND_NAME) {
            next.0 |= NEWER_BOUND;
            changed.push(BOUND);
        }
        (next != self).then_some((next, changed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(dialect: Dialect) -> Value {
        serde_json::to_value(dialect.body("m", &question())).unwrap()
    }

    fn question() -> Question {
        let image =
            Part::ImageUrl { image_url: ImageUrl { url: "data:image/png;base64,AA==".into() } };
        let parts = vec![Part::Text { text: "What is this?".into() }, image];
        Question {
            messages: vec![
                Message::text(Speaker::System, "Be brief."),
                Message { role: Speaker::User, content: Content::Parts(parts) },
            ],
            max_tokens: 30,
        }
    }

    #[test]
    fn a_request_in_full() {
        insta::assert_snapshot!(format!("{:#}", body(Dialect::default())), @r#"
        {
          "chat_template_kwargs": {
            "enable_thinking": false,
            "thinking": false
          },
          "enable_thinking": false,
          "max_tokens": 30,
          "messages": [
            {
              "content": "Be brief.",
              "role": "system"
            },
            {
              "content": [
                {
                  "text": "What is this?",
                  "type": "text"
                },
                {
                  "image_url": {
                    "url": "data:image/png;base64,AA=="
                  },
                  "type": "image_url"
                }
              ],
              "role": "user"
            }
          ],
          "model": "m",
          "reasoning_effort": "none",
          "stream": false,
          "temperature": 0.0,
          "thinking": {
            "type": "disabled"
          },
          "thinking_mode": false
        }
        "#);
    }

    #[test]
    fn questions_are_read_as_they_are_written() {
        let written = serde_json::to_string(&question()).unwrap();
        assert_eq!(serde_json::from_str::<Question>(&written).unwrap(), question());
    }

    #[test]
    fn a_refused_field_is_left_out() {
        let all = Dialect::default();
        for (message, changed) in [
            (
                "Unrecognized request arguments supplied: chat_template_kwargs, thinking_mode",
                &["chat_template_kwargs", "thinking_mode"][..],
            ),
            ("Unknown name \"enable_thinking\": Cannot find field.", &["enable_thinking"]),
            (
                "Unsupported parameter: 'max_tokens'. Use 'max_completion_tokens' instead.",
                &["max_tokens"],
            ),
        ] {
            let (next, fields) = all.after(message).unwrap();
            assert_eq!(fields, changed);
            let body = body(next);
            assert!(changed.iter().all(|field| body.get(field).is_none()), "{body}");
            assert_eq!(next.after(message), None, "nothing is left out twice");
        }
        assert_eq!(all.after("This model's maximum context length is 8192 tokens"), None);
        let (newer, _) = all.after("use max_completion_tokens").unwrap();
        assert_eq!(body(newer)["max_completion_tokens"], 30);
    }
}
