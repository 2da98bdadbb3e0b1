//! The report as Markdown: for a repository, an issue, or a terminal.

use askama::Template;

use super::document::{ReportBlock, ReportDocument, Table, TableCell};

#[derive(Template)]
#[template(path = "report.md", escape = "none")]
struct Markdown<'a> {
    document: &'a ReportDocument,
}

/// The page. Figures are files beside it: `figures/<id>.svg`.
///
/// # Errors
/// When the template fails, which would be a bug.
pub(super) fn render(document: &ReportDocument) -> askama::Result<String> {
    let text = Markdown { document }.render()?;
    // A template leaves empty lines where its instructions stood.
    let mut lines: Vec<&str> = Vec::new();
    for line in text.lines().map(str::trim_end) {
        if !(line.is_empty() && lines.last().is_none_or(|last| last.is_empty())) {
            lines.push(line);
        }
    }
    Ok(lines.join("\n").trim_end().to_owned() + "\n")
}

/// The table as lines of a Markdown table. A group's label stands in each of its rows.
fn table_lines(table: &Table) -> Vec<String> {
    let alignments = table.columns.iter().map(|column| if column.is_text { "---" } else { "---:" });
    let rule = table.stubs.iter().map(|_| "---").chain(alignments).map(str::to_owned);
    let mut lines = vec![line(table.headings()), line(rule)];
    for group in &table.groups {
        for row in &group.rows {
            let labels = group.label.iter().chain([&row.label]).cloned();
            let cells = row.cells.iter().map(|cell| cell_text(table, cell));
            lines.push(line(labels.chain(cells)));
        }
    }
    lines
}

fn line(cells: impl Iterator<Item = String>) -> String {
    let cells: Vec<String> = cells.map(|cell| cell.replace('|', "\\|")).collect();
    format!("| {} |", cells.join(" | "))
}

fn cell_text(table: &Table, cell: &TableCell) -> String {
    match table.note_of(cell) {
        None => cell.text(),
        Some(note) => format!("{} ({note})", cell.text()),
    }
}
