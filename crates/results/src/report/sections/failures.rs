//! Failures by kind.

use domain::Representation;

use crate::report::document::{Block, Cell, Column, Group, Missing, Row, Table};
use crate::report::plot::{PlotError, Stack, StackRow, stack};
use crate::report::view::{View, name, title};
use crate::score::{ConditionScore, Failure};

/// The settings that are shown, as in the first table.
const SETTINGS: [(&str, &str, &str); 4] = [
    ("original, 1 demo", "original/unchanged", "original"),
    ("new, 1 demo", "new/unchanged", "original"),
    ("new, 4 demos", "new/unchanged", "4"),
    ("blocked, 4 demos", "new/blocked", "4"),
];

pub(super) fn blocks(view: &View<'_>) -> Result<Vec<Block>, PlotError> {
    let text = "Each failed episode is of one kind: the first rule that applies, in the order of the columns. First \
                comes how an episode went wrong, then what was missing. Kinds of which there is none have no column.";
    let terms = Failure::ALL.iter().map(|kind| (kind.name().to_owned(), kind.meaning().to_owned()));
    let given_up =
        ("given up".to_owned(), "a fault that is not the policy's ended the episode".to_owned());
    let bars = Representation::ALL.iter().flat_map(|&representation| {
        SETTINGS.map(|(label, rest, demonstrations)| StackRow {
            label: format!("{}: {label}", title(representation)),
            lengths: view.score(&name(representation, rest, demonstrations)).map(shares),
        })
    });
    let figure = stack(&Stack {
        id: view.id("failures-figure"),
        caption: "Why episodes failed: kinds as a percentage of all episodes of the condition. What is missing to 100 \
                  succeeded."
            .to_owned(),
        axis: "Failed episodes, % of all",
        to: Some(100.0),
        parts: kinds(),
        rows: bars.collect(),
    })?;
    let mut blocks =
        vec![Block::Text(text.to_owned()), Block::Terms(terms.chain([given_up]).collect())];
    blocks.extend([Block::Figure(figure), Block::Table(table(view))]);
    Ok(blocks)
}

fn kinds() -> Vec<String> {
    let names = Failure::ALL.iter().map(|kind| kind.name().to_owned());
    names.chain(["given up".to_owned()]).collect()
}

fn counts(score: &ConditionScore) -> Vec<usize> {
    score.failures.iter().map(|(_, count)| count).chain([score.errored]).collect()
}

fn shares(score: &ConditionScore) -> Vec<f64> {
    counts(score).iter().map(|&count| 100.0 * count as f64 / score.episodes as f64).collect()
}

/// Counts under every condition that was run.
fn table(view: &View<'_>) -> Table {
    let scores = &view.scores.conditions;
    let there = |kind: &usize| scores.iter().any(|score| counts(score)[*kind] > 0);
    let present: Vec<usize> = (0..kinds().len()).filter(there).collect();
    let mut columns = vec![Column::new("Episodes"), Column::new("Failed")];
    let kinds = kinds();
    columns.extend(present.iter().map(|&kind| Column::under("Of these", kinds[kind].clone())));
    let row = |score: &ConditionScore| {
        let counts = counts(score);
        let all: usize = counts.iter().sum();
        let figures =
            [score.episodes, all].into_iter().chain(present.iter().map(|&kind| counts[kind]));
        Row {
            label: score.condition.to_string(),
            published: false,
            cells: figures.map(|count| Cell::Value(count.to_string())).collect(),
        }
    };
    let mut rows: Vec<Row> = scores.iter().map(row).collect();
    if rows.is_empty() {
        let cells = vec![Cell::Missing(Missing::NotRun); columns.len()];
        rows.push(Row { label: "no condition".to_owned(), published: false, cells });
    }
    Table {
        id: view.id("failures"),
        caption: "Failed episodes by kind, counts over all runs.".to_owned(),
        stubs: vec!["Condition".to_owned()],
        columns,
        groups: vec![Group { label: None, rows }],
    }
}
