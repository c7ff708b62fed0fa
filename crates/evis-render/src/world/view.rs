//! Views: environment x camera, the engine's unit of work.

use std::sync::Arc;

use evis_core::random::Key;
use evis_core::{CameraInfo, ConfigError, SensorConfig};
use evis_scene::{PixelLens, Scene};

use crate::config::{self, Method, RunConfig};
use crate::error::EngineError;
use crate::world::distorted::Distorted;

/// One camera of one environment.
#[derive(Clone, Debug)]
pub struct View {
    /// Index into `Scene::variants`, 0 where there are none.
    pub environment: usize,
    /// Index into the simulator's cameras.
    pub camera: usize,
    /// Node that carries the camera.
    pub node: usize,
    /// Its camera's sensor, with that camera's own thresholds; or the one that a reset gave its environment.
    pub sensor: SensorConfig,
    /// Of everything random here. It depends on the camera's place in the scene, not among those that are rendered.
    pub key: Key,
    /// Pixels and lens of what is rendered: of the picture without distortion, where the camera's lens is distorted.
    pub lens: PixelLens,
    /// Pixels and lens of the camera itself, but for its distortion.
    pub own_lens: PixelLens,
    /// The camera's own lens, where it is distorted.
    pub distorted: Option<Arc<Distorted>>,
}

impl View {
    /// Pixels per row, and rows, of the camera.
    pub const fn size(&self) -> (u32, u32) {
        (self.own_lens.width, self.own_lens.height)
    }

    /// Its sensor, and the key of what is random in it.
    pub const fn sensing(&self) -> (&SensorConfig, Key) {
        (&self.sensor, self.key)
    }

    /// Whether it can share targets with `other`: of its size, and with its distorted lens where it has one.
    pub fn shares_targets(&self, other: &Self) -> bool {
        self.size() == other.size() && self.distorted == other.distorted
    }
}

/// The views that `config` asks of `scene`, environment-major, and their cameras.
///
/// # Errors
/// Unknown or repeated cameras, a sensor for a camera that is not there, cameras without a usable lens or sensor.
pub fn views(scene: &Scene, config: &RunConfig) -> Result<(Vec<View>, Vec<CameraInfo>), EngineError> {
    let chosen: Vec<usize> = if config.cameras.is_empty() {
        (0..scene.cameras.len()).collect()
    } else {
        config.cameras.iter().map(|name| scene.camera(name)).collect::<Result<_, _>>()?
    };
    if chosen.is_empty() {
        return Err(evis_scene::SceneError::Rule("it has no camera; add one".into()).into());
    }
    for (i, camera) in chosen.iter().enumerate() {
        if chosen[..i].contains(camera) {
            let name = &scene.cameras[*camera].name;
            return Err(evis_core::ConfigError::new("camera", name, "named once").into());
        }
    }
    for name in config.sensors.keys() {
        scene.camera(name)?;
    }
    let mut infos = Vec::new();
    let mut sensors = Vec::new();
    for &index in &chosen {
        let camera = &scene.cameras[index];
        let sensor = config.sensor_of(&camera.name).clone();
        let threshold_on = camera.threshold_on.unwrap_or(sensor.threshold_on);
        let threshold_off = camera.threshold_off.unwrap_or(sensor.threshold_off);
        let sensor = SensorConfig { threshold_on, threshold_off, ..sensor };
        sensors.push(config::checked(&camera.name, sensor)?);
    }
    let mut views: Vec<View> = Vec::new();
    for environment in 0..scene.variants.len().max(1) {
        for (slot, &index) in chosen.iter().enumerate() {
            let own = own_lens(scene, environment, index, config)?;
            if environment == 0 {
                infos.push(camera_info(scene, &scene.cameras[index].name, &own));
            }
            // Where a distorted lens is that of an environment before, what was prepared for it serves again.
            let twin = |view: &&View| view.camera == slot && view.distorted.is_some() && view.own_lens == own;
            let known = if scene.distortions.is_empty() { None } else { views.iter().find(twin) };
            let distorted = match known {
                Some(view) => view.distorted.clone(),
                None => distorted(scene, environment, index, &own, config.picture_density())?,
            };
            views.push(View {
                environment,
                camera: slot,
                node: scene.cameras[index].node,
                sensor: sensors[slot].clone(),
                key: key(scene, config.seed, environment, index),
                lens: distorted.as_ref().map_or(own, |of| of.picture),
                own_lens: own,
                distorted,
            });
        }
    }
    Ok((views, infos))
}

