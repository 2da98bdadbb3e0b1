//! Table `tab:transfer` (RQ1): the test stays at the original start, the demonstration's start changes.

use crate::document::{ReportBlock, Table};
use crate::sections::main_table::{rate_figure, rate_rows};
use crate::view::{ScoredRun, name, our_rates, pair_stubs, rate_columns, their_rates, title};

const DEMONSTRATIONS: [(&str, &str); 4] = [
    ("Original start", "original"),
    ("Opposite heading", "opposite"),
    ("Nearby start", "nearby"),
    ("Distant start", "distant"),
];

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let names = |representation| {
        DEMONSTRATIONS.map(|(_, which)| name(representation, "original/unchanged", which))
    };
    if !view.historical().into_iter().any(|memory| view.has_any(&names(memory)[1..])) {
        return Vec::new();
    }
    let table = Table {
        id: view.id("transfer"),
        caption: "RQ1: demonstrations from other starts (the paper's table “RQ1: Changing starting pose”). The test starts \
                  at the original pose; the columns vary the start of the one demonstration in memory. The \
                  figures for the original start repeat those of the first table."
            .to_owned(),
        stubs: pair_stubs(),
        columns: rate_columns(&DEMONSTRATIONS.map(|(heading, _)| heading)),
        groups: view.pairs(
            &view.historical(),
            |representation| {
                names(representation).iter().flat_map(|name| our_rates(view, name)).collect()
            },
            |representation| {
                names(representation).iter().flat_map(|name| their_rates(view, name)).collect()
            },
        ),
    };
    let rows = view.historical().into_iter().flat_map(|representation| {
        let labelled: Vec<_> = DEMONSTRATIONS
            .iter()
            .zip(names(representation))
            .map(|((label, _), name)| ((*label).to_owned(), name))
            .collect();
        rate_rows(view, &title(representation), &labelled)
    });
    let figure = rate_figure(
        view.id("transfer-figure"),
        "Success rate at the original start, by the demonstration in memory. Filled: this run with its 95 % interval. \
         Open: published, mean ± standard deviation.",
        rows.collect(),
    );
    table.pruned().map(ReportBlock::Table).into_iter().chain(figure).collect()
}
