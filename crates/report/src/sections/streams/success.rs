//! Success over the stream, before and after events, and paired differences.

use conditions::Condition;
use domain::{Arm, MemoryKind, Representation};
use scores::{
    Estimate, FigureDifference, RoundScore, StreamScore, StreamScores, TestedDifference, p_value,
};

use super::{by_condition, is_tested, memory_and_arm, short, sure};
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::plot::{Course, CourseCurve, CoursePoint, course};
use crate::view::{ScoredRun, signed, with_interval};

const NO_BLOCK: Missing = Missing::Undefined("the streams have no such block");
const NO_TEST: Missing = Missing::Undefined("one stream, or all streams alike");
const NO_ORACLE: Missing = Missing::NotApplicable(
    "regret is against the oracle arm of the same memory, where that was run",
);

pub(super) fn blocks(view: &ScoredRun<'_>, scores: &StreamScores) -> Vec<ReportBlock> {
    let mut memories: Vec<MemoryKind> =
        scores.conditions.iter().map(|score| score.condition.memory).collect();
    memories.retain(|memory| memory.uses_demonstrations());
    memories.dedup();
    let mut blocks: Vec<ReportBlock> =
        memories.into_iter().filter_map(|memory| rounds_figure(view, scores, memory)).collect();
    blocks.extend(running_figure(view, scores));
    blocks.extend(ReportBlock::tables([success_table(view), differences_table(view)]));
    blocks
}

/// Success by learning round: a panel for each arm of `memory`, frozen Episodic beside them, and no memory in gray.
fn rounds_figure(
    view: &ScoredRun<'_>,
    scores: &StreamScores,
    memory: MemoryKind,
) -> Option<ReportBlock> {
    let is_shown = |score: &StreamScore| {
        let Condition { memory: own, arm, .. } = score.condition;
        let is_frozen_episodic = own == Representation::Episodic && arm == Arm::Frozen;
        own == memory || is_frozen_episodic || !own.uses_demonstrations()
    };
    draw(
        format!("{}-{memory}", view.id("stream-rounds")),
        format!(
            "{} over the stream, as drawn: success in each learning round, a mean over streams, with 95 % intervals over streams. \
             Dashed: events between blocks. Gray: no memory.",
            view.label(memory)
        ),
        scores.conditions.iter().filter(|score| is_shown(score)),
        |round| round.success,
    )
}

fn running_figure(view: &ScoredRun<'_>, scores: &StreamScores) -> Option<ReportBlock> {
    draw(
        view.id("stream-success-figure"),
        "Stream success: success over all learning episodes so far, as drawn, a mean over streams, with 95 % \
         intervals over streams. Dashed: events between blocks. Gray: no memory."
            .to_owned(),
        scores.conditions.iter().filter(|score| {
            is_tested(&score.condition) || !score.condition.memory.uses_demonstrations()
        }),
        |round| round.running,
    )
}

fn draw<'a>(
    id: String,
    caption: String,
    scores: impl Iterator<Item = &'a StreamScore>,
    value: fn(&RoundScore) -> Estimate,
) -> Option<ReportBlock> {
    let curve = |score: &StreamScore| {
        let rounds_of =
            |place| score.rounds.iter().filter(move |round| round.place == place).count();
        let point = |round: &RoundScore| {
            let within = (f64::from(round.round) - 0.5) / rounds_of(round.place) as f64;
            let Estimate { mean: percent, interval, .. } = value(round);
            CoursePoint {
                at: f64::from(round.place) + within,
                percent,
                interval: interval.map(|found| (found.low, found.high)),
            }
        };
        CourseCurve {
            name: short(&score.condition),
            is_bound: !score.condition.memory.uses_demonstrations(),
            points: score.rounds.iter().map(point).collect(),
        }
    };
    let scores: Vec<&StreamScore> = scores.filter(|score| !score.rounds.is_empty()).collect();
    let places = scores.iter().flat_map(|score| &score.rounds).map(|round| round.place + 1);
    let plot = Course {
        id,
        caption,
        blocks: places.max()?,
        curves: scores.into_iter().map(curve).collect(),
    };
    Some(ReportBlock::Figure(course(&plot)))
}

/// Success of the learning episodes: all, before events, after events.
pub(crate) fn success_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.streams.as_ref()?;
    let mut columns = vec![TableColumn::new("Sequences")];
    columns.extend(
        ["all", "before events", "after events"].map(|name| TableColumn::under("Success %", name)),
    );
    columns.push(TableColumn::new("Regret"));
    let row = |score: &StreamScore| {
        Some(vec![
            TableCell::Value(match score.planned > score.sequences {
                true => format!("{}/{}", score.sequences, score.planned),
                false => score.sequences.to_string(),
            }),
            sure(score.success, 1, NO_BLOCK),
            sure(score.before, 1, NO_BLOCK),
            sure(score.after, 1, NO_BLOCK),
            sure(score.regret, 1, NO_ORACLE),
        ])
    };
    let table = Table {
        id: view.id("stream-success"),
        caption: "Success of the learning episodes, in percent. All: stream success at the end. Before events: in block 0; \
                  after events: in the other blocks, in whatever order they come. Regret: successes of the oracle arm of the \
                  same memory minus its own, summed over the learning episodes of a sequence."
            .to_owned(),
        stubs: memory_and_arm(),
        columns,
        groups: by_condition(view, scores, row),
    };
    table.pruned()
}

/// Pairs of conditions on the same sequences.
pub(crate) fn differences_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.streams.as_ref()?;
    let cells = |found: Option<TestedDifference>| {
        let Some(TestedDifference { difference, p, corrected_p, .. }) = found else {
            return [TableCell::Missing(NO_BLOCK), TableCell::Missing(NO_BLOCK)];
        };
        let FigureDifference { mean, interval, .. } = difference;
        let p = match p.zip(corrected_p) {
            Some((p, corrected)) => TableCell::Sure {
                figure: p_value(p),
                interval: format!("({})", p_value(corrected)),
            },
            None => TableCell::Missing(NO_TEST),
        };
        [with_interval(signed(mean, 1), interval, 1), p]
    };
    let rows = scores.differences.iter().map(|found| {
        let streams = TableCell::Value(found.streams.to_string());
        let figures = [found.before, found.after, found.average].into_iter().flat_map(cells);
        let cells = [streams].into_iter().chain(figures).collect();
        TableRow::new(format!("{} − {}", short(&found.a), short(&found.b)), cells)
    });
    let mut columns = vec![TableColumn::new("Streams")];
    for over in ["Before", "After", "ACC"] {
        columns.extend(["difference", "p"].map(|name| TableColumn::under(over, name)));
    }
    let table = Table {
        id: view.id("stream-differences"),
        caption: format!(
            "First minus second on the sequences that both have, in percentage points, with 95 % intervals over streams: success \
             of the learning episodes before and after events; average success over all blocks after the last (ACC). p: Student's \
             t test over streams, and in parentheses corrected for the {} differences of this table that have one (Holm 1979). No \
             interval and no p: one stream, or all streams alike.",
            scores.tested_differences
        ),
        stubs: vec!["First − second".to_owned()],
        columns,
        groups: vec![RowGroup { label: None, rows: rows.collect() }],
    };
    table.pruned()
}
