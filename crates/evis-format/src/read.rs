//! Reading: one trait, and what works with every reader.

use evis_core::format::FormatError;

use crate::format::Format;
use crate::packet::Packet;

/// What a file says about its stream.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamInfo {
    /// The format.
    pub format: Format,
    /// Pixels per row, and rows, where the file says.
    pub size: Option<(u32, u32)>,
    /// Names of all cameras of the file, or of its streams of events; none where it has one without a name.
    pub cameras: Vec<String>,
    /// The camera that is read.
    pub camera: Option<String>,
    /// Absolute time of the stream's zero in microseconds, where the file keeps it apart from the times.
    pub t_offset_us: i64,
    /// Number of events where the file says it without being read.
    pub events: Option<u64>,
    /// More that the file says, as names and values: serial number, generation, source.
    pub properties: Vec<(String, String)>,
}

impl StreamInfo {
    pub(crate) const fn new(format: Format) -> Self {
        Self {
            format,
            size: None,
            cameras: Vec::new(),
            camera: None,
            t_offset_us: 0,
            events: None,
            properties: Vec::new(),
        }
    }
}

/// Reads a file packet by packet, in constant memory.
pub trait EventReader: Send {
    /// What the file says about its stream.
    fn info(&self) -> &StreamInfo;

    /// Replaces what `packet` holds by the next part of the stream; `false` at its end. A packet may be
    /// empty. Of a damaged file everything before the damage comes first, and then the error.
    ///
    /// # Errors
    /// A file that cannot be read or is damaged; the message names the byte.
    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError>;

    /// The part of the file that has been read, 0 to 1, where it is known.
    fn part(&self) -> Option<f64> {
        None
    }

    /// Moves, back or forth, so that the packets to come hold everything at `t_us` and later. They may
    /// begin with what is somewhat earlier; [`Between`] takes that away.
    ///
    /// # Errors
    /// As [`EventReader::read_packet`].
    fn seek(&mut self, t_us: i64) -> Result<(), FormatError>;
}

/// How a file is read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// The camera, where a file holds several.
    pub camera: Option<String>,
    /// Pixels per row, and rows, for files that do not say.
    pub size: Option<(u32, u32)>,
}

/// How long images may follow behind events in one file, microseconds.
const LAG_US: i64 = 1_000_000;

/// The part of a stream with `start_us <= t < end_us`.
pub struct Between<R> {
    reader: R,
    start_us: i64,
    end_us: i64,
    done: bool,
}

impl<R: EventReader> Between<R> {
    /// Moves `reader` to `start_us`.
    ///
    /// # Errors
    /// As [`EventReader::seek`].
    pub fn new(mut reader: R, start_us: i64, end_us: i64) -> Result<Self, FormatError> {
        if start_us > i64::MIN {
            reader.seek(start_us)?;
        }
        Ok(Self { reader, start_us, end_us, done: false })
    }
}

impl EventReader for Box<dyn EventReader> {
    fn info(&self) -> &StreamInfo {
        (**self).info()
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        (**self).read_packet(packet)
    }

    fn part(&self) -> Option<f64> {
        (**self).part()
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        (**self).seek(t_us)
    }
}

impl<R: EventReader> EventReader for Between<R> {
    fn info(&self) -> &StreamInfo {
        self.reader.info()
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if self.done || !self.reader.read_packet(packet)? {
            return Ok(false);
        }
        let lag_us = if matches!(self.info().format, Format::Aedat4 | Format::Mcap) { LAG_US } else { 0 };
        let past_us = self.end_us.saturating_add(lag_us);
        self.done = packet.events.first().is_some_and(|event| event.t >= past_us);
        packet.retain_between(self.start_us, self.end_us);
        Ok(!self.done)
    }

    fn part(&self) -> Option<f64> {
        self.reader.part()
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        self.done = false;
        self.reader.seek(t_us.max(self.start_us))
    }
}

/// Counts of a whole stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    /// Events.
    pub events: u64,
    /// ON events.
    pub on: u64,
    /// Triggers.
    pub triggers: u64,
    /// Images.
    pub frames: u64,
    /// Inertial samples.
    pub imu: u64,
    /// Times of the first and the last event, microseconds.
    pub range: Option<(i64, i64)>,
    /// Largest x and y, each plus one.
    pub reach: (u32, u32),
}

impl Extent {
    /// Counts what the next packet of the stream holds.
    pub fn add(&mut self, packet: &Packet) {
        let (mut x, mut y, mut on) = (0, 0, 0);
        for e in &packet.events {
            x = e.x.max(x);
            y = e.y.max(y);
            on += u64::from(e.p == 1);
        }
        if let (Some(first), Some(last)) = (packet.events.first(), packet.events.last()) {
            self.reach = (self.reach.0.max(u32::from(x) + 1), self.reach.1.max(u32::from(y) + 1));
            self.range = Some((self.range.map_or(first.t, |range| range.0), last.t));
        }
        self.on += on;
        self.events += packet.events.len() as u64;
        self.triggers += packet.triggers.len() as u64;
        self.frames += packet.frames.len() as u64;
        self.imu += packet.imu.len() as u64;
    }
}

/// Reads `reader` to its end and counts.
///
/// # Errors
/// As [`EventReader::read_packet`].
pub fn measure(reader: &mut dyn EventReader) -> Result<Extent, FormatError> {
    let mut extent = Extent::default();
    let mut packet = Packet::default();
    while reader.read_packet(&mut packet)? {
        extent.add(&packet);
    }
    Ok(extent)
}
