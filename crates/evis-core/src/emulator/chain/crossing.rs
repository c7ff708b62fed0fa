//! The trigger in continuous time: crossings of the signal, and noise between them.

use super::leak::cause_of;
use super::pixel::Pixel;
use crate::emulator::noise::Candidate;
use crate::emulator::receptor::{cells, gain_of, knots_of, shift_of};
use crate::emulator::shape::{Piece, Shape};
use crate::event::Polarity;
use crate::sensor::RefractoryRule;

impl Pixel<'_> {
    /// [`Self::continuous`], cut where the photoreceptor's noise bends.
    pub(super) fn noisy(&mut self, candidates: &[Candidate]) {
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
    pub(super) fn continuous(
        &mut self,
        piece: &Piece,
        end: f64,
        candidates: &[Candidate],
        count: &mut u32,
    ) -> bool {
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
    #[inline]
    pub(super) fn tied(&self, piece: &Piece, end: f64, (low, high): (f64, f64)) -> Option<(f64, bool)> {
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
}
