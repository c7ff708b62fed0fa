//! One pixel over time: samples at regular steps, finer ones where the signal bends near a threshold, and the roots of
//! `log light - threshold` where it crosses.

use evis_core::trigger::{PixelState, decide, fire_time_us};
use evis_core::{Polarity, Region, RegionSpan, SensorConfig};

use crate::audit::{Counts, FINER, chosen};
use crate::clock::Clock;
use crate::probe::{Probe, probe};
use crate::signal::{Reading, Sampler};

/// Halvings of a step where an excursion could hide.
const DEPTH: u32 = 6;
/// A step is looked into where, bent as its neighbours say, it could come to a threshold: for a parabola an eighth of
/// the second difference is enough; this is eight times that.
const EXCURSION: f64 = 1.0;
/// And this is twice as much as a parabola needs, whatever the samples' error.
const PARABOLA: f64 = 0.25;
/// Light that comes as near to a level as this, in log units, reaches it. What moves to and fro returns to the same light
/// but for the rounding of its poses, and whether it fires there must not depend on that.
const TIE: f64 = 1e-6;
/// Second differences below this are no excursion: rounding, and far below any threshold.
const FLAT: f64 = 1e-6;
/// A reading decides about a threshold where it is farther from it than this many times its own error.
const DECIDED: f64 = 4.0;
/// And where it is farther from it than this, in log light: what slips between the samples of the smallest lattice, whose
/// error says nothing of it, moves the pixel by less.
const NEAR: f64 = 0.05;
/// Part of an event's strictest tolerance (100 us, or 0.01 px at the image's speed) to which its time is known.
const TIME_SHARE: f64 = 0.15;
/// A crossing's time is refined until it moves by less, in microseconds.
const TIME_STEP_US: f64 = 0.5;
/// How far an excursion goes past a threshold to be called missed, in log light: a hundredth of a usual threshold. Of one
/// that only touches it, truths of other samples do not know either.
const AUDIT_DEPTH: f64 = 0.002;
/// Two evaluations so far apart, in microseconds, are at the sides of a bend or a jump.
const JUMP_US: f64 = 1.0;
/// Regions are looked up this often, in microseconds.
const REGION_US: f64 = 4000.0;

/// What one pixel does.
#[derive(Clone, Debug, Default)]
pub struct PixelTruth {
    /// Events in firing order.
    pub events: Vec<Fired>,
    /// Regions over time.
    pub spans: Vec<RegionSpan>,
    /// Readings taken, but for the audit's.
    pub readings: u64,
    /// What the audit saw.
    pub audit: Counts,
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
struct LogSample {
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
    /// Part of the quiet steps that are sampled again, densely.
    pub audit_share: f64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// Error of an event's time to aim at; `None` takes [`TIME_SHARE`] of the strictest tolerance.
    pub time_error_us: Option<f64>,
}

/// Walks pixel (x, y), looking at it at `times`.
pub fn walk(clock: &Clock, sampler: &Sampler, rules: &Rules, times: &[i64], x: u16, y: u16) -> PixelTruth {
    let mut walker = Walker::new(clock, sampler, rules, x, y);
    walker.reference = walker.fine(0.0, 0.0).log;
    // Samples before, at both ends of, and after the interval in work.
    let mut a = walker.coarse(0.0);
    let mut before: Option<LogSample> = None;
    let mut b = times.get(1).map(|t| walker.coarse(*t as f64));
    for k in 1..times.len() {
        let Some(end) = b else { break };
        let after = times.get(k + 1).map(|t| walker.coarse(*t as f64));
        let bend = |p: Option<LogSample>, q: LogSample, r: Option<LogSample>| match (p, r) {
            (Some(p), Some(r)) => second_difference(p, q, r),
            _ => 0.0,
        };
        // A jump is no bend, and says nothing of the steps beside it.
        let smooth = |p: LogSample, q: LogSample| q.t_us - p.t_us > JUMP_US;
        let bend = if smooth(a, end) {
            let (before, after) = (before.filter(|p| smooth(*p, a)), after.filter(|r| smooth(end, *r)));
            bend(before, a, Some(end)).max(bend(Some(a), end, after))
        } else {
            0.0
        };
        walker.step_us = end.t_us - a.t_us;
        let fired = walker.truth.events.len();
        let end = walker.advance(a, end, bend, 0);
        if walker.truth.events.len() == fired {
            walker.audit(a, end);
        }
        before = Some(a);
        a = end;
        b = after;
    }
    walker.truth
}

/// What the trigger, which knows light at `instants` alone, makes of pixel (x, y): the light itself without any error.
pub fn sample(
    clock: &Clock,
    sampler: &Sampler,
    rules: &Rules,
    instants: &[i64],
    x: u16,
    y: u16,
) -> PixelTruth {
    let mut walker = Walker::new(clock, sampler, rules, x, y);
    // With all the samples that there are: truth, too, takes no more.
    let exact = |walker: &mut Walker, t_us: i64| walker.fine(t_us as f64, 0.0).log as f32;
    let mut reference_log = exact(&mut walker, 0);
    let mut log_before = Some(reference_log);
    for &[before_us, now_us] in instants.array_windows() {
        walker.reference = f64::from(reference_log);
        let rough = walker.coarse(now_us as f64);
        let margin = NEAR + DECIDED * rough.error;
        if rough.log + margin < walker.upper() && rough.log - margin > walker.lower() {
            log_before = None;
            continue;
        }
        let log_luminance = log_before.unwrap_or_else(|| exact(&mut walker, before_us));
        let old = PixelState { reference_log, log_luminance };
        let log_luminance = exact(&mut walker, now_us);
        let decision = decide(&rules.sensor, old, log_luminance);
        for k in 1..=decision.count {
            let after_us = fire_time_us(&rules.sensor, &decision, k, (now_us - before_us) as u32);
            let t_us = (before_us + i64::from(after_us)) as f64;
            // The last instant is the first one at or after the end.
            if t_us < rules.duration_us as f64 {
                let Probe { speed, region } = walker.probe(t_us);
                let fired = Fired { t_us, polarity: decision.polarity, speed: speed as f32, region };
                walker.truth.events.push(fired);
            }
        }
        (reference_log, log_before) = (decision.reference_log, Some(log_luminance));
    }
    walker.truth
}

/// How far the middle of three looks is from the line through the others, times the ratio that makes it the second
/// difference where they are evenly spaced.
fn second_difference(p: LogSample, q: LogSample, r: LogSample) -> f64 {
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
    /// Length of the step in work.
    step_us: f64,
    truth: PixelTruth,
}

impl<'a, 's> Walker<'a, 's> {
    /// Before its first look; the regions are known.
    fn new(clock: &'a Clock<'s>, sampler: &'a Sampler, rules: &'a Rules, x: u16, y: u16) -> Self {
        let truth = PixelTruth::default();
        let mut walker = Self { clock, sampler, rules, x, y, reference: 0.0, step_us: 0.0, truth };
        walker.regions();
        walker
    }

