//! Noise of the photoreceptor: white noise before the low-pass, made of independent normal numbers at knots on a grid of
//! absolute time, and straight lines between them. So the low-pass's exact answer to straight input is its answer to
//! noise too, and how time is cut by frames moves no knot.
//!
//! Knots are a power of two of microseconds apart, at most a quarter of the time constant of two poles: where the cutoff
//! follows light, noise is as fine as the light asks for. One pole passes so much of what is fast that thresholds feel
//! how far knots are apart: a sixteenth there (rates of events: half of those of 32 knots per time constant at 4, nine
//! tenths at 16; with two poles 0.95 at 4).

use super::frames::BLOCK;
use super::numbering::Numbering;
use crate::random::{EPOCH_SHIFT, Key, StreamId, unit_f32};
use crate::simd;

/// Four knots share a draw, and draws do not cross epochs.
const MOST_SHIFT: i32 = EPOCH_SHIFT as i32 - 2;

/// Microseconds between knots, as a power of two, for a time constant of `tau` microseconds.
#[inline(always)]
pub(crate) fn shift_of(tau: f32, two_poles: bool) -> u32 {
    // The exponent is the logarithm, rounded down.
    let shift = (tau.to_bits() >> 23) as i32 - 127 - if two_poles { 2 } else { 4 };
    let shift = if shift > MOST_SHIFT { MOST_SHIFT } else { shift };
    (if shift > 0 { shift } else { 0 }) as u32
}

/// Standard deviation of the knots for one of 1 behind the low-pass, with `u` time constants between knots.
///
/// The noise has the cubic B-spline for its autocovariance, the mean over where a knot lies; one pole has
/// `e^-|s| / 2`, two have `(1 + |s|) e^-|s| / 4`. The integral of the product is the fourth difference of `g`, whose
/// fourth derivative is the latter: `(6 g(0) - 8 g(u) + 2 g(2 u)) / u^3` with `g = e^-s / 2 + s^3 / 12 + s / 2`, and
/// `g = (5 + s) e^-s / 4 + s^3 / 12 + s`.
#[inline(always)]
pub(crate) fn gain_of(u: f32, two_poles: bool) -> f32 {
    let series = if two_poles {
        0.25 - u * u * (1.0 / 24.0 - u * (31.0 / 1260.0 - u * (3.0 / 320.0 - u * (127.0 / 45_360.0))))
    } else {
        0.5 - u * (7.0 / 30.0 - u * (1.0 / 12.0 - u * (31.0 / 1260.0 - u * (1.0 / 160.0))))
    };
    let e = simd::exp(-u);
    let linear = u * u * (2.0 / 3.0);
    let closed = if two_poles {
        linear - 4.0 + (7.5 - (10.0 + 2.0 * u) * e + (2.5 + u) * e * e) / u
    } else {
        linear - 2.0 + (3.0 - 4.0 * e + e * e) / u
    };
    // The difference has no digits left where u is small.
    let variance = if u <= 0.25 { series * u } else { closed / (u * u) };
    1.0 / variance.sqrt()
}

/// A pair of independent standard normals (Box and Muller, Ann. Math. Stat. 29, 1958).
#[inline(always)]
fn normal_pair(first: u32, second: u32) -> (f32, f32) {
    let radius = (-2.0 * simd::ln(unit_f32(first))).sqrt();
    // A quarter of the circle by two bits, the angle from its middle by the others.
    let a = (unit_f32(second << 2) - 0.5) * std::f32::consts::FRAC_PI_2;
    let z = a * a;
    let sin = a * (1.0 - z * (1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0))));
    let cos = 1.0 - z * (0.5 - z * (1.0 / 24.0 - z * (1.0 / 720.0 - z * (1.0 / 40_320.0))));
    let quarter = second >> 30;
    let (x, y) = if quarter & 1 != 0 { (-sin, cos) } else { (cos, sin) };
    let half = if quarter & 2 != 0 { -radius } else { radius };
    (x * half, y * half)
}

