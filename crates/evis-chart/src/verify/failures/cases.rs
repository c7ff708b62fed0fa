//! The rows: which shots each failure takes, and the number that measures it.

use evis_core::closed_form::convergence::power;
use evis_core::metric::{MatchScore, Score};
use evis_core::{ConfigError, Region, Truth};

use super::detect::{self, Ratio};
use super::methods::NamedMethod;
use super::run::Seen;
use super::shots::{CUT_US, REST_US, SPOT_RADIUS, ShotId, TURN_HZ};
use super::{Cell, Detail, FailureNote, SCORED_US, limits};
use crate::error::ChartError;

/// Part of a gap on either side of a keyframe in which a burst is looked for.
const BURST_PART: f64 = 0.05;

/// Radians per gap at which rotation is measured.
const ANGLES: [f64; 3] = [0.1, 0.2, 0.4];

/// Pixels of motion farther from an edge than which an event has nothing to do with it.
const FAR_PX: f64 = 2.0;

/// The square's speed, in pixels per second.
const SQUARE_SPEED: f64 = 120.0;

/// Pixels from its circle that the spot reaches.
const SPOT_REACH: f64 = 3.0;

/// From so long after a cut on, every method has frames of the new view alone: longer than a gap of 125 per second.
const SETTLED_US: i64 = 16_000;

