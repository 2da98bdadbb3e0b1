//! Controls: each memory beside the same memory with the right content, with wrong content, and beside working memory.

use std::collections::BTreeSet;

use domain::MemoryKind;
use scores::{CertifiedSuccess, Comparison, ControlCondition, ControlScore, Spread};

use super::conditions::setting;
use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, plain_or, signed, sure_or, with_interval};

const OWN_ORACLE: Missing =
    Missing::NotApplicable("the original demonstration is the reference from the original start");
const NO_CERTIFIED: Missing = Missing::Undefined("no case is certified");

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let tables = [controls_table(view), certified_table(view)];
    let mut blocks = ReportBlock::tables(tables);
    if !blocks.is_empty() {
        let text = "The arm oracle holds the test reference of the case and route in place of demonstrations, the arm wrong holds \
                    demonstrations of other tasks, and of documents those of another warehouse. Both are supplied like the \
                    memory itself. Content is what the memory gains over wrong content, and so not from having any; wrong \
                    content may mislead, which the difference of wrong and working shows. A policy that leaves the memory \
                    out does the same whatever it holds: its content is 0 but for chance. Headroom is what is left to gain by this \
                    form of memory.";
        blocks.insert(0, ReportBlock::Text(text.to_owned()));
    }
    blocks
}

/// A table of the memories with controls; `None` without any.
fn table(
    view: &ScoredRun<'_>,
    (id, caption, columns): (&str, &str, Vec<TableColumn>),
    cells: impl Fn(&ControlScore) -> Option<Vec<TableCell>>,
) -> Option<Table> {
    let scores = &view.scores.controls;
    let memories: BTreeSet<MemoryKind> = scores.iter().map(|one| one.condition.memory).collect();
    let group = |memory: MemoryKind| {
        let of_memory = scores.iter().filter(|one| one.condition.memory == memory);
        let rows = of_memory
            .filter_map(|one| Some(TableRow::new(setting(&one.condition), cells(one)?)))
            .collect();
        RowGroup { label: Some(view.label(memory)), rows }
    };
    let table = Table {
        id: view.id(id),
        caption: caption.to_owned(),
        stubs: vec!["Memory".to_owned(), "Setting".to_owned()],
        columns,
        groups: memories.into_iter().map(group).collect(),
    };
    table.pruned()
}

/// Success of each memory and of its controls, and the paired differences; `None` without controls.
pub(crate) fn controls_table(view: &ScoredRun<'_>) -> Option<Table> {
    let names = ["memory", "oracle", "wrong", "working"];
    let mut columns = names.map(|name| TableColumn::under("SR %", name)).to_vec();
    columns.extend(["Content", "Headroom"].map(TableColumn::new));
    let caption = "Each memory beside its controls. Setting: start, route and demonstrations. SR %: success rate, mean over runs, of the memory, of its oracle, of the memory \
                   with wrong content, and of working memory. Content: the memory minus wrong content; headroom: the oracle \
                   minus the memory; in percentage points, on pairs of episodes of the same case and repetition, with 95 % intervals \
                   over cases.";
    table(view, ("controls", caption, columns), |one| {
        let is_own_oracle = one.oracle.is_some_and(|oracle| oracle.condition == one.condition);
        let rate = |control: Option<ControlCondition>| {
            plain_or(control.map(|control| control.sr.mean), 1, Missing::NotRun)
        };
        let difference = |compared: &Option<Comparison>, missing| match compared {
            Some(Comparison { sr, .. }) => with_interval(signed(sr.mean, 1), sr.interval, 1),
            None => TableCell::Missing(missing),
        };
        let (oracle, left) = match is_own_oracle {
            true => (TableCell::Missing(OWN_ORACLE), OWN_ORACLE),
            false => (rate(one.oracle), Missing::NotRun),
        };
        Some(vec![
            plain_or(Some(one.sr.mean), 1, Missing::NotRun),
            oracle,
            rate(one.wrong),
            rate(one.working),
            difference(&one.content, Missing::NotRun),
            difference(&one.headroom, left),
        ])
    })
}

/// The share of cases that need memory, and success on those; `None` where working memory or every oracle is missing.
pub(crate) fn certified_table(view: &ScoredRun<'_>) -> Option<Table> {
    let mut columns = vec![TableColumn::new("Cases"), TableColumn::new("Share %")];
    for over in ["All cases", "Certified"] {
        columns.extend(["memory", "wrong"].map(|name| TableColumn::under(over, name)));
    }
    let caption = "Cases of which most episodes fail with working memory and most succeed with the oracle: those certify that memory \
                   matters to this policy. Cases: certified ones, of all that have both. Success rate in percent on all of these, and \
                   on certified ones, of the memory, with its 95 % interval over cases, and of the memory with wrong content. Working \
                   memory and the oracle decide which cases are certified, so their success on those is so by selection and is not \
                   shown.";
    table(view, ("controls-necessity", caption, columns), |one| {
        let found = one.necessity.as_ref()?;
        let share = 100.0 * found.certified as f64 / found.cases as f64;
        let of =
            |condition| found.success.iter().find(|success| Some(success.condition) == condition);
        let both = [of(Some(one.condition)), of(one.wrong.map(|wrong| wrong.condition))];
        // Only the memory's figures have room for intervals in a terminal.
        let rates = |figure: fn(&CertifiedSuccess) -> Option<Spread>, missing: Missing| {
            let of = |success: Option<&CertifiedSuccess>| success.map(figure);
            let [memory, wrong] = both.map(of);
            let wrong = match wrong {
                Some(wrong) => plain_or(wrong.map(|spread| spread.mean), 1, missing.clone()),
                None => TableCell::Missing(Missing::NotRun),
            };
            [sure_or(memory.flatten(), 1, missing), wrong]
        };
        let all = rates(|success| success.all, Missing::NotRun);
        let certified = rates(|success| success.certified, NO_CERTIFIED);
        let mut cells = vec![
            TableCell::Value(format!("{} of {}", found.certified, found.cases)),
            TableCell::Value(format!("{share:.1}")),
        ];
        cells.extend(all.into_iter().chain(certified));
        Some(cells)
    })
}
