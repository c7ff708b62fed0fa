//! First pass: the signals at the interval's end, 64 pixels at a time, and which pixels could fire.

use super::frozen::draw_thresholds;
use super::memory::Chain;
use super::plan::Plan;
use crate::emulator::frames::{BLOCK, Source};
use crate::emulator::ideal::Interval;
use crate::emulator::receptor::{Course, When};
use crate::random::{EPOCH_SHIFT, Key};
use crate::simd::{self, Isa, bits_of, dispatched};

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
}
