//! Figure `fig:rq3` and its numbers: four demonstrations, of which two are replaced by other tasks' histories.

use domain::MemoryKind;

use crate::document::{Missing, ReportBlock, Table, TableCell, TableColumn};
use crate::sections::main_table::{Setting, names, rate_figure, rates_by_memory};
use crate::view::{ScoredRun, pair_stubs, published_text, sure, sure_or};

const SETTINGS: [Setting; 3] = [
    ("4 relevant", "new/unchanged", "4"),
    ("2 of 4 irrelevant", "new/unchanged", "irrelevant"),
    ("2 of 4 confusable", "new/unchanged", "confusable"),
];

pub(super) const NO_RETRIEVAL: Missing = Missing::NotApplicable(
    "of the built-in memories only Episodic and Adaptive retrieve; the others supply the same at each step",
);

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let names = |memory| names(memory, SETTINGS);
    if !view.historical().into_iter().any(|memory| view.has_any(&names(memory)[1..])) {
        return Vec::new();
    }
    let figure = rate_figure(
        view.id("mixed-figure"),
        "RQ3: success under mixed histories (the paper's figure “RQ3: Success under mixed histories”). New start, unchanged \
         route, four demonstrations; in the mixed sets two of them are replaced by other tasks' histories. Filled: this run \
         with its 95 % interval. Open: published, where it prints a number.",
        rates_by_memory(view, &view.historical(), SETTINGS),
    );
    let headings = SETTINGS.map(|(heading, _, _)| heading);
    let mut columns = headings.map(|heading| TableColumn::under("SR %", heading)).to_vec();
    columns.extend(headings[1..].iter().map(|one| TableColumn::under("From other tasks, %", *one)));
    let ours = |memory: MemoryKind| {
        let names = names(memory);
        let mut cells: Vec<TableCell> =
            names.iter().map(|name| view.ours(name, |score| sure(score.sr, 1))).collect();
        cells.extend(names[1..].iter().map(|name| match memory.retrieves() {
            false => TableCell::Missing(NO_RETRIEVAL),
            true => view.ours(name, |score| {
                let missing = Missing::NotMeasured("nothing was retrieved");
                sure_or(score.from_other_cases, 1, missing)
            }),
        }));
        cells
    };
    let theirs = |memory: MemoryKind| {
        let names = names(memory);
        let mut cells: Vec<TableCell> = names
            .iter()
            .map(|name| view.theirs(name, |p| Some(published_text(p.sr?, 1))))
            .collect();
        cells.extend(names[1..].iter().map(|name| match memory.retrieves() {
            false => TableCell::Missing(NO_RETRIEVAL),
            true => view.theirs(name, |p| Some(published_text(p.from_others?, 1))),
        }));
        cells
    };
    let table = Table {
        id: view.id("mixed"),
        caption: "RQ3 in numbers: success rate by the composition of the four demonstrations, and the percentage of \
                  retrievals that came from another task's history. Irrelevant histories share no pose with the test's \
                  reference route; confusable ones share poses and continue differently from there."
            .to_owned(),
        stubs: pair_stubs(),
        columns,
        groups: view.pairs(&view.historical(), ours, theirs),
    };
    figure.into_iter().chain(table.pruned().map(ReportBlock::Table)).collect()
}
