//! The sensor on frames from elsewhere, and sensors as values.

use std::collections::BTreeMap;
use std::ffi::CString;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use evis_core::sensor::{NoiseLaw, PRESETS, sample};
use evis_core::{
    ConfigError, EmulatorConfig, EmulatorReport, FrameData, Frames, KeyframeReport, Keyframes, MotionCheck,
    Sensor, SensorConfig, Transfer, Warp, check_motion as check,
};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::errors::Failure;
use crate::events;
use crate::gil::{Detach, ProcessBound, lock_unpoisoned};

/// A sensor as JSON, every value spelled out.
pub(crate) fn to_json(sensor: &SensorConfig) -> Result<String, Failure> {
    Ok(sensor.spelled_out()?.to_string())
}

pub(crate) fn from_json(json: &str) -> Result<SensorConfig, Failure> {
    let sensor: SensorConfig = serde_json::from_str(json).map_err(|error| {
        // The place in a text that the user never saw says nothing.
        let reason = error.to_string().replace('`', "'");
        Failure::Config(format!("sensor: {}", reason.split(" at line ").next().unwrap_or(&reason)))
    })?;
    Ok(Sensor::new(sensor)?.config().clone())
}

/// Names of the presets and where they come from.
#[pyfunction]
pub(crate) fn sensor_presets() -> Vec<(&'static str, &'static str)> {
    PRESETS.iter().map(|preset| (preset.name, preset.source)).collect()
}

/// The preset `name` as JSON.
#[pyfunction]
pub(crate) fn sensor_preset(name: &str) -> PyResult<String> {
    let sensor = SensorConfig::preset(name).map_err(Failure::from)?;
    Ok(to_json(&sensor)?)
}

/// Checks a sensor; gives what is allowed and probably not meant, and whether it has thresholds only.
#[pyfunction]
pub(crate) fn sensor_check(json: &str) -> PyResult<(Vec<String>, bool)> {
    let sensor = from_json(json)?;
    Ok((sensor.warnings(), sensor.is_ideal()))
}

/// The photoreceptor's noise with which a sensor's pixels fire so often; by v2e's formula where `v2e`.
#[pyfunction]
pub(crate) fn sensor_photoreceptor_noise(json: &str, rate_hz: f64, v2e: bool) -> PyResult<f32> {
    let law = if v2e { NoiseLaw::V2e } else { NoiseLaw::Measured };
    Ok(from_json(json)?.photoreceptor_noise_for(rate_hz, law).map_err(Failure::from)?)
}

/// JSON to TOML.
#[pyfunction]
pub(crate) fn sensor_to_toml(json: &str) -> PyResult<String> {
    Ok(from_json(json)?.to_toml())
}

/// TOML to JSON.
#[pyfunction]
pub(crate) fn sensor_from_toml(text: &str) -> PyResult<String> {
    let sensor = SensorConfig::from_toml(text).map_err(Failure::from)?;
    Ok(to_json(&sensor)?)
}

/// A sensor drawn within ranges, as JSON.
#[pyfunction]
pub(crate) fn sensor_sample(json: &str, ranges: &str, seed: u64) -> PyResult<String> {
    let base = from_json(json)?;
    let ranges = serde_json::from_str(ranges)
        .map_err(|error| Failure::Config(format!("ranges are {ranges:?}; they must be JSON ({error})")))?;
    let drawn = sample(&base, &ranges, seed).map_err(Failure::from)?;
    Ok(to_json(&drawn)?)
}

/// The sensors that `scene` gives the cameras `names` (all, where there are none), by name, as JSON.
#[pyfunction]
pub(crate) fn scene_sensors(
    scene: &crate::scene::Scene,
    names: Vec<String>,
) -> PyResult<BTreeMap<String, String>> {
    let sensors = evis_render::scene_sensors(&scene.shared(), &names).map_err(Failure::from)?;
    Ok(sensors
        .into_iter()
        .map(|(name, sensor)| Ok((name, to_json(&sensor)?)))
        .collect::<Result<_, Failure>>()?)
}

/// Which convention motion vectors follow, from the light of two keyframes of `size` (width, height).
#[pyfunction]
#[pyo3(signature = (older, newer, motion, *, size, channels, transfer, gamma))]
#[allow(clippy::too_many_arguments, reason = "two keyframes")]
pub(crate) fn check_motion<'py>(
    py: Python<'py>,
    older: Values<'py>,
    newer: Values<'py>,
    motion: PyReadonlyArray1<'py, f32>,
    size: [usize; 2],
    channels: [usize; 2],
    transfer: [String; 2],
    gamma: f32,
) -> PyResult<Bound<'py, PyDict>> {
    let older = Frames { data: older.data(&transfer[0], gamma)?, channels: channels[0] };
    let newer = Frames { data: newer.data(&transfer[1], gamma)?, channels: channels[1] };
    let motion = motion.as_slice()?;
    let MotionCheck { scale, convention, error_given, error } =
        py.detach_engine(|| check(&older, &newer, motion, size).map_err(Failure::from))?;
    let dict = PyDict::new(py);
    dict.set_item("scale", (scale[0], scale[1]))?;
    dict.set_item("convention", convention)?;
    dict.set_item("error_given", error_given)?;
    dict.set_item("error", error)?;
    Ok(dict)
}

