//! From what a user asks to settings: one policy for the command line, Python and Rust.
//!
//! [`RunRequest::settle`] puts a request over its settings file or the defaults, and [`Settled::configure`] makes a
//! configuration of it for a scene and a device. What does not fit is refused here and nowhere else. Errors name settings
//! by the fields of [`RunRequest`], in remedies between backticks: who shows them may put other names there.

mod implausible;
pub mod quality;
mod sampling;
pub mod settings;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use evis_core::{ConfigError, LabelKind, SensorConfig, TriggerRule, Warp, WarpVariant};
use evis_scene::camera_motion::{self, CameraMotionSettings};
use evis_scene::{CameraMotion, HostNames, Scene};

pub use implausible::implausible;
pub use sampling::SamplingRequest;

use crate::config::dense::DenseOutput;
use crate::config::{EVIS_PAPER_LOG_EPS, Method, RunConfig, scene_sensors};
use crate::error::EngineError;
use crate::gpu::Gpu;
use settings::{RecordedScene, SettingsFile};

/// Time between two poses of a host, where none is given, in microseconds.
pub const USUAL_POSE_STEP_US: i64 = 10_000;

/// What a user asks of a run; `None` and empty where nothing was said.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunRequest {
    /// Settings from a file, or those of a recording; everything else stands over them.
    pub settings: Option<PathBuf>,
    /// Sensor of every camera that `sensors` does not name; `None` for what the scene gives each, else an ideal one.
    pub sensor: Option<SensorConfig>,
    /// Sensors of single cameras.
    pub sensors: BTreeMap<String, SensorConfig>,
    /// Values set in every sensor, those of the scene too: see [`SensorConfig::set`].
    pub set: Vec<String>,
    /// How pixels are sampled.
    pub sampling: SamplingRequest,
    /// Keyframes per second, of a method that has keyframes.
    pub keyframe_hz: Option<f64>,
    /// Instants per gap between keyframes, of a method that has keyframes.
    pub steps: Option<u32>,
    /// Pixels that keyframes show beyond each border, of a method that has keyframes.
    pub margin: Option<u32>,
    /// [`RunConfig::shadow_map`].
    pub shadow_map: Option<u32>,
    /// [`RunConfig::audit`].
    pub audit: Option<f64>,
    /// Names of the cameras to render; empty for all.
    pub cameras: Vec<String>,
    /// [`RunConfig::size`].
    pub size: Option<(u32, u32)>,
    /// [`RunConfig::start_us`].
    pub start_us: Option<i64>,
    /// [`RunConfig::seed`].
    pub seed: Option<u64>,
    /// Labels, by [`LabelKind::WORDS`].
    pub labels: Vec<String>,
    /// [`RunConfig::label_rate_hz`].
    pub label_rate_hz: Option<f64>,
    /// [`RunConfig::frame_rate_hz`].
    pub frame_rate_hz: Option<f64>,
    /// [`RunConfig::exposure_us`].
    pub exposure_us: Option<i64>,
    /// How cameras move that the scene leaves at rest.
    pub camera_motion: Option<CameraMotion>,
    /// Image speed of that motion in pixels per second.
    pub camera_speed: Option<f64>,
    /// [`RunConfig::reference_luminance`].
    pub reference_luminance: Option<f32>,
    /// Names of nodes and cameras that a host moves.
    pub poses: Vec<String>,
    /// Names of the materials that a host changes, or of nodes whose own it changes.
    pub materials: Vec<String>,
    /// Names of the lights that a host changes, or of nodes that carry them.
    pub lights: Vec<String>,
    /// [`RunConfig::pose_step_us`].
    pub pose_step_us: Option<i64>,
    /// [`RunConfig::dense`].
    pub dense: Option<DenseOutput>,
}