/// The four knots of which `knot`, counted from time 0, is one.
#[inline(always)]
pub(crate) fn knots_of(key: Key, pixel: u32, knot: i64, shift: u32) -> [f32; 4] {
    let from_us = (knot >> 2) << (shift + 2);
    let within = (from_us as u32 & ((1 << EPOCH_SHIFT) - 1)) >> (shift + 2);
    let words = key.draw(pixel, StreamId::Receptor, from_us >> EPOCH_SHIFT, (shift << 12) | within);
    let (a, b) = normal_pair(words[0], words[1]);
    let (c, d) = normal_pair(words[2], words[3]);
    [a, b, c, d]
}

/// A part of an interval within which noise is straight; times since the interval's start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    /// Its first knot, counted from time 0.
    pub knot: i64,
    pub from: u32,
    pub to: u32,
    /// Where both lie between the knots, 0 to 1.
    pub part: (f32, f32),
}

/// The cells of `[start_us, start_us + us]`.
#[inline(always)]
pub(crate) fn cells(start_us: i64, us: u32, shift: u32) -> impl Iterator<Item = Cell> {
    let first = start_us >> shift;
    let last = (start_us + i64::from(us) - 1) >> shift;
    let part = move |t: u32, knot: i64| {
        (start_us + i64::from(t) - (knot << shift)) as i32 as f32 * (1.0 / (1_u32 << shift) as f32)
    };
    (first..=last).map(move |knot| {
        let from = ((knot << shift) - start_us).max(0) as u32;
        let to = (((knot + 1) << shift) - start_us).min(us.into()) as u32;
        Cell { knot, from, to, part: (part(from, knot), part(to, knot)) }
    })
}

/// 64 pixels over an interval whose signal is straight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Course {
    /// Signal at the start, and its change until the end.
    pub input: [f32; BLOCK],
    pub change: [f32; BLOCK],
    /// Time constants per microsecond.
    pub rate: [f32; BLOCK],
    /// Poles: at the start, then at the end.
    pub first: [f32; BLOCK],
    pub second: [f32; BLOCK],
    /// What the output stays between.
    pub most: [f32; BLOCK],
    pub least: [f32; BLOCK],
}

/// Which pixels, which noise, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct When {
    pub key: Key,
    pub numbering: Numbering,
    /// Within the tile.
    pub first_pixel: u32,
    pub start_us: i64,
    pub us: u32,
    pub rms: f32,
}

impl Course {
    /// To the interval's end, with noise whose knots are as far apart as each pixel's time constant says.
    #[inline(always)]
    pub fn run(&mut self, when: &When, two_poles: bool, lags: impl Fn(f32) -> (f32, f32, f32) + Copy) {
        let mut shifts = [0; BLOCK];
        for (shift, rate) in shifts.iter_mut().zip(&self.rate) {
            *shift = shift_of(1.0 / rate, two_poles);
        }
        let (mut low, mut high) = (u32::MAX, 0);
        for shift in shifts {
            (low, high) = (low.min(shift), high.max(shift));
        }
        if low == high {
            self.run_alike(when, low, two_poles, lags);
            return;
        }
        // Light differs: each spacing in turn, for the pixels that have it.
        let before = *self;
        for shift in low..=high {
            if !shifts.contains(&shift) {
                continue;
            }
            let mut other = before;
            other.run_alike(when, shift, two_poles, lags);
            for (i, own) in shifts.iter().enumerate() {
                let own = *own == shift;
                self.first[i] = if own { other.first[i] } else { self.first[i] };
                self.second[i] = if own { other.second[i] } else { self.second[i] };
                self.most[i] = if own { other.most[i] } else { self.most[i] };
                self.least[i] = if own { other.least[i] } else { self.least[i] };
            }
        }
    }

