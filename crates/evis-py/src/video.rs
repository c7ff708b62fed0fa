//! Films, folders of pictures and arrays of frames: to recordings, and as arrays.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use evis_core::{SensorConfig, Transfer};
use evis_video::{
    Clock, FrameSource, Picture, SourceConfig, TimedFrame, Upsampler, Values, VideoConfig, VideoError,
    VideoStream, clock_of, transfer_name,
};
use numpy::{PyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::emulator::from_json;
use crate::errors::Failure;
use crate::gil::{Detach, ProcessBound};

impl From<VideoError> for Failure {
    fn from(error: VideoError) -> Self {
        match error {
            VideoError::Config(error) => error.into(),
            VideoError::Format(error) => error.into(),
            other => Self::Config(other.to_string()),
        }
    }
}

/// What to read, in the words of Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct SourceOptions {
    path: PathBuf,
    transfer: Option<String>,
    fps: Option<f64>,
    timestamps: Option<PathBuf>,
    size: Option<(u32, u32)>,
    start_us: i64,
    duration_us: Option<i64>,
    ffmpeg: Option<PathBuf>,
}

impl SourceOptions {
    fn open(self) -> Result<FrameSource, Failure> {
        let clock = match (self.fps, self.timestamps) {
            (Some(_), Some(_)) => {
                return Err(Failure::Config("fps and timestamps are both given; give one of them".into()));
            }
            (Some(fps), None) => Clock::rate(fps)?,
            (None, Some(path)) => clock_of(&path)?,
            (None, None) => Clock::Source,
        };
        let transfer = self.transfer.as_deref().map(evis_video::transfer).transpose()?;
        Ok(FrameSource::open(SourceConfig {
            clock,
            transfer,
            size: self.size,
            start_us: self.start_us,
            duration_us: self.duration_us,
            ffmpeg: self.ffmpeg,
            ..SourceConfig::new(self.path)
        })?)
    }
}

/// Converts frames to a recording; returns the report as JSON.
#[pyfunction]
#[pyo3(signature = (source, output, *, sensor, seed, reference_luminance, upsampler, overwrite, progress))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn convert_video(
    py: Python<'_>,
    source: SourceOptions,
    output: PathBuf,
    sensor: &str,
    seed: u64,
    reference_luminance: f32,
    upsampler: Option<Py<PyAny>>,
    overwrite: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let sensor: SensorConfig = from_json(sensor)?;
    let config = VideoConfig { sensor, seed, reference_luminance, ..VideoConfig::default() };
    let stop = AtomicBool::new(false);
    let failed = Mutex::new(None);
    let json = py.detach_interruptible(&stop, || {
        let mut stream = VideoStream::new(source.open()?, config)?;
        if let Some(upsampler) = upsampler {
            stream = stream.upsampled(Box::new(PythonUpsampler(upsampler)));
        }
        let duration_us = stream.source().duration_us().unwrap_or(0);
        let mut reported = Instant::now();
        let report = evis_video::convert(stream, &output, overwrite, |at| {
            if let Some(progress) = progress.as_ref().filter(|_| reported.elapsed() >= PROGRESS_PERIOD) {
                reported = Instant::now();
                let called =
                    Python::attach(|py| progress.call1(py, (at.t_us, duration_us, at.events)).map(|_| ()));
                if let Err(error) = called {
                    *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    return false;
                }
            }
            !stop.load(Ordering::Relaxed)
        })?;
        serde_json::to_string(&report).map_err(|error| Failure::Engine(error.to_string()))
    });
    match failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => json,
    }
}

/// Time between two calls of a progress function, at least.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);

/// Frames between frames by an object of Python, `evis.flow.Upsampler`.
#[derive(Debug)]
struct PythonUpsampler(Py<PyAny>);

/// For the command line: by the network in a file, else by optical flow.
pub(crate) fn upsampler(network: Option<&Path>) -> Result<Box<dyn Upsampler>, VideoError> {
    let made = Python::attach(|py| {
        let made = py.import("evis.flow")?.getattr("Upsampler")?.call1((network,))?;
        Ok(PythonUpsampler(made.unbind()))
    });
    Ok(Box::new(made.map_err(between)?))
}

fn between(error: PyErr) -> VideoError {
    VideoError::Between(Python::attach(|py| error.value(py).to_string()))
}

impl Upsampler for PythonUpsampler {
    fn name(&self) -> String {
        Python::attach(|py| self.0.bind(py).to_string())
    }

    fn between(
        &mut self,
        before: &TimedFrame,
        after: &TimedFrame,
        transfer: Transfer,
    ) -> Result<Vec<(i64, Picture)>, VideoError> {
        Python::attach(|py| {
            let frame = |frame: &TimedFrame| {
                let (t_us, values, height, width, channels) = columns(py, frame.clone());
                let pixels = match channels {
                    1 => values.call_method1("reshape", (height, width)),
                    _ => values.call_method1("reshape", (height, width, channels)),
                };
                PyResult::Ok((t_us, pixels?))
            };
            let curve = PyDict::new(py);
            curve.set_item("transfer", transfer_name(transfer))?;
            let made =
                self.0.bind(py).call_method("between", (frame(before)?, frame(after)?), Some(&curve))?;
            let made: Vec<(i64, PyReadonlyArray2<'_, f32>)> = made.extract()?;
            let picture = |(t_us, light): (i64, PyReadonlyArray2<'_, f32>)| {
                let [height, width] = [0, 1].map(|axis| light.shape()[axis] as u32);
                let values = Values::F32(light.as_array().iter().copied().collect());
                (t_us, Picture { width, height, channels: 1, values })
            };
            Ok(made.into_iter().map(picture).collect())
        })
        .map_err(between)
    }
}

/// Frames, one after the other.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct FrameReader(ProcessBound<Mutex<FrameSource>>);

/// Time, numbers, height, width, channels.
type FrameColumns<'py> = (i64, Bound<'py, PyAny>, u32, u32, usize);

fn columns(py: Python<'_>, TimedFrame { t_us, picture, .. }: TimedFrame) -> FrameColumns<'_> {
    let array = match picture.values {
        Values::U8(values) => PyArray1::from_vec(py, values).into_any(),
        Values::U16(values) => PyArray1::from_vec(py, values).into_any(),
        Values::F32(values) => PyArray1::from_vec(py, values).into_any(),
    };
    (t_us, array, picture.height, picture.width, picture.channels)
}

#[pymethods]
impl FrameReader {
    #[new]
    fn new(py: Python<'_>, source: SourceOptions) -> PyResult<Self> {
        py.detach_engine(|| Ok::<_, Failure>(Self(ProcessBound::new(Mutex::new(source.open()?)))))
    }

    /// The next frame as a flat array; None after the last one.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<FrameColumns<'py>>> {
        let read = py.detach_engine(|| {
            let mut source = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            source.next_frame().map_err(Failure::from)
        })?;
        Ok(read.map(|frame| columns(py, frame)))
    }

    /// Kind, curve, absolute time of the first frame used, warnings.
    fn about(&self, py: Python<'_>) -> PyResult<(&'static str, String, i64, Vec<String>)> {
        py.detach_engine(|| {
            let source = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let curve = transfer_name(source.transfer());
            Ok::<_, Failure>((source.kind(), curve, source.offset_us(), source.warnings()))
        })
    }
}
