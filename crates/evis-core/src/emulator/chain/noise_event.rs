//! A candidate of noise, at its time.

use super::pixel::Pixel;
use crate::emulator::noise::{Candidate, REST_SHIFT};
use crate::event::{Cause, Polarity};
use crate::sensor::NoiseReference;

impl Pixel<'_> {
    /// What a candidate of noise becomes at its time.
    #[inline]
    pub(super) fn decide(&self, candidate: &Candidate) -> Option<(Polarity, Cause)> {
        let noise = &self.plan.sensor.noise;
        let settled = candidate.settle(noise, &self.chain.noise.rates(self.index));
        let light = || self.light_at((candidate.t_us - self.start_us) as f64) as f32;
        if settled.light_below < f32::INFINITY && light() >= settled.light_below {
            return None;
        }
        if settled.rest > 0
            && let Some(fired) = self.chain.fired.get(self.index)
            && candidate.t_us - self.chain.base_us - i64::from(*fired) < i64::from(settled.rest << REST_SHIFT)
        {
            return None;
        }
        let last = self.chain.polarity.get(self.index).copied();
        let polarity = match (settled.relative, last) {
            (Some(side), Some(last)) if last < 2 => {
                if (last == 1) != (side == Polarity::On) {
                    Polarity::On
                } else {
                    Polarity::Off
                }
            }
            _ => settled.polarity,
        };
        Some((polarity, settled.cause))
    }

    /// A candidate's turn; whether it fired.
    #[inline]
    pub(super) fn noise(&mut self, candidate: &Candidate, signal: f64) -> bool {
        let t = (candidate.t_us - self.start_us) as f64;
        let Some((polarity, cause)) = self.decide(candidate) else { return false };
        if self.is_refractory(t) {
            self.tally.suppressed += 1;
            return false;
        }
        self.emit(t, polarity, cause);
        if self.plan.sensor.noise.reference == NoiseReference::Signal {
            self.chain.reference[self.index] = signal as f32;
            self.moved_at(t);
        }
        true
    }
}
