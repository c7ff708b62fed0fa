//! One pixel over time: looks at regular steps, finer ones where the signal bends near a threshold, and the roots of
//! `log light - threshold` where it crosses.

use evis_core::{Polarity, Region, RegionSpan, SensorConfig};

use crate::clock::Clock;
use crate::probe::{Probe, probe};
use crate::signal::{Reading, Sampler};

/// Halvings of a step where an excursion could hide.
const DEPTH: u32 = 6;
/// A step is looked into where, bent as its neighbours say, it could come to a threshold: for a parabola an eighth of
/// the second difference is enough; this is eight times that.
const EXCURSION: f64 = 1.0;
/// Second differences below this are no excursion: rounding, and far below any threshold.
const FLAT: f64 = 1e-6;
/// A reading decides about a threshold where it is farther from it than this many times its own error.
const DECIDED: f64 = 4.0;
/// Part of an event's strictest tolerance (100 us, or 0.01 px at the image's speed) to which its time is known.
const TIME_SHARE: f64 = 0.15;
/// A crossing's time is refined until it moves by less, in microseconds.
const TIME_STEP_US: f64 = 0.5;
/// Regions are looked up this often, in microseconds.
const REGION_US: f64 = 4000.0;

/// What one pixel does.
#[derive(Clone, Debug, Default)]
pub struct PixelTruth {
    /// Events in firing order.
    pub events: Vec<Fired>,
    /// Regions over time.
    pub spans: Vec<RegionSpan>,
    /// Readings taken.
    pub readings: u64,
}

impl PixelTruth {
    /// A pixel in which nothing ever changes.
    pub fn still() -> Self {
        let spans = vec![RegionSpan { t_us: 0, region: Region::Interior }];
        Self { spans, ..Self::default() }
    }
}

/// An event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fired {
    /// Microseconds since the stream's start, not yet floored.
    pub t_us: f64,
    /// Sign.
    pub polarity: Polarity,
    /// Image speed in pixels per second.
    pub speed: f32,
    /// Where it happened.
    pub region: Region,
}

/// `log(Y / Y_ref + eps)` at a time.
#[derive(Clone, Copy, Debug)]
struct Look {
    t_us: f64,
    log: f64,
    /// Estimated standard error of `log`.
    error: f64,
}

/// How the oracle walks.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Thresholds and eps.
    pub sensor: SensorConfig,
    /// `Y_ref`.
    pub reference_luminance: f64,
    /// Microseconds between looks.
    pub step_us: i64,
    /// Length in microseconds.
    pub duration_us: i64,
}

/// Walks pixel (x, y).
pub fn walk(clock: &Clock, sampler: &Sampler, rules: &Rules, x: u16, y: u16) -> PixelTruth {
    let mut walker = Walker {
        clock,
        sampler,
        rules,
        x,
        y,
        reference: 0.0,
        truth: PixelTruth::default(),
        coarse_luminance: (0.0, 0.0),
    };
    walker.reference = walker.fine(0.0, 0.0).log;
    walker.regions();
    // Looks before, at both ends of, and after the interval in work.
    let times: Vec<i64> = {
        let steps = rules.duration_us.div_euclid(rules.step_us);
        let mut times: Vec<i64> = (0..=steps).map(|k| k * rules.step_us).collect();
        if times.last() != Some(&rules.duration_us) {
            times.push(rules.duration_us);
        }
        times
    };
    let mut a = walker.coarse(0.0);
    let mut before: Option<Look> = None;
    let mut b = times.get(1).map(|t| walker.coarse(*t as f64));
    for k in 1..times.len() {
        let Some(end) = b else { break };
        let after = times.get(k + 1).map(|t| walker.coarse(*t as f64));
        let bend = |p: Option<Look>, q: Look, r: Option<Look>| match (p, r) {
            (Some(p), Some(r)) => second_difference(p, q, r),
            _ => 0.0,
        };
        let bend = bend(before, a, Some(end)).max(bend(Some(a), end, after));
        let end = walker.advance(a, end, bend, 0);
        before = Some(a);
        a = end;
        b = after;
    }
    walker.truth
}

