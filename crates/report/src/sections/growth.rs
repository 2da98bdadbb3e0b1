//! Banks of different sizes: success, right retrievals and costs against size.

use scores::GrowthScore;

use super::main_table::{NO_TOKENS, rate_figure, rate_rows};
use super::missing::{NO_RECALL, NO_STORE, NOTHING_RETRIEVED};
use super::mixed::NO_RETRIEVAL;
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::plot::{Curve, Curves, curves};
use crate::view::{ScoredRun, plain_or, sure};

const NO_TYPE: Missing =
    Missing::NotMeasured("the log does not tell the type of every source's task");

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let groups: Vec<&[GrowthScore]> = by_memory(view).collect();
    let rows = groups.iter().flat_map(|scores| {
        let labelled: Vec<(String, String)> =
            scores.iter().map(|one| (label(one), one.score.condition.to_string())).collect();
        rate_rows(view, &heading(view, scores), &labelled)
    });
    let success = rate_figure(
        view.id("growth-figure"),
        "Success rate by the number of demonstrations in the bank, with its 95 % interval.",
        rows.collect(),
    );
    let curve = |up: &str, value: fn(&GrowthScore) -> Option<f64>| {
        let of = |scores: &&[GrowthScore]| {
            let points = scores.iter().filter_map(|one| Some((f64::from(one.size), value(one)?)));
            let points: Vec<(f64, f64)> = points.filter(|point| point.0 > 0.0).collect();
            (points.len() > 1).then(|| Curve {
                name: heading(view, scores),
                is_bound: false,
                points,
            })
        };
        let shown: Vec<Curve> = groups.iter().filter_map(of).collect();
        (!shown.is_empty()).then(|| {
            let (name, unit) = up.split_once(", ").unwrap_or((up, ""));
            let id = name.to_lowercase();
            ReportBlock::Figure(curves(&Curves {
                id: view.id(&format!("growth-{id}")),
                caption: format!(
                    "{name} against the number of demonstrations in the bank ({unit})."
                ),
                across: "Demonstrations in the bank".to_owned(),
                up: up.to_owned(),
                curves: shown,
            }))
        })
    };
    let latency = curve("Search, us", |one| one.search_us);
    let store = curve("Store, KiB", |one| Some(one.store_bytes? as f64 / 1024.0));
    let table = growth_table(view).map(ReportBlock::Table);
    table.into_iter().chain(success).chain(latency).chain(store).collect()
}

/// The scores, by memory, start, route and variation.
fn by_memory<'a>(view: &'a ScoredRun<'_>) -> impl Iterator<Item = &'a [GrowthScore]> {
    view.scores.growth.chunk_by(|a, b| heading_key(view, a) == heading_key(view, b))
}

fn heading_key(view: &ScoredRun<'_>, one: &GrowthScore) -> String {
    let condition = one.score.condition;
    let rest = format!("{} {}{}", condition.start, condition.route, condition.deviations());
    let usual = "new unchanged";
    let rest = if rest == usual { String::new() } else { format!(", {rest}") };
    view.label(condition.memory) + &rest
}

fn heading(view: &ScoredRun<'_>, scores: &[GrowthScore]) -> String {
    scores.first().map(|one| heading_key(view, one)).unwrap_or_default()
}

fn label(one: &GrowthScore) -> String {
    if one.size == 0 { "none".to_owned() } else { one.size.to_string() }
}

/// A row for each size of each memory; `None` without banks.
pub(crate) fn growth_table(view: &ScoredRun<'_>) -> Option<Table> {
    let row = |one: &GrowthScore| {
        let retrieves = one.score.condition.memory.retrieves();
        let share = |value: Option<f64>, missing| match retrieves {
            false => TableCell::Missing(NO_RETRIEVAL),
            true => plain_or(value, 1, missing),
        };
        let kib = one.store_bytes.map(|bytes| bytes as f64 / 1024.0);
        let cells = vec![
            sure(one.score.sr, 1),
            share(one.from_own_case, NOTHING_RETRIEVED),
            share(one.from_same_type, NO_TYPE),
            plain_or(one.search_us, 1, NO_RECALL),
            plain_or(one.recall_us, 1, NO_RECALL),
            plain_or(kib, 0, NO_STORE),
            plain_or(one.images, 1, NO_RECALL),
            plain_or(one.tokens, 0, NO_TOKENS),
        ];
        TableRow::new(label(one), cells)
    };
    let groups: Vec<RowGroup> = by_memory(view)
        .map(|scores| RowGroup {
            label: Some(heading(view, scores)),
            rows: scores.iter().map(row).collect(),
        })
        .collect();
    let mut columns = vec![TableColumn::new("SR %")];
    columns.extend(["own case", "same type"].map(|name| TableColumn::under("Sources %", name)));
    columns.extend(["search, us", "recall, us"].map(|name| TableColumn::under("Time", name)));
    columns.extend(["Store, KiB", "Images", "Tokens"].map(TableColumn::new));
    (!groups.is_empty()).then(|| Table {
        id: view.id("growth"),
        caption: "The same cases by the number of demonstrations in the bank; a larger bank holds the smaller ones. Sources: \
                  percentage of the retrieved sources that are demonstrations of the episode's own case, or of a case with a \
                  task of the same type. Search and recall: means of a step; recall includes embedding the view, and the wait for the memory at the first step. Both depend on \
                  the machine and its load. Store: the largest size that the memory reported. Images and tokens: injected memory in \
                  a request; tokens are an estimate."
            .to_owned(),
        stubs: vec!["Memory".to_owned(), "Demonstrations".to_owned()],
        columns,
        groups,
    })
}
