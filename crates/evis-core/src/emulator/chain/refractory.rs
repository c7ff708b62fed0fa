//! Refractory period: when a pixel may fire again, and how one that is held goes on.

use super::pixel::Pixel;
use crate::emulator::shape::Piece;

impl Pixel<'_> {
    /// When the pixel last fired, since the interval's start; long ago without a refractory period.
    #[inline]
    pub(super) fn fired(&self) -> f64 {
        match self.chain.fired.get(self.index) {
            Some(fired) if self.plan.sensor.refractory.period_us > 0 => {
                (i64::from(*fired) + self.chain.base_us - self.start_us) as f64
            }
            _ => f64::NEG_INFINITY,
        }
    }

    #[inline]
    pub(super) fn period(&self) -> f64 {
        self.plan.sensor.refractory.period_us.into()
    }

    /// Whether an event at `t` is within the refractory period.
    #[inline]
    pub(super) fn is_refractory(&self, t: f64) -> bool {
        t - self.fired() < self.period()
    }

    /// Holds the pixel for its refractory period; when it is released, if that is before `end`.
    #[inline]
    pub(super) fn held(&mut self, piece: &Piece, end: f64) -> Option<f64> {
        let released = self.fired() + self.period();
        if released > end {
            self.chain.reference[self.index] = f32::INFINITY;
            return None;
        }
        let released = released.max(0.0);
        self.chain.reference[self.index] = piece.at(released) as f32;
        self.moved_at(released);
        Some(released)
    }
}
