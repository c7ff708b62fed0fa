//! ROS 2 bags in MCAP: events as `event_camera_msgs/msg/EventPacket` in EVT 3.0.
//!
//! Layouts: the MCAP specification, and OMG's CDR as ROS 2 writes it.

use std::path::Path;

use evis_core::Event;
use evis_core::format::FormatError;

use crate::check::Check;
use crate::files::{Input, Output, u16_at, u32_at, u64_at};
use crate::format::Format;
use crate::packet::{Packet, Trigger};
use crate::prophesee::{Evt3Decoder, Evt3Encoder};
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// First and last bytes of a file.
pub(crate) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Largest record that is read, and largest chunk when it is unpacked.
const MOST_RECORD: u64 = 256 << 20;

const HEADER: u8 = 0x01;
const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const MESSAGE_INDEX: u8 = 0x07;
const CHUNK_INDEX: u8 = 0x08;
const STATISTICS: u8 = 0x0B;
const SUMMARY_OFFSET: u8 = 0x0E;
const DATA_END: u8 = 0x0F;

/// Types of messages that carry events.
const TYPES: [&str; 2] = ["event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray"];
/// Where events are written.
const TOPIC: &str = "/event_camera/events";
/// The definition of [`TYPES`]'s first, from `event_camera_msgs`, with what it refers to.
const DEFINITION: &str = "\
std_msgs/Header header
uint32 height
uint32 width
uint64 seq
uint64 time_base
string encoding
bool is_bigendian
uint8[] events
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// Numbers and texts of a record, one after the other.
struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    /// CDR aligns numbers to their size, from here.
    origin: Option<usize>,
}

impl<'a> Fields<'a> {
    const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, origin: None }
    }

    fn take(&mut self, size: usize) -> Option<&'a [u8]> {
        if let Some(origin) = self.origin {
            self.at = origin + (self.at - origin).next_multiple_of(size.clamp(1, 8));
        }
        self.bytes(size)
    }

    fn bytes(&mut self, size: usize) -> Option<&'a [u8]> {
        let bytes = self.bytes.get(self.at..self.at.checked_add(size)?)?;
        self.at += size;
        Some(bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        u16_at(self.take(2)?, 0)
    }

    fn u32(&mut self) -> Option<u32> {
        u32_at(self.take(4)?, 0)
    }

    fn u64(&mut self) -> Option<u64> {
        u64_at(self.take(8)?, 0)
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()? as usize;
        let text = std::str::from_utf8(self.bytes(length)?).ok()?;
        Some(text.trim_end_matches('\0'))
    }

    fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }
}

/// A message of events.
struct EventMessage<'a> {
    stamp_us: i64,
    width: u32,
    height: u32,
    encoding: &'a str,
    events: &'a [u8],
}

impl<'a> EventMessage<'a> {
    fn parse(bytes: &'a [u8]) -> Option<Self> {
        // Two bytes of encoding, little-endian CDR, and two of options.
        if bytes.get(..2)? != [0, 1] {
            return None;
        }
        let mut fields = Fields { bytes, at: 4, origin: Some(4) };
        let (seconds, nanoseconds) = (fields.u32()? as i32, fields.u32()?);
        fields.text()?;
        let (height, width) = (fields.u32()?, fields.u32()?);
        let _sequence = fields.u64()?;
        let _time_base = fields.u64()?;
        let encoding = fields.text()?;
        let _big_endian = fields.bytes(1)?;
        let length = fields.u32()? as usize;
        let events = fields.bytes(length)?;
        let stamp_us = i64::from(seconds) * 1_000_000 + i64::from(nanoseconds / 1000);
        Some(Self { stamp_us, width, height, encoding, events })
    }
}

/// Reads MCAP files.
pub(crate) struct McapReader {
    input: Input,
    info: StreamInfo,
    block: Vec<u8>,
    /// Records of the current chunk, and the next one's place in them.
    chunk: Vec<u8>,
    next: usize,
    /// Where the chunk, or the record, lies in the file.
    at: u64,
    /// Numbers of schemas, and of channels with their topics.
    schemas: Vec<u16>,
    channels: Vec<(u16, String)>,
    topic: Option<String>,
    decoder: Option<Evt3Decoder>,
    /// Stamp and time of the message before.
    last: Option<(i64, i64)>,
    failed: Option<String>,
}

