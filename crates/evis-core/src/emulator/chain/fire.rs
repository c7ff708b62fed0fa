//! Second pass: the pixels that could fire, one at a time.

use super::memory::Chain;
use super::pixel::Pixel;
use super::plan::Plan;
use crate::emulator::frames::BLOCK;
use crate::emulator::ideal::{Interval, Tally};
use crate::emulator::noise::Candidate;
use crate::emulator::order::Record;
use crate::emulator::shape::Piece;
use crate::event::Cause;
use crate::random::{Key, StreamId, unit_f32};
use crate::sensor::Start;
use crate::simd::Isa;

impl Chain {
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

impl Pixel<'_> {
    /// The interval of one pixel; `most`: events of the pixel that fires most, where times are shared.
    #[inline]
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
    #[inline]
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
}
