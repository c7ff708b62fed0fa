//! Charts: measured, drawn, recommended from. They cross as JSON, the same as `evis chart --report` writes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use evis_chart::{ChartError, ChartResult, ChartSettings, Goal, Ladder, Lens, Look, draw};
use evis_core::{ConfigError, SensorConfig};
use evis_render::Gpu;
use evis_truth::PixelChoice;
use pyo3::prelude::*;

use crate::errors::Failure;
use crate::gil::Detach;
use crate::scene::Scene;

impl From<ChartError> for Failure {
    fn from(error: ChartError) -> Self {
        match error {
            ChartError::Config(error) => error.into(),
            ChartError::Scene(error) => error.into(),
            ChartError::Engine(error) => error.into(),
            ChartError::Silent { .. } | ChartError::Score(_) | ChartError::Unreachable(_) => {
                Self::Config(error.to_string())
            }
            ChartError::Invalid { .. } => Self::Format(error.to_string()),
            ChartError::Io { path, source } => Self::Io { path: Some(path.display().to_string()), source },
            other => Self::Engine(other.to_string()),
        }
    }
}

/// What a text of JSON is called in errors.
const TEXT: &str = "chart";

/// Measures a scene; returns the chart as JSON.
#[pyfunction]
#[pyo3(signature = (
    scene, *, rates_hz, samples, edges, latch_rates_hz, most_samples_hz, published, splat, adaptive, quick,
    repetitions, threshold_on, threshold_off, log_eps, camera, size, start_us, duration_us, truth_pixels, reference_luminance, floor, cache,
    device
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python, one per setting")]
pub(crate) fn chart(
    py: Python<'_>,
    scene: &Scene,
    rates_hz: Vec<f64>,
    samples: Vec<u32>,
    edges: bool,
    latch_rates_hz: Vec<f64>,
    most_samples_hz: Option<f64>,
    published: bool,
    splat: bool,
    adaptive: bool,
    quick: bool,
    repetitions: usize,
    threshold_on: f32,
    threshold_off: f32,
    log_eps: f32,
    camera: Option<String>,
    size: Option<(u32, u32)>,
    start_us: i64,
    duration_us: i64,
    truth_pixels: Option<usize>,
    reference_luminance: Option<f32>,
    floor: bool,
    cache: Option<PathBuf>,
    device: Option<String>,
) -> PyResult<String> {
    let usual = if quick { Ladder::quick() } else { Ladder::default() };
    let settings = ChartSettings {
        ladder: Ladder {
            rates_hz,
            samples,
            edges,
            latch_hz: latch_rates_hz,
            most_samples_hz,
            published,
            adaptive_px: if adaptive { usual.adaptive_px } else { Vec::new() },
            presets: if adaptive { usual.presets } else { Vec::new() },
            decoupled: adaptive && usual.decoupled,
            splat: if splat { usual.splat } else { Vec::new() },
            splat_triggers: splat && usual.splat_triggers,
        },
        repetitions,
        sensor: SensorConfig { threshold_on, threshold_off, log_eps, ..SensorConfig::default() },
        camera,
        size,
        start_us,
        duration_us,
        pixels: truth_pixels.map_or(PixelChoice::All, PixelChoice::Count),
        reference_luminance,
        floor,
        cache,
    };
    let scene = scene.moved_by_default(py, settings.camera.as_ref(), settings.size)?;
    let stop = AtomicBool::new(false);
    py.detach_interruptible(&stop, || {
        let gpu = Gpu::open(device.as_deref())?;
        let going = |_, _| !stop.load(Ordering::Relaxed);
        let made = evis_chart::chart(&gpu, &scene.name, &scene, &settings, &going)?;
        Ok::<_, Failure>(ChartResult::new(vec![made]).to_json()?)
    })
}

/// The user's folder for truths, where the system names one.
#[pyfunction]
pub(crate) fn chart_cache() -> Option<PathBuf> {
    evis_chart::user_cache()
}

/// Rates, samples, edges, latch rates, most samples per second.
type LadderShape = (Vec<f64>, Vec<u32>, bool, Vec<f64>, Option<f64>);

/// Default shape of the ladder.
#[pyfunction]
pub(crate) fn chart_ladder(quick: bool) -> LadderShape {
    let ladder = if quick { Ladder::quick() } else { Ladder::default() };
    let Ladder { rates_hz, samples, edges, latch_hz, most_samples_hz, .. } = ladder;
    (rates_hz, samples, edges, latch_hz, most_samples_hz)
}

/// Checks that `json` is a chart that this version reads.
#[pyfunction]
pub(crate) fn check_chart(py: Python<'_>, json: &str) -> PyResult<()> {
    py.detach_engine(|| ChartResult::from_json(json, Path::new(TEXT)).map(|_| ()))
}

/// Draws a chart's JSON to `path`.
#[pyfunction]
pub(crate) fn draw_chart(
    py: Python<'_>,
    json: &str,
    path: PathBuf,
    tolerance_us: i64,
    render_ms: f64,
) -> PyResult<()> {
    py.detach_engine(|| {
        let chart = ChartResult::from_json(json, Path::new(TEXT))?;
        draw::save(&chart, &Look { lens: Lens { tolerance_us, render_ms } }, &path)
    })
}

/// Recommends a setting of the chart's scene `index`; returns it as JSON.
#[pyfunction]
pub(crate) fn recommend_chart(
    py: Python<'_>,
    json: &str,
    index: usize,
    budget_ms: Option<f64>,
    target_f1: Option<f64>,
    tolerance_us: i64,
    render_ms: f64,
) -> PyResult<String> {
    py.detach_engine(|| {
        let goal = match (budget_ms, target_f1) {
            (Some(ms), None) => Goal::Budget(ms),
            (None, Some(f1)) => Goal::TargetF1(f1),
            _ => {
                return Err(Failure::Config(
                    "a recommendation takes one goal: budget_ms or target_f1, not both".into(),
                ));
            }
        };
        let chart = ChartResult::from_json(json, Path::new(TEXT))?;
        let scene = chart.scenes.get(index).ok_or_else(|| {
            ConfigError::new("scene", index, format!("below {}, the chart's scenes", chart.scenes.len()))
        })?;
        Ok(scene.recommend(goal, Lens { tolerance_us, render_ms })?.to_json()?)
    })
}