/// The lens of camera `index` (of the scene) in `environment`, in pixels.
///
/// # Errors
/// One through which nothing can be seen.
pub fn own_lens(
    scene: &Scene,
    environment: usize,
    index: usize,
    config: &RunConfig,
) -> Result<PixelLens, EngineError> {
    let variant = scene.variants.get(environment);
    Ok(scene.pixel_lens(variant, index, config.size, f64::INFINITY)?)
}

/// What a recording says of the camera `name` of `scene`, which has this lens: nothing but its size, of an orthographic one,
/// which has no intrinsics.
pub fn camera_info(scene: &Scene, name: &str, lens: &PixelLens) -> CameraInfo {
    if lens.is_parallel() {
        return CameraInfo::uncalibrated(name, (lens.width, lens.height));
    }
    let distortion = scene.distortions.get(name).map(|own| (own.name(), own.coefficients()));
    CameraInfo::new(name, (lens.width, lens.height), lens.focal, lens.center, distortion)
}

/// What is random in camera `camera` (of the scene) of `environment` follows from this, in a run with `seed`.
fn key(scene: &Scene, seed: u64, environment: usize, camera: usize) -> Key {
    let offset = scene.variants.get(environment).map_or(0, |variant| variant.seed_offset);
    Key::new(seed.wrapping_add(offset), environment as u32, camera as u32)
}

/// Lets what is random in the views of `environments` follow from `seeds`, as for a simulator of this seed; none: it stays.
pub fn reseed(views: &mut [View], scene: &Scene, environments: &[usize], seeds: &[u64]) {
    for (index, seed) in environments.iter().zip(seeds) {
        for view in views.iter_mut().filter(|view| view.environment == *index) {
            let place = scene.cameras.iter().position(|camera| camera.node == view.node);
            view.key = key(scene, *seed, *index, place.unwrap_or(view.camera));
        }
    }
}

/// Camera `index` of `scene` in `environment`, whose pixels are those of `lens`, where its lens is distorted.
fn distorted(
    scene: &Scene,
    environment: usize,
    index: usize,
    lens: &PixelLens,
    density: f64,
) -> Result<Option<Arc<Distorted>>, EngineError> {
    let camera = &scene.cameras[index];
    if !scene.distortions.contains_key(&camera.name) {
        return Ok(None);
    }
    let size = [lens.width, lens.height];
    let variant = scene.variants.get(environment);
    let own = scene.calibrated_lens_in(variant, index, lens.width, lens.height)?;
    Ok(Some(Arc::new(Distorted::new(&camera.name, own, size, camera.near, density)?)))
}

/// Whether `config` can show the cameras `cameras` of `views`, some of which may have distorted lenses or be orthographic.
///
/// # Errors
/// Keyframes of an orthographic camera; a method, adaptive time or frames with a distorted lens.
pub fn check_lenses(views: &[View], cameras: &[CameraInfo], config: &RunConfig) -> Result<(), ConfigError> {
    if config.method.keyframes().is_some()
        && let Some(view) = views.iter().find(|view| view.own_lens.is_parallel())
    {
        let name = cameras.get(view.camera).map_or("", |camera| &camera.name);
        let remedy = format!("native or decoupled: camera '{name}' is orthographic");
        return Err(ConfigError::new("method", config.method.name(), remedy));
    }
    let Some(view) = views.iter().find(|view| view.distorted.is_some()) else { return Ok(()) };
    let name = cameras.get(view.camera).map_or("", |camera| &camera.name);
    let because = format!("camera '{name}' has a distorted lens");
    if config.method.keyframes().is_some() {
        let remedy = format!("native or decoupled: {because}");
        return Err(ConfigError::new("method", config.method.name(), remedy));
    }
    if let Some(px) = config.adaptive_px.filter(|_| config.method == Method::Native) {
        let remedy = format!("left out: {because}, and every pixel of it is sampled at a fixed rate");
        return Err(ConfigError::new("adaptive_px", px, remedy));
    }
    if let Some(rate_hz) = config.frame_rate_hz {
        let remedy = format!("left out: {because}, and frames are for pinholes");
        return Err(ConfigError::new("frame_rate", rate_hz, remedy));
    }
    Ok(())
}
