//! Reading AEDAT 4.0.

use std::path::Path;

use evis_core::format::FormatError;
use evis_core::{Event, Polarity};

use super::compression::{Compression, MOST_PACKET};
use super::flatbuffer::{Table, sized};
use super::header::{Header, Kind, MOST_HEADER, Stream};
use crate::files::{Input, u32_at};
use crate::format::Format;
use crate::packet::{AedatImuSample, Frame, Packet, Trigger};
use crate::read::{EventReader, ReadOptions, StreamInfo};

/// Bytes of an event.
const EVENT: usize = 16;
/// Largest side of an image.
const LARGEST_SIDE: u32 = 1 << 15;

/// Reads AEDAT 4.0 files: one stream of events, and the frames, inertial samples and triggers that go with
/// it.
pub(crate) struct Aedat4Reader {
    input: Input,
    info: StreamInfo,
    compression: Compression,
    streams: Vec<Stream>,
    start: u64,
    /// Where the packets end.
    end: u64,
    packed: Vec<u8>,
    unpacked: Vec<u8>,
    /// Start of each packet with a time, and the latest time up to its end; filled by the first seek.
    index: Vec<(u64, i64)>,
    failed: Option<(u64, String)>,
}

impl Aedat4Reader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut input = Input::open(path)?;
        let mut head = Vec::new();
        input.read_block(&mut head, MOST_HEADER)?;
        let header = Header::parse(&head).map_err(|(at, what)| input.damaged(at, &what))?;
        let mut info = StreamInfo::new(Format::Aedat4);
        let events: Vec<&Stream> = header.streams.iter().filter(|s| s.kind == Kind::Events).collect();
        // Cameras go by the source, where each has its own, as in stereo recordings; else by the output's name.
        let own_source = |s: &&Stream| {
            !s.source.is_empty() && events.iter().filter(|other| other.source == s.source).count() == 1
        };
        let by_source = events.len() > 1 && events.iter().all(own_source);
        let name = |s: &Stream| if by_source { s.source.clone() } else { s.name.clone() };
        info.cameras = events.iter().map(|s| name(s)).collect();
        let chosen = match &options.camera {
            Some(camera) => events.iter().find(|s| name(s) == *camera || s.id.to_string() == *camera),
            None if events.len() > 1 => None,
            None => events.first(),
        };
        if chosen.is_none() && (options.camera.is_some() || events.len() > 1) {
            let what = match &options.camera {
                Some(camera) => format!("there is no stream of events {camera}"),
                None => format!("there are {} streams of events", events.len()),
            };
            let ids: Vec<String> = events.iter().map(|s| format!("{} ({})", name(s), s.id)).collect();
            return Err(FormatError::invalid(path, what, format!("choose one of: {}", ids.join(", "))));
        }
        let others = header.streams.iter().filter(|s| s.kind != Kind::Events);
        let source = chosen.map(|s| s.source.clone());
        info.size = chosen.and_then(|s| s.size).or(options.size);
        info.camera = chosen.map(|s| name(s));
        if let Some(source) = source.as_ref().filter(|source| !source.is_empty()) {
            info.properties.push(("source".into(), source.clone()));
        }
        // Of several cameras, what else belongs to this one comes from the same source.
        let mut streams: Vec<Stream> =
            others.filter(|s| !by_source || Some(&s.source) == source.as_ref()).cloned().collect();
        streams.extend(chosen.map(|s| (*s).clone()));
        let start = header.length as u64;
        let end = u64::try_from(header.table_at)
            .ok()
            .filter(|at| (start..=input.length()).contains(at))
            .unwrap_or(input.length());
        input.seek(start)?;
        Ok(Self {
            input,
            info,
            compression: header.compression,
            streams,
            start,
            end,
            packed: Vec::new(),
            unpacked: Vec::new(),
            index: Vec::new(),
            failed: None,
        })
    }

    /// Reads the next packet; `Err` holds where the file is damaged, and how.
    fn next(&mut self, packet: &mut Packet) -> Result<Result<bool, (u64, String)>, FormatError> {
        let at = self.input.at();
        if at >= self.end {
            return Ok(Ok(false));
        }
        self.input.read_block(&mut self.packed, 8)?;
        let (Some(id), Some(size)) = (u32_at(&self.packed, 0), u32_at(&self.packed, 4)) else {
            return Ok(Err((at, "it ends within the header of a packet".into())));
        };
        if u64::from(size) > (self.end - at).saturating_sub(8).min(MOST_PACKET) {
            let left = self.end - at;
            return Ok(Err((at, format!("a packet would be {size} bytes long, and {left} are left"))));
        }
        let Some(stream) = self.streams.iter().position(|stream| stream.id == id as i32) else {
            self.input.seek(at + 8 + u64::from(size))?;
            return Ok(Ok(true));
        };
        self.input.read_block(&mut self.packed, size as usize)?;
        let (kind, size) = (self.streams[stream].kind, self.info.size);
        let unpacked = match self.compression {
            Compression::None => &self.packed,
            compression => match compression.unpack(&self.packed, &mut self.unpacked) {
                Ok(()) => &self.unpacked,
                Err(what) => return Ok(Err((at + 8, what))),
            },
        };
        let decoded = match kind {
            Kind::Events => events(unpacked, size, &mut packet.events),
            Kind::Frames => frame(unpacked).map(|frame| packet.frames.extend(frame)),
            Kind::Imu => imu(unpacked, &mut packet.imu),
            Kind::Triggers => triggers(unpacked, &mut packet.triggers),
            Kind::Other => Ok(()),
        };
        Ok(decoded.map(|()| true).map_err(|what| (at + 8, what)))
    }

    fn build_index(&mut self) -> Result<(), FormatError> {
        self.input.seek(self.start)?;
        self.failed = None;
        let mut packet = Packet::default();
        let mut latest = i64::MIN;
        loop {
            packet.clear();
            let at = self.input.at();
            if !matches!(self.next(&mut packet)?, Ok(true)) {
                return Ok(());
            }
            if let Some((_, last)) = packet.range() {
                latest = latest.max(last);
                self.index.push((at, latest));
            }
        }
    }
}

