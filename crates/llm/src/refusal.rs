//! What the error response of a server means: which field of the request it names as the fault, whether every other request
//! would meet the same answer, and what to do.

use serde_json::Value;

use crate::body;
use crate::request::ChatRequest;

/// Words of a sentence that names a field as the fault.
const FAULT_WORDS: [&str; 26] = [
    "unsupported",
    "not supported",
    "not support",
    "n't support",
    "unknown",
    "unrecognized",
    "unrecognised",
    "not recognized",
    "unexpected",
    "not permitted",
    "not allowed",
    "forbidden",
    "extra input",
    "extra field",
    "additional propert",
    "cannot find field",
    "not a valid field",
    "not a valid parameter",
    "invalid field",
    "invalid parameter",
    "invalid argument",
    "deprecated",
    "unavailable",
    "not available",
    "not implemented",
    "not enabled",
];

/// Keys of an error whose values repeat the request.
const REPEATED: [&str; 3] = ["input", "ctx", "url"];

/// Codes and sentences of a server whose user has nothing left to spend: OpenAI, Anthropic, OpenRouter, DeepSeek, DashScope.
const OUT_OF_CREDIT: [&str; 12] = [
    "insufficient_quota",
    "billing_hard_limit",
    "billing_not_active",
    "insufficient_balance",
    "insufficient balance",
    "insufficient credit",
    "insufficient_credit",
    "insufficient funds",
    "credit balance",
    "out of credit",
    "more credits",
    "arrearage",
];

/// A quota that is used up and that no pause restores; with `retry`, as Gemini says it, it is a limit of requests a minute.
const QUOTA: &str = "exceeded your current quota";

/// Sentences of chat templates that refuse a conversation, and of the servers that render them.
const TEMPLATE: [&str; 10] = [
    "roles must alternate",
    "only user and assistant roles",
    "only user, assistant",
    "system role not supported",
    "system role is not supported",
    "system message is not supported",
    "chat template",
    "chat_template",
    "jinja",
    "templateerror",
];

/// Words of an error about the images of a request.
const IMAGE_WORDS: [&str; 6] = ["image", "multimodal", "multi-modal", "vision", "picture", "mm_"];

/// Words of an error about the length of a request.
const LENGTH_WORDS: [&str; 7] =
    ["context", "too long", "too large", "maximum", "exceed", "token", "length"];

fn has_any(text: &str, words: &[&str]) -> bool {
    words.iter().any(|word| text.contains(word))
}

/// The response to a request that the server refuses.
pub(crate) struct Refusal<'a> {
    pub(crate) status: u16,
    body: &'a [u8],
    /// The body in lower case.
    text: String,
    value: Option<Value>,
}

impl<'a> Refusal<'a> {
    pub(crate) fn new(status: u16, body: &'a [u8]) -> Self {
        let text = String::from_utf8_lossy(body).to_lowercase();
        Self { status, body, text, value: body::json(body).ok() }
    }

    /// Whether the model's chat template refuses the conversation, which another attempt does not change.
    pub(crate) fn is_of_template(&self) -> bool {
        // The field is named so, too.
        let text = self.text.replace("chat_template_kwargs", "");
        matches!(self.status, 400 | 422 | 500) && has_any(&text, &TEMPLATE)
    }

    /// Whether the user's account has nothing left to spend.
    fn is_out_of_credit(&self) -> bool {
        (400..=499).contains(&self.status)
            && (has_any(&self.text, &OUT_OF_CREDIT)
                || self.text.contains(QUOTA) && !self.text.contains("retry"))
    }

    /// Whether another attempt cannot meet another answer.
    pub(crate) fn is_final(&self) -> bool {
        !crate::server::is_transient(self.status)
            || self.is_out_of_credit()
            || self.is_of_template()
    }

    /// Whether every other request of the run would meet the same refusal.
    pub(crate) fn is_permanent(&self) -> bool {
        let is_of_request = match self.status {
            // A proxy refuses the size of this request.
            413 => true,
            // OpenRouter refuses the content of a single request with the status of a missing right.
            403 => has_any(&self.text, &["moderation", "flagged"]),
            _ => false,
        };
        let is_permanent = matches!(self.status, 401..=403)
            || self.is_out_of_credit()
            || self.is_of_template()
            || body::is_page(self.body);
        is_permanent && !is_of_request
    }

