//! Frames of light in the place of light: an exposure under way is a sum per pixel, and a frame when it ends.

use super::frames::{BLOCK, Source};
use super::workers::Threads;
use super::{EmulatorReport, Environment, Push, TILE};
use crate::event::Event;

/// What an environment whose pixels see frames remembers of light, `Y / Y_ref`.
#[derive(Clone, Debug)]
pub(crate) struct Exposing {
    /// When its first light came, since the start or the last reset: exposures that begin earlier are not made.
    pub since_us: Option<i64>,
    /// Light at the last sample; NaN where unknown.
    pub last: Vec<f32>,
    /// Light at the sample that is being pushed.
    next: Vec<f32>,
    /// Of the exposure under way, the part that is over: the integral of light by its weight. NaN where light was unknown,
    /// at however short a part of it.
    pub sum: Vec<f64>,
    frame: Vec<f32>,
}

impl Exposing {
    pub fn new(pixels: usize) -> Self {
        Self {
            since_us: None,
            last: vec![0.0; pixels],
            next: vec![0.0; pixels],
            sum: vec![0.0; pixels],
            frame: vec![0.0; pixels],
        }
    }

    /// Reads the sample that is being pushed, and says whether it is light: nothing that outlives a push changes.
    pub fn load(&mut self, threads: Threads<'_>, source: &Source<'_>, eps: f32) -> bool {
        let mut parts: Vec<_> = self.next.chunks_mut(TILE).map(|next| (next, true)).enumerate().collect();
        threads.each(&mut parts, |(index, (next, is_light))| {
            for (block, next) in next.chunks_mut(BLOCK).enumerate() {
                let mut light = [f32::NAN; BLOCK];
                source.load_light(*index * TILE + block * BLOCK, eps, &mut light);
                let own = &light[..next.len()];
                *is_light &= !own.iter().any(|light| *light < 0.0 || *light > f32::MAX);
                next.copy_from_slice(own);
            }
        });
        parts.iter().all(|(_, (_, is_light))| *is_light)
    }

    /// Adds `[before, after]` of the last and the next light to the exposure under way; where that ends, its frame is made.
    fn add(&mut self, threads: Threads<'_>, [before, after]: [f64; 2], ends: bool) {
        let samples = self.last.chunks(TILE).zip(self.next.chunks(TILE));
        let sums = self.sum.chunks_mut(TILE).zip(self.frame.chunks_mut(TILE));
        let mut parts: Vec<_> = samples.zip(sums).collect();
        threads.each(&mut parts, |((last, next), (sum, frame))| {
            for ((sum, last), next) in sum.iter_mut().zip(*last).zip(*next) {
                *sum += before * f64::from(*last) + after * f64::from(*next);
            }
            if ends {
                for (frame, sum) in frame.iter_mut().zip(sum.iter_mut()) {
                    *frame = std::mem::take(sum) as f32;
                }
            }
        });
    }
}

impl Environment {
    /// Takes the sample that [`Exposing::load`] has read, of the end of `work`'s interval: light is straight since the last
    /// one. What pixels make of the frames that are complete with it goes to `events`.
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
