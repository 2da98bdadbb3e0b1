//! Whether a log says what its world makes of the episodes.

use std::collections::BTreeSet;
use std::fmt::{self, Debug};

use anyhow::{Result, ensure};
use case_book::act::EpisodeParts;
use domain::{Route, Start};
use run_log::{Ending, EpisodeRecord};
use serde::Serialize;

use crate::{RecordedRun, begin_of};

/// A field of a record that is not what its world makes of the episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The episode's key.
    pub key: String,
    /// The field.
    pub field: String,
    /// What the log has.
    pub logged: String,
    /// What the world says.
    pub acted: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, field, logged, acted } = self;
        write!(f, "{key}: {field:?} is {logged}, and {acted} by its world")
    }
}

/// Acts out every episode of `run` and compares: task, reference, steps, ending, sub-goals, when it ran into what the variant
/// changed, and the facts of its world, but for those of what is learned.
///
/// # Errors
/// When the world is not that of the run, or an episode does not fit it.
pub fn check_run(run: &RecordedRun) -> Result<Vec<Difference>> {
    let changed = run.changed_assets();
    ensure!(
        changed.is_empty(),
        "this program has another {} than the run had, so its episodes cannot be checked",
        changed.join(", another ")
    );
    let mut found = Vec::new();
    for record in &run.log.episodes {
        found.extend(check_episode(run, record)?);
    }
    Ok(found)
}

fn check_episode(run: &RecordedRun, record: &EpisodeRecord) -> Result<Vec<Difference>> {
    let RecordedRun { log, world, .. } = run;
    let (_, case) = world.case(record)?;
    // Episodes of streams begin at the new start.
    let (start, route) = match &record.stream {
        Some(_) => (Start::New, Route::Unchanged),
        None => (record.start, record.route),
    };
    let listed = case.reference(start, route).map(|listed| listed.begin);
    let begin = listed.or_else(|| begin_of(record));
    let parts = EpisodeParts { facts: true, reference: true, ..EpisodeParts::default() };
    let acted = world.act_in(record, world.variant(record)?, begin, parts)?;
    let is_complete = acted.sub_goals.len() == acted.required as usize;
    let last_met = acted.sub_goals.last().copied().unwrap_or(0);
    let (ending, steps) = match is_complete {
        true => (Ending::Complete, last_met),
        // That a task can no longer be completed is the world's to say.
        false if record.ending == Ending::Failed => (Ending::Failed, record.steps),
        false => (Ending::OutOfSteps, log.manifest.settings.max_steps),
    };
    let mut compared = Comparison { key: &record.key, found: Vec::new() };
    compared.field("task", &record.task, &acted.task);
    compared.field("steps", &record.steps, &steps);
    compared.field("ending", &record.ending, &ending);
    compared.field("sub_goals", &record.sub_goals, &acted.sub_goals);
    compared.field("required", &record.required, &acted.required);
    compared.field("conflict_at", &record.conflict_at, &acted.conflict_at);
    let facts = acted.facts.unwrap_or_default();
    let names: BTreeSet<&String> = record.world.keys().chain(facts.keys()).collect();
    // What is learned from an episode is not told when it is acted out, and earlier versions did not tell loops.
    let is_told = |name: &&String| match name.as_str() {
        "completes_in" => false,
        "loops" => record.world.contains_key("loops"),
        _ => true,
    };
    for name in names.into_iter().filter(is_told) {
        compared.field(name, &record.world.get(name), &facts.get(name));
    }
    let reference = acted.reference;
    let length = reference.as_ref().map(|reference| reference.length);
    compared.field("reference", &Some(record.reference), &length);
    let invalidated = reference.as_ref().map(|reference| reference.invalidated);
    if let Some(blocked) = &record.blocked {
        compared.field("invalidated", &Some(blocked.invalidated), &invalidated);
    }
    if let Some(stream) = &record.stream {
        compared.field("invalidated", &Some(stream.invalidated), &invalidated);
        let actions = reference.iter().flat_map(|reference| &reference.actions);
        let actions = world.declaration().letters(actions.copied().map(Some));
        compared.field("reference_actions", &stream.reference_actions, &actions);
    }
    Ok(compared.found)
}

/// Collects differences of one record.
struct Comparison<'a> {
    key: &'a str,
    found: Vec<Difference>,
}

impl Comparison<'_> {
    fn field<T: PartialEq + Debug>(&mut self, field: &str, logged: &T, acted: &T) {
        if logged != acted {
            let (logged, acted) = (format!("{logged:?}"), format!("{acted:?}"));
            let (key, field) = (self.key.to_owned(), field.to_owned());
            self.found.push(Difference { key, field, logged, acted });
        }
    }
}
