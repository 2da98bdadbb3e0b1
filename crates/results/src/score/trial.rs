//! The episodes of one condition, arranged as the formulas need them: by run, or by case.
//!
//! An episode that was given up because of a fault is here, too, without a record: it is an attempt that did
//! not succeed, and leaving it out would be a mean over survivors.

use std::collections::BTreeMap;

use super::spread::Spread;
use crate::conditions::Condition;
use crate::key::EpisodeKey;
use crate::log::{EpisodeRecord, RunLog};

/// One episode as the formulas see it.
#[derive(Debug, Clone, Copy)]
pub struct Trial<'a> {
    /// The case i.
    pub case: &'a str,
    /// Which repetition, from 1.
    pub run: u32,
    /// The number of its task; `None` when it was given up and no other episode tells.
    pub task: Option<u8>,
    /// What happened; `None` when it was given up.
    pub record: Option<&'a EpisodeRecord>,
}

impl Trial<'_> {
    /// s_i: every requirement met, in order, within T_max. Given up counts as not.
    pub fn is_success(&self) -> bool {
        self.record.is_some_and(EpisodeRecord::is_success)
    }

    /// What it adds to SPL: `s_i * l_i / max(p_i, l_i)`, and 0 / 0 taken as 1: an episode that begins done is
    /// done best.
    pub fn path_weight(&self) -> f64 {
        let Some(record) = self.record.filter(|record| record.is_success()) else { return 0.0 };
        match record.steps.max(record.reference) {
            0 => 1.0,
            longest => f64::from(record.reference) / f64::from(longest),
        }
    }

    /// b_i: whether the agent tried to enter a newly closed cell. `None` where there is none, and where the
    /// episode was given up: what it would have tried is not known.
    pub fn tried_closed(&self) -> Option<bool> {
        self.record?.tried_closed
    }
}

/// All episodes of one condition, by case and run.
#[derive(Debug, Clone, Default)]
pub struct Trials<'a> {
    list: Vec<Trial<'a>>,
}

impl<'a> Trials<'a> {
    /// Those of each condition that has an episode in `log`.
    pub fn by_condition(log: &'a RunLog) -> BTreeMap<Condition, Self> {
        let mut trials: BTreeMap<Condition, Self> = BTreeMap::new();
        let mut tasks: BTreeMap<&str, u8> = BTreeMap::new();
        for record in &log.episodes {
            tasks.insert(&record.case, record.task);
            let EpisodeRecord { case, run, task, .. } = record;
            let trial = Trial { case, run: *run, task: Some(*task), record: Some(record) };
            trials.entry(record.condition()).or_default().list.push(trial);
        }
        // Of an episode that was given up the key says all that is known.
        for error in &log.errors {
            let Some(key) = EpisodeKey::read(&error.key) else { continue };
            let case = &error.key[error.key.len() - key.case.len()..];
            let task = tasks.get(case).copied();
            let trial = Trial { case, run: key.run, task, record: None };
            trials.entry(key.condition).or_default().list.push(trial);
        }
        for Self { list } in trials.values_mut() {
            list.sort_by_key(|trial| (trial.case, trial.run));
        }
        trials
    }

    /// All of them, by case and run.
    pub fn iter(&self) -> impl Iterator<Item = &Trial<'a>> {
        self.list.iter()
    }

    /// The records of those that finished.
    pub fn records(&self) -> impl Iterator<Item = &'a EpisodeRecord> {
        self.list.iter().filter_map(|trial| trial.record)
    }

    /// The runs, each with its episodes.
    pub fn runs(&self) -> BTreeMap<u32, Vec<&Trial<'a>>> {
        let mut runs: BTreeMap<u32, Vec<&Trial<'a>>> = BTreeMap::new();
        for trial in &self.list {
            runs.entry(trial.run).or_default().push(trial);
        }
        runs
    }

    /// The cases, each with its repetitions.
    pub fn cases(&self) -> BTreeMap<&'a str, Vec<&Trial<'a>>> {
        let mut cases: BTreeMap<&'a str, Vec<&Trial<'a>>> = BTreeMap::new();
        for trial in &self.list {
            cases.entry(trial.case).or_default().push(trial);
        }
        cases
    }

    /// `figure` of each run by itself, over the runs in which it is defined; `None` when it is in none.
    pub fn over_runs(&self, figure: impl Fn(&[&Trial<'a>]) -> Option<f64>) -> Option<Spread> {
        let values: Vec<f64> = self.runs().values().filter_map(|trials| figure(trials)).collect();
        Spread::of(&values)
    }
}
