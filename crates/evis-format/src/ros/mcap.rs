//! ROS 2 bags in MCAP: events as `event_camera_msgs/msg/EventPacket` in EVT 3.0.
//!
//! Layouts: the MCAP specification, and OMG's CDR as ROS 2 writes it.

use std::path::{Path, PathBuf};

use evis_core::Event;
use evis_core::format::FormatError;

pub(crate) use super::bag::MAGIC;
use super::bag::{Bag, CHANNEL, CHUNK, DATA_END, FOOTER, MESSAGE, SCHEMA};
use super::cdr::Cdr;
use super::message::{self, EVENT_PACKET, IMAGE, IMU, Pixels};
use crate::check::Check;
use crate::files::{Input, u16_at, u32_at, u64_at};
use crate::format::Format;
use crate::packet::{Frame, Packet, Trigger};
use crate::prophesee::{Evt3Decoder, Evt3Encoder};
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// Largest record that is read, and largest chunk when it is unpacked.
const MOST_RECORD: u64 = 256 << 20;

/// Types of messages that carry events.
const TYPES: [&str; 2] = [EVENT_PACKET.name, "event_array_msgs/msg/EventArray"];
/// The camera of a file that names none.
const CAMERA: &str = "event_camera";

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

    fn part(&self) -> Option<f64> {
        Some(self.input.part())
    }

    fn seek(&mut self, _t_us: i64) -> Result<(), FormatError> {
        // Indexes hold the time of recording, not of the events: from the start.
        self.begin()
    }
}

/// Events of a message at most, and microseconds that it spans at most.
const EVENTS_PER_MESSAGE: usize = 16 << 10;
const US_PER_MESSAGE: i64 = 10_000;
/// Latest stamp: seconds have 31 bits.
pub(super) const LATEST_US: i64 = i32::MAX as i64 * 1_000_000;

/// A topic of events in a bag that is being written.
pub(super) struct EventTopic {
    check: Check,
    /// Its place among the bag's topics.
    place: usize,
    frame: String,
    size: (u32, u32),
    sequence: u64,
    events: Vec<Event>,
    triggers: Vec<Trigger>,
    words: Vec<u16>,
}

impl EventTopic {
    /// Adds the topic `/<name>/events` of a camera.
    pub fn new(
        bag: &mut Bag,
        path: &Path,
        name: &str,
        frame: &str,
        size: (u32, u32),
    ) -> Result<Self, FormatError> {
        let place = bag.topic(format!("/{name}/events"), &EVENT_PACKET)?;
        let check = Check::new(path, Format::Mcap, size, (0, LATEST_US), 15);
        let (events, triggers, words) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { check, place, frame: frame.into(), size, sequence: 0, events, triggers, words })
    }

    /// Makes a message of what has gathered.
    pub fn flush(&mut self, bag: &mut Bag) -> Result<(), FormatError> {
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
        let mut message = Cdr::stamped(first_us, &self.frame, self.words.len() * 2);
        message.u32(self.size.1);
        message.u32(self.size.0);
        message.u64(self.sequence);
        // What is added to a message's own 24-bit time, in nanoseconds.
        message.u64((first_us as u64 & !0xFF_FFFF) * 1000);
        message.text("evt3");
        message.bool(false);
        message.bytes(bytemuck::cast_slice(&self.words));
        self.sequence += 1;
        self.events.clear();
        self.triggers.clear();
        bag.message(self.place, first_us, &message.finish())
    }

    /// Adds events and triggers, and makes messages of what is enough for one.
    pub fn gather(&mut self, packet: &Packet, bag: &mut Bag) -> Result<(), FormatError> {
        self.check.triggers_among_events(packet)?;
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
                self.flush(bag)?;
            }
        }
        Ok(())
    }
}

/// Writes MCAP files of one camera: events, and images and inertial samples where there are any.
pub(crate) struct McapWriter {
    bag: Bag,
    events: EventTopic,
    images: Option<usize>,
    imu: Option<usize>,
    path: PathBuf,
}

/// Metres per second squared of a g, and radians of a degree: ISO 80000-3 and the third CGPM.
const G: f64 = 9.806_65;
const DEGREE: f64 = std::f64::consts::PI / 180.0;

impl McapWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let mut bag = Bag::create(path, options.overwrite)?;
        let events = EventTopic::new(&mut bag, path, CAMERA, CAMERA, options.size)?;
        Ok(Self { bag, events, images: None, imu: None, path: path.into() })
    }

    fn check(&self, packet: &Packet) -> Result<(), FormatError> {
        let frames = packet.frames.iter().flat_map(|frame| [frame.start_us, frame.end_us]);
        let mut times = frames.chain(packet.imu.iter().map(|sample| sample.t));
        if let Some(t) = times.find(|t| !(0..=LATEST_US).contains(t)) {
            return Err(FormatError::invalid(
                &self.path,
                format!("an image or inertial sample is at {t} us"),
                format!(
                    "{} holds times from 0 to {LATEST_US} us: cut the stream, or shift its times",
                    Format::Mcap
                ),
            ));
        }
        let fits = |frame: &&Frame| {
            let values = [frame.width, frame.height, frame.channels.into()].map(u64::from);
            encoding(frame.channels).is_some() && values.iter().product::<u64>() == frame.pixels.len() as u64
        };
        if let Some(frame) = packet.frames.iter().find(|frame| !fits(frame)) {
            let Frame { width, height, channels, ref pixels, .. } = *frame;
            return Err(FormatError::invalid(
                &self.path,
                format!("an image of {width}x{height}, {channels} channels, has {} bytes", pixels.len()),
                "give 1, 3 or 4 channels of 8 bits",
            ));
        }
        Ok(())
    }
}

/// The name of an encoding of 8-bit channels.
const fn encoding(channels: u8) -> Option<&'static str> {
    match channels {
        1 => Some("mono8"),
        3 => Some("rgb8"),
        4 => Some("rgba8"),
        _ => None,
    }
}

impl EventWriter for McapWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check(packet)?;
        self.events.gather(packet, &mut self.bag)?;
        for frame in &packet.frames {
            let place = match self.images {
                Some(place) => place,
                None => *self.images.insert(self.bag.topic(format!("/{CAMERA}/image_raw"), &IMAGE)?),
            };
            // The middle of the exposure.
            let t_us = frame.start_us + (frame.end_us - frame.start_us) / 2;
            let encoding = encoding(frame.channels).unwrap_or_default();
            let pixels = Pixels { size: (frame.width, frame.height), encoding, bytes: &frame.pixels };
            self.bag.message(place, t_us, &message::image(t_us, CAMERA, &pixels))?;
        }
        for sample in &packet.imu {
            let place = match self.imu {
                Some(place) => place,
                None => *self.imu.insert(self.bag.topic(format!("/{CAMERA}/imu"), &IMU)?),
            };
            let accelerometer = sample.acceleration.map(|value| f64::from(value) * G);
            let gyroscope = sample.rotation.map(|value| f64::from(value) * DEGREE);
            let content = message::imu(sample.t, CAMERA, accelerometer, gyroscope);
            self.bag.message(place, sample.t, &content)?;
        }
        Ok(())
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.events.gather(&Packet { events: events.to_vec(), ..Packet::default() }, &mut self.bag)
    }

    fn finish(mut self: Box<Self>) -> Result<(), FormatError> {
        self.events.flush(&mut self.bag)?;
        self.bag.finish()
    }
}
