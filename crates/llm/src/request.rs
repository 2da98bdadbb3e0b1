//! What is sent: messages of text and images, and the body of a request.
//!
//! Temperature is 0 and reasoning is off in every request (specification, section 5). Servers differ in how reasoning
//! is turned off and in how an answer is constrained to a list of choices, so a request carries every known way. Most
//! servers ignore fields they do not know; one that refuses a field is asked without it ([`Dialect`]).

use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD as BASE64;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use serde_json::{Value, json};

/// The author of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ChatRole {
    /// The rules of the conversation.
    System,
    /// The questions.
    User,
    /// The model's earlier answers.
    Assistant,
}

/// One message of a conversation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ChatMessage {
    /// Its author.
    pub role: ChatRole,
    /// Its content.
    pub content: MessageContent,
}

impl ChatMessage {
    /// A message of plain text.
    pub fn text(role: ChatRole, text: impl Into<String>) -> Self {
        Self { role, content: MessageContent::Text(text.into()) }
    }

    fn parts(&self) -> &[ContentPart] {
        match &self.content {
            MessageContent::Text(_) => &[],
            MessageContent::Parts(parts) => parts,
        }
    }
}

/// Plain text, or parts in reading order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum MessageContent {
    /// Plain text.
    Text(String),
    /// Text and images.
    Parts(Vec<ContentPart>),
}

/// A part of a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ContentPart {
    /// Text.
    Text {
        /// The text.
        text: String,
    },
    /// An image.
    ImageUrl {
        /// Its address.
        image_url: ImageUrl,
    },
}

/// The URL of an image: a data URL (`data:image/png;base64,...`), or an address that the server can fetch.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ImageUrl {
    /// The URL. Requests with the same image share it.
    #[serde(serialize_with = "as_str")]
    pub url: Arc<str>,
}

impl ImageUrl {
    /// A data URL of `bytes`.
    pub fn of_bytes(media_type: &str, bytes: &[u8]) -> Self {
        Self { url: format!("data:{media_type};base64,{}", BASE64.encode(bytes)).into() }
    }
}

fn as_str<S: Serializer>(text: &Arc<str>, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(text)
}

/// A request to a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChatRequest {
    /// The conversation so far.
    pub messages: Vec<ChatMessage>,
    /// Maximum number of tokens of the answer.
    pub max_tokens: u32,
    /// The only answers allowed, where the server can enforce that; empty for free text.
    pub choices: Vec<String>,
}

impl ChatRequest {
    /// A request of one user message in plain text.
    pub fn text(text: impl Into<String>, max_tokens: u32) -> Self {
        let messages = vec![ChatMessage::text(ChatRole::User, text)];
        Self { messages, max_tokens, choices: Vec::new() }
    }

    /// Number of images.
    pub fn images(&self) -> usize {
        let parts = self.messages.iter().flat_map(ChatMessage::parts);
        parts.filter(|part| matches!(part, ContentPart::ImageUrl { .. })).count()
    }

    /// Whether every image is a data URL, so that the request alone decides the reply.
    pub(crate) fn is_self_contained(&self) -> bool {
        self.messages.iter().flat_map(ChatMessage::parts).all(|part| match part {
            ContentPart::Text { .. } => true,
            ContentPart::ImageUrl { image_url } => image_url.url.starts_with("data:"),
        })
    }
}

/// The optional fields that a server has refused, as bits: bit i is field i of [`optional_fields`], the highest bit is
/// set when the server wants the bound on the answer under its newer name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Dialect(pub(crate) u32);

/// The constraint of the OpenAI interface. Sent only to servers that refuse the two of vLLM and llama.cpp, since a
/// request with two constraints is refused.
const RESPONSE_FORMAT: &str = "response_format";

/// Constraints of single servers: vLLM's, and the grammar of llama.cpp.
const SERVER_CONSTRAINTS: [&str; 2] = ["structured_outputs", "grammar"];