    /// What to do. `bytes` is the size of the request, `has_key` whether it had a key.
    pub(crate) fn advice(&self, request: &ChatRequest, bytes: usize, has_key: bool) -> String {
        let images = request.images();
        let counted = format!("{images} image{}", if images == 1 { "" } else { "s" });
        let says = |words: &[&str]| has_any(&self.text, words);
        if self.is_out_of_credit() || self.status == 402 {
            return "the account of this key has nothing left to spend: see its billing page"
                .to_owned();
        }
        if self.is_of_template() {
            return "the model's chat template cannot render the conversation: try --system-role user".to_owned();
        }
        match self.status {
            401 | 403 if !has_key => {
                "set OPENAI_API_KEY in the environment or in a .env file".to_owned()
            }
            401 | 403 => "check OPENAI_API_KEY".to_owned(),
            404 => "check the model's name and the base URL, which usually ends in /v1".to_owned(),
            413 => format!(
                "the request has {bytes} bytes and {counted}, and the server or a proxy before it takes fewer: raise \
                 its limit (nginx: client_max_body_size), or make requests smaller with --image-format jpeg, a smaller \
                 --frame-size or --image-budget"
            ),
            _ if images > 0 && (says(&IMAGE_WORDS) || says(&LENGTH_WORDS)) => format!(
                "the request has {counted}: lower --image-budget, or raise the server's context or its bound on \
                 images"
            ),
            _ if says(&["system"]) => {
                "if it is about the system message, try --system-role user".to_owned()
            }
            _ if says(&LENGTH_WORDS) => {
                "check that the server takes requests of this length: raise its context".to_owned()
            }
            _ => "`memtransfer doctor --policy openai` shows what the server takes".to_owned(),
        }
    }

    /// Whether the server names the field as the fault: as the parameter or place of an error, or in a sentence that says that it
    /// is unknown or not supported.
    pub(crate) fn is_about(&self, field: &str) -> bool {
        self.names(field, false)
    }

    /// As [`is_about`](Self::is_about), for a field whose value may be refused too, which says nothing against the field itself.
    pub(crate) fn is_about_name(&self, field: &str) -> bool {
        self.names(field, true)
    }

    fn names(&self, field: &str, in_words: bool) -> bool {
        match &self.value {
            Some(value) => names_as_fault(value, field, in_words),
            None => sentence_names(&String::from_utf8_lossy(self.body), field),
        }
    }

    /// Whether the server asks for the field instead of another one: `use 'max_completion_tokens' instead`.
    pub(crate) fn asks_for(&self, field: &str) -> bool {
        let text = &self.text;
        text.match_indices(field).any(|(at, _)| {
            let before = text[..at].trim_end_matches(|c: char| !c.is_ascii_alphanumeric());
            ["use", "with", "by"].iter().any(|word| {
                before
                    .strip_suffix(word)
                    .is_some_and(|before| !before.ends_with(char::is_alphanumeric))
            })
        })
    }
}

/// Whether an error names `field` as the fault; with `in_words`, only where its words say so too.
fn names_as_fault(error: &Value, field: &str, in_words: bool) -> bool {
    match error {
        Value::String(text) => sentence_names(text, field),
        Value::Array(items) => items.iter().any(|item| names_as_fault(item, field, in_words)),
        Value::Object(fields) => {
            let parameter = fields.get("param").and_then(Value::as_str);
            let parameter = parameter.and_then(|name| name.rsplit('.').next());
            let location = fields.get("loc").and_then(Value::as_array);
            let is_located = location.is_some_and(|path| path.iter().any(|part| part == field));
            let words = || has_any(&error.to_string().to_lowercase(), &FAULT_WORDS);
            let is_named = parameter == Some(field) || is_located;
            (is_named && (!in_words || words()))
                || fields.iter().any(|(key, value)| {
                    !REPEATED.contains(&&**key) && names_as_fault(value, field, in_words)
                })
        }
        _ => false,
    }
}