/// Frames in, events out.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct EventEmulator {
    emulator: ProcessBound<Mutex<evis_core::EventEmulator>>,
    /// Whether it was said that frames hold NaN.
    warned_of_unknown: AtomicBool,
}

/// One-dimensional, contiguous.
#[derive(FromPyObject)]
pub(crate) enum Values<'py> {
    F32(PyReadonlyArray1<'py, f32>),
    U8(PyReadonlyArray1<'py, u8>),
    U16(PyReadonlyArray1<'py, u16>),
}

impl Values<'_> {
    /// What the numbers are, by the name of their curve.
    fn data(&self, transfer: &str, gamma: f32) -> PyResult<FrameData<'_>> {
        Ok(match self {
            Self::F32(values) if transfer == "log" => FrameData::Log(values.as_slice()?),
            Self::F32(values) if transfer == "linear" => FrameData::Linear(values.as_slice()?),
            Self::F32(_) => {
                let remedy = "linear or log for float32 frames";
                return Err(Failure::from(ConfigError::new("transfer", transfer, remedy)).into());
            }
            Self::U8(values) => FrameData::U8(values.as_slice()?, self::transfer(transfer, gamma)?),
            Self::U16(values) => FrameData::U16(values.as_slice()?, self::transfer(transfer, gamma)?),
        })
    }
}

fn transfer(name: &str, gamma: f32) -> Result<Transfer, Failure> {
    Ok(match name {
        "srgb" => Transfer::Srgb,
        "rec709" => Transfer::Rec709,
        "gamma" => Transfer::Gamma(gamma),
        "linear" => Transfer::Linear,
        _ => {
            let remedy = "one of srgb, rec709, gamma (with gamma=...) and linear for integers";
            return Err(ConfigError::new("transfer", name, remedy).into());
        }
    })
}

#[pymethods]
impl EventEmulator {
    #[new]
    #[pyo3(signature = (*, width, height, batch, seed, camera, sensor, reference_luminance, threads, causes))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments, all with names")]
    fn new(
        py: Python<'_>,
        width: u32,
        height: u32,
        batch: usize,
        seed: u64,
        camera: u32,
        sensor: &str,
        reference_luminance: f32,
        threads: usize,
        causes: bool,
    ) -> PyResult<Self> {
        let sensor = from_json(sensor)?;
        let config = EmulatorConfig {
            width,
            height,
            batch,
            seed,
            camera,
            sensor,
            reference_luminance,
            threads,
            causes,
        };
        py.detach_engine(|| {
            let emulator = ProcessBound::new(Mutex::new(evis_core::EventEmulator::new(config)?));
            Ok::<_, Failure>(Self { emulator, warned_of_unknown: AtomicBool::new(false) })
        })
    }

