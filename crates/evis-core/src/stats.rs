//! Statistics of a stream of events: rates, hot pixels, intervals, correlations, spectrum.
//!
//! They are what a recording of a still scene says about a sensor's noise, and what two recordings are compared by.

mod calibrate;
mod compare;
mod flicker;
mod motion;
mod spectrum;

use serde::{Deserialize, Serialize};

use crate::event::Event;
use crate::sensor::ConfigError;

pub use calibrate::{Calibration, Estimate, MOST_PIXEL_SECONDS, calibrate, static_scene};
pub use compare::{Comparison, Named, Row};
pub use flicker::{FlickerFit, Stimulus, calibrate_flicker};

/// A pixel that fires more often than this is hot, events per second.
pub const HOT_HZ: f64 = 20.0;

/// As many events as [`HOT_HZ`] makes in the shortest recording that tells hot pixels: where it makes fewer, pixels that are not
/// hot are above it by chance, and where it makes less than one, all pixels that fire are.
const HOT_EVENTS: f64 = 5.0;

/// Lengths of the windows in which events are counted for [`Stats::fano_by_window`], microseconds.
const WINDOWS_US: [i64; 7] = [1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000];

/// Bins per decade of [`Stats::intervals`].
const PER_DECADE: f64 = 8.0;

/// Steps of the population's rate, microseconds.
pub(crate) const STEP_US: i64 = 1_000;

/// Distances of [`Stats::spatial_correlation`], pixels.
const LAGS: [usize; 8] = [1, 2, 3, 4, 6, 8, 16, 32];

/// Pixels of the largest sensor.
const MOST_PIXELS: i64 = 1 << 32;

/// Intervals up to this count as within a burst, where they are more frequent than those up to twice this.
pub(crate) const BURST_US: i64 = 5_000;

/// A point of a curve.
pub type Point = [f64; 2];

/// What is counted about a stream. "Cold" are pixels that are not hot. A figure is `None` where nothing is left to count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stats {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Length, seconds.
    pub duration_s: f64,
    /// All events.
    pub events: u64,
    /// Events per pixel and second.
    pub rate_hz: f64,
    /// Events per cold pixel and second; `None` where no pixel can fire and be cold, for the recording is shorter than
    /// 1 / [`HOT_HZ`], and where none is.
    pub cold_rate_hz: Option<f64>,
    /// ON events per cold pixel and second.
    pub cold_on_hz: Option<f64>,
    /// OFF events per cold pixel and second.
    pub cold_off_hz: Option<f64>,
    /// Share of ON events among those of cold pixels.
    pub on_share: Option<f64>,
    /// Share of pixels that never fired.
    pub silent_share: f64,
    /// Pixels above [`HOT_HZ`].
    pub hot_pixels: u64,
    /// Their share of all pixels.
    pub hot_share: f64,
    /// Their share of all events.
    pub hot_event_share: Option<f64>,
    /// Their mean rate, events per second.
    pub hot_hz: Option<f64>,
    /// Variance over mean of the counts of cold pixels, over the whole length; 1 for one Poisson process per pixel, all of
    /// one rate.
    pub fano: Option<f64>,
    /// The same in shorter windows: (seconds, Fano factor).
    pub fano_by_window: Vec<Point>,
    /// Neighbouring events of one cold pixel.
    pub pairs: u64,
    /// Share of them whose polarities differ; `None` without pairs.
    pub alternation: Option<f64>,
    /// Share of them whose polarities differ, after an ON event and after an OFF event.
    pub alternation_after: [Option<f64>; 2],
    /// Shortest time between two events of one pixel, microseconds: the refractory time is at most this, give or take the
    /// resolution of the time stamps.
    pub least_interval_us: Option<i64>,
    /// Quantiles of the time between two events of a cold pixel: 1, 10, 50, 90, 99 %, microseconds.
    pub interval_quantiles_us: Option<[f64; 5]>,
    /// Times between two events of a cold pixel: (seconds, pairs per second of interval and event).
    pub intervals: Vec<Point>,
    /// Of all pairs of cold pixels: how many more are within 5 ms than one expects from those up to 10 ms.
    pub burst_share: Option<f64>,
    /// Their mean interval, microseconds; `None` where there are too few.
    pub burst_interval_us: Option<f64>,
    /// Median over cold pixels of the coefficient of variation of the times between ON events in a row: near 1 for random,
    /// below a half for regular events (leak). `None` where no pixel has five.
    pub regularity: Option<f64>,
    /// Share of pixels above a rate: (events per second, share).
    pub pixel_rates: Vec<Point>,
    /// Correlation of the counts of cold pixels at a distance: (pixels, along rows, along columns).
    pub spatial_correlation: Vec<[f64; 3]>,
    /// Autocorrelation of the number of events per millisecond: (seconds, correlation).
    pub temporal_correlation: Vec<Point>,
    /// Power of the number of events per millisecond, over that of a Poisson process: (Hz, power).
    pub spectrum: Vec<Point>,
    /// Standard deviation of the rate over 50 ms, over its mean, beyond what counting explains. `None` below 200 ms.
    pub unsteadiness: Option<f64>,
}

