//! Thresholds and bandwidth from recordings of light that flickers as a sine.

use std::f64::consts::{PI, TAU};
use std::fmt;

use serde::{Deserialize, Serialize};

use super::calibrate::digits;
use crate::event::Event;
use crate::sensor::{Bandwidth, ConfigError, Photoreceptor, Sensor, SensorConfig};

/// Pairs of events that are enough to find the phase with.
const MOST_PAIRS: usize = 20_000;

/// Fewer pairs than this say nothing.
const FEWEST: usize = 100;

/// Events that follow a stimulus are in step with it by more than this: 0 is none, 1 all at one phase.
const IN_STEP: f64 = 0.2;

/// Light that all pixels see: `mean · (1 + contrast · sin(2 pi hz t))`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stimulus {
    /// Periods per second.
    pub hz: f64,
    /// `(most - least) / (most + least)` of light.
    pub contrast: f64,
}

impl Stimulus {
    /// Checks the values.
    ///
    /// # Errors
    /// A frequency that is not above 0, or above 100 kHz; a contrast that is not between 0 and 0.999.
    pub fn new(hz: f64, contrast: f64) -> Result<Self, ConfigError> {
        if !(hz > 0.0 && hz <= 1e5) {
            return Err(ConfigError::new("stimulus frequency", hz, "above 0 and at most 100000 Hz"));
        }
        if !(contrast > 0.0 && contrast <= 0.999) {
            return Err(ConfigError::new("stimulus contrast", contrast, "above 0 and at most 0.999"));
        }
        Ok(Self { hz, contrast })
    }

    /// From the least to the greatest logarithm of light.
    pub fn swing(&self) -> f64 {
        ((1.0 + self.contrast) / (1.0 - self.contrast)).ln()
    }

    /// Logarithm of light at this phase.
    fn log(&self, phase: f64) -> f64 {
        (1.0 + self.contrast * phase.sin()).ln()
    }
}

/// What flickering light says about a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlickerFit {
    /// The sensor, with what was found in place of what was there.
    pub sensor: SensorConfig,
    /// Per recording: the stimulus, and the thresholds that it shows: those of the pixel over what its low-pass leaves of
    /// the stimulus.
    pub recordings: Vec<Apparent>,
    /// Rise of log light that fires an ON event.
    pub threshold_on: f64,
    /// Fall of log light that fires an OFF event.
    pub threshold_off: f64,
    /// Standard deviation of thresholds between pixels.
    pub sigma: f64,
    /// -3 dB frequency of a low-pass of one pole, where recordings at two frequencies or more show one.
    pub cutoff_hz: Option<f64>,
    /// What such recordings cannot say.
    pub unknown: Vec<String>,
}

/// Thresholds as one stimulus shows them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Apparent {
    /// The stimulus.
    pub stimulus: Stimulus,
    /// Apparent threshold of ON events, log units: the median over pixels.
    pub on: f64,
    /// Apparent threshold of OFF events.
    pub off: f64,
    /// Deviation between pixels, from the median one; what the events of single pixels scatter by is taken off.
    pub sigma: f64,
    /// Pairs of events that were measured.
    pub pairs: usize,
}

/// Two events of one polarity in a row at a pixel.
struct Pair {
    pixel: u32,
    on: bool,
    from: f64,
    to: f64,
}

