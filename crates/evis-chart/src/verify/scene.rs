//! The engine on a scene: events against the converged oracle, over rates, samples and triggers.

use std::cell::RefCell;
use std::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};

use evis_core::closed_form::convergence::{FLOOR_US, Variant, power};
use evis_core::metric::{self, MatchScore, Score, ScoreSettings};
use evis_core::{ConfigError, Event, Region, SensorConfig, TimeGrid, TriggerRule, Truth};
use evis_render::{Antialias, Gpu};
use evis_scene::Scene;
use evis_truth::PixelChoice;
use serde::{Deserialize, Serialize};

use super::file::{self, VERSION};
use crate::chart::{ChartSettings, Progress, Work, base, measured};
use crate::error::ChartError;
use crate::ladder::{Ladder, Setting, number};
use crate::result::{Point, SceneChart, tolerance};

/// This report's kind in JSON.
pub(super) const REPORT: &str = "scene";

/// Tolerances that are scored, in microseconds.
pub const TOLERANCES_US: [i64; 4] = [2000, 1000, 300, 100];

/// Time errors are those of pairs within this tolerance, scaled by image speed.
pub(super) const TIMES_US: i64 = 1000;

/// Time errors against an engine's own finest run are those of pairs this close.
const OWN_US: i64 = 10_000;

/// Below this F1, pairs are found by chance, and the tolerance alone says how far they are apart.
const PAIRED_F1: f64 = 0.5;

/// What a scene is verified with.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSettings {
    /// Sampled instants per second.
    pub rates_hz: Vec<f64>,
    /// Samples per pixel.
    pub samples: Vec<u32>,
    /// Triggers: the first with every number of samples, the others with the largest.
    pub triggers: Vec<Variant>,
    /// Thresholds and `eps`; the camera's own thresholds come first.
    pub sensor: SensorConfig,
    /// Name of the camera; `None` takes the first.
    pub camera: Option<String>,
    /// Width and height in pixels; `None` takes the camera's own.
    pub size: Option<(u32, u32)>,
    /// Scene time at which the stream starts, in microseconds.
    pub start_us: i64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// Pixels that truth is made for; the engine renders all.
    pub pixels: PixelChoice,
    /// Folder that keeps truths; `None` keeps none.
    pub cache: Option<PathBuf>,
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self {
            rates_hz: vec![250.0, 500.0, 1000.0, 2000.0, 4000.0],
            samples: vec![1, 4, 16, 64],
            triggers: vec![Variant::Crossing, Variant::Latch],
            sensor: SensorConfig::default(),
            camera: None,
            size: Some((160, 120)),
            start_us: 0,
            duration_us: 100_000,
            pixels: PixelChoice::Count(400),
            cache: None,
        }
    }
}

impl SceneSettings {
    /// What is run, by trigger, samples and rate.
    ///
    /// # Errors
    /// A value that no run can use, or nothing to run.
    pub fn settings(&self) -> Result<Vec<Setting>, ConfigError> {
        for (what, empty) in [
            ("rates", self.rates_hz.is_empty()),
            ("samples", self.samples.is_empty()),
            ("triggers", self.triggers.is_empty()),
        ] {
            if empty {
                return Err(ConfigError::new(what, "empty", "at least one"));
            }
        }
        let mut rates = self.rates_hz.clone();
        for &rate in &rates {
            TimeGrid::new(rate).map_err(|e| ConfigError { what: "rates".into(), ..e })?;
        }
        rates.sort_by(f64::total_cmp);
        rates.dedup();
        let mut samples = self.samples.clone();
        samples.sort_unstable();
        samples.dedup();
        let mut all: Vec<Setting> = Vec::new();
        for (k, &variant) in self.triggers.iter().enumerate() {
            // Only the most samples show what the trigger does.
            let skip = if k == 0 { 0 } else { samples.len().saturating_sub(1) };
            for &count in samples.iter().skip(skip) {
                let more = rates.iter().map(|&rate_hz| setting(variant, rate_hz, count));
                all.extend(more.filter(|s| !all.contains(s)).collect::<Vec<_>>());
            }
        }
        Ok(all)
    }

    fn chart(&self) -> ChartSettings {
        ChartSettings {
            ladder: Ladder::default(),
            repetitions: 1,
            sensor: self.sensor.clone(),
            camera: self.camera.clone(),
            size: self.size,
            start_us: self.start_us,
            duration_us: self.duration_us,
            pixels: self.pixels,
            reference_luminance: None,
            floor: true,
            cache: self.cache.clone(),
        }
    }
}

