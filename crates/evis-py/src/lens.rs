//! Calibrated lenses: points to pixels, and back; rigs and their calibration files.

use std::path::PathBuf;

use evis_scene::{CalibratedLens, CalibrationFormat, Distortion, Rig, SceneError};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::door::EnterEngine;
use crate::errors::Failure;

/// fx, fy, cx, cy.
type Intrinsics = (f64, f64, f64, f64);

fn lens(
    (fx, fy, cx, cy): Intrinsics,
    distortion: Option<(String, Vec<f64>)>,
) -> Result<CalibratedLens, SceneError> {
    let of = |(model, coefficients): (String, Vec<f64>)| Distortion::from_coefficients(&model, &coefficients);
    CalibratedLens::new([fx, fy], [cx, cy], distortion.map(of).transpose()?)
}

/// Pixels (N, 2) of points (N, 3) in camera space; NaN where the lens shows nothing.
#[pyfunction]
#[pyo3(signature = (intrinsics, distortion, points))]
pub(crate) fn lens_project<'py>(
    py: Python<'py>,
    intrinsics: Intrinsics,
    distortion: Option<(String, Vec<f64>)>,
    points: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let points = points.as_array().to_owned();
    let pixels = py.enter_alone(move || {
        let lens = lens(intrinsics, distortion)?;
        let mut pixels = Array2::from_elem((points.nrows(), 2), f64::NAN);
        for (point, mut pixel) in points.rows().into_iter().zip(pixels.rows_mut()) {
            if let Some(at) = lens.project([point[0], point[1], point[2]].into()) {
                (pixel[0], pixel[1]) = (at.x, at.y);
            }
        }
        Ok::<_, SceneError>(pixels)
    })?;
    Ok(pixels.into_pyarray(py))
}

/// Directions (N, 3) of length 1, in camera space, of pixels (N, 2); NaN where the lens sees nothing.
#[pyfunction]
#[pyo3(signature = (intrinsics, distortion, pixels))]
pub(crate) fn lens_unproject<'py>(
    py: Python<'py>,
    intrinsics: Intrinsics,
    distortion: Option<(String, Vec<f64>)>,
    pixels: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let pixels = pixels.as_array().to_owned();
    let directions = py.enter_alone(move || {
        let lens = lens(intrinsics, distortion)?;
        let mut directions = Array2::from_elem((pixels.nrows(), 3), f64::NAN);
        for (pixel, mut direction) in pixels.rows().into_iter().zip(directions.rows_mut()) {
            if let Some(seen) = lens.unproject([pixel[0], pixel[1]].into()) {
                (direction[0], direction[1], direction[2]) = (seen.x, seen.y, seen.z);
            }
        }
        Ok::<_, SceneError>(directions)
    })?;
    Ok(directions.into_pyarray(py))
}

fn json(rig: &Rig) -> Result<String, Failure> {
    serde_json::to_string(rig).map_err(|error| Failure::Engine(format!("a rig cannot be written: {error}")))
}

/// A calibration file's rig, as JSON.
#[pyfunction]
pub(crate) fn load_rig(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    py.enter_alone(|| json(&Rig::load(&path)?))
}

/// The rig of such a file's text, as JSON.
#[pyfunction]
pub(crate) fn parse_rig(py: Python<'_>, text: &str) -> PyResult<String> {
    py.enter_alone(|| json(&Rig::parse(text)?))
}

/// The text of a calibration file, of a rig as JSON.
#[pyfunction]
pub(crate) fn rig_text(py: Python<'_>, json: &str, format: &str) -> PyResult<String> {
    py.enter_alone(|| {
        let rig: Rig =
            serde_json::from_str(json).map_err(|e| Failure::Config(format!("a rig cannot be read: {e}")))?;
        Ok::<_, Failure>(rig.text(CalibrationFormat::from_name(format)?)?)
    })
}