/// Finds thresholds, and the bandwidth where there are several frequencies, from recordings of flickering light; all else
/// is taken from `base`.
///
/// Between two events of one polarity in a row, the pixel's signal has moved by just its threshold. The phase of the
/// stimulus is the one at which these steps differ least.
///
/// # Errors
/// No recording, a stimulus that cannot be, too few events in a row of one polarity.
pub fn calibrate_flicker(
    recordings: &[(&[Event], (u32, u32), Stimulus)],
    base: &SensorConfig,
) -> Result<FlickerFit, ConfigError> {
    Sensor::new(base.clone())?;
    let mut found = Vec::new();
    for (events, size, stimulus) in recordings {
        Stimulus::new(stimulus.hz, stimulus.contrast)?;
        found.push(apparent(events, *size, *stimulus)?);
    }
    found.sort_by(|a, b| a.stimulus.hz.total_cmp(&b.stimulus.hz));
    let Some(slowest) = found.first() else {
        return Err(ConfigError::new("number of recordings", 0, "at least 1"));
    };
    let cutoff_hz = cutoff(&found);
    // What the low-pass leaves at the lowest frequency.
    let left = cutoff_hz.map_or(1.0, |cutoff| gain(slowest.stimulus.hz, cutoff));
    let (on, off, sigma) = (slowest.on * left, slowest.off * left, slowest.sigma * left);
    let mut sensor = base.clone();
    (sensor.threshold_on, sensor.threshold_off) = (on as f32, off as f32);
    sensor.pattern.sigma = sigma as f32;
    if let Some(cutoff_hz) = cutoff_hz {
        sensor.photoreceptor = Photoreceptor {
            cutoff_hz: cutoff_hz as f32,
            order: 1,
            bandwidth: Bandwidth::Constant,
            ..sensor.photoreceptor
        };
    }
    Sensor::new(sensor.clone())?;
    let mut unknown = vec![
        "noise rates and hot pixels: the stimulus hides them (a still scene)".to_owned(),
        "how bandwidth depends on light: record at several lights".into(),
        "latency: the stimulus has no clock of its own in a recording".into(),
    ];
    if cutoff_hz.is_none() {
        unknown.insert(
            0,
            if found.len() < 2 {
                "bandwidth: thresholds are those of a sensor that follows the stimulus; record a second frequency".into()
            } else {
                "bandwidth: thresholds do not rise with the frequency; record a higher one".into()
            },
        );
    }
    Ok(FlickerFit {
        sensor,
        recordings: found,
        threshold_on: on,
        threshold_off: off,
        sigma,
        cutoff_hz,
        unknown,
    })
}

/// What one pole leaves of a sine.
fn gain(hz: f64, cutoff_hz: f64) -> f64 {
    1.0 / (1.0 + (hz / cutoff_hz).powi(2)).sqrt()
}