    fn look(&self, t_us: f64, reading: Reading) -> LogSample {
        let relative = reading.luminance / self.rules.reference_luminance;
        let eps = f64::from(self.rules.sensor.log_eps);
        // d ln(Y + eps) = dY / (Y + eps).
        let error = reading.error * relative / (relative + eps);
        LogSample { t_us, log: (relative + eps).ln(), error }
    }

    fn coarse(&mut self, t_us: f64) -> LogSample {
        self.truth.readings += 1;
        self.look(t_us, self.sampler.coarse(&self.clock.at(t_us), self.x, self.y))
    }

    fn fine(&mut self, t_us: f64, wanted: f64) -> LogSample {
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

    /// Searches for what a step in which nothing fired may hide, if it is chosen.
    fn audit(&mut self, a: LogSample, b: LogSample) {
        self.truth.audit.intervals += 1;
        if !chosen(self.x, self.y, a.t_us as i64, self.rules.audit_share) {
            return;
        }
        self.truth.audit.audited += 1;
        let beyond =
            |look: LogSample, sure: f64| look.log >= self.upper() + sure || look.log <= self.lower() - sure;
        let looks = (1..FINER).map(|k| a.t_us + (b.t_us - a.t_us) * f64::from(k) / f64::from(FINER));
        let missed = looks.into_iter().any(|t| {
            // What rounding alone takes past a threshold is no event that anybody misses.
            let at = |reading| self.look(t, reading);
            let rough = at(self.sampler.coarse(&self.clock.at(t), self.x, self.y));
            beyond(rough, -DECIDED * rough.error) && {
                let wanted = 0.1 * AUDIT_DEPTH;
                let sure = at(self.sampler.fine(&self.clock.at(t), self.x, self.y, wanted));
                beyond(sure, AUDIT_DEPTH.max(DECIDED * sure.error))
            }
        });
        self.truth.audit.missed += u64::from(missed);
    }

    /// Where the next ON event fires.
    fn upper(&self) -> f64 {
        self.reference + f64::from(self.rules.sensor.threshold_on) - TIE
    }

    /// Where the next OFF event fires.
    fn lower(&self) -> f64 {
        self.reference - f64::from(self.rules.sensor.threshold_off) + TIE
    }

    /// Everything that fires in (a, b]; returns `b`, known better where that was needed.
    fn advance(&mut self, a: LogSample, b: LogSample, bend: f64, depth: u32) -> LogSample {
        // What the samples' own error could bend is no excursion, where more than a parabola is guarded against.
        let sure_bend = (bend - 2.0 * a.error.max(b.error)).max(0.0);
        let reach = (EXCURSION * sure_bend).max(PARABOLA * bend);
        let crossed = b.log >= self.upper() || b.log <= self.lower();
        // Where nothing lies within reach of a threshold, and where all is one steep slope, the ends tell everything.
        let near = a.log.max(b.log) + reach >= self.upper() || a.log.min(b.log) - reach <= self.lower();
        let steep = crossed && sure_bend < 0.1 * (b.log - a.log).abs();
        if near && !steep && bend > FLAT && depth < DEPTH && b.t_us - a.t_us > 20.0 {
            let middle = self.coarse((0.5 * (a.t_us + b.t_us)).round());
            // Each half bends by a quarter of the whole where the curvature is even.
            let bend = second_difference(a, middle, b).max(0.25 * bend);
            let middle = self.advance(a, middle, bend, depth + 1);
            return self.advance(middle, b, bend, depth + 1);
        }
        self.fire(a, b)
    }

    /// Everything that fires between two samples of a monotone piece.
    fn fire(&mut self, a: LogSample, mut b: LogSample) -> LogSample {
        let mut start = a;
        loop {
            let (upper, lower) = (self.upper(), self.lower());
            let distance = |look: LogSample| (look.log - upper).abs().min((look.log - lower).abs());
            let undecided = |look: LogSample| distance(look) < DECIDED * look.error;
            if undecided(b) {
                let mut sure = self.fine(b.t_us, distance(b) / DECIDED);
                if undecided(sure) {
                    // With all the samples that there are.
                    sure = self.fine(b.t_us, 0.0);
                }
                b = LogSample { error: 0.0, ..sure };
            }
            let (polarity, level) = if b.log >= upper {
                (Polarity::On, upper)
            } else if b.log <= lower {
                (Polarity::Off, lower)
            } else {
                return b;
            };
            let sign = if polarity == Polarity::On { 1.0 } else { -1.0 };
            let Some((fired, at)) = self.crossing(start, b, level, sign) else {
                // Only the coarse signal was there.
                b = LogSample { error: 0.0, log: b.log.clamp(lower.next_up(), upper.next_down()), ..b };
                return b;
            };
            if fired.t_us < self.rules.duration_us as f64 {
                self.truth.events.push(fired);
            }
            start = at;
            self.reference = level + sign * TIE;
        }
    }

    /// When the signal crosses `level` between `a` and `b`, upwards for `sign` 1.
    fn crossing(&mut self, a: LogSample, b: LogSample, level: f64, sign: f64) -> Option<(Fired, LogSample)> {
        // Coarse: until the bracket is as narrow as the coarse signal is sure.
        let rough = Bracket::new(a, b, level, sign).narrow(|t| self.coarse(t), |look| DECIDED * look.error);
        // The last event may lie just after the step's end, where the fine signal crossed.
        let guess = rough.zero().clamp(a.t_us.min(b.t_us), a.t_us.max(b.t_us));
        let Probe { speed, region } = self.probe(guess);
        let tolerance = (0.01 / speed.max(1e-9) * 1e6).clamp(100.0, 1000.0);
        // The mean slope over the step; that of the coarse bracket may be one of the lattice's own stairs.
        let slope = ((b.log - a.log).abs() / (b.t_us - a.t_us).abs().max(1e-3)).max(1e-12);
        let wanted = self.rules.time_error_us.unwrap_or(TIME_SHARE * tolerance) * slope;
        let sure = DECIDED * rough.high.error.max(rough.low.error).max(wanted / DECIDED);
        // The fine signal may cross outside of the piece where the coarse one did (its lattice has stairs that some
        // directions meet all at once), never before the last event.
        let margin = self.step_us;
        let last = self.truth.events.last().map_or(0.0, |e| e.t_us);
        let bounds = [(a.t_us - margin).max(last), b.t_us + margin];
        let t_us = self.refine([a, b], bounds, guess, (sure / slope).max(2.0), level, sign, wanted)?;
        let fired = Fired {
            t_us,
            polarity: if sign > 0.0 { Polarity::On } else { Polarity::Off },
            speed: speed as f32,
            region,
        };
        Some((fired, LogSample { t_us, log: level, error: 0.0 }))
    }

    /// The zero near `guess`, from fine looks: first a bracket around it, at first `width` wide, then its narrowing.
    /// Between `a` and `b`, below and above by what the walk knows of them; as far as `from` and `to` where fine looks
    /// deny that. `None` where there is no crossing at all.
    #[expect(clippy::too_many_arguments, reason = "a bracket in a bracket")]
    fn refine(
        &mut self,
        [a, b]: [LogSample; 2],
        [from, to]: [f64; 2],
        guess: f64,
        width: f64,
        level: f64,
        sign: f64,
        wanted: f64,
    ) -> Option<f64> {
        let height = |look: LogSample| (look.log - level) * sign;
        // Samples without error were decided as finely as can be: asked again less finely they might say otherwise. Not so
        // the last event, where the search must end: of several at a jump, all are at its time.
        let known = |end: LogSample| (end.error == 0.0).then_some(end);
        let first = self.fine(guess.clamp(from, to), wanted);
        let (mut low, mut high) = (first, first);
        let mut width = width;
        // Downhill for the low end, uphill for the high one, until the signs differ or the interval ends.
        while height(low) >= 0.0 && low.t_us > from {
            high = low;
            let next = (low.t_us - width).max(if low.t_us > a.t_us { a.t_us } else { from });
            low =
                known(a).filter(|a| a.t_us == next && next > from).unwrap_or_else(|| self.fine(next, wanted));
            width *= 4.0;
        }
        while height(high) < 0.0 && high.t_us < to {
            low = high;
            let next = (high.t_us + width).min(if high.t_us < b.t_us { b.t_us } else { to });
            high = known(b).filter(|b| b.t_us == next).unwrap_or_else(|| self.fine(next, wanted));
            width *= 4.0;
        }
        // The fine signal was there before the interval began, or is not there yet at its end.
        if height(low) >= 0.0 {
            return Some(from);
        }
        if height(high) < 0.0 {
            return None;
        }
        Some(Bracket::new(low, high, level, sign).narrow(|t| self.fine(t, wanted), |_| 0.0).zero())
    }
}

/// Two looks, below and at or above a level.
struct Bracket {
    low: LogSample,
    high: LogSample,
    level: f64,
    sign: f64,
    /// Heights of the two, as the next guess weighs them.
    weights: [f64; 2],
}

impl Bracket {
    fn new(low: LogSample, high: LogSample, level: f64, sign: f64) -> Self {
        let mut bracket = Self { low, high, level, sign, weights: [0.0; 2] };
        bracket.weights = [bracket.height(low).min(0.0), bracket.height(high).max(0.0)];
        bracket
    }

