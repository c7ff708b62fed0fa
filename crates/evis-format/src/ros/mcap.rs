//! ROS 2 bags in MCAP as event files: events as `event_camera_msgs/msg/EventPacket` in EVT 3.0, and 8-bit images and inertial
//! samples of the same camera.
//!
//! Layouts: the MCAP specification, and OMG's CDR as ROS 2 writes it.

use std::path::{Path, PathBuf};

use evis_core::Event;
use evis_core::format::FormatError;

use super::bag::Bag;
pub(crate) use super::bag::MAGIC;
use super::cdr::Cdr;
use super::message::{self, EVENT_PACKET, IMAGE, IMU, Pixels};
use super::parse::{EventMessage, Image, is_event_type};
use super::records::{BagReader, Record, Topic};
use crate::check::Check;
use crate::format::Format;
use crate::packet::{AedatImuSample, Frame, Packet, Trigger};
use crate::prophesee::{Evt3Decoder, Evt3Encoder};
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// The camera of a file that names none.
const CAMERA: &str = "event_camera";

/// Decodes the events of a topic, message by message.
#[derive(Default)]
pub(super) struct EventDecoder {
    /// Pixels per row, and rows, as the last message says.
    pub size: Option<(u32, u32)>,
    /// Stamp and time of the message before.
    last: Option<(i64, i64)>,
}

impl EventDecoder {
    /// Appends the events and triggers of a message; says what is wrong with it.
    pub fn message(&mut self, bytes: &[u8], packet: &mut Packet) -> Result<(), String> {
        let message = EventMessage::parse(bytes)?;
        if message.encoding != "evt3" {
            return Err(format!("events are encoded as '{}', and only evt3 is read", message.encoding));
        }
        let EventMessage { stamp_us, size, events, .. } = message;
        let (width, height) = size;
        self.size = Some(size);
        // Time in EVT 3.0 starts again each 16.8 s; stamps tell how often it did since the message before, and
        // at the start, whether they are the events' own time.
        let expected_us = self.last.map_or(stamp_us, |(stamp, t)| t + (stamp_us - stamp).clamp(0, 1 << 45));
        let mut decoder = Evt3Decoder::new(width as u16, height as u16);
        if self.last.is_some() || first_low_bits(events) == Some(stamp_us & 0xFF_FFFF) {
            decoder.expect(expected_us);
        }
        let decoded = decoder.decode(events, &mut packet.events, &mut packet.triggers);
        self.last = Some((stamp_us, decoder.now_us()));
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

/// The names that a camera's topics begin with, such as `/left/` of `/left/events`.
pub(super) fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(before, _)| topic.get(..=before.len()).unwrap_or_default())
}

/// Reads MCAP files.
pub(crate) struct McapReader {
    bag: BagReader,
    info: StreamInfo,
    topic: Option<String>,
    decoder: EventDecoder,
    failed: Option<String>,
}

/// What a record was.
enum Step {
    End,
    Nothing,
    Content,
}

impl McapReader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut reader = Self {
            bag: BagReader::open(path)?,
            info: StreamInfo::new(Format::Mcap),
            topic: options.camera.clone(),
            decoder: EventDecoder::default(),
            failed: None,
        };
        // The first message tells the size; the summary at the end would tell the topics, but a file that was
        // cut off has none.
        let mut packet = Packet::default();
        while reader.decoder.size.is_none() {
            match reader.step(&mut packet)? {
                Ok(Step::End) | Err(_) => break,
                Ok(_) => packet.clear(),
            }
        }
        let (events, others): (Vec<&Topic>, Vec<&Topic>) =
            reader.bag.topics().iter().partition(|topic| is_event_type(&topic.kind));
        let topics: Vec<String> = events.into_iter().map(|topic| topic.name.clone()).collect();
        let property = |topic: &Topic| ("topic".to_owned(), format!("{} ({})", topic.name, topic.kind));
        reader.info.properties = others.into_iter().map(property).collect();
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
        reader.info.size = reader.decoder.size.or(options.size);
        reader.begin()?;
        Ok(reader)
    }

    fn begin(&mut self) -> Result<(), FormatError> {
        (self.decoder, self.failed) = (EventDecoder::default(), None);
        self.bag.begin()
    }

    /// Reads the next record; the inner error says what is wrong with it.
    fn step(&mut self, packet: &mut Packet) -> Result<Result<Step, String>, FormatError> {
        Ok(match self.bag.step()? {
            Ok(Record::End) => Ok(Step::End),
            Ok(Record::Other) => Ok(Step::Nothing),
            Ok(Record::Message(place)) => self.message(place, packet),
            Err(what) => Err(what),
        })
    }

    fn message(&mut self, place: usize, packet: &mut Packet) -> Result<Step, String> {
        let Some(Topic { kind, name, .. }) = self.bag.topics().get(place) else { return Ok(Step::Nothing) };
        let bytes = self.bag.message();
        if is_event_type(kind) && self.topic.as_ref().is_none_or(|topic| topic == name) {
            self.decoder.message(bytes, packet)?;
            self.info.size = self.decoder.size;
            return Ok(Step::Content);
        }
        // What a camera has beside events has the same namespace.
        let Some(own) = self.topic.as_deref().and_then(|topic| name.strip_prefix(namespace(topic))) else {
            return Ok(Step::Nothing);
        };
        if kind == IMAGE.name && own == "image_raw" {
            let image = Image::parse(bytes)?;
            let Some(channels) = channels(image.encoding) else { return Ok(Step::Nothing) };
            let pixels = image.pixels(channels.into())?.to_vec();
            let (width, height) = image.size;
            let t_us = image.stamp_us;
            packet.frames.push(Frame { start_us: t_us, end_us: t_us, width, height, channels, pixels });
        } else if kind == IMU.name && own == "imu" {
            let sample = super::parse::imu(bytes)?;
            packet.imu.push(AedatImuSample {
                t: sample.t_us,
                acceleration: sample.accelerometer.map(|value| (value / G) as f32),
                rotation: sample.gyroscope.map(|value| (value / DEGREE) as f32),
                ..AedatImuSample::default()
            });
        } else {
            return Ok(Step::Nothing);
        }
        Ok(Step::Content)
    }
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
                Ok(Step::Content) => return Ok(true),
                Ok(Step::Nothing) => {}
                Err(what) => self.failed = Some(what),
            }
        }
        match &self.failed {
            Some(what) if packet.is_empty() => Err(self.bag.damaged(what)),
            _ => Ok(true),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.bag.part())
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

/// 8-bit channels of an encoding of images; `None` of others.
fn channels(name: &str) -> Option<u8> {
    [1, 3, 4].into_iter().find(|channels| encoding(*channels) == Some(name))
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
