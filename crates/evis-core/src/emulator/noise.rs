//! Noise events in continuous time: when they could happen, before light has its say.
//!
//! Every pixel has a Poisson process of candidates at the highest rate that light can give it. Candidates are drawn per
//! epoch of 2^14 microseconds, from the pixel, the epoch and nothing else; so no step, chunk or thread changes them.
//! What a candidate becomes is decided where the light of its instant is known (thinning).

use std::cmp::Ordering;

use crate::event::{Cause, Polarity};
use crate::random::{EPOCH_SHIFT, EPOCH_US, Key, StreamId, normals, unit};
use crate::sensor::{LeakLaw, Noise, SensorConfig};
use crate::simd::{bits_of, dispatched};

use super::frames::BLOCK;
use super::numbering::Numbering;

/// Something that may happen to a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Candidate {
    /// Index within the tile.
    pub pixel: u32,
    /// Microseconds.
    pub t_us: i64,
    /// Uniform: what it becomes.
    pub mark: u32,
    /// Uniform: its polarity.
    pub side: u32,
    /// Whether the pixel is hot and this is why.
    pub hot: bool,
    /// Whether it follows another in a burst.
    pub follows: bool,
}

/// Unit of [`Settled::rest`], as a power of two of microseconds: the longest rest fits the bits that shaders have for it.
pub(crate) const REST_SHIFT: u32 = 4;

/// What a candidate's event is like, if light lets it happen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Settled {
    /// It happens where the pixel's light, relative to `Y_ref`, is below this.
    pub light_below: f32,
    /// Its polarity, or where `relative` that of the pixel's first event.
    pub polarity: Polarity,
    /// Whether its polarity is that of the pixel's last event (`Off`) or the other one (`On`).
    pub relative: Option<Polarity>,
    pub cause: Cause,
    /// It happens where the pixel's last event is at least so long ago, in units of 16 us.
    pub rest: u32,
}

impl Candidate {
    /// Everything about it that does not depend on light.
    pub fn settle(&self, noise: &Noise, rates: &Rates) -> Settled {
        let side = unit(self.side);
        let always = |polarity, cause| Settled {
            light_below: f32::INFINITY,
            polarity,
            relative: None,
            cause,
            rest: 0,
        };
        if self.hot {
            let on = side < f64::from(noise.on_share);
            return always(if on { Polarity::On } else { Polarity::Off }, Cause::Hot);
        }
        let (leak, on, off) = (f64::from(rates.leak), f64::from(rates.on), f64::from(rates.off));
        let place = unit(self.mark) * (leak + f64::from(rates.on + rates.off));
        if place < leak {
            return always(Polarity::On, Cause::Leak);
        }
        // Shot noise has its places in the dark; light takes the upper part of each polarity's.
        let place = place - leak;
        let (polarity, part) =
            if place < on { (Polarity::On, place / on) } else { (Polarity::Off, (place - on) / off) };
        let share = f64::from(noise.shot_light_share);
        let light_below = if share > 0.0 {
            // 1 - share (min(light, 1) + offset) / (1 + offset) > part.
            let offset = f64::from(noise.shot_light_offset);
            let limit = (1.0 - part) / share * (1.0 + offset) - offset;
            if limit > 1.0 { f32::INFINITY } else { limit as f32 }
        } else if part < 1.0 {
            f32::INFINITY
        } else {
            f32::NEG_INFINITY
        };
        let other = side < f64::from(noise.alternation);
        let relative = (noise.alternation >= 0.0).then_some(if other { Polarity::On } else { Polarity::Off });
        Settled { light_below, polarity, relative, cause: Cause::Shot, rest: self.rest(noise) }
    }

    /// The time since the pixel's last event that lets a candidate of shot noise happen: its distribution is the recovery.
    fn rest(&self, noise: &Noise) -> u32 {
        if noise.shot_recovery_us == 0.0 || self.follows {
            return 0;
        }
        // The low half of a word whose high half decides the polarity; the longest is 3.4 times the recovery.
        let u = (f64::from(self.side & 0xffff) + 0.5) / 65_536.0;
        (f64::from(noise.shot_recovery_us) * (-u.ln()).sqrt()) as u32 >> REST_SHIFT
    }
}

/// Rates of one pixel, per second, in the dark.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rates {
    pub leak: f32,
    pub on: f32,
    pub off: f32,
}

