//! Writing AEDAT 4.0: without compression and without a table of packets, which every reader takes.

use std::path::Path;

use evis_core::Event;
use evis_core::format::FormatError;

use super::flatbuffer::Builder;
use super::header::{self, Kind};
use super::reader::{FALLING_EDGE, RISING_EDGE, swap_red_and_blue};
use crate::check::Check;
use crate::files::Output;
use crate::format::Format;
use crate::packet::{AedatImuSample, Frame, Packet, Trigger};
use crate::write::{EventWriter, WriteOptions};

/// Events per packet of the file.
const EVENTS_PER_PACKET: usize = 8192;
/// Inertial samples and triggers per packet of the file.
const ROWS_PER_PACKET: usize = 1024;

/// Writes AEDAT 4.0 files.
pub(crate) struct Aedat4Writer {
    output: Output,
    check: Check,
    elements: Vec<u8>,
}

impl Aedat4Writer {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let mut output = Output::create(path, options.overwrite)?;
        // Streams that stay empty disturb no reader, and what comes is not known yet.
        output.write(&header::build(options.size, &[true; 4]))?;
        let check = Check::new(path, Format::Aedat4, options.size, (0, i64::MAX), 0);
        Ok(Self { output, check, elements: Vec::new() })
    }

    fn packet(&mut self, id: i32, bytes: &[u8]) -> Result<(), FormatError> {
        let mut head = [0; 8];
        head[..4].copy_from_slice(&id.to_le_bytes());
        head[4..].copy_from_slice(&(bytes.len() as i32).to_le_bytes());
        self.output.write(&head)?;
        self.output.write(bytes)
    }

    fn put_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        for part in events.chunks(EVENTS_PER_PACKET) {
            self.elements.clear();
            self.elements.extend(part.iter().flat_map(|e| {
                let place = u64::from(e.x) | u64::from(e.y) << 16 | (e.p as u64) << 32;
                (u128::from(e.t as u64) | u128::from(place) << 64).to_le_bytes()
            }));
            let (mut builder, places) = Builder::new(Vec::new(), Kind::Events.identifier(), &[4]);
            if let Some(place) = places.first() {
                builder.vector(*place, part.len(), 8, &self.elements);
            }
            self.packet(0, &builder.finish())?;
        }
        Ok(())
    }

    fn put_frame(&mut self, frame: &Frame) -> Result<(), FormatError> {
        // Times, type, width, height, place, pixels, length of the exposure, source.
        let fields = [8, 8, 8, 8, 8, 1, 2, 2, 2, 2, 4, 8, 1];
        let (mut builder, places) = Builder::new(Vec::new(), Kind::Frames.identifier(), &fields);
        let Frame { start_us, end_us, width, height, channels, .. } = *frame;
        let mut pixels = frame.pixels.clone();
        swap_red_and_blue(&mut pixels, channels.into());
        let kind = match channels {
            1 => 0_u8,
            3 => 16,
            _ => 24,
        };
        let times = [start_us, start_us, end_us, start_us, end_us];
        for (place, t) in places.iter().zip(times) {
            builder.put(*place, &t.to_le_bytes());
        }
        if let [.., kind_at, width_at, height_at, _, _, pixels_at, exposure_at, _] = places.as_slice() {
            builder.put(*kind_at, &[kind]);
            builder.put(*width_at, &(width as i16).to_le_bytes());
            builder.put(*height_at, &(height as i16).to_le_bytes());
            builder.put(*exposure_at, &(end_us - start_us).to_le_bytes());
            builder.vector(*pixels_at, pixels.len(), 4, &pixels);
        }
        self.packet(1, &builder.finish())
    }

    fn put_imu(&mut self, samples: &[AedatImuSample]) -> Result<(), FormatError> {
        self.put_tables(2, Kind::Imu, samples, &[8, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4], |sample| {
            let numbers = [sample.temperature].into_iter();
            let numbers = numbers.chain(sample.acceleration).chain(sample.rotation).chain(sample.magnetic);
            let mut fields = vec![sample.t.to_le_bytes().to_vec()];
            fields.extend(numbers.map(|number| number.to_le_bytes().to_vec()));
            fields
        })
    }

    fn put_triggers(&mut self, triggers: &[Trigger]) -> Result<(), FormatError> {
        self.put_tables(3, Kind::Triggers, triggers, &[8, 1], |trigger| {
            let kind = if trigger.p == 1 { RISING_EDGE } else { FALLING_EDGE };
            vec![trigger.t.to_le_bytes().to_vec(), vec![kind]]
        })
    }

    fn put_tables<T>(
        &mut self,
        id: i32,
        kind: Kind,
        rows: &[T],
        sizes: &[usize],
        fields: impl Fn(&T) -> Vec<Vec<u8>>,
    ) -> Result<(), FormatError> {
        for part in rows.chunks(ROWS_PER_PACKET) {
            let (mut builder, places) = Builder::new(Vec::new(), kind.identifier(), &[4]);
            let Some(place) = places.first() else { return Ok(()) };
            let offsets = builder.offsets(*place, part.len());
            for (offset, row) in offsets.into_iter().zip(part) {
                let (at, places) = builder.table(sizes);
                for (place, bytes) in places.into_iter().zip(fields(row)) {
                    builder.put(place, &bytes);
                }
                builder.point_to_table(offset, at);
            }
            self.packet(id, &builder.finish())?;
        }
        Ok(())
    }

    fn check_frame(&self, frame: &Frame) -> Result<(), FormatError> {
        let Frame { start_us, end_us, width, height, channels, ref pixels } = *frame;
        let size = u64::from(width) * u64::from(height) * u64::from(channels);
        let fits = matches!(channels, 1 | 3 | 4) && width < 1 << 15 && height < 1 << 15;
        if fits && pixels.len() as u64 == size && size <= 1 << 27 && 0 <= start_us && start_us <= end_us {
            return Ok(());
        }
        let got = pixels.len();
        Err(FormatError::invalid(
            self.output.path(),
            format!(
                "a frame of {width}x{height}, {channels} channels, {got} bytes, from {start_us} to {end_us} us does not fit"
            ),
            "AEDAT 4.0 holds 1, 3 or 4 channels of 8 bits, 32767x32767 pixels, and times from 0 on",
        ))
    }
}

impl EventWriter for Aedat4Writer {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        packet.frames.iter().try_for_each(|frame| self.check_frame(frame))?;
        self.check.triggers(&packet.triggers)?;
        self.check.events(&packet.events)?;
        self.put_events(&packet.events)?;
        packet.frames.iter().try_for_each(|frame| self.put_frame(frame))?;
        self.put_imu(&packet.imu)?;
        self.put_triggers(&packet.triggers)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        self.put_events(events)
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        self.output.finish()
    }
}
