//! The cheapest settings that are accurate enough on a scene, found by simulating parts of it.
//!
//! A calibration run (`pilot`) simulates some tiles of the picture at some times of the scene, with candidates from the cheapest
//! up, by rendering and by decoupled sampling, and renders them with a reference that shares none of their shortcuts: every instant of a fixed rate, no bounds on motion, no tile
//! left out, no curves, whole samples instead of coverage samples, and more of them. The first candidate whose events agree
//! with the reference's is taken.

mod pilot;

use std::cell::RefCell;
use std::path::Path;
use std::sync::Arc;

use evis_core::ConfigError;
use evis_scene::Scene;
use pilot::{PLACES, Pilot};
use serde::{Deserialize, Serialize};

use crate::config::{Antialias, Method, Quality, RunConfig, Shadows};
use crate::engine::simulator::Simulator;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::request::quality::SamplingSettings;
use crate::request::settings::SettingsFile;

pub use pilot::Agreement;

/// Reports what is tried and the part of all that is done; returns false to stop.
pub type ProgressFn<'a> = dyn Fn(&str, f64) -> bool + 'a;

/// Stream time that is timed at each place of the scene, after some that is not.
const TIMED_US: i64 = 32_000;

const WARM_UP_US: i64 = 16_000;

/// What is found on the CPU, without rendering, the cheapest first.
const DECOUPLED: [SamplingSettings; 4] = [
    Quality::Draft.sampling(),
    Quality::Standard.sampling(),
    Quality::High.sampling(),
    SamplingSettings::decoupled(0.25),
];

/// What is rendered, the cheapest first.
const RENDERED: [SamplingSettings; 8] = [
    Quality::Draft.sampling().rendered(),
    Quality::Standard.sampling().rendered(),
    SamplingSettings::coverage(0.4, 36, 4),
    SamplingSettings::coverage(0.4, 64, 4),
    SamplingSettings::with_rays(0.4, 100),
    Quality::High.sampling().rendered(),
    SamplingSettings::with_rays(0.2, 144),
    Quality::Reference.sampling(),
];

/// What settings must do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// F1 within 1 ms beside the reference, at least.
    pub target_f1: f64,
    /// Milliseconds of work per simulated second, at most.
    pub budget_ms: Option<f64>,
}

impl Goal {
    /// # Errors
    /// An F1 that is not in (0, 1), a budget that is not above 0.
    pub fn check(&self) -> Result<(), ConfigError> {
        if !(self.target_f1 > 0.0 && self.target_f1 < 1.0) {
            return Err(ConfigError::new("target_f1", self.target_f1, "above 0 and below 1, such as 0.98"));
        }
        match self.budget_ms {
            Some(ms) if !(ms.is_finite() && ms > 0.0) => {
                let remedy = "a number of milliseconds of work per simulated second above 0, such as 1000";
                Err(ConfigError::new("budget", ms, remedy))
            }
            _ => Ok(()),
        }
    }
}

/// Settings that were tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// In words.
    pub what: String,
    /// How their events agree with the reference's; `None` where too few fired to say.
    #[serde(flatten)]
    pub agreement: Option<Agreement>,
    /// Milliseconds of work per simulated second, where there is a budget.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ms_per_s: Option<f64>,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Tuned {
    /// The run with the settings that were found.
    pub config: RunConfig,
    /// What was tried, the cheapest first.
    pub tried: Vec<Tried>,
    /// Which of them was taken.
    pub taken: usize,
    /// The reference, in words.
    pub reference: String,
    /// Tiles, at all times together.
    pub tiles: usize,
    /// What the user asked for and cannot have.
    pub warning: Option<String>,
}

impl Tuned {
    /// Writes the settings, with what was measured as a comment.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, path: &Path, scene: &str) -> Result<(), EngineError> {
        let figures = self.tried.iter().enumerate().map(|(index, tried)| {
            let mark = if index == self.taken { "* " } else { "  " };
            format!("{mark}{}\n", tried.line())
        });
        let comment = format!(
            "Found by `evis tune` on {scene}: F1 within 1 ms beside {}, in {} tiles at {PLACES} times.\n{}",
            self.reference,
            self.tiles,
            figures.collect::<String>()
        );
        SettingsFile::sampling(&self.config).write(path, &comment)
    }
}

impl Tried {
    /// In one line.
    pub fn line(&self) -> String {
        let f1 = self.agreement.map_or_else(
            || "too few events to compare".into(),
            |of| format!("F1 (1 ms) {:.3}, F1 (100 us) {:.3}", of.f1_1ms, of.f1_100us),
        );
        let cost = self.ms_per_s.map_or_else(String::new, |ms| format!(", {ms:.0} ms per simulated second"));
        format!("{}: {f1}{cost}", self.what)
    }
}

