//! The result of validation, as a value and as text.

use std::fmt;

use serde::Serialize;

/// Violations of a constraint that the text of a report lists.
const MAX_PRINTED: usize = 3;

/// The result of validation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ValidationReport {
    /// One result for each constraint.
    pub lines: Vec<ConstraintResult>,
    /// Statistics of each kind of histories of other tasks.
    pub mixtures: Vec<HistoryStatistics>,
}

/// The result for one constraint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ConstraintResult {
    /// The constraint, as a statement.
    pub constraint: &'static str,
    /// How often it was checked.
    pub checked: usize,
    /// The violations.
    pub violations: Vec<String>,
}

impl ValidationReport {
    /// The number of violations of all constraints.
    pub fn violations(&self) -> usize {
        self.lines.iter().map(|line| line.violations.len()).sum()
    }

    /// Whether every constraint was checked at least once and none is violated.
    pub fn is_clean(&self) -> bool {
        self.violations() == 0 && self.lines.iter().all(|line| line.checked > 0)
    }

    /// Adds a constraint with the results of all its checks.
    pub(super) fn push(
        &mut self,
        constraint: &'static str,
        results: impl IntoIterator<Item = Result<(), String>>,
    ) {
        let mut line = ConstraintResult { constraint, checked: 0, violations: Vec::new() };
        for result in results {
            line.checked += 1;
            line.violations.extend(result.err());
        }
        self.lines.push(line);
    }
}

impl fmt::Display for ValidationReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for ConstraintResult { constraint, checked, violations } in &self.lines {
            let verdict = if violations.is_empty() && *checked > 0 { "ok  " } else { "FAIL" };
            writeln!(
                f,
                "{verdict} {checked:>5} checked {:>4} violated  {constraint}",
                violations.len()
            )?;
            for violation in violations.iter().take(MAX_PRINTED) {
                writeln!(f, "           {violation}")?;
            }
            if violations.len() > MAX_PRINTED {
                writeln!(f, "           and {} more", violations.len() - MAX_PRINTED)?;
            }
        }
        self.mixtures.iter().try_for_each(|statistics| writeln!(f, "{statistics}"))
    }
}

/// Statistics of one kind of histories of other tasks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct HistoryStatistics {
    /// The kind: irrelevant or confusable.
    pub mixture: &'static str,
    /// The number of histories, over all cases.
    pub listed: usize,
    /// The number of different histories.
    pub different: usize,
    /// The number of cases that they are demonstrations of.
    pub cases: usize,
    /// Poses that each shares with the test reference.
    pub shared_poses: CountRange,
    /// Shared poses from which each continues differently.
    pub conflicts: CountRange,
}

/// Minimum, upper median and maximum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct CountRange {
    /// The minimum.
    pub least: usize,
    /// The median, the upper one of two.
    pub median: usize,
    /// The maximum.
    pub most: usize,
}

impl CountRange {
    /// `None` without numbers.
    pub(super) fn of(numbers: impl Iterator<Item = usize>) -> Option<Self> {
        let mut numbers: Vec<usize> = numbers.collect();
        numbers.sort_unstable();
        let (&least, &most) = (numbers.first()?, numbers.last()?);
        Some(Self { least, median: numbers[numbers.len() / 2], most })
    }
}

impl fmt::Display for CountRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { least, median, most } = self;
        if least == most {
            return write!(f, "{least}");
        }
        write!(f, "{least} to {most} (median {median})")
    }
}

impl fmt::Display for HistoryStatistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { mixture, listed, different, cases, shared_poses, conflicts } = self;
        write!(
            f,
            "{mixture}: {listed} histories, {different} different ones of {cases} cases\n           shared poses \
             {shared_poses}, conflicts {conflicts}"
        )
    }
}

/// The violation, unless `holds`.
pub(super) fn ensure(holds: bool, violation: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(violation()) }
}

pub(super) fn equal<T: PartialEq + fmt::Debug>(
    what: &str,
    found: T,
    expected: T,
) -> Result<(), String> {
    ensure(found == expected, || format!("{what}: {found:?} instead of {expected:?}"))
}

pub(super) fn at_least(what: &str, found: usize, least: usize) -> Result<(), String> {
    ensure(found >= least, || format!("{found} {what}; at least {least} are needed"))
}
