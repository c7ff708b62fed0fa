//! The simulator: a scene, its cameras and a device; yields packets.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::task::Poll;
use std::thread::JoinHandle;
use std::time::Duration;

use evis_core::event::MOST_T_US;
use evis_core::{CameraInfo, ConfigError, SensorConfig};
use evis_decoupled::Cost;
use evis_scene::{Camera, HostJump, HostPose, HostPoses, HostStep, Lens, PixelLens, Scene};

use crate::config::{Method, RunConfig, checked};
use crate::engine::Engine;
use crate::engine::decoupled::Decoupled;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::output::bodies::HostSpan;
use crate::output::dense::HostArrays;
use crate::output::packet::Packet;
use crate::world::view::{self, View};

/// Packets that a stream renders ahead of its reader.
const AHEAD: usize = 4;

/// How long the poses of a host are kept after their time.
const KEPT_POSES_US: i64 = 1_000_000;

/// Renders a scene and streams its events.
pub struct Simulator {
    scene: Arc<Scene>,
    cameras: Vec<CameraInfo>,
    /// Per view.
    lenses: Vec<PixelLens>,
    environments: usize,
    config: RunConfig,
    source: Source,
    /// Where packets carry arrays in the place of events: makes those that no device makes.
    dense: Option<HostArrays>,
    host_poses: Option<Arc<HostPoses>>,
    /// What the host said of the packet that was made last, or is being made.
    said: Option<HostSpan>,
}

/// The sensor that a camera of an environment has from a reset on.
#[derive(Clone, Debug)]
pub struct EnvironmentSensor {
    /// Which environment.
    pub environment: usize,
    /// Index into [`Simulator::cameras`].
    pub camera: usize,
    /// Its thresholds come before those that the scene gives the camera.
    pub sensor: SensorConfig,
}

/// The lens that a camera of an environment has from a reset on.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentLens {
    /// Which environment.
    pub environment: usize,
    /// Index into [`Simulator::cameras`].
    pub camera: usize,
    /// Intrinsics belong to the camera's own size, as those of the scene do.
    pub lens: Lens,
}

/// Where packets come from.
enum Source {
    /// Instants that a device renders.
    Sampled(Box<Engine>),
    /// Decoupled sampling on the CPU.
    Decoupled(Box<Decoupled>),
}

impl Source {
    fn now_us(&self) -> i64 {
        match self {
            Self::Sampled(engine) => engine.now_us(),
            Self::Decoupled(views) => views.now_us(),
        }
    }

    fn cost(&self) -> Option<&Cost> {
        match self {
            Self::Sampled(_) => None,
            Self::Decoupled(views) => Some(views.cost()),
        }
    }

    fn stop(&self) -> &Arc<AtomicBool> {
        match self {
            Self::Sampled(engine) => engine.stop(),
            Self::Decoupled(views) => views.stop(),
        }
    }

    /// Delivers up to `until_us`, with dense arrays in the place of events where there are any.
    fn deliver(
        &mut self,
        until_us: i64,
        horizon_us: i64,
        dense: Option<&mut HostArrays>,
    ) -> Result<Packet, EngineError> {
        let mut packet = match self {
            Self::Sampled(engine) => engine.deliver(until_us, horizon_us),
            Self::Decoupled(views) => views.deliver(until_us, horizon_us),
        }?;
        dense.map_or(Ok(()), |dense| dense.replace_events(&mut packet))?;
        Ok(packet)
    }

    /// See [`Engine::check_reset`].
    fn check_reset(&self) -> Result<(), ConfigError> {
        match self {
            Self::Sampled(engine) => engine.check_reset(),
            Self::Decoupled(views) => views.check_reset(),
        }
    }

    /// See [`Engine::check_sensor`].
    fn check_sensor(&self, view: usize, sensor: &SensorConfig) -> Result<(), ConfigError> {
        match self {
            Self::Sampled(engine) => engine.check_sensor(view, sensor),
            Self::Decoupled(decoupled) => decoupled.check_sensor(view, sensor),
        }
    }

    /// See [`Engine::reset`].
    fn reset(
        &mut self,
        environments: &[usize],
        seeds: &[u64],
        sensors: &[(usize, SensorConfig)],
        lenses: &[(usize, PixelLens)],
    ) -> Result<(), EngineError> {
        match self {
            Self::Sampled(engine) => engine.reset(environments, seeds, sensors, lenses),
            Self::Decoupled(views) => views.reset(environments, seeds, sensors, lenses),
        }
    }

