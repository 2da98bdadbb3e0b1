//! What a server sends back: the model's answer and the tokens it took.

use domain::names::steers_a_terminal;
use domain::reasoning::split_reasoning;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::body;

/// A model's answer. Fields are `None` where the server does not report them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChatReply {
    /// The answer itself.
    #[serde(rename = "outcome")]
    pub content: ReplyContent,
    /// The model's name as the server reports it.
    pub model: Option<String>,
    /// Tokens of the prompt as the server counted them.
    pub prompt_tokens: Option<u64>,
    /// Tokens of the answer, reasoning included.
    pub completion_tokens: Option<u64>,
    /// Tokens of the prompt that came from the server's prefix cache.
    pub cached_tokens: Option<u64>,
    /// Tokens of the prompt that stand for images.
    pub image_tokens: Option<u64>,
    /// Why the answer ended, in the server's terms.
    pub finish_reason: Option<String>,
    /// Whether the model reasoned before it answered, although reasoning was turned off.
    pub reasoned: bool,
}

/// The kinds of answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReplyContent {
    /// A complete answer.
    Text(String),
    /// Nothing, or white space.
    Empty,
    /// The model or the server's filter refused to answer. The explanation may be empty.
    Refusal(String),
    /// An answer that was cut off at the bound on its tokens.
    Length(String),
}

/// Values of `finish_reason` of an answer that the server, not the model, ended: vLLM, SGLang and LMDeploy (`abort`,
/// `error`), OpenRouter and Mistral (`error`), DeepSeek, GLM, TensorRT-LLM (`timeout`, `cancelled`), Ollama (`load`, `unload`).
const FAILURES: [&str; 10] = [
    "error",
    "abort",
    "aborted",
    "cancelled",
    "canceled",
    "timeout",
    "insufficient_system_resource",
    "network_error",
    "load",
    "unload",
];

/// Values of `finish_reason` of an answer that was refused: OpenAI's, of which Gemini's (`content_filter: SAFETY`) begin with
/// it; those of Gemini, Anthropic, Bedrock and GLM that some proxies pass on.
const REFUSALS: [&str; 9] = [
    "content_filter",
    "refusal",
    "safety",
    "prohibited_content",
    "blocklist",
    "spii",
    "recitation",
    "guardrail_intervened",
    "sensitive",
];

/// Values of `finish_reason` of an answer that was cut off: OpenAI's, those of Anthropic and Gemini, of Mistral and of GLM.
const CUT_OFF: [&str; 4] =
    ["length", "max_tokens", "model_length", "model_context_window_exceeded"];

/// Values of `finish_reason` of an answer that calls tools, and so has no text.
const TOOL_CALLS: [&str; 2] = ["tool_calls", "function_call"];

/// Whether a `finish_reason` begins with one of `kinds`, in any case, with a hyphen or an underscore, and with or without an
/// explanation after it: `content_filter: SAFETY`.
fn is_one_of(finish_reason: Option<&str>, kinds: &[&str]) -> bool {
    let kind = |reason: &str| {
        let reason = reason.trim().replace('-', "_").to_lowercase();
        let end = reason.find(|c: char| !c.is_alphanumeric() && c != '_');
        reason[..end.unwrap_or(reason.len())].to_owned()
    };
    finish_reason.is_some_and(|reason| kinds.contains(&kind(reason).as_str()))
}

impl ReplyContent {
    /// The kind of an answer with this text that ended for this reason.
    fn new(text: String, finish_reason: Option<&str>) -> Self {
        if is_one_of(finish_reason, &REFUSALS) {
            Self::Refusal(text)
        } else if is_one_of(finish_reason, &CUT_OFF) {
            Self::Length(text)
        } else if text.is_empty() {
            Self::Empty
        } else {
            Self::Text(text)
        }
    }
}

impl ChatReply {
    /// The answer's text; empty for an empty answer.
    pub fn text(&self) -> &str {
        match &self.content {
            ReplyContent::Text(text) | ReplyContent::Length(text) | ReplyContent::Refusal(text) => {
                text
            }
            ReplyContent::Empty => "",
        }
    }

