//! What each memory supplied, how long that took, and how large it is.

use domain::MemoryKind;
use scores::MemoryScore;

use crate::document::{Missing, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, plain_or};

const BUILT_IN: Missing =
    Missing::NotApplicable("a built-in memory has no messages of its own, and asks no model");
const NOT_TOLD: Missing = Missing::NotMeasured("the memory does not tell it");

/// A row for each memory; `None` where nothing was supplied, or the log is an earlier one.
pub(crate) fn supplied_table(view: &ScoredRun<'_>) -> Option<Table> {
    let scores = MemoryScore::by_memory(view.log);
    let row = |(memory, score): &(MemoryKind, MemoryScore)| {
        let untold = if memory.external().is_some() { NOT_TOLD } else { BUILT_IN };
        let external = |value: Option<f64>| plain_or(value, 0, untold.clone());
        let store = score.store_bytes.map(|bytes| bytes as f64 / 1024.0);
        let cells = vec![
            TableCell::Value(format!("{:.2}", score.items_each)),
            TableCell::Value(format!("{:.2}", score.images_each)),
            TableCell::Value(format!("{:.0}", score.text_each)),
            TableCell::Value(score.items_dropped.to_string()),
            TableCell::Value(format!("{:.0}", score.recall_us)),
            external(score.method_us),
            external(score.wire_us),
            plain_or(store, 1, NOT_TOLD),
            external(score.tokens_each),
        ];
        TableRow::new(view.label(*memory), cells)
    };
    let rows: Vec<TableRow> = scores.iter().map(row).collect();
    let columns =
        ["Items", "Images", "Text", "Dropped", "Recall us", "Method us", "Wire us", "Store KiB"];
    (!rows.is_empty()).then(|| Table {
        id: view.id("supplied"),
        caption: "What each memory supplied, over all its conditions, outside of streams without control arms. Items, images, bytes of text: means of an answer, \
                  beside the current view and the window. Dropped: items that exceeded the memory's budgets. Recall: \
                  mean microseconds from the observation to the recall, embedding included. Of an external memory, \
                  method: what it computed, by its own clock; wire: the messages to it and back, and waiting \
                  while it answers other lanes. Store: the largest \
                  size that the memory reported. Tokens: of its own requests to a model, mean of an answer."
            .to_owned(),
        stubs: vec!["Memory".to_owned()],
        columns: columns.into_iter().chain(["Tokens"]).map(TableColumn::new).collect(),
        groups: vec![RowGroup { label: None, rows }],
    })
}
