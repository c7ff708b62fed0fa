//! MCAP's container as ROS 2 writes it: schemas and channels, chunks of messages with an index, a summary.

use std::path::Path;

use evis_core::format::FormatError;

use super::message::MessageType;
use crate::files::Output;

/// First and last bytes of a file.
pub(crate) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

pub(super) const HEADER: u8 = 0x01;
pub(super) const FOOTER: u8 = 0x02;
pub(super) const SCHEMA: u8 = 0x03;
pub(super) const CHANNEL: u8 = 0x04;
pub(super) const MESSAGE: u8 = 0x05;
pub(super) const CHUNK: u8 = 0x06;
pub(super) const MESSAGE_INDEX: u8 = 0x07;
pub(super) const CHUNK_INDEX: u8 = 0x08;
pub(super) const STATISTICS: u8 = 0x0B;
pub(super) const SUMMARY_OFFSET: u8 = 0x0E;
pub(super) const DATA_END: u8 = 0x0F;

/// Writes the records of one kind in the summary.
type PutGroup = fn(&mut Bag) -> Result<(), FormatError>;

/// Bytes of a chunk.
const CHUNK_BYTES: usize = 1 << 20;

/// A stream of messages of one type. Its number is its place plus one.
struct Channel {
    schema: u16,
    topic: String,
    count: u64,
    /// Time and offset of each of its messages in the chunk.
    index: Vec<(u64, u64)>,
}

/// A chunk, as the summary lists it.
struct ChunkEntry {
    first: u64,
    last: u64,
    at: u64,
    length: u64,
    /// Where the index of each channel lies.
    indexes: Vec<(u16, u64)>,
    index_length: u64,
    size: u64,
}

/// A bag that is being written.
pub(super) struct Bag {
    output: Output,
    at: u64,
    /// Types of messages, each once; a schema's number is its place plus one.
    types: Vec<&'static MessageType>,
    channels: Vec<Channel>,
    chunk: Vec<u8>,
    chunks: Vec<ChunkEntry>,
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}

fn record(op: u8, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(content.len() + 9);
    bytes.push(op);
    bytes.extend((content.len() as u64).to_le_bytes());
    bytes.extend(content);
    bytes
}

/// A map from channels to numbers.
fn put_map(out: &mut Vec<u8>, entries: &[(u16, u64)]) {
    out.extend((entries.len() as u32 * 10).to_le_bytes());
    for (channel, number) in entries {
        out.extend(channel.to_le_bytes());
        out.extend(number.to_le_bytes());
    }
}

/// The record of the type at `place`.
fn schema_record(place: usize, kind: &MessageType) -> Vec<u8> {
    let mut content = (place as u16 + 1).to_le_bytes().to_vec();
    put_text(&mut content, kind.name);
    put_text(&mut content, "ros2msg");
    put_text(&mut content, kind.definition);
    record(SCHEMA, &content)
}

/// The record of the channel at `place`.
fn channel_record(place: usize, channel: &Channel) -> Vec<u8> {
    let mut content = (place as u16 + 1).to_le_bytes().to_vec();
    content.extend(channel.schema.to_le_bytes());
    put_text(&mut content, &channel.topic);
    put_text(&mut content, "cdr");
    let mut metadata = Vec::new();
    put_text(&mut metadata, "offered_qos_profiles");
    put_text(&mut metadata, "");
    content.extend((metadata.len() as u32).to_le_bytes());
    content.extend(metadata);
    record(CHANNEL, &content)
}

impl Bag {
    pub fn create(path: &Path, overwrite: bool) -> Result<Self, FormatError> {
        let output = Output::create(path, overwrite)?;
        let (types, channels) = (Vec::new(), Vec::new());
        let mut bag = Self { output, at: 0, types, channels, chunk: Vec::new(), chunks: Vec::new() };
        let mut header = Vec::new();
        put_text(&mut header, "ros2");
        put_text(&mut header, "evis");
        bag.put(MAGIC)?;
        bag.put(&record(HEADER, &header))?;
        Ok(bag)
    }

    /// Adds a topic, and returns its place. At any time: it stands before the chunk that its first message is in.
    pub fn topic(&mut self, topic: String, kind: &'static MessageType) -> Result<usize, FormatError> {
        let known = self.types.iter().position(|known| *known == kind);
        let schema = known.unwrap_or(self.types.len());
        if known.is_none() {
            self.types.push(kind);
            self.put(&schema_record(schema, kind))?;
        }
        let (place, schema) = (self.channels.len(), schema as u16 + 1);
        let channel = Channel { schema, topic, count: 0, index: Vec::new() };
        self.put(&channel_record(place, &channel))?;
        self.channels.push(channel);
        Ok(place)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        self.at += bytes.len() as u64;
        self.output.write(bytes)
    }

    fn put_schemas(&mut self) -> Result<(), FormatError> {
        let records: Vec<u8> =
            self.types.iter().enumerate().flat_map(|(k, kind)| schema_record(k, kind)).collect();
        self.put(&records)
    }

    fn put_channels(&mut self) -> Result<(), FormatError> {
        let records: Vec<u8> =
            self.channels.iter().enumerate().flat_map(|(k, channel)| channel_record(k, channel)).collect();
        self.put(&records)
    }