    #[inline(always)]
    fn run_alike(
        &mut self,
        when: &When,
        shift: u32,
        two_poles: bool,
        lags: impl Fn(f32) -> (f32, f32, f32) + Copy,
    ) {
        let draw = |group: &mut [[f32; BLOCK]; 4], knot: i64| {
            for i in 0..BLOCK {
                let four = knots_of(when.key, when.numbering.of(when.first_pixel + i as u32), knot, shift);
                for (knots, own) in group.iter_mut().zip(four) {
                    knots[i] = own;
                }
            }
        };
        let mut gain = [0.0; BLOCK];
        for (gain, rate) in gain.iter_mut().zip(&self.rate) {
            *gain = when.rms * gain_of(rate * (1_u32 << shift) as f32, two_poles);
        }
        let mut group = [[0.0; BLOCK]; 4];
        let per_us = 1.0 / when.us as f32;
        let mut length = u32::MAX;
        let (mut one, mut two, mut e) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        let mut left = [0.0; BLOCK];
        for (index, cell) in cells(when.start_us, when.us, shift).enumerate() {
            if index == 0 {
                draw(&mut group, cell.knot);
                left = group[(cell.knot & 3) as usize];
            }
            if (cell.knot + 1) & 3 == 0 {
                draw(&mut group, cell.knot + 1);
            }
            let right = group[((cell.knot + 1) & 3) as usize];
            if cell.to - cell.from != length {
                length = cell.to - cell.from;
                for i in 0..BLOCK {
                    (one[i], two[i], e[i]) = lags(length as f32 * self.rate[i]);
                }
            }
            let (before, after) = (cell.from as f32 * per_us, cell.to as f32 * per_us);
            for i in 0..BLOCK {
                let u = length as f32 * self.rate[i];
                let step = right[i] - left[i];
                let from = self.input[i] + self.change[i] * before + gain[i] * (left[i] + step * cell.part.0);
                let to = self.input[i] + self.change[i] * after + gain[i] * (left[i] + step * cell.part.1);
                let (y, behind) = (self.first[i], self.first[i] - from);
                let next = to - (to - from) * one[i] + behind * e[i];
                // What is left to go falls ever more slowly: a pole goes half as far as it began at most, then turns.
                let bend = -0.5 * u * behind;
                let (up, down) = (y + bend.max(0.0), y + bend.min(0.0));
                let (up, down) = (up.max(next), down.min(next));
                self.first[i] = next;
                let (up, down) = if two_poles {
                    let z = self.second[i];
                    let next = to + (z - from + behind * u) * e[i] - (to - from) * two[i];
                    self.second[i] = next;
                    // No faster than towards the farthest that the first pole goes.
                    let (up, down) = (z + (u * (up - z)).max(0.0), z + (u * (down - z)).min(0.0));
                    (up.max(next), down.min(next))
                } else {
                    (up, down)
                };
                self.most[i] = self.most[i].max(up);
                self.least[i] = self.least[i].min(down);
            }
            left = right;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::shape::Shape;
    use super::super::{EmulatorConfig, EventEmulator, Frames, Isa, Memory};
    use super::*;
    use crate::sensor::{Bandwidth, Photoreceptor, SensorConfig};

    const SIDE: u32 = 64;

    fn emulator(photoreceptor: Photoreceptor) -> EventEmulator {
        // Nothing fires: the signal is what is read.
        let sensor =
            SensorConfig { threshold_on: 90.0, threshold_off: 90.0, photoreceptor, ..Default::default() };
        EventEmulator::new(EmulatorConfig {
            width: SIDE,
            height: SIDE,
            sensor,
            threads: 1,
            ..Default::default()
        })
        .unwrap()
    }

    /// Noise behind the low-pass at `times`, of all pixels.
    fn outputs(emulator: &mut EventEmulator, light: f32, times: impl Iterator<Item = i64>) -> Vec<Vec<f64>> {
        let frame = vec![light; (SIDE * SIDE) as usize];
        times
            .map(|t_us| {
                emulator.push(&Frames::linear(&frame), t_us).unwrap();
                let Memory::Chain(chain) = &emulator.environments[0].tiles[0].memory else { panic!() };
                let out = if chain.now.second.is_empty() { &chain.now.first } else { &chain.now.second };
                out.iter().zip(&chain.now.input).map(|(out, input)| f64::from(out - input)).collect()
            })
            .collect()
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
        sum / f64::from(count)
    }

    #[test]
    fn the_rms_is_what_was_asked_at_any_cutoff_and_light() {
        let rms = 0.1;
        for (cutoff_hz, order, bandwidth, light) in [
            (200.0, 1, Bandwidth::Constant, 1.0),
            (200.0, 2, Bandwidth::Constant, 0.3),
            // Just above and below where knots become twice as near.
            (155.0, 2, Bandwidth::Constant, 1.0),
            (156.0, 2, Bandwidth::Constant, 1.0),
            (100.0, 2, Bandwidth::Light, 0.04),
            (100.0, 1, Bandwidth::Light, 7.0),
            // Knots a microsecond apart.
            (20_000.0, 1, Bandwidth::Constant, 1.0),
            (20_000.0, 2, Bandwidth::Constant, 1.0),
            // And where they are as far apart as an epoch lets them.
            (0.5, 2, Bandwidth::Constant, 1.0),
        ] {
            let receptor =
                Photoreceptor { cutoff_hz, order, bandwidth, noise: rms, ..Photoreceptor::default() };
            let factor = if bandwidth == Bandwidth::Light { f64::from(light) } else { 1.0 };
            let tau = 1e6 / (std::f64::consts::TAU * f64::from(cutoff_hz) * factor);
            // Long after the start, so far apart that samples are independent, anywhere between knots.
            let step = |k: i64| ((k + 1) as f64 * 12.4 * tau) as i64 + 2 * k;
            let samples = outputs(&mut emulator(receptor), light, (-1..24).map(step));
            let own = mean(samples[1..].iter().flatten().map(|x| x * x)).sqrt() / f64::from(rms);
            let average = mean(samples[1..].iter().flatten().copied());
            let count = f64::from(24 * SIDE * SIDE);
            // 4.5 standard errors; a microsecond's grid is coarse beside the shortest time constants.
            assert!((own - 1.0).abs() < 4.5 * (0.5 / count).sqrt() + 1e-3, "{receptor:?}: {own}");
            assert!(average.abs() < 4.5 * f64::from(rms) / count.sqrt(), "{receptor:?}: {average}");
            // Canary: the other number of poles has another rms.
            let u = (1_u32 << shift_of(tau as f32, order == 2)) as f32 / tau as f32;
            let other = gain_of(u, order == 2) / gain_of(u, order != 2);
            assert!((other - 1.0).abs() > 0.01, "{other}");
        }
    }

    #[test]
    fn knots_have_the_gain_of_their_low_pass() {
        for u in [0.02, 0.06, 0.125, 0.249, 0.251, 0.6, 1.0, 3.0] {
            for two_poles in [false, true] {
                // What one knot of 1 does, squared, over all times: a rise, a fall, and silence; in time constants.
                let (mut y, mut z, mut sum) = (0.0, 0.0, 0.0);
                for (input, length) in [((0.0, 1.0), u), ((1.0, 0.0), u), ((0.0, 0.0), 40.0)] {
                    let pole = Shape::pole(input, length, 1.0, y);
                    let shape = if two_poles { Shape::two_poles(input, length, 1.0, y, z) } else { pole };
                    let steps = 4000;
                    let part = length / f64::from(steps);
                    sum +=
                        (0..steps).map(|k| shape.at((f64::from(k) + 0.5) * part).powi(2) * part).sum::<f64>();
                    (y, z) = (pole.at(length), shape.at(length));
                }
                let expected = (u / sum).sqrt();
                let got = f64::from(gain_of(u as f32, two_poles));
                assert!((got / expected - 1.0).abs() < 3e-4, "{u} {two_poles}: {got}, {expected}");
                // Canary: of the other number of poles.
                assert!((f64::from(gain_of(u as f32, !two_poles)) / expected - 1.0).abs() > 0.05);
            }
        }
    }

    #[test]
    fn it_is_forgotten_as_fast_as_the_low_pass_forgets() {
        for (order, law) in
            [(1, (|s: f64| (-s).exp()) as fn(f64) -> f64), (2, |s: f64| (1.0 + s) * (-s).exp())]
        {
            let receptor = Photoreceptor { cutoff_hz: 120.0, order, noise: 0.1, ..Photoreceptor::default() };
            let tau = 1e6 / (std::f64::consts::TAU * 120.0);
            for lag in [0.5, 1.0, 2.0, 4.0] {
                let mut emulator = emulator(receptor);
                let step = |k: i64| (12.4 * tau * (k / 2 + 1) as f64) as i64 + (k % 2) * (lag * tau) as i64;
                let samples = outputs(&mut emulator, 0.5, (0..41).map(step));
                let pairs = (1..20).flat_map(|k| samples[2 * k].iter().zip(&samples[2 * k + 1]));
                let both = mean(pairs.map(|(a, b)| a * b)) / 0.01;
                let slack = 4.5 / f64::from(19 * SIDE * SIDE).sqrt();
                // What is faster than the knots is not there, and the rest makes up for it.
                let u = f64::from(1_u32 << shift_of(tau as f32, order == 2)) / tau;
                let coarse = if order == 1 { 0.5 * u } else { 0.2 * u * u };
                assert!((both - law(lag)).abs() < slack + coarse * law(lag), "{order} {lag}: {both}");
                // Canary: half and twice the cutoff.
                for other in [0.5 * lag, 2.0 * lag] {
                    assert!((both - law(other)).abs() > slack + coarse * law(other));
                }
            }
        }
    }

    #[test]
    fn it_is_normal_to_its_tails() {
        let receptor = Photoreceptor { cutoff_hz: 100.0, noise: 1.0, ..Photoreceptor::default() };
        let samples = outputs(&mut emulator(receptor), 0.5, (0..61).map(|k| 20_001 * k));
        let all: Vec<f64> = samples[1..].iter().flatten().copied().collect();
        // Shares of a normal distribution beyond 1, 2, 3 and 4 standard deviations.
        for (limit, share) in [(1.0, 0.317_311), (2.0, 0.045_500), (3.0, 0.002_700), (4.0, 6.334e-5)] {
            let beyond = all.iter().filter(|x| x.abs() > limit).count() as f64;
            let expected = share * all.len() as f64;
            assert!((beyond - expected).abs() < 4.5 * expected.sqrt(), "{limit}: {beyond}, {expected}");
            // Canary: of another width.
            let wide = all.iter().filter(|x| x.abs() > 0.9 * limit).count() as f64;
            assert!((wide - expected).abs() > 4.5 * expected.sqrt() || limit > 3.5);
        }
    }

    #[test]
    fn instruction_sets_agree_where_light_asks_for_different_knots() {
        let (width, height) = (67, 21);
        let pixels = (width * height) as usize;
        for order in [1, 2] {
            let sensor = SensorConfig {
                photoreceptor: Photoreceptor {
                    cutoff_hz: 300.0,
                    order,
                    bandwidth: Bandwidth::Light,
                    noise: 0.08,
                    ..Photoreceptor::default()
                },
                ..Default::default()
            };
            let mut streams = Vec::new();
            for isa in Isa::supported() {
                let config = EmulatorConfig { width, height, sensor: sensor.clone(), ..Default::default() };
                let mut emulator = EventEmulator { isa, ..EventEmulator::new(config).unwrap() };
                let mut events = Vec::new();
                for k in 0..30_usize {
                    let light = |i: usize| match (i * 31 + k / 9) % 97 {
                        0 => f32::NAN,
                        n => (n as f32 / 96.0).powi(3),
                    };
                    let frame: Vec<f32> = (0..pixels).map(light).collect();
                    events.extend(emulator.push(&Frames::linear(&frame), 1300 * k as i64).unwrap().remove(0));
                }
                assert!(events.len() > 500, "{}", events.len());
                streams.push((events, emulator.state()));
            }
            assert!(streams.windows(2).all(|pair| pair[0] == pair[1]), "{order}");
            assert!(streams[0].0 != streams[0].0[1..], "canary");
        }
    }
}
