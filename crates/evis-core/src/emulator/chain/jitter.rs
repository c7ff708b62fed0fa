//! Jitter of the leak.

use crate::emulator::frames::BLOCK;
use crate::random::{EPOCH_SHIFT, Key, StreamId};
use crate::simd::dispatched;

/// A leak's jitter is drawn for each pixel and 2^12 microseconds: two computations whose times differ by a rounding
/// nearly always draw the same.
pub const JITTER_SHIFT: u32 = 12;

/// Share of the mean time that the next leak event takes: nearly normal, the sum of four uniform draws, so that neither
/// end is far away and a move of the reference costs no logarithm. Twin: `jitter_at` in `shaders/chain/leak.wgsl`.
#[inline(always)]
pub(crate) fn jitter_at(key: Key, pixel: u32, t_us: i64, jitter: f32) -> f32 {
    let draw = (t_us >> JITTER_SHIFT) as u32 & ((1 << (EPOCH_SHIFT - JITTER_SHIFT)) - 1);
    let words = key.draw(pixel, StreamId::LeakJitter, t_us >> EPOCH_SHIFT, draw);
    // 24 bits: exact in f32.
    let [a, b, c, d] = words.map(|word| word >> 10);
    let sum = a.wrapping_add(b).wrapping_add(c).wrapping_add(d) as i32 as f32 * (1.0 / 4_194_304.0);
    // Their variance is 4 / 12.
    1.0 + jitter * ((sum - 2.0) * 1.732_050_8)
}

/// [`jitter_at`] of many pixels.
#[inline(always)]
fn jitters(key: Key, pixels: &[u32; BLOCK], t_us: i64, jitter: f32, out: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        out[i] = jitter_at(key, pixels[i], t_us, jitter);
    }
}
dispatched!(
    pub(super) fn jitters_by(
        key: Key,
        pixels: &[u32; BLOCK],
        t_us: i64,
        jitter: f32,
        out: &mut [f32; BLOCK],
    ) = jitters
);
