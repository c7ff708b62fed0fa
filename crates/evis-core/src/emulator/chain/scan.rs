//! First pass: the signal of all pixels at the interval's end, and which of them could fire.

use super::memory::{Chain, at, put};
use super::pattern::draw_thresholds;
use super::photoreceptor::{self, Samples, Signal};
use super::plan::Plan;
use crate::emulator::frames::{BLOCK, Source};
use crate::emulator::ideal::Interval;
use crate::emulator::receptor::When;
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

/// The samples at the interval's end, and who could fire; changes nothing that outlives a push.
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
    let dark = plan.sensor.photoreceptor.dark_light;
    let dt = interval.us as f32;
    let tie = chain.tie;
    let mut impossible = 0;
    for block in 0..chain.masks.len() {
        let start = block * BLOCK;
        let first = interval.first.wrapping_add(start);
        let seen = interval.end.saturating_sub(first).min(BLOCK);

        // Light. Pixels whose light is unknown keep what they saw.
        let mut light = [f32::NAN; BLOCK];
        source.load_light(first, plan.sensor.log_eps, &mut light);
        let light_before = at(&chain.now.light, start, f32::NAN);
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

        // Logarithm.
        let mut input = [0.0; BLOCK];
        for i in 0..BLOCK {
            let log = plan.curve(light[i] + dark);
            // The logarithm makes a number of NaN.
            input[i] = if light[i].is_nan() { f32::NAN } else { log };
        }

        // Low-pass.
        let mut signal = Signal::unfiltered(&input);
        if plan.rate > 0.0 {
            let samples = Samples { start, dt, light: &light, light_before: &light_before, input: &input };
            if !plan.exact {
                photoreceptor::euler(plan, &samples, chain, &mut signal);
            } else if NOISY {
                let (numbering, first_pixel) = (interval.numbering, start as u32);
                let when = When { key, numbering, first_pixel, start_us, us: interval.us, rms: plan.noise };
                photoreceptor::exact_with_noise(plan, &samples, &when, chain, &mut signal);
            } else {
                photoreceptor::exact(plan, &samples, chain, &mut signal);
            }
        }
        put(&mut chain.next.input, start, &input);
        put(&mut chain.next.light, start, &light);

        // Leak.
        let mut leaked = [0.0; BLOCK];
        if plan.ramp {
            let (moved, slope) = (at(&chain.moved, start, 0), at(&chain.slope, start, 0.0));
            for i in 0..BLOCK {
                leaked[i] = slope[i] * t_end.wrapping_sub(moved[i]) as f32;
                if NOISY {
                    // The least may have been there before anything leaked.
                    signal.least[i] -= slope[i] * dt;
                }
            }
        }

        // Thresholds.
        let reference = at(&chain.reference, start, f32::NAN);
        let (on, off) = (at(&chain.on, start, 1.0), at(&chain.off, start, 1.0));
        let Signal { output, turns, most, least } = &signal;
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

        // Times that all pixels share take the greatest number of events.
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
