//! What representations are made of: events, their sensor's size and an interval. Events are checked while they are read.

use evis_core::Event;
use evis_core::event::MOST_T_US;

use crate::error::Error;

/// Events that are checked before any of them is used: 16 kB, which stay in the nearest cache.
const BLOCK: usize = 1024;

/// Most pixels of a side.
const MOST_SIDE: u32 = 65_536;

/// Most events: pixels count them in 31 bits.
const MOST_EVENTS: usize = i32::MAX as usize;

/// Events of one sensor, sorted by time, and the interval that they are seen in.
#[derive(Clone, Copy, Debug)]
pub struct Slice<'a> {
    events: &'a [Event],
    size: (u32, u32),
    /// How many events lie before these in what [`Slice::new`] was given.
    offset: usize,
    limits: (Option<i64>, Option<i64>),
}

impl<'a> Slice<'a> {
    /// All of `events`, of a sensor of `size` pixels, width and height.
    ///
    /// # Errors
    /// A side that is not between 1 and 65536 pixels, more than 2^31 - 1 events. Events are checked when they are read.
    pub fn new(events: &'a [Event], size: (u32, u32)) -> Result<Self, Error> {
        for (what, side) in [("width", size.0), ("height", size.1)] {
            if !(1..=MOST_SIDE).contains(&side) {
                return Err(Error::setting(what, side, format!("between 1 and {MOST_SIDE} pixels")));
            }
        }
        if events.len() > MOST_EVENTS {
            let remedy = format!("at most {MOST_EVENTS} at once, in windows of time");
            return Err(Error::setting("the number of events", events.len(), remedy));
        }
        Ok(Self { events, size, offset: 0, limits: (None, None) })
    }

    /// What is in `[start_us, end_us)`; without a limit where none is given.
    ///
    /// # Errors
    /// Events that are not sorted by time, an interval without a microsecond, a limit too far from 0.
    pub fn between(self, start_us: Option<i64>, end_us: Option<i64>) -> Result<Self, Error> {
        if !self.events.is_sorted_by_key(|event| event.t) {
            self.check()?;
        }
        self.between_sorted(start_us, end_us)
    }

    /// [`Slice::between`] for events that are known to be sorted by time: a search, and no look at every one.
    ///
    /// # Errors
    /// An interval without a microsecond, a limit too far from 0.
    pub fn between_sorted(self, start_us: Option<i64>, end_us: Option<i64>) -> Result<Self, Error> {
        for (what, limit) in [("start_us", start_us), ("end_us", end_us)] {
            if let Some(limit) = limit.filter(|limit| limit.unsigned_abs() > MOST_T_US.unsigned_abs()) {
                return Err(Error::setting(what, limit, format!("within {MOST_T_US} us of 0")));
            }
        }
        if let (Some(start), Some(end)) = (start_us, end_us)
            && end <= start
        {
            return Err(Error::setting("end_us", end, format!("after start_us, which is {start}")));
        }
        let from = start_us.map_or(0, |start| self.events.partition_point(|event| event.t < start));
        let to = end_us.map_or(self.events.len(), |end| self.events.partition_point(|event| event.t < end));
        let events = &self.events[from..to.max(from)];
        Ok(Self { events, offset: self.offset + from, limits: (start_us, end_us), ..self })
    }

    /// Pixels per row.
    pub(crate) const fn width(&self) -> usize {
        self.size.0 as usize
    }

    /// Rows.
    pub(crate) const fn height(&self) -> usize {
        self.size.1 as usize
    }

    /// Pixels of the sensor.
    pub(crate) const fn pixels(&self) -> usize {
        self.width() * self.height()
    }

    /// How many events there are.
    pub(crate) const fn len(&self) -> usize {
        self.events.len()
    }

    /// Times that become 0 and 1: the limits that were given, else the first and the last event's.
    pub(crate) fn span(&self) -> Result<(i64, i64), Error> {
        let (start, end) = self.limits;
        let (Some(first), Some(last)) = (self.events.first(), self.events.last()) else {
            let start = start.or(end).unwrap_or(0);
            return Ok((start, end.unwrap_or(start)));
        };
        if first.t < -MOST_T_US || last.t > MOST_T_US || first.t > last.t {
            self.check()?;
        }
        Ok((start.unwrap_or(first.t), end.unwrap_or(last.t)))
    }