/// The cutoff with which one pair of thresholds explains all recordings best.
fn cutoff(found: &[Apparent]) -> Option<f64> {
    let (slowest, fastest) = (found.first()?, found.last()?);
    let rise = (fastest.on * fastest.off / (slowest.on * slowest.off)).sqrt();
    // Five per cent are within what steps are known to.
    if fastest.stimulus.hz < 1.5 * slowest.stimulus.hz || rise < 1.05 {
        return None;
    }
    let spread = |cutoff_hz: f64| {
        let logs: Vec<f64> =
            found.iter().map(|a| 0.5 * (a.on * a.off).ln() + gain(a.stimulus.hz, cutoff_hz).ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>()
    };
    // A quarter of a per cent per step, over five decades around the stimuli.
    let low = slowest.stimulus.hz * 0.01;
    (0..4600).map(|k| low * 1.0025_f64.powi(k)).min_by(|a, b| spread(*a).total_cmp(&spread(*b)))
}

fn apparent(
    events: &[Event],
    (width, height): (u32, u32),
    stimulus: Stimulus,
) -> Result<Apparent, ConfigError> {
    let pixels = width as usize * height as usize;
    let phase = |t_us: i64| TAU * (t_us as f64 * 1e-6 * stimulus.hz).fract();
    let half_us = (0.5e6 / stimulus.hz) as i64;
    let mut last: Vec<Option<(i64, bool)>> = vec![None; pixels];
    let mut pairs = Vec::new();
    for event in events {
        let index = usize::from(event.y) * width as usize + usize::from(event.x);
        let Some(last) = last.get_mut(index).filter(|_| u32::from(event.x) < width) else {
            let remedy = format!("within {width}x{height} pixels");
            return Err(ConfigError::new("an event", format!("{event:?}"), remedy));
        };
        let on = event.p == 1;
        if let Some((t_us, was_on)) = *last
            && was_on == on
            && (1..half_us).contains(&(event.t - t_us))
        {
            pairs.push(Pair { pixel: index as u32, on, from: phase(t_us), to: phase(event.t) });
        }
        *last = Some((event.t, on));
    }
    let counts = [false, true].map(|on| pairs.iter().filter(|pair| pair.on == on).count());
    if counts.into_iter().any(|count| count < FEWEST) {
        let remedy = format!(
            "at least {FEWEST} of each polarity: the stimulus moves log light by {:.3}, and a pixel must fire twice on the \
             way; raise the contrast, lower the frequency, or record longer",
            stimulus.swing()
        );
        let told = format!("{} ON and {} OFF", counts[1], counts[0]);
        return Err(ConfigError::new("number of events in a row of one polarity", told, remedy));
    }
    // Events of a pixel that follows the stimulus gather at two phases, by polarity.
    let (mut real, mut imaginary) = (0.0, 0.0);
    for event in events {
        let sign = if event.p == 1 { 1.0 } else { -1.0 };
        let (sin, cos) = phase(event.t).sin_cos();
        (real, imaginary) = (real + sign * cos, imaginary + sign * sin);
    }
    let in_step = f64::hypot(real, imaginary) / events.len().max(1) as f64;
    if in_step < IN_STEP {
        let told = format!("{:.0} % in step with {} Hz", in_step * 100.0, stimulus.hz);
        let remedy = format!(
            "at least {:.0} %: check the frequency, and that all pixels see the light",
            IN_STEP * 100.0
        );
        return Err(ConfigError::new("the recording", told, remedy));
    }
    // Every so many, so that all of the recording counts.
    let thinned: Vec<&Pair> = pairs.iter().step_by(pairs.len().div_ceil(MOST_PAIRS)).collect();
    let misfit = |shift: f64| {
        let mut total = 0.0;
        for on in [false, true] {
            let mut steps: Vec<f64> =
                thinned.iter().filter(|pair| pair.on == on).map(|pair| step(stimulus, pair, shift)).collect();
            steps.sort_unstable_by(f64::total_cmp);
            let at = |q: f64| steps.get((q * (steps.len() - 1) as f64) as usize).copied().unwrap_or(0.0);
            // Steps that go backwards cannot be.
            let middle = at(0.5);
            total += if middle > 0.0 { (at(0.9) - at(0.1)) / middle } else { 1e6 };
        }
        total
    };
    let least = |from: f64, to: f64, count: u32| {
        let at = |k: u32| from + (to - from) * f64::from(k) / f64::from(count);
        (0..=count).map(at).min_by(|a, b| misfit(*a).total_cmp(&misfit(*b))).unwrap_or(0.0)
    };
    let rough = least(-PI, PI, 90);
    let shift = least(rough - 0.08, rough + 0.08, 64);

    // Pairs of a pixel side by side.
    pairs.sort_unstable_by_key(|pair| (pair.on, pair.pixel));
    let mut of_pixels = [Vec::new(), Vec::new()];
    let mut scatter = Vec::new();
    for same in pairs.chunk_by(|a, b| (a.on, a.pixel) == (b.on, b.pixel)) {
        let mut steps: Vec<f64> = same.iter().map(|pair| step(stimulus, pair, shift)).collect();
        let n = steps.len() as f64;
        let mean = steps.iter().sum::<f64>() / n;
        if n >= 2.0 {
            let variance = steps.iter().map(|step| (step - mean).powi(2)).sum::<f64>() / (n - 1.0);
            scatter.push(variance / n);
        }
        if let Some(first) = same.first() {
            let value = if n < 5.0 { mean } else { median(&mut steps) };
            of_pixels[usize::from(first.on)].push(value);
        }
    }
    let own = if scatter.is_empty() { 0.0 } else { median(&mut scatter) };
    let [off, on] = &mut of_pixels;
    let mut sigmas = [0.0; 2];
    let mut middles = [0.0; 2];
    for (k, values) in [on, off].into_iter().enumerate() {
        middles[k] = median(values);
        let mut apart: Vec<f64> = values.iter().map(|value| (value - middles[k]).abs()).collect();
        // Median absolute deviation of a normal distribution.
        let deviation = 1.4826 * median(&mut apart);
        sigmas[k] = (deviation.powi(2) - own).max(0.0).sqrt();
    }
    let sigma = (sigmas[0] + sigmas[1]) / 2.0;
    Ok(Apparent { stimulus, on: middles[0], off: middles[1], sigma, pairs: pairs.len() })
}

/// What log light moved by, in the direction of the events.
fn step(stimulus: Stimulus, pair: &Pair, shift: f64) -> f64 {
    let moved = stimulus.log(pair.to - shift) - stimulus.log(pair.from - shift);
    if pair.on { moved } else { -moved }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

impl fmt::Display for FlickerFit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "threshold ON      {}", digits(self.threshold_on))?;
        writeln!(f, "threshold OFF     {}", digits(self.threshold_off))?;
        writeln!(f, "spread of both    {}", digits(self.sigma))?;
        match self.cutoff_hz {
            Some(hz) => writeln!(f, "cutoff            {} Hz", digits(hz))?,
            None => writeln!(f, "cutoff            -")?,
        }
        for Apparent { stimulus, on, off, pairs, .. } in &self.recordings {
            writeln!(
                f,
                "  at {} Hz, contrast {}: ON {}, OFF {} from {pairs} pairs of events",
                digits(stimulus.hz),
                digits(stimulus.contrast),
                digits(*on),
                digits(*off)
            )?;
        }
        write!(f, "not to be had from such recordings")?;
        for line in &self.unknown {
            write!(f, "\n  {line}")?;
        }
        Ok(())
    }
}
