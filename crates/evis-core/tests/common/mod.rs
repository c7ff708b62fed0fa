//! What tests share.
#![allow(dead_code, clippy::unwrap_used, reason = "each test file uses its part of these helpers")]

pub mod damage;

/// Times from 0 to `end_us`, by steps in no order: 1 to 128 times 1 to `most + 1` times `unit_us`; `most` is a power of two
/// less one.
pub fn irregular(end_us: i64, seed: u64, unit_us: i64, most: u64) -> Vec<i64> {
    let (mut t, mut times, mut word) = (0, vec![0], seed);
    while t < end_us {
        word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        t += unit_us * (1 << (word >> 61)) * (1 + (word >> 40 & most) as i64);
        times.push(t.min(end_us));
    }
    times
}