/// The noise of a tile.
#[derive(Clone, Debug, Default)]
pub(crate) struct TileNoise {
    /// Per pixel; all alike where there is one.
    rates: Vec<Rates>,
    /// A first word below this means no candidate in an epoch; as `rates`.
    quiet: Vec<u32>,
    /// Hot pixels, rising.
    hot: Vec<u32>,
    /// The epoch of `drawn`.
    epoch: Option<i64>,
    /// Candidates of that epoch by time.
    drawn: Vec<Candidate>,
    /// What follows events up to that epoch, and happens after it.
    later: Vec<Candidate>,
    /// Candidates of the interval, by pixel and time.
    pub now: Vec<Candidate>,
}

/// Probability `p` as a limit of a word.
fn limit(p: f64) -> u32 {
    (p * 4_294_967_296.0).clamp(0.0, 4_294_967_295.0) as u32
}

/// Mean of `10^(s n)` over a standard normal `n`: rates are divided by it, so that their mean is the one asked for.
pub(crate) fn spread_mean(decades: f64) -> f64 {
    (0.5 * (decades * std::f64::consts::LN_10).powi(2)).exp()
}

impl TileNoise {
    /// The noise of pixels with these thresholds.
    pub fn new(sensor: &SensorConfig, key: Key, numbering: Numbering, on: &[f32], off: &[f32]) -> Self {
        let noise = &sensor.noise;
        let poisson_leak = if noise.leak_law == LeakLaw::Poisson { noise.leak_hz } else { 0.0 };
        let alike = noise.shot_spread_decades == 0.0
            && (noise.leak_spread_decades == 0.0 || poisson_leak == 0.0)
            && !(noise.shot_per_threshold && sensor.pattern.sigma > 0.0);
        let mut tile = Self::default();
        if poisson_leak > 0.0 || noise.shot_hz > 0.0 {
            let shot_mean = spread_mean(noise.shot_spread_decades.into());
            let leak_mean = spread_mean(noise.leak_spread_decades.into());
            let count = if alike { 1 } else { on.len() };
            for i in 0..count {
                let [_, _, a, b] = key.draw(numbering.of(i as u32), StreamId::Defects, 0, 1);
                let (n_shot, n_leak) = normals(a, b);
                let spread = |decades: f32, n: f64, mean: f64| 10_f64.powf(f64::from(decades) * n) / mean;
                let shot = f64::from(noise.shot_hz) * spread(noise.shot_spread_decades, n_shot, shot_mean);
                let leak = f64::from(poisson_leak) * spread(noise.leak_spread_decades, n_leak, leak_mean);
                let own = |nominal: f32, threshold: f32| {
                    if noise.shot_per_threshold && threshold.is_finite() {
                        f64::from(nominal / threshold)
                    } else {
                        1.0
                    }
                };
                let on_share = f64::from(noise.on_share);
                let rates = Rates {
                    leak: leak as f32,
                    on: (shot * on_share * own(sensor.threshold_on, on[i])) as f32,
                    off: (shot * (1.0 - on_share) * own(sensor.threshold_off, off[i])) as f32,
                };
                tile.quiet.push(limit(1.0 - (-rates.candidates(noise)).exp()));
                tile.rates.push(rates);
            }
        }
        if noise.hot_share > 0.0 && noise.hot_hz > 0.0 {
            let share = limit(noise.hot_share.into());
            let is_hot = |i: &u32| key.draw(numbering.of(*i), StreamId::Defects, 0, 0)[1] < share;
            tile.hot = (0..on.len() as u32).filter(is_hot).collect();
        }
        tile
    }

    /// Whether nothing ever happens here.
    pub fn is_silent(&self) -> bool {
        self.rates.is_empty() && self.hot.is_empty()
    }

    /// Rates of a pixel.
    pub fn rates(&self, pixel: usize) -> Rates {
        self.rates.get(pixel).or(self.rates.first()).copied().unwrap_or_default()
    }

    /// Puts the candidates in `(start_us, end_us]` into `now`.
    pub fn gather(
        &mut self,
        isa: crate::simd::Isa,
        noise: &Noise,
        key: Key,
        (numbering, pixels): (Numbering, usize),
        (start_us, end_us): (i64, i64),
    ) {
        self.now.clear();
        if self.is_silent() {
            return;
        }
        for epoch in (start_us + 1) >> EPOCH_SHIFT..=end_us >> EPOCH_SHIFT {
            if self.epoch != Some(epoch) {
                self.draw(isa, noise, key, numbering, pixels, epoch);
                self.epoch = Some(epoch);
            }
            let from = self.drawn.partition_point(|candidate| candidate.t_us <= start_us);
            let to = self.drawn.partition_point(|candidate| candidate.t_us <= end_us);
            self.now.extend_from_slice(self.drawn.get(from..to).unwrap_or(&[]));
        }
        self.now.sort_unstable();
    }

