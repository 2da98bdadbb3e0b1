//! Several runs beside each other: what they were, and the conditions that they share, paired by case.

use super::pairs::{cells, columns};
use crate::compare::{compare_runs, run_name};
use crate::report::document::{Block, Cell, Column, Group, Row, Section, Table};
use crate::report::view::View;
use crate::table;

/// The sections about all of the runs together.
pub(in crate::report) fn runs(views: &[View<'_>]) -> Vec<Section> {
    let row = |view: &View<'_>| {
        let settings = &view.log.manifest.settings;
        let facts = [
            settings.policy.to_string(),
            settings.suite.to_string(),
            settings.frames.to_string(),
            view.scores.conditions.len().to_string(),
            format!("{} of {}", view.scores.finished, view.scores.planned),
        ];
        Row { label: run_name(view.log), published: false, cells: facts.map(Cell::Value).to_vec() }
    };
    let overview = Table {
        id: "runs".to_owned(),
        caption: "The runs of this report. Each has its own sections below.".to_owned(),
        stubs: vec!["Run".to_owned()],
        columns: ["Policy", "Suite", "Frames", "Conditions", "Episodes"].map(Column::new).to_vec(),
        groups: vec![Group { label: None, rows: views.iter().map(row).collect() }],
    };
    let standing = views.iter().flat_map(|view| {
        let lines = table::standing(&view.log.manifest.settings).into_iter();
        lines.map(|line| Block::Notice(format!("{}: {line}", run_name(view.log))))
    });
    let mut blocks: Vec<Block> = standing.chain([Block::Table(overview)]).collect();
    for (later, second) in views.iter().enumerate() {
        for first in &views[..later] {
            blocks.push(compared(first, second));
        }
    }
    let title = "The runs compared".to_owned();
    vec![Section { id: "s-runs".to_owned(), level: 2, title, blocks }]
}

fn compared(first: &View<'_>, second: &View<'_>) -> Block {
    let compared = match compare_runs(first.log, second.log) {
        Ok(compared) => compared,
        Err(error) => return Block::Notice(format!("No comparison: {error}.")),
    };
    let (a, b) = (run_name(first.log), run_name(second.log));
    let rows = compared.iter().map(|compared| Row {
        label: compared.a.trim_start_matches(&format!("{a}: ")).to_owned(),
        published: false,
        cells: cells(compared),
    });
    Block::Table(Table {
        id: format!("compare-{}{}", first.prefix, second.prefix.trim_end_matches('-')),
        caption: format!(
            "{a} minus {b}, on the conditions and cases that both have. SR in percentage points, with 95 % bootstrap \
             intervals over cases and runs. Better, worse: cases that succeed more often, or less often, in {a}. p: \
             exact two-sided sign test on these two counts, not corrected for the number of rows."
        ),
        stubs: vec!["Condition".to_owned()],
        columns: columns(),
        groups: vec![Group { label: None, rows: rows.collect() }],
    })
}
