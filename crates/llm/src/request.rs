//! What is sent: messages of text and images, and the body of a request.
//!
//! Temperature is 0, and reasoning is off unless the settings say otherwise (specification, section 5). Servers differ in
//! how reasoning is turned off and in how an answer is constrained to a list of choices, so a request carries every known
//! way. Most servers ignore fields they do not know; one that refuses a field is asked without it ([`Dialect`]).

use std::borrow::Cow;
use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD as BASE64;
use domain::{ReasoningRequest, SystemRole};
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use crate::refusal::Refusal;
use crate::settings::{ChatSettings, RequestOptions};

/// The author of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ChatRole {
    /// The rules of the conversation.
    System,
    /// The rules too, in the role that newer models of OpenAI have for them.
    Developer,
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

/// The optional fields that a server has refused, as bits: bit i is field i of [`FIELDS`], and the two highest bits are
/// [`NO_TEMPERATURE`] and [`NEWER_BOUND`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Dialect(pub(crate) u32);

/// The constraint of the OpenAI interface. Sent only to servers that refuse the two of vLLM and llama.cpp, since a
/// request with two constraints is refused.
const RESPONSE_FORMAT: &str = "response_format";

/// Constraints of single servers: vLLM's, and the grammar of llama.cpp.
const SERVER_CONSTRAINTS: [&str; 2] = ["structured_outputs", "grammar"];

/// The fields that restrict an answer to a list of choices: those of vLLM and llama.cpp, and that of the OpenAI interface.
pub const CONSTRAINTS: [&str; 3] = [SERVER_CONSTRAINTS[0], SERVER_CONSTRAINTS[1], RESPONSE_FORMAT];

/// The field that newer servers have for the amount of reasoning.
const REASONING_EFFORT: &str = "reasoning_effort";

/// Fields that a server may refuse, in the order of [`Dialect`]'s bits.
const FIELDS: [&str; 8] = [
    REASONING_EFFORT,
    "chat_template_kwargs",
    "enable_thinking",
    "thinking_mode",
    "thinking",
    CONSTRAINTS[0],
    CONSTRAINTS[1],
    CONSTRAINTS[2],
];

/// The bit of a field.
fn bit(field: &str) -> u32 {
    FIELDS.iter().position(|known| *known == field).map_or(0, |index| 1 << index)
}

/// The optional fields of a request.
fn optional_fields(reasoning: ReasoningRequest, choices: &[String]) -> Vec<(&'static str, Value)> {
    let mut fields = match reasoning {
        ReasoningRequest::Model => Vec::new(),
        ReasoningRequest::Off => vec![
            // OpenAI, Ollama, OpenRouter, Gemini.
            (REASONING_EFFORT, json!("none")),
            // vLLM, SGLang, llama.cpp: passed to the model's chat template.
            ("chat_template_kwargs", json!({"enable_thinking": false, "thinking": false})),
            // LMDeploy, DashScope.
            ("enable_thinking", json!(false)),
            // InternLM's servers.
            ("thinking_mode", json!(false)),
            // DeepSeek, GLM.
            ("thinking", json!({"type": "disabled"})),
        ],
        effort => vec![(REASONING_EFFORT, json!(effort.name()))],
    };
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

const TEMPERATURE: &str = "temperature";
const BOUND: &str = "max_tokens";
const NEWER_BOUND_NAME: &str = "max_completion_tokens";

/// The bit of servers that want the bound on the answer under its newer name.
const NEWER_BOUND: u32 = 1 << 31;

/// The bit of servers that refuse temperature 0.
const NO_TEMPERATURE: u32 = 1 << 30;

/// The body of a request. It borrows the messages, so image data is copied once, into the bytes that are sent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body<'a> {
    dialect: Dialect,
    settings: &'a ChatSettings,
    request: &'a ChatRequest,
}

impl Serialize for Body<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let Self { dialect, settings: ChatSettings { model, options, .. }, request } = self;
        let extra = &options.extra_body;
        let mut body = to.serialize_map(None)?;
        body.serialize_entry("model", model)?;
        if dialect.has_temperature(options) {
            body.serialize_entry(TEMPERATURE, &0.0)?;
        }
        body.serialize_entry("stream", &false)?;
        if ![BOUND, NEWER_BOUND_NAME].iter().any(|name| extra.contains_key(*name)) {
            let bound = if dialect.0 & NEWER_BOUND == 0 { BOUND } else { NEWER_BOUND_NAME };
            body.serialize_entry(bound, &request.max_tokens)?;
        }
        for (field, value) in dialect.fields(options, &request.choices) {
            body.serialize_entry(field, &value)?;
        }
        for (field, value) in extra.iter().filter(|(_, value)| !value.is_null()) {
            body.serialize_entry(field, value)?;
        }
        body.serialize_entry("messages", &*with_role(&request.messages, options.system_role))?;
        body.end()
    }
}

