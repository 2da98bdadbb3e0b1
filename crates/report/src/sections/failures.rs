//! Failures by kind, since when episodes failed, and the cases that fail most.

use std::collections::BTreeSet;

use domain::{Arm, MemoryKind};
use scores::{ConditionScore, DivergenceScore, LoopScore, PointScore, point_scores, worst_cases};

use crate::document::{Missing, ReportBlock, Table, TableCell, TableRow};
use crate::plot::{Stack, StackRow, stack};
use crate::sections::conditions::setting;
use crate::view::ScoredRun;

/// Cases in the table of the worst.
const WORST: usize = 10;

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let Some(table) = failures_table(view) else { return Vec::new() };
    let text = "Each failed episode is of one kind: the first rule that applies, in the order of the rows. First comes \
                how an episode went wrong, then what was missing.";
    let kinds = &view.log.world.failures;
    let present =
        kinds.iter().filter(|kind| table.groups[0].rows.iter().any(|row| row.label == kind.name));
    let terms = present.map(|kind| (kind.name.clone(), kind.words.clone()));
    let mut blocks = vec![ReportBlock::Text(text.to_owned()), ReportBlock::Terms(terms.collect())];
    let mut last = None;
    let bars = view.scores.conditions.iter().map(|score| {
        let memory = score.condition.memory;
        let is_first = last.replace(memory) != Some(memory);
        let heading = is_first.then(|| view.label(memory));
        StackRow { heading, label: setting(&score.condition), lengths: Some(shares(score)) }
    });
    blocks.push(ReportBlock::Figure(stack(&Stack {
        id: view.id("failures-figure"),
        caption: "Kinds of failure as a percentage of the finished episodes of each condition. The remainder \
                  succeeded."
            .to_owned(),
        axis: "Failed episodes, % of all",
        to: Some(100.0),
        parts: kinds.iter().map(|kind| kind.name.clone()).collect(),
        rows: bars.collect(),
    })));
    blocks.push(ReportBlock::Table(table));
    if let Some(table) = points_table(view) {
        let text = "Since when an episode failed: its last progress is the last sub-goal that it completed. In a loop it is, \
                    for at least 20 steps, only in states in which it was before, and makes no progress after. It is compared \
                    with the success of the same case, start and route, under any memory, with which it has most actions in \
                    common; until the step where they part it did nothing that a success did not do. Where it completed a \
                    sub-goal after that, it took another way, and the reason is later.";
        blocks.push(ReportBlock::Text(text.to_owned()));
        blocks.push(ReportBlock::Table(table));
    }
    blocks.extend(worst_table(view, WORST).map(ReportBlock::Table));
    blocks
}

fn shares(score: &ConditionScore) -> Vec<f64> {
    let share = |(_, count)| 100.0 * count as f64 / score.episodes as f64;
    score.failures.iter().map(share).collect()
}

/// Counts of each kind that occurs, by memory; `None` when nothing failed.
pub(crate) fn failures_table(view: &ScoredRun<'_>) -> Option<Table> {
    // A control arm fails for its own reasons.
    let is_of_memory = |score: &&ConditionScore| score.condition.arm == Arm::Frozen;
    let scores: Vec<_> = view.scores.conditions.iter().filter(is_of_memory).collect();
    let memories: BTreeSet<MemoryKind> =
        scores.iter().map(|score| score.condition.memory).collect();
    let count = |kind: Option<&str>, memory: Option<MemoryKind>| -> usize {
        let of_memory =
            scores.iter().filter(|score| memory.is_none_or(|m| score.condition.memory == m));
        let counts = of_memory.flat_map(|score| score.failures.iter());
        counts.filter(|(found, _)| kind.is_none_or(|kind| *found == kind)).map(|(_, n)| n).sum()
    };
    let row = |label: &str, kind: Option<&str>| {
        let by_memory = memories.iter().map(|memory| count(kind, Some(*memory)).to_string());
        (label.to_owned(), by_memory.chain([count(kind, None).to_string()]).collect())
    };
    let kinds = view.log.world.failures.iter().map(|kind| kind.name.as_str());
    let kinds = kinds.filter(|kind| count(Some(kind), None) > 0);
    let mut rows: Vec<(String, Vec<String>)> = kinds.map(|kind| row(kind, Some(kind))).collect();
    if rows.is_empty() {
        return None;
    }
    rows.push(row("all", None));
    let titles: Vec<String> = memories.iter().map(|memory| view.label(*memory)).collect();
    let columns: Vec<&str> = titles.iter().map(String::as_str).chain(["All"]).collect();
    Some(Table::of_text(
        view.id("failures"),
        "Failed episodes by kind and memory, counts over all conditions and runs but those of control arms.",
        (&["Kind"], &columns),
        rows,
    ))
}

