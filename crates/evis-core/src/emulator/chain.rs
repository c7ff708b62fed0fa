//! The whole pixel: photoreceptor, thresholds of its own, noise, refractory period.
//!
//! A first pass over 64 pixels at a time computes each signal at the interval's end and finds the pixels that could
//! fire. A second pass treats those, one at a time and in continuous time: crossings of the signal and candidates of
//! noise in the order in which they happen.

use super::frames::{BLOCK, Source};
use super::ideal::{Interval, Tally};
use super::noise::{Candidate, REST_SHIFT, TileNoise, spread_mean};
use super::numbering::Numbering;
use super::order::Record;
use super::plain::{self, Moments};
use super::readout::delay_us;
use super::receptor::{Course, When, cells, gain_of, knots_of, shift_of};
use super::shape::{Piece, Shape};
use crate::event::{Cause, Polarity};
use crate::random::{EPOCH_SHIFT, Key, StreamId, normals, unit, unit_f32};
use crate::sensor::{
    Bandwidth, Curve, FilterRule, LeakLaw, NoiseReference, Refractory, RefractoryRule, SensorConfig, Start,
    Times, TriggerRule,
};
use crate::simd::{self, Isa, bits_of, dispatched};

/// A time long before any other, on a tile's clock.
pub(super) const LONG_AGO: i32 = i32::MIN / 2;

/// On a tile's clock, beyond this its origin moves on.
pub(super) const REBASE_US: i64 = 1 << 29;

/// The stages that are on, in the numbers that the passes need; made once.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub sensor: SensorConfig,
    /// 2 pi cutoff, per microsecond; 0: no low-pass.
    rate: f32,
    exact: bool,
    two_poles: bool,
    /// Rms of the photoreceptor's noise; 0: none.
    noise: f32,
    /// Whether the leak is a ramp.
    ramp: bool,
    /// Whether events are decided at samples, with times given by a rule.
    sampled: bool,
    /// Whether the reference of each interval is the sample at its start.
    forgets: bool,
    /// Whether thresholds are drawn for every frame.
    redraws: bool,
    /// Whether a pixel can come back to a level exactly: with thresholds that all have in common, and without a filter or a
    /// leak.
    ties: bool,
    /// What linlog multiplies with below its knee.
    below_knee: f32,
    /// How blocks are treated that noise does not reach, where that can be done for all pixels alike.
    pub plain: Option<Plain>,
}

/// See [`Plan::plain`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plain {
    /// [`plain::lines`].
    Lines,
    /// [`plain::samples`].
    Samples,
}

impl Plan {
    pub fn new(sensor: &SensorConfig) -> Self {
        let receptor = &sensor.photoreceptor;
        let mut plan = Self {
            rate: receptor.cutoff_hz * std::f32::consts::TAU * 1e-6,
            exact: receptor.filter == FilterRule::Exact,
            two_poles: receptor.order == 2,
            noise: receptor.noise,
            ramp: ramps(sensor),
            sampled: sensor.trigger != TriggerRule::Crossing || sensor.times != Times::Crossing,
            forgets: sensor.trigger == TriggerRule::Difference,
            redraws: sensor.pattern.redraw && sensor.pattern.sigma > 0.0,
            ties: sensor.trigger == TriggerRule::Crossing
                && receptor.cutoff_hz == 0.0
                && sensor.pattern.sigma == 0.0
                && !ramps(sensor),
            below_knee: receptor.knee.ln() / receptor.knee,
            plain: None,
            sensor: sensor.clone(),
        };
        plan.plain = plan.to_plain();
        plan
    }

    /// What [`Plan::plain`] is.
    fn to_plain(&self) -> Option<Plain> {
        let Refractory { period_us, rule } = self.sensor.refractory;
        let may = |rules: &[RefractoryRule]| period_us == 0 || rules.contains(&rule);
        let readout = &self.sensor.readout;
        if readout.jitter_us > 0.0 || readout.latency_light_us > 0.0 {
            return None;
        }
        if self.sampled {
            let stays = self.sensor.trigger == TriggerRule::Crossing;
            return (stays && may(&[RefractoryRule::Suppress, RefractoryRule::Defer]))
                .then_some(Plain::Samples);
        }
        let straight = self.noise == 0.0 && (self.rate == 0.0 || !self.exact) && !self.ramp && !self.ties;
        (straight && may(&[RefractoryRule::Suppress])).then_some(Plain::Lines)
    }

    /// Whether all tiles must be scanned before any event has its time.
    pub fn shares_times(&self) -> bool {
        self.sampled && self.sensor.times == Times::Shared
    }

    /// What multiplies the cutoff at this light.
    #[inline(always)]
    fn bandwidth(&self, light: f32) -> f32 {
        let receptor = &self.sensor.photoreceptor;
        match receptor.bandwidth {
            Bandwidth::Constant => 1.0,
            Bandwidth::Light => {
                let relative = (light + receptor.bandwidth_offset) / (1.0 + receptor.bandwidth_offset);
                relative.max(receptor.bandwidth_least).min(receptor.bandwidth_most)
            }
        }
    }

    #[inline(always)]
    fn curve(&self, light: f32) -> f32 {
        let receptor = &self.sensor.photoreceptor;
        match receptor.curve {
            Curve::Log => simd::ln(light + self.sensor.log_eps),
            Curve::Linlog => {
                let i = light * receptor.full_scale;
                let positive = if i > 1.0 { i } else { 1.0 };
                if i <= receptor.knee { i * self.below_knee } else { simd::ln(positive) }
            }
        }
    }
}

