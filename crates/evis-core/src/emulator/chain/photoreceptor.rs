//! The photoreceptor's low-pass, for 64 pixels over an interval in which the logarithm of light is straight.
//!
//! The functions are compiled into the first pass, once for each instruction set.

use super::memory::{Chain, at, put};
use super::plan::Plan;
use crate::emulator::frames::BLOCK;
use crate::emulator::receptor::{Course, When};
use crate::simd;

/// What comes in.
pub(super) struct Samples<'a> {
    /// First pixel of the block.
    pub start: usize,
    /// Length of the interval in microseconds.
    pub dt: f32,
    /// Light at its end and start.
    pub light: &'a [f32; BLOCK],
    pub light_before: &'a [f32; BLOCK],
    /// Log units at its end.
    pub input: &'a [f32; BLOCK],
}

/// What the trigger sees.
pub(super) struct Signal {
    /// At the interval's end.
    pub output: [f32; BLOCK],
    /// Whether the output may turn within the interval.
    pub turns: [u8; BLOCK],
    /// What it stays between then.
    pub most: [f32; BLOCK],
    pub least: [f32; BLOCK],
}

impl Signal {
    /// Without a low-pass.
    #[inline(always)]
    pub fn unfiltered(input: &[f32; BLOCK]) -> Self {
        Self { output: *input, turns: [0; BLOCK], most: *input, least: *input }
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

/// Steps of Euler's method.
#[inline(always)]
pub(super) fn euler(plan: &Plan, samples: &Samples<'_>, chain: &mut Chain, signal: &mut Signal) {
    let Samples { start, dt, light, input, .. } = *samples;
    let dark = plan.sensor.photoreceptor.dark_light;
    let y_before = at(&chain.now.first, start, f32::NAN);
    let (mut y, mut parts) = ([0.0; BLOCK], [0.0; BLOCK]);
    for i in 0..BLOCK {
        let step = dt * plan.rate * plan.bandwidth(light[i] + dark);
        parts[i] = if step < 1.0 { step } else { 1.0 };
        let next = y_before[i] + parts[i] * (input[i] - y_before[i]);
        y[i] = if y_before[i].is_nan() { input[i] } else { next };
    }
    put(&mut chain.next.first, start, &y);
    signal.output = y;
    if plan.two_poles {
        let z_before = at(&chain.now.second, start, f32::NAN);
        for i in 0..BLOCK {
            let next = z_before[i] + parts[i] * (y[i] - z_before[i]);
            signal.output[i] = if z_before[i].is_nan() { input[i] } else { next };
        }
        put(&mut chain.next.second, start, &signal.output);
    }
}

/// The exact answer to straight input.
#[inline(always)]
pub(super) fn exact(plan: &Plan, samples: &Samples<'_>, chain: &mut Chain, signal: &mut Signal) {
    let Samples { start, dt, light, light_before, input } = *samples;
    let dark = plan.sensor.photoreceptor.dark_light;
    let input_before = at(&chain.now.input, start, f32::NAN);
    let y_before = at(&chain.now.first, start, f32::NAN);
    let z_before = if plan.two_poles { at(&chain.now.second, start, f32::NAN) } else { y_before };
    let (mut y, mut z) = ([0.0; BLOCK], [0.0; BLOCK]);
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
            signal.turns[i] = u8::from(inner | outer);
            (signal.most[i], signal.least[i]) = (up.max(y_before[i]), down.min(y_before[i]));
        } else {
            signal.turns[i] = u8::from(inner);
            (signal.most[i], signal.least[i]) = (up, down);
        }
    }
    put(&mut chain.next.first, start, &y);
    signal.output = y;
    if plan.two_poles {
        put(&mut chain.next.second, start, &z);
        signal.output = z;
    }
}

/// The exact answer to straight input and noise.
#[inline(always)]
pub(super) fn exact_with_noise(
    plan: &Plan,
    samples: &Samples<'_>,
    when: &When,
    chain: &mut Chain,
    signal: &mut Signal,
) {
    let Samples { start, light, light_before, input, .. } = *samples;
    let dark = plan.sensor.photoreceptor.dark_light;
    let input_before = at(&chain.now.input, start, f32::NAN);
    let y_before = at(&chain.now.first, start, f32::NAN);
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
    course.run(when, plan.two_poles, lags);
    let mut y = [0.0; BLOCK];
    for i in 0..BLOCK {
        let is_new = input_before[i].is_nan();
        y[i] = if is_new { input[i] } else { course.first[i] };
        course.second[i] = if is_new { input[i] } else { course.second[i] };
        signal.turns[i] = 1;
    }
    (signal.most, signal.least) = (course.most, course.least);
    put(&mut chain.next.first, start, &y);
    signal.output = y;
    if plan.two_poles {
        put(&mut chain.next.second, start, &course.second);
        signal.output = course.second;
    }
}
