//! CSV files: the tables of the report as they are printed, and frames in full.
//!
//! A spreadsheet computes a cell that begins with one of `= + - @`. A text that does so has an apostrophe before it, as OWASP
//! advises; numbers, and figures with their intervals, stay as they are.

use std::io::{self, Write};

use super::document::{Table, TableCell};
use super::frame::{DataFrame, Values};
use super::view::THEIRS;

/// The heading of the column that says whose figures a row has.
const POLICY_COLUMN: &str = "Policy of the figures";

/// Writes a printed table: its labels, its cells as text, a mark where there is no figure, and in the last column `policy`
/// where the figures are a policy's.
///
/// # Errors
/// When writing fails.
pub(super) fn write_table(table: &Table, policy: Option<&str>, out: impl Write) -> csv::Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    let headings = table.headings().chain(policy.map(|_| POLICY_COLUMN.to_owned()));
    writer.write_record(headings.map(literal))?;
    for group in &table.groups {
        for row in &group.rows {
            let labels = group.label.iter().chain([&row.label]).cloned();
            let cells = row.cells.iter().map(TableCell::text);
            let policy = policy.map(|policy| if row.published { THEIRS } else { policy });
            let fields = labels.chain(cells).chain(policy.map(str::to_owned));
            writer.write_record(fields.map(literal))?;
        }
    }
    writer.flush()?;
    Ok(())
}

/// A CSV file of a frame; an absent value is an empty field.
pub(super) struct CsvFile<W: Write>(csv::Writer<W>);

impl<W: Write> CsvFile<W> {
    /// A file with the columns of `frame`, without rows.
    pub(super) fn create(frame: &DataFrame<'_>, out: W) -> io::Result<Self> {
        let mut writer = csv::Writer::from_writer(out);
        writer.write_record(frame.columns.iter().map(|column| literal(column.name.clone())))?;
        Ok(Self(writer))
    }

    /// Adds the rows of `frame`.
    pub(super) fn write(&mut self, frame: &DataFrame<'_>) -> io::Result<()> {
        for row in 0..frame.rows {
            let fields = frame.columns.iter().map(|column| match &column.values {
                Values::Text(_) | Values::Word(_) => literal(column.values.text(row)),
                _ => column.values.text(row),
            });
            self.0.write_record(fields)?;
        }
        Ok(())
    }

    pub(super) fn finish(mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// The text as a spreadsheet shows it, instead of computing it.
fn literal(text: String) -> String {
    // A tab or a line end may be skipped.
    let is_computed =
        text.trim_start().starts_with(['=', '+', '-', '@']) || text.starts_with(['\t', '\r', '\n']);
    if is_computed && !is_figure(&text) { format!("'{text}") } else { text }
}

/// Whether the text is a number, or a signed figure and its interval, such as `-3.2 [-4.0, 1.5]`.
fn is_figure(text: &str) -> bool {
    // Tables print the minus sign, not a hyphen.
    let is_number = |part: &str| part.replace('−', "-").parse::<f64>().is_ok();
    let part = |part: &str| is_number(part.trim_matches(['[', ']', ',', '(', ')', '%']));
    is_number(text) || text.split(' ').all(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spreadsheet_computes_no_text_and_reads_every_number() {
        for text in
            ["=1+2", "+cmd|' /C calc'!A0", "-1+2", "@SUM(A1)", "\t=1", " =1", "-", "=", "-x"]
        {
            assert_eq!(literal(text.to_owned()), format!("'{text}"));
        }
        for text in [
            "-3.2",
            "+0.5",
            "-1e-9",
            "-3.2 [-4.0, +1.5]",
            "x=1",
            "",
            "a-b",
            "−3.2 [1, 2]",
            "+0.006 [−0.062, 0.074]",
        ] {
            assert_eq!(literal(text.to_owned()), text);
        }
    }
}
