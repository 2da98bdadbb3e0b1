//! Table `tab:rq2`: what a blocked route does to each representation; and the same with other demonstrations.

use conditions::{Condition, Route};
use domain::MemoryKind;
use scores::{BlockedScore, Derived};

use crate::document::{Missing, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::sections::conditions::held;
use crate::view::{ScoredRun, name, pair_stubs, published_text, signed, sure_or, with_interval};

const NEEDS_BOTH: Missing = Missing::NotMeasured(
    "needs the unchanged and the blocked route, for change also those of working memory",
);
const NOTHING_TO_RETAIN: Missing =
    Missing::Undefined("no episode succeeds on the unchanged route, so there is nothing to retain");
pub(super) const NONE_TRIED: Missing =
    Missing::Undefined("no episode ran into what blocks the way, so none could recover");

const FIGURES: &str = "Δ: change of the success rate by blocking minus working memory's change, in percentage points. \
                       Retention: success rate blocked over unchanged. Follow: percentage of episodes that ran into \
                       what blocks the way. Recovery: success rate of those, over the runs in which there is one. Intervals of \
                       95 % in brackets.";

/// The condition of `memory` in the paper's table.
fn name_in_paper(memory: MemoryKind) -> String {
    name(memory, "new/blocked", "4")
}

/// The paper's table with the run's figures; `None` where none of its conditions was run.
pub(super) fn blocked_table(view: &ScoredRun<'_>) -> Option<Table> {
    let theirs = |memory| {
        let name = name_in_paper(memory);
        vec![
            view.theirs(&name, |p| Some(signed(p.change?.mean, 1))),
            view.theirs(&name, |p| Some(published_text(p.retention?, 2))),
            view.theirs(&name, |p| Some(published_text(p.follow?, 1))),
            view.theirs(&name, |p| Some(published_text(p.recovery?, 1))),
        ]
    };
    let ours = |memory| cells(view, &name_in_paper(memory));
    let table = Table {
        id: view.id("blocked"),
        caption: format!(
            "RQ2: responses to a blocked route (the paper's table “RQ2: Responses to a blocked route”). New start, four \
             demonstrations. {FIGURES}"
        ),
        stubs: pair_stubs(),
        columns: columns(),
        groups: view.pairs(&view.memories(), ours, theirs),
    };
    table.pruned()
}

/// The conditions on a blocked route that the paper's table does not have; `None` where none was run.
pub(super) fn other_blocked_table(view: &ScoredRun<'_>) -> Option<Table> {
    let is_other = |condition: &Condition| condition.to_string() != name_in_paper(condition.memory);
    let table = rows(view, is_other)?;
    let caption = format!(
        "Blocked routes with demonstrations or a prompt that the paper's table does not have. {FIGURES}"
    );
    Some(Table { id: view.id("blocked-others"), caption, ..table })
}

/// All conditions on a blocked route, for a terminal.
pub(crate) fn all_blocked_table(view: &ScoredRun<'_>) -> Option<Table> {
    rows(view, |_| true)
}

/// A row for each condition on a blocked route that `is_shown`.
fn rows(view: &ScoredRun<'_>, is_shown: impl Fn(&Condition) -> bool) -> Option<Table> {
    let conditions = view.scores.conditions.iter().map(|score| score.condition);
    let shown: Vec<Condition> = conditions
        .filter(|condition| condition.route == Route::Blocked && is_shown(condition))
        .collect();
    let row = |condition: &Condition| {
        let label = held(condition) + &condition.deviations().replace('/', ", ");
        TableRow::new(label, cells(view, &condition.to_string()))
    };
    let groups = shown.chunk_by(|a, b| a.memory == b.memory).map(|conditions| RowGroup {
        label: conditions.first().map(|condition| view.label(condition.memory)),
        rows: conditions.iter().map(row).collect(),
    });
    let table = Table {
        id: String::new(),
        caption: String::new(),
        stubs: vec!["Memory".to_owned(), "Demonstrations".to_owned()],
        columns: columns(),
        groups: groups.collect(),
    };
    table.pruned()
}

fn columns() -> Vec<TableColumn> {
    ["Δ", "Retention", "Follow %", "Recovery %"].map(TableColumn::new).to_vec()
}

/// The run's figures of the blocked condition called `name`.
fn cells(view: &ScoredRun<'_>, name: &str) -> Vec<TableCell> {
    let cell = |figure: &dyn Fn(&BlockedScore) -> TableCell| {
        view.ours(name, |score| {
            score.blocked.as_ref().map_or(TableCell::Missing(NEEDS_BOTH), figure)
        })
    };
    let no_retention = match view.score(&name.replacen("/blocked/", "/unchanged/", 1)) {
        Some(_) => NOTHING_TO_RETAIN,
        None => NEEDS_BOTH,
    };
    vec![
        cell(&|found| derived(found.change, |value| signed(value, 1), 1, &NEEDS_BOTH)),
        cell(&|found| derived(found.retention, |value| format!("{value:.2}"), 2, &no_retention)),
        cell(&|found| sure_or(found.follow, 1, Missing::NotMeasured("no episode finished"))),
        cell(&|found| sure_or(found.recovery, 1, NONE_TRIED)),
    ]
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
