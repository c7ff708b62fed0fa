//! A sensor's noise from a recording of a still scene.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::motion::likeness;
use super::{HOT_HZ, Stats, stats};
use crate::emulator::{EmulatorConfig, EventEmulator, Frames};
use crate::event::{Event, slice_time};
use crate::sensor::{ConfigError, LeakLaw, Noise, Sensor, SensorConfig};

/// Longest part of a recording that is fitted, pixels times seconds: each round simulates as much.
pub const MOST_PIXEL_SECONDS: f64 = 6e6;

/// Rounds of simulation and correction.
const ROUNDS: usize = 16;

/// Figures that agree within this share end the rounds.
const CLOSE: f64 = 0.02;

/// Fewer events than this say nothing.
const FEWEST: u64 = 200;

/// A greater share of pixels above [`HOT_HZ`] is none of defects.
const MOST_HOT: f64 = 0.05;

/// Something that was found about a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// What it is.
    pub name: String,
    /// How much.
    pub value: f64,
    /// Of what.
    pub unit: String,
    /// How it is to be understood.
    pub note: String,
}

/// What a recording says about a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// The sensor, with what the recording says in place of what was there.
    pub sensor: SensorConfig,
    /// What was found.
    pub found: Vec<Estimate>,
    /// What such a recording cannot say.
    pub unknown: Vec<String>,
    /// What is probably not meant.
    pub warnings: Vec<String>,
    /// The recording, as far as it was used.
    pub recording: Stats,
    /// A simulation of the sensor before a still scene, of the same size and length.
    pub simulated: Stats,
}

/// Light of a still scene, `Y / Y_ref`, where a sensor says no other.
const GREY: f32 = 0.18;

/// Events of `sensor` before a still scene of this light, `Y / Y_ref`; `None`: [`SensorConfig::fitted_light`], or 0.18.
///
/// # Errors
/// What [`EventEmulator::new`] refuses.
pub fn static_scene(
    sensor: &SensorConfig,
    (width, height): (u32, u32),
    duration_us: i64,
    light: impl Into<Option<f32>>,
    seed: u64,
) -> Result<Vec<Event>, ConfigError> {
    let light = light.into().or_else(|| sensor.fitted_light()).unwrap_or(GREY);
    let config = EmulatorConfig { width, height, seed, sensor: sensor.clone(), ..EmulatorConfig::default() };
    let mut emulator = EventEmulator::new(config)?;
    let frame = vec![light; width as usize * height as usize];
    let mut lists = [Vec::new()];
    let mut t_us = 0;
    emulator.push_into(&Frames::linear(&frame), 0, &mut lists)?;
    while t_us < duration_us {
        t_us = (t_us + 250_000).min(duration_us);
        emulator.push_into(&Frames::linear(&frame), t_us, &mut lists)?;
    }
    let [mut events] = lists;
    events.retain(|event| event.t < duration_us);
    Ok(events)
}

/// Fits the noise of a sensor to `events`, a recording of a still scene between `start_us` and `end_us`; everything else
/// is taken from `base`.
///
/// Rates are estimated first, then corrected by simulating the sensor and counting its events in the same way, so that
/// what the estimates neglect (bursts beside hot pixels, refractory periods) does not bias them.
///
/// # Errors
/// As [`stats`]; too few events; a `base` that is a diffusion, whose noise is its own, or has an exposure.
pub fn calibrate(
    events: &[Event],
    (width, height): (u32, u32),
    (start_us, end_us): (i64, i64),
    base: &SensorConfig,
    seed: u64,
) -> Result<Calibration, ConfigError> {
    Sensor::new(base.clone())?;
    if base.diffusion.is_some() {
        let remedy = "a sensor with thresholds: the noise of a diffusion is part of it";
        return Err(ConfigError::new("the base sensor", "a diffusion", remedy));
    }
    if !base.exposure.is_off() {
        let remedy = "a sensor without one: noise belongs to pixels, which have a bandwidth and no exposure";
        return Err(ConfigError::new("the base sensor's exposure.time_us", base.exposure.time_us, remedy));
    }
    let mut warnings = Vec::new();
    let longest_us = (MOST_PIXEL_SECONDS / f64::from(width) / f64::from(height).max(1.0) * 1e6) as i64;
    let until_us = end_us.min(start_us.saturating_add(longest_us.max(1)));
    if until_us < end_us {
        warnings.push(format!(
            "of {:.1} s the first {:.1} s were used",
            (end_us - start_us) as f64 * 1e-6,
            (until_us - start_us) as f64 * 1e-6
        ));
    }
    let used = slice_time(events, start_us, until_us);
    let target = stats(used, (width, height), (start_us, until_us))?;
    if target.events < FEWEST {
        let remedy = format!("at least {FEWEST}: record longer");
        return Err(ConfigError::new("number of events", target.events, remedy));
    }
    let duration_us = until_us - start_us;
    warnings.extend(target.hot_note());
    // The noise is fitted to nothing else.
    let cold = cold_events(&target).round();
    if cold < FEWEST as f64 {
        let value = format!("{cold} of {}, for {} pixels are hot", target.events, target.hot_pixels);
        let how = match target.shortest_for_hot_s() {
            Some(shortest) => format!("record {shortest} s or more"),
            None => "record longer, a scene that is still, in light that does not flicker".into(),
        };
        let remedy = format!("at least {FEWEST}: {how}");
        let what = format!("number of events of pixels that fire up to {HOT_HZ} times per second");
        return Err(ConfigError::new(&what, value, remedy));
    }
    warnings.extend(signs_of_motion(&target, used, (start_us, duration_us)));
    let (sensor, simulated) = fit(&target, (width, height), duration_us, base, seed)?;
    let (found, unknown) = tell(&target, &sensor);
    for (name, of) in FIGURES.into_iter().chain([INTERVAL_FIGURE]) {
        if let (Some(want), Some(got)) = (of(&target), of(&simulated))
            && (got - want).abs() > 0.2 * want
        {
            warnings.push(format!("the model does not meet {name}: {got:.4} for {want:.4}"));
        }
    }
    Ok(Calibration { sensor, found, unknown, warnings, recording: target, simulated })
}

