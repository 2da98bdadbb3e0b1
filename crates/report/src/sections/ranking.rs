//! Several runs ranked: of those with the same protocol, the conditions with the same start and route, the best first.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use conditions::{Condition, Mismatch, Route};
use scores::{ConditionScore, Estimate, Spread, StreamScore};
use serde_json::Value;

use super::blocked::NONE_TRIED;
use super::documents::other_authors;
use super::main_table::{NO_REQUESTS, NO_TOKENS};
use crate::document::{
    Missing, ReportBlock, ReportSection, RowGroup, Table, TableCell, TableColumn, TableRow,
};
use crate::view::{ScoredRun, plain_or, sure, sure_or, with_interval};

const NO_SEQUENCE: Missing = Missing::Undefined("no sequence of streams defines it");

/// What runs that are ranked together have in common, by name.
type Protocol = BTreeMap<String, Value>;

/// The section that ranks the conditions of all runs.
pub(crate) fn ranking(views: &[ScoredRun<'_>]) -> ReportSection {
    let mut blocks = Vec::new();
    let mut by_protocol: BTreeMap<(String, String), Vec<&ScoredRun<'_>>> = BTreeMap::new();
    for view in views {
        let manifest = &view.log.manifest;
        if let Some(unit) = &manifest.unit {
            blocks.push(ReportBlock::Notice(format!(
                "{} is not ranked: it is unit {} of a plan, a part of a run. `memtransfer merge` makes a run of all units.",
                view.log.name, unit.number
            )));
            continue;
        }
        let key = (manifest.settings.suite.to_string(), view.log.protocol_id());
        by_protocol.entry(key).or_default().push(view);
    }
    let mut first_of_suite: BTreeMap<&str, (&str, Protocol)> = BTreeMap::new();
    let mut number = 0;
    for ((suite, id), views) in &by_protocol {
        let Some(view) = views.first() else { continue };
        let protocol = view.log.protocol();
        match first_of_suite.get(suite.as_str()) {
            None => {
                first_of_suite.insert(suite, (id, protocol));
            }
            Some((first_id, first)) => {
                blocks.extend(differences((id, &protocol), (first_id, first)));
            }
        }
        blocks.extend(other_authors(views).into_iter().map(ReportBlock::Notice));
        for (caption, columns, rows) in tables(views) {
            number += 1;
            let caption = format!("Suite {suite}, protocol {id}: {caption}, the best first.");
            blocks.push(ReportBlock::Table(table(
                format!("ranking-{number}"),
                caption,
                columns,
                rows,
            )));
        }
    }
    // Below the tables: a result is on the first screen, also of a phone.
    blocks.push(ReportBlock::Text(
        "Conditions of runs with the same protocol: suite, world, cases, seed, limits, look of frames and version of the \
         program. Policy and memory are compared. Mean ± sample standard deviation over runs, 95 % interval. Where intervals \
         overlap, the order may be chance: the paired comparisons of the runs say more."
            .to_owned(),
    ));
    ReportSection::new("s-ranking", "The runs ranked", blocks)
}

/// A notice for each part of the protocol `here` that differs from `first`, the first one of the suite.
fn differences(
    (id, here): (&str, &Protocol),
    (first_id, first): (&str, &Protocol),
) -> Vec<ReportBlock> {
    let (here, first) = (flat(here), flat(first));
    let names: BTreeSet<&String> = here.keys().chain(first.keys()).collect();
    let value = |of: &BTreeMap<String, String>, name| {
        of.get(name).map_or_else(|| "not set".to_owned(), String::clone)
    };
    names
        .into_iter()
        .filter(|name| here.get(*name) != first.get(*name))
        .map(|name| {
            ReportBlock::Notice(format!(
                "Not comparable: {name} is {} in protocol {id} and {} in protocol {first_id}.",
                value(&here, name),
                value(&first, name)
            ))
        })
        .collect()
}

/// The values in words, those of a table each by itself: `stream.blocks`.
fn flat(protocol: &Protocol) -> BTreeMap<String, String> {
    let parts = |(name, value): (&String, &Value)| match value.as_object() {
        Some(parts) => {
            parts.iter().map(|(part, value)| (format!("{name}.{part}"), words(value))).collect()
        }
        None => vec![(name.clone(), words(value))],
    };
    protocol.iter().flat_map(parts).collect()
}

/// A value in words: texts without quotes, hashes shortened.
fn words(value: &Value) -> String {
    match value.as_str() {
        Some(text) if text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit()) => {
            text[..12].to_owned()
        }
        Some(text) => text.to_owned(),
        None => value.to_string(),
    }
}