/// A failure: shots, and what to make of them.
pub(super) struct Case {
    id: &'static str,
    title: &'static str,
    number: &'static str,
    pub shots: &'static [ShotId],
    detect: fn(&[Seen<'_>], &NamedMethod) -> Result<Finding, ChartError>,
}

/// What a detector says.
#[derive(Default)]
struct Finding {
    number: Option<f64>,
    interval: Option<[f64; 2]>,
    details: Vec<Detail>,
}

impl Finding {
    fn of(number: Option<f64>) -> Self {
        Self { number, ..Self::default() }
    }

    fn ratio(ratio: Option<Ratio>) -> Self {
        Self { number: ratio.map(|r| r.value), interval: ratio.map(|r| r.interval), ..Self::default() }
    }

    fn with(mut self, name: impl Into<String>, value: Option<f64>) -> Self {
        self.details.push(Detail { name: name.into(), value });
        self
    }
}

/// Every case, in the order of the table in `docs/failures.md`.
pub(super) const CASES: &[Case] = &[
    Case {
        id: "keyframe-burst",
        title: "keyframe burst",
        number: "share of events within 5 % of a gap around keyframes, over truth's",
        shots: &[ShotId::Burst { keyframe_hz: None }],
        detect: |seen, method| burst(seen, method.keyframe_hz()),
    },
    Case {
        id: "keyframe-burst-30",
        title: "keyframe burst at 30 keyframes per second",
        number: "the same",
        shots: &[ShotId::Burst { keyframe_hz: Some(30.0) }],
        detect: |seen, _| burst(seen, 30.0),
    },
    Case {
        id: "disocclusion",
        title: "disocclusion pulses",
        number: "spurious events per pixel and second where background comes into view",
        shots: &[ShotId::Passing],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let region =
                |r| s.run.score.as_ref().and_then(|score| detect::spurious_in(score, &s.known.truth, r));
            Ok(Finding::of(region(Region::Disoccluded)).with("F1 there", region_f1(s, Region::Disoccluded)))
        },
    },
    Case {
        id: "rotation",
        title: "rotation bends linear motion",
        number: "median error in pixels at 0.4 radians per gap",
        shots: &[
            ShotId::Turning { radians: ANGLES[0] },
            ShotId::Turning { radians: ANGLES[1] },
            ShotId::Turning { radians: ANGLES[2] },
        ],
        detect: |seen, _| Ok(rotation(seen)),
    },
    Case {
        id: "thin-fast",
        title: "thin or fast objects lost between keyframes",
        number: "recall on a rod of 1.2 pixels and a ball that a slit shows for 5 ms",
        shots: &[ShotId::Thin],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let middle = (s.known.truth.camera.height / 2) as u16;
            let part = |upper: bool| {
                let part = detect::at_pixels(&s.known.truth, |_, y| (y < middle) == upper);
                Ok::<_, ChartError>(detect::scored(&s.run.events, &part)?.as_ref().and_then(recall))
            };
            Ok(Finding::of(s.run.score.as_ref().and_then(recall))
                .with("rod", part(true)?)
                .with("ball", part(false)?))
        },
    },
    Case {
        id: "fringe-ghosts",
        title: "ghosts of antialiased fringes",
        number: "events that the edge is nowhere near, per event of truth",
        shots: &[ShotId::Square],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let reach_us = (FAR_PX / SQUARE_SPEED * 1e6) as i64;
            let strays = detect::strays(&s.run.events, &s.known.truth, reach_us);
            Ok(Finding::of(Some(strays as f64 / s.known.truth.events.len().max(1) as f64)))
        },
    },
    Case {
        id: "edge-ramp",
        title: "all events of an edge at one instant",
        number: "time from an edge's first event at a pixel to its last, over truth's; median",
        shots: &[ShotId::Square],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            Ok(Finding::of(detect::ramp(&s.run.events, &s.known.truth))
                .with("events over truth's", count_ratio(s)))
        },
    },
    Case {
        id: "breathing",
        title: "contrast breathing of warped texture",
        number: "spurious events per event of truth, stripes of 2.5 pixels",
        shots: &[ShotId::Stripes],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let share = s.run.score.as_ref().and_then(detect::spurious_share);
            Ok(Finding::of(share).with("events over truth's", count_ratio(s)))
        },
    },
    Case {
        id: "highlights",
        title: "highlights that do not move with the surface",
        number: "F1 in a highlight's way",
        shots: &[ShotId::Highlight],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "shadows",
        title: "shadows that do not move with the surface",
        number: "F1 at the shadow's border",
        shots: &[ShotId::Shadow],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            Ok(Finding::of(region_f1(s, Region::ShadowEdge)).with("events over truth's", count_ratio(s)))
        },
    },
    Case {
        id: "lights",
        title: "lights that flicker",
        number: "F1 under a lamp of 40 Hz",
        shots: &[ShotId::Lamp],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "cones",
        title: "cones of light that move over what is still",
        number: "F1 where the cone of a spot sweeps over a wall",
        shots: &[ShotId::Sweep],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "sky",
        title: "the sky, which has no depth",
        number: "F1 before a camera that turns",
        shots: &[ShotId::Sky],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "near",
        title: "softmax overflow at small depth",
        number: "events over truth's, 12 and 20 mm before the camera",
        shots: &[ShotId::Near],
        detect: |seen, _| counted(seen),
    },
    Case {
        id: "depth",
        title: "depth 0 and infinity",
        number: "events over truth's, a box that flies through the camera before the sky",
        shots: &[ShotId::Through],
        detect: |seen, _| counted(seen),
    },
    Case {
        id: "cracks",
        title: "cracks under expansion",
        number: "events per pixel and second of a plain wall",
        shots: &[ShotId::Expansion],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let pixels = s.known.still.iter().filter(|still| **still).count();
            let time = pixels as f64 * s.known.shot.duration_us as f64 * 1e-6;
            let events = detect::at_still(&s.run.events, &s.known.truth, &s.known.still);
            Ok(Finding::of((time > 0.0).then(|| events as f64 / time))
                .with("events over truth's", count_ratio(s)))
        },
    },
    Case {
        id: "borders",
        title: "borders without margin",
        number: "F1 in the six columns where things come in",
        shots: &[ShotId::Border],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "global-step",
        title: "global step set by one fast pixel",
        number: "pixels drawn with a fast spot, over without",
        shots: &[ShotId::Slow { with_spot: true }, ShotId::Slow { with_spot: false }],
        detect: |seen, _| {
            let [with, without] = seen else { return Ok(Finding::default()) };
            let slow = |s: &Seen<'_>| {
                let [cx, cy] = [s.known.truth.camera.cx, s.known.truth.camera.cy];
                let apart = |x: u16, y: u16| {
                    let radius = (f64::from(x) + 0.5 - cx).hypot(f64::from(y) + 0.5 - cy);
                    (radius - SPOT_RADIUS).abs() > SPOT_REACH
                };
                let slow = detect::at_pixels(&s.known.truth, apart);
                Ok::<_, ChartError>(detect::scored(&s.run.events, &slow)?.as_ref().and_then(f1))
            };
            Ok(Finding::of((without.run.drawn > 0.0).then(|| with.run.drawn / without.run.drawn))
                .with("F1 of what the spot does not touch", slow(with)?)
                .with("without the spot", slow(without)?))
        },
    },
    Case {
        id: "cut",
        title: "camera cut",
        number: "events where light is the same before and after",
        shots: &[ShotId::Cut],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let events = detect::at_still(&s.run.events, &s.known.truth, &s.known.still);
            let between = |from_us: i64, to_us: i64| {
                let truth = detect::between(&s.known.truth, from_us, to_us);
                let events: Vec<_> =
                    s.run.events.iter().filter(|e| (from_us..to_us).contains(&e.t)).copied().collect();
                Ok::<_, ChartError>(detect::scored(&events, &truth)?.as_ref().and_then(f1))
            };
            Ok(Finding::of(Some(events as f64))
                .with("F1 until a gap before the cut", between(0, CUT_US - SETTLED_US)?)
                .with("F1 from two gaps after it", between(CUT_US + SETTLED_US, s.known.truth.duration_us)?))
        },
    },
    Case {
        id: "dark",
        title: "very dark light",
        number: "F1 at 1e-4 and 1e-2 of Y_ref; the worse",
        shots: &[ShotId::Light { luminance: 1e-4 }, ShotId::Light { luminance: 1e-2 }],
        detect: |seen, _| Ok(worst(seen, &["at 1e-4", "at 1e-2"])),
    },
    Case {
        id: "bright",
        title: "very bright light",
        number: "F1 at 1e2 and 1e4 of Y_ref; the worse",
        shots: &[ShotId::Light { luminance: 1e2 }, ShotId::Light { luminance: 1e4 }],
        detect: |seen, _| Ok(worst(seen, &["at 1e2", "at 1e4"])),
    },
    Case {
        id: "low-threshold",
        title: "threshold far below the contrast",
        number: "F1 at a threshold of 0.02",
        shots: &[ShotId::LowThreshold],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "high-threshold",
        title: "threshold far above the contrast",
        number: "F1 at a threshold of 2, contrasts of 3.1 and 1.6",
        shots: &[ShotId::HighThreshold],
        detect: |seen, _| Ok(whole(seen)),
    },
    Case {
        id: "refractory",
        title: "refractory longer than the interval",
        number: "events of a pixel closer together than its rest of 3 ms",
        shots: &[ShotId::Refractory],
        detect: |seen, _| {
            let [s] = seen else { return Ok(Finding::default()) };
            let pairs = detect::closer_than(&s.run.events, &s.known.truth, i64::from(REST_US));
            Ok(Finding::of(Some(pairs as f64)).with("events over truth's", count_ratio(s)))
        },
    },
];

