//! Table `tab:tasks`: success rate by task group, unchanged and blocked.

use domain::TaskGroup;

use crate::document::{Missing, ReportBlock, Table, TableCell, TableColumn};
use crate::view::{ScoredRun, name, pair_stubs, plain_or};

const HEADINGS: [(TaskGroup, &str); 4] = [
    (TaskGroup::Basic, "Basic (T1–T2)"),
    (TaskGroup::MultiObject, "Multi-object (T3–T6)"),
    (TaskGroup::ReturnLoop, "Return loops (T7, T8, T10)"),
    (TaskGroup::Revisit, "Revisit (T9)"),
];

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let columns = HEADINGS.iter().flat_map(|(_, heading)| {
        ["unchanged", "blocked"].map(|route| TableColumn::under(*heading, route))
    });
    let names = |representation| {
        ["new/unchanged", "new/blocked"].map(|rest| name(representation, rest, "4"))
    };
    let each = |representation, cell: &dyn Fn(TaskGroup, &str) -> TableCell| {
        let names = names(representation);
        let both = |(group, _): &(TaskGroup, &str)| names.each_ref().map(|name| cell(*group, name));
        HEADINGS.iter().flat_map(both).collect::<Vec<_>>()
    };
    let ours = |representation| {
        each(representation, &|group, name| {
            view.ours(name, |score| {
                let found = score.groups.iter().find(|found| found.group == group);
                let missing =
                    Missing::NotMeasured("the run's selection of cases has none of this group");
                plain_or(found.map(|found| found.sr.mean), 0, missing)
            })
        })
    };
    let theirs = |representation| {
        each(representation, &|group, name| {
            view.theirs(name, |published| {
                published.group(group.name()).map(|rate| format!("{rate:.0}"))
            })
        })
    };
    let table = Table {
        id: view.id("groups"),
        caption: "Success rate in percent by task group, mean over runs (the paper's table “Task completion across navigation requirements”). New start, four \
                  demonstrations."
            .to_owned(),
        stubs: pair_stubs(),
        columns: columns.collect(),
        groups: view.pairs(&view.memories(), ours, theirs),
    };
    ReportBlock::tables([table.pruned()])
}