/// Events of pixels that are not hot.
fn cold_events(target: &Stats) -> f64 {
    target.events as f64 * (1.0 - target.hot_event_share.unwrap_or(0.0))
}

/// What says that the scene was not still.
fn signs_of_motion(target: &Stats, events: &[Event], (start_us, duration_us): (i64, i64)) -> Vec<String> {
    const COUNTED: &str = "the scene was probably not still, and its motion or flicker is counted as noise";
    let mut signs = Vec::new();
    if let Some(unsteadiness) = target.unsteadiness.filter(|unsteadiness| *unsteadiness > 0.15) {
        signs
            .push(format!("the rate varies by {:.0} % from 50 ms to 50 ms: {COUNTED}", unsteadiness * 100.0));
    }
    let size = (target.width as usize, target.height as usize);
    if let Some(alike) = likeness(events, size, (start_us, duration_us)).filter(|alike| alike.moves()) {
        signs.push(format!(
            "neighbouring pixels change together (correlation {:.2} in windows of {:.0} ms; noise that is independent from \
             pixel to pixel has 0.00): {COUNTED}",
            alike.correlation,
            alike.window_us as f64 * 1e-3
        ));
    }
    if target.hot_share > MOST_HOT {
        signs.push(format!(
            "{:.0} % of the pixels fire more than {HOT_HZ} times per second and count as hot: that many are no defects; the \
             scene was probably not still, or its noise is above {HOT_HZ} Hz, which cannot be fitted",
            target.hot_share * 100.0
        ));
    }
    signs
}

