//! What a server sends back: the model's answer and the tokens it took.

use serde::{Deserialize, Serialize};
use serde_json::Value;

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
    /// The server's name for the configuration that answered.
    pub system_fingerprint: Option<String>,
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
}

/// Reads the body of a response with status 2xx.
///
/// # Errors
/// What is wrong with the body.
pub fn read(body: &[u8]) -> Result<ChatReply, String> {
    let body: Value =
        serde_json::from_slice(body).map_err(|error| format!("it is not JSON: {error}"))?;
    // Some proxies report a failure behind them with status 200.
    if let Some(error) = body.get("error").filter(|error| !error.is_null()) {
        return Err(format!("it is an error: {}", message_of(error)));
    }
    let choice = body.pointer("/choices/0").ok_or("it has no choices")?;
    let message = choice.get("message").ok_or("its choice has no message")?;
    let (reasoning, text) = split_reasoning(&text_of(message.get("content")));
    let word = |field| body.pointer(field).and_then(Value::as_str).map(str::to_owned);
    let count = |field| body.pointer(field).and_then(Value::as_u64);
    let finish_reason = word("/choices/0/finish_reason");
    let refusal = message.get("refusal").and_then(Value::as_str);
    let content = match (finish_reason.as_deref(), refusal) {
        (_, Some(refusal)) => ReplyContent::Refusal(refusal.to_owned()),
        (Some("content_filter"), None) => ReplyContent::Refusal(text),
        (Some("length"), None) => ReplyContent::Length(text),
        _ if text.is_empty() => ReplyContent::Empty,
        _ => ReplyContent::Text(text),
    };
    let reasoned = reasoning
        || ["reasoning_content", "reasoning"].iter().any(|field| {
            message.get(*field).and_then(Value::as_str).is_some_and(|text| !text.trim().is_empty())
        })
        || count("/usage/completion_tokens_details/reasoning_tokens").is_some_and(|n| n > 0);
    Ok(ChatReply {
        content,
        model: word("/model"),
        prompt_tokens: count("/usage/prompt_tokens"),
        completion_tokens: count("/usage/completion_tokens"),
        cached_tokens: CACHED_TOKENS.into_iter().find_map(count),
        image_tokens: IMAGE_TOKENS.into_iter().find_map(count),
        finish_reason,
        system_fingerprint: word("/system_fingerprint"),
        reasoned,
    })
}

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

/// The text of a message's content, which may come in parts.
fn text_of(content: Option<&Value>) -> String {
    match content {
        Some(Value::String(text)) => text.clone(),
        Some(Value::Array(parts)) => {
            parts.iter().filter_map(|part| part["text"].as_str()).collect()
        }
        _ => String::new(),
    }
}

/// Whether the answer begins with reasoning, and the answer without it and without surrounding white space. Reasoning
/// that was cut off leaves an empty answer.
fn split_reasoning(text: &str) -> (bool, String) {
    let text = text.trim();
    let Some(reasoning) = text.strip_prefix("<think>") else { return (false, text.to_owned()) };
    let (reasoning, answer) = reasoning.split_once("</think>").unwrap_or((reasoning, ""));
    (!reasoning.trim().is_empty(), answer.trim().to_owned())
}

/// Characters of a server's message that are shown.
const MESSAGE_CHARS: usize = 400;

/// The message in the body of an error response, on one line.
pub fn error_message(body: &[u8]) -> String {
    let text = String::from_utf8_lossy(body);
    let value: Option<Value> = serde_json::from_str(&text).ok();
    let message = value.as_ref().map_or_else(|| text.into_owned(), message_of);
    let line: String =
        message.split_whitespace().collect::<Vec<_>>().join(" ").replace(char::is_control, "");
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
        read(format!("{{\"choices\":[{choice}]}}").as_bytes()).unwrap().content
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
            (r#"{"message":{"content":null,"tool_calls":[]}}"#, Empty),
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
            (r#""content":"North","reasoning_content":"hm""#, "{}", true),
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
            ("{\"error\":{\"message\":\"upstream died\"}}", "it is an error: upstream died"),
        ] {
            let error = read(body.as_bytes()).unwrap_err();
            assert!(error.starts_with(expected), "{error}");
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
            ("<html>Bad gateway</html>", "<html>Bad gateway</html>"),
            ("", "no message"),
        ] {
            assert_eq!(error_message(body.as_bytes()), expected);
        }
        assert_eq!(error_message("x".repeat(1000).as_bytes()).len(), MESSAGE_CHARS + 3);
    }
}
