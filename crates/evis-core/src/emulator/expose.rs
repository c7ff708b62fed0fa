//! Pixels that see frames: exposures become frames, and frames events.

use super::frames::Source;
use super::{EmulatorReport, Environment, Push};
use crate::event::Event;

impl Environment {
    /// Takes the sample that [`Exposing::load`] has read, of the end of `work`'s interval: light is straight since the last
    /// one. What pixels make of the frames that are complete with it goes to `events`.
    ///
    /// [`Exposing::load`]: super::exposing::Exposing::load
    pub(super) fn expose(&mut self, work: &Push<'_>, events: &mut Vec<Event>) {
        let mut report = EmulatorReport::default();
        // The light is taken out while the sensor model reads a frame.
        let Some(mut light) = self.exposing.take() else { return };
        let (from_us, to_us) = (work.start_us, work.start_us + i64::from(work.interval_us));
        if light.since_us.is_none() {
            light.sum.fill(0.0);
        }
        let since_us = *light.since_us.get_or_insert(to_us);
        let exposure = &work.config.sensor.exposure;
        let first = exposure.first_from(since_us);
        // The one under way, or the first that is made.
        let mut k = exposure.first_from(from_us.saturating_sub(i64::from(exposure.time_us) - 1)).max(first);
        while since_us < to_us && exposure.start_us(k) < to_us {
            let (start_us, end_us) = (exposure.start_us(k), exposure.end_us(k));
            let (a, b) = (start_us.max(from_us), end_us.min(to_us));
            let time = f64::from(exposure.time_us);
            let place = |t_us: i64| (t_us - start_us) as f64 / time;
            // The integrals over [a, b] of 1 and of the time since a, in exposures.
            let area = place(b) - place(a);
            let lever = 0.5 * area * area;
            // How far the light has gone from the last sample to the next one.
            let after = ((a - from_us) as f64 * area + time * lever) / (to_us - from_us) as f64;
            light.add(work.threads, [area - after, after], end_us <= to_us);
            if end_us <= to_us {
                let before_us = if k > first { exposure.middle_us(k - 1) } else { exposure.middle_us(k) };
                let push = Push {
                    start_us: before_us,
                    // At most a period.
                    interval_us: (exposure.middle_us(k) - before_us) as u32,
                    ..*work
                };
                let frame = Source::Linear { values: &light.frame, inverse_reference: 1.0 };
                self.sense(&push, frame, events);
                report.add(&self.report);
            }
            k += 1;
        }
        std::mem::swap(&mut light.last, &mut light.next);
        self.exposing = Some(light);
        self.report = report;
    }
}
