//! Leak: a ramp that is added to the signal, since the reference last moved.

use super::memory::Chain;
use super::pixel::Pixel;
use super::plan::Plan;
use crate::emulator::frames::BLOCK;
use crate::emulator::numbering::Numbering;
use crate::event::Cause;
use crate::random::{EPOCH_SHIFT, Key, StreamId};
use crate::simd::{Isa, dispatched};

impl Pixel<'_> {
    /// Notes that the reference moved at `t`; draws the leak's slope again.
    #[inline]
    pub(super) fn moved_at(&mut self, t: f64) {
        if !self.plan.ramp {
            return;
        }
        let i = self.index;
        let t_us = self.start_us + t as i64;
        self.chain.moved[i] = (t_us - self.chain.base_us) as i32;
        let jitter = self.plan.sensor.noise.leak_jitter;
        if jitter > 0.0 {
            // The time to the next event is drawn, not the slope, so that the mean rate stays.
            self.chain.slope[i] = self.chain.steady[i] / jitter_at(self.key, self.pixel, t_us, jitter);
        }
    }

    /// Notes that the reference moved at the interval's end, the last that happens to the pixel in it.
    #[inline]
    pub(super) fn moved_at_end(&mut self) {
        if !self.plan.ramp {
            return;
        }
        let i = self.index;
        let end_us = self.start_us + i64::from(self.us);
        self.chain.moved[i] = (end_us - self.chain.base_us) as i32;
        if self.plan.sensor.noise.leak_jitter > 0.0 {
            self.chain.moved_last.push(i as u32);
        }
    }

    /// Slope of the leak now, per microsecond.
    #[inline]
    pub(super) fn slope(&self) -> f64 {
        if self.plan.ramp { self.chain.slope[self.index].into() } else { 0.0 }
    }

    /// What the leak has added to the signal at the interval's start, less than nothing where the reference moved later.
    #[inline]
    pub(super) fn leaked_at_start(&self) -> f64 {
        if !self.plan.ramp {
            return 0.0;
        }
        let moved = i64::from(self.chain.moved[self.index]) + self.chain.base_us - self.start_us;
        -self.slope() * moved as f64
    }
}

impl Chain {
    /// Draws the slopes of the pixels whose reference moved at `t_us`, the interval's end.
    pub(super) fn draw_slopes(&mut self, isa: Isa, plan: &Plan, key: Key, numbering: Numbering, t_us: i64) {
        let Self { moved_last, slope, steady, .. } = self;
        let (mut pixels, mut factors) = ([0; BLOCK], [0.0; BLOCK]);
        for part in moved_last.chunks(BLOCK) {
            for (number, pixel) in pixels.iter_mut().zip(part) {
                *number = numbering.of(*pixel);
            }
            jitters_by(isa, key, &pixels, t_us, plan.sensor.noise.leak_jitter, &mut factors);
            for (pixel, factor) in part.iter().zip(&factors) {
                let i = *pixel as usize;
                slope[i] = steady[i] / factor;
            }
        }
        moved_last.clear();
    }
}

/// [`jitter_at`] of many pixels.
#[inline(always)]
fn jitters(key: Key, pixels: &[u32; BLOCK], t_us: i64, jitter: f32, out: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        out[i] = jitter_at(key, pixels[i], t_us, jitter);
    }
}
dispatched!(
    fn jitters_by(
        key: Key,
        pixels: &[u32; BLOCK],
        t_us: i64,
        jitter: f32,
        out: &mut [f32; BLOCK],
    ) = jitters
);

/// Why a threshold was reached: by a rise of which the leak's ramp is at least half, or by light. Twin: `cause_of` in
/// `shaders/chain/pixel.wgsl`.
#[inline]
pub(super) fn cause_of(rises: bool, leaked: f64, rise: f64) -> Cause {
    if rises && leaked >= 0.5 * rise && leaked > 0.0 { Cause::Leak } else { Cause::Signal }
}

/// A leak's jitter is drawn for each pixel and 2^12 microseconds: two computations whose times differ by a rounding
/// nearly always draw the same.
pub const JITTER_SHIFT: u32 = 12;

/// Share of the mean time that the next leak event takes: nearly normal, the sum of four uniform draws, so that neither
/// end is far away and a move of the reference costs no logarithm. Twin: `jitter_at` in `shaders/chain/leak.wgsl`.
#[inline(always)]
fn jitter_at(key: Key, pixel: u32, t_us: i64, jitter: f32) -> f32 {
    let draw = (t_us >> JITTER_SHIFT) as u32 & ((1 << (EPOCH_SHIFT - JITTER_SHIFT)) - 1);
    let words = key.draw(pixel, StreamId::LeakJitter, t_us >> EPOCH_SHIFT, draw);
    // 24 bits: exact in f32.
    let [a, b, c, d] = words.map(|word| word >> 10);
    let sum = a.wrapping_add(b).wrapping_add(c).wrapping_add(d) as i32 as f32 * (1.0 / 4_194_304.0);
    // Their variance is 4 / 12.
    1.0 + jitter * ((sum - 2.0) * 1.732_050_8)
}
