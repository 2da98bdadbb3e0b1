//! Whether a log says what its world makes of the episodes.

use std::fmt::{self, Debug};

use anyhow::{Result, ensure};
use case_book::act::{EpisodeEvents, EpisodeParts};
use domain::{Action, Route, Start};
use run_log::{Ending, EpisodeRecord};
use serde::Serialize;

use crate::RecordedRun;

/// A field of a record that is not what its world makes of the episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The episode's key.
    pub key: String,
    /// The field.
    pub field: &'static str,
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

/// Acts out every episode of `run` and compares: task, reference, start, steps, ending, sub-goals, visits, first sights, blocked
/// moves, tries to enter a closed cell, final pose.
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
    let begin = case.reference(start, route).map_or(record.start_pose, |listed| listed.begin);
    let parts = EpisodeParts { events: true, reference: true, ..EpisodeParts::default() };
    let acted = world.act_in(record, world.variant(record)?, begin, parts)?;
    let events = acted.events.unwrap_or_default();
    let EpisodeEvents { visits, first_seen, blocked_moves, tried_closed_at } = events;
    let is_complete = acted.sub_goals.len() == acted.required as usize;
    let last_met = acted.sub_goals.last().copied().unwrap_or(0);
    let (ending, steps) = match is_complete {
        true => (Ending::Complete, last_met),
        false => (Ending::OutOfSteps, log.manifest.settings.max_steps),
    };
    let is_blocked = record.route == Route::Blocked;
    let tried_closed_at = tried_closed_at.filter(|_| is_blocked);
    let mut compared = Comparison { key: &record.key, found: Vec::new() };
    compared.field("start_pose", &record.start_pose, &begin);
    compared.field("task", &record.task, &acted.task);
    compared.field("steps", &record.steps, &steps);
    compared.field("ending", &record.ending, &ending);
    compared.field("sub_goals", &record.sub_goals, &acted.sub_goals);
    compared.field("required", &record.required, &acted.required);
    compared.field("visits", &record.visits, &visits);
    compared.field("first_seen", &record.first_seen, &first_seen);
    compared.field("blocked_moves", &record.blocked_moves, &blocked_moves);
    compared.field("tried_closed_at", &record.tried_closed_at, &tried_closed_at);
    compared.field(
        "tried_closed",
        &record.tried_closed,
        &is_blocked.then_some(tried_closed_at.is_some()),
    );
    compared.field("final_pose", &Some(record.final_pose), &acted.poses.last().copied());
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
        let actions: String = actions.map(|action| Action::letter(*action)).collect();
        // Earlier logs do not have it.
        if !stream.reference_actions.is_empty() {
            compared.field("reference_actions", &stream.reference_actions, &actions);
        }
    }
    Ok(compared.found)
}

/// Collects differences of one record.
struct Comparison<'a> {
    key: &'a str,
    found: Vec<Difference>,
}

impl Comparison<'_> {
    fn field<T: PartialEq + Debug>(&mut self, field: &'static str, logged: &T, acted: &T) {
        if logged != acted {
            let (logged, acted) = (format!("{logged:?}"), format!("{acted:?}"));
            self.found.push(Difference { key: self.key.to_owned(), field, logged, acted });
        }
    }
}
