//! One pixel: everything that the score counts there.

use super::by_pixel::{Known, Mark};
use super::chance::{PixelEvents, TruthDetail, chance_shift};
use super::matching::{Matcher, Scaled};
use super::phase::Phase;
use super::tally::Tally;
use crate::truth::{Region, RegionSpan, Truth};

/// Buffers that are used again.
#[derive(Default)]
pub(super) struct Scratch {
    matcher: Matcher,
    windows: Scaled,
    stream: Side,
    shifted: Vec<i64>,
    truth: Vec<i64>,
    known: Vec<TruthDetail>,
}

/// Events of one polarity.
#[derive(Default)]
struct Side {
    t_us: Vec<i64>,
    region: Vec<Region>,
}

/// Scores pixel `pixel` of the truth.
pub(super) fn score_pixel(
    truth: &Truth,
    pixel: usize,
    stream: &[Mark],
    known: &[Known],
    scratch: &mut Scratch,
    tally: &mut Tally,
) {
    tally.sequence(
        stream.is_empty() && known.is_empty(),
        stream.iter().map(|m| m.is_on()).eq(known.iter().map(|k| k.mark.is_on())),
    );
    if stream.is_empty() && known.is_empty() {
        return;
    }
    Phase::add(&mut tally.phase, stream, known);
    let shift_us = chance_shift(truth, pixel);
    for on in [true, false] {
        scratch.take_stream(truth, pixel, stream, on);
        scratch.take_truth(known, on);
        scratch.shift(truth.duration_us, shift_us);
        let Scratch { matcher, windows, stream, shifted, truth, known } = &mut *scratch;
        tally.regions(&stream.region, known);
        let events = PixelEvents { stream: &stream.t_us, regions: &stream.region, shifted, truth, known };
        for level in &mut tally.levels {
            level.add(matcher, windows, &events);
        }
    }
    tally.cut_clusters += std::mem::take(&mut scratch.matcher.cut_clusters);
}

impl Scratch {
    fn take_stream(&mut self, truth: &Truth, pixel: usize, stream: &[Mark], on: bool) {
        let mut regions = Regions::of(truth, pixel);
        self.stream.t_us.clear();
        self.stream.region.clear();
        for mark in stream.iter().filter(|m| m.is_on() == on) {
            self.stream.t_us.push(mark.t_us());
            self.stream.region.push(regions.at(mark.t_us()));
        }
    }

    fn take_truth(&mut self, known: &[Known], on: bool) {
        self.truth.clear();
        self.known.clear();
        for (i, k) in known.iter().enumerate().filter(|(_, k)| k.mark.is_on() == on) {
            let distance = |other: Option<usize>| {
                other.and_then(|o| known.get(o)).map(|o| (o.mark.t_us() - k.mark.t_us()).abs().max(1))
            };
            let interval_us =
                [distance(i.checked_sub(1)), distance(Some(i + 1))].into_iter().flatten().min().unwrap_or(0);
            self.truth.push(k.mark.t_us());
            self.known.push(TruthDetail { scale: k.scale, region: k.region, interval_us });
        }
    }

    /// The stream's times, later by `shift_us`; what leaves at the end comes in at the start.
    fn shift(&mut self, duration_us: i64, shift_us: i64) {
        let times = &self.stream.t_us;
        let (stays, wraps) = times.split_at(times.partition_point(|t| t + shift_us < duration_us));
        self.shifted.clear();
        self.shifted.extend(wraps.iter().map(|t| t + shift_us - duration_us));
        self.shifted.extend(stays.iter().map(|t| t + shift_us));
    }
}

/// Walks through a pixel's regions in order of time.
struct Regions<'a> {
    now: Region,
    next: &'a [RegionSpan],
}

impl<'a> Regions<'a> {
    fn of(truth: &'a Truth, pixel: usize) -> Self {
        let next = match (truth.span_start.get(pixel), truth.span_start.get(pixel + 1)) {
            (Some(&from), Some(&to)) => truth.spans.get(from as usize..to as usize).unwrap_or_default(),
            _ => &[],
        };
        Self { now: Region::Interior, next }
    }

    /// [`Truth::region_at`] for times that never go back.
    fn at(&mut self, t_us: i64) -> Region {
        while let [first, rest @ ..] = self.next
            && first.t_us <= t_us
        {
            (self.now, self.next) = (first.region, rest);
        }
        self.now
    }
}