    /// Judges a reply that an earlier version may have stored as the model's answer, as [`read`] judges a new one.
    ///
    /// # Errors
    /// The failure of the server that it is.
    pub fn judged(self) -> Result<Self, String> {
        let finish_reason = self.finish_reason.as_deref();
        if matches!(&self.content, ReplyContent::Refusal(text) if text.is_empty())
            && !is_one_of(finish_reason, &REFUSALS)
        {
            return Err("its refusal is empty, so its text was not kept".to_owned());
        }
        let content = match self.content {
            decided @ (ReplyContent::Refusal(_) | ReplyContent::Length(_)) => decided,
            ReplyContent::Empty => ReplyContent::new(String::new(), finish_reason),
            ReplyContent::Text(text) => ReplyContent::new(text, finish_reason),
        };
        let reply = Self { content, ..self };
        match reply.failure() {
            Some(problem) => Err(problem),
            None => Ok(reply),
        }
    }

    /// The failure of the server that the reply shows, if it is not the model's answer.
    fn failure(&self) -> Option<String> {
        let finish_reason = self.finish_reason.as_deref();
        if is_one_of(finish_reason, &FAILURES) {
            return Some(format!("its finish_reason is {:?}", finish_reason.unwrap_or_default()));
        }
        let is_answer = self.content != ReplyContent::Empty || self.reasoned;
        if is_answer || is_one_of(finish_reason, &TOOL_CALLS) {
            return None;
        }
        // A model that says nothing still says that it has ended, which is a token.
        match self.completion_tokens {
            Some(0) => Some("it is empty and has no tokens".to_owned()),
            None => Some("it is empty, and does not say how many tokens it has".to_owned()),
            Some(_) => None,
        }
    }

    /// Replaces each text that the server wrote with what `masked` makes of it.
    pub(crate) fn mask(&mut self, masked: impl Fn(&str) -> String) {
        if let ReplyContent::Text(text) | ReplyContent::Length(text) | ReplyContent::Refusal(text) =
            &mut self.content
        {
            *text = masked(text);
        }
        let words = [&mut self.model, &mut self.finish_reason];
        for word in words.into_iter().flatten() {
            *word = masked(word);
        }
    }
}

/// Whether a field is there and empty, as some servers send those that do not apply.
fn says_nothing(field: &Value) -> bool {
    match field {
        Value::Null | Value::Bool(false) => true,
        Value::String(text) => text.is_empty(),
        Value::Array(items) => items.is_empty(),
        Value::Object(fields) => fields.is_empty(),
        _ => false,
    }
}

/// What the problem of a failure begins with that the server reports itself.
pub(crate) const REPORTED: &str = "it is an error: ";

/// Reads the body of a response with status 2xx.
///
/// # Errors
/// What is wrong with the body, or the failure of the server that it reports: such a reply is not the model's answer.
pub fn read(body: &[u8]) -> Result<ChatReply, UnusableReply> {
    let body = body::json(body)?;
    // Some proxies report a failure behind them with status 200, as the whole answer or inside a choice.
    let errors = [body.get("error"), body.pointer("/choices/0/error")];
    if let Some(error) = errors.into_iter().flatten().find(|error| !says_nothing(error)) {
        let problem = format!("{REPORTED}{}", message_of(error));
        let code = ["code", "status"].into_iter().find_map(|field| status_of(error.get(field)?));
        return Err(UnusableReply { problem, code, is_reported: true });
    }
    let choice = body.pointer("/choices/0").ok_or("it has no choices")?;
    let message = choice.get("message").filter(|message| message.is_object());
    let message = message.ok_or("its choice has no message")?;
    let text = text_of(message.get("content"));
    let (reasoning, text) = split_reasoning(&text);
    let word = |field| body.pointer(field).and_then(Value::as_str).map(str::to_owned);
    let count = |field| body.pointer(field).and_then(Value::as_u64);
    let finish_reason = word("/choices/0/finish_reason");
    let refusal = message.get("refusal").and_then(Value::as_str).map(str::trim);
    let content = match refusal.filter(|refusal| !refusal.is_empty()) {
        Some(refusal) => ReplyContent::Refusal(refusal.to_owned()),
        None => ReplyContent::new(text.to_owned(), finish_reason.as_deref()),
    };
    let parts = message.get("content").and_then(Value::as_array);
    let reasoned = reasoning
        || parts.is_some_and(|parts| parts.iter().any(is_reasoning))
        || REASONING.iter().any(|field| match message.get(*field) {
            Some(Value::String(text)) => !text.trim().is_empty(),
            Some(Value::Array(parts)) => !parts.is_empty(),
            _ => false,
        })
        || count("/usage/completion_tokens_details/reasoning_tokens").is_some_and(|n| n > 0);
    let reply = ChatReply {
        content,
        model: word("/model"),
        prompt_tokens: count("/usage/prompt_tokens"),
        completion_tokens: count("/usage/completion_tokens"),
        cached_tokens: CACHED_TOKENS.into_iter().find_map(count),
        image_tokens: IMAGE_TOKENS.into_iter().find_map(count),
        finish_reason,
        reasoned,
    };
    match reply.failure() {
        Some(problem) => Err(problem.into()),
        None => Ok(reply),
    }
}

