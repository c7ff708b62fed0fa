//! From a scene to its chart: truth once, then every setting of the ladder.

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use evis_core::metric::{self, DEFAULT_TOLERANCES_US, Score, ScoreSettings};
use evis_core::{ConfigError, Event, SensorConfig, Truth};
use evis_render::{Gpu, RunConfig};
use evis_scene::Scene;
use evis_truth::{Lattice, PixelChoice, TruthError, TruthSettings};

use crate::error::ChartError;
use crate::ladder::{Ladder, Setting};
use crate::measure::{Series, measure};
use crate::result::{DeviceNote, NotMeasured, SceneChart, TruthNote};

/// Most repetitions; beyond, only patience is measured.
const MAX_REPETITIONS: usize = 1000;

/// Pixels for truth's own error: at least, and of a whole picture.
const FLOOR_PIXELS: (usize, usize) = (100, 2000);

/// What a chart is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct ChartSettings {
    /// Which settings are measured.
    pub ladder: Ladder,
    /// Runs of each setting, at least 1.
    pub repetitions: usize,
    /// Thresholds and `eps`; the camera's own thresholds come first, the ladder sets the trigger.
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
    /// `Y_ref` in `ln(Y / Y_ref + eps)`; `None` takes the one that truth finds.
    pub reference_luminance: Option<f32>,
    /// Whether truth is made once more for a part of its pixels, with independent samples, to know its own error.
    pub floor: bool,
    /// Folder that keeps truths; `None` keeps none.
    pub cache: Option<PathBuf>,
}

impl Default for ChartSettings {
    fn default() -> Self {
        Self {
            ladder: Ladder::default(),
            repetitions: 3,
            sensor: SensorConfig::default(),
            camera: None,
            size: Some((160, 120)),
            start_us: 0,
            duration_us: 250_000,
            pixels: PixelChoice::Count(1000),
            reference_luminance: None,
            floor: true,
            cache: None,
        }
    }
}

/// What a chart is busy with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Truth.
    Truth,
    /// Truth once more, for its own error.
    Floor,
    /// The engine.
    Runs,
}

impl Stage {
    /// What it does, for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Truth => "truth",
            Self::Floor => "truth once more, for its own error",
            Self::Runs => "settings",
        }
    }
}

/// Told what it is busy with and the part of that which is done, from several threads; returns false to stop.
pub type Progress<'a> = dyn Fn(Stage, f64) -> bool + Sync + 'a;

/// Measures `scene`, which its user calls `name`.
///
/// # Errors
/// A setting that cannot be used, a scene without truth or events, a device that fails or does not repeat itself, or a
/// stop.
pub fn chart(
    gpu: &Gpu,
    name: &str,
    scene: &Scene,
    settings: &ChartSettings,
    progress: &Progress<'_>,
) -> Result<SceneChart, ChartError> {
    let (runs, not_measured) = runs(settings)?;
    let floor = settings.floor.then(|| floor_pixels(settings.pixels));
    let work = Work { runs, floor, tolerances_us: &DEFAULT_TOLERANCES_US, seen: &|_, _| () };
    Ok(SceneChart { not_measured, ..measured(gpu, name, scene, settings, work, progress)? })
}

/// What is run and scored.
pub(crate) struct Work<'a> {
    /// Settings, each with its run.
    pub(crate) runs: Vec<(Setting, RunConfig)>,
    /// Pixels on which truth is made once more, for its own error.
    pub(crate) floor: Option<PixelChoice>,
    /// Tolerances to score with.
    pub(crate) tolerances_us: &'a [i64],
    /// Is shown truth and each setting's events, in their order.
    pub(crate) seen: &'a dyn Fn(&Truth, &[evis_core::Event]),
}

