//! Counts over all pixels, and what they become in the end.

use super::by_pixel::{ByPixel, Mark};
use super::matching::Matcher;
use super::phase::Phase;
use super::pixels::{TruthDetail, chance_shifts};
use super::{MatchScore, RegionScore, Score, ScoreSettings, TimeError, ToleranceScore};
use crate::truth::{Region, Truth};

/// Bits of an f32 that a ratio's bin leaves out: ten bits of its fraction stay, one part in a thousand.
const RATIO_BITS: u32 = 13;

/// Everything that is counted.
pub(super) struct Tally {
    /// Plain and scaled, by turns.
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
    scaled: bool,
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
        let level = |tolerance_us: i64, scaled| Level {
            tolerance_us,
            scaled,
            magnitudes: Vec::new(),
            ratios: Vec::new(),
            error_sum_us: 0,
            chance: 0,
            matched: [0; 4],
            matched_there: [0; 4],
        };
        Self {
            levels: settings.tolerances_us.iter().flat_map(|t| [level(*t, false), level(*t, true)]).collect(),
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
        let scores: Vec<MatchScore> =
            self.levels.iter().map(|level| self.match_score(level, pixel_seconds)).collect();
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
                .step_by(2)
                .zip(scores.as_chunks().0)
                .map(|(level, [plain, scaled])| ToleranceScore {
                    tolerance_us: level.tolerance_us,
                    plain: plain.clone(),
                    scaled: scaled.clone(),
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

    fn match_score(&self, level: &Level, pixel_seconds: f64) -> MatchScore {
        let of = |counts: &[u64; 4], region| counts.get(region as usize).copied().unwrap_or(0);
        let regions = Region::ALL.into_iter().filter_map(|region| {
            let (truth_events, matched) = (of(&self.truth, region), of(&level.matched, region));
            let events = matched + of(&self.stream, region) - of(&level.matched_there, region);
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
        let (truth_events, events, matched) = (sum(&self.truth), sum(&self.stream), sum(&level.matched));
        let (missed, spurious) = (truth_events - matched, events - matched);
        MatchScore {
            matched,
            missed,
            spurious,
            precision: share(matched, events),
            recall: share(matched, truth_events),
            f1: share(2 * matched, events + truth_events),
            chance_f1: share(2 * level.chance, events + truth_events),
            missed_per_pixel_s: missed as f64 / pixel_seconds,
            spurious_per_pixel_s: spurious as f64 / pixel_seconds,
            time_error: (matched > 0).then(|| level.time_error(matched)),
            regions: regions.collect(),
        }
    }
}

impl Level {
    fn tolerance<'a>(&self, known: &'a [TruthDetail]) -> impl Fn(usize) -> i64 + use<'a> {
        let (tolerance_us, scaled) = (self.tolerance_us, self.scaled);
        move |j| match known.get(j) {
            // Errors are whole microseconds: rounding down changes no comparison.
            Some(detail) if scaled => (tolerance_us as f64 * f64::from(detail.scale)) as i64,
            _ => tolerance_us,
        }
    }

    pub fn add(
        &mut self,
        matcher: &mut Matcher,
        events: &[i64],
        regions: &[Region],
        truth: &[i64],
        known: &[TruthDetail],
    ) {
        matcher.run(events, truth, self.tolerance(known), |i, j, error_us| {
            let (Some(detail), Some(region)) = (known.get(j), regions.get(i)) else { return };
            bump(&mut self.matched, detail.region);
            bump(&mut self.matched_there, *region);
            self.error_sum_us += error_us;
            let magnitude = error_us.unsigned_abs();
            count(&mut self.magnitudes, magnitude as usize);
            if detail.interval_us > 0 {
                let ratio = magnitude as f32 / detail.interval_us as f32;
                count(&mut self.ratios, (ratio.to_bits() >> RATIO_BITS) as usize);
            }
        });
    }

    pub fn add_chance(
        &mut self,
        matcher: &mut Matcher,
        shifted: &[i64],
        truth: &[i64],
        known: &[TruthDetail],
    ) {
        matcher.run(shifted, truth, self.tolerance(known), |_, _, _| self.chance += 1);
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
