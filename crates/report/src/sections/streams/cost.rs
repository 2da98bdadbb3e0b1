//! What memory costs against its size, and which cases need it.

use scores::{Necessity, NecessitySuccess, StreamCost, StreamScore, StreamScores};

use super::{arm, is_tested, memory_and_arm, short, sure};
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::plot::{Curve, Curves, curves};
use crate::sections::main_table::NO_TOKENS;
use crate::sections::missing::{NO_RECALL, NO_STORE};
use crate::view::{ScoredRun, plain_or};

const NO_CASE: Missing = Missing::Undefined("no case is certified");

pub(super) fn blocks(view: &ScoredRun<'_>, scores: &StreamScores) -> Vec<ReportBlock> {
    let figure = cost_figure(view, scores).map(ReportBlock::Figure);
    figure.into_iter().chain(cost_table(view, scores).map(ReportBlock::Table)).collect()
}

fn tested(scores: &StreamScores) -> impl Iterator<Item = &StreamScore> {
    scores.conditions.iter().filter(|score| is_tested(&score.condition) && !score.costs.is_empty())
}

fn cost_table(view: &ScoredRun<'_>, scores: &StreamScores) -> Option<Table> {
    let row = |cost: &StreamCost| {
        let cells = vec![
            TableCell::Value(format!("{:.0}", cost.episodes)),
            plain_or(cost.search_us, 1, NO_RECALL),
            plain_or(cost.recall_us, 1, NO_RECALL),
            plain_or(cost.store_bytes.map(|bytes| bytes / 1024.0), 1, NO_STORE),
            plain_or(cost.tokens, 0, NO_TOKENS),
        ];
        TableRow::new(format!("after {}", cost.after), cells)
    };
    let group = |score: &StreamScore| RowGroup {
        label: Some(format!("{}, {}", view.label(score.condition.memory), arm(&score.condition))),
        rows: score.costs.iter().map(row).collect(),
    };
    let table = Table {
        id: view.id("stream-cost"),
        caption: "What memory costs in the evaluations after so many blocks. Episodes: demonstrations and learning episodes \
                  that it was given; a memory with a budget may hold fewer. Search: microseconds from the embedded view to \
                  what is supplied. Recall: from the view to the answer, embedding included. Views are embedded when \
                  they are first seen, so recall falls as views become known, whatever memory holds. Both depend on the \
                  machine and its load. Store: KiB that the memory reported. Tokens: injected \
                  memory in a request, an estimate."
            .to_owned(),
        stubs: vec!["Memory, arm".to_owned(), "Blocks learned".to_owned()],
        columns: ["Episodes", "Search, us", "Recall, us", "Store, KiB", "Tokens"]
            .map(TableColumn::new)
            .to_vec(),
        groups: tested(scores).map(group).collect(),
    };
    table.pruned()
}

/// Search latency against the number of episodes, of memories that grow.
fn cost_figure(view: &ScoredRun<'_>, scores: &StreamScores) -> Option<crate::ReportFigure> {
    let curve = |score: &StreamScore| {
        let point = |cost: &StreamCost| Some((cost.episodes, cost.search_us?));
        let points: Vec<(f64, f64)> = score.costs.iter().filter_map(point).collect();
        let grows = points.first()?.0 < points.last()?.0;
        grows.then(|| Curve { name: short(&score.condition), is_bound: false, points })
    };
    let shown: Vec<Curve> = tested(scores).filter_map(curve).collect();
    (!shown.is_empty()).then(|| {
        curves(&Curves {
            id: view.id("stream-cost-figure"),
            caption: "Search latency against the number of episodes that memory was given, in the evaluations after each \
                      number of blocks; embedding the view is not part of it."
                .to_owned(),
            across: "Episodes given to memory".to_owned(),
            up: "Search, us".to_owned(),
            curves: shown,
        })
    })
}

/// The share of cases that need memory, and success on those.
pub(crate) fn necessity_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.streams.as_ref()?;
    let group = |necessity: &Necessity| {
        let Necessity { oracle, cases, certified, success } = necessity;
        let share = 100.0 * *certified as f64 / *cases as f64;
        let row = |one: &NecessitySuccess| {
            let cells = vec![
                TableCell::Value(format!("{certified} of {cases}")),
                TableCell::Value(format!("{share:.1}")),
                sure(one.all, 1, NO_CASE),
                sure(one.certified, 1, NO_CASE),
            ];
            TableRow::new(arm(&one.condition), cells)
        };
        RowGroup { label: Some(view.label(oracle.memory)), rows: success.iter().map(row).collect() }
    };
    let mut columns = vec![TableColumn::new("Certified"), TableColumn::new("Share %")];
    columns.extend(["all cases", "certified"].map(|name| TableColumn::under("Success %", name)));
    let table = Table {
        id: view.id("necessity"),
        caption: "Cases in blocks of which most learning episodes fail without memory and most succeed with the oracle arm: \
                  those certify that memory matters to this policy. Success of the learning episodes on all cases and on \
                  certified ones. The rows none and oracle decide which cases are certified, so their success on those is \
                  so by selection."
            .to_owned(),
        stubs: memory_and_arm(),
        columns,
        groups: scores.necessity.iter().map(group).collect(),
    };
    table.pruned()
}