/// How far the middle of three looks is from the line through the others, times the ratio that makes it the second
/// difference where they are evenly spaced.
fn second_difference(p: Look, q: Look, r: Look) -> f64 {
    let line = p.log + (r.log - p.log) * (q.t_us - p.t_us) / (r.t_us - p.t_us);
    2.0 * (q.log - line).abs()
}

struct Walker<'a, 's> {
    clock: &'a Clock<'s>,
    sampler: &'a Sampler,
    rules: &'a Rules,
    x: u16,
    y: u16,
    reference: f64,
    truth: PixelTruth,
    /// The last coarse reading and its time.
    coarse_luminance: (f64, f64),
}

impl Walker<'_, '_> {
    fn look(&self, t_us: f64, reading: Reading) -> Look {
        let relative = reading.luminance / self.rules.reference_luminance;
        let eps = f64::from(self.rules.sensor.log_eps);
        // d ln(Y + eps) = dY / (Y + eps).
        let error = reading.error * relative / (relative + eps);
        Look { t_us, log: (relative + eps).ln(), error }
    }

    fn coarse(&mut self, t_us: f64) -> Look {
        self.truth.readings += 1;
        let reading = self.sampler.coarse(&self.clock.at(t_us), self.x, self.y);
        self.coarse_luminance = (t_us, reading.luminance);
        self.look(t_us, reading)
    }

    fn fine(&mut self, t_us: f64, wanted: f64) -> Look {
        self.truth.readings += 1;
        self.look(t_us, self.sampler.fine(&self.clock.at(t_us), self.x, self.y, wanted))
    }

    fn probe(&self, t_us: f64) -> Probe {
        probe(self.clock, &self.clock.at(t_us), t_us, self.x, self.y)
    }

    fn regions(&mut self) {
        let mut t_us = 0.0;
        // One look ahead and one back: a region that touches an interval holds in all of it.
        let rank = |r: Region| match r {
            Region::Interior => 0,
            Region::Silhouette => 1,
            Region::ShadowEdge => 2,
            Region::Disoccluded => 3,
        };
        let mut previous = self.probe(0.0).region;
        while t_us < self.rules.duration_us as f64 {
            let next = self.probe(t_us + REGION_US).region;
            let region = if rank(next) > rank(previous) { next } else { previous };
            if self.truth.spans.last().is_none_or(|s| s.region != region) {
                self.truth.spans.push(RegionSpan { t_us: t_us as i64, region });
            }
            previous = next;
            t_us += REGION_US;
        }
    }

    fn upper(&self) -> f64 {
        self.reference + f64::from(self.rules.sensor.threshold_on)
    }

    fn lower(&self) -> f64 {
        self.reference - f64::from(self.rules.sensor.threshold_off)
    }

    /// Everything that fires in (a, b]; returns `b`, known better where that was needed.
    fn advance(&mut self, a: Look, b: Look, bend: f64, depth: u32) -> Look {
        // What the samples' own error could bend is no excursion.
        let bend = (bend - 2.0 * a.error.max(b.error)).max(0.0);
        let reach = EXCURSION * bend;
        let crossed = b.log >= self.upper() || b.log <= self.lower();
        // Where nothing lies within reach of a threshold, and where all is one steep slope, the ends tell everything.
        let near = a.log.max(b.log) + reach >= self.upper() || a.log.min(b.log) - reach <= self.lower();
        let steep = crossed && bend < 0.1 * (b.log - a.log).abs();
        if near && !steep && bend > FLAT && depth < DEPTH && b.t_us - a.t_us > 20.0 {
            let middle = self.coarse((0.5 * (a.t_us + b.t_us)).round());
            // Each half bends by a quarter of the whole where the curvature is even.
            let bend = second_difference(a, middle, b).max(0.25 * bend);
            let middle = self.advance(a, middle, bend, depth + 1);
            return self.advance(middle, b, bend, depth + 1);
        }
        self.fire(a, b)
    }