    /// Appends a message to the topic at `place`, stamped with a time from 0 on.
    pub fn message(&mut self, place: usize, t_us: i64, content: &[u8]) -> Result<(), FormatError> {
        let Some(channel) = self.channels.get_mut(place) else { return Ok(()) };
        let time_ns = t_us as u64 * 1000;
        channel.index.push((time_ns, self.chunk.len() as u64));
        self.chunk.push(MESSAGE);
        self.chunk.extend((content.len() as u64 + 22).to_le_bytes());
        self.chunk.extend((place as u16 + 1).to_le_bytes());
        self.chunk.extend((channel.count as u32).to_le_bytes());
        // When it was recorded, and when it was sent.
        self.chunk.extend(time_ns.to_le_bytes());
        self.chunk.extend(time_ns.to_le_bytes());
        self.chunk.extend_from_slice(content);
        channel.count += 1;
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    fn end_chunk(&mut self) -> Result<(), FormatError> {
        let times = || self.channels.iter().flat_map(|channel| &channel.index).map(|(time, _)| *time);
        let (Some(first), Some(last)) = (times().min(), times().max()) else { return Ok(()) };
        let size = self.chunk.len() as u64;
        let mut content = Vec::with_capacity(self.chunk.len() + 64);
        content.extend(first.to_le_bytes());
        content.extend(last.to_le_bytes());
        content.extend(size.to_le_bytes());
        // No checksum.
        content.extend(0_u32.to_le_bytes());
        put_text(&mut content, "");
        content.extend(size.to_le_bytes());
        content.append(&mut self.chunk);
        let at = self.at;
        let bytes = record(CHUNK, &content);
        let length = bytes.len() as u64;
        self.put(&bytes)?;
        let index_at = self.at;
        let mut indexes = Vec::new();
        for place in 0..self.channels.len() {
            let Some(channel) = self.channels.get_mut(place) else { continue };
            if channel.index.is_empty() {
                continue;
            }
            let mut index = (place as u16 + 1).to_le_bytes().to_vec();
            index.extend((channel.index.len() as u32 * 16).to_le_bytes());
            for (time, offset) in channel.index.drain(..) {
                index.extend(time.to_le_bytes());
                index.extend(offset.to_le_bytes());
            }
            indexes.push((place as u16 + 1, self.at));
            self.put(&record(MESSAGE_INDEX, &index))?;
        }
        let index_length = self.at - index_at;
        self.chunks.push(ChunkEntry { first, last, at, length, indexes, index_length, size });
        Ok(())
    }

    fn put_statistics(&mut self) -> Result<(), FormatError> {
        let counts: Vec<_> =
            self.channels.iter().enumerate().map(|(k, channel)| (k as u16 + 1, channel.count)).collect();
        let mut content = Vec::new();
        content.extend(counts.iter().map(|(_, count)| count).sum::<u64>().to_le_bytes());
        content.extend((self.types.len() as u16).to_le_bytes());
        content.extend((self.channels.len() as u32).to_le_bytes());
        // Attachments and metadata.
        content.extend([0; 8]);
        content.extend((self.chunks.len() as u32).to_le_bytes());
        content.extend(self.chunks.iter().map(|chunk| chunk.first).min().unwrap_or(0).to_le_bytes());
        content.extend(self.chunks.iter().map(|chunk| chunk.last).max().unwrap_or(0).to_le_bytes());
        put_map(&mut content, &counts);
        self.put(&record(STATISTICS, &content))
    }

    fn put_chunk_indexes(&mut self) -> Result<(), FormatError> {
        for entry in std::mem::take(&mut self.chunks) {
            let mut content = Vec::new();
            for number in [entry.first, entry.last, entry.at, entry.length] {
                content.extend(number.to_le_bytes());
            }
            put_map(&mut content, &entry.indexes);
            content.extend(entry.index_length.to_le_bytes());
            put_text(&mut content, "");
            content.extend(entry.size.to_le_bytes());
            content.extend(entry.size.to_le_bytes());
            self.put(&record(CHUNK_INDEX, &content))?;
        }
        Ok(())
    }

    /// Ends the file and gives it its name.
    pub fn finish(mut self) -> Result<(), FormatError> {
        self.end_chunk()?;
        self.put(&record(DATA_END, &[0; 4]))?;
        let start = self.at;
        let groups: [(u8, PutGroup); 4] = [
            (SCHEMA, Self::put_schemas),
            (CHANNEL, Self::put_channels),
            (STATISTICS, Self::put_statistics),
            (CHUNK_INDEX, Self::put_chunk_indexes),
        ];
        let mut offsets = Vec::new();
        for (op, put) in groups {
            let at = self.at;
            put(&mut self)?;
            if self.at > at {
                let mut content = vec![op];
                content.extend(at.to_le_bytes());
                content.extend((self.at - at).to_le_bytes());
                offsets.extend(record(SUMMARY_OFFSET, &content));
            }
        }
        let offsets_at = self.at;
        self.put(&offsets)?;
        let mut footer = Vec::new();
        footer.extend(start.to_le_bytes());
        footer.extend(offsets_at.to_le_bytes());
        footer.extend(0_u32.to_le_bytes());
        self.put(&record(FOOTER, &footer))?;
        self.put(MAGIC)?;
        self.output.finish()
    }
}