/// The messages with the rules in this role.
fn with_role(messages: &[ChatMessage], role: SystemRole) -> Cow<'_, [ChatMessage]> {
    match role {
        SystemRole::System => Cow::Borrowed(messages),
        SystemRole::Developer => {
            let developer = |message: &ChatMessage| match message.role {
                ChatRole::System => ChatMessage { role: ChatRole::Developer, ..message.clone() },
                _ => message.clone(),
            };
            messages.iter().map(developer).collect()
        }
        SystemRole::User => {
            let mut rules = String::new();
            let mut all = Vec::new();
            for message in messages {
                match (message.role, &message.content) {
                    (ChatRole::System, MessageContent::Text(text)) => {
                        rules += &format!("{text}\n\n")
                    }
                    (ChatRole::User, content) if !rules.is_empty() => {
                        let content = content.after(&std::mem::take(&mut rules));
                        all.push(ChatMessage { role: ChatRole::User, content });
                    }
                    (ChatRole::System, content) => {
                        let content = content.clone();
                        all.push(ChatMessage { role: ChatRole::User, content });
                    }
                    _ => all.push(message.clone()),
                }
            }
            if !rules.is_empty() {
                all.push(ChatMessage::text(ChatRole::User, rules.trim_end()));
            }
            Cow::Owned(all)
        }
    }
}

impl MessageContent {
    /// The content after another text.
    fn after(&self, text: &str) -> Self {
        match self {
            Self::Text(own) => Self::Text(format!("{text}{own}")),
            Self::Parts(parts) => {
                let first = ContentPart::Text { text: text.to_owned() };
                Self::Parts(std::iter::once(first).chain(parts.iter().cloned()).collect())
            }
        }
    }
}

impl Dialect {
    /// The dialect in which a request with choices is restricted by this field only, if at all.
    pub(crate) fn restricting_by(self, constraint: &str) -> Self {
        let others = CONSTRAINTS.iter().filter(|other| **other != constraint);
        Self(others.fold(self.0 & !bit(constraint), |all, other| all | bit(other)))
    }

