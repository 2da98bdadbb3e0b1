//! Parquet files: a typed, nullable column for each series of a frame.
//!
//! Columns are compressed with Zstandard, and values that repeat are in dictionaries. A row group is what is written at once.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as PhysicalType, ZstdLevel};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::Result as ParquetResult;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};

use super::frame::{DataFrame, Series, Value, Values};

/// A Parquet file that is written in row groups.
pub(super) struct ParquetFile<W: Write + Send>(SerializedFileWriter<W>);

impl<W: Write + Send> ParquetFile<W> {
    /// A file with the columns of `frame`, without rows.
    pub(super) fn create(frame: &DataFrame<'_>, out: W) -> io::Result<Self> {
        let properties = WriterProperties::builder()
            .set_created_by(concat!("memtransfer ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            // Of each row group, not of each page: the writer keeps them all until the end.
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .set_offset_index_disabled(true)
            .build();
        let file = SerializedFileWriter::new(out, schema(frame)?, Arc::new(properties))?;
        Ok(Self(file))
    }

    /// Adds the rows `from..to` of `frame` as a row group.
    pub(super) fn write(
        &mut self,
        frame: &DataFrame<'_>,
        from: usize,
        to: usize,
    ) -> io::Result<()> {
        let mut group = self.0.next_row_group()?;
        for series in &frame.columns {
            let missing = || io::Error::other("the frame has another column than before");
            let mut column = group.next_column()?.ok_or_else(missing)?;
            write_column(&mut column, &series.values, from, to)?;
            column.close()?;
        }
        group.close()?;
        Ok(())
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.0.into_inner()?.flush()
    }
}

fn write_column(
    column: &mut SerializedColumnWriter<'_>,
    values: &Values<'_>,
    from: usize,
    to: usize,
) -> ParquetResult<()> {
    fn write<D: DataType, V>(
        column: &mut SerializedColumnWriter<'_>,
        rows: std::ops::Range<usize>,
        value: &Value<'_, V>,
        stored: impl Fn(V) -> D::T,
    ) -> ParquetResult<()> {
        let mut present = Vec::with_capacity(rows.len());
        let mut stored_values = Vec::new();
        for row in rows {
            let value = value(row).map(&stored);
            present.push(i16::from(value.is_some()));
            stored_values.extend(value);
        }
        column.typed::<D>().write_batch(&stored_values, Some(&present), None)?;
        Ok(())
    }
    let rows = from..to;
    match values {
        Values::Text(value) | Values::Word(value) => {
            write::<ByteArrayType, _>(column, rows, value, |text| {
                ByteArray::from(text.into_bytes())
            })
        }
        Values::Whole(value) => write::<Int64Type, _>(column, rows, value, |whole| whole),
        Values::Natural(value) => write::<Int64Type, _>(column, rows, value, u64::cast_signed),
        Values::Real(value) => write::<DoubleType, _>(column, rows, value, |real| real),
        Values::Flag(value) => write::<BoolType, _>(column, rows, value, |flag| flag),
    }
}

fn schema(frame: &DataFrame<'_>) -> ParquetResult<TypePtr> {
    let column = |Series { name, values }: &Series<'_>| {
        let (physical, logical) = match values {
            Values::Text(_) | Values::Word(_) => {
                (PhysicalType::BYTE_ARRAY, Some(LogicalType::String))
            }
            Values::Whole(_) => (PhysicalType::INT64, None),
            Values::Natural(_) => (PhysicalType::INT64, Some(LogicalType::integer(64, false))),
            Values::Real(_) => (PhysicalType::DOUBLE, None),
            Values::Flag(_) => (PhysicalType::BOOLEAN, None),
        };
        let column = Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(logical);
        column.build().map(Arc::new)
    };
    let columns = frame.columns.iter().map(column).collect::<ParquetResult<_>>()?;
    Ok(Arc::new(Type::group_type_builder("memtransfer").with_fields(columns).build()?))
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use parquet::basic::Encoding;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;

    use super::*;
    use crate::{FrameFile, TableFormat};

    type Row = (Option<&'static str>, Option<i64>, Option<u64>, Option<f64>, Option<bool>);

    fn frame(rows: Vec<Row>) -> DataFrame<'static> {
        let rows: Rc<[Row]> = rows.into();
        let count = rows.len();
        let text = |rows: Rc<[Row]>| -> Value<'static, String> {
            Box::new(move |row| rows[row].0.map(str::to_owned))
        };
        let (word, key) = (text(Rc::clone(&rows)), text(Rc::clone(&rows)));
        let [whole, natural, real] = [(); 3].map(|()| Rc::clone(&rows));
        let columns = [
            ("key", Values::Text(key)),
            ("memory", Values::Word(word)),
            ("steps", Values::Whole(Box::new(move |row| whole[row].1))),
            ("seed", Values::Natural(Box::new(move |row| natural[row].2))),
            ("spl", Values::Real(Box::new(move |row| real[row].3))),
            ("success", Values::Flag(Box::new(move |row| rows[row].4))),
        ];
        let columns = columns.map(|(name, values)| Series { name: name.to_owned(), values });
        DataFrame { rows: count, columns: columns.into() }
    }

    #[test]
    fn a_file_has_a_row_group_for_each_part_compressed_and_with_dictionaries() {
        let first: Vec<Row> = (0..1000)
            .map(|row| (Some("episodic"), Some(row), Some(u64::MAX), Some(0.5), Some(row % 2 == 0)))
            .collect();
        let second: Vec<Row> = vec![
            (Some("ä"), Some(i64::MIN), None, Some(-0.1), None),
            (None, None, Some(0), None, None),
        ];
        let mut file = Vec::new();
        let mut out =
            FrameFile::create(TableFormat::Parquet, &frame(Vec::new()), &mut file).unwrap();
        for part in [&first, &second] {
            out.write(&frame(part.clone())).unwrap();
        }
        out.finish().unwrap();
        assert!(file.len() < 12_000, "{} bytes", file.len());
        let reader = SerializedFileReader::new(bytes(file)).unwrap();
        let groups = reader.metadata().row_groups();
        assert_eq!(groups.iter().map(|group| group.num_rows()).collect::<Vec<_>>(), [1000, 2]);
        for column in groups[0].columns() {
            assert!(matches!(column.compression(), Compression::ZSTD(_)));
            let has_dictionary = column.encodings().any(|one| one == Encoding::RLE_DICTIONARY);
            assert_eq!(has_dictionary, column.column_type() != PhysicalType::BOOLEAN);
        }
        let rows = reader.get_row_iter(None).unwrap();
        for (row, expected) in rows.zip(first.into_iter().chain(second)) {
            let row = row.unwrap();
            let fields: Vec<&Field> = row.get_column_iter().map(|(_, field)| field).collect();
            let (text, whole, natural, real, flag) = expected;
            let text = text.map_or(Field::Null, |text| Field::Str(text.to_owned()));
            let expected = [
                &text,
                &text,
                &whole.map_or(Field::Null, Field::Long),
                &natural.map_or(Field::Null, Field::ULong),
                &real.map_or(Field::Null, Field::Double),
                &flag.map_or(Field::Null, Field::Bool),
            ];
            assert_eq!(fields, expected);
        }
    }

    /// What the reader reads from.
    fn bytes(file: Vec<u8>) -> std::fs::File {
        use std::io::Seek;
        let mut on_disk = tempfile::tempfile().unwrap();
        on_disk.write_all(&file).unwrap();
        on_disk.rewind().unwrap();
        on_disk
    }
}
