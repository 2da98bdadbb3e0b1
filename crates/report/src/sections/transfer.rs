//! Table `tab:transfer` (RQ1): the test stays at the original start, the demonstration's start changes.

use crate::document::{ReportBlock, Table};
use crate::sections::main_table::{Setting, names, rate_figure, rates_by_memory};
use crate::view::{ScoredRun, our_rates, pair_stubs, rate_columns, their_rates};

const SETTINGS: [Setting; 4] = [
    ("Original start", "original/unchanged", "original"),
    ("Opposite heading", "original/unchanged", "opposite"),
    ("Nearby start", "original/unchanged", "nearby"),
    ("Distant start", "original/unchanged", "distant"),
];

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let names = |memory| names(memory, SETTINGS);
    if !view.historical().into_iter().any(|memory| view.has_any(&names(memory)[1..])) {
        return Vec::new();
    }
    let table = Table {
        id: view.id("transfer"),
        caption: "RQ1: demonstrations from other starts (the paper's table “RQ1: Changing starting pose”). The test starts \
                  at the original pose; the columns vary the start of the one demonstration in memory. The \
                  figures for the original start are also in the table of the three questions."
            .to_owned(),
        stubs: pair_stubs(),
        columns: rate_columns(&SETTINGS.map(|(heading, _, _)| heading)),
        groups: view.pairs(
            &view.historical(),
            |memory| names(memory).iter().flat_map(|name| our_rates(view, name)).collect(),
            |memory| names(memory).iter().flat_map(|name| their_rates(view, name)).collect(),
        ),
    };
    let figure = rate_figure(
        view.id("transfer-figure"),
        "Success rate at the original start, by the demonstration in memory. Filled: this run with its 95 % interval. \
         Open: published, mean ± standard deviation.",
        rates_by_memory(view, &view.historical(), SETTINGS),
    );
    table.pruned().map(ReportBlock::Table).into_iter().chain(figure).collect()
}
