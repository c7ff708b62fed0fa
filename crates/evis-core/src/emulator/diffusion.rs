//! Brownian motion with drift between two thresholds: DVS-Voltmeter's pixel, without its dependence on the step.
//!
//! Within a step the end of the path is drawn, then whether the bridge to it touched a threshold, then when: given that
//! a bridge of length 1 from 0 to `end` touches `b`, `T / (1 - T)` is inverse Gaussian with mean `b / |end - b|` and
//! shape `b^2` in units of the variance (Karatzas & Shreve, Brownian Motion, 2.8). Steps are so short that touching both
//! thresholds in one does not matter. After an event the path restarts from the threshold (strong Markov property).

use super::frames::{BLOCK, Source};
use super::ideal::{Interval, Tally};
use super::order::Record;
use crate::event::Polarity;
use crate::random::{EPOCH_SHIFT, Key, StreamId, normals, unit};
use crate::sensor::SensorConfig;

/// Standard deviation of a step at most, in thresholds.
const STEP: f64 = 0.25;

/// What the pixels of a tile remember.
#[derive(Clone, Debug, Default)]
pub(crate) struct Diffuse {
    /// Distance from the last event, in thresholds: -1 to 1; NaN where nothing was seen.
    pub level: Vec<f32>,
    /// Light of the last sample.
    pub light: Vec<f32>,
    /// When the pixel last fired, microseconds.
    pub fired: Vec<i64>,
    next: Vec<f32>,
}

/// Draws of one pixel in one interval.
struct Draws {
    key: Key,
    pixel: u32,
    start_us: i64,
    count: u32,
}

impl Draws {
    fn next(&mut self) -> [u32; 4] {
        self.count += 1;
        // The interval's start takes the place of the epoch and, below it, of the draw's high bits.
        let low = (self.start_us as u32 & ((1 << EPOCH_SHIFT) - 1)) << (32 - EPOCH_SHIFT);
        self.key.draw(self.pixel, StreamId::Diffusion, self.start_us >> EPOCH_SHIFT, low | self.count)
    }
}

/// Inverse Gaussian with this mean and shape (Michael, Schucany & Haas, The American Statistician 30, 1976).
fn inverse_gaussian(mean: f64, shape: f64, [a, b, c, _]: [u32; 4]) -> f64 {
    let y = normals(a, b).0.powi(2) * mean;
    // The smaller root, written without a difference of large numbers.
    let smaller = 2.0 * shape * mean / (2.0 * shape + y + (y * (4.0 * shape + y)).sqrt());
    if unit(c) <= mean / (mean + smaller) { smaller } else { mean * mean / smaller }
}

impl Diffuse {
    pub fn new(pixels: usize) -> Self {
        Self {
            level: vec![f32::NAN; pixels],
            light: vec![f32::NAN; pixels],
            fired: vec![i64::MIN / 2; pixels],
            next: vec![f32::NAN; pixels],
        }
    }

    /// Reads the frame; how many values are NaN, and whether one is impossible.
    pub fn scan(&mut self, source: &Source<'_>, eps: f32, interval: &Interval<'_>) -> (u64, bool) {
        let (mut unknown, mut impossible) = (0, false);
        for (block, next) in self.next.chunks_mut(BLOCK).enumerate() {
            let mut light = [f32::NAN; BLOCK];
            source.load_light(interval.first + block * BLOCK, eps, &mut light);
            for (next, light) in next.iter_mut().zip(light) {
                unknown += u64::from(light.is_nan());
                impossible |= light < 0.0 || light == f32::INFINITY;
                *next = light;
            }
        }
        (unknown, impossible)
    }

    /// Events of the interval; the frame becomes the last one.
    pub fn fire(
        &mut self,
        sensor: &SensorConfig,
        interval: &Interval<'_>,
        key: Key,
        start_us: i64,
        records: &mut Vec<Record>,
    ) -> Tally {
        let mut tally = Tally::default();
        let Some(constants) = sensor.diffusion else { return tally };
        let [k1, k2, k3, k4, k5, k6] =
            [constants.k1, constants.k2, constants.k3, constants.k4, constants.k5, constants.k6]
                .map(f64::from);
        let length = f64::from(interval.us);
        let period = i64::from(sensor.refractory.period_us);
        for i in 0..self.level.len() {
            let after = if self.next[i].is_nan() { self.light[i] } else { self.next[i] };
            let before = std::mem::replace(&mut self.light[i], after);
            if before.is_nan() {
                self.level[i] = if after.is_nan() { f32::NAN } else { 0.0 };
                continue;
            }
            let (before, after) = (255.0 * f64::from(before), 255.0 * f64::from(after));
            let mean = 0.5 * (before + after);
            let drift = k1 * (after - before) / length / (mean + k2) + k4 + k5 * mean;
            let volatility = (k3 * mean.sqrt() / (mean + k2) + k6).max(1e-12);
            let pixel = interval.first + i;
            let mut draws = Draws { key, pixel: pixel as u32, start_us, count: 0 };
            let (mut t, mut level) = (0.0, f64::from(self.level[i]));
            // The last step ends exactly with the interval.
            let longest = (STEP / volatility).powi(2).max(length / 4096.0);
            let mut count = 0;
            while t < length {
                let step = longest.min(length - t);
                let (reached, end, rises) = path(level, drift, volatility, step, &mut draws);
                t = if step < length - t || reached < step { t + reached } else { length };
                level = end;
                let Some(rises) = rises else { continue };
                level = 0.0;
                count += 1;
                if count > sensor.most_events {
                    tally.clamped += 1;
                    break;
                }
                let offset = (t as u32).clamp(1, interval.us.max(1));
                let t_us = start_us + i64::from(offset);
                if t_us - self.fired[i] < period {
                    tally.suppressed += 1;
                    continue;
                }
                self.fired[i] = t_us;
                let place = (pixel % interval.width as usize, pixel / interval.width as usize);
                let polarity = if rises { Polarity::On } else { Polarity::Off };
                records.push(Record::new(offset, place.0 as u32, place.1 as u32, polarity));
            }
            self.level[i] = level as f32;
        }
        tally
    }
}

