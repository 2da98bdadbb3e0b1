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
    Ok(without_markup(lines.join("\n").trim_end()) + "\n")
}

/// The page without HTML, which a page in Markdown may contain, and without characters that steer a terminal. A run from
/// elsewhere may have put both into a text.
fn without_markup(page: &str) -> String {
    let mut text = String::with_capacity(page.len());
    let mut characters = page.chars().peekable();
    while let Some(character) = characters.next() {
        // An element, a comment or an instruction; `<0.001` is none.
        let begins_markup =
            |next: &char| next.is_ascii_alphabetic() || matches!(next, '/' | '!' | '?');
        match character {
            '<' if characters.peek().is_some_and(begins_markup) => text.push_str("&lt;"),
            '\n' => text.push('\n'),
            character if character.is_control() => text.push('\u{fffd}'),
            character => text.push(character),
        }
    }
    text
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_of_a_run_is_no_markup() {
        assert_eq!(
            without_markup("<img src=x onerror=a()> </b> <!-- <?x ` <i> ` p <0.001 a < b"),
            "&lt;img src=x onerror=a()> &lt;/b> &lt;!-- &lt;?x ` &lt;i> ` p <0.001 a < b"
        );
        assert_eq!(without_markup("a\u{1b}[2Jb\r\nü"), "a\u{fffd}[2Jb\u{fffd}\nü");
    }
}
