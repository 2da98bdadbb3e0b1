//! Writing MCAP files (<https://mcap.dev/spec>): uncompressed chunks with indexes, so that a reader can seek. Checksums are
//! left out, which the format allows.

use std::collections::BTreeMap;
use std::io::{self, Write};

const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// The kinds of records.
#[derive(Debug, Clone, Copy)]
#[repr(u8)]
enum Op {
    Header = 0x01,
    Footer = 0x02,
    Schema = 0x03,
    Channel = 0x04,
    Message = 0x05,
    Chunk = 0x06,
    MessageIndex = 0x07,
    ChunkIndex = 0x08,
    Statistics = 0x0b,
    Metadata = 0x0c,
    MetadataIndex = 0x0d,
    DataEnd = 0x0f,
}

/// A channel of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ChannelId(u16);

/// An MCAP file under construction. Messages are kept until their chunk ends.
pub(super) struct McapFile<W> {
    out: W,
    /// Bytes written.
    position: u64,
    /// Schemas and channels, as records.
    declared: Vec<u8>,
    channels: u16,
    chunk: McapChunk,
    /// Records of the summary.
    indexes: Vec<u8>,
    chunks: u32,
    metadata: u32,
    counts: BTreeMap<ChannelId, u64>,
    times: Option<(u64, u64)>,
}

#[derive(Default)]
struct McapChunk {
    records: Vec<u8>,
    /// By channel: time, and place in the records.
    index: BTreeMap<ChannelId, Vec<(u64, u64)>>,
    times: Option<(u64, u64)>,
}

/// The number of bytes in front of data that it counts, in 32 bits.
///
/// # Errors
/// When there are more.
fn length(bytes: usize) -> io::Result<u32> {
    u32::try_from(bytes).map_err(|_| {
        io::Error::other(format!(
            "a part of an MCAP file has at most {} bytes, and one has {bytes}: export fewer episodes into one file, or each \
             into a file of its own",
            u32::MAX
        ))
    })
}

/// The content of a record under construction.
#[derive(Default)]
struct RecordContent(Vec<u8>);

impl RecordContent {
    fn u16(mut self, value: u16) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    /// Bytes after their number.
    ///
    /// # Errors
    /// When there are more than 32 bits can count.
    fn data(self, bytes: &[u8]) -> io::Result<Self> {
        Ok(self.u32(length(bytes.len())?).raw(bytes))
    }

    fn text(self, text: &str) -> io::Result<Self> {
        self.data(text.as_bytes())
    }

    fn times(self, times: Option<(u64, u64)>) -> Self {
        let (first, last) = times.unwrap_or_default();
        self.u64(first).u64(last)
    }

    /// It as a record: kind, length, content.
    fn record(self, op: Op) -> Vec<u8> {
        let mut record = vec![op as u8];
        record.extend((self.0.len() as u64).to_le_bytes());
        record.extend(self.0);
        record
    }
}

fn widen(times: &mut Option<(u64, u64)>, at: u64) {
    let (first, last) = times.unwrap_or((at, at));
    *times = Some((first.min(at), last.max(at)));
}