    /// See [`Engine::needed_us`].
    fn needed_us(&self, until_us: i64) -> i64 {
        match self {
            Self::Sampled(engine) => engine.needed_us(until_us),
            Self::Decoupled(views) => views.needed_us(until_us),
        }
    }
}

impl Simulator {
    /// Prepares `scene` on `gpu`; [`Method::Decoupled`] needs one for labels and frames only.
    ///
    /// # Errors
    /// A setting that cannot be used, a camera that does not exist, rigid bodies that were not simulated, or a device that
    /// is too small or missing.
    pub fn new<'a>(
        gpu: impl Into<Option<&'a Gpu>>,
        scene: Arc<Scene>,
        mut config: RunConfig,
    ) -> Result<Self, EngineError> {
        config.check()?;
        scene.check_simulated()?;
        let gpu = gpu.into();
        gpu.map_or(Ok(()), Gpu::check_not_lost)?;
        let (views, cameras) = view::views(&scene, &config)?;
        view::check_lenses(&views, &cameras, &config)?;
        // Each camera's first view has its sensor.
        config.set_sensors(cameras.iter().map(|c| c.name.as_str()).zip(views.iter().map(|v| &v.sensor)));
        let environments = scene.variants.len().max(1);
        let host_poses = scene.host_poses.clone();
        let whole = Arc::clone(&scene);
        let lenses = views.iter().map(|view| view.own_lens).collect();
        let dense =
            config.dense.map(|output| HostArrays::new(output, views.iter().map(View::size).collect()));
        if host_poses.is_some() {
            check_driven(&config, views.iter().map(|view| &view.sensor))?;
        }
        let source = match (config.method, gpu) {
            (Method::Decoupled, _) => {
                Source::Decoupled(Box::new(Decoupled::new(gpu, scene, views, &cameras, &mut config)?))
            }
            (_, Some(gpu)) => {
                Source::Sampled(Box::new(gpu.guarded(|| Engine::new(gpu, scene, views, &mut config))?))
            }
            (_, None) => return Err(EngineError::NoDevice),
        };
        Ok(Self {
            scene: whole,
            cameras,
            lenses,
            environments,
            config,
            source,
            dense,
            host_poses,
            said: None,
        })
    }

    /// The rendered cameras, in view order, as the first environment has them.
    pub fn cameras(&self) -> &[CameraInfo] {
        &self.cameras
    }

    /// The rendered cameras, with the lenses that `environment` has now; none where there is no such environment.
    pub fn cameras_of(&self, environment: usize) -> Vec<CameraInfo> {
        let count = self.cameras.len();
        let own = self.lenses.iter().skip(environment.saturating_mul(count)).take(count);
        own.zip(&self.cameras)
            .map(|(lens, camera)| view::camera_info(&self.scene, &camera.name, lens))
            .collect()
    }

    /// Environments rendered side by side.
    pub fn environments(&self) -> usize {
        self.environments
    }

    /// The settings in force, `reference_luminance` filled in.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Stream time up to which packets were delivered, in microseconds.
    pub fn now_us(&self) -> i64 {
        self.source.now_us()
    }

    /// What view `view` shows at stream time `t_us`, as its pixels integrate it: mean linear luminance over the samples,
    /// row-major from the top. The stream is left as it is.
    ///
    /// # Errors
    /// A view that does not exist, or a device that fails.
    pub fn luminance(&mut self, view: usize, t_us: i64) -> Result<Vec<f64>, EngineError> {
        match &mut self.source {
            Source::Sampled(engine) => engine.luminance(view, t_us),
            Source::Decoupled(views) => views.luminance(view, t_us, &self.config),
        }
    }

    /// See [`Engine::restart`].
    pub(crate) fn restart(
        &mut self,
        start_us: i64,
        only: Vec<Vec<bool>>,
        every_instant: bool,
    ) -> Result<(), EngineError> {
        match &mut self.source {
            Source::Sampled(engine) => engine.restart(start_us, only, every_instant),
            Source::Decoupled(views) => views.restart(start_us, &only),
        }
    }

    /// Set from another thread, it ends a step after the submission in work with [`EngineError::Stopped`].
    /// Nothing is lost: cleared, the next step delivers everything from [`Simulator::now_us`] on.
    pub fn stop(&self) -> &Arc<AtomicBool> {
        self.source.stop()
    }

    /// Whether a stream can go on to `t_us`.
    fn check_time(&self, what: &str, t_us: i64) -> Result<(), ConfigError> {
        let now_us = self.now_us();
        if t_us <= now_us {
            let remedy = format!("after the stream's present, {now_us} microseconds");
            return Err(ConfigError::new(what, t_us, remedy));
        }
        if t_us > MOST_T_US {
            return Err(ConfigError::new(what, t_us, format!("at most {MOST_T_US} microseconds")));
        }
        Ok(())
    }

    /// Runs to `until_us` (stream time) and yields everything in `[now, until_us)`.
    ///
    /// # Errors
    /// `until_us` must lie after [`Simulator::now_us`] and within [`MOST_T_US`]; the device may fail.
    pub fn step(&mut self, until_us: i64) -> Result<Packet, EngineError> {
        self.check_time("until_us", until_us)?;
        if self.host_poses.is_some() {
            return self.step_with(until_us, &HostStep::default());
        }
        self.source.deliver(until_us, until_us, self.dense.as_mut())
    }

    /// Steps on this thread, `packet_us` at a time, and gives each packet to `on_packet`, until `until_us` or until it breaks.
    /// Returns the stream time that was reached.
    ///
    /// # Errors
    /// As [`Simulator::step`]; a `packet_us` that is not above 0.
    pub fn run_until(
        &mut self,
        until_us: i64,
        packet_us: i64,
        mut on_packet: impl FnMut(&Packet) -> ControlFlow<()>,
    ) -> Result<i64, EngineError> {
        if packet_us <= 0 {
            return Err(ConfigError::new("packet_us", packet_us, "above 0 microseconds").into());
        }
        loop {
            let packet = self.step(self.now_us().saturating_add(packet_us).min(until_us))?;
            if on_packet(&packet).is_break() || packet.end_us >= until_us {
                return Ok(packet.end_us);
            }
        }
    }

    /// As [`Simulator::step`], where a host moves nodes ([`Scene::drive`]): `poses` tells where they are during the step, by
    /// environment and index of the node in [`HostPoses::names`], in stream time, the last one at `until_us`. A node without
    /// any rests. All events before `until_us` are delivered.
    ///
    /// # Errors
    /// As [`Simulator::step`]; poses that cannot be used, and a step that does not end where samples may.
    pub fn step_with_poses(
        &mut self,
        until_us: i64,
        poses: &[(usize, usize, Vec<HostPose>)],
    ) -> Result<Packet, EngineError> {
        self.step_with(until_us, &HostStep { poses, ..HostStep::default() })
    }

    /// As [`Simulator::step_with_poses`], where a host also shows and hides nodes or changes materials and lights
    /// ([`Scene::leave_to_host`]): all at once, just after the present, so that light jumps there; in the first step things were
    /// never otherwise. What is seen at the present itself, labels included, is as it was.
    ///
    /// # Errors
    /// As [`Simulator::step_with_poses`]; nodes that cannot be hidden, factors that a material does not have or that are out
    /// of range. Then nothing has changed.
    pub fn step_with(&mut self, until_us: i64, step: &HostStep<'_>) -> Result<Packet, EngineError> {
        let Some(host) = &self.host_poses else { return Err(not_driven().into()) };
        self.check_time("until_us", until_us)?;
        let needed_us = self.source.needed_us(until_us);
        if needed_us != until_us {
            let remedy = format!(
                "a multiple of pose_step_us ({} us): samples for it are taken at {needed_us} us",
                self.config.pose_step_us.unwrap_or_default()
            );
            return Err(ConfigError::new("until_us", until_us, remedy).into());
        }
        let start_us = self.config.start_us;
        let now_us = start_us + self.now_us();
        // What was said of a step that was stopped still holds.
        if self.said.as_ref().and_then(HostSpan::until_us).is_none_or(|until_us| until_us <= now_us) {
            self.said = Some(HostSpan::new(host));
        }
        // A step that was stopped goes on.
        if !step.is_empty() || host.known_until_us() < start_us + until_us {
            let poses: Vec<_> = step
                .poses
                .iter()
                .map(|(environment, node, poses)| {
                    let poses = poses.iter().map(|p| HostPose { t_us: start_us + p.t_us, ..*p });
                    (*environment, *node, poses.collect())
                })
                .collect();
            let visible: Vec<_> = step
                .visible
                .iter()
                .map(|(environment, node, values)| {
                    let values = values.iter().map(|(t_us, seen)| (start_us + t_us, *seen));
                    (*environment, *node, values.collect())
                })
                .collect();
            let shifted = HostStep { poses: &poses, visible: &visible, ..*step };
            host.advance(&shifted, start_us + until_us)?;
            if let Some(said) = &mut self.said {
                said.steps.push((start_us + until_us, poses));
            }
        }
        let packet = self.source.deliver(until_us, until_us, self.dense.as_mut())?;
        // Flow looks back by the time between two labels.
        let label_us = (1e6 / self.config.label_rate_hz).ceil() as i64;
        host.forget_before(start_us + until_us - 2 * label_us - KEPT_POSES_US);
        Ok(packet)
    }

    /// What the host said of the last packet, once; `None` where no host moves anything.
    pub fn take_host_span(&mut self) -> Option<HostSpan> {
        self.said.take()
    }

    /// Resets environments and their pixel memory at the stream's present time: what their pixels see now is their
    /// reference, and no event of theirs from before is still to come. Events of other environments do not change by a byte.
    /// `seeds`: per environment, of what is random in it from now on, as in a simulator of that seed; empty to keep it.
    /// `poses`: where a host's nodes jump to, without any event: environment, node, and a pose, whose time is ignored.
    ///
    /// # Errors
    /// Environments that do not exist or are named twice, poses that cannot be used, methods with keyframes, sensors with
    /// an exposure, and a present that is not the end of a step to where samples are. Then nothing has changed.
    pub fn reset(
        &mut self,
        environments: &[usize],
        seeds: &[u64],
        poses: &[(usize, usize, HostPose)],
    ) -> Result<(), EngineError> {
        self.reset_to(environments, seeds, &[], &[], &HostJump { poses, ..HostJump::default() })
    }

    /// As [`Simulator::reset`], where nodes, materials and lights also are otherwise from now on, without any event, and cameras of
    /// these environments have other sensors and lenses. What is frozen in a sensor keeps its draw where there is no other seed: a pixel whose
    /// threshold lies one sigma above the mean lies one new sigma above the new mean.
    ///
    /// # Errors
    /// As [`Simulator::reset`] and [`Simulator::step_with`]; a sensor that cannot be, or that has other stages than the camera's; a
    /// lens that cannot be, and another one for a camera whose lens is distorted. Then nothing has changed.
    pub fn reset_to(
        &mut self,
        environments: &[usize],
        seeds: &[u64],
        sensors: &[EnvironmentSensor],
        lenses: &[EnvironmentLens],
        jump: &HostJump<'_>,
    ) -> Result<(), EngineError> {
        for (place, environment) in environments.iter().enumerate() {
            if *environment >= self.environments {
                let remedy = format!("between 0 and {}", self.environments - 1);
                return Err(ConfigError::new("env_ids", environment, remedy).into());
            }
            if environments[..place].contains(environment) {
                return Err(ConfigError::new("env_ids", environment, "named once").into());
            }
        }
        if !(seeds.is_empty() || seeds.len() == environments.len()) {
            let remedy = format!("one per environment, {} of them", environments.len());
            return Err(ConfigError::new("seed", format!("{} seeds", seeds.len()), remedy).into());
        }
        self.source.check_reset()?;
        let now_us = self.now_us();
        if let Some(dense) = self.config.dense.filter(|dense| now_us % dense.window_us != 0) {
            let remedy =
                format!("at a multiple of dense_window_us ({} us), where windows end", dense.window_us);
            return Err(ConfigError::new("reset", format!("at {now_us} us"), remedy).into());
        }
        if let Some(environment) = jump.environments().find(|e| !environments.contains(e)) {
            let remedy = "only for environments that are reset; others change with step";
            let what = if jump.poses.is_empty() { "visible, materials or lights" } else { "poses" };
            return Err(ConfigError::new(what, format!("for environment {environment}"), remedy).into());
        }
        let mut own = Vec::with_capacity(sensors.len());
        for EnvironmentSensor { environment, camera, sensor } in sensors {
            if !environments.contains(environment) {
                let remedy = "only for environments that are reset";
                let what = format!("for environment {environment}");
                return Err(ConfigError::new("sensor", what, remedy).into());
            }
            let Some(info) = self.cameras.get(*camera) else {
                let remedy = format!("for one of the {} cameras, counted from 0", self.cameras.len());
                return Err(ConfigError::new("sensor", format!("for camera {camera}"), remedy).into());
            };
            let sensor = checked(&info.name, sensor.clone())?;
            // Views lie environment by environment.
            let view = environment * self.cameras.len() + camera;
            self.source.check_sensor(view, &sensor)?;
            own.push((view, sensor));
        }
        let mut seen = Vec::with_capacity(lenses.len());
        for lens in lenses {
            seen.push(self.pixel_lens(environments, lens)?);
        }
        if self.host_poses.is_some() {
            check_driven(&self.config, own.iter().map(|(_, sensor)| sensor))?;
        }
        match &self.host_poses {
            Some(host) => host.jump(jump)?,
            None if jump.environments().next().is_none() => {}
            None => return Err(not_driven().into()),
        }
        if let Some(host) = &self.host_poses {
            for (lens, _) in lenses.iter().zip(&seen) {
                host.set_lens(
                    lens.environment,
                    self.scene.camera(&self.cameras[lens.camera].name)?,
                    lens.lens,
                )?;
            }
        }
        for (view, lens) in &seen {
            self.lenses[*view] = *lens;
        }
        self.source.reset(environments, seeds, &own, &seen)
    }

    /// The view that `own` is for, and its lens in pixels.
    fn pixel_lens(
        &self,
        environments: &[usize],
        own: &EnvironmentLens,
    ) -> Result<(usize, PixelLens), EngineError> {
        let EnvironmentLens { environment, camera, lens } = *own;
        if !environments.contains(&environment) {
            let remedy = "only for environments that are reset";
            return Err(ConfigError::new("lenses", format!("for environment {environment}"), remedy).into());
        }
        let Some(info) = self.cameras.get(camera) else {
            let remedy = format!("for one of the {} cameras, counted from 0", self.cameras.len());
            return Err(ConfigError::new("lenses", format!("for camera {camera}"), remedy).into());
        };
        let name = &info.name;
        if info.distortion.is_some() {
            let remedy = "for cameras without distortion: of others, samples are placed when the simulator is made; \
                          give environments their own lenses in the scene";
            return Err(ConfigError::new("lenses", format!("for '{name}'"), remedy).into());
        }
        lens.check()?;
        let of_scene = &self.scene.cameras[self.scene.camera(name)?];
        let own = PixelLens::new(&Camera { lens, ..of_scene.clone() }, self.config.size);
        own.check(name)?;
        Ok((environment * self.cameras.len() + camera, own))
    }

    /// What a host moves, where it moves anything.
    pub const fn host_poses(&self) -> Option<&Arc<HostPoses>> {
        self.host_poses.as_ref()
    }

    /// Streams `duration_us` from now in packets of `packet_us`, rendering ahead on a thread of its own
    /// that ends with the stream. The last packet is shorter where the duration is no multiple.
    ///
    /// # Errors
    /// Both times must be above 0, and the end within [`MOST_T_US`].
    pub fn stream(self, duration_us: i64, packet_us: i64) -> Result<PacketStream, EngineError> {
        if self.host_poses.is_some() {
            let remedy = "a simulator whose poses come from a host goes on step by step: use step";
            return Err(ConfigError::new("stream", "poses from a host", remedy).into());
        }
        for (what, value) in [("duration_us", duration_us), ("packet_us", packet_us)] {
            if value <= 0 {
                return Err(ConfigError::new(what, value, "above 0 microseconds").into());
            }
        }
        let end = self.now_us().saturating_add(duration_us);
        self.check_time("end of the stream", end)?;
        let (send, receive) = sync_channel(AHEAD);
        let (mut source, mut dense) = (self.source, self.dense);
        let stop = source.stop().clone();
        let stopped = stop.clone();
        let cost = source.cost().cloned();
        let thread = std::thread::Builder::new()
            .name("evis-stream".into())
            .spawn(move || {
                let mut now = source.now_us();
                while now < end && !stopped.load(Ordering::Relaxed) {
                    let until = now.saturating_add(packet_us).min(end);
                    let packet = source.deliver(until, end, dense.as_mut());
                    let failed = packet.is_err();
                    if send.send(packet).is_err() || failed {
                        return;
                    }
                    now = until;
                }
            })
            .map_err(|e| EngineError::Device(format!("cannot start the stream's thread: {e}")))?;
        Ok(PacketStream { receive: Some(receive), stop, cost, thread: Some(thread) })
    }
}