/// What the pixels of a tile remember. Vectors are multiples of [`BLOCK`] long, or empty where their stage is off.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chain {
    /// Log units; NaN where nothing was seen, infinite while the pixel is held.
    pub reference: Vec<f32>,
    /// Signal before the filter, filter, second filter, light: now, and at the interval's end.
    pub now: Samples,
    next: Samples,
    /// When the reference last moved, microseconds after `base_us` (leak).
    pub moved: Vec<i32>,
    /// Rise of the signal per microsecond that the leak amounts to, since then.
    pub slope: Vec<f32>,
    /// Its mean.
    steady: Vec<f32>,
    /// When the pixel last fired, microseconds after `base_us` (refractory, recovery).
    pub fired: Vec<i32>,
    /// Polarity of the last event: 0, 1, or 2 for none (alternation).
    pub polarity: Vec<u8>,
    /// Origin of the tile's clock.
    pub base_us: i64,
    /// Thresholds; infinite where the pixel is dead.
    on: Vec<f32>,
    off: Vec<f32>,
    pub noise: TileNoise,
    masks: Vec<u64>,
    /// Pixels whose reference moved at the interval's end: their leak's jitter is drawn for many at once.
    moved_last: Vec<u32>,
    /// How far from a level the signal of this interval's end may be and still be on it: no range is narrowed here, so
    /// twice what the ideal pixel allows.
    tie: f32,
}

/// Values of a tile's pixels at one time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Samples {
    pub input: Vec<f32>,
    pub first: Vec<f32>,
    pub second: Vec<f32>,
    pub light: Vec<f32>,
}

impl Samples {
    fn new(plan: &Plan, length: usize) -> Self {
        let filtered = plan.rate > 0.0;
        Self {
            input: vec![f32::NAN; length],
            first: vec![f32::NAN; if filtered { length } else { 0 }],
            second: vec![f32::NAN; if filtered && plan.two_poles { length } else { 0 }],
            light: vec![f32::NAN; length],
        }
    }

    /// What the trigger sees.
    fn output(&self) -> &[f32] {
        if !self.second.is_empty() {
            &self.second
        } else if !self.first.is_empty() {
            &self.first
        } else {
            &self.input
        }
    }
}

/// What a first pass found.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Scan {
    pub unknown: u64,
    pub impossible: bool,
    /// Greatest number of events of one pixel (shared times only).
    pub most: u32,
}

impl Scan {
    /// Both.
    pub fn join(self, other: Self) -> Self {
        Self {
            unknown: self.unknown + other.unknown,
            impossible: self.impossible | other.impossible,
            most: self.most.max(other.most),
        }
    }
}

/// What is frozen about pixels: drawn from the generator alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frozen {
    /// Rise that fires; infinite where the pixel is dead.
    pub on: Vec<f32>,
    /// Fall that fires, a magnitude; infinite where the pixel is dead.
    pub off: Vec<f32>,
    /// Mean slope of the leak's ramp per microsecond; empty where there is no ramp.
    pub slope: Vec<f32>,
}

impl Frozen {
    /// Of `length` pixels from `first` on.
    pub fn draw(sensor: &SensorConfig, key: Key, first: usize, length: usize) -> Self {
        Self::of(sensor, key, Numbering::run(first), length)
    }

