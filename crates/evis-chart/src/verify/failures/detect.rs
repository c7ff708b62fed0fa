//! How failures are detected: pure functions of a stream and a truth.

use evis_core::metric::{self, Score, ScoreSettings};
use evis_core::{Event, Region, Truth};

use super::SCORED_US;
use crate::error::ChartError;

/// Normal quantile of 95 % confidence.
const SURE: f64 = 1.96;

/// A ratio, and where it lies with 95 % confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ratio {
    pub value: f64,
    pub interval: [f64; 2],
}

/// Scores at [`SCORED_US`]; `None` where truth has no events.
pub(super) fn scored(events: &[Event], truth: &Truth) -> Result<Option<Score>, ChartError> {
    if truth.events.is_empty() || truth.pixels.is_empty() {
        return Ok(None);
    }
    let ask = ScoreSettings { tolerances_us: SCORED_US.to_vec(), ..ScoreSettings::default() };
    metric::score(events, truth, &ask).map(Some).map_err(|e| ChartError::Score(e.to_string()))
}

/// `truth` at the pixels that `keep` picks.
pub(super) fn at_pixels(truth: &Truth, keep: impl Fn(u16, u16) -> bool) -> Truth {
    let mut out = Truth {
        pixels: Vec::new(),
        events: Vec::new(),
        speed: Vec::new(),
        event_region: Vec::new(),
        span_start: Vec::new(),
        spans: Vec::new(),
        ..truth.clone()
    };
    let spanned = truth.span_start.len() == truth.pixels.len() + 1;
    if spanned {
        out.span_start.push(0);
    }
    for (i, &[x, y]) in truth.pixels.iter().enumerate().filter(|(_, [x, y])| keep(*x, *y)) {
        out.pixels.push([x, y]);
        if spanned {
            let (from, to) = (truth.span_start[i] as usize, truth.span_start[i + 1] as usize);
            out.spans.extend_from_slice(truth.spans.get(from..to).unwrap_or(&[]));
            out.span_start.push(out.spans.len() as u32);
        }
    }
    for (i, event) in truth.events.iter().enumerate().filter(|(_, e)| keep(e.x, e.y)) {
        out.events.push(*event);
        out.speed.extend(truth.speed.get(i));
        out.event_region.extend(truth.event_region.get(i));
    }
    out
}

/// `truth` with its events in `[from_us, to_us)` only.
pub(super) fn between(truth: &Truth, from_us: i64, to_us: i64) -> Truth {
    let from = truth.events.partition_point(|e| e.t < from_us);
    let to = truth.events.partition_point(|e| e.t < to_us).max(from);
    Truth {
        events: truth.events[from..to].to_vec(),
        speed: truth.speed.get(from..to).unwrap_or(&[]).to_vec(),
        event_region: truth.event_region.get(from..to).unwrap_or(&[]).to_vec(),
        ..truth.clone()
    }
}

/// Events of a stream or a truth, pixel by pixel, in order of time.
pub(super) struct ByPixel {
    index: Vec<u32>,
    width: usize,
    events: Vec<Vec<Event>>,
}

impl ByPixel {
    /// Of the pixels that `truth` knows; other events are left out.
    pub(super) fn new(events: &[Event], truth: &Truth) -> Self {
        let width = truth.camera.width as usize;
        let mut index = vec![u32::MAX; width * truth.camera.height as usize];
        for (i, [x, y]) in (0..).zip(&truth.pixels) {
            if let Some(entry) = index.get_mut(usize::from(*y) * width + usize::from(*x)) {
                *entry = i;
            }
        }
        let mut out = Self { index, width, events: vec![Vec::new(); truth.pixels.len()] };
        for event in events {
            if let Some(i) = out.of(event) {
                out.events[i].push(*event);
            }
        }
        out
    }

    fn of(&self, event: &Event) -> Option<usize> {
        let at = usize::from(event.y) * self.width + usize::from(event.x);
        let i = *self.index.get(at)? as usize;
        (i < self.events.len()).then_some(i)
    }

