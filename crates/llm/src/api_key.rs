//! The key to a chat endpoint, which is never printed.

use std::fmt;

/// What replaces a key in texts.
const MASK: &str = "[key]";

/// Bytes from which a key is masked where it stands alone.
const SECRET_LENGTH: usize = 8;

/// Bytes from which a key is masked wherever it occurs: no other text has that many in common with it.
const CERTAIN_LENGTH: usize = 16;

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

    /// `text`, which is about to be shown or stored, with the key masked: some servers repeat it.
    ///
    /// A text of fewer than [`SECRET_LENGTH`] characters is no secret: servers without authentication get keys such as
    /// `token` or `1`, which stand in every text. Up to [`CERTAIN_LENGTH`], only an occurrence that stands alone is masked, so
    /// that the key `lm-studio` leaves the model `lm-studio-community/a` as it is.
    pub(crate) fn masked_in(&self, text: &str) -> String {
        let key = self.expose();
        if key.len() < SECRET_LENGTH {
            return text.to_owned();
        }
        let continues = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_');
        let mut masked = String::with_capacity(text.len());
        let mut rest = text;
        while let Some(at) = rest.find(key) {
            let (before, found) = rest.split_at(at);
            let after = &found[key.len()..];
            let joins_before = before.chars().next_back().or_else(|| masked.chars().next_back());
            let stands_alone =
                !joins_before.is_some_and(continues) && !after.starts_with(continues);
            masked.push_str(before);
            masked.push_str(if stands_alone || key.len() >= CERTAIN_LENGTH { MASK } else { key });
            rest = after;
        }
        masked + rest
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
    }

    #[test]
    fn a_key_is_masked_and_a_common_word_is_not() {
        for (key, text, expected) in [
            ("sk-12345", "wrong key sk-12345!", "wrong key [key]!"),
            ("sk-12345", "sk-12345, sk-123456 and ask-12345", "[key], sk-123456 and ask-12345"),
            ("sk-12345", "sk-12345sk-12345", "sk-12345sk-12345"),
            ("lm-studio", "lm-studio-community/a for lm-studio", "lm-studio-community/a for [key]"),
            ("sk-1234567890abcdef", "xsk-1234567890abcdefsk-1234567890abcdef", "x[key][key]"),
            ("1", "status 1", "status 1"),
            ("token", "at most 30 token", "at most 30 token"),
            ("schlüssel-eins", "der schlüssel-eins.", "der [key]."),
        ] {
            assert_eq!(ApiKey::new(key).unwrap().masked_in(text), expected, "{key}");
        }
    }

    #[test]
    fn white_space_is_no_key() {
        assert_eq!(ApiKey::new(" \n"), None);
    }
}
