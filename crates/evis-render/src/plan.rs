//! What `auto` found, kept: for a budget of time its settings are timed on the scene once, for a target some tiles of it
//! are looked at, and a plan keeps what came of it. Whoever replays a plan looks at neither clock nor scene, so the
//! stream's bytes are a function of the plan and of what the user asks for.

use std::hash::Hasher as _;
use std::path::Path;
use std::sync::Arc;

use evis_core::ConfigError;
use evis_core::fnv::Fnv;
use evis_scene::{Scene, SceneError};
use serde::{Deserialize, Serialize};

use crate::auto::{self, Chosen, LADDER, Site, Target};
use crate::config::{Antialias, Between, Method, RunConfig, Shadows};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::search::Looked;
use crate::simulator::Simulator;
use crate::view;

/// Times of the scene at which settings are timed, from its start to its end.
const PLACES: i64 = 3;
/// What runs before each, not timed: the first pictures, shaders, and a block of adaptive time.
const WARM_UP_US: i64 = 16_000;
/// What is timed at each: whole blocks at every rate, and a keyframe's share.
const TIMED_US: i64 = 32_000;

/// What a user asks `auto` for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// How near to the truth events shall be.
    Target(Target),
    /// Milliseconds of work per simulated second.
    Budget(f64),
}

impl Goal {
    fn in_words(self) -> String {
        match self {
            Self::Target(target) => format!("the target {}", target.name()),
            Self::Budget(ms) => format!("a budget of {ms} ms per simulated second"),
        }
    }
}

/// Settings for a goal, and how they were found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Version that made it.
    pub evis: String,
    /// Milliseconds of work per simulated second, if these were asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget_ms: Option<f64>,
    /// The target, if one was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<Target>,
    /// Why these settings.
    pub why: String,
    /// What they reached on the built-in scenes.
    pub expects: String,
    /// What is rendered.
    pub settings: Settings,
    /// What it was made for: it is refused for anything else.
    pub made_for: MadeFor,
    /// For a budget: what was timed, the most accurate first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measured: Vec<Measured>,
    /// For a target: what was looked at. Nothing, where settings are the same for every scene or too little fired.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub looked: Option<Looked>,
}

/// What `auto` sets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// [`RunConfig::method`].
    pub method: Method,
    /// [`RunConfig::rate_hz`].
    pub rate_hz: f64,
    /// [`RunConfig::adaptive_px`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive_px: Option<f64>,
    /// [`RunConfig::between`].
    #[serde(default)]
    pub between: Between,
    /// [`RunConfig::antialias`].
    #[serde(default)]
    pub antialias: Antialias,
    /// [`RunConfig::samples`].
    pub samples: u32,
    /// [`RunConfig::texture_taps`].
    pub texture_taps: u32,
    /// [`RunConfig::shadows`].
    pub shadows: Shadows,
}

/// What makes a plan's settings what they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MadeFor {
    /// Name of the scene.
    pub scene: String,
    /// A number for all that the scene holds.
    pub content: String,
    /// [`RunConfig::start_us`].
    pub start_us: i64,
    /// [`RunConfig::shadows`] as asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shadows: Option<Shadows>,
    /// [`RunConfig::shadow_map`], where that is set.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shadow_map: Option<u32>,
    /// For a budget, since they take time: [`RunConfig::label_rate_hz`], where labels are rendered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub label_rate_hz: Option<f64>,
    /// For a budget: [`RunConfig::frame_rate_hz`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_rate_hz: Option<f64>,
    /// For a target, since they say what fires: [`RunConfig::reference_luminance`], where that is set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_luminance: Option<f32>,
    /// Names and sizes.
    pub cameras: Vec<String>,
    /// For a target: thresholds and `log_eps` of each camera's sensor.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<String>,
}

/// What some settings took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// [`Settings::in_words`].
    pub what: String,
    /// Milliseconds of work per simulated second.
    pub ms_per_s: f64,
}

/// Told what is tried and the part of all that is done; returns false to stop.
pub type Told<'a> = dyn Fn(&str, f64) -> bool + 'a;