impl RunRequest {
    /// Puts the request over its settings file or the defaults.
    ///
    /// # Errors
    /// A settings file that cannot be used, what contradicts itself, a value that cannot be used.
    pub fn settle(self) -> Result<Settled, EngineError> {
        let file = self.settings.as_deref().map(SettingsFile::open).transpose()?;
        // A recording's settings hold every camera's sensor.
        let for_all = self.sensor.is_some() || file.as_ref().is_some_and(|file| file.gives("sensor"));
        let (mut config, recorded) = file.map_or_else(Default::default, SettingsFile::into_parts);
        let sampling = SamplingRequest {
            from_settings: self.settings.is_some(),
            method: self.method()?,
            ..self.sampling.clone()
        };
        sampling.check()?;

        config.sensors.extend(self.sensors.clone());
        if let Some(sensor) = &self.sensor {
            config.sensor = sensor.clone();
        } else if is_evis_paper(sampling.method) {
            config.sensor.trigger = TriggerRule::Latch;
            config.sensor.log_eps = EVIS_PAPER_LOG_EPS;
        }
        for sensor in config.sensors.values_mut().chain([&mut config.sensor]) {
            set(sensor, &self.set)?;
        }
        if !self.cameras.is_empty() {
            config.cameras.clone_from(&self.cameras);
        }
        if !self.labels.is_empty() {
            config.labels = LabelKind::asked(&self.labels)?;
        }
        config.shadow_map = self.shadow_map.or(config.shadow_map);
        config.audit = self.audit.unwrap_or(config.audit);
        config.size = self.size.or(config.size);
        config.start_us = self.start_us.unwrap_or(config.start_us);
        config.seed = self.seed.unwrap_or(config.seed);
        config.label_rate_hz = self.label_rate_hz.unwrap_or(config.label_rate_hz);
        config.reference_luminance = self.reference_luminance.or(config.reference_luminance);
        config.pose_step_us = self.pose_step()?.or(config.pose_step_us);
        config.dense = self.dense;
        config.frame_rate_hz = self.frame_rate_hz.or(config.frame_rate_hz);
        match self.exposure_us {
            Some(exposure_us) if self.frame_rate_hz.is_none() => {
                let remedy =
                    "left out, or given with `frame_rate_hz`: without it there are no frames to expose";
                return Err(ConfigError::new("exposure_us", format!("{exposure_us} us"), remedy).into());
            }
            Some(exposure_us) => config.exposure_us = exposure_us,
            None if self.frame_rate_hz.is_some() => {
                config.exposure_us = RunConfig::usual_exposure_us(self.frame_rate_hz);
            }
            None => {}
        }
        config.check()?;
        let Self { set, camera_motion, camera_speed, poses, materials, lights, .. } = self;
        Ok(Settled {
            config,
            recorded,
            sampling,
            for_all,
            set,
            camera_motion,
            camera_speed,
            poses,
            materials,
            lights,
        })
    }

    /// The method that is asked for, with what is asked of its keyframes.
    fn method(&self) -> Result<Option<Method>, ConfigError> {
        let Some(Method::Splat(warp)) = self.sampling.method else {
            let number = |value: Option<f64>| value.map(|value| value.to_string());
            let given = [
                ("keyframe_hz", number(self.keyframe_hz)),
                ("steps", number(self.steps.map(f64::from))),
                ("margin", number(self.margin.map(f64::from))),
            ];
            if let Some((name, value)) = given.into_iter().find_map(|(name, value)| Some((name, value?))) {
                let remedy =
                    "left out, or given with `method` splat or evis-paper: nothing else has keyframes";
                return Err(ConfigError::new(name, value, remedy));
            }
            return Ok(self.sampling.method);
        };
        Ok(Some(Method::Splat(Warp {
            keyframe_hz: self.keyframe_hz.or(warp.keyframe_hz),
            steps: self.steps.or(warp.steps),
            margin: self.margin.or(warp.margin),
            ..warp
        })))
    }

    /// Whether a host moves or changes anything.
    fn is_driven(&self) -> bool {
        !(self.poses.is_empty() && self.materials.is_empty() && self.lights.is_empty())
    }

