//! The matrix R; average success, transfer and forgetting.

use scores::{StreamScore, StreamScores};

use super::{arm, by_condition, memory_and_arm, short, sure};
use crate::document::{Missing, RowGroup, Table, TableColumn, TableRow};
use crate::plot::{HeatMap, HeatPanel, ReportFigure, heat_map};
use crate::view::{ScoredRun, plain_or};

const ONE_BLOCK: Missing = Missing::Undefined("it needs two blocks");
const NO_BASELINE: Missing =
    Missing::NotApplicable("forward transfer is against no memory, where that was run");
const NOT_EVALUATED: Missing = Missing::Undefined("no case of the block was evaluated");

/// ACC, BWT, FWT and forgetting.
pub(crate) fn transfer_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.streams.as_ref()?;
    let row = |score: &StreamScore| {
        score.average?;
        Some(vec![
            sure(score.average, 1, ONE_BLOCK),
            sure(score.backward, 1, ONE_BLOCK),
            sure(score.forward, 1, NO_BASELINE),
            sure(score.forgetting, 1, ONE_BLOCK),
        ])
    };
    let table = Table {
        id: view.id("stream-transfer"),
        caption: "From read-only evaluations of every block after each block. ACC: average success over all blocks after the \
                  last, in percent. In percentage points: BWT, backward transfer, what later learning changes about a block; \
                  FWT, forward transfer, success on a block before it is learned, minus that without memory; forgetting, the \
                  best earlier success on a block minus the last (Lopez-Paz and Ranzato 2017; Chaudhry et al. 2018)."
            .to_owned(),
        stubs: memory_and_arm(),
        columns: ["ACC", "BWT", "FWT", "Forgetting"].map(TableColumn::new).to_vec(),
        groups: by_condition(view, scores, row),
    };
    table.pruned()
}

/// R: a group for each condition, a row for each number of blocks learned, a column for each block.
pub(super) fn matrix_table(view: &ScoredRun<'_>, scores: &StreamScores) -> Option<Table> {
    let blocks = scores.conditions.iter().map(|score| score.matrix.len()).max()?.checked_sub(1)?;
    let row = |(learned, rates): (usize, &Vec<Option<f64>>)| {
        let rates = (0..blocks).map(|block| rates.get(block).copied().flatten());
        let cells = rates.map(|rate| plain_or(rate, 1, NOT_EVALUATED));
        TableRow::new(format!("after {learned}"), cells.collect())
    };
    let group = |score: &StreamScore| RowGroup {
        label: Some(format!("{}, {}", view.label(score.condition.memory), arm(&score.condition))),
        rows: score.matrix.iter().enumerate().map(row).collect(),
    };
    let table = Table {
        id: view.id("stream-matrix"),
        caption: "R: success in percent on the cases of each block, in the block's own world, after so many blocks were \
                  learned. Blocks count in the order of their sequence; means over all orders. A condition that does not \
                  learn differs from row to row by chance alone."
            .to_owned(),
        stubs: vec!["Memory, arm".to_owned(), "Blocks learned".to_owned()],
        columns: (1..=blocks).map(|block| TableColumn::under("Block, by place", block.to_string())).collect(),
        groups: scores.conditions.iter().filter(|score| score.average.is_some()).map(group).collect(),
    };
    table.pruned()
}

/// R as heat maps; `None` where there is no matrix.
pub(super) fn matrix_figure(view: &ScoredRun<'_>, scores: &StreamScores) -> Option<ReportFigure> {
    let scores = scores.conditions.iter().filter(|score| score.average.is_some());
    let panel = |score: &StreamScore| HeatPanel {
        name: short(&score.condition),
        cells: score.matrix.clone(),
    };
    let panels: Vec<HeatPanel> = scores.map(panel).collect();
    (!panels.is_empty()).then(|| {
        heat_map(&HeatMap {
            id: view.id("stream-matrix-figure"),
            caption: "R: success in percent on the cases of each block, after so many blocks were learned. White: 0 %; dark: \
                      100 %."
                .to_owned(),
            columns: "block",
            rows: "blocks learned",
            panels,
        })
    })
}