/// What a record was.
enum Step {
    End,
    Nothing,
    Events,
}

impl McapReader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut reader = Self {
            input: Input::open(path)?,
            info: StreamInfo::new(Format::Mcap),
            block: Vec::new(),
            chunk: Vec::new(),
            next: 0,
            at: 0,
            schemas: Vec::new(),
            channels: Vec::new(),
            topic: options.camera.clone(),
            decoder: None,
            last: None,
            failed: None,
        };
        reader.begin()?;
        // The first message tells the size; the summary at the end would tell the topics, but a file that was
        // cut off has none.
        let mut packet = Packet::default();
        while reader.decoder.is_none() {
            match reader.step(&mut packet)? {
                Ok(Step::End) | Err(_) => break,
                Ok(_) => {}
            }
        }
        let topics: Vec<String> = reader.channels.iter().map(|(_, topic)| topic.clone()).collect();
        match &options.camera {
            Some(wanted) if !topics.contains(wanted) => {
                let what = format!("there is no topic of events {wanted}");
                let remedy = format!("the topics are: {}", topics.join(", "));
                return Err(FormatError::invalid(path, what, remedy));
            }
            None if topics.len() > 1 => {
                let what = format!("there are {} topics of events", topics.len());
                return Err(FormatError::invalid(
                    path,
                    what,
                    format!("choose one of: {}", topics.join(", ")),
                ));
            }
            _ => {}
        }
        reader.topic = options.camera.clone().or_else(|| topics.first().cloned());
        reader.info.camera = reader.topic.clone();
        reader.info.cameras = topics;
        reader.info.size = reader.info.size.or(options.size);
        reader.begin()?;
        Ok(reader)
    }

    fn begin(&mut self) -> Result<(), FormatError> {
        self.input.seek(MAGIC.len() as u64)?;
        self.chunk.clear();
        self.next = 0;
        (self.decoder, self.last, self.failed) = (None, None, None);
        Ok(())
    }

    /// Reads the next record; the inner error says what is wrong with it.
    fn step(&mut self, packet: &mut Packet) -> Result<Result<Step, String>, FormatError> {
        if self.next < self.chunk.len() {
            let chunk = std::mem::take(&mut self.chunk);
            let mut fields = Fields { bytes: &chunk, at: self.next, origin: None };
            let head = (|| Some((*fields.bytes(1)?.first()?, fields.u64()?)))();
            let record =
                head.and_then(|(op, length)| Some((op, fields.bytes(usize::try_from(length).ok()?)?)));
            self.next = fields.at;
            let step = match record {
                Some((op, record)) => self.record(op, record, packet),
                None => Err("a record leads outside of its chunk".into()),
            };
            self.chunk = chunk;
            return Ok(step);
        }
        self.at = self.input.at();
        let mut block = std::mem::take(&mut self.block);
        let step = self.outer(&mut block, packet);
        self.block = block;
        step
    }

    fn outer(
        &mut self,
        block: &mut Vec<u8>,
        packet: &mut Packet,
    ) -> Result<Result<Step, String>, FormatError> {
        self.input.read_block(block, 9)?;
        let (Some(&op), Some(length)) = (block.first(), u64_at(block, 1)) else {
            return Ok(Err("it ends before its end mark".into()));
        };
        let left = self.input.length().saturating_sub(self.input.at());
        if length > left.min(MOST_RECORD) {
            return Ok(Err(format!("a record would be {length} bytes long, and {left} are left")));
        }
        if matches!(op, DATA_END | FOOTER) {
            return Ok(Ok(Step::End));
        }
        self.input.read_block(block, length as usize)?;
        if op != CHUNK {
            return Ok(self.record(op, block, packet));
        }
        let mut fields = Fields::new(block);
        let head = (|| {
            fields.u64()?;
            fields.u64()?;
            let size = fields.u64()?;
            fields.u32()?;
            let compression = fields.text()?;
            let length = fields.u64()?;
            Some((size, compression, fields.bytes(usize::try_from(length).ok()?)?))
        })();
        let Some((size, compression, records)) = head else {
            return Ok(Err("a chunk ends within its head".into()));
        };
        if size > MOST_RECORD {
            return Ok(Err(format!("a chunk would be {size} bytes long")));
        }
        self.chunk.clear();
        self.next = 0;
        use std::io::Read;
        let unpacked = match compression {
            "" => (&mut &records[..]).take(size).read_to_end(&mut self.chunk),
            "lz4" => lz4_flex::frame::FrameDecoder::new(records).take(size).read_to_end(&mut self.chunk),
            "zstd" => rust_zstd::DecompressReader::new(records).take(size).read_to_end(&mut self.chunk),
            other => {
                return Ok(Err(format!("a chunk is packed by '{other}', and only lz4 and zstd are read")));
            }
        };
        Ok(match unpacked {
            Ok(_) => Ok(Step::Nothing),
            Err(error) => Err(format!("a chunk cannot be unpacked ({error})")),
        })
    }

    fn record(&mut self, op: u8, bytes: &[u8], packet: &mut Packet) -> Result<Step, String> {
        let mut fields = Fields::new(bytes);
        match op {
            SCHEMA => {
                let schema = (|| Some((fields.u16()?, fields.text()?)))();
                let (id, name) = schema.ok_or("a schema ends within its name")?;
                if TYPES.contains(&name) && !self.schemas.contains(&id) {
                    self.schemas.push(id);
                }
            }
            CHANNEL => {
                let channel = (|| Some((fields.u16()?, fields.u16()?, fields.text()?)))();
                let (id, schema, topic) = channel.ok_or("a channel ends within its topic")?;
                if self.schemas.contains(&schema) && !self.channels.iter().any(|(known, _)| *known == id) {
                    self.channels.push((id, topic.to_owned()));
                }
            }
            MESSAGE => {
                let id = (|| {
                    let id = fields.u16()?;
                    fields.u32()?;
                    fields.u64()?;
                    fields.u64()?;
                    Some(id)
                })();
                let id = id.ok_or("a message ends within its head")?;
                let topic = self.channels.iter().find(|(known, _)| *known == id).map(|(_, topic)| topic);
                if topic.is_some() && (self.topic.is_none() || self.topic.as_ref() == topic) {
                    return self.message(fields.rest(), packet).map(|()| Step::Events);
                }
            }
            _ => {}
        }
        Ok(Step::Nothing)
    }

    fn message(&mut self, bytes: &[u8], packet: &mut Packet) -> Result<(), String> {
        let message = EventMessage::parse(bytes).ok_or("a message is no EventPacket in little-endian CDR")?;
        if message.encoding != "evt3" {
            return Err(format!("events are encoded as '{}', and only evt3 is read", message.encoding));
        }
        let EventMessage { stamp_us, width, height, events, .. } = message;
        if !(1..=2048).contains(&width) || !(1..=2048).contains(&height) {
            return Err(format!("a sensor would have {width}x{height} pixels"));
        }
        self.info.size = Some((width, height));
        // Time in EVT 3.0 starts again each 16.8 s; stamps tell how often it did since the message before, and
        // at the start, whether they are the events' own time.
        let expected_us = self.last.map_or(stamp_us, |(stamp, t)| t + (stamp_us - stamp).clamp(0, 1 << 45));
        let mut decoder = Evt3Decoder::new(width as u16, height as u16);
        if self.last.is_some() || first_low_bits(events) == Some(stamp_us & 0xFF_FFFF) {
            decoder.expect(expected_us);
        }
        let decoded = decoder.decode(events, &mut packet.events, &mut packet.triggers);
        self.last = Some((stamp_us, decoder.now_us()));
        self.decoder = Some(decoder);
        decoded.map_err(|(word, what)| format!("word {word} of a message: {what}"))
    }
}

