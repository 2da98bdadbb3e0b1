//! Table `tab:tasks`: success rate by task group, unchanged and blocked.

use case_book::TaskGroupFacts;

use crate::document::{Missing, ReportBlock, Table, TableCell, TableColumn};
use crate::view::{ScoredRun, name, pair_stubs, plain_or, published_text};

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let groups = &view.log.world.groups;
    let columns = groups.iter().flat_map(|group| {
        ["unchanged", "blocked"].map(|route| TableColumn::under(&*group.heading, route))
    });
    let names = |representation| {
        ["new/unchanged", "new/blocked"].map(|rest| name(representation, rest, "4"))
    };
    let each = |representation, cell: &dyn Fn(&str, &str) -> TableCell| {
        let names = names(representation);
        let both = |group: &TaskGroupFacts| names.each_ref().map(|name| cell(&group.name, name));
        groups.iter().flat_map(both).collect::<Vec<_>>()
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
            view.theirs(name, |published| Some(published_text(published.group(group)?, 0)))
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
