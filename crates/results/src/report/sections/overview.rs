//! What the run was, and what a reader must know before looking at its figures.

use domain::Representation;
use domain::representation::Description;

use crate::conditions::{Frames, PolicyKind};
use crate::report::document::{Block, Cell, Column, Group, Missing, Row, Table};
use crate::report::plot::PlotError;
use crate::report::view::{View, title};
use crate::table;

/// What must not be missed about the run.
fn notices(view: &View<'_>) -> Vec<String> {
    let settings = &view.log.manifest.settings;
    let mut notices = table::standing(settings);
    if settings.policy == PolicyKind::Grounded {
        notices.push(
            "The stand-in reads plates, labels and memory by rules, from the same request that a model would get. \
             So its figures show whether every part of the harness works. The paper's figures beside them are a \
             vision-language model's: closeness or distance between the two means nothing."
                .to_owned(),
        );
    }
    if settings.frames != Frames::Rendered {
        notices.push(
            "A control run shows what remains of the figures when the pixels say nothing true: compare it with a run \
             on rendered frames, not with the paper."
                .to_owned(),
        );
    }
    let scores = &view.scores;
    let left = scores.planned.saturating_sub(scores.finished + scores.errored);
    if left > 0 {
        notices.push(format!(
            "Not complete: {left} of {} episodes are missing. Figures are of those that finished.",
            scores.planned
        ));
    }
    if scores.errored > 0 {
        notices.push(format!(
            "{} episodes were given up because of faults that are not the policy's. They count as not successful.",
            scores.errored
        ));
    }
    notices
}

pub(super) fn blocks(view: &View<'_>) -> Result<Vec<Block>, PlotError> {
    let mut blocks: Vec<Block> = notices(view).into_iter().map(Block::Notice).collect();
    let (settings, scores) = (&view.log.manifest.settings, &view.scores);
    let cases = scores.conditions.iter().map(|score| score.cases).max().unwrap_or(0);
    let runs = scores.conditions.iter().map(|score| score.runs).max().unwrap_or(0);
    let speed = match scores.steps_per_s {
        Some(rate) => {
            let rate = table::steps_per_second(rate);
            Cell::Value(format!("{rate} steps/s with {} lanes", settings.lanes))
        }
        None => Cell::Missing(Missing::NotMeasured("the log holds no timings")),
    };
    let facts = [
        ("Policy", Cell::Value(settings.policy.to_string())),
        ("Suite", Cell::Value(settings.suite.to_string())),
        ("Conditions", Cell::Value(scores.conditions.len().to_string())),
        ("Cases", Cell::Value(cases.to_string())),
        ("Runs of each condition, at most", Cell::Value(runs.to_string())),
        ("Episodes finished", Cell::Value(format!("{} of {}", scores.finished, scores.planned))),
        ("Episodes given up", Cell::Value(scores.errored.to_string())),
        ("Speed", speed),
    ];
    blocks.push(Block::Table(facts_table(view.id("facts"), "The run in short.", facts)));
    let asked = "An agent has an instruction such as “Visit a blue barrel, then an orange cone.”, its pose and what it sees. \
                 Expert demonstrations of the same case were made into a memory before, in one of six representations; \
                 at every step a part of it is handed to the policy beside the last few steps. The tables ask what that \
                 is worth where the demonstration fits, from another start, with a passage blocked, and among other \
                 tasks' histories.";
    blocks.push(Block::Text(asked.to_owned()));
    let memory = |representation: &Representation| {
        let Description { stores, supplies, .. } = representation.describe();
        let meaning = format!("stores {stores}; supplies {supplies}");
        (title(*representation).to_owned(), meaning)
    };
    blocks.push(Block::Terms(Representation::ALL.iter().map(memory).collect()));
    Ok(blocks)
}

/// A table of facts, one a row.
pub(super) fn facts_table(
    id: String,
    caption: &str,
    facts: impl IntoIterator<Item = (impl Into<String>, Cell)>,
) -> Table {
    let row = |(label, cell): (_, Cell)| -> Row {
        Row { label: Into::into(label), published: false, cells: vec![cell] }
    };
    Table {
        id,
        caption: caption.to_owned(),
        stubs: vec!["Fact".to_owned()],
        columns: vec![Column::new("Value")],
        groups: vec![Group { label: None, rows: facts.into_iter().map(row).collect() }],
    }
}
