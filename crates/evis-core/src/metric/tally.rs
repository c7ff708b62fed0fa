//! Counts over all pixels, and what they become in the end.

use super::by_pixel::{ByPixel, Mark};
use super::chance::{PixelEvents, TruthDetail, chance_shifts};
use super::matching::{Matcher, Plain, Scaled, count_pairs};
use super::phase::Phase;
use super::{MatchScore, RegionScore, Score, ScoreSettings, TimeError, ToleranceScore};
use crate::truth::{Region, Truth};

/// Bits of an f32 that a ratio's bin leaves out: eight bits of its fraction stay, one part in 256.
const RATIO_BITS: u32 = 15;

/// Everything that is counted.
pub(super) struct Tally {
    pub levels: Vec<Level>,
    pub phase: Phase,
    pub cut_clusters: u64,
    /// Truth events by region.
    truth: [u64; 4],
    /// Events of the stream by where their pixel lies at their time.
    stream: [u64; 4],
    exact: u64,
    exact_fired: u64,
    fired: u64,
}

/// What is counted at one tolerance.
pub(super) struct Level {
    tolerance_us: i64,
    plain: Counts,
    scaled: Counts,
}

/// What is counted of one matching.
#[derive(Default)]
struct Counts {
    /// Pairs by magnitude of their error.
    magnitudes: Vec<u64>,
    /// Pairs by error over interval, in bins of equal relative width.
    ratios: Vec<u64>,
    error_sum_us: i64,
    chance: u64,
    /// Pairs by the region of their truth event.
    matched: [u64; 4],
    /// Pairs by where the pixel lies at the time of the stream's event.
    matched_there: [u64; 4],
}

impl Tally {
    pub fn new(settings: &ScoreSettings, truth: &Truth) -> Self {
        let level = |tolerance_us: &i64| Level {
            tolerance_us: *tolerance_us,
            plain: Counts::default(),
            scaled: Counts::default(),
        };
        Self {
            levels: settings.tolerances_us.iter().map(level).collect(),
            phase: Phase::new(&truth.sensor, truth.duration_us),
            cut_clusters: 0,
            truth: [0; 4],
            stream: [0; 4],
            exact: 0,
            exact_fired: 0,
            fired: 0,
        }
    }

    /// Counts a pixel as silent or not, and its sequence of polarities as exact or not.
    pub fn sequence(&mut self, silent: bool, exact: bool) {
        self.exact += u64::from(exact);
        self.fired += u64::from(!silent);
        self.exact_fired += u64::from(exact && !silent);
    }

    /// Counts events of the stream and of the truth by region.
    pub fn regions(&mut self, stream: &[Region], known: &[TruthDetail]) {
        stream.iter().for_each(|r| bump(&mut self.stream, *r));
        known.iter().for_each(|k| bump(&mut self.truth, k.region));
    }

    pub fn finish(self, truth: &Truth, stream: &ByPixel<Mark>) -> Score {
        let (events, truth_events) = (stream.len() as u64, truth.events.len() as u64);
        let pixels = truth.pixels.len() as u64;
        let pixel_seconds = pixels as f64 * truth.duration_us as f64 / 1.0e6;
        Score {
            duration_us: truth.duration_us,
            pixels,
            truth_events,
            events,
            ignored_unknown_pixel: stream.ignored_unknown_pixel,
            ignored_outside_interval: stream.ignored_outside_interval,
            count_ratio: share(events, truth_events),
            tolerances: self
                .levels
                .iter()
                .map(|level| ToleranceScore {
                    tolerance_us: level.tolerance_us,
                    plain: self.match_score(&level.plain, pixel_seconds),
                    scaled: self.match_score(&level.scaled, pixel_seconds),
                })
                .collect(),
            fired_pixels: self.fired,
            exact_sequence: share(self.exact, pixels),
            exact_sequence_fired: share(self.exact_fired, self.fired),
            voxel_l1: self.phase.voxel_l1(),
            integrated_log_rms: self.phase.integrated_log_rms(pixels),
            chance_shift_us: chance_shifts(truth.duration_us),
            cut_clusters: self.cut_clusters,
        }
    }