    /// Per pixel of the truth.
    pub(super) fn pixels(&self) -> impl Iterator<Item = &[Event]> {
        self.events.iter().map(Vec::as_slice)
    }
}

/// Share of `events` within `half_us` of a keyframe over truth's share there; what happens before the first keyframe
/// window of the stream's own start counts nowhere. `None` where either side has nothing to tell it from.
///
/// Confidence: both shares are taken as binomial, and their ratio as log-normal (Katz et al., "Obtaining Confidence
/// Intervals for the Risk Ratio in Cohort Studies", 1978).
pub(super) fn burst(events: &[Event], truth: &Truth, keyframe_hz: f64, half_us: f64) -> Option<Ratio> {
    let gap = 1e6 / keyframe_hz;
    // The first half gap has no keyframe before it, and nothing has fired yet.
    let counts = |events: &mut dyn Iterator<Item = &Event>| {
        let (mut near, mut all) = (0.0, 0.0);
        for event in events.filter(|e| e.t as f64 >= 0.5 * gap) {
            let off = event.t as f64 - (event.t as f64 / gap).round() * gap;
            all += 1.0;
            near += f64::from(u8::from(off.abs() <= half_us));
        }
        (near, all)
    };
    let known = ByPixel::new(events, truth);
    let (near, all) = counts(&mut known.pixels().flatten());
    let (true_near, true_all) = counts(&mut truth.events.iter());
    if near == 0.0 || true_near == 0.0 {
        return None;
    }
    let value = (near / all) / (true_near / true_all);
    let error = (1.0 / near - 1.0 / all + 1.0 / true_near - 1.0 / true_all).max(0.0).sqrt();
    Some(Ratio { value, interval: [value * (-SURE * error).exp(), value * (SURE * error).exp()] })
}

/// Largest share of `events` in any eighth of a gap (around each of eight evenly spaced instants, a keyframe being one of
/// them), over truth's share there. `None` where truth lacks events in one of them.
pub(super) fn densest(events: &[Event], truth: &Truth, keyframe_hz: f64) -> Option<f64> {
    let gap = 1e6 / keyframe_hz;
    let shares = |events: &mut dyn Iterator<Item = &Event>| {
        let (mut bins, mut all) = ([0.0; 8], 0.0);
        for event in events.filter(|e| e.t as f64 >= 0.5 * gap) {
            let eighth = (event.t as f64 / gap * 8.0).round() as usize % 8;
            bins[eighth] += 1.0;
            all += 1.0;
        }
        bins.map(|count| count / f64::max(all, 1.0))
    };
    let known = ByPixel::new(events, truth);
    let pairs = shares(&mut known.pixels().flatten()).into_iter().zip(shares(&mut truth.events.iter()));
    pairs
        .map(|(got, expected)| (expected > 0.0).then(|| got / expected))
        .reduce(|a, b| Some(a?.max(b?)))
        .flatten()
}

/// Pixel-seconds that `truth` spends in `region`.
pub(super) fn pixel_seconds(truth: &Truth, region: Region) -> f64 {
    let mut sum = 0;
    for pair in truth.span_start.array_windows() {
        let &[from, to] = pair;
        let spans = truth.spans.get(from as usize..to as usize).unwrap_or(&[]);
        for (i, span) in spans.iter().enumerate().filter(|(_, s)| s.region == region) {
            sum += spans.get(i + 1).map_or(truth.duration_us, |s| s.t_us) - span.t_us;
        }
    }
    sum as f64 * 1e-6
}

/// Unmatched events per pixel and second in `region`.
pub(super) fn spurious_in(score: &Score, truth: &Truth, region: Region) -> Option<f64> {
    let found = score.at(SCORED_US[0])?.scaled.region(region)?;
    let time = pixel_seconds(truth, region);
    (time > 0.0).then(|| found.events.saturating_sub(found.matched) as f64 / time)
}

