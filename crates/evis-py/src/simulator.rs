//! The simulator and its stream.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::task::Poll;

use evis_core::CameraInfo;
use evis_render::settings::RecordedScene;
use evis_render::{
    DeviceSummary, EnvironmentLens, EnvironmentSensor, Gpu, PacketStream, Quality, RunConfig, RunRequest,
    implausible,
};
use evis_scene::{HostJump, HostPose, HostStep, Lens, LightChange, MaterialChange, VisibleSteps};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::emulator;
use crate::engine;
use crate::errors::Failure;
use crate::gil::{Detach, ProcessBound, SIGNAL_PERIOD, lock, lock_unpoisoned};
use crate::packet::{self, Packet};
use crate::request::Request;
use crate::scene::Scene;

/// The engine on one scene.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Simulator {
    /// `None` while a stream has it.
    engine: ProcessBound<Mutex<Option<evis_render::Simulator>>>,
    cameras: Vec<CameraInfo>,
    /// By environment, as they are now.
    cameras_of: Mutex<Vec<Vec<CameraInfo>>>,
    environments: usize,
    config: RunConfig,
    notes: Vec<String>,
    warnings: Vec<String>,
    /// The scene that is rendered.
    moved: Arc<evis_scene::Scene>,
    device: evis_render::DeviceSummary,
    now_us: AtomicI64,
    /// The engine's own: ends a step.
    stop: Arc<AtomicBool>,
}

/// Packets in order, rendered ahead.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Stream {
    engine: ProcessBound<Mutex<Option<PacketStream>>>,
    sizes: Vec<(u32, u32)>,
}

fn cameras_of(simulator: &evis_render::Simulator) -> Vec<Vec<CameraInfo>> {
    (0..simulator.environments()).map(|environment| simulator.cameras_of(environment)).collect()
}

fn sizes(cameras: &[CameraInfo]) -> Vec<(u32, u32)> {
    cameras.iter().map(|camera| (camera.width, camera.height)).collect()
}

/// What is said where a scene plays another animation than in the recording whose settings are taken.
fn other_animation(recorded: &RecordedScene, scene: &evis_scene::Scene) -> Option<String> {
    let (recorded, playing) = (recorded.animation.as_deref()?, scene.animation.as_deref()?);
    (recorded != playing).then(|| {
        format!(
            "the recording whose settings are taken plays animation '{recorded}', and the scene '{playing}'; \
             Scene.load(…, animation='{recorded}') plays the same"
        )
    })
}

#[pymethods]
impl Simulator {
    #[new]
    fn new(py: Python<'_>, scene: &Scene, request: Request, device: Option<String>) -> PyResult<Self> {
        let mut settled = RunRequest::try_from(request)?.settle().map_err(Failure::from)?;
        let own = scene.shared();
        let scene = py.detach_engine(|| settled.moved(&own))?;
        settled.take_sensors(&scene).map_err(Failure::from)?;
        let moved = Arc::clone(&scene);
        let other = other_animation(&settled.recorded(&scene.name), &scene);
        let stopped = AtomicBool::new(false);
        let prepare = || {
            let gpu = Gpu::open_any(device.as_deref())?;
            let (config, notes) = settled.configure(gpu.as_ref(), &scene)?;
            let duration_s = scene.duration_s.unwrap_or(1.0);
            let left_us = ((duration_s * 1e6) as i64 - config.start_us).max(0);
            let warnings = implausible(&scene, &config, left_us).into_iter().chain(other).collect();
            let simulator = evis_render::Simulator::new(gpu.as_ref(), scene, config)?;
            Ok::<_, Failure>(Self {
                cameras: simulator.cameras().to_vec(),
                cameras_of: Mutex::new(cameras_of(&simulator)),
                environments: simulator.environments(),
                config: simulator.config().clone(),
                notes,
                warnings,
                moved,
                device: gpu.map_or_else(DeviceSummary::none, |gpu| gpu.summary().clone()),
                now_us: AtomicI64::new(simulator.now_us()),
                stop: Arc::clone(simulator.stop()),
                engine: ProcessBound::new(Mutex::new(Some(simulator))),
            })
        };
        py.detach_interruptible(&stopped, prepare)
    }

