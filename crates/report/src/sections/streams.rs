//! Streams: worlds that change, and memories that learn (specification, section 9; `docs/streams.md`).

mod adaptation;
mod cost;
mod retention;
mod success;

pub(crate) use adaptation::{adaptation_table, orders_table};
pub(crate) use cost::necessity_table;
pub(crate) use retention::transfer_table;
pub(crate) use success::{differences_table, success_table};

use conditions::{Condition, Variation};
use domain::{Arm, FeedbackLevel};
use retention::{matrix_figure, matrix_table};
use scores::{Estimate, StreamScore, StreamScores};

use crate::document::{Missing, ReportBlock, ReportSection, RowGroup, TableCell, TableRow};
use crate::sections::overview::how_to_continue;
use crate::view::{ScoredRun, with_interval};

/// The sections about streams; none for a run without.
pub(super) fn sections(view: &ScoredRun<'_>) -> Vec<ReportSection> {
    let Some(scores) = &view.scores.streams else { return Vec::new() };
    let mut blocks: Vec<ReportBlock> =
        incomplete(view).into_iter().map(ReportBlock::Notice).collect();
    blocks.push(ReportBlock::Text(introduction(scores)));
    blocks.extend(success::blocks(view, scores));
    let mut sections = vec![ReportSection::new(view.id("s-streams"), "Streams", blocks)];
    for (id, title, blocks) in [
        (
            "retention",
            "Streams: what is kept and what carries over",
            retention_blocks(view, scores),
        ),
        (
            "adaptation",
            "Streams: adaptation, stale reuse and orders",
            ReportBlock::tables([adaptation_table(view), orders_table(view)]),
        ),
        ("stream-cost", "Streams: cost against size", cost::blocks(view, scores)),
        (
            "necessity",
            "Streams: cases that need memory",
            ReportBlock::tables([necessity_table(view)]),
        ),
    ] {
        if !blocks.is_empty() {
            let section = ReportSection::new(view.id(&format!("s-{id}")), title, blocks);
            sections.push(ReportSection { level: 3, ..section });
        }
    }
    sections
}

fn retention_blocks(view: &ScoredRun<'_>, scores: &StreamScores) -> Vec<ReportBlock> {
    let tables = ReportBlock::tables([transfer_table(view), matrix_table(view, scores)]);
    matrix_figure(view, scores).map(ReportBlock::Figure).into_iter().chain(tables).collect()
}

/// The notice about sequences that enter no figure.
pub(crate) fn incomplete(view: &ScoredRun<'_>) -> Option<String> {
    let scores = view.scores.streams.as_ref()?;
    let StreamScores { sequences, planned, .. } = scores;
    let missing = planned.saturating_sub(*sequences);
    (missing > 0).then(|| {
        format!(
            "Streams: {missing} of {planned} sequences are not complete and enter no figure; {}.",
            how_to_continue(view)
        )
    })
}

fn introduction(scores: &StreamScores) -> String {
    let feedback: Vec<&str> = scores.feedback.iter().copied().map(FeedbackLevel::word).collect();
    format!(
        "A stream is a list of blocks of episodes, with events between blocks that change the world: a passage closes or \
         opens, an item moves, two types swap places, stock is added. A memory in the arm learning persists over the stream, \
         observes its learning episodes and is told of their end (feedback: {}). Frozen is built once from the original \
         demonstrations, oracle for every block from demonstrations in the world as it is, wrong from histories of other \
         tasks. Evaluations change no memory. Block 0 is the unchanged world: before events. {} streams, {} complete \
         sequences. Figures are means over the sequences of each stream, then over streams; brackets: 95 % \
         intervals over streams, Student's t, all orders and repetitions of a stream together.",
        feedback.join(", "),
        scores.streams,
        scores.sequences
    )
}

/// The arm of a condition and its deviations from the standard variation; working memory is no memory.
fn arm(condition: &Condition) -> String {
    let word = match condition.memory.uses_demonstrations() {
        true => condition.arm.word(),
        false => "none",
    };
    let variation = match condition.variation == Variation::STANDARD {
        true => String::new(),
        false => condition.variation.to_string().replace('/', ", "),
    };
    word.to_owned() + &variation
}

/// Memory and arm: `episodic, frozen`.
fn short(condition: &Condition) -> String {
    match condition.memory.uses_demonstrations() {
        true => format!("{} {}", condition.memory, arm(condition)),
        false => condition.memory.to_string() + &arm(condition)["none".len()..],
    }
}

/// The headings of the label columns of rows [by condition](by_condition).
fn memory_and_arm() -> Vec<String> {
    vec!["Memory".to_owned(), "Arm".to_owned()]
}

/// A row for each condition, by memory.
fn by_condition(
    view: &ScoredRun<'_>,
    scores: &StreamScores,
    cells: impl Fn(&StreamScore) -> Option<Vec<TableCell>>,
) -> Vec<RowGroup> {
    let row = |score: &StreamScore| Some(TableRow::new(arm(&score.condition), cells(score)?));
    let of_memory = scores.conditions.chunk_by(|a, b| a.condition.memory == b.condition.memory);
    let group = |scores: &[StreamScore]| RowGroup {
        label: scores.first().map(|score| view.label(score.condition.memory)),
        rows: scores.iter().filter_map(row).collect(),
    };
    of_memory.map(group).filter(|group| !group.rows.is_empty()).collect()
}

/// A figure with its interval, or why there is none.
fn sure(estimate: Option<Estimate>, digits: usize, missing: Missing) -> TableCell {
    estimate.map_or(TableCell::Missing(missing), |Estimate { mean, interval, .. }| {
        with_interval(minus(mean, digits), interval, digits)
    })
}

/// A number with a typographic minus where it is below zero.
fn minus(value: f64, digits: usize) -> String {
    let shown = format!("{value:.digits$}");
    let is_zero = shown.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if is_zero { shown.replace('-', "") } else { shown.replace('-', "−") }
}

/// Whether the condition is one that a stream tests, not a control.
fn is_tested(condition: &Condition) -> bool {
    matches!(condition.arm, Arm::Frozen | Arm::Learning) && condition.memory.uses_demonstrations()
}