/// Events without a partner, per event of truth.
pub(super) fn spurious_share(score: &Score) -> Option<f64> {
    let at = &score.at(SCORED_US[0])?.scaled;
    Some(at.spurious as f64 / score.truth_events.max(1) as f64)
}

/// Events that no event of truth at their pixel is closer to than `reach_us`: there, the edge is not.
pub(super) fn strays(events: &[Event], truth: &Truth, reach_us: i64) -> u64 {
    let (stream, known) = (ByPixel::new(events, truth), ByPixel::new(&truth.events, truth));
    let mut strays = 0;
    for (stream, known) in stream.pixels().zip(known.pixels()) {
        for event in stream {
            let after = known.partition_point(|k| k.t < event.t - reach_us);
            if known.get(after).is_none_or(|k| k.t > event.t + reach_us) {
                strays += 1;
            }
        }
    }
    strays
}

/// Time from the first to the last event of an edge at a pixel, over truth's time: median over pixels and polarities
/// where truth fires at least four times and the stream once.
pub(super) fn ramp(events: &[Event], truth: &Truth) -> Option<f64> {
    let (stream, known) = (ByPixel::new(events, truth), ByPixel::new(&truth.events, truth));
    let spread = |events: &[Event], p: i16| {
        let mut times = events.iter().filter(|e| e.p == p).map(|e| e.t);
        let first = times.next()?;
        let (mut last, mut count) = (first, 1);
        for t in times {
            (last, count) = (t, count + 1);
        }
        Some((last - first, count))
    };
    let mut ratios = Vec::new();
    for (stream, known) in stream.pixels().zip(known.pixels()) {
        for p in [0, 1] {
            if let (Some((got, _)), Some((true_us, 4..))) = (spread(stream, p), spread(known, p)) {
                ratios.push(got as f64 / true_us.max(1) as f64);
            }
        }
    }
    median(&mut ratios)
}

/// Events at the pixels of `truth` that are marked as still.
pub(super) fn at_still(events: &[Event], truth: &Truth, still: &[bool]) -> u64 {
    let stream = ByPixel::new(events, truth);
    stream.pixels().zip(still).filter(|(_, still)| **still).map(|(events, _)| events.len() as u64).sum()
}

/// Pairs of events of one pixel that are closer than `period_us`.
pub(super) fn closer_than(events: &[Event], truth: &Truth, period_us: i64) -> u64 {
    let stream = ByPixel::new(events, truth);
    let pairs =
        |events: &[Event]| events.array_windows().filter(|[a, b]| b.t - a.t < period_us).count() as u64;
    stream.pixels().map(pairs).sum()
}