    /// Everything that fires between two looks of a monotone piece.
    fn fire(&mut self, a: Look, mut b: Look) -> Look {
        let mut start = a;
        loop {
            let (upper, lower) = (self.upper(), self.lower());
            let distance = (b.log - upper).abs().min((b.log - lower).abs());
            if distance < DECIDED * b.error {
                let sure = self.fine(b.t_us, distance / DECIDED);
                // As well as it can be known; asked again it would say the same.
                b = Look { error: 0.0, ..sure };
            }
            let (polarity, level) = if b.log >= upper {
                (Polarity::On, upper)
            } else if b.log <= lower {
                (Polarity::Off, lower)
            } else {
                return b;
            };
            let sign = if polarity == Polarity::On { 1.0 } else { -1.0 };
            let t_us = self.crossing(start, b, level, sign);
            if let Some((fired, at)) = t_us {
                if fired.t_us < self.rules.duration_us as f64 {
                    self.truth.events.push(fired);
                }
                start = at;
            }
            self.reference = level;
        }
    }

    /// When the signal crosses `level` between `a` and `b`, upwards for `sign` 1.
    fn crossing(&mut self, a: Look, b: Look, level: f64, sign: f64) -> Option<(Fired, Look)> {
        let height = |look: Look| (look.log - level) * sign;
        let (mut low, mut high) = (a, b);
        // Coarse: until the bracket is as narrow as the coarse signal is sure.
        let (mut below, mut above) = (height(a).min(0.0), height(b).max(0.0));
        let mut guess = at_zero(low, below, high, above);
        let mut slope = (b.log - a.log) * sign / (b.t_us - a.t_us).max(1e-3);
        for round in 0..40 {
            if high.t_us - low.t_us <= TIME_STEP_US {
                break;
            }
            let look = self.coarse(guess);
            let h = height(look);
            let sure = DECIDED * look.error;
            slope = if look.t_us > low.t_us && high.t_us > low.t_us {
                ((height(high) - height(low)) / (high.t_us - low.t_us)).max(1e-12)
            } else {
                slope
            };
            // The Illinois rule: an end that stays twice has its height halved.
            if h >= 0.0 {
                (high, above) = (look, h);
                if round % 3 == 2 {
                    below *= 0.5;
                }
            } else {
                (low, below) = (look, h);
                if round % 3 == 2 {
                    above *= 0.5;
                }
            }
            let next = at_zero(low, below, high, above);
            let moved = (next - guess).abs();
            guess = next;
            if h.abs() <= sure.max(1e-12) && moved * slope < sure || moved < 0.5 * TIME_STEP_US {
                break;
            }
        }
        let Probe { speed, region } = self.probe(guess);
        let tolerance = (0.01 / speed.max(1e-9) * 1e6).clamp(100.0, 1000.0);
        let wanted = TIME_SHARE * tolerance * slope.max(1e-12);
        // Fine: Newton's steps with the slope of the bracket; the signal is as good as straight here.
        let mut t_us = guess.clamp(a.t_us, b.t_us);
        let mut last: Option<Look> = None;
        for _ in 0..6 {
            let look = self.fine(t_us, wanted);
            if let Some(previous) = last
                && (look.t_us - previous.t_us).abs() > 1e-3
            {
                let measured = (look.log - previous.log) * sign / (look.t_us - previous.t_us);
                if measured > 0.2 * slope && measured < 5.0 * slope {
                    slope = measured;
                }
            }
            let next = (t_us - height(look) / slope.max(1e-12)).clamp(a.t_us, b.t_us);
            let moved = (next - t_us).abs();
            t_us = next;
            last = Some(look);
            if moved < TIME_STEP_US {
                break;
            }
        }
        let fired = Fired {
            t_us,
            polarity: if sign > 0.0 { Polarity::On } else { Polarity::Off },
            speed: speed as f32,
            region,
        };
        Some((fired, Look { t_us, log: level, error: 0.0 }))
    }
}

/// Where the line through two heights is 0, inside the bracket by a hundredth of it.
fn at_zero(low: Look, below: f64, high: Look, above: f64) -> f64 {
    let width = high.t_us - low.t_us;
    let share = if above > below { -below / (above - below) } else { 0.5 };
    low.t_us + width * share.clamp(0.01, 0.99)
}