/// A row, and the means that it is ranked by.
struct RankedRow {
    row: TableRow,
    memory: String,
    means: [Option<f64>; 2],
}

/// The tables of runs with one protocol: caption, headings and rows, single episodes before streams.
fn tables(
    views: &[&ScoredRun<'_>],
) -> impl Iterator<Item = (String, &'static [&'static str], Vec<RankedRow>)> {
    let mut episodes: BTreeMap<String, Vec<RankedRow>> = BTreeMap::new();
    let mut streams: BTreeMap<String, Vec<RankedRow>> = BTreeMap::new();
    for view in views {
        for score in &view.scores.conditions {
            let condition = &score.condition;
            let ranked = ranked_row(
                view,
                condition,
                (score.episodes, score.planned),
                (condition_cells(score), [Some(score.sr.mean), Some(score.spl.mean)]),
            );
            let mut caption = format!("{} start, {} route", condition.start, condition.route);
            if condition.mismatch != Mismatch::None {
                caption += &format!(", mismatch {}", condition.mismatch);
            }
            episodes.entry(caption).or_default().push(ranked);
        }
        for score in view.scores.streams.iter().flat_map(|streams| &streams.conditions) {
            let condition = &score.condition;
            let mean = |estimate: Option<Estimate>| estimate.map(|estimate| estimate.mean);
            let ranked = ranked_row(
                view,
                condition,
                (score.sequences, score.planned),
                (stream_cells(score), [mean(score.success), mean(score.average)]),
            );
            let caption = format!("streams, {} start", condition.start);
            streams.entry(caption).or_default().push(ranked);
        }
    }
    let episodes = episodes.into_iter().map(|(caption, rows)| (caption, EPISODE_COLUMNS, rows));
    episodes.chain(streams.into_iter().map(|(caption, rows)| (caption, STREAM_COLUMNS, rows)))
}

fn ranked_row(
    view: &ScoredRun<'_>,
    condition: &Condition,
    (finished, planned): (usize, usize),
    (figures, means): (Vec<TableCell>, [Option<f64>; 2]),
) -> RankedRow {
    let manifest = &view.log.manifest;
    let mut memory = view.label(condition.memory);
    let external = condition.memory.external();
    if let Some(facts) = external.and_then(|name| manifest.memories.get(&name)) {
        memory += &format!(" {}", facts.version);
    }
    // memory/start/route/demonstrations, then what deviates.
    let condition = condition.to_string();
    let demonstrations = condition.split('/').skip(3).collect::<Vec<_>>().join(", ");
    let count = match finished < planned {
        true => format!("{finished} of {planned}"),
        false => finished.to_string(),
    };
    let facts = [count, demonstrations, manifest.policy_label().to_string()];
    let cells = [TableCell::Value(memory.clone())].into_iter().chain(figures);
    let cells = cells.chain(facts.map(TableCell::Value));
    RankedRow {
        row: TableRow::new(view.log.name.clone(), cells.collect()),
        memory,
        // Means that are the same on paper differ by rounding.
        means: means.map(|mean| mean.map(|mean| (mean * 1e9).round())),
    }
}

