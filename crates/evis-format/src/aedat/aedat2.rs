//! Writing AEDAT 2.0, jAER's format: big-endian pairs of an address and a time.
//!
//! Bits of the address: iniVation's description of AEDAT 2.0, and jAER's chip classes (`Davis346`,
//! `Davis240`, `DVS640`, `DVS128`). jAER counts rows from the bottom and, on these chips, columns from the
//! right, as v2e's `aedat2_output.py` has it too.

use std::path::Path;

use evis_core::Event;
use evis_core::format::FormatError;

use crate::check::Check;
use crate::files::Output;
use crate::format::Format;
use crate::packet::Packet;
use crate::write::{EventWriter, WriteOptions};

/// Where column, row and polarity lie in an address.
#[derive(Clone, Copy)]
struct Chip {
    x_shift: u32,
    y_shift: u32,
    on_shift: u32,
    /// jAER's class.
    class: &'static str,
}

impl Chip {
    const fn of(size: (u32, u32)) -> Option<Self> {
        match size {
            (346, 260) => Some(Self::davis("eu.seebetter.ini.chips.davis.Davis346blue")),
            (240, 180) => Some(Self::davis("eu.seebetter.ini.chips.davis.DAVIS240C")),
            (640, 480) => {
                let class = "ch.unizh.ini.jaer.chip.retina.DVS640";
                Some(Self { x_shift: 1, y_shift: 11, on_shift: 0, class })
            }
            _ => None,
        }
    }

    const fn davis(class: &'static str) -> Self {
        Self { x_shift: 12, y_shift: 22, on_shift: 11, class }
    }
}

/// The bit of DAVIS chips for an edge on the external input.
const EXTERNAL_EDGE: u64 = 1 << 10;

/// Writes AEDAT 2.0 files.
pub(crate) struct Aedat2Writer {
    output: Output,
    check: Check,
    chip: Chip,
    size: (u32, u32),
    rows: Vec<u8>,
    begun: bool,
}

impl Aedat2Writer {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let (width, height) = options.size;
        let chip = Chip::of(options.size).ok_or_else(|| {
            FormatError::invalid(
                path,
                format!("AEDAT 2.0 has no chip of {width}x{height}"),
                "crop to 240x180, 346x260 or 640x480, or choose another format, such as .aedat4",
            )
        })?;
        let mut output = Output::create(path, options.overwrite)?;
        let header = format!(
            "#!AER-DAT2.0\r\n\
             # This is a raw AE data file - do not edit\r\n\
             # Data format is int32 address, int32 timestamp (8 bytes total), repeated for each event\r\n\
             # Timestamps tick is 1 us\r\n\
             # AEChip: {}\r\n",
            chip.class
        );
        output.write(header.as_bytes())?;
        let check = Check::new(path, Format::Aedat2, options.size, (0, i32::MAX.into()), -1);
        Ok(Self { output, check, chip, size: options.size, rows: Vec::new(), begun: false })
    }
}

impl EventWriter for Aedat2Writer {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.only_events(packet)?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        let Chip { x_shift, y_shift, on_shift, .. } = self.chip;
        if let (Some(first), false) = (events.first(), self.begun) {
            self.begun = true;
            // A first event whose address starts with '#' would be taken for a line of the header. An edge on
            // the external input, which this bit means, goes before it.
            if (self.size.1 - 1 - u32::from(first.y)) << y_shift >> 24 == u32::from(b'#') {
                self.output.write(&(EXTERNAL_EDGE << 32 | first.t as u64).to_be_bytes())?;
            }
        }
        for part in events.chunks(1 << 14) {
            self.rows.clear();
            self.rows.extend(part.iter().flat_map(|e| {
                let (x, y) = (self.size.0 - 1 - u32::from(e.x), self.size.1 - 1 - u32::from(e.y));
                let address = x << x_shift | y << y_shift | (e.p as u32) << on_shift;
                (u64::from(address) << 32 | e.t as u64).to_be_bytes()
            }));
            self.output.write(&self.rows)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        self.output.finish()
    }
}