    fn draw(
        &mut self,
        isa: crate::simd::Isa,
        noise: &Noise,
        key: Key,
        numbering: Numbering,
        pixels: usize,
        epoch: i64,
    ) {
        let Self { rates, quiet, hot, drawn, later, .. } = self;
        drawn.clear();
        // What follows an event of an epoch before may reach into this one: it is kept, and drawn again where the stream
        // begins or goes back.
        let reach =
            if noise.burst_events > 0.0 { 1 + ((longest_delay(noise) - 1) >> EPOCH_SHIFT) } else { 0 };
        let from = if self.epoch == Some(epoch - 1) {
            later.retain(|candidate| {
                let now = candidate.t_us >> EPOCH_SHIFT == epoch;
                if now {
                    drawn.push(*candidate);
                }
                !now
            });
            epoch
        } else {
            later.clear();
            epoch - reach
        };
        if !rates.is_empty() {
            let mut masks = vec![0_u64; pixels.div_ceil(BLOCK)];
            for from in from..=epoch {
                busy(isa, key, numbering, pixels, from, quiet, &mut masks);
                for (block, mask) in masks.iter().enumerate() {
                    let mut mask = *mask;
                    while mask != 0 {
                        let i = block * BLOCK + mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        let rates = rates.get(i).or(rates.first()).copied().unwrap_or_default();
                        parents(noise, key, numbering, i as u32, from, &rates, |candidate| match (candidate
                            .t_us
                            >> EPOCH_SHIFT)
                            .cmp(&epoch)
                        {
                            Ordering::Less => {}
                            Ordering::Equal => drawn.push(candidate),
                            Ordering::Greater => later.push(candidate),
                        });
                    }
                }
            }
        }
        let mean = f64::from(noise.hot_hz) * EPOCH_US as f64 * 1e-6;
        for pixel in hot {
            let count = poisson(key.draw(numbering.of(*pixel), StreamId::Hot, epoch, 0)[0], mean);
            for k in 1..=count {
                let [when, mark, side, _] = key.draw(numbering.of(*pixel), StreamId::Hot, epoch, k);
                drawn.push(Candidate {
                    pixel: *pixel,
                    t_us: instant(epoch, when),
                    mark,
                    side,
                    hot: true,
                    follows: false,
                });
            }
        }
        drawn.sort_unstable_by_key(|candidate| (candidate.t_us, *candidate));
    }
}

impl Rates {
    /// Candidates per epoch, without what follows them.
    fn candidates(&self, noise: &Noise) -> f64 {
        let shot = (self.on + self.off) / (1.0 + noise.burst_events);
        f64::from(self.leak + shot) * EPOCH_US as f64 * 1e-6
    }
}

const fn instant(epoch: i64, word: u32) -> i64 {
    (epoch << EPOCH_SHIFT) + (word >> (32 - EPOCH_SHIFT)) as i64
}

/// The longest time after which an event of a burst follows.
fn longest_delay(noise: &Noise) -> i64 {
    // A whole epoch is eight mean delays or more; the rest follows at once.
    if noise.burst_longest_us > 0.0 { noise.burst_longest_us as i64 } else { EPOCH_US - 1 }
}

/// A Poisson number of this mean, by inversion of `1 - unit`: large words are 0.
fn poisson(word: u32, mean: f64) -> u32 {
    let u = 1.0 - unit(word);
    let mut term = (-mean).exp();
    let mut sum = term;
    let mut count = 0;
    // 2^-32 is the smallest step of `u`: beyond it, terms cannot matter. The bound ends rounding's quarrels.
    while u > sum && count < 4096 {
        count += 1;
        term *= mean / f64::from(count);
        sum += term;
    }
    count
}