    /// The interval `[start, end)`: the limits that were given, else from the first event to just after the last one.
    pub(crate) fn interval(&self) -> Result<(i64, i64), Error> {
        let (start, end) = self.span()?;
        Ok((start, if self.limits.1.is_some() { end } else { end + 1 }))
    }

    /// Hands out all events, block by block, in order. Those of a block are within the sensor, of a polarity, and neither
    /// before any that were handed out nor after the last one.
    pub(crate) fn blocks(&self, mut use_block: impl FnMut(&'a [Event])) -> Result<(), Error> {
        let (width, height) = self.size;
        let mut before = -MOST_T_US;
        let last = self.events.last().map_or(0, |event| event.t).min(MOST_T_US);
        for block in self.events.chunks(BLOCK) {
            // Largest x, y and p + 1, in the first places; no branch, and all places in one register.
            let (mut most, mut goes_back) = ([0_u16; 8], false);
            for (event, halves) in block.iter().zip(bytemuck::cast_slice::<Event, [u16; 8]>(block)) {
                for ((most, half), more) in most.iter_mut().zip(halves).zip([0, 0, 1, 0, 0, 0, 0, 0]) {
                    *most = (*most).max(half.wrapping_add(more));
                }
                goes_back |= event.t < before;
                before = event.t;
            }
            let outside = u32::from(most[0]) >= width || u32::from(most[1]) >= height;
            let wrong = outside || most[2] > 2 || goes_back || before > last;
            if wrong {
                self.check()?;
            }
            use_block(block);
        }
        Ok(())
    }

    /// Finds the first event that cannot be used.
    #[cold]
    fn check(&self) -> Result<(), Error> {
        let mut before_us = None;
        for (index, event) in self.events.iter().enumerate() {
            let index = index + self.offset;
            if event.t.unsigned_abs() > MOST_T_US.unsigned_abs() {
                return Err(Error::Time { index, t_us: event.t });
            }
            if let Some(before_us) = before_us.filter(|before| event.t < *before) {
                return Err(Error::Unsorted { index, t_us: event.t, before_us });
            }
            if u32::from(event.x) >= self.size.0 || u32::from(event.y) >= self.size.1 {
                return Err(Error::OutsideSensor { index, x: event.x, y: event.y, size: self.size });
            }
            if !(-1..=1).contains(&event.p) {
                return Err(Error::Polarity { index, polarity: event.p });
            }
            before_us = Some(event.t);
        }
        Ok(())
    }
}

/// The plane of an event that was handed out: 1 for ON, 0 for OFF. Polarities are random, and a branch on them is guessed wrong
/// half of the time; the compiler makes one of a comparison, and cannot of this arithmetic.
#[inline(always)]
pub(crate) fn plane(event: &Event) -> usize {
    usize::from(event.p.wrapping_add(1) as u16 >> 1)
}

/// A part of time from 0 at the start of a span to 1 at its end, times `steps`.
pub(crate) struct Clock {
    start_us: i64,
    span_us: f64,
    steps: f64,
}

impl Clock {
    /// Over `slice`, whose events may all be of one time: then it stands at 0.
    pub(crate) fn new(slice: &Slice<'_>, steps: usize) -> Result<Self, Error> {
        let (start_us, end_us) = slice.span()?;
        Ok(Self { start_us, span_us: (end_us - start_us).max(1) as f64, steps: steps as f64 })
    }

    /// What it shows at `t_us`, which lies in the span: 0 to `steps`.
    #[inline]
    pub(crate) fn at(&self, t_us: i64) -> f64 {
        // Multiplied first, so that it is exact at the end.
        (t_us - self.start_us) as f64 * self.steps / self.span_us
    }
}

#[cfg(test)]
mod tests {
    use evis_core::Polarity;

    use super::*;

    #[test]
    fn planes_are_those_of_polarities() {
        let plane_of = |p| {
            let mut event = Event::new(0, 0, 0, Polarity::Off);
            event.p = p;
            plane(&event)
        };
        assert_eq!([-1, 0, 1].map(plane_of), [0, 0, 1]);
    }
}