fn not_driven() -> ConfigError {
    let remedy = "not given: name the nodes that a host moves, and the materials and lights that it changes, when the simulator is made";
    ConfigError::new("poses, visible, materials or lights", "given", remedy)
}

/// Whether everything that `config` asks for can be had of poses that are known no further than a step's end.
fn check_driven<'a>(
    config: &RunConfig,
    sensors: impl Iterator<Item = &'a SensorConfig> + Clone,
) -> Result<(), ConfigError> {
    let refused = |what: &str, value: &str, remedy: &str| {
        Err(ConfigError::new(what, value, format!("{remedy}, where poses come from a host")))
    };
    if config.method.keyframes().is_some() {
        return refused(
            "method",
            config.method.name(),
            "native or decoupled: keyframes need poses that come later",
        );
    }
    if config.frame_rate_hz.is_some() {
        return refused("frame_rate", "given", "none: exposures last beyond a step");
    }
    if sensors.clone().any(|sensor| !sensor.exposure.is_off()) {
        return refused("sensor.exposure", "on", "off: exposures last beyond a step");
    }
    let step_us = config.pose_step_us.unwrap_or(0);
    let apart_us = 1e6 / config.rate_hz;
    let sampled =
        config.method != Method::Decoupled || sensors.clone().any(|sensor| sensor.needs_frames().is_some());
    if sampled && step_us > 0 && (apart_us.fract() != 0.0 || (step_us as f64 / apart_us).fract() != 0.0) {
        let remedy = format!(
            "a multiple of the time between two samples, which is a whole number of microseconds ({apart_us} us now)"
        );
        return Err(ConfigError::new("pose_step_us", step_us, remedy));
    }
    if step_us <= 0 {
        return Err(ConfigError::new(
            "pose_step_us",
            step_us,
            "above 0 microseconds, where poses come from a host",
        ));
    }
    Ok(())
}