/// The middle one, or the mean of the middle two.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    match n % 2 {
        _ if n == 0 => None,
        1 => Some(values[n / 2]),
        _ => Some(0.5 * (values[n / 2 - 1] + values[n / 2])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evis_core::{CameraInfo, Polarity, RegionSpan, SensorConfig};

    fn event(t: i64, x: u16) -> Event {
        Event::new(t, x, 0, Polarity::On)
    }

    fn truth(events: Vec<Event>) -> Truth {
        let camera = CameraInfo::uncalibrated("c", (8, 1));
        Truth::from_events(events, camera, SensorConfig::default(), 1.0, 1_000_000)
    }

    fn even(step_us: usize) -> Vec<Event> {
        (0..1_000_000).step_by(step_us).map(|t| event(t as i64, (t / step_us % 8) as u16)).collect()
    }

    #[test]
    fn a_burst_at_keyframes_is_told_from_even_events() {
        let truth = truth(even(100));
        let half = 0.05 * 8000.0;
        let same = burst(&even(100), &truth, 125.0, half).unwrap();
        assert!((same.value - 1.0).abs() < 1e-9 && same.interval[0] < 1.0 && same.interval[1] > 1.0);
        // Every event within half a millisecond of a keyframe goes there: twelve and a half instead of ten percent.
        let drawn = |mut e: Event| {
            let off = (e.t + 4000).rem_euclid(8000) - 4000;
            e.t -= if off.abs() <= 500 { off } else { 0 };
            e
        };
        let mut bursting: Vec<Event> = even(100).into_iter().map(drawn).collect();
        bursting.sort_by_key(Event::order);
        let found = burst(&bursting, &truth, 125.0, half).unwrap();
        assert!((found.value - 1.25).abs() < 0.03, "{found:?}");
        assert!(found.interval[0] > 1.0, "canary: its interval leaves 1 out, {found:?}");
        let densest = |events: &[Event]| densest(events, &truth, 125.0).unwrap();
        assert!((densest(&even(100)) - 1.0).abs() < 0.03, "{}", densest(&even(100)));
        // All of one eighth's events moved to its neighbour.
        let moved: Vec<Event> = even(100)
            .into_iter()
            .map(|mut e| {
                e.t += if (e.t + 500).rem_euclid(8000) < 1000 { 1000 } else { 0 };
                e
            })
            .collect();
        assert!(densest(&moved) > 1.9, "canary");
        assert!(burst(&[], &truth, 125.0, half).is_none());
    }

    #[test]
    fn strays_ramps_and_pairs_are_counted() {
        let edge = |start: i64, step: i64| (0..8).map(move |k| event(start + k * step, 3));
        let truth = truth(edge(10_000, 1000).collect());
        let right: Vec<Event> = edge(10_100, 1000).collect();
        assert_eq!((strays(&right, &truth, 3000), ramp(&right, &truth)), (0, Some(1.0)));
        // At one instant, and with a ghost long after, and one at a pixel that nothing reaches.
        let mut wrong: Vec<Event> = edge(14_000, 0).collect();
        wrong.extend([event(40_000, 3), event(50_000, 5)]);
        assert_eq!(strays(&wrong, &truth, 3000), 2);
        let steep: Vec<Event> = edge(14_000, 0).collect();
        assert_eq!(ramp(&steep, &truth), Some(0.0));
        assert_eq!((closer_than(&right, &truth, 1000), closer_than(&right, &truth, 1001)), (0, 7));
        let still = [true, true, true, false, true, true, true, true];
        assert_eq!((at_still(&right, &truth, &still), at_still(&wrong, &truth, &still)), (0, 1));
        let cut = between(&truth, 13_000, 16_000);
        assert_eq!((cut.events.len(), cut.speed.len()), (3, 0));
        let part = at_pixels(&truth, |x, _| x > 3);
        assert_eq!((part.pixels.len(), part.events.len()), (4, 0));
        assert!(scored(&right, &part).unwrap().is_none(), "nothing to score against");
        assert!(scored(&right, &truth).unwrap().is_some());
    }

    #[test]
    fn spurious_events_of_a_region_count_per_pixel_and_second() {
        let span = |t_us, region| RegionSpan { t_us, region };
        let mut truth = truth(vec![event(500_000, 0)]);
        truth.pixels = vec![[0, 0], [1, 0]];
        truth.span_start = vec![0, 2, 3];
        truth.spans =
            vec![span(0, Region::Interior), span(250_000, Region::Disoccluded), span(0, Region::Interior)];
        truth.event_region = vec![Region::Disoccluded];
        assert_eq!(pixel_seconds(&truth, Region::Disoccluded), 0.75);
        let told = |events: &[Event]| {
            let score = scored(events, &truth).unwrap().unwrap();
            (spurious_in(&score, &truth, Region::Disoccluded), spurious_share(&score))
        };
        assert_eq!(told(&[event(500_100, 0)]), (Some(0.0), Some(0.0)));
        let pulse = [event(300_000, 0), event(400_000, 0), event(400_000, 1), event(500_100, 0)];
        assert_eq!(told(&pulse), (Some(2.0 / 0.75), Some(3.0)), "canary: the pulse counts");
    }

    #[test]
    fn the_median_is_the_middle() {
        assert_eq!(median(&mut []), None);
        assert_eq!((median(&mut [3.0, 1.0, 2.0]), median(&mut [4.0, 1.0])), (Some(2.0), Some(2.5)));
    }
}