impl Stats {
    /// How long a recording must be to tell hot pixels, seconds, if this one is too short.
    pub fn shortest_for_hot_s(&self) -> Option<f64> {
        (HOT_HZ * self.duration_s < HOT_EVENTS).then_some(HOT_EVENTS / HOT_HZ)
    }

    /// That the recording is too short to tell hot pixels, if it is.
    pub fn hot_note(&self) -> Option<String> {
        let shortest = self.shortest_for_hot_s()?;
        let Self { duration_s, .. } = self;
        let fewest = (HOT_HZ * duration_s).floor() + 1.0;
        let events = if fewest > 1.0 { "events make" } else { "event makes" };
        Some(format!(
            "a recording of {duration_s:.3} s is too short for a threshold of {HOT_HZ} Hz to tell hot pixels: {fewest} {events} \
             a pixel hot; {shortest} s or more would do"
        ))
    }
}

/// What a pixel has done so far.
#[derive(Clone, Copy, Default)]
struct Pixel {
    count: u32,
    last_us: i64,
    last_on: bool,
    /// ON intervals without an OFF event between: number, sum, sum of squares.
    runs: u32,
    run_sum: f64,
    run_squares: f64,
}

/// Counts `events`, which are sorted by time, of a sensor of this size between `start_us` and `end_us`.
///
/// # Errors
/// No pixels, no time, events outside, or out of order.
pub fn stats(
    events: &[Event],
    (width, height): (u32, u32),
    (start_us, end_us): (i64, i64),
) -> Result<Stats, ConfigError> {
    for (what, value) in [("width", width), ("height", height)] {
        if !(1..=65_536).contains(&value) {
            return Err(ConfigError::new(what, value, "between 1 and 65536 pixels"));
        }
    }
    let length_us = end_us.saturating_sub(start_us);
    if length_us <= 0 {
        let remedy = format!("after its start, {start_us} us");
        return Err(ConfigError::new("the recording's end", format!("{end_us} us"), remedy));
    }
    if !events.is_sorted_by_key(|event| event.t) {
        return Err(ConfigError::new("order of the events", "not by time", "by time"));
    }
    let outside = |e: &&Event| {
        u32::from(e.x) >= width
            || u32::from(e.y) >= height
            || !(0..=1).contains(&e.p)
            || e.t < start_us
            || e.t >= end_us
    };
    if let Some(event) = events.iter().find(outside) {
        let remedy = format!("within {width}x{height} pixels and {start_us} to {end_us} us, polarity 0 or 1");
        return Err(ConfigError::new("an event", format!("{event:?}"), remedy));
    }
    let pixels = width as usize * height as usize;
    // What follows keeps per pixel, per event and per step.
    let budget = evis_limits::Budget::default();
    let steps = usize::try_from(length_us / STEP_US).unwrap_or(usize::MAX).min(1 << 26);
    let per_pixel = (2 * size_of::<u32>() + size_of::<Pixel>() + size_of::<f64>()) as u64;
    let bytes = (pixels as u64 * per_pixel).saturating_add((steps + 2 * events.len()) as u64 * 8);
    if let Err(error) = budget.take(bytes, "counting") {
        let value = format!("{width}x{height} pixels and {} events", events.len());
        return Err(ConfigError::new("the recording's size", value, format!("smaller: {error}")));
    }
    let duration_s = length_us as f64 * 1e-6;
    let place = |e: &Event| usize::from(e.y) * width as usize + usize::from(e.x);

    let mut counts = vec![0_u32; pixels];
    let mut population = vec![0.0_f64; steps];
    for event in events {
        counts[place(event)] += 1;
        let step = usize::try_from((event.t - start_us) / STEP_US).unwrap_or(usize::MAX);
        if let Some(count) = population.get_mut(step) {
            *count += 1.0;
        }
    }
    let hot_count = HOT_HZ * duration_s;
    let is_hot = |count: u32| f64::from(count) > hot_count;
    let hot_pixels = counts.iter().filter(|count| is_hot(**count)).count();
    let cold_pixels = (pixels - hot_pixels) as f64;
    let hot_events: u64 = counts.iter().filter(|count| is_hot(**count)).map(|count| u64::from(*count)).sum();
    let cold_events = events.len() as u64 - hot_events;

    // Pairs of neighbouring events of a pixel.
    let mut seen = vec![Pixel::default(); pixels];
    let mut intervals_us = Vec::new();
    let (mut on, mut least_us) = (0_u64, None::<i64>);
    // Pairs and those that differ, after OFF and after ON.
    let mut after = [[0_u64; 2]; 2];
    for event in events {
        let index = place(event);
        let pixel = &mut seen[index];
        let cold = !is_hot(counts[index]);
        let is_on = event.p == 1;
        on += u64::from(cold && is_on);
        if pixel.count > 0 {
            let gap_us = event.t - pixel.last_us;
            least_us = Some(least_us.map_or(gap_us, |least| least.min(gap_us)));
            if cold {
                let tally = &mut after[usize::from(pixel.last_on)];
                tally[0] += 1;
                tally[1] += u64::from(pixel.last_on != is_on);
                intervals_us.push(gap_us);
                if pixel.last_on && is_on {
                    pixel.runs += 1;
                    pixel.run_sum += gap_us as f64;
                    pixel.run_squares += (gap_us as f64).powi(2);
                }
            }
        }
        (pixel.count, pixel.last_us, pixel.last_on) = (pixel.count + 1, event.t, is_on);
    }
    intervals_us.sort_unstable();
    let share = |part: u64, whole: u64| (whole > 0).then(|| part as f64 / whole as f64);
    let pairs = intervals_us.len() as u64;
    let until = |limit: i64| intervals_us.partition_point(|gap| *gap <= limit);
    let (within, beyond) = (until(BURST_US), until(2 * BURST_US) - until(BURST_US));
    let excess = within as f64 - beyond as f64;
    let sum: i64 = intervals_us.iter().take(within).sum();
    let burst_sum = sum as f64 - beyond as f64 * BURST_US as f64 / 2.0;
    let quantile =
        |q: f64| intervals_us.get((q * (pairs.max(1) - 1) as f64).round() as usize).map(|gap| *gap as f64);
    let quantiles = [0.01, 0.1, 0.5, 0.9, 0.99].map(quantile);

    let cold_counts = || counts.iter().copied().filter(|count| !is_hot(*count)).map(f64::from);
    // Where one event makes a pixel hot, that the others have none says nothing.
    let some_are_cold = cold_pixels > 0.0 && hot_count >= 1.0;
    let mean = if some_are_cold { cold_events as f64 / cold_pixels } else { 0.0 };
    let variance = cold_counts().map(|count| (count - mean).powi(2)).sum::<f64>() / cold_pixels.max(1.0);
    let mut regular: Vec<f64> = seen
        .iter()
        .zip(&counts)
        .filter(|(pixel, count)| pixel.runs >= 4 && !is_hot(**count))
        .map(|(pixel, _)| {
            let n = f64::from(pixel.runs);
            let mean = pixel.run_sum / n;
            ((pixel.run_squares / n - mean * mean).max(0.0) * n / (n - 1.0)).sqrt() / mean
        })
        .collect();
    regular.sort_unstable_by(f64::total_cmp);

    let cold = |event: &Event| !is_hot(counts[place(event)]);
    let cold_hz = |events: u64| some_are_cold.then(|| events as f64 / cold_pixels / duration_s);
    Ok(Stats {
        width,
        height,
        duration_s,
        events: events.len() as u64,
        rate_hz: events.len() as f64 / pixels as f64 / duration_s,
        cold_rate_hz: cold_hz(cold_events),
        cold_on_hz: cold_hz(on),
        cold_off_hz: cold_hz(cold_events - on),
        on_share: share(on, cold_events),
        silent_share: counts.iter().filter(|count| **count == 0).count() as f64 / pixels as f64,
        hot_pixels: hot_pixels as u64,
        hot_share: hot_pixels as f64 / pixels as f64,
        hot_event_share: share(hot_events, events.len() as u64),
        hot_hz: share(hot_events, hot_pixels as u64).map(|count| count / duration_s),
        fano: (mean > 0.0).then(|| variance / mean),
        fano_by_window: fano_by_window(events, place, cold, cold_pixels, (start_us, length_us)),
        pairs,
        alternation: share(after[0][1] + after[1][1], pairs),
        alternation_after: [share(after[1][1], after[1][0]), share(after[0][1], after[0][0])],
        least_interval_us: least_us,
        interval_quantiles_us: match quantiles {
            [Some(a), Some(b), Some(c), Some(d), Some(e)] => Some([a, b, c, d, e]),
            _ => None,
        },
        intervals: histogram(&intervals_us, cold_events),
        burst_share: (pairs > 0).then(|| (excess / pairs as f64).max(0.0)),
        burst_interval_us: (excess > 20.0 && burst_sum > 0.0).then(|| burst_sum / excess),
        regularity: regular.get(regular.len() / 2).copied(),
        pixel_rates: survival(&counts, duration_s),
        spatial_correlation: spatial(&counts, width as usize, is_hot, mean, variance),
        temporal_correlation: spectrum::autocorrelation(&population, STEP_US as f64 * 1e-6),
        spectrum: spectrum::spectrum(&population, STEP_US as f64 * 1e-6),
        unsteadiness: unsteadiness(&population),
    })
}

