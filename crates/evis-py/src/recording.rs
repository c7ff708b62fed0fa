//! Event files: the HDF5 writer and reader.

use std::path::PathBuf;
use std::sync::Mutex;

use evis_core::format::hdf5::{self, RecordingExtras, RecordingHeader, RecordingWriter, StateInfo};
use evis_core::{LabelData, LabelFrame, PoseSample};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyReadonlyArrayDyn,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::bodies;
use crate::engine;
use crate::errors::Failure;
use crate::events::{self, EventCd};
use crate::gil::{Detach, ProcessBound, lock, lock_unpoisoned};
use crate::lens;
use crate::packet;

/// Events of a file, with pixels per row and rows.
#[pyfunction]
pub(crate) fn read_events(py: Python<'_>, path: PathBuf) -> PyResult<(Bound<'_, PyAny>, u32, u32)> {
    let file = py.detach_pure(|| evis_format::read_events(&path, None))?;
    Ok((events::into_numpy(py, file.events).into_any(), file.size.0, file.size.1))
}

/// An HDF5 file that is being written.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Writer {
    /// `None` once it is finished or abandoned.
    writer: ProcessBound<Mutex<Option<RecordingWriter>>>,
}

/// Names of a state's values (K), times (N,), values (N, K).
type StateColumns<'py> = (Vec<String>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray2<f64>>);

fn finished() -> Failure {
    Failure::Engine("this file is finished; open another one to write more".into())
}

impl Writer {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut RecordingWriter) -> Result<T, evis_core::format::FormatError> + Send,
    ) -> PyResult<T> {
        py.detach_engine(|| {
            let mut writer = lock_unpoisoned(&self.writer)?;
            Ok::<_, Failure>(work(writer.as_mut().ok_or_else(finished)?)?)
        })
    }
}

