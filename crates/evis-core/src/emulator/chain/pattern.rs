//! Fixed pattern: each pixel's own thresholds and leak.

use super::plan::ramps;
use crate::emulator::noise::spread_mean;
use crate::emulator::numbering::Numbering;
use crate::random::{Key, StreamId, normals, unit};
use crate::sensor::SensorConfig;

/// What is frozen about pixels: drawn from the generator alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FixedPattern {
    /// Rise that fires; infinite where the pixel is dead.
    pub on: Vec<f32>,
    /// Fall that fires, a magnitude; infinite where the pixel is dead.
    pub off: Vec<f32>,
    /// Mean slope of the leak's ramp per microsecond; empty where there is no ramp.
    pub slope: Vec<f32>,
}

impl FixedPattern {
    /// Of `length` pixels from `first` on.
    pub fn draw(sensor: &SensorConfig, key: Key, first: usize, length: usize) -> Self {
        Self::of(sensor, key, Numbering::run(first), length)
    }

    /// Of the first `length` pixels of a tile.
    pub(super) fn of(sensor: &SensorConfig, key: Key, numbering: Numbering, length: usize) -> Self {
        let (mut on, mut off) = (vec![0.0; length], vec![0.0; length]);
        draw_thresholds(sensor, key, numbering, (&mut on, &mut off), (0, 0));
        let noise = &sensor.noise;
        let mut slope = Vec::new();
        if ramps(sensor) {
            let mean = spread_mean(noise.leak_spread_decades.into());
            slope = (0..length)
                .map(|i| {
                    let factor = if noise.leak_spread_decades > 0.0 {
                        let [_, _, a, b] = key.draw(numbering.of(i as u32), StreamId::Defects, 0, 1);
                        10_f64.powf(f64::from(noise.leak_spread_decades) * normals(a, b).1) / mean
                    } else {
                        1.0
                    };
                    let own = if on[i].is_finite() { f64::from(on[i]) } else { 0.0 };
                    (f64::from(noise.leak_hz) * factor * own * 1e-6) as f32
                })
                .collect();
        }
        Self { on, off, slope }
    }
}

/// Thresholds of a tile's pixels, by the draw `when` of their pattern: its epoch and number.
pub(super) fn draw_thresholds(
    sensor: &SensorConfig,
    key: Key,
    numbering: Numbering,
    (on, off): (&mut [f32], &mut [f32]),
    (epoch, number): (i64, u32),
) {
    let pattern = &sensor.pattern;
    on.fill(sensor.threshold_on);
    off.fill(sensor.threshold_off);
    if pattern.sigma > 0.0 {
        for (i, (on, off)) in on.iter_mut().zip(off.iter_mut()).enumerate() {
            let [a, b, ..] = key.draw(numbering.of(i as u32), StreamId::Pattern, epoch, number);
            let (n_on, n_off) = normals(a, b);
            let own = |nominal: f32, n: f64| {
                (nominal + pattern.sigma * n as f32).clamp(pattern.least, pattern.most)
            };
            (*on, *off) = (own(*on, n_on), own(*off, n_off));
        }
    }
    if pattern.dead_share > 0.0 || pattern.sensitive_share > 0.0 {
        for (i, (on, off)) in on.iter_mut().zip(off).enumerate() {
            let [dead, _, sensitive, _] = key.draw(numbering.of(i as u32), StreamId::Defects, 0, 0);
            if unit(dead) < f64::from(pattern.dead_share) {
                (*on, *off) = (f32::INFINITY, f32::INFINITY);
            } else if unit(sensitive) < f64::from(pattern.sensitive_share) {
                (*on, *off) = (pattern.sensitive_threshold, pattern.sensitive_threshold);
            }
        }
    }
}
