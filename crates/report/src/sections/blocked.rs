//! Table `tab:rq2`: what a blocked route does to each representation.

use results::score::{BlockedScore, Derived};

use crate::document::{Missing, Table, TableCell, TableColumn};
use crate::view::{ScoredRun, name, pair_stubs, published_text, signed, sure_or, with_interval};

const NEEDS_BOTH: Missing = Missing::NotMeasured(
    "needs the unchanged and the blocked route, for change also those of working memory",
);
const NOTHING_TO_RETAIN: Missing =
    Missing::Undefined("no episode succeeds on the unchanged route, so there is nothing to retain");
pub(super) const NONE_TRIED: Missing =
    Missing::Undefined("no episode tried to enter a closed cell, so none could recover");

/// The paper's table with the run's figures; `None` where no blocked route was run.
pub(crate) fn blocked_table(view: &ScoredRun<'_>) -> Option<Table> {
    let blocked = |representation| name(representation, "new/blocked", "4");
    let unchanged = |representation| name(representation, "new/unchanged", "4");
    let ours = |representation| {
        let cell = |figure: &dyn Fn(&BlockedScore) -> TableCell| {
            view.ours(&blocked(representation), |score| {
                score.blocked.as_ref().map_or(TableCell::Missing(NEEDS_BOTH), figure)
            })
        };
        let no_retention = match view.score(&unchanged(representation)) {
            Some(_) => NOTHING_TO_RETAIN,
            None => NEEDS_BOTH,
        };
        vec![
            cell(&|found| derived(found.change, |value| signed(value, 1), 1, &NEEDS_BOTH)),
            cell(&|found| {
                derived(found.retention, |value| format!("{value:.2}"), 2, &no_retention)
            }),
            cell(&|found| sure_or(found.follow, 1, Missing::NotMeasured("no episode finished"))),
            cell(&|found| sure_or(found.recovery, 1, NONE_TRIED)),
        ]
    };
    let theirs = |representation| {
        let name = blocked(representation);
        vec![
            view.theirs(&name, |p| p.change.map(|change| signed(change, 1))),
            view.theirs(&name, |p| p.retention.map(|retention| format!("{retention:.2}"))),
            view.theirs(&name, |p| p.follow.map(published_text)),
            view.theirs(&name, |p| p.recovery.map(published_text)),
        ]
    };
    let table = Table {
        id: view.id("blocked"),
        caption: "RQ2: responses to a blocked route (the paper's table “RQ2: Responses to a blocked route”). New start, four demonstrations. \
                  Δ: change of the success rate by blocking minus working memory's change, in percentage points. \
                  Retention: success rate blocked over unchanged. Follow: percentage of episodes that tried to enter \
                  a closed cell. Recovery: success rate of those, over the runs in which there is one. Intervals of \
                  95 % in brackets."
            .to_owned(),
        stubs: pair_stubs(),
        columns: ["Δ", "Retention", "Follow %", "Recovery %"].map(TableColumn::new).to_vec(),
        groups: view.pairs(&view.memories(), ours, theirs),
    };
    table.pruned()
}

fn derived(
    found: Option<Derived>,
    shown: impl Fn(f64) -> String,
    digits: usize,
    missing: &Missing,
) -> TableCell {
    found.map_or(TableCell::Missing(missing.clone()), |Derived { value, interval }| {
        with_interval(shown(value), interval, digits)
    })
}
