//! Validation of arguments: everything after it trusts what it gets.

use super::by_pixel::PixelIndex;
use super::{MAX_TOLERANCE_US, MetricError, ScoreSettings};
use crate::event::Event;
use crate::truth::Truth;

/// Longest truth: doubled times and their distances stay far from overflow.
const MAX_DURATION_US: i64 = 1 << 52;

/// Relative difference of two settings that are the same number, rounded twice.
const SAME: f32 = 1e-5;

pub(super) fn check_settings(settings: &ScoreSettings, truth: &Truth) -> Result<(), MetricError> {
    let setting =
        |value: String, remedy: String| MetricError::Setting { what: "tolerances_us", value, remedy };
    if settings.tolerances_us.is_empty() {
        return Err(setting("empty".into(), "at least one number of microseconds".into()));
    }
    for tolerance in &settings.tolerances_us {
        if !(1..=MAX_TOLERANCE_US).contains(tolerance) {
            return Err(setting(tolerance.to_string(), format!("1 to {MAX_TOLERANCE_US} microseconds")));
        }
    }
    let size = [truth.camera.width, truth.camera.height];
    if let Some(stream) = settings.size
        && stream != size
    {
        return Err(MetricError::SensorSize { stream, truth: size });
    }
    let Some(sensor) = &settings.sensor else { return Ok(()) };
    for (what, stream, truth) in [
        ("threshold_on", sensor.threshold_on, truth.sensor.threshold_on),
        ("threshold_off", sensor.threshold_off, truth.sensor.threshold_off),
        ("log_eps", sensor.log_eps, truth.sensor.log_eps),
    ] {
        // NaN stands for unknown, and compares as neither more nor less.
        if (stream - truth).abs() > SAME * stream.abs().max(truth.abs()) {
            return Err(MetricError::SensorSetting { what, stream, truth });
        }
    }
    Ok(())
}

pub(super) fn check_not_empty(truth: &Truth, events: &[Event]) -> Result<(), MetricError> {
    let lacks = match (truth.pixels.is_empty(), truth.events.is_empty()) {
        (true, _) => "knows no pixels",
        (_, true) => "has no events",
        _ => return Ok(()),
    };
    Err(MetricError::EmptyTruth {
        lacks,
        duration_us: truth.duration_us,
        pixels: truth.pixels.len(),
        events: events.len(),
    })
}

pub(super) fn check_stream(events: &[Event], truth: &Truth) -> Result<(), MetricError> {
    check_events("the stream", events, truth)
}

fn check_events(side: &'static str, events: &[Event], truth: &Truth) -> Result<(), MetricError> {
    let size = [truth.camera.width, truth.camera.height];
    let mut before_us = i64::MIN;
    for (index, event) in events.iter().enumerate() {
        let &Event { t, x, y, p, .. } = event;
        if t < before_us {
            return Err(MetricError::Unsorted { side, index, t_us: t, before_us });
        }
        if !(0..=1).contains(&p) {
            return Err(MetricError::Polarity { side, index, polarity: p });
        }
        if u32::from(x) >= size[0] || u32::from(y) >= size[1] {
            return Err(MetricError::OutsideSensor { side, index, x, y, size });
        }
        before_us = t;
    }
    if u32::try_from(events.len()).is_err() {
        return Err(MetricError::Setting {
            what: "the number of events",
            value: format!("{} in {side}", events.len()),
            remedy: format!("at most {}; score it in pieces", u32::MAX),
        });
    }
    Ok(())
}

/// Whether the parts of `truth` fit together; one without events or pixels may.
pub(crate) fn check_truth(truth: &Truth) -> Result<(), MetricError> {
    let inconsistent = |what: String| Err(MetricError::Inconsistent(what));
    let (width, height) = (truth.camera.width, truth.camera.height);
    if !(1..=65_536).contains(&width) || !(1..=65_536).contains(&height) {
        return inconsistent(format!("its camera has {width}x{height} pixels"));
    }
    if !(1..=MAX_DURATION_US).contains(&truth.duration_us) {
        return inconsistent(format!("its duration is {} us", truth.duration_us));
    }
    if let Some([x, y]) = truth.pixels.iter().find(|[x, y]| u32::from(*x) >= width || u32::from(*y) >= height)
    {
        return inconsistent(format!("its pixel x = {x}, y = {y} lies outside {width}x{height}"));
    }
    if let Some([[x, y], _]) = truth.pixels.array_windows().find(|[[x, y], [u, v]]| (y, x) >= (v, u)) {
        return inconsistent(format!("its pixels are not in the order of y, then x, after x = {x}, y = {y}"));
    }
    let events = truth.events.len();
    for (what, length) in [("speeds", truth.speed.len()), ("regions", truth.event_region.len())] {
        if length != 0 && length != events {
            return inconsistent(format!("{events} events and {length} {what}"));
        }
    }
    check_spans(truth)?;
    check_events("the truth", &truth.events, truth)?;
    let outside = |e: &Event| !(0..truth.duration_us).contains(&e.t);
    if let Some((index, e)) = truth.events.iter().enumerate().find(|(_, e)| outside(e)) {
        let (t_us, duration_us) = (e.t, truth.duration_us);
        return Err(MetricError::OutsideInterval { index, t_us, duration_us });
    }
    let pixel_index = PixelIndex::new(truth);
    if let Some((index, e)) = truth.events.iter().enumerate().find(|(_, e)| !pixel_index.knows(e)) {
        return Err(MetricError::UnknownPixel { index, x: e.x, y: e.y, pixels: truth.pixels.len() });
    }
    Ok(())
}

fn check_spans(truth: &Truth) -> Result<(), MetricError> {
    let inconsistent = |what: String| Err(MetricError::Inconsistent(what));
    let (starts, spans, pixels) = (&truth.span_start, &truth.spans, truth.pixels.len());
    if starts.is_empty() && spans.is_empty() {
        return Ok(());
    }
    let ends = (starts.first().copied(), starts.last().map(|last| *last as usize));
    if starts.len() != pixels + 1 || ends != (Some(0), Some(spans.len())) || !starts.is_sorted() {
        return inconsistent(format!(
            "{} starts for the {} region spans of {pixels} pixels; there must be one per pixel and one at the end",
            starts.len(),
            spans.len()
        ));
    }
    for (&[from, to], [x, y]) in starts.array_windows().zip(&truth.pixels) {
        let of_pixel = spans.get(from as usize..to as usize).unwrap_or_default();
        if !of_pixel.is_sorted_by_key(|s| s.t_us) || of_pixel.first().is_some_and(|s| s.t_us != 0) {
            return inconsistent(format!(
                "the region spans of pixel x = {x}, y = {y} do not start at 0 or are not in order of time"
            ));
        }
    }
    Ok(())
}