    fn pose_step(&self) -> Result<Option<i64>, ConfigError> {
        match self.pose_step_us {
            Some(step_us) if !self.is_driven() => {
                let remedy = "left out, or given with `poses`, `materials` or `lights`: the names of what a host moves or changes";
                Err(ConfigError::new("pose_step_us", step_us, remedy))
            }
            None if self.is_driven() => Ok(Some(USUAL_POSE_STEP_US)),
            step_us => Ok(step_us),
        }
    }
}

fn is_evis_paper(method: Option<Method>) -> bool {
    matches!(method, Some(Method::Splat(Warp { variant: WarpVariant::EvisPaper, .. })))
}

fn set(sensor: &mut SensorConfig, assignments: &[String]) -> Result<(), ConfigError> {
    assignments.iter().try_for_each(|assignment| sensor.set(assignment))
}

/// A request over its settings file or the defaults; scene and device decide the rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Settled {
    config: RunConfig,
    /// Of the settings file.
    recorded: RecordedScene,
    sampling: SamplingRequest,
    /// Whether a sensor is given for all cameras, so that the scene's own do not count.
    for_all: bool,
    set: Vec<String>,
    camera_motion: Option<CameraMotion>,
    camera_speed: Option<f64>,
    poses: Vec<String>,
    materials: Vec<String>,
    lights: Vec<String>,
}

impl Settled {
    /// The settings so far.
    pub const fn config(&self) -> &RunConfig {
        &self.config
    }

    /// How `scene` was opened for the recording whose settings are taken, where it is that recording's.
    pub fn recorded(&self, scene: &str) -> RecordedScene {
        self.recorded.of(scene)
    }

    /// How the cameras of `scene` are to be moved: as asked for, else as in the recording whose settings are taken. The first
    /// camera and the size decide how a motion looks, and a settings file may hold both.
    ///
    /// # Errors
    /// A recording whose motion is none.
    pub fn camera_motion(&self, scene: &str) -> Result<CameraMotionSettings, ConfigError> {
        self.recorded(scene).camera_motion(self.asked_motion())
    }

    fn asked_motion(&self) -> CameraMotionSettings {
        CameraMotionSettings {
            motion: self.camera_motion.clone(),
            speed_px_per_s: self.camera_speed,
            camera: self.config.cameras.first().cloned(),
            size: self.config.size,
        }
    }

    /// `scene` as it is asked for: what a host moves and changes left to it, its cameras moved.
    ///
    /// # Errors
    /// Names that do not exist, a motion that cannot be had.
    pub fn moved(&self, scene: &Arc<Scene>) -> Result<Arc<Scene>, EngineError> {
        let mut scene = Arc::clone(scene);
        let names = HostNames { nodes: &self.poses, materials: &self.materials, lights: &self.lights };
        if !(self.poses.is_empty() && self.materials.is_empty() && self.lights.is_empty()) {
            let mut driven = Scene::clone(&scene);
            driven.leave_to_host(&names, self.config.start_us)?;
            scene = Arc::new(driven);
        }
        // One that was moved before stays so.
        let motion = match &scene.camera_motion {
            Some(_) => self.asked_motion(),
            None => self.camera_motion(&scene.name)?,
        };
        Ok(camera_motion::moved(&scene, &motion)?)
    }

    /// Takes the sensors that `scene` gives its cameras, where the request has none for all.
    ///
    /// # Errors
    /// Cameras that do not exist, sensors that cannot be used.
    pub fn take_sensors(&mut self, scene: &Scene) -> Result<(), EngineError> {
        for name in self.config.cameras.iter().chain(self.config.sensors.keys()) {
            scene.camera(name)?;
        }
        if !self.for_all {
            for (camera, mut sensor) in scene_sensors(scene, &self.config.cameras)? {
                set(&mut sensor, &self.set)?;
                self.config.sensors.entry(camera).or_insert(sensor);
            }
        }
        Ok(self.config.check()?)
    }