/// The 24-bit time of the first event of a message.
fn first_low_bits(words: &[u8]) -> Option<i64> {
    let mut high = None;
    for word in words.as_chunks().0 {
        let word = u16::from_le_bytes(*word);
        match word >> 12 {
            8 => high = Some(i64::from(word & 0xFFF) << 12),
            6 => return Some(high? | i64::from(word & 0xFFF)),
            _ => {}
        }
    }
    None
}

impl EventReader for McapReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        while self.failed.is_none() {
            match self.step(packet)? {
                Ok(Step::End) => return Ok(false),
                Ok(Step::Events) => return Ok(true),
                Ok(Step::Nothing) => {}
                Err(what) => self.failed = Some(what),
            }
        }
        match &self.failed {
            Some(what) if packet.is_empty() => Err(self.input.damaged(self.at, what)),
            _ => Ok(true),
        }
    }

    fn seek(&mut self, _t_us: i64) -> Result<(), FormatError> {
        // Indexes hold the time of recording, not of the events: from the start.
        self.begin()
    }
}

/// Events of a message at most, and microseconds that it spans at most.
const EVENTS_PER_MESSAGE: usize = 16 << 10;
const US_PER_MESSAGE: i64 = 10_000;
/// Bytes of a chunk.
const CHUNK_BYTES: usize = 1 << 20;

