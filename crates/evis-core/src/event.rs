//! The event record and operations on sorted slices of it.

use bytemuck::{Pod, Zeroable};

/// Times of events lie within this many microseconds of 0: 142 years. Differences and sums of a few times cannot overflow,
/// and are exact as `f64`.
pub const MOST_T_US: i64 = 1 << 52;

/// Sign of a brightness change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Polarity {
    /// Brightness fell.
    Off,
    /// Brightness rose.
    On,
}

impl Polarity {
    /// The value that files and arrays carry: ON = 1, OFF = 0.
    pub const fn as_i16(self) -> i16 {
        match self {
            Self::Off => 0,
            Self::On => 1,
        }
    }
}

/// Why an event fired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Cause {
    /// The scene's light.
    #[default]
    Signal = 0,
    /// The pixel's leak: at random times, or a ramp that had at least half a part in reaching the threshold.
    Leak = 1,
    /// Shot noise.
    Shot = 2,
    /// A hot pixel.
    Hot = 3,
}

impl Cause {
    /// All of them, by number.
    pub const ALL: [Self; 4] = [Self::Signal, Self::Leak, Self::Shot, Self::Hot];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Signal => "signal",
            Self::Leak => "leak",
            Self::Shot => "shot",
            Self::Hot => "hot",
        }
    }
}

/// One event, laid out as Metavision's `EventCD` (16 bytes): `x <u2 @0, y <u2 @2, p <i2 @4, t <i8 @8`.
///
/// The two bytes after `p` are always zero, so equal streams are equal as bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct Event {
    /// Column, from the left.
    pub x: u16,
    /// Row, from the top.
    pub y: u16,
    /// Polarity: ON = 1, OFF = 0.
    pub p: i16,
    /// Zero in every stream; while an event is on its way, its cause where that is asked for.
    mark: u16,
    /// Microseconds since the stream's start.
    pub t: i64,
}

impl Event {
    /// An event at pixel (`x`, `y`) and time `t` in microseconds.
    pub const fn new(t: i64, x: u16, y: u16, polarity: Polarity) -> Self {
        Self { x, y, p: polarity.as_i16(), mark: 0, t }
    }

    /// The same event, marked with its cause; see [`take_causes`].
    #[must_use]
    pub const fn with_cause(self, cause: Cause) -> Self {
        Self { mark: cause as u16, ..self }
    }

    /// Whether its mark is the number of a cause.
    pub(crate) const fn has_cause(&self) -> bool {
        (self.mark as usize) < Cause::ALL.len()
    }

    /// The canonical order within a stream: time, then row, then column. Events of one pixel at one
    /// microsecond keep their firing order (sort stably).
    pub const fn order(&self) -> (i64, u16, u16) {
        (self.t, self.y, self.x)
    }
}

/// Takes the marks off `events`: the number of each one's [`Cause`], in their order.
pub fn take_causes(events: &mut [Event]) -> Vec<u8> {
    events.iter_mut().map(|event| std::mem::take(&mut event.mark) as u8).collect()
}

/// The part of time-sorted `events` with `start_us <= t < end_us`, without a copy.
pub fn slice_time(events: &[Event], start_us: i64, end_us: i64) -> &[Event] {
    let from = events.partition_point(|e| e.t < start_us);
    let to = events.partition_point(|e| e.t < end_us).max(from);
    &events[from..to]
}

/// Whether `events` are in canonical order.
pub fn is_ordered(events: &[Event]) -> bool {
    events.is_sorted_by_key(Event::order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn event_has_the_metavision_layout() {
        use std::mem::offset_of;
        assert_eq!(size_of::<Event>(), 16);
        assert_eq!(
            (offset_of!(Event, x), offset_of!(Event, y), offset_of!(Event, p), offset_of!(Event, t)),
            (0, 2, 4, 8)
        );
    }

    #[test]
    fn slices_are_half_open() {
        let events: Vec<_> = (0..10).map(|t| Event::new(t, 0, 0, Polarity::On)).collect();
        let got: Vec<_> = slice_time(&events, 3, 6).iter().map(|e| e.t).collect();
        assert_eq!(got, [3, 4, 5]);
        assert!(slice_time(&events, 6, 3).is_empty());
        assert!(is_ordered(&events));
        let mut swapped = events.clone();
        swapped.swap(2, 3);
        assert!(!is_ordered(&swapped), "canary: a swapped pair must be seen");
    }
}
