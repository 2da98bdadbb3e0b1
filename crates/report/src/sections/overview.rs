//! What was run, and what a reader must know before looking at the figures.

use std::collections::BTreeSet;

use conditions::{Condition, Frames};
use domain::representation::RepresentationInfo;
use domain::{Appearance, Representation};
use run_log::answers::WithoutAction;
use run_log::usage::UsageTotals;
use run_log::{EpisodeError, EpisodeRecord, ExternalMemoryFacts, Manifest};
use scores::RequestScore;

use super::documents;
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::ScoredRun;

/// What gets the missing episodes, as the rest of a sentence.
pub(super) fn how_to_continue(view: &ScoredRun<'_>) -> &'static str {
    match view.log.errors.iter().any(EpisodeError::is_final) {
        true => {
            "a sequence whose snapshot is damaged cannot go on: errors.jsonl says what to delete before the same command \
             continues the run"
        }
        false => "the same command continues the run",
    }
}

/// Notices for the reader of the figures: the policy, controls, missing episodes, damaged lines.
pub(crate) fn notices(view: &ScoredRun<'_>) -> Vec<String> {
    let mut notices = standing(&view.log.manifest);
    let scores = &view.scores;
    if scores.missing() > 0 {
        notices.push(format!(
            "Incomplete: {} of {} episodes are missing, {} of them given up after a fault (errors.jsonl). Figures are \
             over finished episodes; {}.",
            scores.missing(),
            scores.planned,
            scores.errored,
            how_to_continue(view)
        ));
    }
    notices.extend(answers(view));
    notices.extend(documents::accounts(view));
    for score in scores.conditions.iter().take(MOST_BOUNDS) {
        if let Some(bounds) = &score.bounds {
            notices.push(format!(
                "{}: the missing episodes allow an SR from {:.1} to {:.1} % and an SPL from {:.3} to {:.3}.",
                score.condition, bounds.sr.low, bounds.sr.high, bounds.spl.low, bounds.spl.high
            ));
        }
    }
    let damaged = view.log.damaged.iter().take(MOST_DAMAGED);
    notices.extend(damaged.map(|line| format!("Damaged and left out: {line}.")));
    if let Some(more) = view.log.damaged.len().checked_sub(MOST_DAMAGED).filter(|more| *more > 0) {
        notices.push(format!("Damaged and left out: {more} more lines."));
    }
    notices
}

/// That a model's answers have no action, or were not all given to this run.
fn answers(view: &ScoredRun<'_>) -> Vec<String> {
    let mut notices: Vec<String> = view.log.varies().into_iter().collect();
    if let Some(silent) = WithoutAction::of_run(view.log) {
        notices.push(silent.described(view.log.manifest.settings.model.as_ref()));
    }
    if let Some(UsageTotals { requests, replayed: replayed @ 1.., .. }) =
        RequestScore::of_run(view.log).map(|score| score.usage)
    {
        notices.push(format!(
            "{replayed} of {} answers came from the reply cache; tokens, latency and cost of requests are of the others.",
            requests + replayed
        ));
    }
    notices
}

/// Maximum number of conditions whose bounds are printed.
const MOST_BOUNDS: usize = 12;
/// Maximum number of damaged lines that are named.
const MOST_DAMAGED: usize = 5;

/// What a command stands for that `evaluate` of the Python package has made: an object of its caller, which the last word describes.
/// `None` for other commands.
fn object_in(command: &str) -> Option<&str> {
    let (start, object) = command.strip_suffix('\'')?.rsplit_once('\'')?;
    start.contains("$_MEMTRANSFER_RELAY").then_some(object)
}

/// The policy, and whether the frames were a control.
fn standing(manifest: &Manifest) -> Vec<String> {
    let settings = &manifest.settings;
    let mut lines = vec![manifest.policy_label().sentence("Policy")];
    match (&settings.world_cmd, settings.own_world()) {
        (Some(command), _) => lines.push(format!("The world was started with `{command}`.")),
        (None, Some(_)) => lines.push("The world was started by the user.".to_owned()),
        (None, None) => {}
    }
    if let Some(command) = &settings.policy_cmd {
        lines.push(match object_in(command) {
            Some(object) => format!("The policy is {object}."),
            None => format!("The policy was started with `{command}`."),
        });
    }
    match settings.frames {
        Frames::Rendered => {}
        Frames::BlankAll => lines.push(
            "Control: all frames were blank, those of memory too, and memory supplied no texts. Compare with a run on \
             rendered frames, not with the paper."
                .to_owned(),
        ),
        control => lines.push(format!(
            "Control: observed frames were {control}; the views and texts that memory supplied were left as they are. \
             Compare with a run on rendered frames, not with the paper."
        )),
    }
    let appearance = settings.appearance();
    if settings.own_world().is_none() && appearance != Appearance::STANDARD {
        lines.push(format!("Appearance of the world: {appearance}."));
    }
    lines
}

/// That the frames of the run `manifest` had plates, for a reader who compares its figures with the paper's.
pub(super) fn had_plates(manifest: &Manifest) -> Option<String> {
    let settings = &manifest.settings;
    (settings.own_world().is_none() && settings.appearance().plates).then(|| {
        "The frames of this run had plates, coloured codes above items, which the paper's warehouse lacks.".to_owned()
    })
}

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let notices = notices(view).into_iter().chain(documents::beside_the_paper(view));
    let mut blocks: Vec<ReportBlock> = notices.map(ReportBlock::Notice).collect();
    let (settings, scores) = (&view.log.manifest.settings, &view.scores);
    let cases = scores.conditions.iter().map(|score| score.cases).max().unwrap_or(0);
    let runs = scores.conditions.iter().map(|score| score.runs).max().unwrap_or(0);
    // Of streams, too.
    let records = &view.log.episodes;
    let conditions: BTreeSet<Condition> = records.iter().map(EpisodeRecord::condition).collect();
    let of_streams = records.iter().filter(|record| record.stream.is_some());
    let streamed: BTreeSet<&str> = of_streams.clone().map(|record| record.case.as_str()).collect();
    let cases = cases.max(streamed.len());
    let runs = runs.max(of_streams.map(|record| record.run as usize).max().unwrap_or(0));
    let speed = match scores.steps_per_s {
        Some(rate) => {
            let rate = steps_per_second(rate);
            TableCell::Value(format!("{rate} steps/s with {} lanes", settings.lanes))
        }
        None => TableCell::Missing(Missing::NotMeasured("the log holds no timings")),
    };
    let facts = [
        ("Policy", TableCell::Value(view.log.manifest.policy_label().to_string())),
        ("Suite", TableCell::Value(settings.suite.to_string())),
        ("Conditions", TableCell::Value(conditions.len().to_string())),
        ("Cases", TableCell::Value(cases.to_string())),
        ("Runs of each condition, at most", TableCell::Value(runs.to_string())),
        (
            "Episodes finished",
            TableCell::Value(format!("{} of {}", scores.finished, scores.planned)),
        ),
        ("Episodes given up", TableCell::Value(scores.errored.to_string())),
        ("Speed", speed),
    ];
    let streams = scores.streams.iter().flat_map(|found| {
        [
            ("Streams", TableCell::Value(found.streams.to_string())),
            (
                "Sequences complete",
                TableCell::Value(format!("{} of {}", found.sequences, found.planned)),
            ),
        ]
    });
    let facts = facts.into_iter().chain(streams);
    blocks.push(ReportBlock::Table(facts_table(view.id("facts"), "Summary of the run.", facts)));
    let agent = match settings.own_world() {
        None => {
            "has an instruction such as “Visit a blue barrel, then an orange cone.”, its pose and what it sees"
        }
        Some(_) => "has an instruction, its state and what it sees",
    };
    blocks.push(ReportBlock::Text(format!(
        "An agent {agent}. Every memory except working memory is built from expert demonstrations beforehand; at every step the \
         policy gets a part of it in addition to the last few steps."
    )));
    let memory = |representation: &Representation| {
        let RepresentationInfo { stores, supplies, .. } = representation.describe();
        let meaning = format!("stores {stores}; supplies {supplies}");
        (view.label((*representation).into()), meaning)
    };
    let external = view.log.manifest.memories.iter().map(|(name, facts)| {
        let ExternalMemoryFacts { version, command, scope, .. } = facts;
        let started = match command {
            Some(command) => object_in(command)
                .map_or_else(|| format!("started with `{command}`"), str::to_owned),
            None => "started by the user".to_owned(),
        };
        let scope = match scope.as_str() {
            _ if view.log.manifest.settings.stream.is_some() => {
                "remembers the demonstrations of the cases of its stream".to_owned()
            }
            "all" => "remembers the demonstrations of all cases".to_owned(),
            "case" => "remembers the demonstrations of the episode's case".to_owned(),
            other => format!("scope {other}"),
        };
        (name.to_string(), format!("external memory, version {version}, {started}; {scope}"))
    });
    let has_run = |representation: &&Representation| {
        conditions.iter().any(|condition| condition.memory == **representation)
    };
    let terms = Representation::ALL.iter().filter(has_run).map(memory).chain(external);
    blocks.push(ReportBlock::Terms(terms.collect()));
    blocks
}

