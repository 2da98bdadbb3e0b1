//! Every condition that was run.

use conditions::{Condition, Route};
use domain::Arm;
use scores::ConditionScore;

use super::main_table::{NO_REQUESTS, NO_TOKENS};
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, interval_text, plain_or, spread_text};

const NO_RETRIEVAL: Missing = Missing::NotApplicable("nothing is retrieved under this condition");
const ONE_CASE: Missing = Missing::NotMeasured("one case says nothing about others");

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let mut table = conditions_table(view);
    table.columns.extend(["Mtok", "Unreadable %", "Other tasks %"].map(TableColumn::new));
    let rows = table.groups.iter_mut().flat_map(|group| &mut group.rows);
    for (row, score) in rows.zip(&view.scores.conditions) {
        row.cells.extend([
            plain_or(score.tokens_per_100.map(|tokens| tokens.mean / 1e6), 2, NO_TOKENS),
            plain_or(score.unread.map(|unread| unread.mean), 2, NO_REQUESTS),
            plain_or(score.from_other_cases.map(|share| share.mean), 1, NO_RETRIEVAL),
        ]);
    }
    table.caption = "Every condition that was run. N: finished episodes, and planned ones where some are missing. SR \
                     %: success rate, mean ± sample standard deviation over runs. SPL, steps, images per request (Img), million \
                     tokens per 100 cases (Mtok), percentage of unreadable answers and of retrievals from another \
                     task's history: means. conditions.csv and conditions.parquet hold every figure in full."
        .to_owned();
    ReportBlock::tables([table.pruned()])
}

/// The conditions by memory with success rate, interval, SPL, steps and images.
pub(crate) fn conditions_table(view: &ScoredRun<'_>) -> Table {
    let scores = &view.scores.conditions;
    let groups = scores.chunk_by(|a, b| a.condition.memory == b.condition.memory);
    let group = |scores: &[ConditionScore]| RowGroup {
        label: scores.first().map(|score| view.label(score.condition.memory)),
        rows: scores.iter().map(row).collect(),
    };
    Table {
        id: view.id("conditions"),
        caption: String::new(),
        stubs: vec!["Memory".to_owned(), "Start, route, demonstrations".to_owned()],
        columns: ["N", "SR %", "95 % CI", "SPL", "Steps", "Img"].map(TableColumn::new).to_vec(),
        groups: groups.map(group).collect(),
    }
}

fn row(score: &ConditionScore) -> TableRow {
    let episodes = match score.planned > score.episodes {
        true => format!("{}/{}", score.episodes, score.planned),
        false => score.episodes.to_string(),
    };
    let interval = score.sr.interval.map(|interval| TableCell::Value(interval_text(interval, 1)));
    let cells = vec![
        TableCell::Value(episodes),
        TableCell::Value(spread_text(score.sr, 1)),
        interval.unwrap_or(TableCell::Missing(ONE_CASE)),
        TableCell::Value(format!("{:.3}", score.spl.mean)),
        plain_or(score.mean_steps, 1, NO_REQUESTS),
        plain_or(score.images_per_request.map(|images| images.mean), 1, NO_REQUESTS),
    ];
    TableRow::new(setting(&score.condition), cells)
}

/// A condition without its memory: `original, 1 demonstration`.
pub(super) fn setting(condition: &Condition) -> String {
    let mut text = condition.start.to_string();
    if condition.route == Route::Blocked {
        text += " blocked";
    }
    if condition.memory.uses_demonstrations() {
        text += &format!(", {}", held(condition));
    }
    text + &condition.deviations().replace('/', ", ")
}

/// What the memory of a condition holds: its demonstrations, and the arm if it is not `frozen`. In the arm `oracle` no set of
/// demonstrations matters.
pub(super) fn held(condition: &Condition) -> String {
    let Condition { demonstrations, arm, .. } = condition;
    match arm {
        Arm::Frozen => demonstrations.to_string(),
        Arm::Oracle => arm.word().to_owned(),
        Arm::Learning | Arm::Wrong => format!("{demonstrations}, {}", arm.word()),
    }
}
