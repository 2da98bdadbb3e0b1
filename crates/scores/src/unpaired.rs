//! Episodes of a comparison that have no partner, and why.

use std::collections::BTreeSet;

use conditions::Condition;
use conditions::key::EpisodeKey;
use run_log::{EpisodeRecord, RunLog};
use serde::Serialize;

/// A side of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ComparedSide {
    /// The first.
    A,
    /// The second.
    B,
}

/// Why there is no finished episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Absence {
    /// It was given up because of a fault that is not the policy's.
    GivenUp,
    /// The run has it, and is not over.
    NotFinished,
    /// The run does not have it.
    NotRun,
}

impl Absence {
    /// The reason in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::GivenUp => "given up",
            Self::NotFinished => "not finished",
            Self::NotRun => "not run",
        }
    }
}

/// An episode that one side has finished and the other has not.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Unpaired {
    /// The case's id.
    pub case: String,
    /// The repetition.
    pub repetition: u32,
    /// The side that has it.
    pub finished_in: ComparedSide,
    /// Why the other side has not.
    pub absence: Absence,
}

/// What a run has of a condition.
pub(super) struct PlannedEpisodes<'a> {
    condition: Condition,
    given_up: BTreeSet<&'a str>,
    /// 0 where the run is over.
    repetitions: u32,
    /// The cases that a record of the run names, where these are all of its cases.
    cases: Option<BTreeSet<&'a str>>,
}

impl<'a> PlannedEpisodes<'a> {
    pub(super) fn of(log: &'a RunLog, condition: Condition) -> Self {
        let planned = log.manifest.episodes as usize;
        let runs = log.manifest.settings.runs();
        let own = runs.iter().find(|(planned, _)| *planned == condition);
        let is_over = log.episodes.len() + log.errors.len() >= planned;
        let all: usize = runs.iter().map(|(_, repetitions)| *repetitions as usize).sum();
        let cases: BTreeSet<&str> =
            log.episodes.iter().map(|record| record.case.as_str()).collect();
        let has_all = planned.checked_div(all).is_some_and(|count| cases.len() >= count);
        Self {
            condition,
            given_up: log.errors.iter().map(|error| error.key.as_str()).collect(),
            repetitions: own.filter(|_| !is_over).map_or(0, |(_, repetitions)| *repetitions),
            cases: has_all.then_some(cases),
        }
    }

    /// Why the run has not finished the episode of the case and repetition of `record`. A case that no record of a run names is
    /// taken for one of the run's as long as the run has more cases than its records name.
    pub(super) fn absence(&self, record: &EpisodeRecord) -> Absence {
        let (case, run) = (record.case.clone(), record.run);
        let is_known = |cases: &BTreeSet<&str>| cases.contains(case.as_str());
        let is_planned = run <= self.repetitions && self.cases.as_ref().is_none_or(is_known);
        let key = EpisodeKey { condition: self.condition, run, place: None, case };
        match (self.given_up.contains(key.to_string().as_str()), is_planned) {
            (true, _) => Absence::GivenUp,
            (false, true) => Absence::NotFinished,
            (false, false) => Absence::NotRun,
        }
    }
}
