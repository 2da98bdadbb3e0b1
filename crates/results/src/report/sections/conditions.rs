//! Every condition that was run.

use super::main_table::{NO_REQUESTS, NO_TOKENS};
use crate::report::document::{Block, Cell, Column, Group, Missing, Row, Table};
use crate::report::plot::PlotError;
use crate::report::view::{View, plain_or, sure};
use crate::score::ConditionScore;

const NO_RETRIEVAL: Missing = Missing::NotApplicable("nothing is retrieved under this condition");
const NONE_FINISHED: Missing = Missing::NotMeasured("no episode finished");

pub(super) fn blocks(view: &View<'_>) -> Result<Vec<Block>, PlotError> {
    let columns = [
        "Episodes",
        "Runs",
        "SR %",
        "SPL",
        "Steps",
        "Images",
        "Mtok",
        "Unreadable %",
        "Other tasks %",
    ];
    let row = |score: &ConditionScore| Row {
        label: score.condition.to_string(),
        published: false,
        cells: vec![
            Cell::Value(score.episodes.to_string()),
            Cell::Value(score.runs.to_string()),
            sure(score.sr, 1),
            sure(score.spl, 3),
            plain_or(score.mean_steps, 1, NONE_FINISHED),
            plain_or(score.images_per_request.map(|images| images.mean), 2, NO_REQUESTS),
            plain_or(score.tokens_per_100.map(|tokens| tokens.mean / 1e6), 2, NO_TOKENS),
            plain_or(score.unread.map(|unread| unread.mean), 2, NO_REQUESTS),
            plain_or(score.from_other_cases.map(|share| share.mean), 1, NO_RETRIEVAL),
        ],
    };
    let mut rows: Vec<Row> = view.scores.conditions.iter().map(row).collect();
    if rows.is_empty() {
        let cells = vec![Cell::Missing(Missing::NotRun); columns.len()];
        rows.push(Row { label: "no condition".to_owned(), published: false, cells });
    }
    let table = Table {
        id: view.id("conditions"),
        caption: "Every condition that was run, written memory/start/route/demonstrations and what departs from the \
                  standard. SR and SPL: mean ± standard deviation over runs and 95 % interval; the rest: means. Images: \
                  a request. Mtok: million tokens per 100 cases. Other tasks: retrievals that came from another task's \
                  history. The files conditions.csv and conditions.parquet hold every figure in full."
            .to_owned(),
        stubs: vec!["Condition".to_owned()],
        columns: columns.map(Column::new).to_vec(),
        groups: vec![Group { label: None, rows }],
    };
    Ok(vec![Block::Table(table)])
}
