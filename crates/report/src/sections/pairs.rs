//! The comparisons that the paper's questions ask for, paired by case and repetition.

use conditions::Condition;
use domain::{ExternalName, MemoryKind, Representation};
use scores::compare::compare_conditions;
use scores::{Comparison, FigureDifference};

use crate::document::{Missing, ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::sections::conditions::setting;
use crate::view::{ScoredRun, name, p_value, signed, with_interval};

/// A condition without its memory: start and route, demonstrations.
type Setting = (&'static str, &'static str);

/// What is compared, then the first setting and the second.
const COMPARED: [(&str, Setting, Setting); 5] = [
    (
        "new − original start (1 demo)",
        ("new/unchanged", "original"),
        ("original/unchanged", "original"),
    ),
    ("4 − 1 demos (new start)", ("new/unchanged", "4"), ("new/unchanged", "original")),
    ("blocked − unchanged (4 demos)", ("new/blocked", "4"), ("new/unchanged", "4")),
    ("irrelevant − 4 relevant", ("new/unchanged", "irrelevant"), ("new/unchanged", "4")),
    ("confusable − 4 relevant", ("new/unchanged", "confusable"), ("new/unchanged", "4")),
];

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let group = |&representation: &MemoryKind| {
        let of = |(rest, demonstrations): (&str, &str)| name(representation, rest, demonstrations);
        let mut rows: Vec<TableRow> = COMPARED
            .iter()
            .map(|&(label, a, b)| (label, of(a), of(b)))
            // Working memory has no demonstrations, so some of these are the same condition twice.
            .filter(|(_, a, b)| a != b)
            .map(|(label, a, b)| row(view, label, &a, &b))
            .collect();
        if representation.uses_demonstrations() {
            let baseline = name(Representation::Working.into(), "new/unchanged", "none");
            let label = "memory − working memory (new start, 4 demos)";
            rows.push(row(view, label, &of(("new/unchanged", "4")), &baseline));
        }
        RowGroup { label: Some(view.label(representation)), rows }
    };
    let table = Table {
        id: view.id("pairs"),
        caption: "Pairs of conditions on the same cases and repetitions, and first minus second, SR in percent, with 95 % \
                  intervals over cases. Pairs: episodes of the same case and repetition; where one condition has more \
                  repetitions, the others do not enter. Better, worse: cases that succeed more often, or less often, under \
                  the first. p: exact two-sided sign test on these two counts (McNemar's exact test where every case has \
                  one pair), not corrected for the number of rows."
            .to_owned(),
        stubs: vec!["Representation".to_owned(), "Comparison".to_owned()],
        columns: columns(),
        groups: view.memories().iter().map(group).collect(),
    };
    ReportBlock::tables([table.pruned(), against_others(view)])
}

/// Each external memory against every other memory of the run, in each setting that both have; `None` without external
/// memories.
fn against_others(view: &ScoredRun<'_>) -> Option<Table> {
    let memories = view.memories();
    let group = |name: ExternalName| {
        let memory = MemoryKind::External(name);
        let own = view.scores.conditions.iter().map(|score| score.condition);
        let own = own.filter(|condition| condition.memory == memory);
        // Two external memories are compared once.
        let others = memories.iter().filter(|other| **other < memory);
        let rows = own.flat_map(|condition| {
            others.clone().filter_map(move |&other| {
                let Condition { start, route, demonstrations, variation, .. } = condition;
                let other = Condition::new(other, start, route, demonstrations, variation)?;
                let other = other.with_mismatch(condition.mismatch);
                view.scores.of(&other)?;
                let label = format!("{name} − {} ({})", other.memory, setting(&condition));
                Some(row(view, &label, &condition.to_string(), &other.to_string()))
            })
        });
        RowGroup { label: Some(name.to_string()), rows: rows.collect() }
    };
    let groups = view.external_memories().into_iter().map(group);
    let table = Table {
        id: view.id("external-pairs"),
        caption: "Each external memory against the other memories of the run, in the same setting and on the same cases \
                  and repetitions: first minus second, as above."
            .to_owned(),
        stubs: vec!["Memory".to_owned(), "Comparison".to_owned()],
        columns: columns(),
        groups: groups.filter(|group| !group.rows.is_empty()).collect(),
    };
    table.pruned()
}

pub(super) fn columns() -> Vec<TableColumn> {
    let mut columns = vec![TableColumn::new("Cases"), TableColumn::new("Pairs")];
    for over in ["SR %", "SPL"] {
        columns
            .extend(["first", "second", "difference"].map(|name| TableColumn::under(over, name)));
    }
    columns.extend(["Better", "Worse", "p"].map(TableColumn::new));
    columns
}

pub(super) fn row(view: &ScoredRun<'_>, label: &str, a: &str, b: &str) -> TableRow {
    let compared = compare_conditions((view.log, a), (view.log, b));
    let not_run = |_| vec![TableCell::Missing(Missing::NotRun); columns().len()];
    TableRow::new(label, compared.as_ref().map_or_else(not_run, cells))
}

/// The cells of a comparison under [`columns`].
pub(super) fn cells(compared: &Comparison) -> Vec<TableCell> {
    let Comparison { cases, pairs, sr, spl, more_under_a, more_under_b, p, .. } = compared;
    let three = |FigureDifference { a, b, mean, interval }: &FigureDifference, digits: usize| {
        [
            TableCell::Value(format!("{a:.digits$}")),
            TableCell::Value(format!("{b:.digits$}")),
            with_interval(signed(*mean, digits), *interval, digits),
        ]
    };
    let mut cells = [cases, pairs].map(|count| TableCell::Value(count.to_string())).to_vec();
    cells.extend(three(sr, 1).into_iter().chain(three(spl, 3)));
    cells.extend(
        [more_under_a.to_string(), more_under_b.to_string(), p_value(*p)].map(TableCell::Value),
    );
    cells
}
