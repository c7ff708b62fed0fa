//! Event Stream, version 2, of DVS events: a byte of time and polarity, then the place.
//!
//! Layout: the Event Stream specification. Rows count from the bottom.

use std::path::Path;

use evis_core::format::FormatError;
use evis_core::{Event, Polarity};

use crate::check::Check;
use crate::files::{Input, Output, u16_at};
use crate::format::Format;
use crate::packet::Packet;
use crate::read::{EventReader, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// First bytes of a file.
pub(crate) const MAGIC: &[u8; 12] = b"Event Stream";
/// Version 2.0.0, and the type of DVS events.
const VERSION: [u8; 3] = [2, 0, 0];
const DVS: u8 = 1;
/// Bytes before the first event.
const START: usize = 20;
/// A byte that is no event: 127 us pass, or nothing does.
const OVERFLOW: u8 = 0xFF;
const RESET: u8 = 0xFE;
const OVERFLOW_US: i64 = 127;
/// Bytes that are read at once.
const BLOCK: usize = 128 << 10;
/// Latest time: silence takes a byte per 127 us, and these days are 270 MB of it.
const LATEST_US: i64 = 1 << 35;

/// Reads Event Stream files.
pub(crate) struct EsReader {
    input: Input,
    info: StreamInfo,
    size: (u16, u16),
    t: i64,
    /// Bytes of an event that the block before began with.
    block: Vec<u8>,
    damage: Option<(u64, String)>,
}

impl EsReader {
    pub(crate) fn open(path: &Path) -> Result<Self, FormatError> {
        let mut input = Input::open(path)?;
        let mut head = Vec::new();
        input.read_block(&mut head, START)?;
        let (Some(version), Some(&kind)) = (head.get(12..15), head.get(15)) else {
            return Err(input.damaged(input.at(), "it ends within its header"));
        };
        if version.first() != Some(&2) {
            return Err(input.damaged(12, &format!("its version is {version:?}, and only 2 is read")));
        }
        if kind != DVS {
            return Err(
                input.damaged(15, &format!("its events are of type {kind}, and only 1 (DVS) is read"))
            );
        }
        let (Some(width), Some(height)) = (u16_at(&head, 16), u16_at(&head, 18)) else {
            return Err(input.damaged(input.at(), "it ends within its header"));
        };
        if width == 0 || height == 0 {
            return Err(input.damaged(16, &format!("its sensor has {width}x{height} pixels")));
        }
        let mut info = StreamInfo::new(Format::Es);
        info.size = Some((width.into(), height.into()));
        Ok(Self { input, info, size: (width, height), t: 0, block: Vec::new(), damage: None })
    }
}

impl EventReader for EsReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if let Some((at, what)) = &self.damage {
            return Err(self.input.damaged(*at, what));
        }
        let start = self.input.at();
        self.input.read_block(&mut self.block, BLOCK)?;
        let (width, height) = self.size;
        let mut at = 0;
        while let Some(&byte) = self.block.get(at) {
            match byte {
                OVERFLOW => self.t += OVERFLOW_US,
                RESET => {}
                _ => {
                    let Some(&[x0, x1, y0, y1]) = self.block.get(at + 1..at + 5) else { break };
                    let (x, y) = (u16::from_le_bytes([x0, x1]), u16::from_le_bytes([y0, y1]));
                    if x >= width || y >= height {
                        let what = format!("x {x}, y {y} lies outside of {width}x{height}");
                        self.damage = Some((start + at as u64, what));
                        return if packet.is_empty() { self.read_packet(packet) } else { Ok(true) };
                    }
                    self.t += i64::from(byte >> 1);
                    let polarity = if byte & 1 == 0 { Polarity::Off } else { Polarity::On };
                    packet.events.push(Event::new(self.t, x, height - 1 - y, polarity));
                    at += 4;
                }
            }
            at += 1;
        }
        if at < self.block.len() {
            if self.input.at() == self.input.length() {
                self.damage = Some((start + at as u64, "it ends within an event".into()));
                return if packet.is_empty() { self.read_packet(packet) } else { Ok(true) };
            }
            // The rest of the event comes with the next block.
            self.input.seek(start + at as u64)?;
        }
        Ok(!self.block.is_empty())
    }

    fn part(&self) -> Option<f64> {
        Some(self.input.part())
    }

    fn seek(&mut self, _t_us: i64) -> Result<(), FormatError> {
        // Times are differences: from the start.
        (self.t, self.damage) = (0, None);
        self.input.seek(START as u64)
    }
}

/// Writes Event Stream files.
pub(crate) struct EsWriter {
    output: Output,
    check: Check,
    height: u32,
    t: i64,
    bytes: Vec<u8>,
}

impl EsWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let mut output = Output::create(path, options.overwrite)?;
        let (width, height) = options.size;
        output.write(MAGIC)?;
        output.write(&VERSION)?;
        output.write(&[DVS])?;
        output.write(&(width as u16).to_le_bytes())?;
        output.write(&(height as u16).to_le_bytes())?;
        let check = Check::new(path, Format::Es, options.size, (0, LATEST_US), -1);
        Ok(Self { output, check, height, t: 0, bytes: Vec::new() })
    }
}

impl EventWriter for EsWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.only_events(packet)?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        for e in events {
            let mut step = e.t - self.t;
            while step >= OVERFLOW_US {
                let silence = (step / OVERFLOW_US).min(1 << 20);
                self.bytes.resize(self.bytes.len() + silence as usize, OVERFLOW);
                step -= silence * OVERFLOW_US;
                if self.bytes.len() > BLOCK {
                    self.output.write(&self.bytes)?;
                    self.bytes.clear();
                }
            }
            self.t = e.t;
            let y = (self.height - 1 - u32::from(e.y)) as u16;
            let [x0, x1] = e.x.to_le_bytes();
            let [y0, y1] = y.to_le_bytes();
            self.bytes.extend([(step as u8) << 1 | e.p as u8, x0, x1, y0, y1]);
            if self.bytes.len() > BLOCK {
                self.output.write(&self.bytes)?;
                self.bytes.clear();
            }
        }
        self.output.write(&self.bytes)?;
        self.bytes.clear();
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        self.output.finish()
    }
}