    /// Cameras as dictionaries: name, width, height, fx, fy, cx, cy.
    #[getter]
    fn cameras<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        self.cameras.iter().map(|camera| engine::camera_dict(py, camera)).collect()
    }

    /// The same with the lenses that environment `environment` has now.
    fn cameras_of<'py>(&self, py: Python<'py>, environment: usize) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let known = lock(&self.cameras_of).get(environment).cloned().unwrap_or_default();
        known.iter().map(|camera| engine::camera_dict(py, camera)).collect()
    }

    /// The sensor of each camera, in their order, as JSON.
    #[getter]
    fn sensors(&self) -> PyResult<Vec<String>> {
        let of = |camera: &CameraInfo| emulator::to_json(self.config.sensor_of(&camera.name));
        Ok(self.cameras.iter().map(of).collect::<Result<_, _>>()?)
    }

    /// The scene that is rendered: the one given, or one with its cameras moved.
    #[getter]
    fn scene(&self) -> Scene {
        Scene::of(Arc::clone(&self.moved))
    }

    #[getter]
    fn environments(&self) -> usize {
        self.environments
    }

    #[getter]
    fn device<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        engine::device_dict(py, &self.device)
    }

    /// The settings in force as TOML, with `reference_luminance` filled in; what event files store.
    #[getter]
    fn config_toml(&self) -> PyResult<String> {
        engine::config_toml(&self.moved, self.environments, &self.config).map_err(Into::into)
    }

    /// What the preset could not have on this scene and device.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// What was hardly meant: see [`implausible`].
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    /// The preset in force, if one is.
    #[getter]
    fn quality(&self) -> Option<&'static str> {
        self.config.quality.map(Quality::name)
    }

    #[getter]
    const fn seed(&self) -> u64 {
        self.config.seed
    }

    /// Scene time of the stream's start.
    #[getter]
    const fn start_us(&self) -> i64 {
        self.config.start_us
    }

    /// The method's name.
    #[getter]
    fn method(&self) -> &'static str {
        self.config.method.name()
    }

    #[getter]
    fn reference_luminance(&self) -> Option<f32> {
        self.config.reference_luminance
    }

    /// Names of the labels in force, in file order.
    #[getter]
    fn labels(&self) -> Vec<&'static str> {
        self.config.carried().iter().map(|kind| kind.name()).collect()
    }

    #[getter]
    fn now_us(&self) -> i64 {
        self.now_us.load(Ordering::Acquire)
    }

    /// Runs to `until_us` and returns everything from now on. `poses`: environment, index of the node, times, and per time
    /// position (3), rotation (x, y, z, w), velocity and angular velocity (3, or none). `visible`: environment, index of the node, and whether it
    /// is seen up to each time. `materials` and `lights`: environment, index, new factors.
    #[pyo3(signature = (until_us, poses, visible, materials, lights))]
    fn step(
        &self,
        py: Python<'_>,
        until_us: i64,
        poses: Option<Vec<NodePoses>>,
        visible: Vec<VisibleSteps>,
        materials: Vec<(usize, usize, Factors)>,
        lights: Vec<(usize, usize, LightValues)>,
    ) -> PyResult<Packet> {
        let driven = poses.is_some() || !visible.is_empty() || !materials.is_empty() || !lights.is_empty();
        let poses: Vec<_> = poses.into_iter().flatten().map(host_poses).collect();
        let materials: Vec<_> = materials.into_iter().map(host_change).collect();
        let lights: Vec<_> = lights.into_iter().map(light_change).collect();
        let (packet, host) = py.detach_interruptible(&self.stop, || {
            let mut engine = lock_unpoisoned(&self.engine)?;
            let simulator = engine.as_mut().ok_or_else(engine_in_stream)?;
            let packet = if driven {
                let step =
                    HostStep { poses: &poses, visible: &visible, materials: &materials, lights: &lights };
                simulator.step_with(until_us, &step)?
            } else {
                simulator.step(until_us)?
            };
            self.now_us.store(simulator.now_us(), Ordering::Release);
            Ok::<_, Failure>((packet, simulator.take_host_span()))
        })?;
        packet::convert(py, packet, &sizes(&self.cameras), host)
    }

    /// Resets environments. `poses`: environment, index of the node, position (3) and rotation (x, y, z, w). `visible`, `materials`
    /// and `lights`: as of a step, without times. `sensors`: environment, index of the camera, sensor as JSON. `lenses`:
    /// environment, index of the camera, field of view in radians or fx, fy, cx, cy.
    #[pyo3(signature = (environments, seeds, sensors, lenses, poses, visible, materials, lights))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn reset(
        &self,
        py: Python<'_>,
        environments: Vec<usize>,
        seeds: Vec<u64>,
        sensors: Vec<(usize, usize, String)>,
        lenses: Vec<(usize, usize, Vec<f64>)>,
        poses: Vec<(usize, usize, [f64; 7])>,
        visible: Vec<(usize, usize, bool)>,
        materials: Vec<(usize, usize, Factors)>,
        lights: Vec<(usize, usize, LightValues)>,
    ) -> PyResult<()> {
        let pose = |(environment, node, [x, y, z, qx, qy, qz, qw]): (usize, usize, [f64; 7])| {
            (environment, node, HostPose::new(0, [x, y, z], [qx, qy, qz, qw], None))
        };
        let poses: Vec<_> = poses.into_iter().map(pose).collect();
        let materials: Vec<_> = materials.into_iter().map(host_change).collect();
        let lights: Vec<_> = lights.into_iter().map(light_change).collect();
        let lenses: Vec<_> = lenses.into_iter().map(environment_lens).collect::<Result<_, _>>()?;
        let sensor = |(environment, camera, json): (usize, usize, String)| {
            Ok::<_, Failure>(EnvironmentSensor { environment, camera, sensor: emulator::from_json(&json)? })
        };
        let sensors: Vec<_> = sensors.into_iter().map(sensor).collect::<Result<_, _>>()?;
        py.detach_engine(|| {
            let mut engine = lock_unpoisoned(&self.engine)?;
            let simulator = engine.as_mut().ok_or_else(engine_in_stream)?;
            let jump = HostJump { poses: &poses, visible: &visible, materials: &materials, lights: &lights };
            simulator.reset_to(&environments, &seeds, &sensors, &lenses, &jump)?;
            if !lenses.is_empty() {
                *lock(&self.cameras_of) = cameras_of(simulator);
            }
            Ok::<_, Failure>(())
        })
    }

    /// Hands the engine to a stream that renders ahead.
    fn stream(&self, py: Python<'_>, duration_us: i64, packet_us: i64) -> PyResult<Stream> {
        let stream = py.detach_engine(|| {
            for (what, value) in [("duration", duration_us), ("packet_us", packet_us)] {
                if value <= 0 {
                    return Err(evis_core::ConfigError::new(what, value, "above 0 microseconds").into());
                }
            }
            let simulator = lock_unpoisoned(&self.engine)?.take().ok_or_else(engine_in_stream)?;
            Ok::<_, Failure>(simulator.stream(duration_us, packet_us)?)
        })?;
        Ok(Stream { engine: ProcessBound::new(Mutex::new(Some(stream))), sizes: sizes(&self.cameras) })
    }
}