/// Packets in order; dropping it stops the engine after the interval in work.
pub struct PacketStream {
    receive: Option<Receiver<Result<Packet, EngineError>>>,
    stop: Arc<AtomicBool>,
    cost: Option<Cost>,
    thread: Option<JoinHandle<()>>,
}

impl Iterator for PacketStream {
    type Item = Result<Packet, EngineError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.receive.as_ref()?.recv() {
            Ok(packet) => Some(packet),
            Err(_) => self.ended(),
        }
    }
}

impl PacketStream {
    /// Seconds of work per second of stream, by the first block of work, which is done before the first packet; labels and frames
    /// apart. `None` as long as nothing was measured; [`Method::Decoupled`] alone measures it.
    pub fn cost(&self) -> Option<f64> {
        self.cost.as_ref().and_then(Cost::get)
    }

    /// Waits for the next packet for at most `wait`; pending where it is not there yet, so that a host can
    /// look for an interruption meanwhile.
    pub fn poll_next(&mut self, wait: Duration) -> Poll<Option<Result<Packet, EngineError>>> {
        let Some(receive) = &self.receive else { return Poll::Ready(None) };
        match receive.recv_timeout(wait) {
            Ok(packet) => Poll::Ready(Some(packet)),
            Err(RecvTimeoutError::Timeout) => Poll::Pending,
            Err(RecvTimeoutError::Disconnected) => Poll::Ready(self.ended()),
        }
    }

    /// After the thread has gone: nothing, or the error that a panic there is. A stream that broke must not
    /// look like one that came to its end.
    fn ended(&mut self) -> Option<Result<Packet, EngineError>> {
        self.receive = None;
        match self.thread.take()?.join() {
            Ok(()) => None,
            Err(_) => Some(Err(EngineError::Device(
                "the stream's thread stopped with an internal error; please report what it printed".into(),
            ))),
        }
    }
}

impl Drop for PacketStream {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // The sender must not wait for a reader that is gone.
        self.receive = None;
        if let Some(thread) = self.thread.take() {
            // A panic there was a broken invariant; it has printed itself.
            let _ = thread.join();
        }
    }
}
