//! The time of a step by stage.

use domain::MemoryKind;
use run_log::Stages;
use scores::StageTimes;

use crate::document::{Missing, ReportBlock, RowGroup, Table, TableColumn, TableRow};
use crate::plot::{Stack, StackRow, stack};
use crate::view::{ScoredRun, plain_or};

/// The stages in which something is computed; the others are transport between processes.
const WORK: [&str; 6] = ["dynamics", "render", "embed", "search", "assemble", "decide"];

const NO_STAGE: Missing = Missing::NotApplicable("this memory or policy has no such stage");

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let Some(table) = time_table(view) else { return Vec::new() };
    let bar = |(memory, times): (MemoryKind, StageTimes)| {
        let work = WORK.map(|stage| times.stage(stage).unwrap_or(0.0) / 1000.0);
        let between = times.sum / 1000.0 - work.iter().sum::<f64>();
        StackRow {
            heading: None,
            label: view.label(memory),
            lengths: Some(work.into_iter().chain([between]).collect()),
        }
    };
    let figure = stack(&Stack {
        id: view.id("time-figure"),
        caption: "Mean time of a step by stage. Between: transport from process to process, and waiting there."
            .to_owned(),
        axis: "Time of a step, ms",
        to: None,
        parts: WORK.iter().copied().chain(["between"]).map(str::to_owned).collect(),
        rows: StageTimes::by_memory(view.log).into_iter().map(bar).collect(),
    });
    vec![ReportBlock::Figure(figure), ReportBlock::Table(table)]
}

/// A row for each stage, a column for each memory; `None` when nothing was timed.
pub(crate) fn time_table(view: &ScoredRun<'_>) -> Option<Table> {
    let times = StageTimes::by_memory(view.log);
    let row = |label: &str, us: &dyn Fn(&StageTimes) -> Option<f64>| {
        let cells = times.iter().map(|(_, times)| plain_or(us(times), 0, NO_STAGE));
        TableRow::new(label, cells.collect())
    };
    let stages = Stages::NAMES.iter().map(|stage| row(stage, &|times| times.stage(stage)));
    let rows = stages.chain([row("sum", &|times| Some(times.sum))]).collect();
    (!times.is_empty()).then(|| Table {
        id: view.id("time"),
        caption: "Mean time of a step by stage, in microseconds, over all conditions of a memory. The sum is the time \
                  from one command to the next. Episodes in different lanes are in different stages at once, and \
                  waiting for a busy process counts for the stage that waits, so this is a step's latency and not its \
                  cost. Depends on the machine and on the number of lanes."
            .to_owned(),
        stubs: vec!["Stage".to_owned()],
        columns: times.iter().map(|(memory, _)| TableColumn::new(view.label(*memory))).collect(),
        groups: vec![RowGroup { label: None, rows }],
    })
}
