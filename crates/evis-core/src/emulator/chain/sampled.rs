//! The trigger of other simulators: decided at samples, with times by a rule.

use super::leak::cause_of;
use super::pixel::Pixel;
use crate::emulator::noise::Candidate;
use crate::event::Polarity;
use crate::sensor::{NoiseReference, RefractoryRule, Times, TriggerRule};
use crate::simd;

impl Pixel<'_> {
    /// The rules of other simulators: decided at the sample, times by rule.
    pub(super) fn sampled(&mut self, candidates: &[Candidate], most: u32) {
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