/// Settles `config`, which asks for `auto`: by the plan that `path` holds; else for `goal`, by timing the scene or
/// looking at it, and then `path` holds the plan. A plan that is there is all that is looked at, and must be for `goal`,
/// if that is given. Without a goal and a plan that is there it is for the target that the method names.
///
/// # Errors
/// A plan that is broken or was made for something else, a file that cannot be read or written, a device that fails, or
/// a stop.
pub fn settle(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &mut RunConfig,
    goal: Option<Goal>,
    path: Option<&Path>,
    told: &Told<'_>,
) -> Result<(), EngineError> {
    if let Some(Goal::Budget(ms)) = goal
        && !(ms.is_finite() && ms > 0.0)
    {
        let remedy = "a number of milliseconds of work per simulated second above 0, such as 1000";
        return Err(ConfigError::new("budget", ms, remedy).into());
    }
    let Method::Auto(usual) = config.method else {
        let remedy = "auto, for a target, a budget or a plan";
        return Err(ConfigError::new("method", config.method.name(), remedy).into());
    };
    let plan = if let Some(path) = path.filter(|path| path.exists()) {
        let plan = Plan::read(path)?;
        if let (Some(own), Some(asked)) = (plan.goal(), goal)
            && own != asked
        {
            return Err(plan.refused(path, &own.in_words(), &asked.in_words()).into());
        }
        plan.check_made_for(path, &MadeFor::new(scene, config, plan.target.is_some())?)?;
        plan
    } else {
        let folder = path.and_then(Path::parent).filter(|folder| !folder.as_os_str().is_empty());
        if let (Some(path), Some(false)) = (path, folder.map(Path::is_dir)) {
            let source = std::io::Error::from(std::io::ErrorKind::NotFound);
            return Err(EngineError::Write { path: path.into(), source });
        }
        let plan = match goal.unwrap_or(Goal::Target(usual)) {
            // Nobody asks what that was made for.
            Goal::Target(target) if path.is_none() => {
                auto::choose(gpu, scene, target, config, told)?;
                return Ok(());
            }
            Goal::Budget(budget_ms) => calibrate(gpu, scene, config, budget_ms, told)?,
            Goal::Target(target) => look(gpu, scene, config, target, told)?,
        };
        if let Some(path) = path {
            plan.write(path)?;
        }
        plan
    };
    plan.apply(config);
    Ok(config.check()?)
}

/// Looks at `scene` for `target`, where that takes a look.
///
/// # Errors
/// A setting that cannot be used, a device that fails, or a stop.
pub fn look(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    target: Target,
    told: &Told<'_>,
) -> Result<Plan, EngineError> {
    config.check()?;
    let made_for = MadeFor::new(scene, config, true)?;
    let mut settled = config.clone();
    let (chosen, looked) = auto::choose(gpu, scene, target, &mut settled, told)?;
    Ok(Plan {
        evis: env!("CARGO_PKG_VERSION").into(),
        budget_ms: None,
        target: Some(target),
        why: chosen.why,
        expects: chosen.expects,
        settings: Settings::of(&settled),
        made_for,
        measured: Vec::new(),
        looked,
    })
}

/// Times the ladder of `auto` on `scene`, as far as it takes to know what fits the budget.
///
/// # Errors
/// A setting that cannot be used, a device that fails, or a stop.
pub fn calibrate(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    budget_ms: f64,
    told: &Told<'_>,
) -> Result<Plan, EngineError> {
    config.check()?;
    let made_for = MadeFor::new(scene, config, false)?;
    let site = Site::new(gpu, scene, config)?;
    let mut settled: Vec<_> = LADDER.iter().map(|rung| site.settled(rung, config)).collect();
    drop(site);
    let mut costs = vec![None; settled.len()];
    let mut done = 0;
    while let Some(next) = next(&costs, budget_ms) {
        let what = Settings::of(&settled[next].0).in_words();
        let stop = || !told(&what, f64::from(done) / LADDER.len() as f64);
        let (ms, reference) = time(gpu, scene, &settled[next].0, &stop)?;
        // One Y_ref for all, and it is measured once.
        settled.iter_mut().for_each(|(config, _)| config.reference_luminance = Some(reference));
        // As the file has it.
        costs[next] = Some((ms * 10.0).round() / 10.0);
        done += 1;
    }
    let measured: Vec<_> = settled
        .iter()
        .zip(&costs)
        .filter_map(|((config, _), cost)| {
            Some(Measured { what: Settings::of(config).in_words(), ms_per_s: (*cost)? })
        })
        .collect();
    // The cheapest is timed in any case.
    let Some((index, _)) = pick(&costs, budget_ms) else {
        return Err(EngineError::Device("no settings could be timed".into()));
    };
    let (chosen, rate_why) = &settled[index];
    let took = costs[index].unwrap_or_default();
    let why = format!("took {took} ms per simulated second, {} settings timed; {rate_why}", measured.len());
    Ok(Plan {
        evis: env!("CARGO_PKG_VERSION").into(),
        budget_ms: Some(budget_ms),
        target: None,
        why,
        expects: LADDER[index].expects.into(),
        settings: Settings::of(chosen),
        made_for,
        measured,
        looked: None,
    })
}