/// Writes MCAP files.
pub(crate) struct McapWriter {
    output: Output,
    check: Check,
    size: (u32, u32),
    at: u64,
    sequence: u32,
    events: Vec<Event>,
    triggers: Vec<Trigger>,
    words: Vec<u16>,
    chunk: Vec<u8>,
    /// Time and offset of each message of the chunk.
    index: Vec<(u64, u64)>,
    chunks: Vec<ChunkEntry>,
}

/// A chunk, as the summary lists it.
struct ChunkEntry {
    first: u64,
    last: u64,
    at: u64,
    length: u64,
    index_at: u64,
    index_length: u64,
    size: u64,
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}

fn record(op: u8, content: &[u8]) -> Vec<u8> {
    let mut bytes = vec![op];
    bytes.extend((content.len() as u64).to_le_bytes());
    bytes.extend(content);
    bytes
}

fn schema() -> Vec<u8> {
    let mut content = 1_u16.to_le_bytes().to_vec();
    put_text(&mut content, TYPES[0]);
    put_text(&mut content, "ros2msg");
    put_text(&mut content, DEFINITION);
    record(SCHEMA, &content)
}

fn channel() -> Vec<u8> {
    let mut content = Vec::new();
    content.extend(1_u16.to_le_bytes());
    content.extend(1_u16.to_le_bytes());
    put_text(&mut content, TOPIC);
    put_text(&mut content, "cdr");
    let mut metadata = Vec::new();
    put_text(&mut metadata, "offered_qos_profiles");
    put_text(&mut metadata, "");
    content.extend((metadata.len() as u32).to_le_bytes());
    content.extend(metadata);
    record(CHANNEL, &content)
}

