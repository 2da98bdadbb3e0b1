//! What a memory loses where the test differs from its demonstrations.

use std::collections::BTreeSet;

use scores::{FigureDifference, Sensitivity, p_value};

use super::conditions::setting;
use crate::document::{RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, signed, with_interval};

/// A row for each memory and mismatch; `None` without mismatches.
pub(crate) fn sensitivity_table(view: &ScoredRun<'_>) -> Option<Table> {
    let all = &view.scores.sensitivity;
    let settings: BTreeSet<String> = all.iter().map(rest).collect();
    let groups = all.chunk_by(|a, b| a.condition == b.condition).map(|of_condition| {
        let label = of_condition.first().map(|one| {
            let memory = view.label(one.condition.memory);
            if settings.len() == 1 {
                memory
            } else {
                format!("{memory}: {}", setting(&one.condition))
            }
        });
        RowGroup { label, rows: of_condition.iter().map(row).collect() }
    });
    let groups: Vec<RowGroup> = groups.collect();
    let mut columns = vec![TableColumn::new("Cases"), TableColumn::new("Pairs")];
    columns.extend(["without", "with", "loss"].map(|name| TableColumn::under("SR %", name)));
    columns.push(TableColumn::new("Corrected p"));
    columns.push(TableColumn::under("SPL", "loss"));
    (!groups.is_empty()).then(|| Table {
        id: view.id("sensitivity"),
        caption: format!(
            "Tests that differ from the demonstrations in one thing more than their start and route, against the same \
                  condition without it, on the same cases and repetitions. Loss: without minus with, in percentage \
                  points for SR, with 95 % intervals over cases, which are not corrected: of many, about one in twenty leaves out 0 \
                  by chance. p: exact sign test, corrected for all {} losses of SR (Holm 1979); below 5 % one is shown. What \
                  differs is in the specification, section 6.",
            all.len()
        ),
        stubs: vec!["Memory".to_owned(), "Mismatch".to_owned()],
        columns,
        groups,
    })
}

/// The condition without its memory, where working memory is as the others.
fn rest(one: &Sensitivity) -> String {
    let condition = &one.condition;
    format!("{} {}{}", condition.start, condition.route, condition.deviations())
}

fn row(one: &Sensitivity) -> TableRow {
    let loss = |figure: &FigureDifference, digits: usize| {
        with_interval(signed(figure.mean, digits), figure.interval, digits)
    };
    let compared = &one.loss;
    let cells = vec![
        TableCell::Value(compared.cases.to_string()),
        TableCell::Value(compared.pairs.to_string()),
        TableCell::Value(format!("{:.1}", compared.sr.a)),
        TableCell::Value(format!("{:.1}", compared.sr.b)),
        loss(&compared.sr, 1),
        TableCell::Value(p_value(compared.conclusion.corrected_p)),
        loss(&compared.spl, 3),
    ];
    TableRow::new(one.mismatch.name(), cells)
}
