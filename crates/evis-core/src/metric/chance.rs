//! What a match is counted from, and streams shifted in time, whose matches are chance.

use crate::truth::{Region, Truth};

/// Chance streams are shifted by more than this.
const LEAST_SHIFT_US: i64 = 50_000;
/// From this length on.
const LONG_US: i64 = 200_000;

/// A pixel's events of one polarity, in order of time.
pub(super) struct PixelEvents<'a> {
    /// Times of the stream, and where the pixel lies at each.
    pub stream: &'a [i64],
    pub regions: &'a [Region],
    /// The stream's times, shifted for chance.
    pub shifted: &'a [i64],
    /// Times of the truth, and what is known of each event.
    pub truth: &'a [i64],
    pub known: &'a [TruthDetail],
}

/// What a truth event brings to a match.
#[derive(Clone, Copy)]
pub(super) struct TruthDetail {
    pub scale: f32,
    pub region: Region,
    /// Time to the nearest other truth event of the pixel, at least 1; 0 where there is none.
    pub interval_us: i64,
}

/// Least and largest shift of a chance stream.
pub(super) fn chance_shifts(duration_us: i64) -> [i64; 2] {
    if duration_us >= LONG_US {
        [LEAST_SHIFT_US + 1, duration_us - LEAST_SHIFT_US - 1]
    } else {
        [duration_us / 4, duration_us - duration_us / 4 - 1]
    }
}

/// By how much the stream of pixel `pixel` is shifted.
pub(super) fn chance_shift(truth: &Truth, pixel: usize) -> i64 {
    let [least, largest] = chance_shifts(truth.duration_us);
    let [x, y] = truth.pixels.get(pixel).copied().unwrap_or_default();
    let choices = (largest - least).unsigned_abs() + 1;
    least + (mixed(u64::from(y) << 16 | u64::from(x)) % choices) as i64
}

/// SplitMix64's output function.
const fn mixed(key: u64) -> u64 {
    crate::random::mix(key.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}
