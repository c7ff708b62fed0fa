//! Second pass: events of the pixels that could fire or that noise may reach.

use super::jitter::jitters_by;
use super::memory::Chain;
use super::pixel::Pixel;
use super::plan::Plan;
use crate::emulator::frames::BLOCK;
use crate::emulator::ideal::{Interval, Tally};
use crate::emulator::numbering::Numbering;
use crate::emulator::order::Record;
use crate::event::Cause;
use crate::random::Key;
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
        for block in 0..self.masks.len() {
            let mut mask = self.masks[block];
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
