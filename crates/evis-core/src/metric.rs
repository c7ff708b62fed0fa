//! How close an event stream comes to a [`Truth`].
//!
//! **Matching.** Per pixel and polarity, events of the stream are matched with events of truth one to one and in
//! order, each pair closer in time than a tolerance. Of all such matchings the score is that of one with the most
//! pairs, and among those the least sum of time errors.
//!
//! **Tolerances.** Each tolerance τ counts twice: `plain`, and `scaled` by the image speed v at the truth event to
//! max(τ, min(0.1 px · (τ / 1 ms) / v, 10 τ)), so that slow motion is not asked for thousandths of a pixel. 0.1 px at
//! 1 ms is 0.01 px at 100 µs. The cap of ten τ keeps a match meaningful where next to nothing moves. Below 100 px/s
//! the tolerance grows, at 10 px/s it reaches the cap; where the speed is 0, not finite or not given, it is τ.
//!
//! **Counts.** precision = matched / events, recall = matched / truth events, F1 = 2 · matched / (events + truth
//! events). A stream that says nothing says nothing wrong: precision without events is 1, recall with nothing to find
//! is 1. F1 of an empty stream is 0.
//!
//! **What is scored.** Pixels that the truth knows, times in `[0, duration_us)`; other events are counted and
//! otherwise ignored.
//!
//! **Chance.** The same matching after each pixel's times were shifted cyclically by an amount of its own, more than
//! 50 ms either way (see [`Score::chance_shift_us`]): what F1 a stream of the same rates would get by luck.

mod by_pixel;
mod chance;
mod check;
mod error;
mod flow;
mod image;
mod matching;
mod phase;
mod pixels;
mod table;
mod tally;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use crate::event::Event;
use crate::sensor::SensorConfig;
use crate::truth::{Region, Truth};

pub use error::MetricError;
pub use flow::{EndpointError, endpoint_error};
pub use image::{Frame, mse, psnr, ssim};
pub use phase::{VOXEL_BINS, WINDOW_US, voxel_l1};

/// Tolerances unless others are asked for, in microseconds.
pub const DEFAULT_TOLERANCES_US: [i64; 3] = [1000, 300, 100];

/// Largest tolerance, in microseconds.
pub const MAX_TOLERANCE_US: i64 = 1_000_000;

/// What to score with, and what is known of the stream.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoreSettings {
    /// Tolerances in microseconds, each 1 to [`MAX_TOLERANCE_US`]; at least one.
    pub tolerances_us: Vec<i64>,
    /// Sensor that made the stream, where known: thresholds and `eps` must then be those of the truth.
    pub sensor: Option<SensorConfig>,
    /// Width and height of the stream's sensor, where known: must then be those of the truth.
    pub size: Option<[u32; 2]>,
}

impl Default for ScoreSettings {
    fn default() -> Self {
        Self { tolerances_us: DEFAULT_TOLERANCES_US.to_vec(), sensor: None, size: None }
    }
}

/// A stream against truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Length that was scored, in microseconds.
    pub duration_us: i64,
    /// Pixels that were scored.
    pub pixels: u64,
    /// Events of the truth.
    pub truth_events: u64,
    /// Events of the stream that were scored.
    pub events: u64,
    /// Events of the stream at pixels that the truth does not know.
    pub ignored_unknown_pixel: u64,
    /// Events of the stream before 0, or at or after the truth's end.
    pub ignored_outside_interval: u64,
    /// `events / truth_events`.
    pub count_ratio: f64,
    /// One entry per tolerance, as asked for.
    pub tolerances: Vec<ToleranceScore>,
    /// Pixels with an event in the stream or in the truth.
    pub fired_pixels: u64,
    /// Share of all pixels whose sequence of polarities is that of the truth; silence is a sequence too.
    pub exact_sequence: f64,
    /// The same among the pixels that fired.
    pub exact_sequence_fired: f64,
    /// Sum of absolute differences of voxel grids over the sum of the truth's absolute values, see [`voxel_l1`].
    /// None where the truth's grids are all zero.
    pub voxel_l1: Option<f64>,
    /// Error of integrated log brightness, in log units: RMS over pixels and boundaries of 20 ms (the last one is the
    /// end) of the difference of the sums C_on · (ON events) − C_off · (OFF events) so far. None where the truth's
    /// thresholds are unknown.
    pub integrated_log_rms: Option<f64>,
    /// Least and largest shift of the chance streams in microseconds: more than 50 ms and less than the duration
    /// minus 50 ms; for truths shorter than 200 ms between a quarter and three quarters of the duration.
    pub chance_shift_us: [i64; 2],
    /// Clusters of ambiguous events too large for one exact matching (millions of possible pairs in one pixel), which
    /// were matched piece by piece and may lack a pair at a seam.
    pub cut_clusters: u64,
}