/// Fano factors of cold pixels in windows that fit the length four times.
fn fano_by_window(
    events: &[Event],
    place: impl Fn(&Event) -> usize,
    cold: impl Fn(&Event) -> bool,
    cold_pixels: f64,
    (start_us, length_us): (i64, i64),
) -> Vec<Point> {
    let mut points = Vec::new();
    let mut keys = Vec::new();
    for window_us in WINDOWS_US {
        let windows = length_us / window_us;
        if windows < 4 {
            break;
        }
        // A number for each window of each pixel.
        if windows.checked_mul(MOST_PIXELS).is_none() {
            continue;
        }
        keys.clear();
        keys.extend(events.iter().filter(|event| cold(event)).filter_map(|event| {
            let window = (event.t - start_us) / window_us;
            (window < windows).then(|| place(event) as i64 * windows + window)
        }));
        keys.sort_unstable();
        let total = keys.len() as f64;
        let squares: f64 = keys.chunk_by(|a, b| a == b).map(|same| (same.len() as f64).powi(2)).sum();
        let cells = cold_pixels * windows as f64;
        if total > 0.0 {
            let mean = total / cells;
            points.push([window_us as f64 * 1e-6, (squares / cells - mean * mean) / mean]);
        }
    }
    points
}

/// Density of intervals in logarithmic bins.
fn histogram(sorted_us: &[i64], events: u64) -> Vec<Point> {
    let edge = |k: i32| 10_f64.powf(f64::from(k) / PER_DECADE);
    // From 10 us to 28 hours.
    (8..88)
        .filter_map(|k| {
            let (low, high) = (edge(k), edge(k + 1));
            let below = |limit: f64| sorted_us.partition_point(|gap| (*gap as f64) < limit);
            let count = below(high) - below(low);
            let density = count as f64 / ((high - low) * 1e-6) / events.max(1) as f64;
            (count > 0).then(|| [(low * high).sqrt() * 1e-6, density])
        })
        .collect()
}