/// The cases with these ids, in the suite's order; all where none is given.
pub(super) fn chosen(ids: &[String]) -> Result<Vec<&'static Case>, ConfigError> {
    for id in ids {
        if CASES.iter().all(|case| case.id != id) {
            let known: Vec<_> = CASES.iter().map(|case| case.id).collect();
            return Err(ConfigError::new("failure", id, format!("one of {}", known.join(", "))));
        }
    }
    Ok(CASES.iter().filter(|case| ids.is_empty() || ids.iter().any(|id| id == case.id)).collect())
}

impl Case {
    pub(super) fn note(&self) -> FailureNote {
        FailureNote { id: self.id.into(), title: self.title.into(), number: self.number.into() }
    }

    /// What `method` made of the shots.
    pub(super) fn cell(&self, method: &NamedMethod, seen: &[Seen<'_>]) -> Result<Cell, ChartError> {
        let Finding { number, interval, details } = (self.detect)(seen, method)?;
        let scores = || seen.iter().filter_map(|s| s.run.score.as_ref());
        let least = |a: f64, b: f64| a.min(b);
        Ok(Cell {
            failure: self.id.into(),
            method: method.name.clone(),
            number,
            interval,
            details,
            f1: scores().filter_map(f1).reduce(least),
            median_us: scores().filter_map(median_us).reduce(f64::max),
            truth_events: seen.iter().map(|s| s.known.truth.events.len() as u64).sum(),
            events: scores().map(|score| score.events).sum(),
            at_still: seen
                .iter()
                .map(|s| detect::at_still(&s.run.events, &s.known.truth, &s.known.still))
                .sum(),
            still_pixels: seen.iter().flat_map(|s| &s.known.still).filter(|still| **still).count() as u64,
            outside: seen.iter().map(|s| s.run.outside).sum(),
            unknown: seen.iter().map(|s| s.run.unknown).sum(),
            limit: limits::limit(self.id, &method.name),
            faults: Vec::new(),
        })
    }
}

/// The scaled match within a millisecond.
fn matched(score: &Score) -> Option<&MatchScore> {
    score.at(SCORED_US[0]).map(|t| &t.scaled)
}

fn f1(score: &Score) -> Option<f64> {
    matched(score).map(|m| m.f1)
}

fn recall(score: &Score) -> Option<f64> {
    matched(score).map(|m| m.recall)
}

fn median_us(score: &Score) -> Option<f64> {
    matched(score)?.time_error.as_ref().map(|e| e.median_us)
}

fn region_f1(s: &Seen<'_>, region: Region) -> Option<f64> {
    Some(matched(s.run.score.as_ref()?)?.region(region)?.f1)
}

fn count_ratio(s: &Seen<'_>) -> Option<f64> {
    s.run.score.as_ref().map(|score| score.count_ratio)
}

/// F1 of a single shot.
fn whole(seen: &[Seen<'_>]) -> Finding {
    let [s] = seen else { return Finding::default() };
    Finding::of(s.run.score.as_ref().and_then(f1)).with("events over truth's", count_ratio(s))
}

fn counted(seen: &[Seen<'_>]) -> Result<Finding, ChartError> {
    let [s] = seen else { return Ok(Finding::default()) };
    Ok(Finding::of(count_ratio(s)))
}

/// The least F1 of several shots.
fn worst(seen: &[Seen<'_>], names: &[&str]) -> Finding {
    let each: Vec<Option<f64>> = seen.iter().map(|s| s.run.score.as_ref().and_then(f1)).collect();
    let least = each.iter().copied().reduce(|a, b| Some(a?.min(b?))).flatten();
    names.iter().zip(each).fold(Finding::of(least), |finding, (name, f1)| finding.with(*name, f1))
}

fn burst(seen: &[Seen<'_>], keyframe_hz: f64) -> Result<Finding, ChartError> {
    let [s] = seen else { return Ok(Finding::default()) };
    let half_us = BURST_PART * 1e6 / keyframe_hz;
    Ok(Finding::ratio(detect::burst(&s.run.events, &s.known.truth, keyframe_hz, half_us))
        .with(
            "most in any eighth of a gap, over truth's",
            detect::densest(&s.run.events, &s.known.truth, keyframe_hz),
        )
        .with("events over truth's", count_ratio(s)))
}

/// Times are off by some part of the angle, so that the median time error, times the turning speed, times the mean
/// radius, is the error in pixels, whatever the radius.
fn rotation(seen: &[Seen<'_>]) -> Finding {
    let error = |s: &Seen<'_>, radians: f64| {
        let wide = &s.run.score.as_ref()?.at(SCORED_US[1])?.plain;
        let median_us = wide.time_error.as_ref()?.median_us;
        Some(median_us * 1e-6 * radians * TURN_HZ * mean_radius(&s.known.truth))
    };
    let errors: Vec<Option<f64>> = seen.iter().zip(ANGLES).map(|(s, radians)| error(s, radians)).collect();
    let points = ANGLES.into_iter().zip(&errors).filter_map(|(radians, e)| Some((radians, (*e)?)));
    let mut finding = Finding::of(errors.last().copied().flatten()).with("power of the angle", power(points));
    for (radians, error) in ANGLES.into_iter().zip(errors) {
        finding = finding.with(format!("pixels at {radians}"), error);
    }
    finding
}

/// Mean distance of truth's events from the picture's middle, in pixels.
fn mean_radius(truth: &Truth) -> f64 {
    let [cx, cy] = [truth.camera.cx, truth.camera.cy];
    let radius = |x: u16, y: u16| (f64::from(x) + 0.5 - cx).hypot(f64::from(y) + 0.5 - cy);
    truth.events.iter().map(|e| radius(e.x, e.y)).sum::<f64>() / truth.events.len().max(1) as f64
}