impl McapWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        // Stamps hold seconds in 31 bits.
        let latest_us = i64::from(i32::MAX) * 1_000_000;
        let check = Check::new(path, Format::Mcap, options.size, (0, latest_us), 15);
        let mut writer = Self {
            output: Output::create(path, options.overwrite)?,
            check,
            size: options.size,
            at: 0,
            sequence: 0,
            events: Vec::new(),
            triggers: Vec::new(),
            words: Vec::new(),
            chunk: Vec::new(),
            index: Vec::new(),
            chunks: Vec::new(),
        };
        let mut header = Vec::new();
        put_text(&mut header, "ros2");
        put_text(&mut header, "evis");
        writer.put(MAGIC)?;
        writer.put(&record(HEADER, &header))?;
        writer.put(&schema())?;
        writer.put(&channel())?;
        Ok(writer)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        self.at += bytes.len() as u64;
        self.output.write(bytes)
    }

    /// Makes a message of what has gathered.
    fn message(&mut self) -> Result<(), FormatError> {
        let times = [self.events.first().map(|e| e.t), self.triggers.first().map(|e| e.t)];
        let Some(first_us) = times.into_iter().flatten().min() else { return Ok(()) };
        // Each message can be decoded alone: it starts with its time and its row.
        let mut encoder = Evt3Encoder::starting_at(self.size.0 as u16, first_us);
        self.words.clear();
        let mut rest = self.events.as_slice();
        for edge in &self.triggers {
            let (before, after) = rest.split_at(rest.partition_point(|event| event.t <= edge.t));
            encoder.events(before, &mut self.words);
            encoder.trigger(edge, &mut self.words);
            rest = after;
        }
        encoder.events(rest, &mut self.words);
        let time_ns = first_us as u64 * 1000;
        let mut content = Vec::with_capacity(self.words.len() * 2 + 128);
        content.extend(1_u16.to_le_bytes());
        content.extend(self.sequence.to_le_bytes());
        content.extend(time_ns.to_le_bytes());
        content.extend(time_ns.to_le_bytes());
        let start = content.len() + 4;
        content.extend([0, 1, 0, 0]);
        content.extend(((first_us / 1_000_000) as i32).to_le_bytes());
        content.extend(((first_us % 1_000_000) as u32 * 1000).to_le_bytes());
        let align = |content: &mut Vec<u8>, size: usize| {
            let end = start + (content.len() - start).next_multiple_of(size);
            content.resize(end, 0);
        };
        put_text(&mut content, "event_camera\0");
        align(&mut content, 4);
        content.extend(self.size.1.to_le_bytes());
        content.extend(self.size.0.to_le_bytes());
        align(&mut content, 8);
        content.extend(u64::from(self.sequence).to_le_bytes());
        // What is added to a message's own 24-bit time, in nanoseconds.
        content.extend(((first_us as u64 & !0xFF_FFFF) * 1000).to_le_bytes());
        put_text(&mut content, "evt3\0");
        content.push(0);
        align(&mut content, 4);
        content.extend((self.words.len() as u32 * 2).to_le_bytes());
        content.extend_from_slice(bytemuck::cast_slice(&self.words));
        self.index.push((time_ns, self.chunk.len() as u64));
        self.chunk.extend(record(MESSAGE, &content));
        self.sequence += 1;
        self.events.clear();
        self.triggers.clear();
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    fn end_chunk(&mut self) -> Result<(), FormatError> {
        let (Some(&(first, _)), Some(&(last, _))) = (self.index.first(), self.index.last()) else {
            return Ok(());
        };
        let mut content = Vec::with_capacity(self.chunk.len() + 64);
        content.extend(first.to_le_bytes());
        content.extend(last.to_le_bytes());
        content.extend((self.chunk.len() as u64).to_le_bytes());
        // No checksum.
        content.extend(0_u32.to_le_bytes());
        put_text(&mut content, "");
        content.extend((self.chunk.len() as u64).to_le_bytes());
        content.extend(&self.chunk);
        let at = self.at;
        let bytes = record(CHUNK, &content);
        let length = bytes.len() as u64;
        self.put(&bytes)?;
        let mut index = 1_u16.to_le_bytes().to_vec();
        index.extend((self.index.len() as u32 * 16).to_le_bytes());
        for (time, offset) in &self.index {
            index.extend(time.to_le_bytes());
            index.extend(offset.to_le_bytes());
        }
        let index_at = self.at;
        let bytes = record(MESSAGE_INDEX, &index);
        let index_length = bytes.len() as u64;
        self.put(&bytes)?;
        let size = self.chunk.len() as u64;
        self.chunks.push(ChunkEntry { first, last, at, length, index_at, index_length, size });
        self.chunk.clear();
        self.index.clear();
        Ok(())
    }

    fn gather(&mut self, packet: &Packet) -> Result<(), FormatError> {
        let (mut events, mut triggers) = (packet.events.as_slice(), packet.triggers.as_slice());
        while !events.is_empty() || !triggers.is_empty() {
            let own = [self.events.first().map(|e| e.t), self.triggers.first().map(|e| e.t)];
            let new = [events.first().map(|e| e.t), triggers.first().map(|e| e.t)];
            let first_us = own.into_iter().chain(new).flatten().min().unwrap_or(0);
            let end_us = first_us.saturating_add(US_PER_MESSAGE);
            let room = EVENTS_PER_MESSAGE.saturating_sub(self.events.len());
            let taken = events.partition_point(|e| e.t < end_us).min(room);
            // A message that is full ends at its last event.
            let full = taken == room;
            let until_us = match events.get(taken) {
                Some(next) if full => next.t.min(end_us),
                _ => end_us,
            };
            let edges = triggers.partition_point(|e| e.t < until_us);
            let (now, later) = events.split_at(taken);
            self.events.extend_from_slice(now);
            events = later;
            let (now, later) = triggers.split_at(edges);
            self.triggers.extend_from_slice(now);
            triggers = later;
            if full || !events.is_empty() || !triggers.is_empty() {
                self.message()?;
            }
        }
        Ok(())
    }

    fn summary(&mut self) -> Result<(), FormatError> {
        self.put(&record(DATA_END, &[0; 4]))?;
        let start = self.at;
        let mut groups: Vec<(u8, u64, u64)> = Vec::new();
        self.put(&schema())?;
        groups.push((SCHEMA, start, self.at - start));
        let at = self.at;
        self.put(&channel())?;
        groups.push((CHANNEL, at, self.at - at));
        let mut statistics = Vec::new();
        statistics.extend(u64::from(self.sequence).to_le_bytes());
        statistics.extend(1_u16.to_le_bytes());
        statistics.extend(1_u32.to_le_bytes());
        statistics.extend([0; 8]);
        statistics.extend((self.chunks.len() as u32).to_le_bytes());
        statistics.extend(self.chunks.first().map_or(0, |chunk| chunk.first).to_le_bytes());
        statistics.extend(self.chunks.last().map_or(0, |chunk| chunk.last).to_le_bytes());
        statistics.extend(10_u32.to_le_bytes());
        statistics.extend(1_u16.to_le_bytes());
        statistics.extend(u64::from(self.sequence).to_le_bytes());
        let at = self.at;
        self.put(&record(STATISTICS, &statistics))?;
        groups.push((STATISTICS, at, self.at - at));
        let at = self.at;
        for entry in std::mem::take(&mut self.chunks) {
            let mut content = Vec::new();
            for number in [entry.first, entry.last, entry.at, entry.length] {
                content.extend(number.to_le_bytes());
            }
            content.extend(10_u32.to_le_bytes());
            content.extend(1_u16.to_le_bytes());
            content.extend(entry.index_at.to_le_bytes());
            content.extend(entry.index_length.to_le_bytes());
            put_text(&mut content, "");
            content.extend(entry.size.to_le_bytes());
            content.extend(entry.size.to_le_bytes());
            self.put(&record(CHUNK_INDEX, &content))?;
        }
        if self.at > at {
            groups.push((CHUNK_INDEX, at, self.at - at));
        }
        let offsets = self.at;
        for (op, at, length) in groups {
            let mut content = vec![op];
            content.extend(at.to_le_bytes());
            content.extend(length.to_le_bytes());
            self.put(&record(SUMMARY_OFFSET, &content))?;
        }
        let mut footer = Vec::new();
        footer.extend(start.to_le_bytes());
        footer.extend(offsets.to_le_bytes());
        footer.extend(0_u32.to_le_bytes());
        self.put(&record(FOOTER, &footer))?;
        self.put(MAGIC)
    }
}

impl EventWriter for McapWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.refuse(packet.frames.len(), "frames")?;
        self.check.refuse(packet.imu.len(), "inertial samples")?;
        self.check.triggers_among_events(packet)?;
        self.gather(packet)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.write(&Packet { events: events.to_vec(), ..Packet::default() })
    }

    fn finish(mut self: Box<Self>) -> Result<(), FormatError> {
        self.message()?;
        self.end_chunk()?;
        self.summary()?;
        self.output.finish()
    }
}
