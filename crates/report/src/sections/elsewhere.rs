//! Demonstrations in another warehouse: what memory knows in general, apart from routes and places that it has memorised.

use domain::{MemoryKind, Representation};

use crate::document::{ReportBlock, ReportSection, RowGroup, Table};
use crate::sections::pairs::{columns, row};
use crate::view::{ScoredRun, name};

const SETTING: &str = "new/unchanged";
const ELSEWHERE: &str = "elsewhere";

/// The section, if the run has such demonstrations from the new start.
pub(super) fn section(view: &ScoredRun<'_>) -> Option<ReportSection> {
    let has_run = |name: &String| {
        view.scores.conditions.iter().any(|score| score.condition.to_string() == *name)
    };
    let group = |&memory: &MemoryKind| {
        let elsewhere = name(memory, SETTING, ELSEWHERE);
        let mut rows = Vec::new();
        if memory.uses_demonstrations() && has_run(&elsewhere) {
            for (label, demonstrations) in
                [("1 demo here − elsewhere", "original"), ("4 demos here − elsewhere", "4")]
            {
                let here = name(memory, SETTING, demonstrations);
                rows.extend(has_run(&here).then(|| row(view, label, &here, &elsewhere)));
            }
            let nothing = name(Representation::Working.into(), SETTING, "none");
            let label = "elsewhere − working memory";
            rows.extend(has_run(&nothing).then(|| row(view, label, &elsewhere, &nothing)));
        }
        RowGroup { label: Some(view.label(memory)), rows }
    };
    let memories = view.memories();
    let groups = memories.iter().map(group).filter(|group| !group.rows.is_empty());
    let table = Table {
        id: view.id(ELSEWHERE),
        caption: "The same tasks with demonstrations of the warehouse that is tested (here) and of another one (elsewhere), \
                  from the new start on the unchanged route, paired by case: first minus second. What a memory gains from \
                  elsewhere over working memory is general knowledge; what it gains from here beyond that belongs to the place."
            .to_owned(),
        stubs: vec!["Representation".to_owned(), "Comparison".to_owned()],
        columns: columns(),
        groups: groups.collect(),
    };
    let blocks = vec![ReportBlock::Table(table.pruned()?)];
    Some(ReportSection::new(view.id("s-elsewhere"), "Demonstrations in another warehouse", blocks))
}
