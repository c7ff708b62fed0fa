//! One pixel of the second pass: crossings of its signal and candidates of noise, in the order in which they happen.

use super::jitter::jitter_at;
use super::memory::Chain;
use super::plan::Plan;
use crate::emulator::ideal::Tally;
use crate::emulator::noise::Candidate;
use crate::emulator::order::Record;
use crate::emulator::readout::delay_us;
use crate::emulator::receptor::{cells, gain_of, knots_of, shift_of};
use crate::emulator::shape::{Piece, Shape};
use crate::event::{Cause, Polarity};
use crate::random::{Key, StreamId, unit_f32};
use crate::sensor::{NoiseReference, RefractoryRule, Start, Times, TriggerRule};
use crate::simd;

/// One pixel in one interval; times are microseconds since its start.
pub(super) struct Pixel<'a> {
    pub plan: &'a Plan,
    pub key: Key,
    pub chain: &'a mut Chain,
    pub index: usize,
    /// Index within the image.
    pub pixel: u32,
    pub place: (u32, u32),
    pub start_us: i64,
    pub us: u32,
    pub tally: &'a mut Tally,
    pub records: &'a mut Vec<Record>,
    /// Where they are asked for.
    pub causes: Option<&'a mut Vec<Cause>>,
}

impl Pixel<'_> {
    pub fn step(&mut self, candidates: &[Candidate], most: u32) {
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

    /// Notes that the reference moved at `t`; the leak's slope is drawn again.
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

    /// When the pixel last fired, since the interval's start.
    fn fired(&self) -> f64 {
        match self.chain.fired.get(self.index) {
            Some(fired) => (i64::from(*fired) + self.chain.base_us - self.start_us) as f64,
            None => f64::NEG_INFINITY,
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
