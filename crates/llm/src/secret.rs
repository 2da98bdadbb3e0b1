//! The key to a chat endpoint, which nothing may print.

use std::fmt;

/// What stands in the place of a key.
const MASK: &str = "[key]";

/// A key. It has no `Display`, its `Debug` is a mask, and only the client's request header sees inside.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl Secret {
    /// `text` without the blanks around it; `None` when nothing is left.
    pub fn new(text: &str) -> Option<Self> {
        let text = text.trim();
        (!text.is_empty()).then(|| Self(text.to_owned()))
    }

    /// The key itself, for the header that carries it.
    pub(super) fn expose(&self) -> &str {
        let Self(key) = self;
        key
    }

    /// `text` with a mask wherever the key stands in it: servers have been seen to repeat it.
    pub(super) fn masked_in(&self, text: &str) -> String {
        text.replace(self.expose(), MASK)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Secret({MASK})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_never_printed() {
        let key = Secret::new(" sk-12345\n").unwrap();
        assert_eq!(key.expose(), "sk-12345");
        assert_eq!(format!("{:?} {:#?}", Some(&key), key), "Some(Secret([key])) Secret([key])");
        assert_eq!(key.masked_in("wrong key sk-12345!"), "wrong key [key]!");
    }

    #[test]
    fn blanks_are_no_key() {
        assert_eq!(Secret::new(" \n"), None);
    }
}