/// Milliseconds of work per simulated second, as packets report it, and the `Y_ref` in force.
fn time(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    stop: &dyn Fn() -> bool,
) -> Result<(f64, f32), EngineError> {
    let start_s = config.start_us as f64 * 1e-6;
    let length_us = (auto::length_s(scene, start_s) * 1e6) as i64;
    let room_us = (length_us - WARM_UP_US - TIMED_US).max(0);
    let (mut ms, mut reference) = (0.0, config.reference_luminance);
    for place in 0..PLACES {
        let start_us = config.start_us + room_us * place / (PLACES - 1);
        let config = RunConfig { start_us, reference_luminance: reference, ..config.clone() };
        let mut simulator = Simulator::new(gpu, Arc::clone(scene), config)?;
        reference = simulator.config().reference_luminance;
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
    Ok((ms * 1e6 / (PLACES * TIMED_US) as f64, reference.unwrap_or(1.0)))
}

/// What is timed next, of a ladder whose most accurate rung comes first: from the cheap end up, until two in a row do not
/// fit. What is beyond those costs more still, as a rule, and would take the longest to time.
fn next(costs: &[Option<f64>], budget_ms: f64) -> Option<usize> {
    let untimed = costs.iter().rposition(Option::is_none)?;
    let below = &costs[untimed + 1..];
    let misses = below.iter().take(2).filter(|cost| cost.is_some_and(|ms| ms > budget_ms)).count();
    (misses < 2).then_some(untimed)
}

/// The first, hence most accurate, that fits, and true; where none does the cheapest, and false.
fn pick(costs: &[Option<f64>], budget_ms: f64) -> Option<(usize, bool)> {
    let fits = costs.iter().position(|cost| cost.is_some_and(|ms| ms <= budget_ms));
    let timed = costs.iter().enumerate().filter_map(|(k, cost)| Some((k, (*cost)?)));
    let cheapest = timed.min_by(|a, b| a.1.total_cmp(&b.1));
    fits.map(|k| (k, true)).or(cheapest.map(|(k, _)| (k, false)))
}

impl Settings {
    pub(crate) fn of(config: &RunConfig) -> Self {
        Self {
            method: config.method,
            rate_hz: config.rate_hz,
            adaptive_px: config.adaptive_px,
            between: config.between,
            antialias: config.antialias,
            samples: config.samples,
            texture_taps: config.taps(),
            shadows: config.shadows.unwrap_or_default(),
        }
    }

    /// `native, every 0.5 px up to 1000 Hz, 16 samples, 1 in 4 shaded, textures at 4x4 places`.
    pub fn in_words(&self) -> String {
        let Self { method, rate_hz, adaptive_px, between, antialias, samples, texture_taps: taps, shadows } =
            self;
        let step = adaptive_px.map_or_else(|| "all at".into(), |px| format!("every {px} px up to"));
        let curves = if *between == Between::Curve { ", curves between them" } else { "" };
        let plural = if *samples == 1 { "" } else { "s" };
        let shaded = if *antialias == Antialias::Edges { ", 1 in 4 shaded" } else { "" };
        let shadows = if *shadows == Shadows::Rays { ", shadows by rays" } else { "" };
        format!(
            "{}, {step} {rate_hz} Hz{curves}, {samples} sample{plural}{shaded}, textures at {taps}x{taps} places{shadows}",
            method.name()
        )
    }
}

impl MadeFor {
    /// What counts of `config` for a target, or for a budget: sensors say what fires, and hardly change what rendering
    /// takes; labels and frames take time, and fire nothing.
    fn new(scene: &Scene, config: &RunConfig, target: bool) -> Result<Self, EngineError> {
        let (views, cameras) = view::views(scene, config)?;
        let mut content = [Fnv::default()];
        evis_scene::digest(scene, "", &mut content);
        // A camera has its sensor in all environments.
        let first = views.iter().filter(|view| view.environment == 0);
        let sensors = first.map(|view| {
            let (sensor, camera) = (&view.sensor, &cameras[view.camera].name);
            format!(
                "{camera} {} ON, {} OFF, log_eps {}",
                sensor.threshold_on, sensor.threshold_off, sensor.log_eps
            )
        });
        Ok(Self {
            scene: scene.name.clone(),
            content: format!("{:016x}", content[0].finish()),
            start_us: config.start_us,
            shadows: config.shadows,
            shadow_map: config.shadow_map,
            label_rate_hz: (!target && !config.labels.is_empty()).then_some(config.label_rate_hz),
            frame_rate_hz: config.frame_rate_hz.filter(|_| !target),
            reference_luminance: config.reference_luminance.filter(|_| target),
            cameras: cameras.iter().map(|c| format!("{} {}x{}", c.name, c.width, c.height)).collect(),
            sensors: if target { sensors.collect() } else { Vec::new() },
        })
    }
}

impl Plan {
    /// What it was made for; one that was read has one goal.
    pub fn goal(&self) -> Option<Goal> {
        match (self.budget_ms, self.target) {
            (Some(ms), None) => Some(Goal::Budget(ms)),
            (None, Some(target)) => Some(Goal::Target(target)),
            _ => None,
        }
    }

    /// Reads and checks one.
    ///
    /// # Errors
    /// A file that cannot be read, is no plan, or does not follow from its own figures.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let io = |source| SceneError::Io { path: path.into(), source };
        let text = std::fs::read_to_string(path).map_err(io)?;
        let remedy = "remove it and give a budget or a target to make a new one";
        let broken = |what: &str| SceneError::invalid(path, format!("no plan of auto: {what}; {remedy}"));
        let plan: Self = toml::from_str(&text).map_err(|e| broken(e.to_string().trim_end()))?;
        let mut config = RunConfig::default();
        plan.apply(&mut config);
        config.check().map_err(|e| broken(&e.to_string()))?;
        let asked = plan.settings.in_words();
        match plan.asks_for().map_err(|e| broken(&e))? {
            Some((figures, what)) if what != asked => {
                Err(broken(&format!("{figures} ask for '{what}', and its settings are '{asked}'")))
            }
            _ => Ok(plan),
        }
    }

    /// Which settings its own figures ask for, in words, and what figures those are; `None` where nothing was looked at, so
    /// that there is nothing to tell them by. What is wrong, if its figures are no figures of such a plan.
    fn asks_for(&self) -> Result<Option<(String, &str)>, String> {
        match self.goal() {
            None if self.target.is_some() => Err("it is for a budget and for a target".into()),
            None => Err("it is for neither a budget nor a target".into()),
            Some(Goal::Budget(_)) if self.looked.is_some() => Err("it is for a budget, and not timed".into()),
            Some(Goal::Target(_)) if !self.measured.is_empty() => Err("it is for a target, and timed".into()),
            Some(goal @ Goal::Budget(budget_ms)) => {
                let is_time = |m: &&Measured| m.ms_per_s.is_finite() && m.ms_per_s >= 0.0;
                if let Some(bad) = self.measured.iter().find(|m| !is_time(m)) {
                    return Err(format!("'{}' took {} ms", bad.what, bad.ms_per_s));
                }
                let (taken, _) = pick(&self.costs(), budget_ms).ok_or("it has no times")?;
                Ok(Some((format!("for {} its times", goal.in_words()), &self.measured[taken].what)))
            }
            Some(goal @ Goal::Target(target)) => {
                let Some(looked) = &self.looked else { return Ok(None) };
                let what = looked.asks_for(target)?;
                Ok(Some((format!("for {} its figures", goal.in_words()), what)))
            }
        }
    }

    /// What was timed, as [`pick`] takes it.
    fn costs(&self) -> Vec<Option<f64>> {
        self.measured.iter().map(|m| Some(m.ms_per_s)).collect()
    }

    fn write(&self, path: &Path) -> Result<(), EngineError> {
        const HEAD: &str =
            "# What `auto` chose. --plan with this file runs it again, without looking at scene or clock.\n";
        let figures = match self.target {
            Some(_) if self.looked.is_none() => {
                "Nothing was looked at: these settings are the same for every scene."
            }
            None => "Times are milliseconds of work per simulated second on the machine that made it.",
            Some(_) => "Figures are those beside the finest settings, in the tiles that were looked at.",
        };
        let text = toml::to_string(self).map_err(|e| EngineError::Device(format!("no plan: {e}")))?;
        std::fs::write(path, format!("{HEAD}# {figures}\n\n{text}"))
            .map_err(|source| EngineError::Write { path: path.into(), source })
    }

    /// Gives `config` its settings, and says so.
    fn apply(&self, config: &mut RunConfig) {
        let Settings { method, rate_hz, adaptive_px, between, antialias, samples, texture_taps, shadows } =
            &self.settings;
        config.method = *method;
        config.antialias = *antialias;
        (config.rate_hz, config.adaptive_px, config.between) = (*rate_hz, *adaptive_px, *between);
        (config.samples, config.texture_taps) = (*samples, Some(*texture_taps));
        config.shadows = Some(*shadows);
        let words = self.settings.in_words();
        let warning = match self.budget_ms.map(|ms| (ms, pick(&self.costs(), ms))) {
            Some((ms, Some((k, false)))) => Some(format!(
                "nothing fits {ms} ms per simulated second: the cheapest, {words}, took {} ms; allow that much, or render \
                 fewer pixels",
                self.measured[k].ms_per_s
            )),
            _ => None,
        };
        config.chosen = Some(Chosen {
            target: self.target,
            budget_ms: self.budget_ms,
            // What a target takes begins with what it asks for.
            why: if self.target.is_some() { self.why.clone() } else { format!("{words}: {}", self.why) },
            expects: self.expects.clone(),
            warning,
        });
    }

    fn check_made_for(&self, path: &Path, run: &MadeFor) -> Result<(), ConfigError> {
        let own = &self.made_for;
        let rate = |hz: Option<f64>| hz.map_or_else(|| "none".into(), |hz| format!("{hz} Hz"));
        let shadows = |asked| match asked {
            None => "what auto takes",
            Some(Shadows::Maps) => "maps",
            Some(Shadows::Rays) => "rays",
        };
        let texels =
            |edge: Option<u32>| edge.map_or_else(|| "their usual size".into(), |n| format!("{n} texels"));
        let reference =
            |luminance: Option<f32>| luminance.map_or_else(|| "what is measured".into(), |y| y.to_string());
        for (what, own, run) in [
            ("scene", own.scene.clone(), run.scene.clone()),
            ("cameras", own.cameras.join(", "), run.cameras.join(", ")),
            ("a start at (microseconds)", own.start_us.to_string(), run.start_us.to_string()),
            ("shadows by", shadows(own.shadows).into(), shadows(run.shadows).into()),
            ("shadow maps of", texels(own.shadow_map), texels(run.shadow_map)),
            ("labels at", rate(own.label_rate_hz), rate(run.label_rate_hz)),
            ("frames at", rate(own.frame_rate_hz), rate(run.frame_rate_hz)),
            (
                "a reference luminance of",
                reference(own.reference_luminance),
                reference(run.reference_luminance),
            ),
            ("sensors with", own.sensors.join("; "), run.sensors.join("; ")),
            (
                "a scene (of that name, with its --seed and --speed) of content",
                own.content.clone(),
                run.content.clone(),
            ),
        ] {
            if own != run {
                return Err(self.refused(path, &format!("{what} {own}"), &run));
            }
        }
        Ok(())
    }

    fn refused(&self, path: &Path, own: &str, run: &str) -> ConfigError {
        ConfigError::new(
            &format!("plan {}", path.display()),
            format!("for {own}"),
            format!("for {run}, as this run: name a file that does not exist to make a new plan"),
        )
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::auto::{NEAR_NATIVE, Rung};
    use crate::search::{Agreement, Tried};

    /// What would be timed and taken if rungs cost `true_ms`.
    fn search(true_ms: &[f64], budget_ms: f64) -> (Vec<usize>, Option<(usize, bool)>) {
        let mut costs = vec![None; true_ms.len()];
        let mut timed = Vec::new();
        while let Some(k) = next(&costs, budget_ms) {
            costs[k] = Some(true_ms[k]);
            timed.push(k);
        }
        (timed, pick(&costs, budget_ms))
    }

    #[test]
    fn the_most_accurate_that_fits_is_taken_and_the_dear_end_is_not_timed() {
        let ladder = [1000.0, 500.0, 200.0, 90.0, 40.0, 10.0];
        assert_eq!(search(&ladder, 100.0), (vec![5, 4, 3, 2, 1], Some((3, true))));
        assert_eq!(search(&ladder, 90.0).1, Some((3, true)), "a budget may be used up");
        assert_eq!(search(&ladder, 89.0).1, Some((4, true)));
        assert_eq!(search(&ladder, 1e4), (vec![5, 4, 3, 2, 1, 0], Some((0, true))));
        // One rung that is dearer than a more accurate one does not end the search.
        assert_eq!(search(&[1000.0, 500.0, 60.0, 120.0, 40.0, 10.0], 100.0).1, Some((2, true)));
        assert_eq!(search(&[], 100.0), (vec![], None));
    }

    #[test]
    fn where_nothing_fits_the_cheapest_is_taken_and_it_is_told() {
        assert_eq!(search(&[1000.0, 90.0, 40.0, 20.0], 15.0), (vec![3, 2], Some((3, false))));
        assert_eq!(search(&[1000.0, 90.0, 20.0, 40.0], 15.0).1, Some((2, false)));
        let mut plan = made_up();
        plan.budget_ms = Some(100.0);
        plan.settings.samples = 4;
        let mut config = RunConfig::default();
        plan.apply(&mut config);
        let told = config.chosen.take().unwrap().warning.unwrap();
        assert!(told.contains("100 ms") && told.contains("150.5 ms") && told.contains("4 samples"), "{told}");
        made_up().apply(&mut config);
        assert_eq!(config.chosen.unwrap().warning, None);
    }

    fn made_up() -> Plan {
        let cheap = Settings {
            method: Method::Native,
            rate_hz: 1000.0,
            adaptive_px: Some(0.5),
            between: Between::Curve,
            antialias: Antialias::Samples,
            samples: 4,
            texture_taps: 4,
            shadows: Shadows::Maps,
        };
        let settings = Settings { samples: 16, ..cheap.clone() };
        Plan {
            evis: "0".into(),
            budget_ms: Some(500.0),
            target: None,
            why: "took 480 ms".into(),
            expects: "F1".into(),
            measured: vec![
                Measured { what: settings.in_words(), ms_per_s: 480.0 },
                Measured { what: cheap.in_words(), ms_per_s: 150.5 },
            ],
            settings,
            made_for: MadeFor {
                scene: "hall".into(),
                content: "12".into(),
                start_us: 0,
                shadows: None,
                shadow_map: None,
                label_rate_hz: None,
                frame_rate_hz: Some(30.0),
                reference_luminance: None,
                cameras: vec!["front 64x48".into()],
                sensors: Vec::new(),
            },
            looked: None,
        }
    }

    /// The same settings for `exact`, the second that were tried.
    fn made_up_for_a_target() -> Plan {
        let plan = made_up();
        let tried = |m: &Measured, f1_100us: f64, median_us: f64| Tried {
            what: m.what.clone(),
            as_finest: false,
            agreement: Agreement { f1_1ms: 0.98, f1_100us, median_us: Some(median_us) },
        };
        let [dear, cheap] = &plan.measured[..] else { panic!("{:?}", plan.measured) };
        let looked = Looked {
            tiles: 24,
            finest: "the finest".into(),
            tried: vec![tried(cheap, 0.7, 30.0), tried(dear, 0.853, 12.5)],
            native: Some(Agreement { f1_1ms: 0.99, f1_100us: 0.85, median_us: Some(12.0) }),
        };
        let made_for = MadeFor {
            frame_rate_hz: None,
            reference_luminance: Some(0.18),
            sensors: vec!["front 0.2 ON, 0.25 OFF, log_eps 0.001".into()],
            ..plan.made_for
        };
        let (budget_ms, measured) = (None, Vec::new());
        Plan { budget_ms, target: Some(Target::Exact), made_for, measured, looked: Some(looked), ..plan }
    }

    #[test]
    fn a_plan_is_read_as_it_was_written_and_a_broken_one_is_told() {
        let path = std::env::temp_dir().join(format!("evis-plan-{}.toml", std::process::id()));
        let plan = made_up();
        plan.write(&path).unwrap();
        assert_eq!(Plan::read(&path).unwrap(), plan);
        let text = std::fs::read_to_string(&path).unwrap();
        let broken = |text: &str, told: &str| {
            std::fs::write(&path, text).unwrap();
            let error = Plan::read(&path).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains("give a budget or a target"), "{told}: {error}");
        };
        for (from, to, told) in [
            (
                "samples = 16",
                "samples = 4",
                "ask for 'native, every 0.5 px up to 1000 Hz, curves between them, 16 samples",
            ),
            ("samples = 16", "samples = 0", "samples is 0"),
            ("samples = 16", "samples = \"many\"", "samples"),
            (
                "budget_ms = 500.0",
                "budget_ms = 200.0",
                "for a budget of 200 ms per simulated second its times ask",
            ),
            ("budget_ms = 500.0", "", "neither a budget nor a target"),
            ("budget_ms = 500.0", "budget_ms = 500.0\ntarget = \"draft\"", "for a budget and for a target"),
            ("budget_ms = 500.0", "target = \"draft\"", "for a target, and timed"),
            ("budget_ms = 500.0", "target = \"fine\"", "fine"),
            ("ms_per_s = 480.0", "ms_per_s = nan", "NaN ms"),
            ("start_us = 0", "begin_us = 0", "begin_us"),
            ("rate_hz = 1000.0", "rate_hz = -5.0", "-5"),
            ("[settings]", "[settings", "line 9"),
        ] {
            assert!(text.contains(from), "{from}");
            broken(&text.replacen(from, to, 1), told);
        }

        let plan = made_up_for_a_target();
        plan.write(&path).unwrap();
        assert_eq!(Plan::read(&path).unwrap(), plan);
        let text = std::fs::read_to_string(&path).unwrap();
        let other = "ask for 'native, every 0.5 px up to 1000 Hz, curves between them, 4 samples";
        for (from, to, told) in [
            ("samples = 16", "samples = 4", "for the target exact its figures ask for"),
            ("f1_100us = 0.7\nmedian_us = 30.0", "f1_100us = 0.9\nmedian_us = 9.0", other),
            ("f1_100us = 0.853", "f1_100us = 0.8", "ask for 'the finest'"),
            ("median_us = 12.5", "median_us = 14.0", "ask for 'the finest'"),
            ("f1_100us = 0.853", "f1_100us = 1.2", "1.2"),
            ("median_us = 12.5", "median_us = -1.0", "-1"),
            ("f1_1ms = 0.99", "f1_1ms = nan", "NaN"),
            ("f1_1ms = 0.99\n", "", "f1_1ms"),
            ("[looked.native]", "[looked.naive]", "naive"),
            ("target = \"exact\"", "target = \"draft\"", "asks for nothing of native"),
            ("target = \"exact\"", "target = \"finest\"", "finest looks at nothing"),
            ("target = \"exact\"", "budget_ms = 70.0", "not timed"),
        ] {
            assert!(text.contains(from), "{from}: {text}");
            broken(&text.replacen(from, to, 1), told);
        }
        let without_native = text.split("[looked.native]").next().unwrap();
        broken(without_native, "what native has is missing");
        // Where nothing was looked at there is nothing that settings could follow from.
        Plan { looked: None, ..plan.clone() }.write(&path).unwrap();
        assert_eq!(Plan::read(&path).unwrap().settings, plan.settings);
        let Plan { looked: Some(looked), .. } = plan.clone() else { panic!("{plan:?}") };
        let by_f1 = Looked { native: None, ..looked.clone() };
        let of = |target: Target, looked: Looked| {
            Plan { target: Some(target), looked: Some(looked), ..plan.clone() }.write(&path).unwrap();
            Plan::read(&path).map_err(|e| e.to_string())
        };
        // For these the first has what is asked for, which is not what its settings are.
        assert!(
            of(Target::Default, by_f1.clone()).unwrap_err().contains("for the target default its figures")
        );
        assert!(
            of(Target::Exact, Looked { tried: Vec::new(), ..looked }).unwrap_err().contains("nothing was")
        );
        let last = Looked { tried: by_f1.tried[1..].to_vec(), ..by_f1 };
        assert_eq!(of(Target::Default, last).unwrap().goal(), Some(Goal::Target(Target::Default)));
        std::fs::remove_file(&path).unwrap();
        assert!(Plan::read(&path).unwrap_err().to_string().contains("cannot read"));
    }

    #[test]
    fn plans_of_budgets_from_before_targets_had_any_are_read() {
        let path = std::env::temp_dir().join(format!("evis-old-plan-{}.toml", std::process::id()));
        std::fs::write(
            &path,
            r#"evis = "0.1.0"
budget_ms = 500.0
why = "took 480 ms"
expects = "F1"

[settings]
method = "native"
rate_hz = 1000.0
adaptive_px = 0.5
between = "curve"
antialias = "samples"
samples = 16
texture_taps = 4
shadows = "maps"

[made_for]
scene = "hall"
content = "12"
start_us = 0
frame_rate_hz = 30.0
cameras = ["front 64x48"]

[[measured]]
what = "native, every 0.5 px up to 1000 Hz, curves between them, 16 samples, textures at 4x4 places"
ms_per_s = 480.0

[[measured]]
what = "native, every 0.5 px up to 1000 Hz, curves between them, 4 samples, textures at 4x4 places"
ms_per_s = 150.5
"#,
        )
        .unwrap();
        assert_eq!(Plan::read(&path).unwrap(), Plan { evis: "0.1.0".into(), ..made_up() });
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_plan_for_something_else_is_refused_with_both_sides_named() {
        let (plan, path) = (made_up(), Path::new("p.toml"));
        let own = || plan.made_for.clone();
        plan.check_made_for(path, &own()).unwrap();
        for (run, sides) in [
            (MadeFor { scene: "yard".into(), ..own() }, ["scene hall", "yard"]),
            (MadeFor { content: "34".into(), ..own() }, ["content 12", "34"]),
            (MadeFor { cameras: vec!["front 640x480".into()], ..own() }, ["front 64x48", "front 640x480"]),
            (MadeFor { start_us: 7, ..own() }, ["start at (microseconds) 0", "7"]),
            (MadeFor { shadows: Some(Shadows::Rays), ..own() }, ["shadows by what auto takes", "rays"]),
            (MadeFor { shadows: Some(Shadows::Maps), ..own() }, ["shadows by what auto takes", "maps"]),
            (MadeFor { shadow_map: Some(512), ..own() }, ["their usual size", "512 texels"]),
            (MadeFor { label_rate_hz: Some(50.0), ..own() }, ["labels at none", "50 Hz"]),
            (MadeFor { frame_rate_hz: Some(25.0), ..own() }, ["frames at 30 Hz", "25 Hz"]),
        ] {
            let error = plan.check_made_for(path, &run).unwrap_err().to_string();
            assert!(error.contains("p.toml") && sides.iter().all(|side| error.contains(side)), "{error}");
        }
        let plan = made_up_for_a_target();
        let own = || plan.made_for.clone();
        let sensors = vec!["front 0.3 ON, 0.25 OFF, log_eps 0.001".into()];
        plan.check_made_for(path, &own()).unwrap();
        for (run, sides) in [
            (MadeFor { sensors, ..own() }, ["sensors with front 0.2 ON", "for front 0.3 ON"]),
            (MadeFor { reference_luminance: None, ..own() }, ["luminance of 0.18", "what is measured"]),
            (MadeFor { reference_luminance: Some(0.5), ..own() }, ["luminance of 0.18", "for 0.5"]),
        ] {
            let error = plan.check_made_for(path, &run).unwrap_err().to_string();
            assert!(error.contains("p.toml") && sides.iter().all(|side| error.contains(side)), "{error}");
        }
    }

    #[test]
    fn rungs_are_settings_that_can_run_and_each_has_words_of_its_own() {
        for rungs in [LADDER, NEAR_NATIVE] {
            let words = |rung: &Rung| {
                let config = RunConfig {
                    method: rung.method,
                    adaptive_px: Some(rung.step_px),
                    antialias: rung.antialias,
                    samples: rung.samples,
                    texture_taps: Some(rung.texture_taps),
                    shadows: rung.rays.then_some(Shadows::Rays),
                    ..RunConfig::default()
                };
                config.check().unwrap();
                Settings::of(&config).in_words()
            };
            let words: BTreeSet<_> = rungs.iter().map(words).collect();
            assert_eq!(words.len(), rungs.len());
        }
    }
}