/// What a row of the table of points has of the failures of a memory.
type PointFigure = fn(&PointScore) -> TableCell;

/// The rows of the table of points.
const POINTS: [(&str, PointFigure); 9] = [
    ("failed", |score| TableCell::Value(score.failed.to_string())),
    ("last progress, median step", |score| step(Some(score.last_progress), "")),
    ("in a loop", |score| of_loops(score, |loops| share(loops.looped, loops.recorded))),
    ("first repetition, median step", |score| {
        of_loops(score, |loops| step(loops.first_repetition, "no failed episode is in a loop"))
    }),
    ("undecided until the steps ran out", |score| TableCell::Value(score.undecided.to_string())),
    ("of these in a loop", |score| {
        of_loops(score, |loops| TableCell::Value(loops.undecided.to_string()))
    }),
    ("compared with a success", |score| {
        share(score.divergence.map_or(0, |divergence| divergence.compared), score.failed)
    }),
    ("first unlike it, median step", |score| {
        step(score.divergence.map(|divergence| divergence.step), NO_SUCCESS)
    }),
    ("no progress after that", |score| {
        let of =
            |divergence: DivergenceScore| share(divergence.without_progress, divergence.compared);
        score.divergence.map_or(TableCell::Missing(Missing::NotApplicable(NO_SUCCESS)), of)
    }),
];

const NO_SUCCESS: &str = "no episode of the same case, start and route succeeded";

fn step(median: Option<f64>, why_not: &'static str) -> TableCell {
    let missing = TableCell::Missing(Missing::NotApplicable(why_not));
    median.map_or(missing, |step| TableCell::Value(step.to_string()))
}

fn share(part: usize, of: usize) -> TableCell {
    TableCell::Value(format!("{part} of {of}"))
}

fn of_loops(score: &PointScore, figure: impl Fn(LoopScore) -> TableCell) -> TableCell {
    let missing = Missing::NotMeasured("the records tell no loops");
    score.loops.map_or(TableCell::Missing(missing), figure)
}

/// Since when episodes failed, by memory; `None` when nothing failed.
pub(crate) fn points_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = point_scores(view.log);
    let titles: Vec<String> = scores
        .iter()
        .map(|score| score.memory.map_or_else(|| "All".to_owned(), |memory| view.label(memory)))
        .collect();
    let columns: Vec<&str> = titles.iter().map(String::as_str).collect();
    let mut table = Table::of_text(
        view.id("failure-points"),
        "Since when episodes failed, by memory, over all conditions and runs. Undecided: the rule of its kind names no event \
         after the last progress.",
        (&["Point"], &columns),
        [],
    );
    let rows = POINTS
        .iter()
        .map(|(label, figure)| TableRow::new(*label, scores.iter().map(figure).collect()));
    let is_measured =
        |row: &TableRow| row.cells.iter().any(|cell| !matches!(cell, TableCell::Missing(_)));
    table.groups[0].rows = rows.filter(is_measured).collect();
    (!scores.is_empty()).then_some(table)
}

/// The cases that fail most; `None` when nothing failed.
pub(crate) fn worst_table(view: &ScoredRun<'_>, most: usize) -> Option<Table> {
    let cases = worst_cases(view.log, most);
    let row = |case: scores::CaseScore| {
        let failed = format!("{} of {}", case.failed, case.episodes);
        let kind = case.failure;
        (case.case, vec![case.task.to_string(), failed, kind, case.example])
    };
    let rows: Vec<(String, Vec<String>)> = cases.into_iter().map(row).collect();
    (!rows.is_empty()).then(|| {
        Table::of_text(
            view.id("worst-cases"),
            "The cases that fail most, over all conditions and runs but those of control arms, with the most frequent kind of failure and an \
             episode of it, whose steps are shown by: memtransfer show RUN CASE STEP.",
            (&["Case"], &["Task", "Failed", "Main failure", "Example"]),
            rows,
        )
        .with_text(&["Main failure", "Example"])
    })
}