/// The fields that restrict an answer to a list of choices: those of vLLM and llama.cpp, and that of the OpenAI interface.
pub const CONSTRAINTS: [&str; 3] = [SERVER_CONSTRAINTS[0], SERVER_CONSTRAINTS[1], RESPONSE_FORMAT];

/// Fields that a server may refuse, in the order of [`Dialect`]'s bits.
fn optional_fields(choices: &[String]) -> Vec<(&'static str, Value)> {
    let mut fields = vec![
        // OpenAI, Ollama, OpenRouter, Gemini.
        ("reasoning_effort", json!("none")),
        // vLLM, SGLang, llama.cpp: passed to the model's chat template.
        ("chat_template_kwargs", json!({"enable_thinking": false, "thinking": false})),
        // LMDeploy, DashScope.
        ("enable_thinking", json!(false)),
        // InternLM's servers.
        ("thinking_mode", json!(false)),
        // DeepSeek, GLM.
        ("thinking", json!({"type": "disabled"})),
    ];
    if !choices.is_empty() {
        let alternatives: Vec<String> =
            choices.iter().map(|choice| Value::from(choice.as_str()).to_string()).collect();
        let schema = json!({
            "type": "object",
            "properties": {"action": {"type": "string", "enum": choices}},
            "required": ["action"],
            "additionalProperties": false,
        });
        fields.extend([
            (SERVER_CONSTRAINTS[0], json!({"choice": choices})),
            (SERVER_CONSTRAINTS[1], json!(format!("root ::= {}", alternatives.join(" | ")))),
            (
                RESPONSE_FORMAT,
                json!({"type": "json_schema", "json_schema": {"name": "answer", "strict": true, "schema": schema}}),
            ),
        ]);
    }
    fields
}

/// The bit of servers that want the bound on the answer under its newer name.
const NEWER_BOUND: u32 = 1 << 31;

const BOUND: &str = "max_tokens";
const NEWER_BOUND_NAME: &str = "max_completion_tokens";

/// The body of a request. It borrows the messages, so image data is copied once, into the bytes that are sent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body<'a> {
    dialect: Dialect,
    model: &'a str,
    request: &'a ChatRequest,
}

impl Serialize for Body<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let Self { dialect, model, request: ChatRequest { messages, max_tokens, choices } } = self;
        let mut body = to.serialize_map(None)?;
        body.serialize_entry("model", model)?;
        body.serialize_entry("temperature", &0.0)?;
        body.serialize_entry("stream", &false)?;
        let bound = if dialect.0 & NEWER_BOUND == 0 { BOUND } else { NEWER_BOUND_NAME };
        body.serialize_entry(bound, max_tokens)?;
        for (field, value) in dialect.fields(choices) {
            body.serialize_entry(field, &value)?;
        }
        body.serialize_entry("messages", messages)?;
        body.end()
    }
}

impl Dialect {
    /// The body of `request` to `model`.
    pub(crate) const fn body<'a>(self, model: &'a str, request: &'a ChatRequest) -> Body<'a> {
        Body { dialect: self, model, request }
    }

    /// The optional fields that are sent.
    fn fields(self, choices: &[String]) -> Vec<(&'static str, Value)> {
        let refused = |bit: usize| self.0 & (1 << bit) != 0;
        let all = optional_fields(choices).into_iter().enumerate();
        let mut fields: Vec<_> = all.filter(|(bit, _)| !refused(*bit)).map(|(_, f)| f).collect();
        if fields.iter().any(|(field, _)| SERVER_CONSTRAINTS.contains(field)) {
            fields.retain(|(field, _)| *field != RESPONSE_FORMAT);
        }
        fields
    }

