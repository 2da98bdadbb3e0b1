//! Parquet files: a typed, nullable column for each series of a frame.
//!
//! The simplest files that the format allows (<https://parquet.apache.org/docs/file-format/>): one row group,
//! uncompressed, each column one data page of version 1 in PLAIN encoding with definition levels in one bit, and
//! metadata in Thrift's compact protocol.

use std::io::{self, Write};

use super::frame::{DataFrame, Series, Values};

const MAGIC: &[u8; 4] = b"PAR1";

impl DataFrame {
    /// Writes it as a Parquet file.
    ///
    /// # Errors
    /// When writing fails, or a column is larger than the format allows.
    pub fn write_parquet(&self, mut out: impl Write) -> io::Result<()> {
        out.write_all(MAGIC)?;
        let mut offset = MAGIC.len();
        let mut chunks = Vec::new();
        for series in &self.columns {
            let page = page(series)?;
            out.write_all(&page)?;
            chunks.push(ColumnChunk { offset: count(offset)?, bytes: count(page.len())? });
            offset += page.len();
        }
        let footer = footer(self, &chunks)?;
        out.write_all(&footer)?;
        out.write_all(&length("footer", "bytes", footer.len())?.to_le_bytes())?;
        out.write_all(MAGIC)
    }
}

/// Where a column is in the file.
struct ColumnChunk {
    offset: i64,
    bytes: i64,
}

/// The number of `unit` in the part called `name` as the format stores it: in 31 bits.
///
/// # Errors
/// When there are more.
fn length(name: &str, unit: &str, count: usize) -> io::Result<i32> {
    i32::try_from(count).map_err(|_| {
        io::Error::other(format!(
            "`{name}` has {count} {unit}, and a part of a Parquet file has at most {}: write fewer episodes into one file, \
             or CSV",
            i32::MAX
        ))
    })
}

/// A number of rows or bytes of the whole file.
fn count(count: usize) -> io::Result<i64> {
    i64::try_from(count).map_err(io::Error::other)
}

/// A data page with its header: definition levels, then the values that are present.
fn page(Series { name, values }: &Series) -> io::Result<Vec<u8>> {
    let (present, plain) = match values {
        Values::Text(list) => encode(list, |text, bytes| {
            bytes.extend(length(name, "bytes in one text", text.len())?.to_le_bytes());
            bytes.extend(text.as_bytes());
            Ok(())
        })?,
        Values::Whole(list) => encode(list, |whole, bytes| {
            bytes.extend(whole.to_le_bytes());
            Ok(())
        })?,
        Values::Real(list) => encode(list, |real, bytes| {
            bytes.extend(real.to_le_bytes());
            Ok(())
        })?,
        Values::Flag(list) => {
            let flags: Vec<bool> = list.iter().flatten().copied().collect();
            (list.iter().map(Option::is_some).collect(), bits(&flags))
        }
    };
    // One bit-packed run of groups of eight levels; its length comes before it.
    let mut levels = Vec::new();
    varint(&mut levels, (present.len().div_ceil(8) as u64) << 1 | 1);
    levels.extend(bits(&present));
    let mut content = length(name, "bytes of levels", levels.len())?.to_le_bytes().to_vec();
    content.extend(levels);
    content.extend(plain);

    let mut header = Thrift::default();
    header.i32(1, 0); // DATA_PAGE
    let (bytes, rows) =
        (length(name, "bytes", content.len())?, length(name, "rows", values.len())?);
    header.i32(2, bytes);
    header.i32(3, bytes);
    header.structure(5, |page| {
        page.i32(1, rows);
        page.i32(2, 0); // PLAIN
        page.i32(3, 3); // definition levels: RLE
        page.i32(4, 3); // repetition levels: RLE
    });
    let mut page = header.finish();
    page.extend(content);
    Ok(page)
}

/// Which values are present, and those values in PLAIN encoding.
fn encode<T>(
    list: &[Option<T>],
    write: impl Fn(&T, &mut Vec<u8>) -> io::Result<()>,
) -> io::Result<(Vec<bool>, Vec<u8>)> {
    let mut bytes = Vec::new();
    list.iter().flatten().try_for_each(|value| write(value, &mut bytes))?;
    Ok((list.iter().map(Option::is_some).collect(), bytes))
}

/// Bits in bytes, the lowest first.
fn bits(flags: &[bool]) -> Vec<u8> {
    let byte = |flags: &[bool]| {
        flags.iter().enumerate().fold(0, |byte, (place, flag)| byte | u8::from(*flag) << place)
    };
    flags.chunks(8).map(byte).collect()
}

