//! What comes back: the model's text, or why there is none, and what it cost.

use serde_json::Value;

/// What a model answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// The answer itself.
    pub outcome: Outcome,
    /// The model's name as the server reports it; `None` when it does not.
    pub model: Option<String>,
    /// Tokens of the prompt as the server counted them; `None` when it did not.
    pub prompt_tokens: Option<u64>,
    /// Tokens of the answer, likewise.
    pub completion_tokens: Option<u64>,
}

/// The kinds of answers.
#[derive(Debug, Clone, PartialEq, Eq)]
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
    let text = strip_reasoning(&text_of(message.get("content"))).to_owned();
    let refusal = message.get("refusal").and_then(Value::as_str);
    let outcome = match (choice.get("finish_reason").and_then(Value::as_str), refusal) {
        (_, Some(refusal)) => Outcome::Refusal(refusal.to_owned()),
        (Some("content_filter"), None) => Outcome::Refusal(text),
        (Some("length"), None) => Outcome::Length(text),
        _ if text.is_empty() => Outcome::Empty,
        _ => Outcome::Text(text),
    };
    let tokens = |field| body.pointer(field).and_then(Value::as_u64);
    Ok(Reply {
        outcome,
        model: body.get("model").and_then(Value::as_str).map(str::to_owned),
        prompt_tokens: tokens("/usage/prompt_tokens"),
        completion_tokens: tokens("/usage/completion_tokens"),
    })
}

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

/// `text` without blanks around it and without the reasoning that some servers leave in front of an answer.
fn strip_reasoning(text: &str) -> &str {
    let text = text.trim();
    let reasoned = text.strip_prefix("<think>").and_then(|rest| rest.split_once("</think>"));
    reasoned.map_or(text, |(_, answer)| answer.trim())
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