    /// The optional fields that the server has refused.
    pub(crate) fn refused(self) -> Vec<&'static str> {
        let all = optional_fields(&["any".to_owned()]).into_iter().enumerate();
        all.filter(|(bit, _)| self.0 & (1 << bit) != 0).map(|(_, (field, _))| field).collect()
    }

    /// The dialect without the fields that a refusal of `request` names, and those fields; `None` when `message` names
    /// none of them.
    pub(crate) fn after(
        self,
        request: &ChatRequest,
        message: &str,
    ) -> Option<(Self, Vec<&'static str>)> {
        let named = |field: &str| {
            let mut words = message.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            words.any(|word| word == field)
        };
        let sent = self.fields(&request.choices);
        let mut next = self;
        let mut changed = Vec::new();
        for (bit, (field, _)) in optional_fields(&request.choices).into_iter().enumerate() {
            if sent.iter().any(|(sent, _)| *sent == field) && named(field) {
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

    fn request(choices: &[&str]) -> ChatRequest {
        let image = ContentPart::ImageUrl {
            image_url: ImageUrl { url: "data:image/png;base64,AA==".into() },
        };
        let parts = vec![ContentPart::Text { text: "What is this?".into() }, image];
        ChatRequest {
            messages: vec![
                ChatMessage::text(ChatRole::System, "Be brief."),
                ChatMessage { role: ChatRole::User, content: MessageContent::Parts(parts) },
            ],
            max_tokens: 30,
            choices: choices.iter().map(|&choice| choice.to_owned()).collect(),
        }
    }

    fn body(dialect: Dialect, choices: &[&str]) -> Value {
        serde_json::to_value(dialect.body("m", &request(choices))).unwrap()
    }

    #[test]
    fn whole_body_of_a_free_request() {
        insta::assert_snapshot!(body(Dialect::default(), &[]), @r#"{"chat_template_kwargs":{"enable_thinking":false,"thinking":false},"enable_thinking":false,"max_tokens":30,"messages":[{"content":"Be brief.","role":"system"},{"content":[{"text":"What is this?","type":"text"},{"image_url":{"url":"data:image/png;base64,AA=="},"type":"image_url"}],"role":"user"}],"model":"m","reasoning_effort":"none","stream":false,"temperature":0.0,"thinking":{"type":"disabled"},"thinking_mode":false}"#);
        assert_eq!(request(&[]).images(), 1);
    }

    #[test]
    fn a_constraint_falls_back_to_the_interface_own_and_then_to_none() {
        let choices = ["go", "stop"];
        let first = body(Dialect::default(), &choices);
        assert_eq!(first["structured_outputs"], json!({"choice": ["go", "stop"]}));
        assert_eq!(first["grammar"], json!(r#"root ::= "go" | "stop""#));
        assert!(first.get("response_format").is_none());

        let request = request(&choices);
        let unknown = "Unrecognized request arguments supplied: grammar, structured_outputs";
        let (second, _) = Dialect::default().after(&request, unknown).unwrap();
        let schema = body(second, &choices);
        assert!(schema.get("grammar").is_none() && schema.get("structured_outputs").is_none());
        assert_eq!(
            schema.pointer("/response_format/json_schema/schema/properties/action/enum"),
            Some(&json!(["go", "stop"]))
        );

        let (third, _) = second.after(&request, "response_format is not supported").unwrap();
        assert!(body(third, &choices).get("response_format").is_none());
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
            let request = request(&[]);
            let (next, fields) = all.after(&request, message).unwrap();
            assert_eq!(fields, changed);
            let body = body(next, &[]);
            assert!(changed.iter().all(|field| body.get(field).is_none()), "{body}");
            assert_eq!(next.after(&request, message), None, "a field is left out once");
        }
        let length = "This model's maximum context length is 8192 tokens";
        assert_eq!(all.after(&request(&["go"]), length), None);
        let request = request(&[]);
        let (newer, _) = all.after(&request, "use max_completion_tokens").unwrap();
        assert_eq!(body(newer, &[])["max_completion_tokens"], 30);
    }
}