fn setting(variant: Variant, rate_hz: f64, samples: u32) -> Setting {
    let trigger = match variant {
        Variant::Latch => TriggerRule::Latch,
        Variant::Crossing => TriggerRule::Crossing,
    };
    Setting::native(rate_hz, samples, Antialias::Samples, trigger)
}

/// The trigger of a setting.
pub(super) fn variant(setting: &Setting) -> Variant {
    match setting.trigger {
        TriggerRule::Latch => Variant::Latch,
        TriggerRule::Crossing | TriggerRule::Difference => Variant::Crossing,
    }
}

/// What an order is fitted over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Swept {
    /// The sampling interval, with this many samples.
    Rate {
        /// Samples per pixel.
        samples: u32,
    },
    /// The number of samples, at this rate.
    Samples {
        /// Instants per second.
        rate_hz: f64,
    },
}

/// What errors are taken against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// The oracle.
    Truth,
    /// The same run at the highest rate: only the rate's own error is seen, not that of samples.
    Finest,
}

/// How the median time error falls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// The trigger.
    pub trigger: Variant,
    /// Over what.
    pub over: Swept,
    /// Against what.
    pub against: Reference,
    /// Median time errors in microseconds, by rate or by number of samples; `None` where too few events are paired.
    pub median_us: Vec<(f64, Option<f64>)>,
    /// The power of the interval, or of one over the number of samples; `None` for fewer than three errors
    /// above the rounding.
    pub order: Option<f64>,
}

/// The engine against truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneReport {
    /// [`VERSION`].
    pub evis_verify: u32,
    /// What it is a report of: `scene`.
    pub report: String,
    /// What was measured; its truth has a floor, its scores have [`TOLERANCES_US`].
    pub chart: SceneChart,
    /// How errors fall.
    pub fits: Vec<Fit>,
}

/// Runs the engine on `scene`, which its user calls `name`, and scores it against the converged oracle. `progress` is
/// told what it is busy with and the part of that which is done, from several threads, and stops the work by returning
/// false.
///
/// # Errors
/// A setting that cannot be used, a scene without truth or events, a device that fails, or a stop.
pub fn verify_scene(
    gpu: &Gpu,
    name: &str,
    scene: &Scene,
    settings: &SceneSettings,
    progress: &Progress<'_>,
) -> Result<SceneReport, ChartError> {
    let chart_settings = settings.chart();
    if settings.duration_us <= 0 {
        return Err(ConfigError::new("duration", settings.duration_us, "above 0 microseconds").into());
    }
    let base = base(&chart_settings);
    let mut runs = Vec::new();
    for setting in settings.settings()? {
        if let Some(config) = setting.run_config(&base) {
            config.check()?;
            runs.push((setting, config));
        }
    }
    // What each run fired at the pixels of truth: little beside all that it fired.
    let kept: RefCell<(Option<Truth>, Vec<Vec<Event>>)> = RefCell::default();
    let seen = |truth: &Truth, events: &[Event]| {
        let known = |e: &&Event| truth.pixel_index(e.x, e.y).is_some();
        let mut kept = kept.borrow_mut();
        kept.0.get_or_insert_with(|| truth.clone());
        kept.1.push(events.iter().filter(known).copied().collect());
    };
    let work = Work { runs, floor: Some(settings.pixels), tolerances_us: &TOLERANCES_US, seen: &seen };
    let chart = measured(gpu, name, scene, &chart_settings, work, progress)?;
    let (truth, events) = kept.into_inner();
    let fits = fits(&chart.points, truth.as_ref(), &events)?;
    Ok(SceneReport { evis_verify: VERSION, report: REPORT.into(), chart, fits })
}

