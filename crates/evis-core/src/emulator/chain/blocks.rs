//! Blocks of pixels that light alone moves: treated together, where settings allow it.

use super::memory::Chain;
use super::plan::{Plain, Plan};
use crate::emulator::frames::BLOCK;
use crate::emulator::ideal::{Interval, Tally};
use crate::emulator::order::Record;
use crate::emulator::plain::{self, Moments};
use crate::emulator::readout::delay_us;
use crate::event::Cause;
use crate::random::Key;
use crate::sensor::{RefractoryRule, Times};
use crate::simd::Isa;

/// Where the events of a pass go.
pub(super) type Sinks<'a> = (&'a mut Tally, &'a mut Vec<Record>, Option<&'a mut Vec<Cause>>);

impl Chain {
    /// What the pixels of an interval share, where [`Plan::plain`] says how to use it.
    #[inline]
    pub(super) fn shared(
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
    #[inline]
    pub(super) fn fire_block(
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
