//! DAT files: a header of lines, two bytes, then 8 bytes per event.

use std::path::Path;

use evis_core::format::FormatError;
use evis_core::{Event, Polarity};

use super::header::{self, MOST_HEADER};
use crate::check::Check;
use crate::files::{Input, Output, u32_at};
use crate::format::Format;
use crate::packet::{Packet, Trigger};
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// Type of events, in the first of the two bytes after the header.
const EVENT_CD: u8 = 0x0C;
/// The same in older files.
const EVENT_2D: u8 = 0x00;
/// Type of triggers.
const EVENT_TRIGGER: u8 = 0x0E;
/// Bytes per event, the second of the two bytes.
const ROW: usize = 8;
/// Rows that are read at once.
const ROWS_AT_ONCE: usize = 32 << 10;

/// Reads DAT files.
pub(crate) struct DatReader {
    input: Input,
    info: StreamInfo,
    start: u64,
    rows: u64,
    triggers: bool,
    block: Vec<u8>,
    damage: Option<(u64, String)>,
}

impl DatReader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut input = Input::open(path)?;
        let mut block = Vec::new();
        input.read_block(&mut block, MOST_HEADER)?;
        let header = header::read(path, &block)?;
        let at = header.length as u64;
        let version = header.get("version").unwrap_or("2");
        if version.trim() != "2" {
            return Err(input.damaged(at, &format!("its version is {version}, and only version 2 is read")));
        }
        let triggers = match block.get(header.length..header.length + 2) {
            Some(&[EVENT_CD | EVENT_2D, 8]) => false,
            Some(&[EVENT_TRIGGER, 8]) => true,
            Some(&[kind, size]) => {
                let what =
                    format!("events are of type {kind} in {size} bytes, and only 12 or 14 in 8 are read");
                return Err(input.damaged(at, &what));
            }
            _ => return Err(input.damaged(at, "it ends before its events")),
        };
        let start = at + 2;
        let rows = input.length().saturating_sub(start) / ROW as u64;
        let mut info = StreamInfo::new(Format::Dat);
        info.size = header.size().or(options.size);
        info.events = Some(if triggers { 0 } else { rows });
        info.properties = header.lines;
        input.seek(start)?;
        Ok(Self { input, info, start, rows, triggers, block, damage: None })
    }

    fn time_of(&mut self, row: u64) -> Result<i64, FormatError> {
        self.input.seek(self.start + row * ROW as u64)?;
        self.input.read_block(&mut self.block, ROW)?;
        Ok(u32_at(&self.block, 0).map_or(i64::MAX, i64::from))
    }
}

impl EventReader for DatReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if let Some((at, what)) = &self.damage {
            return Err(self.input.damaged(*at, what));
        }
        let at = self.input.at();
        self.input.read_block(&mut self.block, ROWS_AT_ONCE * ROW)?;
        let (rows, rest): (&[[u8; ROW]], _) = self.block.as_chunks();
        if !rest.is_empty() {
            self.damage = Some((self.input.at() - rest.len() as u64, "it ends within an event".into()));
        }
        let split = |row: &[u8; ROW]| {
            let row = u64::from_le_bytes(*row);
            (i64::from(row as u32), (row >> 32) as u32)
        };
        if self.triggers {
            packet.triggers.extend(rows.iter().map(|row| {
                let (t, word) = split(row);
                Trigger::new(t, (word >> 8 & 0x1F) as i16, word & 1 == 1)
            }));
        } else {
            let (width, height) = self.info.size.unwrap_or((1 << 14, 1 << 14));
            let mut outside = false;
            packet.events.extend(rows.iter().map(|row| {
                let (t, word) = split(row);
                let (x, y) = (word & 0x3FFF, word >> 14 & 0x3FFF);
                outside |= (x >= width) | (y >= height) | (word >> 28 > 1);
                let polarity = if word >> 28 == 0 { Polarity::Off } else { Polarity::On };
                Event::new(t, x as u16, y as u16, polarity)
            }));
            if outside {
                let wrong = |row: &[u8; ROW]| {
                    let (_, word) = split(row);
                    (word & 0x3FFF, word >> 14 & 0x3FFF, word >> 28)
                };
                let found = rows
                    .iter()
                    .map(wrong)
                    .enumerate()
                    .find(|(_, (x, y, p))| *x >= width || *y >= height || *p > 1);
                if let Some((index, (x, y, p))) = found {
                    packet.events.truncate(index);
                    let what = format!(
                        "an event has x {x}, y {y}, polarity {p}, outside of {width}x{height} and 0, 1"
                    );
                    self.damage = Some((at + (index * ROW) as u64, what));
                }
            }
        }
        match &self.damage {
            Some((at, what)) if packet.is_empty() => Err(self.input.damaged(*at, what)),
            Some(_) => Ok(true),
            None => Ok(!self.block.is_empty()),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.input.part())
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        let (mut low, mut high) = (0, self.rows);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.time_of(middle)? < t_us {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        self.damage = None;
        self.input.seek(self.start + low * ROW as u64)
    }
}

/// Writes DAT files.
pub(crate) struct DatWriter {
    output: Output,
    check: Check,
    rows: Vec<u64>,
}

impl DatWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let mut output = Output::create(path, options.overwrite)?;
        let (width, height) = options.size;
        let header = format!(
            "% Data file containing CD events.\n% Version 2\n% Date 1970-01-01 00:00:00\n% Height {height}\n% Width {width}\n"
        );
        output.write(header.as_bytes())?;
        output.write(&[EVENT_CD, ROW as u8])?;
        let check = Check::new(path, Format::Dat, options.size, (0, u32::MAX.into()), -1);
        Ok(Self { output, check, rows: Vec::new() })
    }
}

impl EventWriter for DatWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.refuse(packet.frames.len(), "frames")?;
        self.check.refuse(packet.imu.len(), "inertial samples")?;
        self.check.refuse(packet.triggers.len(), "triggers beside events")?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        for part in events.chunks(ROWS_AT_ONCE) {
            self.rows.clear();
            self.rows.extend(part.iter().map(|e| {
                let word = u32::from(e.x) | u32::from(e.y) << 14 | (e.p as u32) << 28;
                (u64::from(word) << 32 | u64::from(e.t as u32)).to_le()
            }));
            self.output.write(bytemuck::cast_slice(&self.rows))?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        self.output.finish()
    }
}