impl<W: Write> McapFile<W> {
    pub(super) fn new(out: W) -> io::Result<Self> {
        let mut file = Self {
            out,
            position: 0,
            declared: Vec::new(),
            channels: 0,
            chunk: McapChunk::default(),
            indexes: Vec::new(),
            chunks: 0,
            metadata: 0,
            counts: BTreeMap::new(),
            times: None,
        };
        file.write(&MAGIC)?;
        let header = RecordContent::default().text("")?.text("memtransfer")?;
        file.write(&header.record(Op::Header))?;
        Ok(file)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.position += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    /// Adds a channel of messages in the encoding `messages`, with a schema `name` of its own, before the first message.
    pub(super) fn channel(
        &mut self,
        topic: &str,
        name: &str,
        encoding: &str,
        schema: &[u8],
        messages: &str,
    ) -> io::Result<ChannelId> {
        let id = self.channels;
        // The number 0 means no schema.
        let schema =
            RecordContent::default().u16(id + 1).text(name)?.text(encoding)?.data(schema)?;
        let channel = RecordContent::default().u16(id).u16(id + 1);
        let channel = channel.text(topic)?.text(messages)?.data(&[])?;
        self.channels += 1;
        self.declared.extend(schema.record(Op::Schema));
        self.declared.extend(channel.record(Op::Channel));
        Ok(ChannelId(id))
    }

    /// Adds facts about the file.
    pub(super) fn metadata(&mut self, name: &str, facts: &[(&str, &str)]) -> io::Result<()> {
        let facts = facts.iter().try_fold(RecordContent::default(), |facts, (name, value)| {
            facts.text(name)?.text(value)
        })?;
        let record = RecordContent::default().text(name)?.data(&facts.0)?.record(Op::Metadata);
        let index = RecordContent::default().u64(self.position).u64(record.len() as u64);
        let index = index.text(name)?;
        self.indexes.extend(index.record(Op::MetadataIndex));
        self.metadata += 1;
        self.write(&record)
    }

    /// Adds a message to the chunk.
    pub(super) fn message(&mut self, channel: ChannelId, at_ns: u64, data: &[u8]) {
        if self.chunks == 0 && self.chunk.records.is_empty() {
            self.chunk.records.extend(&self.declared);
        }
        let sequence = self.counts.entry(channel).or_default();
        // Readers detect lost messages by gaps in it: it goes on from 0 after the largest number.
        let number = (*sequence % (1 << 32)) as u32;
        let message = RecordContent::default().u16(channel.0).u32(number).u64(at_ns).u64(at_ns);
        *sequence += 1;
        let place = self.chunk.records.len() as u64;
        self.chunk.index.entry(channel).or_default().push((at_ns, place));
        self.chunk.records.extend(message.raw(data).record(Op::Message));
        widen(&mut self.chunk.times, at_ns);
        widen(&mut self.times, at_ns);
    }

    /// Writes the chunk and its indexes.
    pub(super) fn end_chunk(&mut self) -> io::Result<()> {
        let McapChunk { records, index, times } = std::mem::take(&mut self.chunk);
        let size = records.len() as u64;
        let chunk = RecordContent::default().times(times).u64(size).u32(0).text("")?.u64(size);
        let chunk = chunk.raw(&records);
        let (chunk, begins) = (chunk.record(Op::Chunk), self.position);
        self.write(&chunk)?;
        let (indexes_begin, mut offsets) = (self.position, RecordContent::default());
        for (channel, messages) in index {
            offsets = offsets.u16(channel.0).u64(self.position);
            let places = messages
                .iter()
                .fold(RecordContent::default(), |places, &(at, place)| places.u64(at).u64(place));
            let record = RecordContent::default().u16(channel.0).data(&places.0)?;
            self.write(&record.record(Op::MessageIndex))?;
        }
        let entry = RecordContent::default().times(times).u64(begins).u64(chunk.len() as u64);
        let entry = entry.data(&offsets.0)?.u64(self.position - indexes_begin);
        let entry = entry.text("")?.u64(size).u64(size);
        self.indexes.extend(entry.record(Op::ChunkIndex));
        self.chunks += 1;
        Ok(())
    }

    /// Writes the summary.
    pub(super) fn finish(mut self) -> io::Result<()> {
        self.write(&RecordContent::default().u32(0).record(Op::DataEnd))?;
        let summary = self.position;
        let counts =
            self.counts.iter().fold(RecordContent::default(), |counts, (channel, count)| {
                counts.u16(channel.0).u64(*count)
            });
        let statistics = RecordContent::default()
            .u64(self.counts.values().sum())
            .u16(self.channels)
            .u32(self.channels.into())
            .u32(0)
            .u32(self.metadata)
            .u32(self.chunks)
            .times(self.times)
            .data(&counts.0)?;
        let mut records = std::mem::take(&mut self.declared);
        records.extend(statistics.record(Op::Statistics));
        records.append(&mut self.indexes);
        self.write(&records)?;
        self.write(&RecordContent::default().u64(summary).u64(0).u32(0).record(Op::Footer))?;
        self.write(&MAGIC)?;
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_format_cannot_count_is_refused_with_its_size() {
        assert_eq!(length(u32::MAX as usize).unwrap(), u32::MAX);
        let error = length(1 << 32).unwrap_err();
        insta::assert_snapshot!(error, @"a part of an MCAP file has at most 4294967295 bytes, and one has 4294967296: export fewer episodes into one file, or each into a file of its own");
    }
}