/// Whether a sentence of the text has the field as a word, and says that something is unknown or not supported.
fn sentence_names(text: &str, field: &str) -> bool {
    let ends = |(at, end): (usize, char)| {
        let after = text[at + end.len_utf8()..].chars().next();
        matches!(end, '\n' | ';') || end == '.' && after.is_none_or(char::is_whitespace)
    };
    let ends =
        text.char_indices().filter(|found| ends(*found)).map(|(at, end)| at + end.len_utf8());
    let mut begin = 0;
    let mut sentences = Vec::new();
    for end in ends.chain([text.len()]) {
        sentences.push(&text[begin..end]);
        begin = end;
    }
    sentences.into_iter().any(|sentence| {
        let mut words = sentence.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        words.any(|word| word == field) && has_any(&sentence.to_lowercase(), &FAULT_WORDS)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(status: u16, body: &str) -> Refusal<'_> {
        Refusal::new(status, body.as_bytes())
    }

    #[test]
    fn a_field_is_at_fault_where_the_server_names_it_so() {
        for (field, body) in [
            ("temperature", r#"{"error":{"message":"Invalid value","param":"temperature"}}"#),
            (
                "temperature",
                r#"{"error":{"message":"Unsupported value: 'temperature' does not support 0 with this model. Only the default (1) value is supported."}}"#,
            ),
            ("temperature", r#"{"error":"`temperature` is deprecated for this model."}"#),
            (
                "reasoning_effort",
                r#"{"error":{"message":"Unsupported value: 'reasoning_effort' does not support 'none' with this model. Supported values are: 'low', 'medium', and 'high'."}}"#,
            ),
            ("thinking", r#"{"error":{"message":"thinking: Extra inputs are not permitted"}}"#),
            (
                "thinking_mode",
                r#"{"detail":[{"type":"extra_forbidden","loc":["body","thinking_mode"]}]}"#,
            ),
            ("thinking_mode", "body.thinking_mode: property unsupported"),
            ("grammar", "Unrecognized request arguments supplied: grammar, thinking"),
            (
                "enable_thinking",
                r#"[{"error":{"message":"Unknown name \"enable_thinking\": Cannot find field."}}]"#,
            ),
            (
                "response_format",
                r#"{"error":{"message":"This response_format type is unavailable now"}}"#,
            ),
        ] {
            assert!(refusal(400, body).is_about(field), "{body}");
        }
        for (field, body) in [
            (
                "thinking",
                r#"{"error":{"message":"The context length is 4096 tokens; thinking tokens count. Images are not supported."}}"#,
            ),
            (
                "max_tokens",
                r#"{"error":{"message":"'max_tokens' or 'max_completion_tokens' is too large: 30. Your request has 4090 tokens.","param":"input"}}"#,
            ),
            (
                "thinking",
                r#"{"detail":[{"loc":["body","messages"],"msg":"not supported","input":"thinking"}]}"#,
            ),
            ("grammar", r#"{"error":"unsupported: grammars"}"#),
        ] {
            assert!(!refusal(400, body).is_about(field), "{body}");
        }
    }

    #[test]
    fn the_bound_is_refused_by_its_name_and_not_by_its_value() {
        let unsupported = r#"{"error":{"message":"Unsupported parameter: 'max_tokens' is not supported with this model. Use 'max_completion_tokens' instead.","param":"max_tokens"}}"#;
        assert!(refusal(400, unsupported).is_about_name("max_tokens"));
        assert!(refusal(400, "use max_completion_tokens").asks_for("max_completion_tokens"));
        for body in [
            r#"{"error":{"message":"'max_tokens' or 'max_completion_tokens' is too large: 30. This model's maximum context length is 4096 tokens.","param":"max_tokens"}}"#,
            r#"{"error":{"message":"maximum context length is 4096 tokens; max_completion_tokens was reduced because of max_completion_tokens"}}"#,
        ] {
            let refusal = refusal(400, body);
            assert!(!refusal.is_about_name("max_tokens"), "{body}");
            assert!(!refusal.asks_for("max_completion_tokens"), "{body}");
        }
    }

    #[test]
    fn which_refusals_are_final_and_which_concern_every_request() {
        let quota = r#"{"error":{"message":"You exceeded your current quota, please check your plan and billing details.","code":"insufficient_quota"}}"#;
        let page = "<html><title>Forbidden</title></html>";
        for (status, body, is_final, is_permanent) in [
            (429, r#"{"error":"slow down"}"#, false, false),
            (429, quota, true, true),
            (429, "You exceeded your current quota. Please retry in 35.2s.", false, false),
            (400, "Your credit balance is too low", true, true),
            (402, "no", true, true),
            (403, "no", true, true),
            (403, "Your input was flagged", true, false),
            (404, "no such model", true, false),
            (404, page, true, true),
            (413, page, true, false),
            (500, "oh", false, false),
            (
                500,
                "After the optional system message, conversation roles must alternate",
                true,
                true,
            ),
            (503, page, false, true),
            (400, "Only user and assistant roles are supported, got system", true, true),
            (400, "at most 4 images", true, false),
            (400, "chat_template_kwargs must be an object", true, false),
        ] {
            let refusal = refusal(status, body);
            assert_eq!(
                (refusal.is_final(), refusal.is_permanent()),
                (is_final, is_permanent),
                "{status} {body}"
            );
        }
        for status in [408, 409, 421, 424, 425, 429, 499, 500, 503, 520, 529] {
            assert!(!refusal(status, "try again").is_final(), "{status}");
        }
    }

    #[test]
    fn advice_fits_the_refusal() {
        let image = crate::ContentPart::ImageUrl {
            image_url: crate::ImageUrl { url: "data:image/png;base64,AA==".into() },
        };
        let mut with_image = ChatRequest::text("?", 9);
        with_image.messages[0].content = crate::MessageContent::Parts(vec![image]);
        let advice = |status, body: &str| refusal(status, body).advice(&with_image, 9000, true);
        for (status, body, expected) in [
            (400, "Image count 6 exceeds limit 4", "the request has 1 image: lower --image-budget"),
            (400, "maximum context length is 4096 tokens", "lower --image-budget"),
            (413, "", "9000 bytes and 1 image,"),
            (402, "", "nothing left to spend"),
            (400, "Only user and assistant roles are supported, got system", "--system-role user"),
            (401, "", "check OPENAI_API_KEY"),
        ] {
            let advice = advice(status, body);
            assert!(advice.contains(expected), "{advice}");
        }
        for body in ["`temperature` is out of range", "no"] {
            assert!(!advice(400, body).contains("image"), "{body}");
        }
        let text =
            refusal(400, "maximum context length").advice(&ChatRequest::text("?", 9), 9, true);
        assert!(!text.contains("image"), "{text}");
    }
}