/// The table of `rows`, without columns that have no figure.
fn table(id: String, caption: String, figures: &[&'static str], mut rows: Vec<RankedRow>) -> Table {
    rows.sort_by(|a, b| {
        let by_means = b.means.partial_cmp(&a.means).unwrap_or(Ordering::Equal);
        by_means.then_with(|| (&a.row.label, &a.memory).cmp(&(&b.row.label, &b.memory)))
    });
    // The figures are beside the names, so that a phone shows both.
    let headings = ["Memory"].iter().chain(figures).chain(&["n", "Demonstrations", "Policy"]);
    let mut columns: Vec<TableColumn> = headings.map(|name| TableColumn::new(*name)).collect();
    let mut rows: Vec<TableRow> = rows.into_iter().map(|ranked| ranked.row).collect();
    for column in (0..columns.len()).rev() {
        if !rows.iter().any(|row| row.cells[column].is_figure()) {
            columns.remove(column);
            for row in &mut rows {
                row.cells.remove(column);
            }
        }
    }
    let table = Table {
        id,
        caption,
        stubs: vec!["Run".to_owned()],
        columns,
        groups: vec![RowGroup { label: None, rows }],
    };
    table.with_text(&["Policy", "Memory", "Demonstrations"])
}

const EPISODE_COLUMNS: &[&str] = &["SR %", "SPL", "Follow %", "Recovery %", "Steps", "Img", "Mtok"];

fn condition_cells(score: &ConditionScore) -> Vec<TableCell> {
    const UNCHANGED: Missing = Missing::NotApplicable("nothing is blocked on an unchanged route");
    let missing = match score.condition.route {
        Route::Unchanged => UNCHANGED,
        Route::Blocked => NONE_TRIED,
    };
    let blocked = |of: fn(scores::BlockedScore) -> Option<Spread>| {
        sure_or(score.blocked.and_then(of), 1, missing.clone())
    };
    let mean = |spread: Option<Spread>| spread.map(|spread| spread.mean);
    vec![
        sure(score.sr, 1),
        sure(score.spl, 3),
        blocked(|blocked| blocked.follow),
        blocked(|blocked| blocked.recovery),
        plain_or(score.mean_steps, 1, NO_REQUESTS),
        plain_or(mean(score.images_per_request), 1, NO_REQUESTS),
        plain_or(mean(score.tokens_per_100).map(|tokens| tokens / 1e6), 2, NO_TOKENS),
    ]
}

const STREAM_COLUMNS: &[&str] = &["Success %", "ACC %", "BWT", "FWT", "Forgetting", "t-nDTW"];

fn stream_cells(score: &StreamScore) -> Vec<TableCell> {
    let cell = |(estimate, digits): (Option<Estimate>, usize)| match estimate {
        Some(Estimate { mean, interval, .. }) => {
            with_interval(format!("{mean:.digits$}").replace('-', "−"), interval, digits)
        }
        None => TableCell::Missing(NO_SEQUENCE),
    };
    let StreamScore { success, average, backward, forward, forgetting, t_ndtw, .. } = *score;
    let figures = [success, average, backward, forward, forgetting].map(|figure| (figure, 1));
    figures.into_iter().chain([(t_ndtw, 3)]).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use domain::StreamOrder;
    use rigs::records::{keyed, log, record, stream_log, stream_record};
    use run_log::{EpisodeRecord, RunLog, UnitId};

    use crate::published::Published;
    use crate::views;

    use super::*;

    /// The labels of each table's rows, and the notices.
    fn ranked(logs: &[RunLog]) -> (Vec<Vec<String>>, Vec<String>) {
        let published = Published::paper().unwrap();
        let section = ranking(&views(logs, &published));
        let rows = |table: &Table| {
            let rows = table.groups.iter().flat_map(|group| &group.rows);
            rows.map(|row| row.label.clone()).collect()
        };
        let notices = section.blocks.iter().filter_map(|block| match block {
            ReportBlock::Notice(notice) => Some(notice.clone()),
            _ => None,
        });
        (section.tables().map(rows).collect(), notices.collect())
    }

    fn named(name: &str, log: RunLog) -> RunLog {
        RunLog { name: name.to_owned(), ..log }
    }

    #[test]
    fn runs_whose_figures_differ_by_rounding_stand_in_the_order_of_their_names() {
        // 3 and 5 of 6 cases are 66.66666666666666 % on average, 2 of 3 are 66.66666666666667 %.
        let run_of = |name: &str, counts: &[(usize, usize)]| {
            let of_run = |(run, &(successes, cases)): (u32, &(usize, usize))| {
                let of_case = move |case: usize| {
                    let record = record(&format!("t01-{case:02}"), case < successes);
                    keyed(EpisodeRecord { run, ..record })
                };
                (0..cases).map(of_case)
            };
            named(name, log((1..).zip(counts).flat_map(of_run).collect()))
        };
        let (lower, higher) = (run_of("a", &[(3, 6), (5, 6)]), run_of("b", &[(2, 3)]));
        for logs in [[lower.clone(), higher.clone()], [higher, lower]] {
            assert_eq!(ranked(&logs).0, [["a", "b"]]);
        }
    }

    #[test]
    fn the_best_is_first_and_runs_with_another_protocol_are_apart() {
        let run = |name: &str, success: bool, seed: u64| {
            let mut log = log(vec![record("t01-01", success), record("t01-02", true)]);
            log.manifest.settings.seed = seed;
            named(name, log)
        };
        let logs = [run("weak", false, 1), run("strong", true, 1), run("other", true, 2)];
        let (mut tables, notices) = ranked(&logs);
        tables.sort();
        assert_eq!(tables, [vec!["other"], vec!["strong", "weak"]]);
        assert_eq!(notices.len(), 1, "{notices:?}");
        assert!(notices[0].starts_with("Not comparable: seed is "), "{notices:?}");
        let mut unit = run("unit", true, 1);
        unit.manifest.unit = Some(UnitId { plan: String::new(), number: 3 });
        let (tables, notices) = ranked(&[logs[0].clone(), unit]);
        assert_eq!(tables, [["weak"]]);
        assert!(notices[0].contains("unit is not ranked: it is unit 3 of a plan"), "{notices:?}");
    }

    #[test]
    fn runs_of_other_worlds_without_hashes_are_apart() {
        let run = |name: &str, world: &str, instruction: &str| {
            let mut log = log(vec![record("a", true)]);
            log.manifest.hashes.clear();
            log.world.declaration.name = world.to_owned();
            let case = case_book::CaseFacts {
                id: "a".to_owned(),
                task: 1,
                instruction: instruction.to_owned(),
                paraphrase: None,
                references: Vec::new(),
                invalidated_when_blocked: false,
            };
            log.cases.insert("a".to_owned(), case);
            named(name, log)
        };
        let door = "Go to the door.";
        let logs = [run("first", "kitchen", door), run("same", "kitchen", door)];
        assert_eq!(ranked(&logs).0.len(), 1);
        for other in [run("other", "cellar", door), run("other", "kitchen", "Open it.")] {
            let (tables, notices) = ranked(&[logs[0].clone(), other]);
            assert_eq!((tables.len(), notices.len()), (2, 1), "{notices:?}");
        }
    }

    #[test]
    fn of_stream_settings_those_that_differ_are_named() {
        let run = |name: &str, blocks, orders: &[StreamOrder]| {
            let mut log = stream_log(vec![stream_record("t01-01", true)], [blocks, 1, 2]);
            log.manifest.settings.stream.as_mut().unwrap().orders = orders.to_vec();
            named(name, log)
        };
        let (tables, notices) =
            ranked(&[run("a", 2, &StreamOrder::ALL), run("b", 3, &[StreamOrder::Drawn])]);
        assert_eq!(tables.len(), 0, "no sequence is complete");
        let is_named = |part: &str| notices.iter().any(|notice| notice.contains(part));
        assert!(is_named("stream.blocks is ") && is_named("stream.orders is "), "{notices:?}");
        assert_eq!(notices.len(), 2, "{notices:?}");
    }
}
