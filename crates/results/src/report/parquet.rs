//! Parquet files: frames in full, a nullable column for each figure.

use std::io::Write;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::Result;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use super::frame::{Frame, Values};

/// Writes `frame` as one row group, uncompressed: the tables are small, and every reader reads them.
///
/// # Errors
/// When `out` refuses.
pub(super) fn write_frame(frame: &Frame, out: impl Write + Send) -> Result<()> {
    let fields: Result<Vec<TypePtr>> =
        frame.columns.iter().map(|column| field(&column.name, &column.values)).collect();
    let schema = Type::group_type_builder("memtransfer").with_fields(fields?).build()?;
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(out, Arc::new(schema), properties)?;
    let mut rows = writer.next_row_group()?;
    for column in &frame.columns {
        match &column.values {
            Values::Text(values) => {
                let bytes = |text: &String| ByteArray::from(text.as_str());
                write_column::<ByteArrayType, _, _>(&mut rows, values, bytes)
            }
            Values::Whole(values) => write_column::<Int64Type, _, _>(&mut rows, values, |v| *v),
            Values::Real(values) => write_column::<DoubleType, _, _>(&mut rows, values, |v| *v),
            Values::Flag(values) => write_column::<BoolType, _, _>(&mut rows, values, |v| *v),
        }?;
    }
    rows.close()?;
    writer.close()?;
    Ok(())
}

fn field(name: &str, values: &Values) -> Result<TypePtr> {
    let (physical, logical) = match values {
        Values::Text(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        Values::Whole(_) => (Physical::INT64, None),
        Values::Real(_) => (Physical::DOUBLE, None),
        Values::Flag(_) => (Physical::BOOLEAN, None),
    };
    let builder = Type::primitive_type_builder(name, physical);
    let builder = builder.with_repetition(Repetition::OPTIONAL).with_logical_type(logical);
    Ok(Arc::new(builder.build()?))
}

/// Writes the next column: for each row whether there is a value, then the values that there are.
fn write_column<D: DataType, T, W: Write + Send>(
    rows: &mut SerializedRowGroupWriter<'_, W>,
    values: &[Option<T>],
    convert: impl Fn(&T) -> D::T,
) -> Result<()> {
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let present: Vec<D::T> = values.iter().flatten().map(convert).collect();
    if let Some(mut column) = rows.next_column()? {
        column.typed::<D>().write_batch(&present, Some(&levels), None)?;
        column.close()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use parquet::file::reader::{FileReader, SerializedFileReader};

    use super::*;
    use crate::report::frame::Series;

    #[test]
    fn a_reader_finds_what_was_written_and_nothing_where_there_was_nothing() {
        let series = |name: &str, values| Series { name: name.to_owned(), values };
        let frame = Frame {
            columns: vec![
                series("key", Values::Text(vec![Some("a".into()), Some("ä".into())])),
                series("steps", Values::Whole(vec![Some(7), None])),
                series("sr", Values::Real(vec![None, Some(0.5)])),
                series("success", Values::Flag(vec![Some(true), None])),
            ],
        };
        let mut file = Vec::new();
        write_frame(&frame, &mut file).unwrap();
        let reader = SerializedFileReader::new(bytes(file)).unwrap();
        let rows: Vec<String> =
            reader.get_row_iter(None).unwrap().map(|row| row.unwrap().to_string()).collect();
        insta::assert_snapshot!(rows.join("\n"), @r#"
        {key: "a", steps: 7, sr: null, success: true}
        {key: "ä", steps: null, sr: 0.5, success: null}
        "#);
    }

    /// A reader wants a file, or bytes that it can share.
    fn bytes(content: Vec<u8>) -> std::fs::File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&content).unwrap();
        file
    }
}
