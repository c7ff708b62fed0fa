//! Reports of convergence. They cross as JSON, the same as `evis verify --json` writes.

use std::path::{Path, PathBuf};

use evis_chart::verify::failures::{NamedMethod, methods};
use evis_chart::verify::{FailureSettings, LightSettings, Report, SceneSettings, verify_forms};
use evis_core::Word as _;
use evis_core::closed_form::convergence::Variant;
use evis_render::Shadows;
use pyo3::prelude::*;

use crate::chart::{TruthRequest, measured};
use crate::errors::Failure;
use crate::gil::Detach;
use crate::request::word;
use crate::scene::Scene;

/// What a text of JSON is called in errors.
const TEXT: &str = "report";

/// Measures the triggers on closed forms; returns the report as JSON.
#[pyfunction]
pub(crate) fn verify(py: Python<'_>) -> PyResult<String> {
    py.detach_engine(|| Ok::<_, Failure>(verify_forms()?.to_json()?))
}

/// Measures the engine on a scene; returns the report as JSON.
#[pyfunction]
pub(crate) fn verify_scene(
    py: Python<'_>,
    scene: &Scene,
    rates_hz: Vec<f64>,
    samples: Vec<u32>,
    triggers: Vec<String>,
    truth: TruthRequest,
) -> PyResult<String> {
    let triggers = triggers.iter().map(|name| Variant::of_word("triggers", name));
    let settings = SceneSettings {
        rates_hz,
        samples,
        triggers: triggers.collect::<Result<_, _>>().map_err(Failure::from)?,
        sensor: truth.sensor(),
        pixels: truth.pixels(),
        camera: truth.camera,
        size: truth.size,
        start_us: truth.start_us,
        duration_us: truth.duration_us,
        cache: truth.cache,
    };
    let scene = scene.moved_by_default(py, settings.camera.as_ref(), settings.size)?;
    measured(py, truth.device, |gpu, going| {
        evis_chart::verify::verify_scene(gpu, &scene.name, &scene, &settings, going)?.to_json()
    })
}

/// Measures the failure modes; returns the report as JSON. Without names, all methods and all failures.
#[pyfunction]
#[pyo3(signature = (*, methods, failures, compute, cache, device))]
pub(crate) fn verify_failures(
    py: Python<'_>,
    methods: Option<Vec<String>>,
    failures: Option<Vec<String>>,
    compute: Option<String>,
    cache: Option<PathBuf>,
    device: Option<String>,
) -> PyResult<String> {
    let named = |names: Vec<String>| names.iter().map(|name| NamedMethod::named(name)).collect();
    let methods: Result<Vec<NamedMethod>, _> = methods.map_or_else(|| Ok(self::methods()), named);
    let settings = FailureSettings {
        methods: methods.map_err(Failure::from)?,
        failures: failures.unwrap_or_default(),
        cache,
        compute: word("compute", compute).map_err(Failure::from)?.unwrap_or_default(),
    };
    // Before a device is opened.
    settings.check().map_err(Failure::from)?;
    measured(py, device, |gpu, going| evis_chart::verify::verify_failures(gpu, &settings, going)?.to_json())
}

/// What light is compared at, as Python gives it: a dictionary with these keys.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct LightRequest {
    at_us: i64,
    samples: u32,
    shadows: String,
    camera: Option<String>,
    size: Option<(u32, u32)>,
    worst: usize,
    device: Option<String>,
}

/// Compares light at one instant; returns the report as JSON.
#[pyfunction]
pub(crate) fn verify_light(py: Python<'_>, scene: &Scene, asked: LightRequest) -> PyResult<String> {
    let LightRequest { at_us, samples, shadows, camera, size, worst, device } = asked;
    let shadows = Shadows::of_word("shadows", &shadows).map_err(Failure::from)?;
    let settings = LightSettings { camera, size, at_us, samples, shadows, worst };
    let scene = scene.moved_by_default(py, settings.camera.as_ref(), settings.size)?;
    measured(py, device, |gpu, going| {
        evis_chart::verify::verify_light(gpu, &scene.name, &scene, &settings, going)?.to_json()
    })
}

/// The table of a report that is given as JSON.
#[pyfunction]
pub(crate) fn verify_table(py: Python<'_>, json: &str) -> PyResult<String> {
    py.detach_engine(|| Ok::<_, Failure>(Report::from_json(json, Path::new(TEXT))?.to_string()))
}

/// Draws a report's JSON to `path`.
#[pyfunction]
pub(crate) fn draw_verify(py: Python<'_>, json: &str, path: PathBuf) -> PyResult<()> {
    py.detach_engine(|| Report::from_json(json, Path::new(TEXT))?.save(&path))
}