/// Truth once, then every setting.
pub(crate) fn measured(
    gpu: &Gpu,
    name: &str,
    scene: &Scene,
    settings: &ChartSettings,
    work: Work<'_>,
    progress: &Progress<'_>,
) -> Result<SceneChart, ChartError> {
    let Work { runs, floor, tolerances_us, seen } = work;
    let truth =
        make_truth(scene, settings, settings.pixels, Lattice::First, &|part| progress(Stage::Truth, part))?;
    if truth.events.is_empty() {
        return Err(ChartError::Silent { pixels: truth.pixels.len(), duration_us: settings.duration_us });
    }
    let floor = floor.map(|pixels| {
        let told = |part| progress(Stage::Floor, part);
        let other = make_truth(scene, settings, pixels, Lattice::Second, &told)?;
        // Where little fires, a quarter of the pixels may have none: the error is not known then.
        if other.events.is_empty() {
            return Ok(None);
        }
        score(&truth.events, &other, truth.sensor.clone(), tolerances_us).map(Some)
    });
    let floor = floor.transpose()?.flatten();

    // Truth and engine see the same light, from the same camera.
    let mut runs = runs;
    for (_, config) in &mut runs {
        config.cameras = vec![truth.camera.name.clone()];
        config.size = Some((truth.camera.width, truth.camera.height));
        config.reference_luminance = Some(truth.reference_luminance as f32);
    }
    let series = Series {
        gpu,
        scene: first_environment(scene),
        runs: &runs,
        duration_us: settings.duration_us,
        repetitions: settings.repetitions,
    };
    let judge = |events: &[Event], config: &RunConfig| {
        seen(&truth, events);
        // A camera's own thresholds come before those of the run, in engine and truth alike.
        let (threshold_on, threshold_off) = (truth.sensor.threshold_on, truth.sensor.threshold_off);
        let sensor = SensorConfig { threshold_on, threshold_off, ..config.sensor.clone() };
        score(events, &truth, sensor, tolerances_us)
    };
    let points = measure(&series, &judge, &|part| progress(Stage::Runs, part))?;
    Ok(SceneChart {
        scene: name.to_owned(),
        run_as: None,
        camera: truth.camera.name.clone(),
        of_cameras: scene.cameras.len(),
        width: truth.camera.width,
        height: truth.camera.height,
        start_us: settings.start_us,
        duration_us: settings.duration_us,
        sensor: truth.sensor.clone(),
        reference_luminance: truth.reference_luminance,
        evis: env!("CARGO_PKG_VERSION").into(),
        measured: today(),
        device: DeviceNote::of(gpu),
        repetitions: settings.repetitions,
        truth: TruthNote {
            pixels: truth.pixels.len(),
            events: truth.events.len(),
            firing: truth.events.iter().map(|e| (e.x, e.y)).collect::<HashSet<_>>().len(),
            floor,
            provenance: serde_json::from_str(&truth.provenance)
                .unwrap_or_else(|_| serde_json::Value::String(truth.provenance.clone())),
        },
        points,
        not_measured: Vec::new(),
    })
}

/// Checked runs of the ladder, and what the engine cannot run.
#[expect(clippy::type_complexity, reason = "two lists, taken apart at once")]
fn runs(settings: &ChartSettings) -> Result<(Vec<(Setting, RunConfig)>, Vec<NotMeasured>), ChartError> {
    if !(1..=MAX_REPETITIONS).contains(&settings.repetitions) {
        let remedy = format!("between 1 and {MAX_REPETITIONS}");
        return Err(ConfigError::new("repetitions", settings.repetitions, remedy).into());
    }
    if settings.duration_us <= 0 {
        return Err(ConfigError::new("duration", settings.duration_us, "above 0 microseconds").into());
    }
    let base = base(settings);
    base.check()?;
    let (mut runs, mut not_measured) = (Vec::new(), Vec::new());
    for setting in settings.ladder.settings()? {
        match setting.run_config(&base) {
            Some(config) => {
                config.check()?;
                runs.push((setting, config));
            }
            None => {
                let reason = format!("method {} does not exist in this version", setting.method);
                not_measured.push(NotMeasured { setting, reason });
            }
        }
    }
    if runs.is_empty() {
        return Err(ConfigError::new("ladder", "without a setting that can run", "at least one rate").into());
    }
    Ok((runs, not_measured))
}

/// What all runs share.
pub(crate) fn base(settings: &ChartSettings) -> RunConfig {
    RunConfig {
        sensor: settings.sensor.clone(),
        cameras: settings.camera.iter().cloned().collect(),
        size: settings.size,
        start_us: settings.start_us,
        reference_luminance: settings.reference_luminance,
        ..RunConfig::default()
    }
}

