//! The Python module `evis._evis`: converts arguments, calls the engine without the GIL (module `gil`), converts results.

mod bodies;
mod chart;
mod emulator;
mod engine;
mod errors;
mod events;
mod format;
mod gil;
mod lens;
mod metrics;
mod packet;
mod recording;
mod representation;
mod request;
mod scene;
mod simulator;
mod stats;
mod verify;
mod video;

/// The engine of EVIS; use the package `evis`.
#[pyo3::pymodule]
mod _evis {
    use pyo3::prelude::*;
    use pyo3::types::PyDict;

    use crate::errors::Failure;
    use crate::gil::Detach;

    #[pymodule_export]
    use crate::bodies::{HostBodies, body_times, scene_bodies};
    #[pymodule_export]
    use crate::chart::{chart, chart_cache, check_chart, draw_chart, recommend_chart};
    #[pymodule_export]
    use crate::emulator::{
        EventEmulator, check_motion, scene_sensors, sensor_check, sensor_from_toml,
        sensor_photoreceptor_noise, sensor_preset, sensor_presets, sensor_sample, sensor_to_toml,
    };
    #[pymodule_export]
    use crate::format::{EventFileReader, EventFileWriter, file_formats, format_of_ending, recognise_format};
    #[pymodule_export]
    use crate::lens::{
        lens_project, lens_unproject, load_rig, parse_rig, rig_rectify, rig_text, simulate_imu,
    };
    #[pymodule_export]
    use crate::metrics::{
        Truth, endpoint_error, mse, psnr, score, score_table, sensor_of_settings, ssim, voxel_l1,
    };
    #[pymodule_export]
    use crate::packet::{HostSpan, Label, Packet, View};
    #[pymodule_export]
    use crate::recording::{Recording, Writer, read_events};
    #[pymodule_export]
    use crate::representation::{
        averaged_timestamps, bina_rep, binary_stack, counts, event_frame, event_spike_tensor, time_surfaces,
        voxel_grid,
    };
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::simulator::{Simulator, Stream};
    #[pymodule_export]
    use crate::stats::{
        calibrate_flicker, calibrate_still, compare_table, draw_compare, static_scene, statistics,
    };
    #[pymodule_export]
    use crate::verify::{draw_verify, verify, verify_failures, verify_light, verify_scene, verify_table};
    #[pymodule_export]
    use crate::video::{FrameReader, convert_video};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("MOST_T_US", evis_core::event::MOST_T_US)?;
        crate::errors::register(module)
    }

    /// The dtype of one event.
    #[pyfunction]
    fn event_dtype(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
        crate::events::event_dtype(py).map(Bound::into_any)
    }

    /// Per kind of label: name, dtype, values per pixel.
    #[pyfunction]
    fn label_kinds() -> Vec<(&'static str, &'static str, usize)> {
        crate::engine::label_kinds()
    }

    /// Names and one-line descriptions of the built-in scenes.
    #[pyfunction]
    fn builtin_scenes() -> Vec<(&'static str, &'static str)> {
        crate::engine::builtin_names()
    }

    /// Linear light of every 8-bit sRGB value.
    #[pyfunction]
    fn srgb_table() -> Vec<f32> {
        crate::engine::srgb_table()
    }

    /// The devices that can run EVIS, as dictionaries.
    #[pyfunction]
    fn list_devices(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
        let devices = py.detach_engine(|| Ok::<_, Failure>(evis_render::list_devices()))?;
        devices.iter().map(|device| crate::engine::device_dict(py, device)).collect()
    }

    /// Memory that a file may take, in bytes, and whether scenes may refer to files outside of their folder; sets them first
    /// where they are given.
    #[pyfunction]
    #[pyo3(signature = (memory=None, allow_outside=None))]
    fn limits(memory: Option<u64>, allow_outside: Option<bool>) -> (u64, bool) {
        if let Some(allowed) = allow_outside {
            evis_core::limits::set_allow_outside(allowed);
        }
        if let Some(bytes) = memory {
            evis_core::limits::set_memory_limit(bytes);
        }
        (evis_core::limits::memory_limit(), evis_core::limits::allow_outside())
    }

    /// Text as it may be shown on a terminal: control characters but line breaks and tabs are written as `\\u001b`.
    #[pyfunction]
    fn printable(text: &str) -> String {
        evis_core::limits::printable(text).into_owned()
    }

    /// Runs the command line; returns its exit code.
    #[pyfunction]
    fn run_cli(py: Python<'_>, args: Vec<String>) -> PyResult<i32> {
        py.detach_engine(|| Ok::<_, Failure>(evis_cli::run_with(args, &crate::video::upsampler)))
    }

    /// For tests: what `kind` names, of exceptions, the released GIL and the ownership of arrays, without a device.
    #[pyfunction]
    fn _probe(py: Python<'_>, kind: &str) -> PyResult<Py<PyAny>> {
        crate::engine::probe(py, kind)
    }
}