/// Share of pixels above each rate.
fn survival(counts: &[u32], duration_s: f64) -> Vec<Point> {
    let mut sorted = counts.to_vec();
    sorted.sort_unstable();
    let edge = |k: i32| 10_f64.powf(f64::from(k) / 4.0);
    let point = |k: i32| {
        let above = sorted.len() - sorted.partition_point(|count| f64::from(*count) / duration_s <= edge(k));
        (above > 0).then(|| [edge(k), above as f64 / sorted.len() as f64])
    };
    (-12..=24).filter_map(point).collect()
}

fn spatial(
    counts: &[u32],
    width: usize,
    is_hot: impl Fn(u32) -> bool,
    mean: f64,
    variance: f64,
) -> Vec<[f64; 3]> {
    let height = counts.len() / width;
    // Hot pixels count as average ones.
    let values: Vec<f64> =
        counts.iter().map(|count| if is_hot(*count) { 0.0 } else { f64::from(*count) - mean }).collect();
    let along = |step: usize, columns: usize, rows: usize| {
        let (mut sum, mut number) = (0.0, 0.0);
        for y in 0..rows {
            let line = y * width..y * width + columns;
            for i in line {
                sum += values[i] * values[i + step];
            }
            number += columns as f64;
        }
        sum / number / variance
    };
    if variance <= 0.0 {
        return Vec::new();
    }
    LAGS.into_iter()
        .filter(|lag| *lag < width && *lag < height)
        .map(|lag| [lag as f64, along(lag, width - lag, height), along(lag * width, width, height - lag)])
        .collect()
}

/// Relative deviation of the rate over 50 steps beyond counting noise.
fn unsteadiness(population: &[f64]) -> Option<f64> {
    let sums: Vec<f64> = population.chunks_exact(50).map(|chunk| chunk.iter().sum()).collect();
    let mean = sums.iter().sum::<f64>() / sums.len().max(1) as f64;
    if sums.len() < 4 || mean <= 0.0 {
        return None;
    }
    let variance = sums.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() / (sums.len() - 1) as f64;
    Some(((variance - mean).max(0.0)).sqrt() / mean)
}
