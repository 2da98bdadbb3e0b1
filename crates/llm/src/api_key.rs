//! The key to a chat endpoint, which is never printed.

use std::fmt;

use serde_json::Value;

/// What replaces a key in texts.
const MASK: &str = "[key]";

/// A key. It has no `Display`, and its `Debug` shows a mask; only the request header contains the key itself.
#[derive(Clone, PartialEq, Eq)]
pub struct ApiKey(String);

impl ApiKey {
    /// `text` without surrounding white space; `None` when nothing is left.
    pub fn new(text: &str) -> Option<Self> {
        let text = text.trim();
        (!text.is_empty()).then(|| Self(text.to_owned()))
    }

    /// The key itself, for the request header.
    pub(crate) fn expose(&self) -> &str {
        let Self(key) = self;
        key
    }

    /// `text` with the key masked: some servers repeat it in their messages. In JSON the key may be written with escapes.
    pub(crate) fn masked_in(&self, text: &str) -> String {
        let masked = text.replace(self.expose(), MASK);
        if !masked.contains('\\') {
            return masked;
        }
        let Ok(mut value) = serde_json::from_str(&masked) else { return masked };
        if self.mask(&mut value) { value.to_string() } else { masked }
    }

    /// Masks the key in every string of `value`. Returns whether it was in one.
    fn mask(&self, value: &mut Value) -> bool {
        match value {
            Value::String(text) if text.contains(self.expose()) => {
                *text = text.replace(self.expose(), MASK);
                true
            }
            Value::Array(items) => items.iter_mut().fold(false, |any, item| self.mask(item) | any),
            Value::Object(fields) => {
                let any = fields.keys().any(|key| key.contains(self.expose()));
                let renamed = std::mem::take(fields).into_iter();
                *fields =
                    renamed.map(|(key, one)| (key.replace(self.expose(), MASK), one)).collect();
                fields.values_mut().fold(any, |any, field| self.mask(field) | any)
            }
            _ => false,
        }
    }
}

impl fmt::Debug for ApiKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ApiKey({MASK})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_never_printed() {
        let key = ApiKey::new(" sk-12345\n").unwrap();
        assert_eq!(key.expose(), "sk-12345");
        assert_eq!(format!("{:?} {:#?}", Some(&key), key), "Some(ApiKey([key])) ApiKey([key])");
        assert_eq!(key.masked_in("wrong key sk-12345!"), "wrong key [key]!");
        let escaped = r#"{"choices":[{"text":"sk\u002D12345\n"}],"sk-\u00312345":1}"#;
        assert_eq!(key.masked_in(escaped), r#"{"[key]":1,"choices":[{"text":"[key]\n"}]}"#);
        assert_eq!(key.masked_in(r#"{"a": "\n"}"#), r#"{"a": "\n"}"#);
    }

    #[test]
    fn white_space_is_no_key() {
        assert_eq!(ApiKey::new(" \n"), None);
    }
}