/// Finds the cheapest settings of `config`'s run on `scene` that reach `goal`.
///
/// # Errors
/// A goal or a setting that cannot be used, a device that fails, or a stop.
pub fn tune(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    goal: Goal,
    progress: &ProgressFn<'_>,
) -> Result<Tuned, EngineError> {
    goal.check()?;
    config.check()?;
    let doing = RefCell::new((String::new(), 0.0));
    let stop = || {
        let doing = doing.borrow();
        !progress(&doing.0, doing.1)
    };
    let candidates = candidates(gpu, scene, config)?;
    let mut pilot = Pilot::new(gpu, scene, config, &stop)?;
    let steps = candidates.len() + 2;
    let mut done = 0;
    let mut next = |what: String| {
        *doing.borrow_mut() = (what, f64::from(done) / steps as f64);
        done += 1;
    };
    // The cheapest shows how many tiles it takes to see enough events.
    next(words(&candidates[0]));
    let probe = pilot.fire(&candidates[0])?;
    pilot.adjust(&probe);
    let reference_words = pilot.reference_words();
    next(reference_words.clone());
    let reference = pilot.fire_reference(config)?;
    let (mut tried, mut taken) = (Vec::new(), None);
    for (index, candidate) in candidates.iter().enumerate() {
        next(words(candidate));
        let fired = pilot.fire(candidate)?;
        let agreement = pilot.agreement(&fired, &reference)?;
        let ms_per_s = match goal.budget_ms {
            Some(_) => Some(time(gpu, scene, candidate, &stop)?),
            None => None,
        };
        tried.push(Tried { what: words(candidate), agreement, ms_per_s });
        let exceeds = ms_per_s.zip(goal.budget_ms).is_some_and(|(ms, budget)| ms > budget);
        if exceeds {
            // What is finer costs more.
            break;
        }
        taken = Some(index);
        // Too few events to compare settings by: the next one would tell no more.
        if agreement.is_none_or(|of| of.f1_1ms >= goal.target_f1) && (agreement.is_some() || index > 0) {
            break;
        }
    }
    let met = taken.and_then(|index| tried[index].agreement).is_some_and(|of| of.f1_1ms >= goal.target_f1);
    let warning = match (taken, goal.budget_ms) {
        (Some(index), _) if tried[index].agreement.is_none() => Some(
            "too few events fire in the tiles that were simulated to compare settings; the standard ones are taken".into(),
        ),
        (None, Some(budget)) => {
            Some(format!("no settings take {budget} ms per simulated second or less; the cheapest are taken"))
        }
        _ if !met => Some(match goal.budget_ms {
            Some(budget) => {
                format!("an F1 of {} takes more than {budget} ms per simulated second", goal.target_f1)
            }
            None => format!("no settings reach an F1 of {}; the finest are taken", goal.target_f1),
        }),
        _ => None,
    };
    let taken = taken.unwrap_or(0);
    let tiles = pilot.tiles();
    Ok(Tuned { config: candidates[taken].clone(), tried, taken, reference: reference_words, tiles, warning })
}

/// What is tried for `config`'s run on `scene`, the cheapest first.
fn candidates(gpu: &Gpu, scene: &Scene, config: &RunConfig) -> Result<Vec<RunConfig>, EngineError> {
    let with = |sampling: &SamplingSettings| {
        let mut candidate = config.clone();
        sampling.apply(Some(gpu), scene, &mut candidate).map(|_| candidate)
    };
    let rendered: Vec<_> = RENDERED.iter().map(with).collect::<Result<_, _>>()?;
    let mut decoupled: Vec<_> = DECOUPLED.iter().map(with).collect::<Result<_, _>>()?;
    // Of a scene or a sensor that decoupled sampling does not know, it says so by rendering.
    decoupled.retain(|candidate| candidate.method == Method::Decoupled);
    let software = gpu.summary().kind == "cpu";
    let [first, second] = if software { [decoupled, rendered] } else { [rendered, decoupled] };
    Ok(first.into_iter().chain(second).collect())
}

/// Milliseconds of work per simulated second, as packets report it.
fn time(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    stop: &dyn Fn() -> bool,
) -> Result<f64, EngineError> {
    let length_us = (pilot::length_s(scene, config.start_us as f64 * 1e-6) * 1e6) as i64;
    let room_us = (length_us - WARM_UP_US - TIMED_US).max(0);
    let mut ms = 0.0;
    for place in 0..PLACES as i64 {
        let start_us = config.start_us + room_us * place / (PLACES as i64 - 1);
        let mut simulator = Simulator::new(gpu, Arc::clone(scene), RunConfig { start_us, ..config.clone() })?;
        for until_us in [WARM_UP_US, WARM_UP_US + TIMED_US] {
            if stop() {
                return Err(EngineError::Stopped);
            }
            let packet = simulator.step(until_us)?;
            if until_us > WARM_UP_US {
                ms += packet.report.times.total_ms;
            }
        }
    }
    Ok(ms * 1e6 / (PLACES as i64 * TIMED_US) as f64)
}

/// `0.4 px, 100 samples, shadow rays`.
fn words(config: &RunConfig) -> String {
    let whole = if config.antialias == Antialias::Samples { " whole" } else { "" };
    let rays = if config.shadows == Some(Shadows::Rays) { ", shadow rays" } else { "" };
    let step = config.adaptive_px.map_or_else(|| format!("{} Hz", config.rate_hz), |px| format!("{px} px"));
    if config.method == Method::Decoupled {
        return format!("decoupled, {step}");
    }
    format!("{step}, {}{whole} samples{rays}", config.samples)
}
