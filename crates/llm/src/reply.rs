//! What comes back: the model's text, or why there is none, and what it cost.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What a model answered. A field is `None` when the server does not tell.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// The answer itself.
    pub outcome: Outcome,
    /// The model's name as the server reports it.
    pub model: Option<String>,
    /// Tokens of the prompt as the server counted them.
    pub prompt_tokens: Option<u64>,
    /// Tokens of the answer, reasoning included.
    pub completion_tokens: Option<u64>,
    /// Those of the prompt that the server had read before (its prefix cache).
    pub cached_tokens: Option<u64>,
    /// Those of the prompt that stand for images.
    pub image_tokens: Option<u64>,
    /// Why the answer ended, in the server's word.
    pub finish_reason: Option<String>,
    /// What the server calls the configuration that answered.
    pub system_fingerprint: Option<String>,
    /// Whether the model reasoned before it answered, although it was asked not to.
    pub reasoned: bool,
}

/// The kinds of answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// A whole answer.
    Text(String),
    /// Nothing, or blanks.
    Empty,
    /// The model or the server's filter refused to answer: what was said about it, maybe nothing.
    Refusal(String),
    /// An answer that reached the bound on its tokens: what there is of it.
    Length(String),
}

/// Reads the body of a server's good answer; the error says what it lacks.
pub(super) fn read(body: &[u8]) -> Result<Reply, String> {
    let body: Value =
        serde_json::from_slice(body).map_err(|error| format!("it is not JSON: {error}"))?;
    // Some servers that pass requests on report another's failure with status 200.
    if let Some(error) = body.get("error").filter(|error| !error.is_null()) {
        return Err(format!("it is an error: {}", message_of(error)));
    }
    let choice = body.pointer("/choices/0").ok_or("it has no choices")?;
    let message = choice.get("message").ok_or("its choice has no message")?;
    let (reasoning, text) = apart(&text_of(message.get("content")));
    let word = |field| body.pointer(field).and_then(Value::as_str).map(str::to_owned);
    let count = |field| body.pointer(field).and_then(Value::as_u64);
    let finish_reason = word("/choices/0/finish_reason");
    let refusal = message.get("refusal").and_then(Value::as_str);
    let outcome = match (finish_reason.as_deref(), refusal) {
        (_, Some(refusal)) => Outcome::Refusal(refusal.to_owned()),
        (Some("content_filter"), None) => Outcome::Refusal(text),
        (Some("length"), None) => Outcome::Length(text),
        _ if text.is_empty() => Outcome::Empty,
        _ => Outcome::Text(text),
    };
    let reasoned = reasoning
        || ["reasoning_content", "reasoning"].iter().any(|field| {
            message.get(*field).and_then(Value::as_str).is_some_and(|text| !text.trim().is_empty())
        })
        || count("/usage/completion_tokens_details/reasoning_tokens").is_some_and(|n| n > 0);
    Ok(Reply {
        outcome,
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

/// Where servers tell how many tokens of the prompt they had read before: OpenAI, vLLM, SGLang; DeepSeek;
/// llama.cpp.
const CACHED_TOKENS: [&str; 3] = [
    "/usage/prompt_tokens_details/cached_tokens",
    "/usage/prompt_cache_hit_tokens",
    "/timings/cache_n",
];

/// Where servers tell how many tokens of the prompt stand for images: hosted ones; vLLM.
const IMAGE_TOKENS: [&str; 2] = [
    "/usage/prompt_tokens_details/image_tokens",
    "/usage/prompt_tokens_details/multimodal_tokens/image",
];

/// The text of a message's content, which some servers send in parts.
fn text_of(content: Option<&Value>) -> String {
    match content {
        Some(Value::String(text)) => text.clone(),
        Some(Value::Array(parts)) => {
            parts.iter().filter_map(|part| part["text"].as_str()).collect()
        }
        _ => String::new(),
    }
}

/// Whether reasoning stands in front of an answer, where some servers leave it, and the answer without it and
/// without blanks around it. Reasoning that was cut off leaves no answer.
fn apart(text: &str) -> (bool, String) {
    let text = text.trim();
    let Some(reasoning) = text.strip_prefix("<think>") else { return (false, text.to_owned()) };
    let (reasoning, answer) = reasoning.split_once("</think>").unwrap_or((reasoning, ""));
    (!reasoning.trim().is_empty(), answer.trim().to_owned())
}

/// Most characters of a server's message that are shown.
const MESSAGE_CHARS: usize = 400;

/// What a server says about an error, from the body of its answer.
pub(super) fn error_message(body: &[u8]) -> String {
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

    fn outcome(choice: &str) -> Outcome {
        read(format!("{{\"choices\":[{choice}]}}").as_bytes()).unwrap().outcome
    }

    #[test]
    fn every_kind_of_answer() {
        use Outcome::{Empty, Length, Refusal, Text};
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
            assert_eq!(outcome(choice), expected, "{choice}");
        }
    }

    #[test]
    fn what_was_not_counted_is_absent() {
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
    fn tokens_of_several_servers() {
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
    fn reasoning_is_noticed_wherever_it_stands() {
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
    fn an_answer_that_is_none_says_what_it_lacks() {
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
