//! Charts: measured, drawn, recommended from. They cross as JSON, the same as `evis chart --report` writes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use evis_chart::{
    ChartError, ChartResult, ChartSettings, Criteria, Goal, Ladder, LadderRequest, Progress, draw,
};
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

/// What settings are measured on beside truth, as Python gives it: a dictionary with these keys.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct TruthRequest {
    /// ON and OFF threshold, and eps.
    pub sensor: (f32, f32, f32),
    pub camera: Option<String>,
    pub size: Option<(u32, u32)>,
    pub start_us: i64,
    pub duration_us: i64,
    pub truth_pixels: Option<usize>,
    pub cache: Option<PathBuf>,
    pub device: Option<String>,
}

impl TruthRequest {
    pub fn sensor(&self) -> SensorConfig {
        let (threshold_on, threshold_off, log_eps) = self.sensor;
        SensorConfig { threshold_on, threshold_off, log_eps, ..SensorConfig::default() }
    }

    pub fn pixels(&self) -> PixelChoice {
        self.truth_pixels.map_or(PixelChoice::All, PixelChoice::Count)
    }
}

/// What a chart measures, as Python gives it: a dictionary with these keys.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ChartRequest {
    quick: bool,
    rates_hz: Option<Vec<f64>>,
    samples: Option<Vec<u32>>,
    edges: Option<bool>,
    latch_rates_hz: Option<Vec<f64>>,
    published: bool,
    splat: bool,
    adaptive: bool,
    repetitions: usize,
    reference_luminance: Option<f32>,
    floor: bool,
}

/// Measures a scene; returns the chart as JSON.
#[pyfunction]
pub(crate) fn chart(
    py: Python<'_>,
    scene: &Scene,
    asked: ChartRequest,
    truth: TruthRequest,
) -> PyResult<String> {
    let settings = ChartSettings {
        ladder: Ladder::from(LadderRequest {
            quick: asked.quick,
            rates_hz: asked.rates_hz,
            samples: asked.samples,
            edges: asked.edges,
            latch_hz: asked.latch_rates_hz,
            no_published: !asked.published,
            no_splat: !asked.splat,
            no_adaptive: !asked.adaptive,
        }),
        repetitions: asked.repetitions,
        sensor: truth.sensor(),
        pixels: truth.pixels(),
        camera: truth.camera,
        size: truth.size,
        start_us: truth.start_us,
        duration_us: truth.duration_us,
        reference_luminance: asked.reference_luminance,
        floor: asked.floor,
        cache: truth.cache,
    };
    let scene = scene.moved_by_default(py, settings.camera.as_ref(), settings.size)?;
    measured(py, truth.device, |gpu, going| {
        let made = evis_chart::chart(gpu, &scene.name, &scene, &settings, going)?;
        ChartResult::new(vec![made]).to_json()
    })
}

/// Measures on `device` what gives a text of JSON; Ctrl-C ends it.
pub(crate) fn measured(
    py: Python<'_>,
    device: Option<String>,
    measure: impl FnOnce(&Gpu, &Progress<'_>) -> Result<String, ChartError> + Send,
) -> PyResult<String> {
    let stop = AtomicBool::new(false);
    py.detach_interruptible(&stop, || {
        let gpu = Gpu::open(device.as_deref())?;
        Ok::<_, Failure>(measure(&gpu, &|_, _| !stop.load(Ordering::Relaxed))?)
    })
}

/// The user's folder for truths, where the system names one.
#[pyfunction]
pub(crate) fn chart_cache() -> Option<PathBuf> {
    evis_chart::user_cache()
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
        draw::save(&chart, Criteria { tolerance_us, render_ms }, &path)
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
        Ok(scene.recommend(goal, Criteria { tolerance_us, render_ms })?.to_json()?)
    })
}