/// What a fit must meet.
type Figure = (&'static str, fn(&Stats) -> Option<f64>);
const HOT_FIGURE: &str = "the share of hot pixels";
const FIGURES: [Figure; 5] = [
    ("the rate without hot pixels", |s| s.cold_rate_hz),
    // A handful of hot pixels has no share.
    (HOT_FIGURE, |s| (s.hot_pixels >= 5).then_some(s.hot_share)),
    ("the ON share", |s| s.on_share),
    ("the Fano factor", |s| s.fano),
    ("the alternation of polarities", |s| s.alternation.filter(|_| s.pairs >= 100)),
];

/// What the recovery of shot noise is fitted to, where it is longer than independent events have it.
const INTERVAL_FIGURE: Figure = ("the median time between a pixel's events, in milliseconds", |s| {
    s.interval_quantiles_us.filter(|_| s.pairs >= 100).map(|quantiles| quantiles[2] * 1e-3)
});

/// The median time between a pixel's events that is wanted, and that of a simulation with `noise`, where a recovery of shot
/// noise is what they differ by: leaks are regular by themselves, and bursts that last have intervals of their own.
fn recovery(noise: &Noise, target: &Stats, got: &Stats) -> Option<(f64, f64)> {
    let (want, had) = (INTERVAL_FIGURE.1(target)?, INTERVAL_FIGURE.1(got)?);
    let has_own = noise.leak_hz > 0.0 || noise.burst_longest_us > 0.0;
    (!has_own && (noise.shot_recovery_us > 0.0 || want > 1.1 * had)).then_some((want, had))
}

/// Greatest relative difference of the figures that pixels which are not hot decide.
fn distance(target: &Stats, got: &Stats, noise: &Noise) -> f64 {
    if got.fano.is_none() {
        return f64::INFINITY;
    }
    let of = |(_, of): &Figure| Some((of(got)? / of(target)? - 1.0).abs());
    let hot = |(name, _): &&Figure| *name != HOT_FIGURE;
    let median = recovery(noise, target, got).map(|(want, had)| (had / want - 1.0).abs());
    FIGURES.iter().filter(hot).filter_map(of).chain(median).fold(0.0, f64::max)
}

/// Rounds without hot pixels first: a handful of them differs too much from draw to draw to be corrected. What the tail
/// of the others leaves of the recording's hot pixels is put on top at the end.
fn fit(
    target: &Stats,
    size: (u32, u32),
    duration_us: i64,
    base: &SensorConfig,
    seed: u64,
) -> Result<(SensorConfig, Stats), ConfigError> {
    let mut guess = Guess { noise: first_guess(target, base), tail_is_full: false };
    let simulate = |noise: Noise| -> Result<(SensorConfig, Stats), ConfigError> {
        let sensor = SensorConfig { noise, ..base.clone() };
        let events = static_scene(&sensor, size, duration_us, GREY, seed)?;
        Ok((sensor, stats(&events, size, (0, duration_us))?))
    };
    let mut best: Option<(f64, Noise, Stats)> = None;
    for _ in 0..ROUNDS {
        let (_, got) = simulate(guess.noise)?;
        // A tail that is hotter than the recording's hot pixels counts as far away.
        let apart = distance(target, &got, &guess.noise) + if too_hot(target, &got) { 10.0 } else { 0.0 };
        let next = guess.corrected(target, &got);
        if best.as_ref().is_none_or(|(least, ..)| apart < *least) {
            best = Some((apart, guess.noise, got));
        }
        if apart < CLOSE {
            break;
        }
        guess = next;
    }
    let remedy = "a recording that a sensor can be fitted to";
    let (_, mut noise, got) = best.ok_or_else(|| ConfigError::new("the recording", "unusable", remedy))?;
    let share = target.hot_share - got.hot_share;
    if share > 0.0 {
        let of_all = |stats: &Stats| stats.hot_share * stats.hot_hz.unwrap_or(0.0);
        let hz = (of_all(target) - of_all(&got)) / share;
        noise.hot_share = share.min(1.0) as f32;
        noise.hot_hz = hz.clamp(1.2 * HOT_HZ, 1e4) as f32;
    }
    simulate(noise)
}

/// Whether the tail of pixels that are not meant to be hot leaves too little room for those that are.
fn too_hot(target: &Stats, got: &Stats) -> bool {
    got.hot_pixels >= 5 && got.hot_share > 0.7 * target.hot_share
}

/// What a fit starts from and steers by.
#[derive(Clone, Copy)]
struct Cold {
    rate_hz: f64,
    on_hz: f64,
    off_hz: f64,
    on_share: f64,
    fano: f64,
    burst_share: f64,
}

impl Cold {
    /// A recording has all of them; a simulation on the way may be silent, and is steered away from as if it were Poisson's.
    fn of(stats: &Stats) -> Self {
        Self {
            rate_hz: stats.cold_rate_hz.unwrap_or(0.0),
            on_hz: stats.cold_on_hz.unwrap_or(0.0),
            off_hz: stats.cold_off_hz.unwrap_or(0.0),
            on_share: stats.on_share.unwrap_or(0.5),
            fano: stats.fano.unwrap_or(1.0),
            burst_share: stats.burst_share.unwrap_or(0.0),
        }
    }
}

/// Log-normal spread, in decades, whose coefficient of variation has this square.
fn decades(variation_squared: f64) -> f32 {
    ((1.0 + variation_squared.max(0.0)).ln().sqrt() / std::f64::consts::LN_10).clamp(0.0, 1.0) as f32
}

fn first_guess(target: &Stats, base: &SensorConfig) -> Noise {
    let cold = Cold::of(target);
    let mean = cold.rate_hz * target.duration_s;
    // Followers per event that is followed.
    let followers = cold.burst_share * target.pairs as f64;
    let events = cold_events(target).max(1.0);
    let burst = (followers / (events - followers).max(1.0)).clamp(0.0, 20.0);
    let spread = (cold.fano - 1.0 - 2.0 * burst) / mean.max(1e-9);
    let leak = leak(target);
    let shot_hz = if leak.is_some() { 2.0 * cold.off_hz } else { cold.rate_hz };
    let on_share = if leak.is_some() { 0.5 } else { cold.on_share };
    // What independent polarities would give.
    let chance = 2.0 * cold.on_share * (1.0 - cold.on_share);
    let alternation = target
        .alternation
        .filter(|told| target.pairs >= 100 && leak.is_none() && (told - chance).abs() > 0.03)
        .unwrap_or(-1.0);
    Noise {
        leak_hz: leak.map_or(0.0, |(hz, _)| hz as f32),
        leak_law: LeakLaw::Ramp,
        leak_jitter: leak.map_or(0.0, |(_, jitter)| jitter.clamp(0.0, 0.2) as f32),
        shot_hz: shot_hz as f32,
        shot_spread_decades: decades(spread),
        on_share: on_share as f32,
        reference: base.noise.reference,
        burst_events: if target.burst_interval_us.is_some() { burst as f32 } else { 0.0 },
        burst_us: if base.noise.burst_longest_us > 0.0 {
            base.noise.burst_us
        } else {
            target.burst_interval_us.map_or(300.0, |us| us.clamp(1.0, 2000.0) as f32)
        },
        burst_longest_us: base.noise.burst_longest_us,
        alternation: alternation as f32,
        ..Noise::default()
    }
}

/// Rate and jitter of the leak, where ON events are regular.
fn leak(target: &Stats) -> Option<(f64, f64)> {
    let variation = target.regularity.filter(|variation| *variation < 0.5)?;
    let hz = target.cold_on_hz? - target.cold_off_hz?;
    (hz > 0.0).then_some((hz, variation))
}

/// Noise on its way to what a recording shows.
#[derive(Clone, Copy)]
struct Guess {
    noise: Noise,
    /// Whether pixels may not differ more, for too many would be hot: bursts then make up the Fano factor.
    tail_is_full: bool,
}

impl Guess {
    fn corrected(self, target: &Stats, got: &Stats) -> Self {
        let Self { noise, mut tail_is_full } = self;
        let mut next = noise;
        let (want, had) = (Cold::of(target), Cold::of(got));
        let ratio = |want: f64, got: f64, most: f64| {
            if got > 0.0 { (want / got).clamp(1.0 / most, most) } else { most }
        };
        if noise.leak_hz > 0.0 {
            let missing = (want.on_hz - had.on_hz) - (want.off_hz - had.off_hz);
            next.leak_hz = (f64::from(noise.leak_hz) + missing).clamp(0.0, 1e4) as f32;
            let factor = ratio(want.off_hz, had.off_hz, 2.0);
            next.shot_hz = (f64::from(noise.shot_hz) * factor).min(1e4) as f32;
        } else {
            let factor = ratio(want.rate_hz, had.rate_hz, 2.0);
            next.shot_hz = (f64::from(noise.shot_hz) * factor).min(1e4) as f32;
            let share = f64::from(noise.on_share) + want.on_share - had.on_share;
            next.on_share = share.clamp(0.0, 1.0) as f32;
        }
        if let (true, Some(want), Some(had)) = (noise.alternation >= 0.0, target.alternation, got.alternation)
        {
            next.alternation = (f64::from(noise.alternation) + want - had).clamp(0.0, 1.0) as f32;
        }
        if let Some((want_ms, had_ms)) = recovery(&noise, target, got) {
            let recovery_us = f64::from(noise.shot_recovery_us) + 1e3 * (want_ms - had_ms);
            next.shot_recovery_us = recovery_us.clamp(0.0, 1e6) as f32;
        }
        // Pixels' rates differ by this, squared, relative to their mean.
        let squared = (f64::from(noise.shot_spread_decades) * std::f64::consts::LN_10).powi(2).exp() - 1.0;
        let mean = (want.rate_hz * target.duration_s).max(1e-9);
        let missing = want.fano - had.fano;
        if too_hot(target, got) || (noise.shot_spread_decades >= 1.0 && missing > 0.0) {
            tail_is_full = true;
            next.shot_spread_decades = decades(squared * 0.6);
        }
        if tail_is_full {
            let burst = f64::from(noise.burst_events) + missing / 2.0;
            next.burst_events = burst.clamp(0.0, 20.0) as f32;
            if noise.burst_longest_us == 0.0 {
                // As long as exponential delays may be: such recordings have longer ones.
                next.burst_us = 2000.0;
            }
            return Self { noise: next, tail_is_full };
        }
        if noise.burst_events > 0.0 {
            let factor = ratio(want.burst_share, had.burst_share, 1.5);
            next.burst_events = (f64::from(noise.burst_events) * factor).clamp(0.0, 20.0) as f32;
            if let (Some(want), Some(had), true) =
                (target.burst_interval_us, got.burst_interval_us, noise.burst_longest_us == 0.0)
            {
                next.burst_us = (f64::from(noise.burst_us) * ratio(want, had, 1.5)).clamp(1.0, 2000.0) as f32;
            }
        }
        // The spread makes up what bursts leave of the Fano factor: linear in the squared variation.
        next.shot_spread_decades = decades(squared + missing / mean);
        Self { noise: next, tail_is_full }
    }
}

/// What was found, and what cannot be.
fn tell(target: &Stats, sensor: &SensorConfig) -> (Vec<Estimate>, Vec<String>) {
    let mut found = Vec::new();
    let mut say = |name: &str, value: f64, unit: &str, note: &str| {
        found.push(Estimate { name: name.into(), value, unit: unit.into(), note: note.into() });
    };
    let noise = &sensor.noise;
    let cold = Cold::of(target);
    say("ON noise", cold.on_hz, "Hz", "per pixel, hot pixels left out");
    say("OFF noise", cold.off_hz, "Hz", "per pixel, hot pixels left out");
    if noise.leak_hz > 0.0 {
        say(
            "leak",
            noise.leak_hz.into(),
            "Hz",
            "ON events come at regular times, as a leaking reference makes them",
        );
    } else {
        let most = (cold.on_hz - cold.off_hz).max(0.0);
        say(
            "leak, at most",
            most,
            "Hz",
            "what ON events exceed OFF events by; they are not regular, so counted as shot noise",
        );
    }
    say("hot pixels", target.hot_share, "share", "above 20 Hz");
    if let Some(hot_hz) = target.hot_hz {
        say("rate of a hot pixel", hot_hz, "Hz", "mean; the model gives all the same");
    }
    say("Fano factor", cold.fano, "", "of the counts of pixels that are not hot; 1: alike and independent");
    say(
        "spread of pixels' rates",
        noise.shot_spread_decades.into(),
        "decades",
        "log-normal; explains the Fano factor",
    );
    if noise.burst_events > 0.0 {
        say("bursts", noise.burst_events.into(), "events", "that follow each event");
        let delay = if noise.burst_longest_us > 0.0 {
            "shortest; the base's, as the longest is"
        } else {
            "mean; at most 2000 in the model"
        };
        say("delay within a burst", noise.burst_us.into(), "us", delay);
    }
    if noise.shot_recovery_us > 0.0 {
        let note =
            "after an event, until shot noise is back; explains the median time between a pixel's events";
        say("recovery of shot noise", noise.shot_recovery_us.into(), "us", note);
    }
    if let Some(alternation) = target.alternation {
        let note = if noise.alternation >= 0.0 {
            "chance that a pixel's next event has the other polarity, within a recording of this length"
        } else {
            "chance that a pixel's next event has the other polarity; as independent polarities have it, or too few pairs"
        };
        say("alternation", alternation, "", note);
    }
    if let Some(least) = target.least_interval_us {
        say(
            "refractory time, at most",
            least as f64,
            "us",
            "shortest interval at one pixel; the file keeps its base's value",
        );
    }
    let unknown = [
        "thresholds and their spread between pixels: nothing crosses them in a still scene, flickering light does",
        "bandwidth, and latency: they show in light that flickers at several frequencies",
        "how noise depends on light: one recording has one light; the fitted rates hold at any",
        "leak apart from shot noise, unless ON events are regular",
        "whether a rate is the pixel's or the scene's: flicker and motion count as noise",
        "the refractory time itself, dead pixels (a silent pixel may only be quiet), and the bus",
    ];
    (found, unknown.map(String::from).to_vec())
}

/// A number of four digits.
pub(super) fn digits(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if value.abs() < 1e-3 {
        return format!("{value:.3e}");
    }
    let decimals = (3 - value.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{value:.decimals$}")
}

impl fmt::Display for Calibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "found")?;
        for Estimate { name, value, unit, note } in &self.found {
            writeln!(f, "  {name:<26} {:>10} {unit:<8} {note}", digits(*value))?;
        }
        writeln!(f, "met by the model, before a still scene of the same length")?;
        for (name, of) in FIGURES {
            let text = |stats| of(stats).map_or_else(|| "-".into(), digits);
            let (want, got) = (text(&self.recording), text(&self.simulated));
            writeln!(f, "  {name:<30} {got:>10} for {want:>10}")?;
        }
        write!(f, "not to be had from such a recording")?;
        for line in &self.unknown {
            write!(f, "\n  {line}")?;
        }
        Ok(())
    }
}