/// Every order that these points tell. `events` are theirs, one by one.
fn fits(points: &[Point], truth: Option<&Truth>, events: &[Vec<Event>]) -> Result<Vec<Fit>, ChartError> {
    let most = points.iter().map(|p| p.setting.samples).max().unwrap_or(0);
    let highest = points.iter().map(|p| p.setting.rate_hz).fold(0.0, f64::max);
    let mut out: Vec<Fit> = Vec::new();
    let mut triggers: Vec<Variant> = Vec::new();
    for point in points {
        let trigger = variant(&point.setting);
        if triggers.contains(&trigger) {
            continue;
        }
        triggers.push(trigger);
        let all = || points.iter().zip(events).filter(|(p, _)| variant(&p.setting) == trigger);
        let by_rate: Vec<_> = all().filter(|(p, _)| p.setting.samples == most).collect();
        let median = |p: &Point| (p.setting.rate_hz, time_error(&p.score));
        let over = Swept::Rate { samples: most };
        out.push(fit(trigger, over, Reference::Truth, by_rate.iter().map(|(p, _)| median(p)).collect()));
        let finest = by_rate.iter().find(|(p, _)| p.setting.rate_hz == highest).map(|(_, events)| *events);
        if let (Some(truth), Some(finest)) = (truth, finest) {
            let finest = Truth {
                events: finest.clone(),
                speed: Vec::new(),
                event_region: Vec::new(),
                span_start: Vec::new(),
                spans: Vec::new(),
                ..truth.clone()
            };
            let coarser = by_rate.iter().filter(|(p, _)| p.setting.rate_hz < highest);
            let own = coarser.map(|(p, events)| Ok((p.setting.rate_hz, own_error(events, &finest)?)));
            let own = own.collect::<Result<Vec<_>, ChartError>>()?;
            out.push(fit(trigger, over, Reference::Finest, own));
        }
        let by_samples: Vec<_> = all()
            .filter(|(p, _)| p.setting.rate_hz == highest)
            .map(|(p, _)| (f64::from(p.setting.samples), time_error(&p.score)))
            .collect();
        let over = Swept::Samples { rate_hz: highest };
        out.push(fit(trigger, over, Reference::Truth, by_samples));
    }
    // One error falls nowhere.
    out.retain(|fit| fit.median_us.len() > 1);
    Ok(out)
}

fn fit(trigger: Variant, over: Swept, against: Reference, median_us: Vec<(f64, Option<f64>)>) -> Fit {
    let above = |error: &f64| *error > FLOOR_US;
    let order = power(median_us.iter().filter_map(|&(x, error)| Some((1.0 / x, error.filter(above)?))));
    Fit { trigger, over, against, median_us, order }
}

/// Scaled score within [`TIMES_US`].
pub(super) fn at(score: &Score, tolerance_us: i64) -> Option<&MatchScore> {
    score.at(tolerance_us).map(|t| &t.scaled)
}

/// Median time error where enough events are paired to speak of it.
pub(super) fn time_error(score: &Score) -> Option<f64> {
    let at = at(score, TIMES_US).filter(|s| s.f1 >= PAIRED_F1)?;
    at.time_error.as_ref().map(|e| e.median_us)
}

/// Median time error against a run of the engine's own.
fn own_error(events: &[Event], finest: &Truth) -> Result<Option<f64>, ChartError> {
    if finest.events.is_empty() || events.is_empty() {
        return Ok(None);
    }
    let ask = ScoreSettings { tolerances_us: vec![OWN_US], ..ScoreSettings::default() };
    let score = metric::score(events, finest, &ask).map_err(|e| ChartError::Score(e.to_string()))?;
    let at = score.at(OWN_US).map(|t| &t.plain).filter(|s| s.f1 >= PAIRED_F1);
    Ok(at.and_then(|s| s.time_error.as_ref()).map(|e| e.median_us))
}

impl SceneReport {
    /// JSON in one line.
    ///
    /// # Errors
    /// None that could be put right.
    pub fn to_json(&self) -> Result<String, ChartError> {
        file::to_json(self)
    }

    /// Reads what [`SceneReport::to_json`] wrote; `path` names it in errors.
    ///
    /// # Errors
    /// No JSON, another report, or one of another version.
    pub fn from_json(text: &str, path: &Path) -> Result<Self, ChartError> {
        file::from_json(text, REPORT, path)
    }

    /// Name and score of every row: truth's own error first.
    fn rows(&self) -> impl Iterator<Item = (String, &Score)> {
        let floor = self.chart.truth.floor.iter().map(|s| ("oracle's own error".to_owned(), s));
        let name = |p: &Point| {
            let Setting { rate_hz, samples, .. } = &p.setting;
            format!("{:<15} {:>5} Hz {samples:>5}", variant(&p.setting).name(), number(*rate_hz))
        };
        floor.chain(self.chart.points.iter().map(move |p| (name(p), &p.score)))
    }
}