/// One step from `level` between thresholds at -1 and 1: how far it came, where it is then, and the threshold that it
/// touched.
fn path(level: f64, drift: f64, volatility: f64, step: f64, draws: &mut Draws) -> (f64, f64, Option<bool>) {
    let deviation = volatility * step.sqrt();
    let variance = deviation * deviation;
    let [a, b, up, down] = draws.next();
    let end = level + drift * step + deviation * normals(a, b).0;
    let mut first: Option<(f64, bool)> = None;
    for (rises, word) in [(true, up), (false, down)] {
        let sign = if rises { 1.0 } else { -1.0 };
        let distance = (1.0 - sign * level).max(0.0);
        let beyond = 1.0 - sign * end;
        let exponent = 2.0 * distance * beyond / variance;
        let touches = beyond <= 0.0 || (exponent < 25.0 && unit(word) < (-exponent).exp());
        if touches {
            let ratio = if distance == 0.0 {
                0.0
            } else {
                let gap = beyond.abs().max(1e-12);
                inverse_gaussian(distance / gap, distance * distance / variance, draws.next())
            };
            let t = step * ratio / (1.0 + ratio);
            if first.is_none_or(|(other, _)| t < other) {
                first = Some((t, rises));
            }
        }
    }
    match first {
        Some((t, rises)) => (t, 0.0, Some(rises)),
        None => (step, end, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First-passage times from 0 to 1 of a path with drift, cut into steps of `step`.
    fn passages(drift: f64, volatility: f64, step: f64, count: u32) -> Vec<f64> {
        (0..count)
            .map(|pixel| {
                let mut draws = Draws { key: Key::new(5, 0, 0), pixel, start_us: 77, count: 0 };
                let (mut t, mut level) = (0.0, 0.0);
                loop {
                    let (reached, end, touched) = path(level, drift, volatility, step, &mut draws);
                    t += reached;
                    level = end;
                    match touched {
                        Some(true) => break t,
                        Some(false) => break f64::NAN,
                        None => {}
                    }
                }
            })
            .filter(|t| !t.is_nan())
            .collect()
    }

    /// Normal distribution (Abramowitz & Stegun 7.1.26 is not enough here): by its continued fraction and series.
    fn normal(x: f64) -> f64 {
        let z = x.abs();
        let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        let upper = if z < 3.0 {
            let (mut term, mut sum, mut k) = (z, z, 1.0);
            while term > 1e-17 * sum {
                k += 2.0;
                term *= z * z / k;
                sum += term;
            }
            0.5 - density * sum
        } else {
            let fraction = (1..60).rev().fold(0.0, |f, k| f64::from(k) / (z + f));
            density / (z + fraction)
        };
        if x > 0.0 { 1.0 - upper } else { upper }
    }

    /// Distribution of the first passage to 1: inverse Gaussian with mean 1 / drift and shape 1 / volatility^2.
    fn inverse_gaussian_below(t: f64, drift: f64, volatility: f64) -> f64 {
        let (mean, shape) = (1.0 / drift, 1.0 / (volatility * volatility));
        let root = (shape / t).sqrt();
        normal(root * (t / mean - 1.0)) + (2.0 * shape / mean).exp() * normal(-root * (t / mean + 1.0))
    }

    fn kolmogorov_smirnov(times: &mut [f64], drift: f64, volatility: f64) -> f64 {
        times.sort_by(f64::total_cmp);
        let n = times.len() as f64;
        let distance = times.iter().enumerate().map(|(i, t)| {
            let below = inverse_gaussian_below(*t, drift, volatility);
            (below - i as f64 / n).abs().max((below - (i + 1) as f64 / n).abs())
        });
        distance.fold(0.0, f64::max) * n.sqrt()
    }

    #[test]
    fn first_passages_are_inverse_gaussian_at_any_step() {
        // Drift so strong that the lower threshold is touched once in e^18 paths.
        let (drift, volatility) = (1e-3, 0.0105);
        for step in [10.0, 100.0, 560.0] {
            let mut times = passages(drift, volatility, step, 20_000);
            let statistic = kolmogorov_smirnov(&mut times, drift, volatility);
            // 1.63 is the 1 % point of Kolmogorov's distribution; three tests of one seed.
            assert!(statistic < 1.63, "{statistic} at steps of {step}");
            // Canary: a drift 5 % off is seen.
            assert!(kolmogorov_smirnov(&mut times, 1.05 * drift, volatility) > 1.63);
        }
    }
}
