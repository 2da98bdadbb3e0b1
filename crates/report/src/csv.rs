//! CSV files: the tables of the report as they are printed, and frames in full.

use std::io::Write;

use super::document::{Table, TableCell};
use super::frame::DataFrame;
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
    writer.write_record(table.headings().chain(policy.map(|_| POLICY_COLUMN.to_owned())))?;
    for group in &table.groups {
        for row in &group.rows {
            let labels = group.label.iter().chain([&row.label]).cloned();
            let cells = row.cells.iter().map(TableCell::text);
            let policy = policy.map(|policy| if row.published { THEIRS } else { policy });
            writer.write_record(labels.chain(cells).chain(policy.map(str::to_owned)))?;
        }
    }
    writer.flush()?;
    Ok(())
}

/// Writes a frame; an absent value is an empty field.
///
/// # Errors
/// When writing fails.
pub(super) fn write_frame(frame: &DataFrame, out: impl Write) -> csv::Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record(frame.columns.iter().map(|column| &column.name))?;
    for row in 0..frame.rows() {
        writer.write_record(frame.columns.iter().map(|column| column.values.text(row)))?;
    }
    writer.flush()?;
    Ok(())
}