#[pymethods]
impl Writer {
    #[new]
    #[pyo3(signature = (
        path, *, cameras, seed, method, environment, config_toml, duration_us, t_offset_us, labels, overwrite,
        imus=Vec::new(), bodies=Vec::new(), states=Vec::new()
    ))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python, one per field of the header")]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        cameras: Vec<Bound<'_, PyDict>>,
        seed: u64,
        method: String,
        environment: u32,
        config_toml: String,
        duration_us: Option<i64>,
        t_offset_us: i64,
        labels: Vec<String>,
        overwrite: bool,
        imus: Vec<String>,
        bodies: Vec<bodies::BodyRow>,
        states: Vec<(String, Vec<String>)>,
    ) -> PyResult<Self> {
        let header = RecordingHeader {
            cameras: cameras.iter().map(engine::camera_info).collect::<PyResult<_>>()?,
            seed,
            method,
            environment,
            config_toml,
            duration_us,
            t_offset_us,
            labels: engine::labels(&labels)?,
        };
        let states = states.into_iter().map(|(name, values)| StateInfo { name, values }).collect();
        let extras = RecordingExtras { imus, bodies: bodies::infos_of(bodies), states };
        let writer =
            py.detach_engine(|| RecordingWriter::create_with_extras(&path, &header, &extras, overwrite))?;
        Ok(Self { writer: ProcessBound::new(Mutex::new(Some(writer))) })
    }

    /// Appends EventCD events of camera `camera`, with their causes where the file has them.
    #[pyo3(signature = (camera, events, causes=None))]
    fn write_events(
        &self,
        py: Python<'_>,
        camera: usize,
        events: PyReadonlyArray1<'_, EventCd>,
        causes: Option<PyReadonlyArray1<'_, u8>>,
    ) -> PyResult<()> {
        let events = events::as_events(&events)?;
        let causes = causes.as_ref().map_or(Ok(&[][..]), |causes| causes.as_slice())?;
        self.with(py, |writer| writer.write_caused_events(camera, events, causes))
    }

    /// Appends a label image of camera `camera`.
    fn write_label(
        &self,
        py: Python<'_>,
        camera: usize,
        kind: &str,
        t_us: i64,
        t_other_us: i64,
        data: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let frame = LabelFrame { kind: engine::label(kind)?, t_us, t_other_us, data: label_data(data)? };
        self.with(py, |writer| writer.write_label(camera, &frame))
    }

    /// Appends poses of camera `camera`: times (N,), positions (N, 3), rotations (N, 4).
    fn write_poses(
        &self,
        py: Python<'_>,
        camera: usize,
        t_us: PyReadonlyArray1<'_, i64>,
        position: PyReadonlyArray2<'_, f64>,
        rotation: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let (t_us, position, rotation) = (t_us.as_array(), position.as_array(), rotation.as_array());
        let poses =
            t_us.iter().zip(position.rows()).zip(rotation.rows()).map(|((t_us, position), rotation)| {
                Some(PoseSample {
                    t_us: *t_us,
                    position: position.to_vec().try_into().ok()?,
                    rotation: rotation.to_vec().try_into().ok()?,
                })
            });
        let poses: Vec<_> = poses
            .collect::<Option<_>>()
            .ok_or_else(|| Failure::Config("poses take positions (N, 3) and rotations (N, 4)".into()))?;
        self.with(py, |writer| poses.iter().try_for_each(|pose| writer.write_pose(camera, pose)))
    }

    /// Appends samples of inertial measurement unit `index`: times (N,), specific force (N, 3), angular rate (N, 3).
    fn write_imu(
        &self,
        py: Python<'_>,
        index: usize,
        t_us: PyReadonlyArray1<'_, i64>,
        accelerometer: PyReadonlyArray2<'_, f64>,
        gyroscope: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let samples = lens::imu_samples(&t_us, &accelerometer, &gyroscope)?;
        self.with(py, |writer| writer.write_imu(index, &samples))
    }

    /// Appends rows of state `index`: times (N,), values (N, K).
    fn write_state(
        &self,
        py: Python<'_>,
        index: usize,
        t_us: PyReadonlyArray1<'_, i64>,
        values: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let (t_us, values) = (t_us.as_slice()?, values.as_slice()?);
        self.with(py, |writer| writer.write_state(index, t_us, values))
    }

    /// Appends where all bodies are: times (T,), positions (T, N, 3), rotations (T, N, 4), velocities (T, N, 3).
    fn write_bodies(
        &self,
        py: Python<'_>,
        t_us: PyReadonlyArray1<'_, i64>,
        position: PyReadonlyArray3<'_, f64>,
        rotation: PyReadonlyArray3<'_, f64>,
        linear_velocity: PyReadonlyArray3<'_, f64>,
        angular_velocity: PyReadonlyArray3<'_, f64>,
    ) -> PyResult<()> {
        let samples = bodies::samples(&position, &rotation, &linear_velocity, &angular_velocity)?;
        let times = t_us.as_array().to_vec();
        self.with(py, |writer| {
            times.iter().zip(&samples).try_for_each(|(t, samples)| writer.write_bodies(*t, samples))
        })
    }

    /// Writes the report and closes the file.
    fn finish(&self, py: Python<'_>, report_json: &str) -> PyResult<()> {
        py.detach_engine(|| {
            let writer = lock_unpoisoned(&self.writer)?.take().ok_or_else(finished)?;
            Ok::<_, Failure>(writer.finish(report_json)?)
        })
    }

    /// Closes the file without a report: what was written stays readable, marked as incomplete.
    fn abandon(&self, py: Python<'_>) -> PyResult<()> {
        py.detach_engine(|| {
            drop(lock(&self.writer).take());
            Ok::<_, Failure>(())
        })
    }
}

/// An HDF5 file that is read piece by piece; it is open only during a call.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Recording(hdf5::Recording);

