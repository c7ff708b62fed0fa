//! One pixel in one interval of the second pass: its signal.
//!
//! The stages add methods to [`Pixel`]. All but the triggers are `#[inline]`: each file is a unit of compilation of its own,
//! and the triggers' loops must be compiled with the small steps in them.

use super::memory::Chain;
use super::plan::Plan;
use crate::emulator::ideal::Tally;
use crate::emulator::order::Record;
use crate::emulator::shape::Shape;
use crate::event::Cause;
use crate::random::Key;

/// One pixel in one interval; times are microseconds since its start.
pub(super) struct Pixel<'a> {
    pub plan: &'a Plan,
    pub key: Key,
    pub chain: &'a mut Chain,
    pub index: usize,
    /// Index within the image.
    pub pixel: u32,
    pub place: (u32, u32),
    pub start_us: i64,
    pub us: u32,
    pub tally: &'a mut Tally,
    pub records: &'a mut Vec<Record>,
    /// Where they are asked for.
    pub causes: Option<&'a mut Vec<Cause>>,
}

impl Pixel<'_> {
    /// The signal's course in the interval.
    #[inline]
    pub(super) fn shape(&self) -> Shape {
        let i = self.index;
        let (now, next) = (&self.chain.now, &self.chain.next);
        let length = f64::from(self.us);
        let input = (f64::from(now.input[i]), f64::from(next.input[i]));
        if now.first.is_empty() {
            return Shape::line(input.0, input.1, length);
        }
        if !self.plan.exact {
            return Shape::line(now.output()[i].into(), next.output()[i].into(), length);
        }
        let tau = 1.0 / f64::from(self.filter_rate());
        let y = f64::from(now.first[i]);
        match now.second.get(i) {
            Some(z) => Shape::two_poles(input, length, tau, y, (*z).into()),
            None => Shape::pole(input, length, tau, y),
        }
    }

    /// Time constants per microsecond.
    #[inline]
    pub(super) fn filter_rate(&self) -> f32 {
        let (before, after) = (self.chain.now.light[self.index], self.chain.next.light[self.index]);
        let mean = 0.5 * (before + after) + self.plan.sensor.photoreceptor.dark_light;
        self.plan.rate * self.plan.bandwidth(mean)
    }

    #[inline]
    pub(super) fn light_at(&self, t: f64) -> f64 {
        let i = self.index;
        let (before, after) = (f64::from(self.chain.now.light[i]), f64::from(self.chain.next.light[i]));
        let part = if self.us > 0 { t / f64::from(self.us) } else { 1.0 };
        before + (after - before) * part
    }
}