    fn match_score(&self, counts: &Counts, pixel_seconds: f64) -> MatchScore {
        let of = |counts: &[u64; 4], region| counts.get(region as usize).copied().unwrap_or(0);
        let regions = Region::ALL.into_iter().filter_map(|region| {
            let (truth_events, matched) = (of(&self.truth, region), of(&counts.matched, region));
            let events = matched + of(&self.stream, region) - of(&counts.matched_there, region);
            (truth_events + events > 0).then(|| RegionScore {
                region,
                truth_events,
                events,
                matched,
                precision: share(matched, events),
                recall: share(matched, truth_events),
                f1: share(2 * matched, events + truth_events),
            })
        });
        let sum = |counts: &[u64; 4]| counts.iter().sum::<u64>();
        let (truth_events, events, matched) = (sum(&self.truth), sum(&self.stream), sum(&counts.matched));
        let (missed, spurious) = (truth_events - matched, events - matched);
        MatchScore {
            matched,
            missed,
            spurious,
            precision: share(matched, events),
            recall: share(matched, truth_events),
            f1: share(2 * matched, events + truth_events),
            chance_f1: share(2 * counts.chance, events + truth_events),
            missed_per_pixel_s: missed as f64 / pixel_seconds,
            spurious_per_pixel_s: spurious as f64 / pixel_seconds,
            time_error: (matched > 0).then(|| counts.time_error(matched)),
            regions: regions.collect(),
        }
    }
}

impl Level {
    /// Matches one pixel's events of one polarity.
    pub fn add(&mut self, matcher: &mut Matcher, windows: &mut Scaled, pixel: &PixelEvents<'_>) {
        let plain = Plain { truth: pixel.truth, tolerance_us: self.tolerance_us };
        let chance = count_pairs(pixel.shifted, plain);
        self.plain.chance += chance;
        if pixel.known.iter().all(|k| k.scale <= 1.0) {
            // Nothing is scaled here: one matching stands for both.
            matcher.run(pixel.stream, &plain, |i, j, error_us| {
                self.plain.pair(pixel, i, j, error_us);
                self.scaled.pair(pixel, i, j, error_us);
            });
            self.scaled.chance += chance;
            return;
        }
        matcher.run(pixel.stream, &plain, |i, j, error_us| self.plain.pair(pixel, i, j, error_us));
        // Errors are whole microseconds: rounding down changes no comparison.
        let tolerance = |scale: f32| (self.tolerance_us as f64 * f64::from(scale)) as i64;
        windows.set(pixel.truth.iter().zip(pixel.known).map(|(t, k)| (*t, tolerance(k.scale))));
        matcher.run(pixel.stream, windows, |i, j, error_us| self.scaled.pair(pixel, i, j, error_us));
        matcher.run(pixel.shifted, windows, |_, _, _| self.scaled.chance += 1);
    }
}

impl Counts {
    fn pair(&mut self, pixel: &PixelEvents<'_>, i: usize, j: usize, error_us: i64) {
        let (Some(known), Some(region)) = (pixel.known.get(j), pixel.regions.get(i)) else { return };
        bump(&mut self.matched, known.region);
        bump(&mut self.matched_there, *region);
        self.error_sum_us += error_us;
        let magnitude = error_us.unsigned_abs();
        count(&mut self.magnitudes, magnitude as usize);
        if known.interval_us > 0 {
            let ratio = magnitude as f32 / known.interval_us as f32;
            count(&mut self.ratios, (ratio.to_bits() >> RATIO_BITS) as usize);
        }
    }

    fn time_error(&self, matched: u64) -> TimeError {
        let of_ratio = |bin: usize| f64::from(f32::from_bits((bin as u32) << RATIO_BITS));
        let with_interval: u64 = self.ratios.iter().sum();
        let squares = self.magnitudes.iter().enumerate().map(|(us, n)| (us as f64).powi(2) * *n as f64);
        TimeError {
            median_us: percentile(&self.magnitudes, matched, 0.5),
            p95_us: percentile(&self.magnitudes, matched, 0.95),
            rms_us: (squares.sum::<f64>() / matched as f64).sqrt(),
            bias_us: self.error_sum_us as f64 / matched as f64,
            median_per_interval: (with_interval > 0)
                .then(|| of_ratio(ranked(&self.ratios, with_interval.div_ceil(2) - 1))),
        }
    }
}

fn bump(counts: &mut [u64; 4], region: Region) {
    if let Some(count) = counts.get_mut(region as usize) {
        *count += 1;
    }
}

fn count(bins: &mut Vec<u64>, bin: usize) {
    if bins.len() <= bin {
        bins.resize(bin + 1, 0);
    }
    if let Some(count) = bins.get_mut(bin) {
        *count += 1;
    }
}

/// `part / whole`, and 1 where there is nothing: nothing was missed, nothing was wrong.
fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 1.0 } else { part as f64 / whole as f64 }
}

/// The bin of the item of this rank, from 0.
fn ranked(bins: &[u64], rank: u64) -> usize {
    let mut seen = 0;
    bins.iter()
        .position(|count| {
            seen += count;
            seen > rank
        })
        .unwrap_or(0)
}

/// Linear interpolation between ranks, as NumPy's `percentile` does; bins are values.
fn percentile(bins: &[u64], total: u64, fraction: f64) -> f64 {
    let rank = fraction * (total - 1) as f64;
    let low = ranked(bins, rank.floor() as u64) as f64;
    let high = ranked(bins, rank.ceil() as u64) as f64;
    low + (high - low) * rank.fract()
}