#[pymethods]
impl Recording {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self(py.detach_pure(|| hdf5::Recording::open(&path))?))
    }

    /// Cameras as dictionaries: name, width, height, fx, fy, cx, cy.
    #[getter]
    fn cameras<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        self.0.header().cameras.iter().map(|camera| engine::camera_dict(py, camera)).collect()
    }

    #[getter]
    fn labels(&self) -> Vec<&'static str> {
        self.0.header().labels.iter().map(|kind| kind.name()).collect()
    }

    #[getter]
    fn seed(&self) -> u64 {
        self.0.header().seed
    }

    #[getter]
    fn method(&self) -> &str {
        &self.0.header().method
    }

    #[getter]
    fn environment(&self) -> u32 {
        self.0.header().environment
    }

    #[getter]
    fn config_toml(&self) -> &str {
        &self.0.header().config_toml
    }

    #[getter]
    fn t_offset_us(&self) -> i64 {
        self.0.header().t_offset_us
    }

    fn is_complete(&self, py: Python<'_>) -> PyResult<bool> {
        py.detach_pure(|| self.0.is_complete())
    }

    fn report_json(&self, py: Python<'_>) -> PyResult<Option<String>> {
        py.detach_pure(|| self.0.report())
    }

    fn event_count(&self, py: Python<'_>, camera: usize) -> PyResult<u64> {
        py.detach_pure(|| self.0.event_count(camera))
    }

    /// Events of camera `camera` in `[start_us, end_us)`; all of them where there are no limits.
    fn events<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        limits: Option<(i64, i64)>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let events = py.detach_pure(|| match limits {
            Some((start_us, end_us)) => self.0.events_between(camera, start_us, end_us),
            None => self.0.events(camera),
        })?;
        Ok(events::into_numpy(py, events).into_any())
    }

    /// Why events fired, as [`Self::events`] gives those.
    fn causes<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        limits: Option<(i64, i64)>,
    ) -> PyResult<Option<Bound<'py, PyArray1<u8>>>> {
        let causes = py.detach_pure(|| self.0.causes(camera, limits))?;
        Ok(causes.map(|causes| PyArray1::from_vec(py, causes)))
    }

    fn label_times<'py>(
        &self,
        py: Python<'py>,
        camera: usize,
        kind: &str,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let kind = engine::label(kind)?;
        Ok(PyArray1::from_vec(py, py.detach_pure(|| self.0.label_times(camera, kind))?))
    }

    fn label(&self, py: Python<'_>, camera: usize, kind: &str, index: usize) -> PyResult<packet::Label> {
        let kind = engine::label(kind)?;
        let frame = py.detach_pure(|| self.0.label(camera, kind, index))?;
        let size = self.0.header().cameras.get(camera).map_or((0, 0), |info| (info.width, info.height));
        packet::label(py, frame, size)
    }

    /// Names of inertial measurement units.
    fn imus(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        py.detach_pure(|| self.0.imus())
    }

    /// Names of the states.
    fn states(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        py.detach_pure(|| self.0.states())
    }

    /// A state: names of its values (K), times (N,), values (N, K).
    fn state<'py>(&self, py: Python<'py>, name: &str) -> PyResult<StateColumns<'py>> {
        let state = py.detach_pure(|| self.0.state(name))?;
        let shape = [state.t_us.len(), state.names.len()];
        let values = PyArray1::from_vec(py, state.values).reshape(shape)?;
        Ok((state.names, PyArray1::from_vec(py, state.t_us), values))
    }

    /// Samples of the inertial measurement unit `name`.
    fn imu<'py>(&self, py: Python<'py>, name: &str) -> PyResult<lens::ImuColumns<'py>> {
        Ok(lens::imu_columns(py, &py.detach_pure(|| self.0.imu(name))?))
    }

    /// Objects and cameras, and where they are.
    fn bodies<'py>(&self, py: Python<'py>) -> PyResult<bodies::Columns<'py>> {
        Ok(bodies::columns(py, py.detach_pure(|| self.0.bodies())?))
    }

    fn poses(&self, py: Python<'_>, camera: usize) -> PyResult<Py<PyAny>> {
        packet::poses(py, &py.detach_pure(|| self.0.poses(camera))?)
    }
}

fn label_data(data: &Bound<'_, PyAny>) -> PyResult<LabelData> {
    if let Ok(values) = data.extract::<PyReadonlyArrayDyn<'_, f32>>() {
        return Ok(LabelData::F32(values.as_array().iter().copied().collect()));
    }
    if let Ok(values) = data.extract::<PyReadonlyArrayDyn<'_, u32>>() {
        return Ok(LabelData::U32(values.as_array().iter().copied().collect()));
    }
    if let Ok(values) = data.extract::<PyReadonlyArrayDyn<'_, u8>>() {
        return Ok(LabelData::U8(values.as_array().iter().copied().collect()));
    }
    Err(PyTypeError::new_err("a label image is an array of float32, uint32 or uint8"))
}
