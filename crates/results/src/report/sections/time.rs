//! Where the time of a step went.

use domain::Representation;

use crate::log::Stages;
use crate::report::document::{Block, Cell, Column, Group, Missing, Row, Table};
use crate::report::plot::{PlotError, Stack, StackRow, stack};
use crate::report::view::{View, title};
use crate::score::StageTimes;
use crate::table::WORK;

const NO_STAGE: Missing = Missing::NotApplicable("this memory or policy has no such stage");

pub(super) fn blocks(view: &View<'_>) -> Result<Vec<Block>, PlotError> {
    let times = StageTimes::by_memory(view.log);
    let of = |representation: Representation| {
        times.iter().find(|(memory, _)| *memory == representation).map(|(_, times)| times)
    };
    let row = |&representation: &Representation| {
        let cells = match of(representation) {
            None => vec![Cell::Missing(Missing::NotRun); Stages::NAMES.len() + 1],
            Some(times) => Stages::NAMES
                .into_iter()
                .map(|stage| times.stage(stage))
                .chain([Some(times.sum)])
                .map(|us| us.map_or(Cell::Missing(NO_STAGE), |us| Cell::Value(format!("{us:.0}"))))
                .collect(),
        };
        Row { label: title(representation).to_owned(), published: false, cells }
    };
    let mut columns: Vec<Column> =
        Stages::NAMES.map(|stage| Column::under("Stage, µs", stage)).to_vec();
    columns.push(Column::new("Sum"));
    let table = Table {
        id: view.id("time"),
        caption: "Mean time of a step by stage, in microseconds, over all conditions of a memory. The stages together \
                  are the time from a command to the next one. Episodes in different lanes are in different stages at \
                  once, and waiting for a busy process counts for the stage that waits, so this is a step's \
                  latency and not its cost. Depends on the machine and on the number of lanes."
            .to_owned(),
        stubs: vec!["Representation".to_owned()],
        columns,
        groups: vec![Group { label: None, rows: Representation::ALL.iter().map(row).collect() }],
    };
    let bar = |&representation: &Representation| StackRow {
        label: title(representation).to_owned(),
        lengths: of(representation).map(|times| {
            let work = WORK.map(|stage| times.stage(stage).unwrap_or(0.0) / 1000.0);
            let between = times.sum / 1000.0 - work.iter().sum::<f64>();
            work.into_iter().chain([between]).collect()
        }),
    };
    let figure = stack(&Stack {
        id: view.id("time-figure"),
        caption: "Mean time of a step by stage. Between: the ways from process to process, and waiting there."
            .to_owned(),
        axis: "Time of a step, ms",
        to: None,
        parts: WORK.iter().copied().chain(["between"]).map(str::to_owned).collect(),
        rows: Representation::ALL.iter().map(bar).collect(),
    })?;
    Ok(vec![Block::Figure(figure), Block::Table(table)])
}
