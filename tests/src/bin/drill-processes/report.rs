//! What a drill found, as a file that `cargo xtask drill` reads.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use serde_json::json;

/// The result of one drill.
pub(crate) struct Report {
    text: &'static str,
    faults: BTreeMap<String, u64>,
    figures: BTreeMap<String, f64>,
    violations: Vec<String>,
    skipped: Vec<String>,
    began: Instant,
}

impl Report {
    pub(crate) fn new(text: &'static str) -> Self {
        Self {
            text,
            faults: BTreeMap::new(),
            figures: BTreeMap::new(),
            violations: Vec::new(),
            skipped: Vec::new(),
            began: Instant::now(),
        }
    }

    /// Counts a fault that took place.
    pub(crate) fn fault(&mut self, class: &str) {
        *self.faults.entry(class.to_owned()).or_default() += 1;
    }

    /// Adds to a figure.
    pub(crate) fn add(&mut self, figure: &str, more: f64) {
        *self.figures.entry(figure.to_owned()).or_default() += more;
    }

    /// The number of faults so far.
    pub(crate) fn faults(&self) -> u64 {
        self.faults.values().sum()
    }

    /// The time since the drill began, in seconds.
    pub(crate) fn seconds(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Records, and prints, what was found beside what `what` names.
    pub(crate) fn outcome(&mut self, what: &str, outcome: Result<(), String>) {
        if let Err(violation) = outcome {
            eprintln!("VIOLATION: {what}: {violation}");
            self.violations.push(format!("{what}: {violation}"));
        }
    }

    /// Records that a part of the drill cannot take place here.
    pub(crate) fn skip(&mut self, why: &str) {
        eprintln!("skipped: {why}");
        self.skipped.push(why.to_owned());
    }

    pub(crate) fn is_clean(&self) -> bool {
        self.violations.is_empty()
    }

    /// The report as JSON, with the arguments that repeat the drill.
    pub(crate) fn summary(&self) -> String {
        let mut figures = self.figures.clone();
        figures.insert("minutes".to_owned(), (self.seconds() / 6.0).round() / 10.0);
        let arguments: Vec<String> = std::env::args().skip(1).collect();
        let report = json!({
            "arguments": arguments.join(" "),
            "text": self.text,
            "skipped": self.skipped,
            "faults": self.faults,
            "figures": figures,
            "violations": self.violations,
        });
        format!("{report:#}")
    }

    /// Writes the report. Called also while the drill goes on, so that a drill that is ended has one.
    pub(crate) fn write(&self, file: &Path) -> Result<(), String> {
        std::fs::write(file, format!("{}\n", self.summary()))
            .map_err(|error| format!("cannot write {}: {error}", file.display()))
    }
}
