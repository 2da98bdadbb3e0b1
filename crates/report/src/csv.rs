//! CSV files: the tables of the report as they are printed, and frames in full.

use std::io::Write;

use super::document::Table;
use super::frame::DataFrame;

/// Writes a printed table: its labels, its cells as text, and a mark where there is no figure.
///
/// # Errors
/// When writing fails.
pub(super) fn write_table(table: &Table, out: impl Write) -> csv::Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record(table.headings())?;
    for group in &table.groups {
        for row in &group.rows {
            let labels = group.label.iter().chain([&row.label]).cloned();
            writer.write_record(
                labels.chain(row.cells.iter().map(super::document::TableCell::text)),
            )?;
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
