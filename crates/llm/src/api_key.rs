//! The key to a chat endpoint, which is never printed.

use std::fmt;

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

    /// `text` with the key masked: some servers repeat it in their messages.
    pub(crate) fn masked_in(&self, text: &str) -> String {
        text.replace(self.expose(), MASK)
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
    }

    #[test]
    fn white_space_is_no_key() {
        assert_eq!(ApiKey::new(" \n"), None);
    }
}