/// The HTTP status in an error, which may be a text.
fn status_of(code: &Value) -> Option<u16> {
    let number = code.as_u64().or_else(|| code.as_str()?.parse().ok());
    number.and_then(|number| number.try_into().ok()).filter(|status| (400..600).contains(status))
}

/// A body with status 2xx that is no reply of the model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnusableReply {
    /// What is wrong with it.
    pub problem: String,
    /// The status that it reports about the failure, if it does.
    pub code: Option<u16>,
    /// Whether the server reports the failure itself.
    pub is_reported: bool,
}

impl From<String> for UnusableReply {
    fn from(problem: String) -> Self {
        Self { problem, code: None, is_reported: false }
    }
}

impl From<&str> for UnusableReply {
    fn from(problem: &str) -> Self {
        problem.to_owned().into()
    }
}

/// Where servers report the model's reasoning: vLLM before 0.12, SGLang, llama.cpp, DeepSeek; vLLM, Ollama, OpenRouter;
/// OpenRouter also in parts.
const REASONING: [&str; 3] = ["reasoning_content", "reasoning", "reasoning_details"];

/// Where servers report cached tokens: OpenAI, vLLM, SGLang; DeepSeek; llama.cpp.
const CACHED_TOKENS: [&str; 3] = [
    "/usage/prompt_tokens_details/cached_tokens",
    "/usage/prompt_cache_hit_tokens",
    "/timings/cache_n",
];

/// Where servers report image tokens: hosted ones; vLLM.
const IMAGE_TOKENS: [&str; 2] = [
    "/usage/prompt_tokens_details/image_tokens",
    "/usage/prompt_tokens_details/multimodal_tokens/image",
];

/// The text of a message's content, which may come in parts, without those of reasoning.
fn text_of(content: Option<&Value>) -> String {
    match content {
        Some(Value::String(text)) => text.clone(),
        Some(Value::Array(parts)) => {
            let parts = parts.iter().filter(|part| !is_reasoning(part));
            parts.filter_map(|part| part["text"].as_str()).collect()
        }
        _ => String::new(),
    }
}

/// Whether a part of a message's content is reasoning: `reasoning`, `thinking` (Mistral, Claude), `redacted_thinking`.
fn is_reasoning(part: &Value) -> bool {
    let kind = part["type"].as_str().unwrap_or_default();
    kind.contains("reasoning") || kind.contains("thinking")
}

/// Characters of a server's message that are shown.
const MESSAGE_CHARS: usize = 400;

/// The message in the body of an error response, on one line, and what `masked` makes of it.
pub fn error_message(body: &[u8], masked: impl Fn(&str) -> String) -> String {
    let message = match body::json(body) {
        Ok(value) => message_of(&value),
        Err(_) => String::from_utf8_lossy(body).into_owned(),
    };
    let message = match message.trim_start().starts_with('<') {
        true => body::words_of_page(&message).into_owned(),
        false => message,
    };
    let words: Vec<&str> = message.split_whitespace().collect();
    let line = words.join(" ").replace(steers_a_terminal, "");
    // Before it is cut, since a part of the key would not be found.
    let line = masked(&line);
    match line.char_indices().nth(MESSAGE_CHARS) {
        Some((end, _)) => format!("{}...", &line[..end]),
        None if line.is_empty() => "no message".to_owned(),
        None => line,
    }
}

