//! The name of an episode in the log.

use std::fmt;

use crate::conditions::Condition;

/// Names an episode: `memory/start/route/demonstrations/run/case`, for example
/// `episodic/new/unchanged/4/run2/t03-07`. Unique in a run.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EpisodeKey {
    /// The condition.
    pub condition: Condition,
    /// The repetition, from 1.
    pub run: u32,
    /// The case's id.
    pub case: String,
}

impl fmt::Display for EpisodeKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { condition, run, case } = self;
        write!(f, "{condition}/run{run}/{case}")
    }
}

impl EpisodeKey {
    /// Parses what [`Display`](fmt::Display) writes, with any memory; `None` for any other text.
    pub fn read(text: &str) -> Option<Self> {
        let (rest, case) = text.rsplit_once('/')?;
        let (condition, run) = rest.rsplit_once("/run")?;
        let (condition, run) = (Condition::logged(condition).ok()?, run.parse().ok()?);
        Some(Self { condition, run, case: case.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_read_as_it_is_written() {
        for text in [
            "working/original/unchanged/none/run1/t01-01",
            "episodic/new/unchanged/4/run12/t03-07",
            "episodic/original/unchanged/original/h20/images/no-hint/run1/a",
            "run1/new/unchanged/4/run1/run2",
        ] {
            assert_eq!(EpisodeKey::read(text).unwrap().to_string(), text);
        }
        for text in ["", "episodic/new/unchanged/4/t03-07", "episodic/new/unchanged/4/run/t03-07"] {
            assert_eq!(EpisodeKey::read(text), None, "{text}");
        }
    }
}