impl Display for SceneReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let SceneChart { scene, width, height, duration_us, truth, device, .. } = &self.chart;
        writeln!(
            f,
            "{scene}: {width}x{height} pixels, {} s; truth: {} events in {} pixels; {}",
            number(*duration_us as f64 * 1e-6),
            truth.events,
            truth.pixels,
            device.name
        )?;
        writeln!(
            f,
            "\nF1 within each tolerance: plain, and scaled by image speed. The oracle's own error: two truths"
        )?;
        writeln!(f, "with independent samples, scored against each other.\n")?;
        const ROW: usize = 30;
        write!(f, "{:<ROW$}", "trigger             rate  samples")?;
        for us in TOLERANCES_US {
            write!(f, " {:>15}", tolerance(us))?;
        }
        writeln!(f, "   events    voxel")?;
        for (name, score) in self.rows() {
            write!(f, "{name:<ROW$}")?;
            for us in TOLERANCES_US {
                match score.at(us) {
                    Some(t) => write!(f, "   {:.4} {:.4}", t.plain.f1, t.scaled.f1)?,
                    None => write!(f, " {:>15}", "-")?,
                }
            }
            let voxel = score.voxel_l1.map_or_else(|| "-".into(), |v| format!("{v:.4}"));
            writeln!(f, "   {:.4}   {voxel:>6}", score.count_ratio)?;
        }
        writeln!(f, "events: as many times as truth; voxel: relative L1 of voxel grids.")?;

        writeln!(f, "\nTime errors in microseconds and F1 by region, within 1 ms scaled by image speed:\n")?;
        let regions: Vec<Region> = Region::ALL
            .into_iter()
            .filter(|r| self.rows().any(|(_, s)| at(s, TIMES_US).is_some_and(|s| s.region(*r).is_some())))
            .collect();
        write!(f, "{:<ROW$} {:>8} {:>8} {:>8} {:>8}", "", "median", "p95", "rms", "bias")?;
        for region in &regions {
            write!(f, " {:>12}", region.name())?;
        }
        writeln!(f)?;
        for (name, score) in self.rows() {
            let Some(score) = at(score, TIMES_US) else { continue };
            write!(f, "{name:<ROW$}")?;
            match &score.time_error {
                Some(e) => {
                    write!(f, " {:>8.1} {:>8.1} {:>8.1} {:>8.1}", e.median_us, e.p95_us, e.rms_us, e.bias_us)?
                }
                None => write!(f, " {:>8} {:>8} {:>8} {:>8}", "-", "-", "-", "-")?,
            }
            for region in &regions {
                match score.region(*region) {
                    Some(r) => write!(f, " {:>12.4}", r.f1)?,
                    None => write!(f, " {:>12}", "-")?,
                }
            }
            writeln!(f)?;
        }
        if let Some(floor) = self.chart.truth.floor.as_ref().and_then(|s| at(s, TIMES_US)) {
            write!(f, "{:<ROW$} {:>35}", "events of truth", "")?;
            for region in &regions {
                write!(f, " {:>12}", floor.region(*region).map_or(0, |r| r.truth_events))?;
            }
            writeln!(f)?;
        }

        if self.fits.is_empty() {
            return write!(f, "\nNo orders: they take several rates or numbers of samples.");
        }
        writeln!(
            f,
            "\nOrders: the power of the sampling interval, or of 1/samples, with which the median time error falls."
        )?;
        for fit in &self.fits {
            let order = fit.order.map_or_else(|| "-".into(), |o| format!("{o:.2}"));
            let over = match fit.over {
                Swept::Rate { samples } => format!("over the rate, {samples} samples"),
                Swept::Samples { rate_hz } => format!("over the samples, {} Hz", number(rate_hz)),
            };
            let against = match fit.against {
                Reference::Truth => "truth",
                Reference::Finest => "the same at the highest rate",
            };
            let errors: Vec<String> = fit
                .median_us
                .iter()
                .map(|(_, us)| us.map_or_else(|| "-".into(), |us| format!("{us:.1}")))
                .collect();
            writeln!(
                f,
                "{:<15} {over:<29} {order:>5}  ({} us against {against})",
                fit.trigger.name(),
                errors.join(", ")
            )?;
        }
        write!(f, "Theory, over the rate: crossing 2, latch 1, until the samples' own error is reached.")
    }
}