/// The candidates of a pixel that has any, and those that follow them.
fn parents(
    noise: &Noise,
    key: Key,
    numbering: Numbering,
    pixel: u32,
    epoch: i64,
    rates: &Rates,
    mut found: impl FnMut(Candidate),
) {
    let number = numbering.of(pixel);
    let word = key.draw(number, StreamId::Noise, epoch, 0)[0];
    let all = f64::from(rates.leak) + f64::from(rates.on + rates.off) / f64::from(1.0 + noise.burst_events);
    let leak_part = limit(f64::from(rates.leak) / all);
    for k in 0..poisson(word, rates.candidates(noise)) {
        let [when, which, mark, side] = key.draw(number, StreamId::NoiseMark, epoch, k << 8);
        let t_us = instant(epoch, when);
        // Marks are uniform over leak, ON and OFF; leak takes its part of them first.
        let shot = rates.on + rates.off;
        let scaled = |within: f64| limit(within / f64::from(rates.leak + shot));
        if which < leak_part {
            let within = f64::from(rates.leak) * unit(mark);
            found(Candidate { pixel, t_us, mark: scaled(within), side, hot: false, follows: false });
            continue;
        }
        let within = |mark: u32| scaled(f64::from(rates.leak) + f64::from(shot) * unit(mark));
        found(Candidate { pixel, t_us, mark: within(mark), side, hot: false, follows: false });
        if noise.burst_events > 0.0 {
            let mean = f64::from(noise.burst_events);
            let [more, ..] = key.draw(number, StreamId::NoiseMark, epoch, (k << 8) | 1);
            // Geometric with this mean.
            let count = (unit(more).ln() / (mean / (1.0 + mean)).ln()).min(250.0) as u32;
            for j in 0..count {
                let draw = (k << 8) | (2 + j);
                let [delay, mark, side, _] = key.draw(number, StreamId::NoiseMark, epoch, draw);
                let shortest = f64::from(noise.burst_us);
                let delay = if noise.burst_longest_us > 0.0 {
                    shortest * (f64::from(noise.burst_longest_us) / shortest).powf(unit(delay))
                } else {
                    -unit(delay).ln() * shortest
                };
                let t_us = t_us + (delay as i64).clamp(1, longest_delay(noise));
                found(Candidate { pixel, t_us, mark: within(mark), side, hot: false, follows: true });
            }
        }
    }
}

#[inline(always)]
fn busy_body(key: Key, numbering: Numbering, pixels: usize, epoch: i64, quiet: &[u32], masks: &mut [u64]) {
    let alike = quiet.first().copied().unwrap_or(0);
    for (block, mask) in masks.iter_mut().enumerate() {
        let start = block * BLOCK;
        let limits = quiet.get(start..).and_then(|quiet| quiet.first_chunk::<BLOCK>());
        let mut words = [0_u32; BLOCK];
        for (i, word) in words.iter_mut().enumerate() {
            *word = key.draw(numbering.of((start + i) as u32), StreamId::Noise, epoch, 0)[0];
        }
        let mut fires = [0_u8; BLOCK];
        match limits {
            Some(limits) if quiet.len() > 1 => {
                for i in 0..BLOCK {
                    fires[i] = u8::from(words[i] < limits[i]);
                }
            }
            _ => {
                for i in 0..BLOCK {
                    let own =
                        if quiet.len() > 1 { quiet.get(start + i).copied().unwrap_or(0) } else { alike };
                    fires[i] = u8::from(words[i] < own);
                }
            }
        }
        *mask = bits_of(&fires);
        if pixels - start < BLOCK {
            *mask &= (1_u64 << (pixels - start)) - 1;
        }
    }
}
dispatched!(
    /// Which pixels have a candidate in `epoch`.
    fn busy(key: Key, numbering: Numbering, pixels: usize, epoch: i64, quiet: &[u32], masks: &mut [u64]) = busy_body
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poisson_numbers_have_their_mean_and_variance() {
        for mean in [0.01, 0.7, 4.9, 60.0] {
            let count = 100_000;
            let draws = (0..count)
                .map(|i| f64::from(poisson(Key::new(3, 0, 0).draw(i, StreamId::Hot, 0, 0)[0], mean)));
            let (sum, squares) = draws.fold((0.0, 0.0), |(s, q), n| (s + n, q + n * n));
            let n = f64::from(count);
            let (got, variance) = (sum / n, squares / n - (sum / n).powi(2));
            assert!((got - mean).abs() < 5.0 * (mean / n).sqrt(), "{got} for {mean}");
            assert!((variance / mean - 1.0).abs() < 0.1, "{variance} for {mean}");
        }
    }

    #[test]
    fn large_words_are_quiet() {
        // The vector test `word < limit` and the scalar inversion must say the same.
        for mean in [1e-6_f64, 0.08, 3.0] {
            let edge = limit(1.0 - (-mean).exp());
            assert_eq!(poisson(edge.saturating_add(2), mean), 0);
            assert!(poisson(edge.saturating_sub(2), mean) > 0);
        }
    }
}
