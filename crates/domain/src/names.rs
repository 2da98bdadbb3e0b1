//! Names of the members of closed sets, and errors that suggest the nearest name.
//!
//! A set is declared once with `named!`; flags, suite files, logs and tables use the same names.

use std::fmt;

/// A name that is not in its set.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct UnknownName {
    /// The kind of thing: "memory", "suite", ...
    pub what: &'static str,
    /// The unknown name.
    pub given: String,
    /// The known names.
    pub known: Vec<String>,
}

impl UnknownName {
    /// Makes the error for `given`, which is not one of the `known` names of a `what`.
    pub fn new<T: Into<String>>(
        what: &'static str,
        given: &str,
        known: impl IntoIterator<Item = T>,
    ) -> Self {
        Self { what, given: given.to_owned(), known: known.into_iter().map(Into::into).collect() }
    }
}

impl fmt::Display for UnknownName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "unknown {} `{}`", self.what, self.given)?;
        if let Some(nearest) = nearest(&self.given, &self.known) {
            write!(f, ": did you mean `{nearest}`?")?;
        }
        // A longer list does not help; `memtransfer ls` does.
        if (1..=32).contains(&self.known.len()) {
            write!(f, " (known: {})", self.known.join(", "))?;
        }
        Ok(())
    }
}

/// Returns the name in `known` that is most like `given`, if any is close.
pub fn nearest<'a, T: AsRef<str>>(given: &str, known: &'a [T]) -> Option<&'a str> {
    let given = given.to_lowercase();
    let likeness = |name: &str| strsim::jaro_winkler(&given, &name.to_lowercase());
    known
        .iter()
        .map(|name| (likeness(name.as_ref()), name.as_ref()))
        .filter(|(likeness, _)| *likeness >= 0.75)
        // The first of equals, so that the answer does not depend on how `max` breaks ties.
        .fold(None, |best: Option<(f64, &str)>, next| match best {
            Some(best) if best.0 >= next.0 => Some(best),
            _ => Some(next),
        })
        .map(|(_, name)| name)
}

/// Declares a closed set of named things: `Display`, `FromStr` and serde all use the name.
#[macro_export]
macro_rules! named {
    ($($(#[$doc:meta])* $name:ident, $what:literal {
        $($(#[$variant_doc:meta])* $variant:ident = $word:literal,)*
    })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[derive(serde::Serialize, serde::Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub enum $name { $($(#[$variant_doc])* $variant,)* }

        impl $name {
            /// Every member, in the order in which they are listed.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// The word for it.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $word,)* }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.name())
            }
        }

        impl std::str::FromStr for $name {
            type Err = $crate::names::UnknownName;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                let found = Self::ALL.iter().find(|member| member.name() == text);
                found.copied().ok_or_else(|| {
                    let known = Self::ALL.iter().map(|member| member.name());
                    $crate::names::UnknownName::new($what, text, known)
                })
            }
        }

        $crate::names::serde_as_text!($name);
    )*};
}

pub use crate::serde_as_text;
pub use named;

/// Whether a character steers a terminal instead of being shown: control characters, and those that change the direction of
/// the text after them.
pub fn steers_a_terminal(c: char) -> bool {
    let turns = matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || c.is_control()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_offered_when_there_is_one() {
        let known = ["working", "episodic"];
        for (given, expected) in [
            ("episodik", Some("episodic")),
            ("Working", Some("working")),
            ("work", Some("working")),
            ("zzz", None),
        ] {
            assert_eq!(nearest(given, &known), expected, "{given}");
        }
        insta::assert_snapshot!(
            UnknownName::new("memory", "episodik", known),
            @"unknown memory `episodik`: did you mean `episodic`? (known: working, episodic)"
        );
    }
}
