//! RAW files: a header, then words of EVT 2.0 or EVT 3.0.

use std::path::Path;

use evis_core::Event;
use evis_core::format::FormatError;

use super::header::{self, MOST_HEADER};
use super::{evt2, evt3};
use crate::check::Check;
use crate::files::{Input, Output};
use crate::format::Format;
use crate::packet::{Packet, Trigger};
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// Bytes that are decoded at once.
const BLOCK: usize = 128 << 10;
/// Blocks between the places that a seek can start from.
const BLOCKS_PER_CHECKPOINT: u64 = 32;
/// Largest side where the header has none: 11 bits.
const LARGEST_SIDE: u16 = 2048;

#[derive(Clone, Copy)]
enum Decoder {
    Evt2(evt2::Decoder),
    Evt3(evt3::Decoder),
}

impl Decoder {
    fn decode(&mut self, bytes: &[u8], packet: &mut Packet) -> Result<(), (usize, String)> {
        match self {
            Self::Evt2(decoder) => decoder.decode(bytes, &mut packet.events, &mut packet.triggers),
            Self::Evt3(decoder) => decoder.decode(bytes, &mut packet.events, &mut packet.triggers),
        }
    }

    const fn now_us(&self) -> i64 {
        match self {
            Self::Evt2(decoder) => decoder.now_us(),
            Self::Evt3(decoder) => decoder.now_us(),
        }
    }

    const fn word_bytes(&self) -> usize {
        match self {
            Self::Evt2(_) => 4,
            Self::Evt3(_) => 2,
        }
    }
}

/// Reads RAW files.
pub(crate) struct RawReader {
    input: Input,
    info: StreamInfo,
    decoder: Decoder,
    block: Vec<u8>,
    /// Places to start from, with what was known there; the first is the start.
    checkpoints: Vec<(u64, Decoder)>,
    /// Where the file is damaged, once that is known.
    damage: Option<(u64, String)>,
}

impl RawReader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut input = Input::open(path)?;
        let mut block = Vec::new();
        input.read_block(&mut block, MOST_HEADER)?;
        let header = header::read(path, &block)?;
        let format = header.format().unwrap_or(Format::Evt3);
        let mut info = StreamInfo::new(format);
        info.size = header.size().or(options.size);
        info.properties = header.lines;
        let side = |side: Option<u32>| {
            side.and_then(|side| u16::try_from(side).ok()).unwrap_or(LARGEST_SIDE).min(LARGEST_SIDE)
        };
        let (width, height) = (side(info.size.map(|s| s.0)), side(info.size.map(|s| s.1)));
        let decoder = match format {
            Format::Evt2 => Decoder::Evt2(evt2::Decoder::new(width, height)),
            _ => Decoder::Evt3(evt3::Decoder::new(width, height)),
        };
        let start = header.length as u64;
        input.seek(start)?;
        Ok(Self { input, info, decoder, block, checkpoints: vec![(start, decoder)], damage: None })
    }

    fn damaged(&self) -> Option<FormatError> {
        self.damage.as_ref().map(|(at, what)| self.input.damaged(*at, what))
    }
}