/// Scores at one tolerance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToleranceScore {
    /// The tolerance in microseconds.
    pub tolerance_us: i64,
    /// With this tolerance everywhere.
    pub plain: MatchScore,
    /// With the tolerance scaled by local image speed.
    pub scaled: MatchScore,
}

/// The result of one matching.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchScore {
    /// Pairs.
    pub matched: u64,
    /// Truth events without partner.
    pub missed: u64,
    /// Events of the stream without partner.
    pub spurious: u64,
    /// `matched / events`.
    pub precision: f64,
    /// `matched / truth_events`.
    pub recall: f64,
    /// Harmonic mean of both.
    pub f1: f64,
    /// F1 of the stream with shifted times.
    pub chance_f1: f64,
    /// Missed events per pixel and second.
    pub missed_per_pixel_s: f64,
    /// Spurious events per pixel and second.
    pub spurious_per_pixel_s: f64,
    /// Time errors of the pairs; None where there are none.
    pub time_error: Option<TimeError>,
    /// Regions in which something happened, in the order of their numbers.
    pub regions: Vec<RegionScore>,
}

/// Time errors of matched pairs, stream minus truth. Percentiles interpolate linearly, as NumPy's do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeError {
    /// Median of the magnitude, in microseconds.
    pub median_us: f64,
    /// 95th percentile of the magnitude, in microseconds.
    pub p95_us: f64,
    /// Root of the mean square, in microseconds.
    pub rms_us: f64,
    /// Mean, in microseconds; positive where the stream is late.
    pub bias_us: f64,
    /// Median of the magnitude over the time to the nearest other truth event of the pixel (at least 1 µs), to one
    /// part in 256. Pixels with a single truth event do not count; None where there are no others.
    pub median_per_interval: Option<f64>,
}

/// One region's share of a matching. A truth event counts in its own region, a matched event in that of its truth
/// event, an unmatched one where the pixel lies at its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionScore {
    /// Which.
    pub region: Region,
    /// Events of the truth.
    pub truth_events: u64,
    /// Events of the stream.
    pub events: u64,
    /// Pairs.
    pub matched: u64,
    /// `matched / events`.
    pub precision: f64,
    /// `matched / truth_events`.
    pub recall: f64,
    /// Harmonic mean of both.
    pub f1: f64,
}

impl Score {
    /// The score at `tolerance_us`; None where it was not asked for.
    pub fn at(&self, tolerance_us: i64) -> Option<&ToleranceScore> {
        self.tolerances.iter().find(|t| t.tolerance_us == tolerance_us)
    }
}

impl MatchScore {
    /// The score in `region`; None where nothing happened there.
    pub fn region(&self, region: Region) -> Option<&RegionScore> {
        self.regions.iter().find(|r| r.region == region)
    }
}

impl Truth {
    /// Whether its parts fit together; one without events or pixels may.
    ///
    /// # Errors
    /// What contradicts what.
    pub fn check(&self) -> Result<(), MetricError> {
        check::check_truth(self)
    }
}

/// Scores `events`, sorted by time, against `truth`.
///
/// # Errors
/// See [`MetricError`]: settings that cannot be used, a stream of another sensor or of other thresholds, a stream that
/// is not sorted or not of this sensor, a truth without pixels or events, or one that contradicts itself.
pub fn score(events: &[Event], truth: &Truth, settings: &ScoreSettings) -> Result<Score, MetricError> {
    check::check_settings(settings, truth)?;
    check::check_truth(truth)?;
    check::check_not_empty(truth, events)?;
    check::check_stream(events, truth)?;
    let stream = by_pixel::stream_by_pixel(events, truth);
    let known = by_pixel::truth_by_pixel(truth);
    let mut tally = tally::Tally::new(settings, truth);
    let mut scratch = pixels::Scratch::default();
    for pixel in 0..truth.pixels.len() {
        pixels::score_pixel(truth, pixel, stream.pixel(pixel), known.pixel(pixel), &mut scratch, &mut tally);
    }
    Ok(tally.finish(truth, &stream))
}
