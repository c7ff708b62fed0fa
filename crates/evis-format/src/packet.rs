//! What travels between files: events, and what some cameras record beside them.

use bytemuck::{Pod, Zeroable};
use evis_core::Event;

/// An edge of an external signal, laid out as Metavision's `EventExtTrigger` (24 bytes):
/// `p <i2 @0, t <i8 @8, id <i2 @16`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct Trigger {
    /// 1 for a rising edge, 0 for a falling one.
    pub p: i16,
    padding: [u16; 3],
    /// Microseconds.
    pub t: i64,
    /// Channel.
    pub id: i16,
    tail: [u16; 3],
}

impl Trigger {
    /// An edge on channel `id` at `t` microseconds: rising or falling.
    pub const fn new(t: i64, id: i16, rising: bool) -> Self {
        Self { p: rising as i16, padding: [0; 3], t, id, tail: [0; 3] }
    }
}

/// An image of a camera that records intensity beside events.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Start of the exposure, microseconds.
    pub start_us: i64,
    /// End of the exposure, microseconds; equal to the start where the exposure is not known.
    pub end_us: i64,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Values per pixel: 1 (grey), 3 (red, green, blue) or 4 (with alpha).
    pub channels: u8,
    /// 8-bit values, row-major from the top-left pixel, channels innermost.
    pub pixels: Vec<u8>,
}

/// A sample of an inertial unit, in the units of AEDAT4.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AedatImuSample {
    /// Microseconds.
    pub t: i64,
    /// Degrees Celsius.
    pub temperature: f32,
    /// Acceleration along x, y and z, in g.
    pub acceleration: [f32; 3],
    /// Rotation about x, y and z, in degrees per second.
    pub rotation: [f32; 3],
    /// Magnetic field along x, y and z, in microtesla.
    pub magnetic: [f32; 3],
}

/// A part of a stream. Each of the four lists is in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packet {
    /// Events.
    pub events: Vec<Event>,
    /// Edges of external signals.
    pub triggers: Vec<Trigger>,
    /// Images.
    pub frames: Vec<Frame>,
    /// Inertial samples.
    pub imu: Vec<AedatImuSample>,
}

impl Packet {
    /// Empties it; memory is kept.
    pub fn clear(&mut self) {
        self.events.clear();
        self.triggers.clear();
        self.frames.clear();
        self.imu.clear();
    }

    /// Whether it holds nothing.
    pub fn is_empty(&self) -> bool {
        self.events.is_empty() && self.triggers.is_empty() && self.frames.is_empty() && self.imu.is_empty()
    }

    /// Keeps what lies in `[start_us, end_us)`; an image lies where its exposure starts.
    pub fn retain_between(&mut self, start_us: i64, end_us: i64) {
        let within = |t: i64| start_us <= t && t < end_us;
        if self.events.iter().any(|event| !within(event.t)) {
            self.events.retain(|event| within(event.t));
        }
        self.triggers.retain(|trigger| within(trigger.t));
        self.frames.retain(|frame| within(frame.start_us));
        self.imu.retain(|sample| within(sample.t));
    }

    /// Earliest and latest time of what it holds.
    pub fn range(&self) -> Option<(i64, i64)> {
        let times = self.triggers.iter().map(|trigger| trigger.t);
        let times = times.chain(self.frames.iter().map(|frame| frame.start_us));
        let times = times.chain(self.imu.iter().map(|sample| sample.t));
        let events = self.events.iter().map(|event| event.t);
        times.chain(events).fold(None, |range, t| match range {
            None => Some((t, t)),
            Some((first, last)) => Some((t.min(first), t.max(last))),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triggers_have_the_metavision_layout() {
        use std::mem::offset_of;
        assert_eq!(size_of::<Trigger>(), 24);
        assert_eq!((offset_of!(Trigger, p), offset_of!(Trigger, t), offset_of!(Trigger, id)), (0, 8, 16));
    }
}
