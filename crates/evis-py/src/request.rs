//! The request of a run, as Python gives it.

use std::collections::BTreeMap;
use std::path::PathBuf;

use evis_core::{ConfigError, Word};
use evis_render::{DenseKind, DenseOutput, Method, RunRequest, SamplingRequest};
use pyo3::prelude::*;

use crate::emulator::from_json;
use crate::engine;
use crate::errors::Failure;
use crate::representation;

/// The dataclass of the same name, field by field: sensors and a warp are JSON, choices are words.
#[derive(FromPyObject)]
pub(crate) struct Request {
    settings: Option<PathBuf>,
    sensor: Option<String>,
    sensors: BTreeMap<String, String>,
    quality: Option<String>,
    method: Option<String>,
    warp: Option<String>,
    rate_hz: Option<f64>,
    adaptive_px: Option<f64>,
    samples: Option<u32>,
    antialias: Option<String>,
    texture_taps: Option<u32>,
    shadows: Option<String>,
    compute: Option<String>,
    shadow_map: Option<u32>,
    audit: Option<f64>,
    cameras: Vec<String>,
    size: Option<(u32, u32)>,
    start_us: Option<i64>,
    seed: Option<u64>,
    labels: Vec<String>,
    label_rate_hz: Option<f64>,
    frame_rate_hz: Option<f64>,
    exposure_us: Option<i64>,
    camera_motion: Option<String>,
    camera_speed: Option<f64>,
    reference_luminance: Option<f32>,
    poses: Vec<String>,
    materials: Vec<String>,
    lights: Vec<String>,
    pose_step_us: Option<i64>,
    dense: Option<DenseRequest>,
}

/// Name, bins, polarity, normalize, tau_us, decay, and length of a window.
type DenseRequest = (String, u32, String, bool, f64, String, i64);

impl TryFrom<Request> for RunRequest {
    type Error = Failure;

    fn try_from(asked: Request) -> Result<Self, Failure> {
        let sensor = |json: &String| from_json(json);
        let sensors = asked.sensors.iter().map(|(camera, json)| Ok((camera.clone(), from_json(json)?)));
        Ok(Self {
            settings: asked.settings,
            sensor: asked.sensor.as_ref().map(sensor).transpose()?,
            sensors: sensors.collect::<Result<_, Failure>>()?,
            set: Vec::new(),
            sampling: SamplingRequest {
                quality: word("quality", asked.quality)?,
                from_settings: false,
                method: method(asked.method, asked.warp)?,
                rate_hz: asked.rate_hz,
                adaptive_px: asked.adaptive_px,
                samples: asked.samples,
                antialias: word("antialias", asked.antialias)?,
                texture_taps: asked.texture_taps,
                shadows: word("shadows", asked.shadows)?,
                compute: word("compute", asked.compute)?,
            },
            keyframe_hz: None,
            steps: None,
            margin: None,
            shadow_map: asked.shadow_map,
            audit: asked.audit,
            cameras: asked.cameras,
            size: asked.size,
            start_us: asked.start_us,
            seed: asked.seed,
            labels: asked.labels,
            label_rate_hz: asked.label_rate_hz,
            frame_rate_hz: asked.frame_rate_hz,
            exposure_us: asked.exposure_us,
            camera_motion: asked.camera_motion.as_deref().map(engine::camera_motion).transpose()?,
            camera_speed: asked.camera_speed,
            reference_luminance: asked.reference_luminance,
            poses: asked.poses,
            materials: asked.materials,
            lights: asked.lights,
            pose_step_us: asked.pose_step_us,
            dense: asked.dense.map(dense).transpose()?,
        })
    }
}

fn dense(asked: DenseRequest) -> Result<DenseOutput, Failure> {
    let (name, bins, polarity, normalize, tau_us, decay, window_us) = asked;
    let kind = match name.as_str() {
        "event_frame" => DenseKind::EventFrame,
        "counts" => DenseKind::Counts,
        "voxel_grid" => {
            DenseKind::VoxelGrid { bins, polarities: representation::polarities(&polarity)?, normalize }
        }
        "time_surface" => DenseKind::TimeSurface { tau_us, decay: representation::decay(&decay)? },
        other => {
            let remedy = "event_frame, counts, voxel_grid or time_surface";
            return Err(ConfigError::new("dense", other, remedy).into());
        }
    };
    Ok(DenseOutput { kind, window_us })
}

/// The value that a word stands for.
pub(crate) fn word<T: Word>(what: &str, word: Option<String>) -> Result<Option<T>, ConfigError> {
    word.map(|word| T::of_word(what, &word)).transpose()
}

/// A method by its word, or as a warp.
fn method(name: Option<String>, warp: Option<String>) -> Result<Option<Method>, ConfigError> {
    let Some(json) = warp else { return word("method", name) };
    let warp = serde_json::from_str(&json)
        .map_err(|error| ConfigError::new("method", &json, format!("settings that a Warp has ({error})")))?;
    Ok(Some(Method::Splat(warp)))
}