    /// Takes frames; gives an array of events per environment.
    #[pyo3(signature = (frames, t_us, *, channels, transfer, gamma))]
    fn push<'py>(
        &self,
        py: Python<'py>,
        frames: Values<'py>,
        t_us: i64,
        channels: usize,
        transfer: &str,
        gamma: f32,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let data = frames.data(transfer, gamma)?;
        let frames = Frames { data, channels };
        let (lists, unknown) = py.detach_engine(|| {
            let mut emulator = lock_unpoisoned(&self.emulator)?;
            let lists = emulator.push(&frames, t_us).map_err(Failure::from)?;
            Ok::<_, Failure>((lists, emulator.report().unknown))
        })?;
        if unknown > 0 && !self.warned_of_unknown.swap(true, Ordering::Relaxed) {
            let warning = format!(
                "frames hold NaN ({unknown} values at {t_us} us), which means unknown: those pixels keep their state. \
                 This is said once; report.unknown and total_report.unknown count them"
            );
            // Of the caller of the Python method that calls this.
            let text = CString::new(warning).map_err(|error| Failure::Engine(error.to_string()))?;
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)?;
        }
        Ok(lists.into_iter().map(|list| events::into_numpy(py, list).into_any()).collect())
    }

    /// Takes frames with depth and motion; gives an array of events per environment.
    #[pyo3(signature = (
        light, depth, motion, t_us, *, motion_steps, motion_forward, cut, channels, transfer, gamma, warp
    ))]
    #[allow(clippy::too_many_arguments, reason = "what a keyframe has")]
    fn push_keyframe<'py>(
        &self,
        py: Python<'py>,
        light: Values<'py>,
        depth: PyReadonlyArray1<'py, f32>,
        motion: Option<PyReadonlyArray1<'py, f32>>,
        t_us: i64,
        motion_steps: Option<PyReadonlyArray1<'py, f32>>,
        motion_forward: Option<PyReadonlyArray1<'py, f32>>,
        cut: Vec<bool>,
        channels: usize,
        transfer: &str,
        gamma: f32,
        warp: &str,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let warp: Warp = serde_json::from_str(warp)
            .map_err(|error| Failure::Config(format!("warp: {}", error.to_string().replace('`', "'"))))?;
        let keyframes = Keyframes {
            light: light.data(transfer, gamma)?,
            channels,
            depth: depth.as_slice()?,
            motion: motion.as_ref().map(|values| values.as_slice()).transpose()?.unwrap_or_default(),
            motion_steps: motion_steps.as_ref().map(|values| values.as_slice()).transpose()?,
            motion_forward: motion_forward.as_ref().map(|values| values.as_slice()).transpose()?,
            cut: &cut,
        };
        let lists = py.detach_engine(|| {
            let mut emulator = lock_unpoisoned(&self.emulator)?;
            emulator.push_keyframe(&keyframes, t_us, &warp).map_err(Failure::from)
        })?;
        Ok(lists.into_iter().map(|list| events::into_numpy(py, list).into_any()).collect())
    }

    /// Why the events of the last push fired, an array per environment; none where that was not asked for.
    fn causes<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyArray1<u8>>>> {
        let lists = py.detach_engine(|| {
            let emulator = lock_unpoisoned(&self.emulator)?;
            Ok::<_, Failure>(emulator.causes().to_vec())
        })?;
        Ok(lists.into_iter().map(|list| PyArray1::from_vec(py, list)).collect())
    }

    /// Reports on the last keyframes, per environment.
    fn keyframe_reports<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let reports = py.detach_engine(|| {
            let emulator = lock_unpoisoned(&self.emulator)?;
            Ok::<_, Failure>(emulator.keyframe_reports().to_vec())
        })?;
        reports.iter().map(|report| keyframe_dict(py, report)).collect()
    }

    /// Resets environments.
    fn reset(&self, py: Python<'_>, environments: Option<Vec<usize>>) -> PyResult<()> {
        py.detach_engine(|| {
            let mut emulator = lock_unpoisoned(&self.emulator)?;
            emulator.reset(environments.as_deref()).map_err(Failure::from)
        })
    }

    /// Counts of the last push, and of all pushes.
    fn reports<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
        let (last, total) = py.detach_engine(|| {
            let emulator = lock_unpoisoned(&self.emulator)?;
            Ok::<_, Failure>((*emulator.report(), *emulator.total_report()))
        })?;
        Ok((report_dict(py, &last)?, report_dict(py, &total)?))
    }

    /// Time of the last frame.
    fn now_us(&self, py: Python<'_>) -> PyResult<Option<i64>> {
        py.detach_engine(|| {
            let emulator = lock_unpoisoned(&self.emulator)?;
            Ok::<_, Failure>(emulator.now_us())
        })
    }

    /// The state that the next events depend on, apart from the settings.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach_engine(|| {
            let emulator = lock_unpoisoned(&self.emulator)?;
            Ok::<_, Failure>(emulator.state())
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Restores what [`Self::state`] returned.
    fn restore(&self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        py.detach_engine(|| {
            let mut emulator = lock_unpoisoned(&self.emulator)?;
            emulator.restore(state).map_err(Failure::from)
        })
    }
}

fn report_dict<'py>(py: Python<'py>, report: &EmulatorReport) -> PyResult<Bound<'py, PyDict>> {
    let EmulatorReport { events, unknown, clamped, suppressed, dropped } = *report;
    let dict = PyDict::new(py);
    dict.set_item("events", events)?;
    dict.set_item("unknown", unknown)?;
    dict.set_item("clamped", clamped)?;
    dict.set_item("suppressed", suppressed)?;
    dict.set_item("dropped", dropped)?;
    Ok(dict)
}

fn keyframe_dict<'py>(py: Python<'py>, report: &KeyframeReport) -> PyResult<Bound<'py, PyDict>> {
    let warnings = report.warnings();
    let KeyframeReport { steps, motion_px, linked, unknown, bad_depth, bad_motion, strayed, cut } = *report;
    let dict = PyDict::new(py);
    dict.set_item("steps", steps)?;
    dict.set_item("motion_px", motion_px)?;
    dict.set_item("linked", linked)?;
    dict.set_item("unknown", unknown)?;
    dict.set_item("bad_depth", bad_depth)?;
    dict.set_item("bad_motion", bad_motion)?;
    dict.set_item("strayed", strayed)?;
    dict.set_item("cut", cut.name())?;
    dict.set_item("warnings", warnings)?;
    Ok(dict)
}
