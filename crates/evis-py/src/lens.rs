//! Calibrated lenses: points to pixels, and back; rigs and their calibration files; inertial measurement units.

use std::path::PathBuf;

use evis_core::ImuSample;
use evis_render::{Imu, ImuConfig, ImuNoise};
use evis_scene::{CalibratedLens, CalibrationFormat, Distortion, LensModel, Rig, SceneError};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::errors::Failure;
use crate::gil::Detach;
use crate::scene::Scene;

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
    let pixels = py.detach_pure(move || {
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
    let directions = py.detach_pure(move || {
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
    py.detach_pure(|| json(&Rig::load(&path)?))
}

/// The rig of such a file's text, as JSON.
#[pyfunction]
pub(crate) fn parse_rig(py: Python<'_>, text: &str) -> PyResult<String> {
    py.detach_pure(|| json(&Rig::parse(text)?))
}

fn rig_of(json: &str) -> Result<Rig, Failure> {
    serde_json::from_str(json).map_err(|e| Failure::Config(format!("a rig cannot be read: {e}")))
}

/// The text of a calibration file, of a rig as JSON.
#[pyfunction]
pub(crate) fn rig_text(py: Python<'_>, json: &str, format: &str) -> PyResult<String> {
    py.detach_pure(|| Ok::<_, Failure>(rig_of(json)?.text(CalibrationFormat::from_name(format)?)?))
}

/// By rows.
type Rotation = [[f64; 3]; 3];

/// How the pictures of cameras `left` and `right` (indices) of a rig as JSON are rectified: the rotations to the rectified axes from
/// those of the left and the right camera, the lens of both, and the baseline.
#[pyfunction]
pub(crate) fn rig_rectify(
    py: Python<'_>,
    json: &str,
    left: usize,
    right: usize,
    alpha: f64,
) -> PyResult<(Rotation, Rotation, Intrinsics, f64)> {
    py.detach_pure(|| {
        let pair = rig_of(json)?.rectify(left, right, alpha)?;
        let [a, b] = pair.cameras.map(|camera| camera.rectified_from_camera.transpose().to_cols_array_2d());
        let ([fx, fy], [cx, cy]) = (pair.cameras[0].pinhole.focal, pair.cameras[0].pinhole.center);
        Ok::<_, Failure>((a, b, (fx, fy, cx, cy), pair.baseline))
    })
}

/// Times (N,), specific force (N, 3) and angular rate (N, 3).
pub(crate) type ImuColumns<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

pub(crate) fn imu_columns<'py>(py: Python<'py>, samples: &[ImuSample]) -> ImuColumns<'py> {
    let vectors = |of: fn(&ImuSample) -> [f64; 3]| {
        Array2::from_shape_fn((samples.len(), 3), |(row, axis)| of(&samples[row])[axis]).into_pyarray(py)
    };
    let times = samples.iter().map(|sample| sample.t_us).collect();
    (PyArray1::from_vec(py, times), vectors(|s| s.accelerometer), vectors(|s| s.gyroscope))
}

pub(crate) fn imu_samples(
    t_us: &PyReadonlyArray1<'_, i64>,
    accelerometer: &PyReadonlyArray2<'_, f64>,
    gyroscope: &PyReadonlyArray2<'_, f64>,
) -> Result<Vec<ImuSample>, Failure> {
    let (t_us, force, rate) = (t_us.as_array(), accelerometer.as_array(), gyroscope.as_array());
    if [force.dim(), rate.dim()] != [(t_us.len(), 3); 2] {
        let shapes = format!("{:?} and {:?}", force.dim(), rate.dim());
        return Err(Failure::Config(format!("inertial samples are {shapes}; both take ({}, 3)", t_us.len())));
    }
    let row = |of: &numpy::ndarray::ArrayView2<'_, f64>, i: usize| [of[[i, 0]], of[[i, 1]], of[[i, 2]]];
    let sample = |(i, t_us): (usize, &i64)| ImuSample {
        t_us: *t_us,
        accelerometer: row(&force, i),
        gyroscope: row(&rate, i),
    };
    Ok(t_us.iter().enumerate().map(sample).collect())
}

/// What an inertial measurement unit on a node, or a camera's, measures. `noise`: density and random walk of the
/// accelerometer, then of the gyroscope.
#[pyfunction]
#[pyo3(signature = (scene, node, environment, rate_hz, noise, gravity, seed, start_us, duration_us))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn simulate_imu<'py>(
    py: Python<'py>,
    scene: &Scene,
    node: &str,
    environment: usize,
    rate_hz: f64,
    noise: [f64; 4],
    gravity: [f64; 3],
    seed: u64,
    start_us: i64,
    duration_us: i64,
) -> PyResult<ImuColumns<'py>> {
    let scene = scene.shared();
    let samples = py.detach_pure(|| {
        let node = scene.camera_or_node(node)?;
        let noise = ImuNoise::of(noise);
        let config =
            ImuConfig { environment, rate_hz, noise, gravity, seed, start_us, ..ImuConfig::new(node) };
        Ok::<_, Failure>(Imu::new(&scene, config)?.advance(&scene, duration_us))
    })?;
    Ok(imu_columns(py, &samples))
}