    /// The body of `request`.
    pub(crate) const fn body<'a>(
        self,
        settings: &'a ChatSettings,
        request: &'a ChatRequest,
    ) -> Body<'a> {
        Body { dialect: self, settings, request }
    }

    fn has_temperature(self, options: &RequestOptions) -> bool {
        self.0 & NO_TEMPERATURE == 0 && !options.extra_body.contains_key(TEMPERATURE)
    }

    /// The optional fields that are sent.
    fn fields(self, options: &RequestOptions, choices: &[String]) -> Vec<(&'static str, Value)> {
        let mut fields = optional_fields(options.reasoning, choices);
        fields.retain(|(field, _)| {
            self.0 & bit(field) == 0 && !options.extra_body.contains_key(*field)
        });
        if fields.iter().any(|(field, _)| SERVER_CONSTRAINTS.contains(field)) {
            fields.retain(|(field, _)| *field != RESPONSE_FORMAT);
        }
        fields
    }

    /// The constraints of a request with choices that is sent in this dialect.
    pub(crate) fn constraints(self, options: &RequestOptions) -> Vec<&'static str> {
        let fields = self.fields(options, &["any".to_owned()]).into_iter().map(|(field, _)| field);
        fields.filter(|field| CONSTRAINTS.contains(field)).collect()
    }

    /// The fields that the server has refused.
    pub(crate) fn refused(self) -> Vec<&'static str> {
        let mut refused: Vec<_> =
            FIELDS.into_iter().filter(|field| self.0 & bit(field) != 0).collect();
        let others = [(NO_TEMPERATURE, TEMPERATURE), (NEWER_BOUND, BOUND)];
        refused.extend(others.iter().filter(|(bit, _)| self.0 & bit != 0).map(|(_, field)| field));
        refused
    }

    /// The dialect without the fields of `request` that a refusal names as the fault; `None` when it names none of them.
    pub(crate) fn after(
        self,
        options: &RequestOptions,
        request: &ChatRequest,
        refusal: &Refusal<'_>,
    ) -> Option<Self> {
        let mut next = self.0;
        for (field, _) in self.fields(options, &request.choices) {
            if refusal.is_about(field) {
                next |= bit(field);
            }
        }
        if self.has_temperature(options) && refusal.is_about(TEMPERATURE) {
            next |= NO_TEMPERATURE;
        }
        let is_own = !options.extra_body.contains_key(BOUND);
        if is_own && (refusal.is_about_name(BOUND) || refusal.asks_for(NEWER_BOUND_NAME)) {
            next |= NEWER_BOUND;
        }
        (next != self.0).then_some(Self(next))
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
        body_with(RequestOptions::default(), dialect, choices)
    }

    fn body_with(options: RequestOptions, dialect: Dialect, choices: &[&str]) -> Value {
        let settings = ChatSettings { options, ..ChatSettings::new("m") };
        serde_json::to_value(dialect.body(&settings, &request(choices))).unwrap()
    }

    /// The dialect after a refusal with this message.
    fn after(dialect: Dialect, choices: &[&str], message: &str) -> Option<Dialect> {
        let refusal = Refusal::new(400, message.as_bytes());
        dialect.after(&RequestOptions::default(), &request(choices), &refusal)
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

        let unknown = "Unrecognized request arguments supplied: grammar, structured_outputs";
        let second = after(Dialect::default(), &choices, unknown).unwrap();
        let schema = body(second, &choices);
        assert!(schema.get("grammar").is_none() && schema.get("structured_outputs").is_none());
        assert_eq!(
            schema.pointer("/response_format/json_schema/schema/properties/action/enum"),
            Some(&json!(["go", "stop"]))
        );

        let third = after(second, &choices, "response_format is not supported").unwrap();
        assert!(body(third, &choices).get("response_format").is_none());
        let only = Dialect::default().restricting_by("grammar");
        assert_eq!(only.constraints(&RequestOptions::default()), ["grammar"]);
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
            ("Unsupported value: 'temperature' does not support 0.", &["temperature"]),
        ] {
            let next = after(all, &[], message).unwrap();
            assert_eq!(next.refused(), changed);
            let body = body(next, &[]);
            assert!(changed.iter().all(|field| body.get(field).is_none()), "{body}");
            assert_eq!(after(next, &[], message), None, "a field is left out once");
        }
        let length = "This model's maximum context length is 8192 tokens; max_completion_tokens was reduced. thinking counts";
        assert_eq!(after(all, &["go"], length), None);
        let newer = after(all, &[], "use max_completion_tokens").unwrap();
        assert_eq!(body(newer, &[])["max_completion_tokens"], 30);
    }

    #[test]
    fn the_options_change_reasoning_roles_and_fields() {
        let reasoning = |reasoning| {
            let options = RequestOptions { reasoning, ..RequestOptions::default() };
            body_with(options, Dialect::default(), &[])
        };
        let low = reasoning(ReasoningRequest::Low);
        assert_eq!((&low["reasoning_effort"], low.get("thinking")), (&json!("low"), None));
        assert_eq!(reasoning(ReasoningRequest::Model).get("reasoning_effort"), None);

        let roles = |system_role| {
            let options = RequestOptions { system_role, ..RequestOptions::default() };
            body_with(options, Dialect::default(), &[])["messages"].clone()
        };
        let developer = roles(SystemRole::Developer);
        assert_eq!(developer[0], json!({"role": "developer", "content": "Be brief."}));
        let user = roles(SystemRole::User);
        assert_eq!(user.as_array().unwrap().len(), 1);
        assert_eq!(user[0]["content"][0], json!({"type": "text", "text": "Be brief.\n\n"}));
        let alone = [ChatMessage::text(ChatRole::System, "Be brief.")];
        let alone = with_role(&alone, SystemRole::User);
        assert_eq!(*alone, [ChatMessage::text(ChatRole::User, "Be brief.")]);

        let extra_body = json!({"top_k": 1, "temperature": 1, "max_completion_tokens": 9, "grammar": null, "structured_outputs": null});
        let extra_body = extra_body.as_object().unwrap().clone();
        let options = RequestOptions { extra_body, ..RequestOptions::default() };
        let body = body_with(options.clone(), Dialect::default(), &["go"]);
        assert_eq!((&body["top_k"], &body["temperature"]), (&json!(1), &json!(1)));
        assert_eq!((body.get("max_tokens"), body.get("grammar")), (None, None));
        assert!(body.get("response_format").is_some(), "the others are left out");
        let refusal = Refusal::new(400, b"unsupported: temperature");
        assert_eq!(Dialect::default().after(&options, &request(&[]), &refusal), None);
    }
}