    /// The configuration for `scene` and device, and notes for the user: what a preset could not have.
    ///
    /// # Errors
    /// What contradicts itself, cameras that cannot be used.
    pub fn configure(
        mut self,
        gpu: Option<&Gpu>,
        scene: &Scene,
    ) -> Result<(RunConfig, Vec<String>), EngineError> {
        let notes = self.sampling.apply(gpu, scene, &mut self.config)?;
        Ok((self.config, notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(request: RunRequest) -> String {
        request.settle().unwrap_err().to_string()
    }

    #[test]
    fn what_does_not_fit_is_refused_with_name_value_and_remedy() {
        let nothing = RunRequest::default;
        let labels = |word: &str| vec![word.to_owned()];
        for (request, told) in [
            (
                RunRequest { exposure_us: Some(5000), ..nothing() },
                ["exposure_us is 5000 us", "`frame_rate_hz`"],
            ),
            (RunRequest { pose_step_us: Some(7), ..nothing() }, ["pose_step_us is 7", "`poses`"]),
            (RunRequest { keyframe_hz: Some(30.0), ..nothing() }, ["keyframe_hz is 30", "`method` splat"]),
            (
                RunRequest { labels: labels("dept"), ..nothing() },
                ["labels is 'dept'", "did you mean 'depth'"],
            ),
            (RunRequest { labels: labels("frame"), ..nothing() }, ["labels is 'frame'", "`frame_rate_hz`"]),
            (RunRequest { set: labels("noise.leek_hz=1"), ..nothing() }, ["leek_hz", "leak_hz"]),
            (RunRequest { set: labels("threshold_on=-1"), ..nothing() }, ["threshold_on is -1", "above 0"]),
            (RunRequest { audit: Some(2.0), ..nothing() }, ["audit is 2", "from 0 to 1"]),
        ] {
            let error = refused(request);
            assert!(told.iter().all(|word| error.contains(word)), "{error}");
        }
        assert!(nothing().settle().is_ok(), "canary");
    }

    #[test]
    fn what_is_given_stands_over_the_defaults() {
        let request = RunRequest {
            set: vec!["noise.shot_hz=2".into()],
            frame_rate_hz: Some(30.0),
            poses: vec!["ball".into()],
            ..RunRequest::default()
        };
        let config = request.settle().unwrap().config().clone();
        assert_eq!((config.sensor.noise.shot_hz, config.exposure_us), (2.0, 10_000));
        assert_eq!((config.pose_step_us, config.label_rate_hz), (Some(USUAL_POSE_STEP_US), 50.0));
        assert_eq!(RunRequest::default().settle().unwrap().config(), &RunConfig::default());
    }

    #[test]
    fn the_published_method_has_the_published_sensor_unless_one_is_given() {
        let method = Some(Method::Splat(Warp::of(WarpVariant::EvisPaper)));
        let sampling = SamplingRequest { method, ..SamplingRequest::default() };
        let paper = RunRequest { sampling, ..RunRequest::default() };
        let config = paper.clone().settle().unwrap().config().clone();
        assert_eq!((config.sensor.trigger, config.sensor.log_eps), (TriggerRule::Latch, EVIS_PAPER_LOG_EPS));
        let own = RunRequest { sensor: Some(SensorConfig::default()), ..paper };
        assert_eq!(own.settle().unwrap().config().sensor, SensorConfig::default());
    }

    #[test]
    fn keyframes_are_of_the_method_that_has_them() {
        let method = Some(Method::Splat(Warp::of(WarpVariant::Splat)));
        let sampling = SamplingRequest { method, ..SamplingRequest::default() };
        let request =
            RunRequest { sampling, keyframe_hz: Some(60.0), steps: Some(4), ..RunRequest::default() };
        let asked = request.method().unwrap().unwrap();
        assert_eq!(asked.keyframes(), Some((60.0, 4)));
    }
}