impl EventReader for RawReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if let Some(error) = self.damaged() {
            return Err(error);
        }
        let at = self.input.at();
        if let Some(last) = self.checkpoints.last()
            && at >= last.0 + BLOCKS_PER_CHECKPOINT * BLOCK as u64
        {
            self.checkpoints.push((at, self.decoder));
        }
        self.input.read_block(&mut self.block, BLOCK)?;
        let decoded = self.decoder.decode(&self.block, packet);
        let rest = self.block.len() % self.decoder.word_bytes();
        self.damage = match decoded {
            Err((word, what)) => Some((at + (word * self.decoder.word_bytes()) as u64, what)),
            Ok(()) if rest > 0 => Some((self.input.at() - rest as u64, "it ends within a word".into())),
            Ok(()) => None,
        };
        match self.damaged() {
            // What comes before the damage comes first.
            Some(error) if packet.is_empty() => Err(error),
            Some(_) => Ok(true),
            None => Ok(!self.block.is_empty()),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.input.part())
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        // Times count wraps from the start, so the way leads from a place whose time is known.
        let index =
            self.checkpoints.partition_point(|(_, decoder)| decoder.now_us() < t_us).saturating_sub(1);
        let Some(&(at, decoder)) = self.checkpoints.get(index) else { return Ok(()) };
        self.damage = None;
        self.decoder = decoder;
        self.input.seek(at)?;
        let mut packet = Packet::default();
        loop {
            let (at, decoder) = (self.input.at(), self.decoder);
            // Damage ends the search; reading meets it again.
            let more = self.read_packet(&mut packet).unwrap_or(false);
            if !more || self.damage.is_some() || self.decoder.now_us() >= t_us {
                self.damage = None;
                self.decoder = decoder;
                return self.input.seek(at);
            }
        }
    }
}

/// Writes RAW files in EVT 3.0.
pub(crate) struct Evt3Writer {
    output: Output,
    check: Check,
    encoder: evt3::Encoder,
    words: Vec<u16>,
}

/// Writes RAW files in EVT 2.0.
pub(crate) struct Evt2Writer {
    output: Output,
    check: Check,
    encoder: evt2::Encoder,
    words: Vec<u32>,
}

/// Events that are encoded before they go to the file.
const EVENTS_AT_ONCE: usize = 16 << 10;

/// Calls `events` and `trigger` with the parts of a packet in the order of time; an event comes before a
/// trigger of the same microsecond.
fn in_order<S>(
    state: &mut S,
    packet: &Packet,
    mut events: impl FnMut(&mut S, &[Event]) -> Result<(), FormatError>,
    mut trigger: impl FnMut(&mut S, &Trigger) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    let mut rest = packet.events.as_slice();
    for edge in &packet.triggers {
        let (before, after) = rest.split_at(rest.partition_point(|event| event.t <= edge.t));
        events(state, before)?;
        trigger(state, edge)?;
        rest = after;
    }
    events(state, rest)
}

macro_rules! raw_writer {
    ($writer:ident, $format:expr, $module:ident, $encoder:expr, $most_id:expr) => {
        impl $writer {
            pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
                let mut output = Output::create(path, options.overwrite)?;
                output.write(header::raw_header($format, options.size).as_bytes())?;
                let check = Check::new(path, $format, options.size, (0, $module::LATEST_US), $most_id);
                Ok(Self { output, check, encoder: $encoder(options), words: Vec::new() })
            }

            fn put(&mut self, events: &[Event]) -> Result<(), FormatError> {
                for part in events.chunks(EVENTS_AT_ONCE) {
                    self.encoder.events(part, &mut self.words);
                    self.output.write(bytemuck::cast_slice(&self.words))?;
                    self.words.clear();
                }
                Ok(())
            }
        }

        impl EventWriter for $writer {
            fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
                self.check.refuse(packet.frames.len(), "frames")?;
                self.check.refuse(packet.imu.len(), "inertial samples")?;
                self.check.triggers_among_events(packet)?;
                in_order(self, packet, Self::put, |this, trigger| {
                    this.encoder.trigger(trigger, &mut this.words);
                    Ok(())
                })?;
                self.output.write(bytemuck::cast_slice(&self.words))?;
                self.words.clear();
                Ok(())
            }

            fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
                self.check.events(events)?;
                self.put(events)
            }

            fn finish(self: Box<Self>) -> Result<(), FormatError> {
                self.output.finish()
            }
        }
    };
}

raw_writer!(
    Evt3Writer,
    Format::Evt3,
    evt3,
    |options: &WriteOptions| evt3::Encoder::new(options.size.0 as u16),
    15
);
raw_writer!(Evt2Writer, Format::Evt2, evt2, |_: &WriteOptions| evt2::Encoder::new(), 31);