/// `FileMetaData`.
fn footer(frame: &DataFrame, chunks: &[ColumnChunk]) -> io::Result<Vec<u8>> {
    let (rows, columns) = (count(frame.rows())?, length("schema", "columns", frame.columns.len())?);
    let mut meta = Thrift::default();
    meta.i32(1, 1);
    meta.list(2, frame.columns.len() + 1, |index, element| match index.checked_sub(1) {
        None => {
            element.text(4, "memtransfer");
            element.i32(5, columns);
        }
        Some(column) => {
            let series = &frame.columns[column];
            element.i32(1, physical(&series.values));
            element.i32(3, 1); // OPTIONAL
            element.text(4, &series.name);
            if matches!(series.values, Values::Text(_)) {
                element.i32(6, 0); // UTF8
            }
        }
    });
    meta.i64(3, rows);
    meta.list(4, 1, |_, group| {
        group.list(1, chunks.len(), |column, chunk| {
            let (series, at) = (&frame.columns[column], &chunks[column]);
            chunk.i64(2, at.offset);
            chunk.structure(3, |meta| {
                meta.i32(1, physical(&series.values));
                meta.integers(2, &[0, 3]); // PLAIN, RLE
                meta.texts(3, &[&series.name]);
                meta.i32(4, 0); // UNCOMPRESSED
                meta.i64(5, rows);
                meta.i64(6, at.bytes);
                meta.i64(7, at.bytes);
                meta.i64(9, at.offset);
            });
        });
        group.i64(2, chunks.iter().map(|chunk| chunk.bytes).sum());
        group.i64(3, rows);
    });
    meta.text(6, "memtransfer");
    Ok(meta.finish())
}

/// The code of the physical type.
const fn physical(values: &Values) -> i32 {
    match values {
        Values::Flag(_) => 0,
        Values::Whole(_) => 2,
        Values::Real(_) => 5,
        Values::Text(_) => 6,
    }
}

/// A struct in Thrift's compact protocol, under construction.
#[derive(Default)]
struct Thrift {
    bytes: Vec<u8>,
    last_field: u8,
}

impl Thrift {
    const I32: u8 = 5;
    const I64: u8 = 6;
    const BINARY: u8 = 8;
    const LIST: u8 = 9;
    const STRUCT: u8 = 12;

    /// Fields come in ascending order, less than 16 apart.
    fn field(&mut self, id: u8, kind: u8) {
        self.bytes.push((id - self.last_field) << 4 | kind);
        self.last_field = id;
    }

    fn i32(&mut self, id: u8, value: i32) {
        self.field(id, Self::I32);
        zigzag(&mut self.bytes, value.into());
    }

    fn i64(&mut self, id: u8, value: i64) {
        self.field(id, Self::I64);
        zigzag(&mut self.bytes, value);
    }

    fn text(&mut self, id: u8, text: &str) {
        self.field(id, Self::BINARY);
        binary(&mut self.bytes, text);
    }

    fn structure(&mut self, id: u8, write: impl FnOnce(&mut Self)) {
        self.field(id, Self::STRUCT);
        let mut inner = Self::default();
        write(&mut inner);
        self.bytes.extend(inner.finish());
    }

    fn list(&mut self, id: u8, len: usize, write: impl Fn(usize, &mut Self)) {
        self.list_header(id, len, Self::STRUCT);
        for index in 0..len {
            let mut element = Self::default();
            write(index, &mut element);
            self.bytes.extend(element.finish());
        }
    }

    fn integers(&mut self, id: u8, values: &[i64]) {
        self.list_header(id, values.len(), Self::I32);
        values.iter().for_each(|value| zigzag(&mut self.bytes, *value));
    }

    fn texts(&mut self, id: u8, values: &[&str]) {
        self.list_header(id, values.len(), Self::BINARY);
        values.iter().for_each(|value| binary(&mut self.bytes, value));
    }

    fn list_header(&mut self, id: u8, len: usize, kind: u8) {
        self.field(id, Self::LIST);
        if len < 15 {
            self.bytes.push((len as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            varint(&mut self.bytes, len as u64);
        }
    }

    fn finish(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

fn binary(bytes: &mut Vec<u8>, text: &str) {
    varint(bytes, text.len() as u64);
    bytes.extend(text.as_bytes());
}

fn zigzag(bytes: &mut Vec<u8>, value: i64) {
    varint(bytes, ((value << 1) ^ (value >> 63)).cast_unsigned());
}

fn varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_format_cannot_count_is_refused_with_its_size() {
        assert_eq!(length("key", "rows", i32::MAX as usize).unwrap(), i32::MAX);
        let error = length("actions", "bytes", 1 << 31).unwrap_err();
        insta::assert_snapshot!(error, @"`actions` has 2147483648 bytes, and a part of a Parquet file has at most 2147483647: write fewer episodes into one file, or CSV");
    }

    #[test]
    fn a_small_file_has_the_bytes_that_were_read_with_pyarrow() {
        let series = |name: &str, values| Series { name: name.to_owned(), values };
        let frame = DataFrame {
            columns: vec![
                series("key", Values::Text(vec![Some("a".into()), Some("ä".into())])),
                series("steps", Values::Whole(vec![Some(7), None])),
                series("sr", Values::Real(vec![None, Some(0.5)])),
                series("success", Values::Flag(vec![Some(true), None])),
            ],
        };
        let mut file = Vec::new();
        frame.write_parquet(&mut file).unwrap();
        let hex: Vec<String> =
            file.chunks(32).map(|line| line.iter().map(|b| format!("{b:02x}")).collect()).collect();
        insta::assert_snapshot!(hex.join("\n"));
    }
}
