//! The events of an episode that the log keeps beside its actions: arrivals before items, first sights.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::Cell;
use crate::names::{named, serde_as_text};

named! {
    /// The part of a task that an item fulfils (specification, section 3).
    Requirement, "requirement" {
        /// An instance of the first type.
        A = "A",
        /// An instance of the second type.
        B = "B",
        /// An item of the category.
        C = "C",
    }
}

/// An arrival before an item of the task. Written `12A@3,7`: after 12 steps, before an A, on the cell in column 3
/// and row 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Visit {
    /// Steps taken on arrival; 0 for the cell on which the episode starts.
    pub step: u32,
    /// The requirement that the item fulfils.
    pub requirement: Requirement,
    /// The item's standpoint.
    pub cell: Cell,
}

impl fmt::Display for Visit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}@{},{}", self.step, self.requirement, self.cell.x, self.cell.y)
    }
}

/// A text that is not a visit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a visit (write it like 12A@3,7: step, requirement, column, row)")]
pub struct BadVisit(String);

impl FromStr for Visit {
    type Err = BadVisit;

    fn from_str(text: &str) -> Result<Self, BadVisit> {
        let read = || {
            let (when, cell) = text.split_once('@')?;
            let (step, requirement) = when.split_at_checked(when.len().checked_sub(1)?)?;
            let (x, y) = cell.split_once(',')?;
            Some(Self {
                step: step.parse().ok()?,
                requirement: requirement.parse().ok()?,
                cell: Cell::new(x.parse().ok()?, y.parse().ok()?),
            })
        };
        read().ok_or_else(|| BadVisit(text.to_owned()))
    }
}

serde_as_text!(Visit);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn visits_are_read_as_they_are_written() {
        for text in ["0A@0,0", "12B@3,7", "200C@15,29"] {
            assert_eq!(text.parse::<Visit>().unwrap().to_string(), text);
        }
        for text in ["", "@", "12@3,7", "A@3,7", "12D@3,7", "12A@3", "12A@3,256", "12é@3,7"] {
            assert_eq!(text.parse::<Visit>(), Err(BadVisit(text.to_owned())));
        }
    }
}