    /// Of the first `length` pixels of a tile.
    fn of(sensor: &SensorConfig, key: Key, numbering: Numbering, length: usize) -> Self {
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
fn draw_thresholds(
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

/// Whether the leak is a ramp.
pub(crate) fn ramps(sensor: &SensorConfig) -> bool {
    sensor.noise.leak_hz > 0.0 && sensor.noise.leak_law == LeakLaw::Ramp
}

impl Chain {
    /// Pixels that have seen nothing, with what is frozen about them.
    pub fn new(plan: &Plan, key: Key, numbering: Numbering, pixels: usize) -> Self {
        let length = pixels.next_multiple_of(BLOCK);
        let sensor = &plan.sensor;
        let noise = &sensor.noise;
        let Frozen { on, off, slope } = Frozen::of(sensor, key, numbering, length);
        let tile_noise = TileNoise::new(sensor, key, numbering, &on[..pixels], &off[..pixels]);
        let when = |wanted: bool, value: i32| vec![value; if wanted { length } else { 0 }];
        Self {
            reference: vec![f32::NAN; length],
            now: Samples::new(plan, length),
            next: Samples::new(plan, length),
            moved: when(plan.ramp, 0),
            steady: slope.clone(),
            slope,
            fired: when(sensor.refractory.period_us > 0 || noise.shot_recovery_us > 0.0, LONG_AGO),
            polarity: vec![2; if noise.alternation >= 0.0 { length } else { 0 }],
            base_us: 0,
            on,
            off,
            noise: tile_noise,
            masks: vec![0; length / BLOCK],
            moved_last: Vec::new(),
            tie: 0.0,
        }
    }

    /// Nothing seen, keeping what is frozen.
    pub fn clear(&mut self) {
        self.reference.fill(f32::NAN);
        for samples in [&mut self.now, &mut self.next] {
            samples.input.fill(f32::NAN);
            samples.first.fill(f32::NAN);
            samples.second.fill(f32::NAN);
            samples.light.fill(f32::NAN);
        }
        self.moved.fill(0);
        self.slope.copy_from_slice(&self.steady);
        self.fired.fill(LONG_AGO);
        self.polarity.fill(2);
        self.base_us = 0;
    }

    /// Moves the clock's origin on where it lies far back; what leaked until then goes into the reference.
    pub fn rebase(&mut self, start_us: i64, first_frame: bool) {
        if first_frame {
            self.base_us = start_us;
            return;
        }
        while start_us - self.base_us >= REBASE_US {
            self.base_us += REBASE_US;
            for (i, moved) in self.moved.iter_mut().enumerate() {
                let since = i64::from(*moved) - REBASE_US;
                if since < 0 && self.reference[i].is_finite() {
                    self.reference[i] += self.slope[i] * since as f32;
                }
                *moved = since.max(0) as i32;
            }
            for fired in &mut self.fired {
                *fired = (i64::from(*fired) - REBASE_US).max(LONG_AGO.into()) as i32;
            }
        }
    }
}

#[inline(always)]
fn at<T: Copy>(values: &[T], start: usize, missing: T) -> [T; BLOCK] {
    values.get(start..).and_then(|values| values.first_chunk::<BLOCK>()).copied().unwrap_or([missing; BLOCK])
}

#[inline(always)]
fn put(values: &mut [f32], start: usize, block: &[f32; BLOCK]) {
    if let Some(values) = values.get_mut(start..).and_then(|values| values.first_chunk_mut::<BLOCK>()) {
        *values = *block;
    }
}

/// `(1 - e^-u) / u` and `(2 - 2 e^-u - u e^-u) / u`, and `e^-u`: what a pole, and two poles, miss of a ramp.
#[inline(always)]
fn lags(u: f32) -> (f32, f32, f32) {
    let e = simd::exp(-u);
    let one = if u < 0.1 { 1.0 - u * (0.5 - u * (1.0 / 6.0 - u * (1.0 / 24.0))) } else { (1.0 - e) / u };
    let two = if u < 0.1 {
        1.0 - u * u * (1.0 / 6.0 - u * (1.0 / 12.0 - u * (1.0 / 40.0)))
    } else {
        (2.0 - 2.0 * e - u * e) / u
    };
    (one, two, e)
}

/// First pass: the samples at the interval's end, and who could fire; changes nothing that outlives a push.
#[inline(always)]
fn scan_body<const NOISY: bool>(
    plan: &Plan,
    source: &Source<'_>,
    interval: &Interval<'_>,
    (key, start_us): (Key, i64),
    chain: &mut Chain,
) -> Scan {
    // Within an i32 once `rebase` has been called.
    let t_end = (start_us - chain.base_us + i64::from(interval.us)) as i32;
    let mut scan = Scan::default();
    let eps = plan.sensor.log_eps;
    let dark = plan.sensor.photoreceptor.dark_light;
    let dt = interval.us as f32;
    let tie = chain.tie;
    let mut impossible = 0;
    for block in 0..chain.masks.len() {
        let start = block * BLOCK;
        let first = interval.first.wrapping_add(start);
        let seen = interval.end.saturating_sub(first).min(BLOCK);
        let mut light = [f32::NAN; BLOCK];
        source.load_light(first, eps, &mut light);
        let light_before = at(&chain.now.light, start, f32::NAN);
        let input_before = at(&chain.now.input, start, f32::NAN);
        let reference = at(&chain.reference, start, f32::NAN);
        let (on, off) = (at(&chain.on, start, 1.0), at(&chain.off, start, 1.0));
        let mut lost = [0_u8; BLOCK];
        let mut any_lost = 0;
        for i in 0..BLOCK {
            impossible |= u8::from(light[i] < 0.0) | u8::from(light[i] > f32::MAX);
            lost[i] = u8::from(light[i].is_nan());
            any_lost |= lost[i];
        }
        if any_lost != 0 {
            for i in 0..BLOCK {
                light[i] = if lost[i] != 0 { light_before[i] } else { light[i] };
            }
            scan.unknown += lost.iter().take(seen).map(|lost| u64::from(*lost)).sum::<u64>();
        }
        let mut input = [0.0; BLOCK];
        for i in 0..BLOCK {
            let log = plan.curve(light[i] + dark);
            // The logarithm makes a number of NaN.
            input[i] = if light[i].is_nan() { f32::NAN } else { log };
        }
        let mut output = input;
        let mut turns = [0_u8; BLOCK];
        let (mut most, mut least) = (input, input);
        if plan.rate > 0.0 {
            let y_before = at(&chain.now.first, start, f32::NAN);
            let mut y = [0.0; BLOCK];
            if !plan.exact {
                let mut parts = [0.0; BLOCK];
                for i in 0..BLOCK {
                    let step = dt * plan.rate * plan.bandwidth(light[i] + dark);
                    parts[i] = if step < 1.0 { step } else { 1.0 };
                    let next = y_before[i] + parts[i] * (input[i] - y_before[i]);
                    y[i] = if y_before[i].is_nan() { input[i] } else { next };
                }
                output = y;
                if plan.two_poles {
                    let z_before = at(&chain.now.second, start, f32::NAN);
                    for i in 0..BLOCK {
                        let next = z_before[i] + parts[i] * (y[i] - z_before[i]);
                        output[i] = if z_before[i].is_nan() { input[i] } else { next };
                    }
                    put(&mut chain.next.second, start, &output);
                }
            } else if NOISY {
                let mut course = Course {
                    input: input_before,
                    change: [0.0; BLOCK],
                    rate: [0.0; BLOCK],
                    first: y_before,
                    second: if plan.two_poles { at(&chain.now.second, start, f32::NAN) } else { y_before },
                    most: [f32::NEG_INFINITY; BLOCK],
                    least: [f32::INFINITY; BLOCK],
                };
                for i in 0..BLOCK {
                    let mean = 0.5 * (light_before[i] + light[i]) + dark;
                    course.rate[i] = plan.rate * plan.bandwidth(mean);
                    course.change[i] = input[i] - input_before[i];
                }
                let (numbering, first_pixel) = (interval.numbering, start as u32);
                let when = When { key, numbering, first_pixel, start_us, us: interval.us, rms: plan.noise };
                course.run(&when, plan.two_poles, lags);
                for i in 0..BLOCK {
                    let is_new = input_before[i].is_nan();
                    y[i] = if is_new { input[i] } else { course.first[i] };
                    course.second[i] = if is_new { input[i] } else { course.second[i] };
                    turns[i] = 1;
                }
                (most, least) = (course.most, course.least);
                output = if plan.two_poles { course.second } else { y };
                if plan.two_poles {
                    put(&mut chain.next.second, start, &course.second);
                }
            } else {
                let z_before = if plan.two_poles { at(&chain.now.second, start, f32::NAN) } else { y_before };
                let mut z = [0.0; BLOCK];
                for i in 0..BLOCK {
                    let mean = 0.5 * (light_before[i] + light[i]) + dark;
                    let u = dt * plan.rate * plan.bandwidth(mean);
                    let (one, two, e) = lags(u);
                    let change = input[i] - input_before[i];
                    let behind = y_before[i] - input_before[i];
                    let next = input[i] - change * one + behind * e;
                    let is_new = input_before[i].is_nan();
                    y[i] = if is_new { input[i] } else { next };
                    let next = input[i] + (z_before[i] - input_before[i] + behind * u) * e - change * two;
                    z[i] = if is_new { input[i] } else { next };
                    let (up, down) = (input[i].max(input_before[i]), input[i].min(input_before[i]));
                    let inner = (input_before[i] - y_before[i]) * (input[i] - y[i]) < 0.0;
                    if plan.two_poles {
                        let outer = (y_before[i] - z_before[i]) * (y[i] - z[i]) < 0.0;
                        turns[i] = u8::from(inner | outer);
                        (most[i], least[i]) = (up.max(y_before[i]), down.min(y_before[i]));
                    } else {
                        turns[i] = u8::from(inner);
                        (most[i], least[i]) = (up, down);
                    }
                }
                output = if plan.two_poles { z } else { y };
                if plan.two_poles {
                    put(&mut chain.next.second, start, &z);
                }
            }
            put(&mut chain.next.first, start, &y);
        }
        put(&mut chain.next.input, start, &input);
        put(&mut chain.next.light, start, &light);
        let mut leaked = [0.0; BLOCK];
        if plan.ramp {
            let (moved, slope) = (at(&chain.moved, start, 0), at(&chain.slope, start, 0.0));
            for i in 0..BLOCK {
                leaked[i] = slope[i] * t_end.wrapping_sub(moved[i]) as f32;
                if NOISY {
                    // The least may have been there before anything leaked.
                    least[i] -= slope[i] * dt;
                }
            }
        }
        let mut fires = [0_u8; BLOCK];
        for i in 0..BLOCK {
            let change = output[i] - reference[i] + leaked[i];
            let (high, low) = (most[i] - reference[i] + leaked[i], least[i] - reference[i] + leaked[i]);
            let passes = (turns[i] != 0) & ((high >= on[i]) | (low <= -off[i]));
            let begins = reference[i].is_nan() & !input[i].is_nan();
            fires[i] = u8::from((change + tie >= on[i]) | (change - tie <= -off[i]) | passes | begins);
        }
        let mut mask = bits_of(&fires);
        if seen < BLOCK {
            mask &= (1_u64 << seen).wrapping_sub(1);
        }
        chain.masks[block] = mask;
        if plan.shares_times() {
            while mask != 0 {
                let i = mask.trailing_zeros() as usize % BLOCK;
                mask &= mask.wrapping_sub(1);
                let change = output[i] - reference[i] + leaked[i];
                let steps = (change.abs() + tie) / if change >= 0.0 { on[i] } else { off[i] };
                // Held pixels and new ones have no change to count.
                scan.most = scan.most.max(simd::whole(if steps.is_finite() { steps } else { 0.0 }));
            }
        }
    }
    scan.impossible = impossible != 0;
    scan
}

/// [`scan_body`], with noise of the photoreceptor or without.
#[inline(always)]
fn scan_either(
    plan: &Plan,
    source: &Source<'_>,
    interval: &Interval<'_>,
    when: (Key, i64),
    chain: &mut Chain,
) -> Scan {
    if plan.noise > 0.0 {
        scan_body::<true>(plan, source, interval, when, chain)
    } else {
        scan_body::<false>(plan, source, interval, when, chain)
    }
}

dispatched!(
    /// [`scan_either`].
    fn scan_by(
        plan: &Plan,
        source: &Source<'_>,
        interval: &Interval<'_>,
        when: (Key, i64),
        chain: &mut Chain,
    ) -> Scan = scan_either
);

impl Chain {
    /// First pass; `start_us` is when the interval starts.
    pub fn scan(
        &mut self,
        isa: Isa,
        plan: &Plan,
        source: &Source<'_>,
        interval: &Interval<'_>,
        key: Key,
        start_us: i64,
    ) -> Scan {
        self.tie = if plan.ties { 2.0 * source.tie() } else { 0.0 };
        if plan.redraws {
            // A number of its own for each microsecond of an epoch; 0 is that of the pattern that stays.
            let end_us = start_us + i64::from(interval.us);
            let when = (end_us >> EPOCH_SHIFT, 1 + (end_us as u32 & ((1 << EPOCH_SHIFT) - 1)));
            draw_thresholds(&plan.sensor, key, interval.numbering, (&mut self.on, &mut self.off), when);
        }
        scan_by(isa, plan, source, interval, (key, start_us), self)
    }

    /// Second pass: events of the pixels that could fire or that noise may reach; the samples become the last ones.
    #[expect(clippy::too_many_arguments, reason = "two of them are where events and their causes go")]
    pub fn fire(
        &mut self,
        isa: Isa,
        plan: &Plan,
        interval: &Interval<'_>,
        key: Key,
        (start_us, most): (i64, u32),
        records: &mut Vec<Record>,
        mut causes: Option<&mut Vec<Cause>>,
    ) -> Tally {
        let mut tally = Tally::default();
        let end_us = start_us + i64::from(interval.us);
        let tile = (interval.numbering, interval.end - interval.first);
        if interval.us > 0 {
            self.noise.gather(isa, &plan.sensor.noise, key, tile, (start_us, end_us));
        } else {
            self.noise.now.clear();
        }
        for candidate in &self.noise.now {
            let pixel = candidate.pixel as usize;
            self.masks[pixel / BLOCK] |= 1 << (pixel % BLOCK);
        }
        let candidates = std::mem::take(&mut self.noise.now);
        let mut rest = candidates.as_slice();
        let shared = self.shared(plan, interval, start_us, most);
        for block in 0..self.masks.len() {
            let mut mask = self.masks[block];
            let is_quiet =
                rest.first().is_none_or(|candidate| candidate.pixel as usize >= (block + 1) * BLOCK);
            if let (Some((kind, shared)), true, true) = (&shared, mask != 0, is_quiet)
                && self.fire_block(
                    isa,
                    *kind,
                    shared,
                    plan,
                    block,
                    (&mut tally, records, causes.as_deref_mut()),
                )
            {
                continue;
            }
            while mask != 0 {
                let index = block * BLOCK + mask.trailing_zeros() as usize;
                mask &= mask.wrapping_sub(1);
                let own = rest.iter().take_while(|candidate| candidate.pixel as usize <= index).count();
                let (mine, later) = rest.split_at(own);
                rest = later;
                let pixel = interval.numbering.of(index as u32);
                let y = pixel / interval.width;
                let place = (pixel - y * interval.width, y);
                let mut one = Pixel {
                    plan,
                    key,
                    chain: self,
                    index,
                    pixel,
                    place,
                    start_us,
                    us: interval.us,
                    tally: &mut tally,
                    records,
                    causes: causes.as_deref_mut(),
                };
                one.step(mine, most);
            }
        }
        self.noise.now = candidates;
        self.draw_slopes(isa, plan, key, interval.numbering, end_us);
        if plan.forgets {
            self.reference.copy_from_slice(self.next.output());
            self.moved.fill((end_us - self.base_us) as i32);
        }
        std::mem::swap(&mut self.now, &mut self.next);
        tally
    }
}

/// Where the events of a pass go.
type Sinks<'a> = (&'a mut Tally, &'a mut Vec<Record>, Option<&'a mut Vec<Cause>>);

impl Chain {
    /// What the pixels of an interval share, where [`Plan::plain`] says how to use it.
    fn shared(
        &self,
        plan: &Plan,
        interval: &Interval<'_>,
        start_us: i64,
        most: u32,
    ) -> Option<(Plain, plain::Shared)> {
        let sensor = &plan.sensor;
        let when = match (plan.plain?, sensor.times) {
            (Plain::Lines, _) => Moments::Crossing,
            (Plain::Samples, Times::Shared) => Moments::common(most, interval.us),
            (Plain::Samples, Times::Even) => Moments::Even,
            (Plain::Samples, Times::Crossing | Times::Sample) => Moments::Sample,
        };
        let shared = plain::Shared {
            numbering: interval.numbering,
            width: interval.width,
            us: interval.us,
            since_us: i32::try_from(start_us - self.base_us).ok()?,
            period: sensor.refractory.period_us.into(),
            hidden_moves: sensor.refractory.rule == RefractoryRule::Suppress,
            // Without jitter that is all that is left.
            delay_us: delay_us(&sensor.readout, Key::new(0, 0, 0), 0, 0),
            most_events: sensor.most_events,
            tie: self.tie,
            when,
        };
        Some((plan.plain?, shared))
    }

    /// [`plain`]'s way through a block; whether it could be taken.
    fn fire_block(
        &mut self,
        isa: Isa,
        kind: Plain,
        shared: &plain::Shared,
        plan: &Plan,
        block: usize,
        (tally, records, causes): Sinks<'_>,
    ) -> bool {
        let mask = self.masks[block];
        let (start, end) = (block * BLOCK, (block + 1) * BLOCK);
        let part = start..end;
        let pixels = plain::Pixels {
            first: start as u32,
            on: &self.on[part.clone()],
            off: &self.off[part.clone()],
            before: &self.now.output()[part.clone()],
            after: &self.next.output()[part.clone()],
            reference: &mut self.reference[part.clone()],
            fired: self.fired.get_mut(part.clone()).unwrap_or_default(),
            polarity: self.polarity.get_mut(part.clone()).unwrap_or_default(),
            moved: self.moved.get_mut(part.clone()).unwrap_or_default(),
            slope: self.slope.get(part).unwrap_or_default(),
        };
        let jitters = plan.sensor.noise.leak_jitter > 0.0;
        let moved_last = jitters.then_some(&mut self.moved_last);
        let sink = plain::Sink { tally, records, causes, moved_last };
        match kind {
            Plain::Lines => plain::lines(isa, shared, pixels, mask, sink),
            Plain::Samples => plain::samples(isa, shared, pixels, mask, sink),
        }
    }
}

impl Chain {
    /// Draws the slopes of the pixels whose reference moved at `t_us`, the interval's end.
    fn draw_slopes(&mut self, isa: Isa, plan: &Plan, key: Key, numbering: Numbering, t_us: i64) {
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

/// One pixel in one interval; times are microseconds since its start.
struct Pixel<'a> {
    plan: &'a Plan,
    key: Key,
    chain: &'a mut Chain,
    index: usize,
    /// Index within the image.
    pixel: u32,
    place: (u32, u32),
    start_us: i64,
    us: u32,
    tally: &'a mut Tally,
    records: &'a mut Vec<Record>,
    /// Where they are asked for.
    causes: Option<&'a mut Vec<Cause>>,
}

impl Pixel<'_> {
    fn step(&mut self, candidates: &[Candidate], most: u32) {
        let i = self.index;
        let output = self.chain.next.output()[i];
        let reference = self.chain.reference[i];
        if reference.is_nan() {
            if !output.is_nan() {
                self.begin(output);
            }
            return;
        }
        if self.chain.on[i].is_infinite() {
            return;
        }
        if self.plan.sampled {
            self.sampled(candidates, most);
        } else if self.plan.noise > 0.0 {
            self.noisy(candidates);
        } else {
            let whole = Piece { shape: self.shape(), from: 0.0 };
            self.continuous(&whole, f64::from(self.us), candidates, &mut 0);
        }
    }

    /// The first sample.
    fn begin(&mut self, output: f32) {
        let i = self.index;
        self.chain.reference[i] = match self.plan.sensor.pattern.start {
            Start::Phase if self.chain.on[i].is_finite() => {
                let part = unit_f32(self.key.draw(self.pixel, StreamId::Start, 0, 0)[0]);
                // d = signal - reference lies between the thresholds.
                output - (part * (self.chain.on[i] + self.chain.off[i]) - self.chain.off[i])
            }
            _ => output,
        };
        self.moved_at(f64::from(self.us));
    }

    /// Notes that the reference moved at `t`; the leak's slope is drawn anew.
    fn moved_at(&mut self, t: f64) {
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
    fn moved_at_end(&mut self) {
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
    fn slope(&self) -> f64 {
        if self.plan.ramp { self.chain.slope[self.index].into() } else { 0.0 }
    }

    /// What the leak has added to the signal at the interval's start, less than nothing where the reference moved later.
    fn leaked_at_start(&self) -> f64 {
        if !self.plan.ramp {
            return 0.0;
        }
        let moved = i64::from(self.chain.moved[self.index]) + self.chain.base_us - self.start_us;
        -self.slope() * moved as f64
    }

    fn shape(&self) -> Shape {
        let i = self.index;
        let (now, next) = (&self.chain.now, &self.chain.next);
        let length = f64::from(self.us);
        let input = (f64::from(now.input[i]), f64::from(next.input[i]));
        if now.first.is_empty() {
            return Shape::line(input.0, input.1, length);
        }
        if !self.plan.exact {
            return Shape::line(now.output()[i].into(), next.output()[i].into(), length);
        }
        let tau = 1.0 / f64::from(self.filter_rate());
        let y = f64::from(now.first[i]);
        match now.second.get(i) {
            Some(z) => Shape::two_poles(input, length, tau, y, (*z).into()),
            None => Shape::pole(input, length, tau, y),
        }
    }

    /// Time constants per microsecond.
    fn filter_rate(&self) -> f32 {
        let (before, after) = (self.chain.now.light[self.index], self.chain.next.light[self.index]);
        let mean = 0.5 * (before + after) + self.plan.sensor.photoreceptor.dark_light;
        self.plan.rate * self.plan.bandwidth(mean)
    }

    fn light_at(&self, t: f64) -> f64 {
        let i = self.index;
        let (before, after) = (f64::from(self.chain.now.light[i]), f64::from(self.chain.next.light[i]));
        let part = if self.us > 0 { t / f64::from(self.us) } else { 1.0 };
        before + (after - before) * part
    }

    /// When the pixel last fired, since the interval's start; long ago without a refractory period.
    fn fired(&self) -> f64 {
        match self.chain.fired.get(self.index) {
            Some(fired) if self.plan.sensor.refractory.period_us > 0 => {
                (i64::from(*fired) + self.chain.base_us - self.start_us) as f64
            }
            _ => f64::NEG_INFINITY,
        }
    }

    fn period(&self) -> f64 {
        self.plan.sensor.refractory.period_us.into()
    }

    /// Whether an event at `t` is within the refractory period.
    fn is_refractory(&self, t: f64) -> bool {
        t - self.fired() < self.period()
    }

    /// Writes an event.
    fn emit(&mut self, t: f64, polarity: Polarity, cause: Cause) {
        let offset = (t as u32).clamp(1, self.us.max(1));
        let (x, y) = self.place;
        let left = offset + self.light_delay(t);
        let t_us = self.start_us + i64::from(left);
        let delay = delay_us(&self.plan.sensor.readout, self.key, self.pixel, t_us);
        self.records.push(Record::new(left + delay, x, y, polarity));
        if let Some(causes) = &mut self.causes {
            causes.push(cause);
        }
        if let Some(fired) = self.chain.fired.get_mut(self.index) {
            *fired = (self.start_us + i64::from(offset) - self.chain.base_us) as i32;
        }
        if let Some(last) = self.chain.polarity.get_mut(self.index) {
            *last = u8::from(polarity == Polarity::On);
        }
    }

    /// Delay of an event at `t` within the pixel, whole microseconds: the part of the latency that light has.
    fn light_delay(&self, t: f64) -> u32 {
        let latency = self.plan.sensor.readout.latency_light_us;
        if latency == 0.0 {
            return 0;
        }
        let light = self.light_at(t) as f32 + self.plan.sensor.photoreceptor.dark_light;
        (latency / light.max(0.01)) as u32
    }

    /// What a candidate of noise becomes at its time.
    fn decide(&self, candidate: &Candidate) -> Option<(Polarity, Cause)> {
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
    fn noise(&mut self, candidate: &Candidate, signal: f64) -> bool {
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

    /// [`Self::continuous`], cut where the photoreceptor's noise bends.
    fn noisy(&mut self, candidates: &[Candidate]) {
        let i = self.index;
        let rate = self.filter_rate();
        let (tau, shift) = (1.0 / f64::from(rate), shift_of(1.0 / rate, self.plan.two_poles));
        let gain = self.plan.noise * gain_of(rate * (1_u32 << shift) as f32, self.plan.two_poles);
        let start = f64::from(self.chain.now.input[i]);
        let slope = (f64::from(self.chain.next.input[i]) - start) / f64::from(self.us);
        let mut y = f64::from(self.chain.now.first[i]);
        let mut z = self.chain.now.second.get(i).copied().map(f64::from);
        let mut rest = candidates;
        let mut count = 0;
        let (key, pixel) = (self.key, self.pixel);
        let draw = |knot: i64| knots_of(key, pixel, knot, shift);
        let mut group = draw(self.start_us >> shift);
        for cell in cells(self.start_us, self.us, shift) {
            let left = group[(cell.knot & 3) as usize];
            // Four at a time.
            if (cell.knot + 1) & 3 == 0 {
                group = draw(cell.knot + 1);
            }
            let after = group[((cell.knot + 1) & 3) as usize];
            let (from, to) = (f64::from(cell.from), f64::from(cell.to));
            let noise = |part: f32| f64::from(gain) * f64::from(left + (after - left) * part);
            let input = (start + slope * from + noise(cell.part.0), start + slope * to + noise(cell.part.1));
            let pole = Shape::pole(input, to - from, tau, y);
            let shape = z.map_or(pole, |z| Shape::two_poles(input, to - from, tau, y, z));
            let end_us = self.start_us + i64::from(cell.to);
            let (own, later) = rest.split_at(rest.partition_point(|candidate| candidate.t_us <= end_us));
            rest = later;
            let next = pole.at(to - from);
            // As the first pass has it: most pieces stay between the thresholds.
            let bend = 0.5 * (to - from) / tau * (input.0 - y);
            let (mut up, mut down) = (next.max(y + bend.max(0.0)), next.min(y + bend.min(0.0)));
            if let Some(z) = &mut z {
                let (u, after) = ((to - from) / tau, shape.at(to - from));
                (up, down) = (*z + (u * (up - *z)).max(0.0), *z + (u * (down - *z)).min(0.0));
                (up, down) = (up.max(after), down.min(after));
                *z = after;
            }
            y = next;
            let (drift, change) = (self.slope(), self.leaked_at_start() - f64::from(self.chain.reference[i]));
            let fires = up + drift * to + change >= self.chain.on[i].into()
                || down + drift * from + change <= -f64::from(self.chain.off[i]);
            let is_held = self.chain.reference[i].is_infinite();
            if (fires || is_held || !own.is_empty())
                && !self.continuous(&Piece { shape, from }, to, own, &mut count)
            {
                return;
            }
        }
    }

    /// Crossings at their own times, and noise between them, of a piece that ends at `end`; `count` is of those in the
    /// interval. Whether the pixel may still fire in it.
    fn continuous(&mut self, piece: &Piece, end: f64, candidates: &[Candidate], count: &mut u32) -> bool {
        let i = self.index;
        let rule = self.plan.sensor.refractory.rule;
        let holds = rule == RefractoryRule::Hold && self.period() > 0.0;
        let defers = rule == RefractoryRule::Defer && self.period() > 0.0;
        let (on, off) = (f64::from(self.chain.on[i]), f64::from(self.chain.off[i]));
        let mut candidates = candidates.iter().peekable();
        let mut t = piece.from;
        if self.chain.reference[i].is_infinite() {
            match self.held(piece, end) {
                Some(released) => t = released,
                None => return true,
            }
        }
        loop {
            let reference = f64::from(self.chain.reference[i]);
            // signal + leak = piece(t) + drift t + leaked, against the reference.
            let (drift, leaked) = (self.slope(), self.leaked_at_start());
            let from = if defers { (self.fired() + self.period()).max(t) } else { t };
            let (low, high) = (reference - off - leaked, reference + on - leaked);
            let crossing = if from <= end { piece.leaves(drift, low, high, from, end) } else { None };
            let tied =
                if crossing.is_none() && from <= end { self.tied(piece, end, (low, high)) } else { None };
            let crossing = crossing.or(tied);
            let next_noise = candidates.peek().map(|candidate| (candidate.t_us - self.start_us) as f64);
            match (crossing, next_noise) {
                (None, None) => return true,
                (crossing, Some(at)) if crossing.is_none_or(|(first, _)| at <= first) => {
                    let Some(candidate) = candidates.next() else { return true };
                    // A held pixel hears nothing.
                    if at < t {
                        continue;
                    }
                    t = at;
                    let fired = self.noise(candidate, piece.at(at));
                    if fired && holds {
                        match self.held(piece, end) {
                            Some(released) => t = released,
                            None => return true,
                        }
                    }
                }
                (Some((at, rises)), _) => {
                    t = at;
                    *count += 1;
                    let polarity = if rises { Polarity::On } else { Polarity::Off };
                    if self.is_refractory(at) {
                        self.tally.suppressed += 1;
                    } else {
                        self.emit(at, polarity, cause_of(rises, leaked + drift * at, on));
                    }
                    if *count > self.plan.sensor.most_events {
                        self.tally.clamped += 1;
                        self.chain.reference[i] = self.chain.next.output()[i];
                        self.moved_at(f64::from(self.us));
                        return false;
                    }
                    if holds {
                        match self.held(piece, end) {
                            Some(released) => t = released,
                            None => return true,
                        }
                        continue;
                    }
                    let step = if rises { on } else { -off };
                    self.chain.reference[i] = (reference - (leaked + drift * at) + step) as f32;
                    if tied.is_some() {
                        self.chain.reference[i] = self.chain.next.output()[i];
                    }
                    self.moved_at(at);
                }
                (None, Some(_)) => return true,
            }
        }
    }

    /// The interval's end, and whether it is above, where its signal is on a level but for rounding.
    fn tied(&self, piece: &Piece, end: f64, (low, high): (f64, f64)) -> Option<(f64, bool)> {
        let tie = f64::from(self.chain.tie);
        if tie == 0.0 || end < f64::from(self.us) {
            return None;
        }
        let value = piece.at(end) + self.slope() * end;
        if value + tie >= high {
            Some((end, true))
        } else if value - tie <= low {
            Some((end, false))
        } else {
            None
        }
    }

    /// Holds the pixel for its refractory period; when it is released, if that is before `end`.
    fn held(&mut self, piece: &Piece, end: f64) -> Option<f64> {
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

    /// The rules of other simulators: decided at the sample, times by rule.
    fn sampled(&mut self, candidates: &[Candidate], most: u32) {
        let i = self.index;
        let sensor = &self.plan.sensor;
        let end = f64::from(self.us);
        let output = self.chain.next.output()[i];
        let before = self.chain.now.output()[i];
        let signal_at = |t: f64| f64::from(before) + f64::from(output - before) * t / end;
        if self.chain.reference[i].is_infinite() {
            if self.fired() + self.period() > end {
                return;
            }
            self.chain.reference[i] = output;
            self.moved_at_end();
            return;
        }
        let (on, off) = (self.chain.on[i], self.chain.off[i]);
        let leaked = (self.leaked_at_start() + self.slope() * end) as f32;
        let change = output - self.chain.reference[i] + leaked;
        let (polarity, step) = if change >= 0.0 { (Polarity::On, on) } else { (Polarity::Off, off) };
        let latch = sensor.trigger == TriggerRule::Latch;
        let tie = self.chain.tie;
        let mut steps = simd::whole((change.abs() + tie) / step);
        if self.plan.forgets && change.abs() <= step {
            steps = 0;
        }
        let number = steps.min(if latch { 1 } else { sensor.most_events });
        let mut rest = candidates;
        let (mut fired, mut noisy) = (0, false);
        for k in 1..=number {
            let t = match sensor.times {
                _ if latch => end,
                Times::Crossing if self.plan.forgets => {
                    end * (f64::from(k) * f64::from(step) / f64::from(change.abs())).min(1.0)
                }
                Times::Sample | Times::Crossing => end,
                Times::Even => end * f64::from(k) / f64::from(number),
                Times::Shared => end * f64::from(k) / f64::from(most.max(number)),
            };
            while let Some((candidate, later)) = rest.split_first() {
                let at = (candidate.t_us - self.start_us) as f64;
                if at > t {
                    break;
                }
                noisy |= self.noise(candidate, signal_at(at));
                rest = later;
            }
            let silent = self.is_refractory(t);
            self.tally.suppressed += u64::from(silent);
            if !silent {
                self.emit(t, polarity, cause_of(change >= 0.0, leaked.into(), f64::from(change)));
            }
            fired += u32::from(!silent || sensor.refractory.rule == RefractoryRule::Suppress);
        }
        for candidate in rest {
            noisy |= self.noise(candidate, signal_at((candidate.t_us - self.start_us) as f64));
        }
        if noisy && sensor.noise.reference == NoiseReference::Signal {
            // As v2e: the sample is memorised, whatever else the pixel fired.
            self.tally.clamped += u64::from(!latch && steps > number);
            self.chain.reference[i] = output;
            self.moved_at_end();
            return;
        }
        if number == 0 {
            return;
        }
        let holds = sensor.refractory.rule == RefractoryRule::Hold && self.period() > 0.0;
        if holds {
            self.chain.reference[i] = if self.fired() + self.period() > end { f32::INFINITY } else { output };
            self.moved_at_end();
        } else if latch {
            if fired > 0 {
                self.chain.reference[i] = output;
                self.moved_at_end();
            }
        } else if steps > number {
            self.tally.clamped += 1;
            self.chain.reference[i] = output;
            self.moved_at_end();
        } else if fired > 0 {
            let moved = fired as f32 * step;
            let sign = if polarity == Polarity::On { 1.0 } else { -1.0 };
            let next = self.chain.reference[i] + (sign * moved - leaked);
            let is_tied = fired == steps && (next - output).abs() <= tie;
            self.chain.reference[i] = if is_tied { output } else { next };
            self.moved_at_end();
        }
    }
}

/// Why a threshold was reached: by a rise of which the leak's ramp is at least half, or by light. Twin: `cause_of` in
/// `shaders/chain/pixel.wgsl`.
fn cause_of(rises: bool, leaked: f64, rise: f64) -> Cause {
    if rises && leaked >= 0.5 * rise && leaked > 0.0 { Cause::Leak } else { Cause::Signal }
}

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
