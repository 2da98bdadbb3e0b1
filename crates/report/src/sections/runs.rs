//! Several runs side by side: their settings, and the conditions that they share, paired by case and repetition.

use std::collections::BTreeSet;

use conditions::Condition;
use domain::MemoryKind;
use run_log::memory_label::memory_title;
use scores::compare::{LeftOutConditions, differing_settings, pair_runs};
use scores::{Comparison, conclude};

use super::comparisons::{ComparedRow, ComparedRows};
use super::overview::notices;
use crate::document::{
    Missing, ReportBlock, ReportSection, RowGroup, Table, TableCell, TableColumn, TableRow,
};
use crate::sections::conditions::setting;
use crate::view::{ScoredRun, sure};

/// The section about all runs together.
pub(crate) fn runs(views: &[ScoredRun<'_>]) -> ReportSection {
    let mut blocks = Vec::new();
    for view in views {
        let name = view.log.name.clone();
        let lines = notices(view).into_iter();
        blocks.extend(lines.map(|line| ReportBlock::Notice(format!("{name}: {line}"))));
    }
    blocks.push(ReportBlock::Table(overview(views)));
    blocks.push(ReportBlock::Table(side_by_side(views)));
    blocks.extend(compared_pairs(views));
    ReportSection::new("s-runs", "The runs side by side", blocks)
}

fn overview(views: &[ScoredRun<'_>]) -> Table {
    let row = |view: &ScoredRun<'_>| {
        let settings = &view.log.manifest.settings;
        let facts = vec![
            view.log.manifest.policy_label().to_string(),
            settings.suite.to_string(),
            settings.frames.to_string(),
            view.scores.conditions.len().to_string(),
            format!("{} of {}", view.scores.finished, view.scores.planned),
        ];
        (view.log.name.clone(), facts)
    };
    Table::of_text(
        "runs",
        "The runs of this report.",
        (&["Run"], &["Policy", "Suite", "Frames", "Conditions", "Episodes"]),
        views.iter().map(row),
    )
    .with_text(&["Policy", "Suite", "Frames"])
}

/// Success rate and SPL of every condition, a pair of columns for each run.
fn side_by_side(views: &[ScoredRun<'_>]) -> Table {
    let scores = views.iter().flat_map(|view| &view.scores.conditions);
    let conditions: BTreeSet<Condition> = scores.map(|score| score.condition).collect();
    let conditions: Vec<Condition> = conditions.into_iter().collect();
    let row = |condition: &Condition| {
        let cells = views.iter().flat_map(|view| match view.scores.of(condition) {
            Some(score) => [sure(score.sr, 1), TableCell::Value(format!("{:.3}", score.spl.mean))],
            None => [TableCell::Missing(Missing::NotRun), TableCell::Missing(Missing::NotRun)],
        });
        TableRow::new(setting(condition), cells.collect())
    };
    let group = |conditions: &[Condition]| RowGroup {
        label: conditions.first().map(|condition| shared_label(views, condition.memory)),
        rows: conditions.iter().map(row).collect(),
    };
    let columns = views.iter().flat_map(|view| {
        let name = view.log.name.clone();
        [TableColumn::under(name.clone(), "SR %"), TableColumn::under(name, "SPL")]
    });
    Table {
        id: "side-by-side".to_owned(),
        caption: "Success rate (mean ± sample standard deviation over runs, 95 % interval) and SPL of every condition."
            .to_owned(),
        stubs: vec!["Memory".to_owned(), "Start, route, demonstrations".to_owned()],
        columns: columns.collect(),
        groups: conditions.chunk_by(|a, b| a.memory == b.memory).map(group).collect(),
    }
}

/// The name of a memory, with the author of its documents where all runs that have it have the same.
fn shared_label(views: &[ScoredRun<'_>], memory: MemoryKind) -> String {
    let has_it = |view: &&ScoredRun<'_>| {
        view.scores.conditions.iter().any(|score| score.condition.memory == memory)
    };
    let mut labels = views.iter().filter(has_it).map(|view| view.label(memory));
    let first = labels.next().unwrap_or_default();
    if labels.all(|label| label == first) { first } else { memory_title(memory) }
}

/// Every two runs compared. All comparisons are made together.
fn compared_pairs(views: &[ScoredRun<'_>]) -> Vec<ReportBlock> {
    let pairs: Vec<(&ScoredRun<'_>, &ScoredRun<'_>)> = views
        .iter()
        .enumerate()
        .flat_map(|(later, second)| views[..later].iter().map(move |first| (first, second)))
        .collect();
    let (mut pairings, mut counts) = (Vec::new(), Vec::new());
    for (first, second) in &pairs {
        let paired = pair_runs(first.log, second.log).map(|paired| {
            let count = paired.pairings.len();
            pairings.extend(paired.pairings);
            (count, paired.left_out)
        });
        counts.push(paired);
    }
    let compared = conclude(pairings);
    let mut rest = &compared[..];
    let mut blocks = Vec::new();
    for ((first, second), paired) in pairs.into_iter().zip(counts) {
        match paired {
            Err(error) => blocks.push(ReportBlock::Notice(format!("No comparison: {error}."))),
            Ok((count, left_out)) => {
                let (own, others) = rest.split_at(count);
                rest = others;
                blocks.extend(compared_runs((first, second), own, &left_out));
            }
        }
    }
    blocks
}

fn compared_runs(
    (first, second): (&ScoredRun<'_>, &ScoredRun<'_>),
    compared: &[Comparison],
    left_out: &LeftOutConditions,
) -> Vec<ReportBlock> {
    let (a, b) = (first.log.name.clone(), second.log.name.clone());
    let differing = differing_settings(first.log, second.log).into_iter().map(|one| {
        let (key, there, here) = (one.key, one.there, one.here);
        ReportBlock::Notice(format!("{key} differs: {there} in {a}, {here} in {b}."))
    });
    let mut blocks: Vec<ReportBlock> = differing.collect();
    blocks.extend(left_out.sentences(&a, &b).into_iter().map(ReportBlock::Notice));
    let own = format!("{a}: ");
    let labelled = compared.iter().map(|comparison| ComparedRow {
        group: None,
        label: comparison.a.trim_start_matches(&own).to_owned(),
        comparison,
    });
    let rows = ComparedRows { stubs: &["Condition"], rows: labelled.collect() };
    let caption = format!(
        "{a} minus {b}, on the conditions, cases and repetitions that both have. SR in percentage points. Episodes: finished in \
         {a} (first) and in {b} (second), and those of the same case and repetition."
    );
    let id = format!("compare-{}{}", first.prefix, second.prefix.trim_end_matches('-'));
    blocks.extend(rows.blocks(&id, caption));
    blocks
}