fn score(
    events: &[Event],
    truth: &Truth,
    sensor: SensorConfig,
    tolerances_us: &[i64],
) -> Result<Score, ChartError> {
    let ask = ScoreSettings {
        tolerances_us: tolerances_us.to_vec(),
        sensor: Some(sensor),
        size: Some([truth.camera.width, truth.camera.height]),
    };
    metric::score(events, truth, &ask).map_err(|e| ChartError::Score(e.to_string()))
}

/// A quarter of the pixels tells the error well enough. Spread pixels are the first of one sequence, so that fewer of
/// them are among more of them.
fn floor_pixels(pixels: PixelChoice) -> PixelChoice {
    match pixels {
        PixelChoice::Count(count) => PixelChoice::Count(count.div_ceil(4).max(FLOOR_PIXELS.0).min(count)),
        PixelChoice::All => PixelChoice::Count(FLOOR_PIXELS.1),
        crop @ PixelChoice::Crop { .. } => crop,
    }
}

fn make_truth(
    scene: &Scene,
    settings: &ChartSettings,
    pixels: PixelChoice,
    lattice: Lattice,
    progress: &(dyn Fn(f64) -> bool + Sync),
) -> Result<Truth, ChartError> {
    let ask = TruthSettings {
        sensor: settings.sensor.clone(),
        camera: settings.camera.clone(),
        size: settings.size,
        start_us: settings.start_us,
        duration_us: settings.duration_us,
        pixels,
        reference_luminance: settings.reference_luminance,
        lattice,
        ..TruthSettings::default()
    };
    let made = match &settings.cache {
        Some(folder) => evis_truth::cached(folder, scene, &ask, progress),
        None => evis_truth::truth(scene, &ask, progress),
    };
    made.map_err(|error| match error {
        TruthError::Config(error) => error.into(),
        TruthError::Scene(error) => error.into(),
        TruthError::Stopped => ChartError::Stopped,
        other => ChartError::Truth(other.to_string()),
    })
}

/// Truth knows one environment, so the others are neither rendered nor timed.
pub(crate) fn first_environment(scene: &Scene) -> Arc<Scene> {
    let mut scene = scene.clone();
    scene.variants.truncate(1);
    Arc::new(scene)
}

/// YYYY-MM-DD of now, in UTC.
pub(crate) fn today() -> String {
    date(SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()))
}

/// YYYY-MM-DD of a time since 1970 (H. Hinnant, "chrono-compatible low-level date algorithms", civil_from_days).
fn date(seconds: u64) -> String {
    let days = (seconds / 86_400) as i64 + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, day) in [
            (0, "1970-01-01"),
            (951_782_399, "2000-02-28"),
            (951_782_400, "2000-02-29"),
            (1_735_689_599, "2024-12-31"),
            (1_735_689_600, "2025-01-01"),
        ] {
            assert_eq!(date(seconds), day);
        }
    }

    #[test]
    fn the_floors_pixels_are_among_the_truths() {
        let chosen = |pixels| TruthSettings { pixels, ..TruthSettings::default() }.pixels(160, 120).unwrap();
        for pixels in [PixelChoice::Count(40), PixelChoice::Count(1000), PixelChoice::All] {
            let (all, part) = (chosen(pixels), chosen(floor_pixels(pixels)));
            assert!(part.iter().all(|p| all.contains(p)), "{pixels:?}");
            assert!(all.len() <= 100 || part.len() * 3 < all.len(), "{pixels:?}: {}", part.len());
        }
        let sparse = chosen(PixelChoice::Count(250));
        assert!(!chosen(PixelChoice::Count(1000)).iter().all(|p| sparse.contains(p)), "canary");
    }

    #[test]
    fn what_cannot_be_measured_is_told_before_any_work() {
        let told = |settings: ChartSettings| runs(&settings).unwrap_err().to_string();
        let good = ChartSettings::default();
        assert!(told(ChartSettings { repetitions: 0, ..good.clone() }).contains("repetitions is 0"));
        assert!(told(ChartSettings { duration_us: 0, ..good.clone() }).contains("duration is 0"));
        assert!(told(ChartSettings { size: Some((0, 9)), ..good.clone() }).contains("width is 0"));
        let (runs, lacking) = runs(&good).unwrap();
        assert_eq!((runs.len(), lacking.len()), (42, 0));
        assert!(runs.iter().all(|(_, config)| config.size == Some((160, 120))));
    }
}
