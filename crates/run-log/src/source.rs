//! Where an item of memory comes from, and its distance, as the columns `retrieved` and `distances` of the log write it.

use std::str::FromStr;

use domain::DemonstrationKind;

/// A step of a demonstration, or of an earlier episode of the same sequence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SourceStep {
    /// `o12`: step 12 of the case's original demonstration; `t03-07:o12`: of another case's.
    Demonstration {
        /// The id of the other case.
        case: Option<String>,
        /// The demonstration.
        kind: DemonstrationKind,
        /// The step: how many were taken before.
        step: u32,
    },
    /// `e12:3`: step 3 of the episode at position 12 of the sequence.
    Experience {
        /// The position.
        position: u32,
        /// The step.
        step: u32,
    },
}

/// The sources of one request: a word of the column. Empty for `-`. A part that cannot be read is left out.
pub fn sources(word: &str) -> Vec<SourceStep> {
    word.split('+').filter_map(|part| part.parse().ok()).collect()
}

/// How `distances` writes a distance; NaN is one that the memory does not tell.
pub fn distance_word(distance: f32) -> String {
    let rounded = (f64::from(distance) * 1e4).round() / 1e4;
    // Without the sign of a negative zero.
    if rounded.is_finite() { (rounded + 0.0).to_string() } else { "-".to_owned() }
}

/// The distances of the sources of one request: a word of `distances`.
pub fn distances(word: &str) -> Vec<Option<f64>> {
    word.split('+').map(|part| part.parse().ok().filter(|one: &f64| one.is_finite())).collect()
}

/// A text that is not a source.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a source (write it like o12, t03-07:o12 or e12:3)")]
pub struct BadSource(String);

impl FromStr for SourceStep {
    type Err = BadSource;

    fn from_str(text: &str) -> Result<Self, BadSource> {
        let read = || {
            let (before, view) = match text.rsplit_once(':') {
                Some((before, view)) => (Some(before), view),
                None => (None, text),
            };
            if let Some(position) = before.and_then(|before| before.strip_prefix('e'))
                && let (Ok(position), Ok(step)) = (position.parse(), view.parse())
            {
                return Some(Self::Experience { position, step });
            }
            let letter = view.chars().next()?;
            let kind = DemonstrationKind::ALL.into_iter().find(|kind| kind.letter() == letter)?;
            let step = view.get(1..)?.parse().ok()?;
            Some(Self::Demonstration { case: before.map(str::to_owned), kind, step })
        };
        read().ok_or_else(|| BadSource(text.to_owned()))
    }
}

impl SourceStep {
    /// It in words.
    pub fn in_words(&self) -> String {
        match self {
            Self::Demonstration { case, kind, step } => {
                let of = case.as_ref().map(|case| format!(" of {case}, another task"));
                let shown = match kind.is_reference() {
                    true => "test reference".to_owned(),
                    false => format!("demonstration `{}`", kind.name()),
                };
                format!("view {step} of the {shown}{}", of.unwrap_or_default())
            }
            Self::Experience { position, step } => {
                format!("view {step} of the episode at position {position} of this sequence")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_source_is_named() {
        let words = |word| sources(word).iter().map(SourceStep::in_words).collect::<Vec<_>>();
        insta::assert_snapshot!(words("o12+t03-07:n3+e4:0+?+t3+b0").join("\n"), @"
        view 12 of the demonstration `original`
        view 3 of the demonstration `nearby` of t03-07, another task
        view 0 of the episode at position 4 of this sequence
        view 3 of the test reference
        view 0 of the test reference
        ");
        assert!(words("-").is_empty());
        for text in ["", "o", "x3", "z3", "e4:", "é"] {
            assert_eq!(text.parse::<SourceStep>(), Err(BadSource(text.to_owned())));
        }
    }
}