impl EventReader for Aedat4Reader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if self.failed.is_none() {
            match self.next(packet)? {
                Ok(more) => return Ok(more),
                Err(failed) => self.failed = Some(failed),
            }
            // What comes before the damage within its packet comes first.
            if !packet.is_empty() {
                return Ok(true);
            }
        }
        match &self.failed {
            Some((at, what)) => Err(self.input.damaged(*at, what)),
            None => Ok(false),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.input.part())
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        if self.index.is_empty() {
            self.build_index()?;
        }
        self.failed = None;
        // A stream may lag behind another; all that comes after the first packet that reaches the time.
        let first = self.index.partition_point(|(_, latest)| *latest < t_us);
        let at = self.index.get(first).map_or(self.end, |(at, _)| *at);
        self.input.seek(at)
    }
}

fn root<'a>(bytes: &'a [u8], kind: Kind) -> Result<Table<'a>, String> {
    let identifier = kind.identifier();
    sized(bytes)
        .and_then(|bytes| Table::root(bytes, identifier))
        .ok_or_else(|| format!("a packet is no {} table", String::from_utf8_lossy(identifier)))
}

fn broken(kind: Kind) -> String {
    format!("a {} table leads outside of its packet", String::from_utf8_lossy(kind.identifier()))
}

fn events(bytes: &[u8], size: Option<(u32, u32)>, out: &mut Vec<Event>) -> Result<(), String> {
    let rows = root(bytes, Kind::Events)?.elements(0, EVENT).ok_or_else(|| broken(Kind::Events))?;
    let (width, height) = size.unwrap_or((LARGEST_SIDE, LARGEST_SIDE));
    let rows: &[[u8; EVENT]] = rows.as_chunks().0;
    let before = out.len();
    let mut outside = false;
    out.extend(rows.iter().map(|row| {
        let [t0, t1, t2, t3, t4, t5, t6, t7, x0, x1, y0, y1, on, ..] = *row;
        let (x, y) = (u16::from_le_bytes([x0, x1]), u16::from_le_bytes([y0, y1]));
        outside |= (u32::from(x) >= width) | (u32::from(y) >= height);
        let polarity = if on == 0 { Polarity::Off } else { Polarity::On };
        Event::new(i64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]), x, y, polarity)
    }));
    if outside {
        let wrong = |e: &Event| u32::from(e.x) >= width || u32::from(e.y) >= height;
        let index = out.iter().skip(before).position(wrong).unwrap_or(0);
        let e = out.get(before + index).copied().unwrap_or_default();
        out.truncate(before + index);
        return Err(format!(
            "event {index} of a packet, x {}, y {}, lies outside of {width}x{height}",
            e.x, e.y
        ));
    }
    Ok(())
}

fn frame(bytes: &[u8]) -> Result<Option<Frame>, String> {
    let table = root(bytes, Kind::Frames)?;
    let side = |index| u32::try_from(table.i16(index).unwrap_or(0)).unwrap_or(0);
    let (width, height) = (side(6), side(7));
    let channels = match table.u8(5).unwrap_or(0) {
        // OpenCV's numbers for 8 bits and 1, 3 or 4 channels.
        0 => 1,
        16 => 3,
        24 => 4,
        other => return Err(format!("a frame has pixels of type {other}, and only 0, 16 and 24 are read")),
    };
    let pixels = table.elements(10, 1).ok_or_else(|| broken(Kind::Frames))?;
    if pixels.len() as u64 != u64::from(width) * u64::from(height) * channels as u64 {
        let got = pixels.len();
        return Err(format!("a frame of {width}x{height} has {got} bytes of {channels} per pixel"));
    }
    let mut pixels = pixels.to_vec();
    swap_red_and_blue(&mut pixels, channels);
    let t = table.i64(0).unwrap_or(0);
    // Fields of newer files come last: the exposure's length where its ends are not given; negative is unknown.
    let known = |index| table.i64(index).filter(|t| *t >= 0);
    let start_us = known(3).or(known(1)).unwrap_or(t);
    let exposure = table.i64(11).filter(|length| *length > 0).map(|length| start_us.saturating_add(length));
    let end_us = known(4).or(exposure).or(known(2)).unwrap_or(start_us).max(start_us);
    Ok(Some(Frame { start_us, end_us, width, height, channels: channels as u8, pixels }))
}

