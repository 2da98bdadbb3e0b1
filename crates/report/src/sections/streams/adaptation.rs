//! Adaptation lag, stale reuse, robustness against the order of blocks.

use domain::StreamOrder;
use scores::{OrderScore, StreamScore};

use super::{by_condition, memory_and_arm, sure};
use crate::document::{Missing, Table, TableCell, TableColumn};
use crate::sections::missing::NOTHING_RETRIEVED;
use crate::view::{ScoredRun, plain_or};

const NEVER: Missing = Missing::Undefined("no case that an event invalidated ever succeeded");
const NO_EVENT: Missing = Missing::Undefined("no event invalidated a case");
const NO_REFERENCE: Missing =
    Missing::NotMeasured("an episode's record does not have the actions of its reference");
const TWO_ORDERS: Missing = Missing::Undefined("no stream was run in three orders");

/// Adaptation lag and stale reuse.
pub(crate) fn adaptation_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.streams.as_ref()?;
    let mut columns = vec![TableColumn::new("Lag"), TableColumn::new("Adapted %")];
    columns.extend(["all", "after events"].map(|name| TableColumn::under("Stale %", name)));
    columns.push(TableColumn::new("t-nDTW"));
    let row = |score: &StreamScore| {
        let no_lag = if score.adapted.is_some() { NEVER } else { NO_EVENT };
        Some(vec![
            sure(score.lag, 1, no_lag),
            sure(score.adapted, 1, NO_EVENT),
            sure(score.stale, 1, NOTHING_RETRIEVED),
            sure(score.stale_after, 1, NOTHING_RETRIEVED),
            sure(score.t_ndtw, 3, NO_REFERENCE),
        ])
    };
    let table = Table {
        id: view.id("stream-adaptation"),
        caption: "Learning episodes. Lag: episodes from the start of a block to the first success of a case whose \
                  demonstration an event has invalidated, that one included; over the blocks in which there is one. Adapted: \
                  share of the blocks with an invalidated case that have such a success. A lag counts only together with \
                  that share. Stale: share of the retrieved sources that complete their task in the world in which they were \
                  recorded, and not in the episode's. t-nDTW: how closely paths follow the references, from 0 to 1."
            .to_owned(),
        stubs: memory_and_arm(),
        columns,
        groups: by_condition(view, scores, row),
    };
    table.pruned()
}

/// Success in each order, and its range.
pub(crate) fn orders_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = view.scores.streams.as_ref()?;
    let names = || StreamOrder::ALL.iter().map(|order| order.word()).chain(["range"]);
    let columns = ["Success %", "ACC"]
        .into_iter()
        .flat_map(|over| names().map(move |name| TableColumn::under(over, name)));
    let row = |score: &StreamScore| {
        let of = |figure: fn(&OrderScore) -> Option<f64>| {
            StreamOrder::ALL.map(|order| match score.orders.iter().find(|one| one.order == order) {
                Some(found) => plain_or(figure(found), 1, TWO_ORDERS),
                None => TableCell::Missing(Missing::NotRun),
            })
        };
        let mut cells = of(|order| order.success).to_vec();
        cells.push(plain_or(score.order_spread.map(|range| range.mean), 1, TWO_ORDERS));
        cells.extend(of(|order| order.average));
        cells.push(plain_or(score.order_spread_average.map(|range| range.mean), 1, TWO_ORDERS));
        Some(cells)
    };
    let table = Table {
        id: view.id("stream-orders"),
        caption: "Success of the learning episodes, and average success after the last block (ACC), by the order of the \
                  blocks. Range: largest minus smallest over the orders of a stream, a mean over streams that were run in \
                  three."
            .to_owned(),
        stubs: memory_and_arm(),
        columns: columns.collect(),
        groups: by_condition(view, scores, row),
    };
    table.pruned()
}
