//! Files of frames, which are written part by part.

use std::io::{self, Write};

use super::csv::CsvFile;
use super::frame::DataFrame;
use super::parquet::ParquetFile;

/// Most rows of a row group in a Parquet file.
const ROW_GROUP: usize = 1 << 17;

/// A format of tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableFormat {
    /// Text; an absent value is an empty field.
    Csv,
    /// Typed columns with nulls.
    Parquet,
}

impl TableFormat {
    /// The extension of its files.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
        }
    }
}

/// A file of a table that is written part by part.
pub struct FrameFile<W: Write + Send>(Format<W>);

enum Format<W: Write + Send> {
    Csv(CsvFile<W>),
    Parquet(ParquetFile<W>),
}

impl<W: Write + Send> FrameFile<W> {
    /// A file with the columns of `frame`, without its rows.
    ///
    /// # Errors
    /// When writing fails.
    pub fn create(format: TableFormat, frame: &DataFrame<'_>, out: W) -> io::Result<Self> {
        Ok(Self(match format {
            TableFormat::Csv => Format::Csv(CsvFile::create(frame, out)?),
            TableFormat::Parquet => Format::Parquet(ParquetFile::create(frame, out)?),
        }))
    }

    /// Adds the rows of `frame`, which has the columns with which the file was created.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&mut self, frame: &DataFrame<'_>) -> io::Result<()> {
        match &mut self.0 {
            Format::Csv(file) => file.write(frame),
            Format::Parquet(file) => {
                for from in (0..frame.rows).step_by(ROW_GROUP) {
                    file.write(frame, from, frame.rows.min(from + ROW_GROUP))?;
                }
                Ok(())
            }
        }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// When writing fails.
    pub fn finish(self) -> io::Result<()> {
        match self.0 {
            Format::Csv(file) => file.finish(),
            Format::Parquet(file) => file.finish(),
        }
    }
}

impl DataFrame<'_> {
    /// Writes all of it.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, format: TableFormat, out: impl Write + Send) -> io::Result<()> {
        let mut file = FrameFile::create(format, self, out)?;
        file.write(self)?;
        file.finish()
    }
}