/// The file's blue, green, red becomes red, green, blue, and the other way round.
pub(super) fn swap_red_and_blue(pixels: &mut [u8], channels: usize) {
    if channels >= 3 {
        pixels.chunks_exact_mut(channels).for_each(|pixel| pixel.swap(0, 2));
    }
}

fn imu(bytes: &[u8], out: &mut Vec<AedatImuSample>) -> Result<(), String> {
    let table = root(bytes, Kind::Imu)?;
    let samples = table.tables(0).ok_or_else(|| broken(Kind::Imu))?;
    for sample in samples {
        let sample = sample.ok_or_else(|| broken(Kind::Imu))?;
        let number = |index| sample.f32(index).unwrap_or(0.0);
        out.push(AedatImuSample {
            t: sample.i64(0).unwrap_or(0),
            temperature: number(1),
            acceleration: [number(2), number(3), number(4)],
            rotation: [number(5), number(6), number(7)],
            magnetic: [number(8), number(9), number(10)],
        });
    }
    Ok(())
}

/// Types of edges on the external input; other types tell of the camera's own frames.
pub(super) const RISING_EDGE: u8 = 1;
/// As [`RISING_EDGE`].
pub(super) const FALLING_EDGE: u8 = 2;

fn triggers(bytes: &[u8], out: &mut Vec<Trigger>) -> Result<(), String> {
    let table = root(bytes, Kind::Triggers)?;
    let edges = table.tables(0).ok_or_else(|| broken(Kind::Triggers))?;
    for edge in edges {
        let edge = edge.ok_or_else(|| broken(Kind::Triggers))?;
        let t = edge.i64(0).unwrap_or(0);
        match edge.u8(1).unwrap_or(0) {
            RISING_EDGE => out.push(Trigger::new(t, 0, true)),
            FALLING_EDGE => out.push(Trigger::new(t, 0, false)),
            _ => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::aedat::Aedat4Writer;
    use crate::write::{EventWriter, WriteOptions};

    /// The same file with packed packets.
    fn packed(plain: &[u8], compression: Compression, number: i32) -> Vec<u8> {
        let header = Header::parse(plain).unwrap();
        let mut out = plain[..header.length].to_vec();
        // The number is the only thing of four bytes and value 0 at its place; the builder says where.
        let table = &mut out[super::super::header::MAGIC.len()..];
        let field = super::super::flatbuffer::place_of(sized(table).unwrap(), b"IOHE", 0).unwrap() + 4;
        table[field..field + 4].copy_from_slice(&number.to_le_bytes());
        let mut at = header.length;
        while at < plain.len() {
            let size = u32_at(plain, at + 4).unwrap() as usize;
            let packet = compression.packed(&plain[at + 8..at + 8 + size]);
            out.extend(&plain[at..at + 4]);
            out.extend((packet.len() as i32).to_le_bytes());
            out.extend(packet);
            at += 8 + size;
        }
        out
    }

    #[test]
    fn packed_files_are_read() {
        let path = std::env::temp_dir().join(format!("evis-aedat-{}.aedat4", std::process::id()));
        let options = WriteOptions { size: (320, 240), overwrite: true };
        let mut writer = Box::new(Aedat4Writer::create(&path, &options).unwrap());
        let events: Vec<Event> =
            (0..5000).map(|k| Event::new(k * 7, (k % 320) as u16, (k % 240) as u16, Polarity::On)).collect();
        writer.write_events(&events).unwrap();
        writer.finish().unwrap();
        let plain = std::fs::read(&path).unwrap();
        for (compression, number) in [(Compression::Lz4, 1), (Compression::Lz4, 2), (Compression::Zstd, 3)] {
            let bytes = packed(&plain, compression, number);
            assert_ne!(bytes, plain);
            std::fs::write(&path, bytes).unwrap();
            let mut reader = Aedat4Reader::open(&path, &ReadOptions::default()).unwrap();
            assert_eq!(reader.compression, compression);
            let (mut packet, mut all) = (Packet::default(), Vec::new());
            while reader.read_packet(&mut packet).unwrap() {
                all.extend_from_slice(&packet.events);
            }
            assert_eq!(all, events);
        }
        std::fs::remove_file(&path).unwrap();
    }
}