/// Formats a rate: a slow one with a digit after the point.
pub(crate) fn steps_per_second(rate: f64) -> String {
    if rate < 10.0 { format!("{rate:.1}") } else { format!("{rate:.0}") }
}

/// A table of facts, one in each row.
pub(super) fn facts_table(
    id: String,
    caption: &str,
    facts: impl IntoIterator<Item = (impl Into<String>, TableCell)>,
) -> Table {
    let row = |(label, cell)| TableRow::new(label, vec![cell]);
    Table {
        id,
        caption: caption.to_owned(),
        stubs: vec!["Fact".to_owned()],
        columns: vec![TableColumn::text("Value")],
        groups: vec![RowGroup { label: None, rows: facts.into_iter().map(row).collect() }],
    }
}

#[cfg(test)]
mod tests {
    use super::object_in;

    #[test]
    fn the_command_of_an_object_says_what_the_object_is() {
        let object = r#"sh -c 'exec "$_MEMTRANSFER_PYTHON" -IS "$_MEMTRANSFER_RELAY" memory nearest' 'an object of class Nearest of the calling program'"#;
        assert_eq!(object_in(object), Some("an object of class Nearest of the calling program"));
        for other in ["python my_memory.py", "sh -c 'exec program' 'a word'", "'"] {
            assert_eq!(object_in(other), None, "{other}");
        }
    }
}
