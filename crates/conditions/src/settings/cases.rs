//! The entries of `--cases`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use domain::names::serde_as_text;

/// One entry of `--cases`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum CaseSelector {
    /// `all`.
    All,
    /// `37`, or `1-10` with both ends: positions in the case file, counted from 1.
    Numbers(usize, usize),
    /// `t03-07`, or `t03` for all of its cases.
    Name(String),
    /// `t03-01..t04-10`, both ends included, in the order of the case file.
    Names(String, String),
}

/// A text that is not an entry of `--cases`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not a case (t03-07), a task (t03), a number (37) or a range (1-10, t03-01..t04-10)"
)]
pub struct BadSelector(String);

impl FromStr for CaseSelector {
    type Err = BadSelector;

    fn from_str(text: &str) -> Result<Self, BadSelector> {
        let text = text.trim();
        let bad = || BadSelector(text.to_owned());
        if text == "all" {
            return Ok(Self::All);
        }
        if let Some((first, last)) = text.split_once("..") {
            let named = !first.is_empty() && !last.is_empty();
            let range = || Self::Names(first.to_owned(), last.to_owned());
            return named.then(range).ok_or_else(bad);
        }
        let number = |text: &str| text.parse::<usize>().ok().filter(|&n| n > 0);
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        match (number(first), number(last)) {
            (Some(first), Some(last)) if first <= last => Ok(Self::Numbers(first, last)),
            _ if text.starts_with(|c: char| c.is_ascii_alphabetic()) => {
                Ok(Self::Name(text.to_owned()))
            }
            _ => Err(bad()),
        }
    }
}

impl fmt::Display for CaseSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => write!(f, "all"),
            Self::Numbers(first, last) if first == last => write!(f, "{first}"),
            Self::Numbers(first, last) => write!(f, "{first}-{last}"),
            Self::Name(name) => write!(f, "{name}"),
            Self::Names(first, last) => write!(f, "{first}..{last}"),
        }
    }
}

serde_as_text!(CaseSelector);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selectors_are_read_as_they_are_written() {
        for text in ["all", "t02-01", "t02", "1", "2-4", "t01-02..t02-02"] {
            assert_eq!(text.parse::<CaseSelector>().unwrap().to_string(), text);
        }
        insta::assert_snapshot!("0".parse::<CaseSelector>().unwrap_err(), @"`0` is not a case (t03-07), a task (t03), a number (37) or a range (1-10, t03-01..t04-10)");
        for text in ["7-5", "..", "", "t01-01.."] {
            assert!(text.parse::<CaseSelector>().is_err(), "{text}");
        }
    }
}