fn message_of(value: &Value) -> String {
    let inner = match value {
        Value::Array(items) => items.first(),
        Value::Object(fields) => {
            ["error", "message", "detail", "msg"].iter().find_map(|name| fields.get(*name))
        }
        _ => None,
    };
    match (value, inner) {
        (Value::String(text), _) => text.clone(),
        (Value::Array(_) | Value::Object(_), Some(inner)) => message_of(inner),
        (other, _) => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn content(choice: &str) -> ReplyContent {
        let usage = r#""usage":{"completion_tokens":1}"#;
        read(format!("{{\"choices\":[{choice}],{usage}}}").as_bytes()).unwrap().content
    }

    #[test]
    fn every_kind_of_answer() {
        use ReplyContent::{Empty, Length, Refusal, Text};
        for (choice, expected) in [
            (r#"{"message":{"content":" North. "},"finish_reason":"stop"}"#, Text("North.".into())),
            (
                r#"{"message":{"content":[{"type":"text","text":"No"},{"type":"text","text":"rth"}]}}"#,
                Text("North".into()),
            ),
            (r#"{"message":{"content":"<think>hm\n</think>\n\nNorth"}}"#, Text("North".into())),
            (
                r#"{"message":{"content":"<think>hm"},"finish_reason":"length"}"#,
                Length(String::new()),
            ),
            (r#"{"message":{"content":" \n"},"finish_reason":"stop"}"#, Empty),
            (
                r#"{"message":{"content":null,"tool_calls":[{"id":"1"}]},"finish_reason":"tool_calls"}"#,
                Empty,
            ),
            (r#"{"message":{"content":"","reasoning":"hm"}}"#, Empty),
            (r#"{"message":{"content":null},"finish_reason":"length"}"#, Length(String::new())),
            (r#"{"message":{"content":"Nor"},"finish_reason":"MAX_TOKENS"}"#, Length("Nor".into())),
            (
                r#"{"message":{"content":"","refusal":null},"finish_reason":"content_filter: PROHIBITED_CONTENT"}"#,
                Refusal(String::new()),
            ),
            (r#"{"message":{"content":"North","refusal":""}}"#, Text("North".into())),
            (r#"{"message":{"content":"North"},"error":{}}"#, Text("North".into())),
            (r#"{"message":{"content":"hm\n</think>\n\nNorth"}}"#, Text("North".into())),
            (r#"{"message":{"content":"North</think>"}}"#, Text("North".into())),
            (
                r#"{"message":{"content":[{"type":"reasoning","text":"South"},{"type":"text","text":"North"}]}}"#,
                Text("North".into()),
            ),
            (
                r#"{"message":{"content":""},"finish_reason":"content-filter"}"#,
                Refusal(String::new()),
            ),
            (
                r#"{"message":{"content":null,"refusal":"I cannot."},"finish_reason":"stop"}"#,
                Refusal("I cannot.".into()),
            ),
            (
                r#"{"message":{"content":"","refusal":null},"finish_reason":"content_filter"}"#,
                Refusal(String::new()),
            ),
            (r#"{"message":{"content":"Nor"},"finish_reason":"length"}"#, Length("Nor".into())),
        ] {
            assert_eq!(content(choice), expected, "{choice}");
        }
    }

    #[test]
    fn counts_the_server_does_not_report_are_absent() {
        let choices = r#""choices":[{"message":{"content":"a"}}]"#;
        for (usage, expected) in [
            ("", (None, None)),
            (r#","usage":null"#, (None, None)),
            (r#","usage":{"prompt_tokens":7}"#, (Some(7), None)),
            (r#","usage":{"prompt_tokens":0,"completion_tokens":9}"#, (Some(0), Some(9))),
            (r#","usage":{"prompt_tokens":"many"}"#, (None, None)),
        ] {
            let reply = read(format!("{{{choices}{usage}}}").as_bytes()).unwrap();
            assert_eq!((reply.prompt_tokens, reply.completion_tokens), expected, "{usage}");
        }
    }

    #[test]
    fn token_counts_of_several_servers() {
        for (body, expected) in [
            (
                r#""usage":{"prompt_tokens_details":{"cached_tokens":64,"image_tokens":256}}"#,
                (Some(64), Some(256)),
            ),
            (
                r#""usage":{"prompt_tokens_details":{"cached_tokens":null,"multimodal_tokens":{"image":9}}}"#,
                (None, Some(9)),
            ),
            (
                r#""usage":{"prompt_tokens_details":null,"prompt_cache_hit_tokens":8}"#,
                (Some(8), None),
            ),
            (r#""usage":{},"timings":{"cache_n":7,"prompt_n":3}"#, (Some(7), None)),
        ] {
            let body = format!(r#"{{"choices":[{{"message":{{"content":"a"}}}}],{body}}}"#);
            let reply = read(body.as_bytes()).unwrap();
            assert_eq!((reply.cached_tokens, reply.image_tokens), expected, "{body}");
        }
    }

    #[test]
    fn reasoning_is_noticed_in_every_form() {
        for (message, usage, expected) in [
            (r#""content":"North""#, "{}", false),
            (r#""content":"<think>\n</think>North""#, "{}", false),
            (r#""content":"<think>hm</think>North""#, "{}", true),
            (r#""content":"hm</think>North""#, "{}", true),
            (
                r#""content":[{"type":"thinking","thinking":[]},{"type":"text","text":"North"}]"#,
                "{}",
                true,
            ),
            (
                r#""content":"North","reasoning_details":[{"type":"reasoning.encrypted"}]"#,
                "{}",
                true,
            ),
            (r#""content":"North","reasoning_content":"hm""#, "{}", true),
            (r#""content":"◁think▷hm◁/think▷North""#, "{}", true),
            (r#""content":[{"type":"text","text":"North"}]"#, "{}", false),
            (
                r#""content":[{"type":"thinking","thinking":[]},{"type":"text","text":"North"}]"#,
                "{}",
                true,
            ),
            (r#""content":"North","reasoning":null"#, "{}", false),
            (
                r#""content":"North""#,
                r#"{"completion_tokens_details":{"reasoning_tokens":3}}"#,
                true,
            ),
        ] {
            let body = format!(r#"{{"choices":[{{"message":{{{message}}}}}],"usage":{usage}}}"#);
            assert_eq!(read(body.as_bytes()).unwrap().reasoned, expected, "{body}");
        }
    }

    #[test]
    fn an_unusable_body_says_what_is_wrong() {
        for (body, expected) in [
            ("{\"choices\":[", "it is not JSON"),
            ("{\"choices\":[]}", "it has no choices"),
            ("{\"choices\":[{}]}", "its choice has no message"),
            ("{\"choices\":[{\"message\":null}]}", "its choice has no message"),
            ("{\"error\":{\"message\":\"upstream died\"}}", "it is an error: upstream died"),
        ] {
            let error = read(body.as_bytes()).unwrap_err().problem;
            assert!(error.starts_with(expected), "{error}");
        }
    }

    /// Failures that servers report with status 200, as a server sends them and as an earlier version has stored them.
    #[test]
    fn a_failure_of_the_server_is_no_answer() {
        let of = |choice: &str, usage: &str| {
            read(format!("{{\"choices\":[{choice}],\"usage\":{usage}}}").as_bytes())
        };
        let died =
            r#"{"message":{"content":"mov"},"error":{"code":502,"message":"upstream died"}}"#;
        let busy = r#"{"message":{"content":""},"error":{"code":429,"message":"slow"}}"#;
        for (choice, usage, problem, code) in [
            (died, "{}", "it is an error: upstream died", Some(502)),
            (busy, "{}", "it is an error: slow", Some(429)),
            (
                r#"{"message":{"content":"mov"},"finish_reason":"abort"}"#,
                r#"{"completion_tokens":3}"#,
                "its finish_reason is \"abort\"",
                None,
            ),
            (
                r#"{"message":{"content":"mov"},"finish_reason":"error: upstream"}"#,
                "{}",
                "its finish_reason is \"error: upstream\"",
                None,
            ),
            (
                r#"{"message":{"content":""},"finish_reason":"ERROR"}"#,
                "{}",
                "its finish_reason is \"ERROR\"",
                None,
            ),
            (
                r#"{"message":{"content":""},"finish_reason":"stop"}"#,
                r#"{"completion_tokens":0}"#,
                "it is empty and has no tokens",
                None,
            ),
            (
                r#"{"message":{"content":""},"finish_reason":"stop"}"#,
                "{}",
                "it is empty, and does not say how many tokens it has",
                None,
            ),
        ] {
            let is_reported = problem.starts_with("it is an error");
            let expected = UnusableReply { problem: problem.to_owned(), code, is_reported };
            assert_eq!(of(choice, usage), Err(expected), "{choice}");
        }
        let spoken = of(
            r#"{"message":{"content":""},"finish_reason":"stop"}"#,
            r#"{"completion_tokens":1}"#,
        );
        assert_eq!(spoken.unwrap().content, ReplyContent::Empty);
    }

    #[test]
    fn a_stored_reply_is_judged_as_a_new_one() {
        use ReplyContent::{Empty, Length, Refusal, Text};
        let stored = |content: &ReplyContent, finish_reason: Option<&str>, tokens| ChatReply {
            content: content.clone(),
            finish_reason: finish_reason.map(str::to_owned),
            completion_tokens: tokens,
            ..read(br#"{"choices":[{"message":{"content":"a"}}]}"#).unwrap()
        };
        let (text, none) = (Text("North".to_owned()), String::new());
        for (content, finish_reason, tokens, expected) in [
            (&text, Some("stop"), Some(1), Some(&text)),
            (&text, Some("error"), Some(1), None),
            (&Empty, Some("abort"), Some(0), None),
            (&Empty, Some("stop"), Some(0), None),
            (&Empty, Some("stop"), Some(2), Some(&Empty)),
            (&Empty, None, None, None),
            (&Empty, Some("content_filter: SAFETY"), None, Some(&Refusal(none.clone()))),
            (&Refusal(none.clone()), Some("stop"), Some(1), None),
            (&Refusal("No.".to_owned()), Some("stop"), Some(1), Some(&Refusal("No.".to_owned()))),
            (&Empty, Some("max_tokens"), Some(30), Some(&Length(none.clone()))),
        ] {
            let judged = stored(content, finish_reason, tokens).judged().ok();
            assert_eq!(judged.map(|reply| reply.content).as_ref(), expected, "{finish_reason:?}");
        }
    }

    #[test]
    fn error_messages_of_several_servers() {
        for (body, expected) in [
            (r#"{"error":{"message":"Incorrect API key","type":"x"}}"#, "Incorrect API key"),
            (r#"{"error":"model not found"}"#, "model not found"),
            (r#"{"object":"error","message":"too\nlong"}"#, "too long"),
            (r#"{"detail":[{"loc":["body"],"msg":"Extra inputs"}]}"#, "Extra inputs"),
            (r#"[{"error":{"message":"Unknown name"}}]"#, "Unknown name"),
            ("<html>Bad gateway</html>", "Bad gateway"),
            ("<html><title>502 Bad Gateway</title><h1>nginx</h1></html>", "502 Bad Gateway"),
            (r#"{"error":"no \u202edrow\u001b[2J"}"#, "no drow[2J"),
            ("", "no message"),
        ] {
            assert_eq!(error_message(body.as_bytes(), str::to_owned), expected);
        }
        let long = "x".repeat(MESSAGE_CHARS - 2) + "secret" + &"x".repeat(MESSAGE_CHARS);
        let shown = error_message(long.as_bytes(), |text| text.replace("secret", "[key]"));
        assert_eq!(shown, "x".repeat(MESSAGE_CHARS - 2) + "[k...");
    }
}
