//! Statistics of events, sensors fitted to them, and comparisons. They cross as JSON.

use std::path::PathBuf;

use evis_core::stats::{Comparison, Stimulus};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::emulator::{from_json, to_json};
use crate::errors::Failure;
use crate::events::{self, EventCd};
use crate::gil::Detach;

fn text(value: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(|error| Failure::Engine(error.to_string()))
}

fn value<T: DeserializeOwned>(json: &str, what: &str) -> Result<T, Failure> {
    serde_json::from_str(json)
        .map_err(|error| Failure::Format(format!("this is not the JSON of {what}: {error}")))
}

/// Statistics as JSON.
#[pyfunction]
pub(crate) fn statistics(
    py: Python<'_>,
    events: PyReadonlyArray1<'_, EventCd>,
    size: (u32, u32),
    range_us: (i64, i64),
) -> PyResult<String> {
    let events = events::as_events(&events)?;
    py.detach_engine(|| text(&evis_core::stats::stats(events, size, range_us)?))
}

/// A fit to a still scene: JSON, the sensor's JSON, the table.
#[pyfunction]
pub(crate) fn calibrate_still(
    py: Python<'_>,
    events: PyReadonlyArray1<'_, EventCd>,
    size: (u32, u32),
    range_us: (i64, i64),
    base: &str,
    seed: u64,
) -> PyResult<(String, String, String)> {
    let base = from_json(base)?;
    let events = events::as_events(&events)?;
    py.detach_engine(|| {
        let made = evis_core::stats::calibrate(events, size, range_us, &base, seed)?;
        Ok::<_, Failure>((text(&made)?, to_json(&made.sensor)?, made.to_string()))
    })
}

/// One recording of flicker: events, size, frequency and contrast.
type Flicker<'py> = (PyReadonlyArray1<'py, EventCd>, (u32, u32), (f64, f64));

/// A fit to flicker: JSON, the sensor's JSON, the table.
#[pyfunction]
pub(crate) fn calibrate_flicker(
    py: Python<'_>,
    recordings: Vec<Flicker<'_>>,
    base: &str,
) -> PyResult<(String, String, String)> {
    let base = from_json(base)?;
    let mut parts = Vec::new();
    for (events, size, (hz, contrast)) in &recordings {
        let stimulus = Stimulus::new(*hz, *contrast).map_err(Failure::from)?;
        parts.push((events::as_events(events)?, *size, stimulus));
    }
    py.detach_engine(|| {
        let made = evis_core::stats::calibrate_flicker(&parts, &base)?;
        Ok::<_, Failure>((text(&made)?, to_json(&made.sensor)?, made.to_string()))
    })
}

/// The table of a comparison that is given as JSON.
#[pyfunction]
pub(crate) fn compare_table(json: &str) -> PyResult<String> {
    Ok(value::<Comparison>(json, "a comparison")?.to_string())
}

/// Draws a comparison's JSON to `path`.
#[pyfunction]
pub(crate) fn draw_compare(py: Python<'_>, json: &str, path: PathBuf) -> PyResult<()> {
    let comparison: Comparison = value(json, "a comparison")?;
    py.detach_engine(|| evis_chart::compare::save(&comparison, &path))
}

/// Events of a sensor before a still scene.
#[pyfunction]
pub(crate) fn static_scene<'py>(
    py: Python<'py>,
    sensor: &str,
    size: (u32, u32),
    duration_us: i64,
    light: Option<f32>,
    seed: u64,
) -> PyResult<Bound<'py, PyAny>> {
    let sensor = from_json(sensor)?;
    let made = py.detach_engine(|| {
        Ok::<_, Failure>(evis_core::stats::static_scene(&sensor, size, duration_us, light, seed)?)
    })?;
    Ok(events::into_numpy(py, made).into_any())
}
