//! Objects and cameras by name, and where they are, as arrays.

use std::sync::Mutex;

use evis_core::format::hdf5::{self, BodyInfo, BodySample};
use evis_render::{Bodies, BodyTimes};
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray1, PyArray3, PyReadonlyArray3};
use pyo3::prelude::*;

use crate::errors::Failure;
use crate::gil::{Detach, lock_unpoisoned};
use crate::packet::HostSpan;
use crate::scene::Scene;

/// Name, instance id, semantic id and name, lowest and highest corner.
pub(crate) type BodyRow = (String, u32, u32, String, [[f64; 3]; 2]);

type Values<'py> = Bound<'py, PyArray3<f64>>;

/// What bodies there are, times (T,), positions (T, N, 3), rotations (T, N, 4), linear and angular velocities (T, N, 3).
pub(crate) type Columns<'py> =
    (Vec<BodyRow>, Bound<'py, PyArray1<i64>>, Values<'py>, Values<'py>, Values<'py>, Values<'py>);

pub(crate) fn infos_of(infos: Vec<BodyRow>) -> Vec<BodyInfo> {
    let info = |(name, instance_id, semantic_id, semantic_name, bounds)| BodyInfo {
        name,
        instance_id,
        semantic_id,
        semantic_name,
        bounds,
    };
    infos.into_iter().map(info).collect()
}

pub(crate) fn columns(py: Python<'_>, bodies: hdf5::Bodies) -> Columns<'_> {
    let hdf5::Bodies { infos, t_us, samples } = bodies;
    let (times, count) = (samples.len(), infos.len());
    let vectors = |of: fn(&BodySample) -> [f64; 3]| {
        Array3::from_shape_fn((times, count, 3), |(t, n, axis)| of(&samples[t][n])[axis]).into_pyarray(py)
    };
    let rotation = Array3::from_shape_fn((times, count, 4), |(t, n, axis)| samples[t][n].rotation[axis])
        .into_pyarray(py);
    let info = |i: BodyInfo| (i.name, i.instance_id, i.semantic_id, i.semantic_name, i.bounds);
    let infos = infos.into_iter().map(info).collect();
    (
        infos,
        PyArray1::from_vec(py, t_us),
        vectors(|s| s.position),
        rotation,
        vectors(|s| s.linear_velocity),
        vectors(|s| s.angular_velocity),
    )
}

/// Samples, for each time one per body, of arrays (T, N, 3) and (T, N, 4).
pub(crate) fn samples(
    position: &PyReadonlyArray3<'_, f64>,
    rotation: &PyReadonlyArray3<'_, f64>,
    linear: &PyReadonlyArray3<'_, f64>,
    angular: &PyReadonlyArray3<'_, f64>,
) -> Result<Vec<Vec<BodySample>>, Failure> {
    let [position, linear, angular] = [position, linear, angular].map(PyReadonlyArray3::as_array);
    let rotation = rotation.as_array();
    let (times, count, _) = position.dim();
    let vectors = [position.dim(), linear.dim(), angular.dim()] == [(times, count, 3); 3];
    if !vectors || rotation.dim() != (times, count, 4) {
        return Err(Failure::Config("poses of bodies take (T, N, 3) and rotations (T, N, 4)".into()));
    }
    let sample = |t: usize, n: usize| BodySample {
        position: [0, 1, 2].map(|axis| position[[t, n, axis]]),
        rotation: [0, 1, 2, 3].map(|axis| rotation[[t, n, axis]]),
        linear_velocity: [0, 1, 2].map(|axis| linear[[t, n, axis]]),
        angular_velocity: [0, 1, 2].map(|axis| angular[[t, n, axis]]),
    };
    Ok((0..times).map(|t| (0..count).map(|n| sample(t, n)).collect()).collect())
}

/// Objects of a scene and the cameras of these names, at stream times that begin at scene time `start_us`.
#[pyfunction]
#[pyo3(signature = (scene, cameras, environment, start_us, t_us))]
pub(crate) fn scene_bodies<'py>(
    py: Python<'py>,
    scene: &Scene,
    cameras: Vec<String>,
    environment: usize,
    start_us: i64,
    t_us: Vec<i64>,
) -> PyResult<Columns<'py>> {
    let scene = scene.shared();
    let bodies = py.detach_pure(|| {
        let mut bodies = Bodies::new(&scene, cameras.iter().map(String::as_str), environment, start_us)?;
        let samples = t_us.iter().map(|t| bodies.at(&scene, *t)).collect();
        Ok::<_, Failure>(hdf5::Bodies { infos: bodies.infos().to_vec(), t_us, samples })
    })?;
    Ok(columns(py, bodies))
}

/// The bodies of a scene that a host moves.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct HostBodies(Mutex<evis_render::HostBodies>);

#[pymethods]
impl HostBodies {
    #[new]
    fn new(
        py: Python<'_>,
        scene: &Scene,
        nodes: Vec<String>,
        cameras: Vec<String>,
        start_us: i64,
    ) -> PyResult<Self> {
        let scene = scene.shared();
        let bodies = py.detach_pure(|| {
            Ok::<_, Failure>(evis_render::HostBodies::new(&scene, &nodes, &cameras, start_us)?)
        })?;
        Ok(Self(Mutex::new(bodies)))
    }

    /// Where all bodies were during the packet that `span` is of, by environment: at the times that the host gave, and at `t_us`.
    fn follow<'py>(&self, py: Python<'py>, span: &HostSpan, t_us: Vec<i64>) -> PyResult<Vec<Columns<'py>>> {
        let followed = py.detach_engine(|| {
            let mut bodies = lock_unpoisoned(&self.0)?;
            let rows = bodies.follow(&span.0, &t_us)?;
            let of = |(infos, rows): (&[BodyInfo], Vec<evis_render::BodyRow>)| {
                let (t_us, samples) = rows.into_iter().unzip();
                hdf5::Bodies { infos: infos.to_vec(), t_us, samples }
            };
            Ok::<_, Failure>(bodies.infos().zip(rows).map(of).collect::<Vec<_>>())
        })?;
        Ok(followed.into_iter().map(|bodies| columns(py, bodies)).collect())
    }
}

/// Times of a rate after `after_us` up to `until_us`, both in microseconds and the latter included.
#[pyfunction]
#[pyo3(signature = (rate_hz, after_us, until_us))]
pub(crate) fn body_times(rate_hz: f64, after_us: i64, until_us: i64) -> PyResult<Vec<i64>> {
    let mut times = BodyTimes::new(rate_hz).map_err(Failure::from)?;
    times.advance(after_us);
    Ok(times.advance(until_us))
}