    fn height(&self, look: LogSample) -> f64 {
        (look.log - self.level) * self.sign
    }

    /// Where the line through the two is 0.
    fn zero(&self) -> f64 {
        let [below, above] = self.weights;
        let share = if above > below { -below / (above - below) } else { 0.5 };
        self.low.t_us + (self.high.t_us - self.low.t_us) * share
    }

    /// Samples between the two until they are [`TIME_STEP_US`] apart, or a sample is closer to the level than `sure` of it
    /// or than the bracket's slope moves in a fifth of that time. Illinois' rule (M. Dowell and P. Jarratt, 1971): an
    /// end that stays is weighed half; a bracket that does not shrink is halved.
    fn narrow(mut self, mut look: impl FnMut(f64) -> LogSample, sure: impl Fn(LogSample) -> f64) -> Self {
        let mut last = 0.0_f64;
        for round in 0..60 {
            let width = self.high.t_us - self.low.t_us;
            if width <= TIME_STEP_US {
                break;
            }
            let guess = if round % 4 == 3 { 0.5 * (self.low.t_us + self.high.t_us) } else { self.zero() };
            // Off the ends, where a sample would tell nothing.
            let margin = (0.01 * width).max(0.2 * TIME_STEP_US).min(0.5 * width);
            let now = look(guess.clamp(self.low.t_us + margin, self.high.t_us - margin));
            let height = self.height(now);
            let slope = (self.height(self.high) - self.height(self.low)) / width;
            let [below, above] = &mut self.weights;
            if height >= 0.0 {
                (self.high, *above) = (now, height);
                if last > 0.0 {
                    *below *= 0.5;
                }
            } else {
                (self.low, *below) = (now, height);
                if last < 0.0 {
                    *above *= 0.5;
                }
            }
            last = if height >= 0.0 { 1.0 } else { -1.0 };
            if height.abs() <= sure(now).max(0.2 * TIME_STEP_US * slope) {
                break;
            }
        }
        // What remains is read off the line through the true heights.
        self.weights = [self.height(self.low).min(0.0), self.height(self.high).max(0.0)];
        self
    }
}