/// Environment, index of the node, times, positions and rotations, velocities, angular velocities.
type NodePoses = (usize, usize, Vec<i64>, Vec<[f64; 7]>, Option<Vec<[f64; 3]>>, Option<Vec<[f64; 3]>>);

fn host_poses(
    (environment, node, times, values, velocities, turns): NodePoses,
) -> (usize, usize, Vec<HostPose>) {
    let of = |list: &Option<Vec<[f64; 3]>>, i: usize| list.as_ref().and_then(|v| v.get(i)).copied();
    let pose = |(i, (t_us, [x, y, z, qx, qy, qz, qw])): (usize, (i64, [f64; 7]))| {
        HostPose::new(t_us, [x, y, z], [qx, qy, qz, qw], of(&velocities, i)).turning(of(&turns, i))
    };
    (environment, node, times.into_iter().zip(values).enumerate().map(pose).collect())
}

/// Base colour, metallic, emitted radiance, roughness; what is none stays.
type Factors = (Option<[f32; 3]>, Option<f32>, Option<[f32; 3]>, Option<f32>);

fn host_change((environment, material, factors): (usize, usize, Factors)) -> (usize, usize, MaterialChange) {
    let (base_color, metallic, emissive, roughness) = factors;
    (environment, material, MaterialChange { base_color, metallic, emissive, roughness })
}

/// Colour, intensity, on; what is none stays.
type LightValues = (Option<[f32; 3]>, Option<f32>, Option<bool>);

fn light_change((environment, light, values): (usize, usize, LightValues)) -> (usize, usize, LightChange) {
    let (color, intensity, on) = values;
    (environment, light, LightChange { color, intensity, on })
}

fn environment_lens(
    (environment, camera, values): (usize, usize, Vec<f64>),
) -> Result<EnvironmentLens, Failure> {
    let lens = match values[..] {
        [fov_y] => Lens::FieldOfView { fov_y },
        [height, far] => Lens::Orthographic { height, far },
        [fx, fy, cx, cy] => Lens::Intrinsics { fx, fy, cx, cy },
        _ => return Err(Failure::Engine(format!("a lens has {} numbers; 1, 2 or 4", values.len()))),
    };
    Ok(EnvironmentLens { environment, camera, lens })
}

fn engine_in_stream() -> Failure {
    Failure::Engine("a stream has this simulator's engine; close the stream, or read it to its end".into())
}

#[pymethods]
impl Stream {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Packet>> {
        loop {
            let waited = py.detach_engine(|| match lock(&self.engine).as_mut() {
                None => Ok(Poll::Ready(None)),
                Some(stream) => match stream.poll_next(SIGNAL_PERIOD) {
                    Poll::Pending => Ok(Poll::Pending),
                    Poll::Ready(packet) => packet.transpose().map(Poll::Ready),
                },
            });
            match waited {
                Ok(Poll::Ready(Some(packet))) => {
                    return packet::convert(py, packet, &self.sizes, None).map(Some);
                }
                Ok(Poll::Ready(None)) => {
                    self.close(py)?;
                    return Ok(None);
                }
                Ok(Poll::Pending) => {}
                // Whatever stopped us, Ctrl-C included, also stops the engine.
                Err(error) => {
                    self.close(py)?;
                    return Err(error);
                }
            }
        }
    }

    /// Stops the engine after the interval in work. Closing twice does nothing.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        py.detach_engine(|| {
            drop(lock(&self.engine).take());
            Ok::<_, Failure>(())
        })
    }
}
