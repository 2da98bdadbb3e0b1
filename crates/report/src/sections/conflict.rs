//! Demonstrations from before and from after a passage has closed.

use std::collections::BTreeSet;

use conditions::{Condition, Demonstrations, Mismatch, Route, Start, Variation};
use domain::{Arm, MemoryKind};
use scores::{ConditionScore, HISTORIES, Question};

use super::blocked::NONE_TRIED;
use super::comparisons::asked_blocks;
use super::missing::NOTHING_RETRIEVED;
use super::mixed::NO_RETRIEVAL;
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, sure, sure_or};

/// The figures, and the comparisons that the sets of demonstrations are run for.
pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let caption = "Pairs of sets of demonstrations on the same cases, those whose original demonstration the blocked way invalidates: \
                   first minus second, on each route. What a demonstration from after the event is worth against one from before it, \
                   what the outdated one costs beside the newer, and whether their order matters.";
    let mut blocks = ReportBlock::tables([conflict_table(view)]);
    blocks.extend(asked_blocks(view, Question::Conflict, "conflict-pairs", caption));
    blocks
}

/// Success on both routes and use of outdated demonstrations from the new start, the only one with blocked routes, by memory,
/// variation and demonstrations; `None` where there is no demonstration from after the event.
pub(crate) fn conflict_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.conflicts.iter();
    let is_shown = |condition: &Condition| {
        (condition.start, condition.mismatch) == (Start::New, Mismatch::None)
    };
    let scores: Vec<_> = scores.filter(|score| is_shown(&score.condition)).collect();
    let cases = scores.iter().map(|score| score.cases).max().filter(|cases| *cases > 0)?;
    let row = |memory: MemoryKind, variation, set: Demonstrations| {
        let on = |route| {
            let (start, mismatch, arm) = (Start::New, Mismatch::None, Arm::Frozen);
            let demonstrations = set;
            let condition =
                Condition { memory, start, route, demonstrations, variation, mismatch, arm };
            scores.iter().copied().find(|score| score.condition == condition)
        };
        let (unchanged, blocked) = (on(Route::Unchanged), on(Route::Blocked));
        let rate = |score: Option<&ConditionScore>| {
            score.map_or(TableCell::Missing(Missing::NotRun), |score| sure(score.sr, 1))
        };
        let of_blocked = blocked.and_then(|score| score.blocked);
        let (follow, stale) = match of_blocked {
            None => (TableCell::Missing(Missing::NotRun), TableCell::Missing(Missing::NotRun)),
            Some(found) => (
                sure_or(found.follow, 1, NONE_TRIED),
                match memory.retrieves() {
                    false => TableCell::Missing(NO_RETRIEVAL),
                    true => sure_or(found.stale, 1, NOTHING_RETRIEVED),
                },
            ),
        };
        let label = match set {
            Demonstrations::NONE => "none".to_owned(),
            Demonstrations::ORIGINAL => "before".to_owned(),
            other => other.to_string().replace('-', ", "),
        };
        let cells = vec![rate(unchanged), rate(blocked), follow, stale];
        (unchanged.is_some() || blocked.is_some()).then(|| TableRow::new(label, cells))
    };
    let both: BTreeSet<(MemoryKind, Variation)> =
        scores.iter().map(|score| (score.condition.memory, score.condition.variation)).collect();
    let groups = both.into_iter().map(|(memory, variation)| {
        let sets = [Demonstrations::NONE].into_iter().chain(HISTORIES);
        RowGroup {
            label: Some(view.label(memory) + &variation.to_string().replace('/', ", ")),
            rows: sets.filter_map(|set| row(memory, variation, set)).collect(),
        }
    });
    Some(Table {
        id: view.id("conflict"),
        caption: format!(
            "The {cases} cases whose original demonstration a blocked way invalidates: a demonstration from before it \
             was blocked, from after, and both in either order. New start. Success rate on the unchanged and on the blocked route. Follow: \
             percentage of episodes that ran into what blocks the way. Stale: percentage of the retrieved sources that, \
             replayed on the blocked route, do not complete their task. Intervals of 95 % in brackets."
        ),
        stubs: vec!["Memory".to_owned(), "Demonstrations".to_owned()],
        columns: vec![
            TableColumn::under("SR %", "unchanged"),
            TableColumn::under("SR %", "blocked"),
            TableColumn::new("Follow %"),
            TableColumn::new("Stale %"),
        ],
        groups: groups.filter(|group| !group.rows.is_empty()).collect(),
    })
}
