//! Decoupled sampling behind the simulator: events come from `evis-decoupled`, labels and frames from the engine, and events of
//! the tiles that are left to rendering, too.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use evis_core::event::take_causes;
use evis_core::random::Key;
use evis_core::{CameraInfo, ConfigError, Event, LabelKind, SensorConfig, TimeGrid};
use evis_decoupled::{Cost, Devices, Report, Stream, StreamSettings};
use evis_scene::{PixelLens, Scene};

use crate::config::{Compute, Interpolation, Method, RunConfig};
use crate::engine::follower::Followers;
use crate::engine::reset::other_stages;
use crate::engine::stages::{self, MadeArrays};
use crate::engine::{Arrived, Engine, milliseconds};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::output::packet::{Packet, PacketReport, ViewPacket};
use crate::output::poses::CameraPoses;
use crate::sensor::passes::share_passes;
use crate::world::crowds::Crowds;
use crate::world::tiles::{tile_at, tile_count};
use crate::world::view::{View, reseed};

/// Views of a scene whose events are found without rendering.
pub struct Decoupled {
    scene: Arc<Scene>,
    views: Vec<View>,
    /// The same, as `evis-decoupled` has them.
    seen: Vec<evis_decoupled::View>,
    stream: Stream,
    /// Renders labels and frames, and the tiles of `rendered`, where there are any.
    pictures: Option<Engine>,
    /// Per view: tiles whose events are rendered; empty where none are.
    rendered: Vec<Vec<bool>>,
    /// Arrays of events that a device has made.
    made: Arc<Mutex<MadeArrays>>,
    poses: CameraPoses,
    arrived: Vec<Arrived>,
    /// Per view: events before this are there.
    complete_us: Vec<i64>,
    /// Per view: what it took, of the stream and of what was reported.
    reports: Vec<[Report; 2]>,
    delivered_us: i64,
    settings: StreamSettings,
    stop: Arc<AtomicBool>,
    caused: bool,
}

impl Decoupled {
    /// Prepares `views`, and `gpu` where there are labels or frames.
    ///
    /// # Errors
    /// A scene or a sensor that this method cannot show, and pictures without a device.
    pub fn new(
        gpu: Option<&Gpu>,
        scene: Arc<Scene>,
        views: Vec<View>,
        cameras: &[CameraInfo],
        config: &mut RunConfig,
    ) -> Result<Self, EngineError> {
        let pictured = config.carried().iter().any(|kind| *kind != LabelKind::Cause);
        if pictured && gpu.is_none() {
            return Err(EngineError::NoDevice);
        }
        let rendered = match (config.rendered_tiles, gpu) {
            (Some(own), Some(_)) => {
                match Crowds::of(&scene, &views, cameras, (config, own.triangles_per_pixel))? {
                    Crowds::Tiles(found) => found.tiles,
                    Crowds::None | Crowds::Whole(_) => Vec::new(),
                }
            }
            _ => Vec::new(),
        };
        let followed: Vec<Vec<bool>> =
            rendered.iter().map(|tiles| tiles.iter().map(|tile| !tile).collect()).collect();
        let made = Arc::default();
        let devices: Option<Arc<dyn Devices>> = match (config.compute, gpu) {
            (Compute::Cpu, _) => None,
            (Compute::Gpu, Some(gpu)) => {
                let followers = Followers::new(gpu)?;
                // Tiles that are rendered fire on the host.
                Some(Arc::new(match config.dense.filter(|_| rendered.is_empty()) {
                    Some(output) => followers.with_dense(output, &made),
                    None => followers,
                }))
            }
            (Compute::Gpu, None) => return Err(EngineError::NoDevice),
        };
        let settings = StreamSettings {
            size: config.size,
            start_us: config.start_us,
            reference_luminance: config.reference_luminance,
            step_px: config.adaptive_px.unwrap_or(StreamSettings::default().step_px),
            rate_hz: config.rate_hz,
            pose_step_us: config.pose_step_us.unwrap_or(StreamSettings::default().pose_step_us),
            only: own_tiles(&views, &followed),
            devices,
        };
        let of = |view: &View| {
            let camera = scene.camera(&cameras[view.camera].name)?;
            let variant = (!scene.variants.is_empty()).then_some(view.environment);
            Ok(evis_decoupled::View { camera, variant, sensor: view.sensor.clone(), key: view.key })
        };
        let seen: Vec<_> = views.iter().map(of).collect::<Result<_, EngineError>>()?;
        let stream = Stream::new(Arc::clone(&scene), seen.clone(), &settings)?;
        config.reference_luminance = Some(stream.reference_luminance());
        let pictures = match gpu.filter(|_| pictured || !rendered.is_empty()) {
            Some(gpu) => Some(pictures(gpu, &scene, &views, &rendered, config)?),
            None => None,
        };
        Ok(Self {
            poses: CameraPoses::new(TimeGrid::new(config.label_rate_hz)?, config.start_us),
            arrived: views.iter().map(|_| Arrived::default()).collect(),
            complete_us: vec![0; views.len()],
            reports: vec![Default::default(); views.len()],
            delivered_us: 0,
            settings,
            stop: pictures.as_ref().map_or_else(Arc::default, |engine| Arc::clone(engine.stop())),
            caused: config.labels.contains(&LabelKind::Cause),
            scene,
            views,
            seen,
            stream,
            pictures,
            rendered,
            made,
        })
    }

    /// See [`Engine::stop`].
    pub fn stop(&self) -> &Arc<AtomicBool> {
        &self.stop
    }

    /// How fast events come; labels and frames apart.
    pub fn cost(&self) -> &Cost {
        self.stream.cost()
    }

    /// Stream time up to which packets were delivered.
    pub fn now_us(&self) -> i64 {
        self.delivered_us
    }

    /// See [`Engine::luminance`]; by this method.
    pub fn luminance(&self, view: usize, t_us: i64, config: &RunConfig) -> Result<Vec<f64>, EngineError> {
        let Some(of) = self.seen.get(view) else {
            return Err(EngineError::Device(format!("there is no view {view}")));
        };
        let settings =
            evis_decoupled::Settings { camera: of.camera, size: config.size, ..Default::default() };
        let variant = of.variant.and_then(|index| self.scene.variants.get(index));
        let t_us = (config.start_us + t_us) as f64;
        Ok(evis_decoupled::luminance_of(&self.scene, variant, &settings, t_us)?)
    }

    /// Whether views may be reset now.
    ///
    /// # Errors
    /// Where no host moves anything: then views are simulated ahead of the present.
    pub fn check_reset(&self) -> Result<(), ConfigError> {
        if self.scene.host_poses.is_none() {
            let remedy = "of a simulator with the method native, or with poses from a host: decoupled sampling is \
                          ahead of the present";
            return Err(ConfigError::new("reset", "with the method decoupled", remedy));
        }
        self.pictures.as_ref().map_or(Ok(()), Engine::check_reset)
    }

    /// Whether view `view` can have `sensor` from a reset on.
    ///
    /// # Errors
    /// One that is defined on frames where the present one is not, or the other way round: blocks of time are made for it.
    pub fn check_sensor(&self, view: usize, sensor: &SensorConfig) -> Result<(), ConfigError> {
        let (on_frames, now) = (sensor.needs_frames(), self.views[view].sensor.needs_frames());
        let value = match (on_frames, now) {
            (Some(what), None) => format!("one with {what}, which is defined on frames"),
            (None, Some(what)) => format!("one without {what}, which is defined on frames"),
            // The device makes arrays of what its stages fire, and of nothing else.
            _ if stages::lock(&self.made).makes(view) && !share_passes(&self.views[view].sensor, sensor) => {
                return Err(other_stages());
            }
            _ => return Ok(()),
        };
        Err(ConfigError::new("sensor", value, "one that is defined on frames if the simulator's own is"))
    }

    /// Resets environments at the present: see [`Engine::reset`].
    ///
    /// # Errors
    /// As [`Decoupled::check_reset`]; the device may fail.
    pub fn reset(
        &mut self,
        environments: &[usize],
        seeds: &[u64],
        sensors: &[(usize, SensorConfig)],
        lenses: &[(usize, PixelLens)],
    ) -> Result<(), EngineError> {
        self.check_reset()?;
        for (view, sensor) in sensors {
            self.views[*view].sensor = sensor.clone();
            self.seen[*view].sensor = sensor.clone();
            self.stream.set_sensor(*view, sensor.clone());
        }
        // What is simulated has it of the scene.
        for (view, lens) in lenses {
            self.views[*view].lens = *lens;
            self.views[*view].own_lens = *lens;
        }
        reseed(&mut self.views, &self.scene, environments, seeds);
        let own = |(_, view): &(usize, &View)| environments.contains(&view.environment);
        let again = self.views.iter().enumerate().filter(own).map(|(index, view)| (index, view.key));
        let again: Vec<(usize, Key)> = again.collect();
        for (view, key) in &again {
            self.arrived[*view].events.clear();
            self.seen[*view].key = *key;
            // New pixels count from 0.
            self.reports[*view] = Default::default();
        }
        self.stream.restart(again);
        match &mut self.pictures {
            // Pictures see no sensor.
            Some(engine) => engine.reset(environments, seeds, &[], lenses),
            None => Ok(()),
        }
    }

    /// See [`Engine::restart`]; events come from tiles of `only` alone.
    ///
    /// # Errors
    /// A thread that cannot start.
    pub fn restart(&mut self, start_us: i64, only: &[Vec<bool>]) -> Result<(), EngineError> {
        let asked = |(at, view): (usize, &View)| {
            only.get(at).cloned().unwrap_or_else(|| vec![true; tile_count(view.size())])
        };
        let asked: Vec<Vec<bool>> = self.views.iter().enumerate().map(asked).collect();
        // Those that are rendered, or not.
        let of = |rendered: bool| -> Vec<Vec<bool>> {
            let is = |view: usize, tile: usize| self.rendered.get(view).is_some_and(|tiles| tiles[tile]);
            let own = |(view, asked): (usize, &Vec<bool>)| {
                asked.iter().enumerate().map(|(tile, asked)| *asked && is(view, tile) == rendered).collect()
            };
            asked.iter().enumerate().map(own).collect()
        };
        let (rendered, followed) = (of(true), of(false));
        if let Some(engine) = self.pictures.as_mut().filter(|_| !self.rendered.is_empty()) {
            engine.restart(start_us, rendered, false)?;
        }
        self.settings = StreamSettings {
            start_us,
            only: own_tiles(&self.views, &followed),
            reference_luminance: Some(self.stream.reference_luminance()),
            ..self.settings.clone()
        };
        self.stream = Stream::new(Arc::clone(&self.scene), self.seen.clone(), &self.settings)?;
        self.arrived.iter_mut().for_each(|arrived| *arrived = Arrived::default());
        self.complete_us.fill(0);
        self.reports.fill(Default::default());
        self.delivered_us = 0;
        Ok(())
    }

    /// See [`Engine::needed_us`].
    pub fn needed_us(&self, until_us: i64) -> i64 {
        let step_us = self.settings.pose_step_us;
        let parts = until_us.div_euclid(step_us) + i64::from(until_us.rem_euclid(step_us) > 0);
        let own_us = if self.scene.host_poses.is_some() { parts * step_us } else { until_us };
        self.pictures.as_ref().map_or(own_us, |engine| engine.needed_us(until_us).max(own_us))
    }

    /// Delivers `[now, until_us)`, simulating ahead as far as `horizon_us`.
    pub fn deliver(&mut self, until_us: i64, horizon_us: i64) -> Result<Packet, EngineError> {
        let _span = tracing::trace_span!("deliver", until_us).entered();
        let started = Instant::now();
        self.stream.want(horizon_us);
        let waiting = Instant::now();
        while self.complete_us.iter().any(|&t| t < until_us) {
            let next =
                tracing::trace_span!("wait for decoupled sampling").in_scope(|| self.stream.next(&self.stop));
            let Some(piece) = next? else { return Err(EngineError::Stopped) };
            let events = &mut self.arrived[piece.view].events;
            // Where two blocks meet within a microsecond, both may have events in it.
            let meeting = events.partition_point(|e| e.t < self.complete_us[piece.view]);
            events.extend(piece.events);
            events[meeting..].sort_by_key(Event::order);
            self.complete_us[piece.view] = piece.complete_us;
            self.reports[piece.view][0] = piece.report;
        }
        let waited_ms = milliseconds(waiting);
        let pictures = match &mut self.pictures {
            Some(engine) => Some(engine.deliver(until_us, horizon_us)?),
            None => None,
        };
        let mut report = pictures.as_ref().map_or_else(PacketReport::default, |packet| packet.report.clone());
        let mut pictures = pictures.map(|packet| packet.views.into_iter());
        let arrived = &mut self.arrived;
        self.poses.take(&self.scene, &self.views, until_us, |view, pose| arrived[view].poses.push(pose));
        let mut packet = Packet { start_us: self.delivered_us, end_us: until_us, ..Default::default() };
        for (view, arrived) in self.views.iter().zip(&mut self.arrived) {
            let count = arrived.events.partition_point(|e| e.t < until_us);
            let rest = arrived.events.split_off(count);
            let mut events = std::mem::replace(&mut arrived.events, rest);
            let mut causes = take_causes(&mut events);
            let mut pictured = pictures.as_mut().and_then(Iterator::next).unwrap_or_default();
            if let Some(tiles) = self.rendered.get(packet.views.len()) {
                (events, causes) = joined((events, causes), &mut pictured, view, tiles);
            }
            packet.views.push(ViewPacket {
                environment: view.environment,
                camera: view.camera,
                dense: stages::lock(&self.made).take(packet.views.len(), until_us),
                causes: if self.caused { causes } else { Vec::new() },
                events,
                labels: pictured.labels,
                poses: std::mem::take(&mut arrived.poses),
            });
        }
        self.delivered_us = until_us;
        let events = packet.views.iter().map(|v| v.events.len() as u64);
        report.events = events.sum::<u64>() + stages::lock(&self.made).take_count();
        for [now, reported] in &mut self.reports {
            let before = std::mem::replace(reported, *now);
            report.drawn_pixels += now.evaluations - before.evaluations;
            report.on_device += now.on_device - before.on_device;
            report.refollowed += now.refollowed - before.refollowed;
            report.resting += now.resting - before.resting;
            report.clamped += now.losses.clamped - before.losses.clamped;
            report.suppressed += now.losses.suppressed - before.losses.suppressed;
            report.dropped += now.losses.dropped - before.losses.dropped;
        }
        report.rendered_tiles = self.rendered.iter().flatten().filter(|tile| **tile).count() as u64;
        report.times.device_wait_ms += waited_ms;
        report.times.total_ms = milliseconds(started);
        packet.report = report;
        Ok(packet)
    }
}

/// What renders labels and frames, and where there are any the tiles `rendered` of `views`.
fn pictures(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    views: &[View],
    rendered: &[Vec<bool>],
    config: &mut RunConfig,
) -> Result<Engine, EngineError> {
    let start =
        |views, config: &mut RunConfig| gpu.guarded(|| Engine::new(gpu, Arc::clone(scene), views, config));
    if rendered.is_empty() {
        // It fires nothing: stages would cost memory alone.
        let plain = |view: &View| View { sensor: SensorConfig::default(), ..view.clone() };
        return start(views.iter().map(plain).collect(), config);
    }
    let mut own = RunConfig {
        method: Method::Native,
        adaptive_px: config.rendered_tiles.map(|own| own.step_px),
        rendered_tiles: None,
        between: Interpolation::Curve,
        dense: None,
        ..config.clone()
    };
    let mut engine = start(views.to_vec(), &mut own)?;
    engine.restrict(rendered.to_vec());
    Ok(engine)
}

/// Tiles of `views`, in those of `evis-decoupled`.
fn own_tiles(views: &[View], tiles: &[Vec<bool>]) -> Vec<Vec<bool>> {
    const OWN: u32 = evis_decoupled::scene::tiles::TILE as u32;
    let of = |(view, tiles): (&View, &Vec<bool>)| {
        let (width, height) = view.size();
        let at = |x: u32, y: u32| tiles[tile_at(width, x * OWN, y * OWN)];
        (0..height.div_ceil(OWN)).flat_map(|y| (0..width.div_ceil(OWN)).map(move |x| at(x, y))).collect()
    };
    views.iter().zip(tiles).map(of).collect()
}

/// Events and their causes, with those of the `tiles` that `pictured` has of the same view.
fn joined(
    (events, causes): (Vec<Event>, Vec<u8>),
    pictured: &mut ViewPacket,
    view: &View,
    tiles: &[bool],
) -> (Vec<Event>, Vec<u8>) {
    let is_rendered = |event: &Event| tiles[tile_at(view.size().0, event.x.into(), event.y.into())];
    let others = std::mem::take(&mut pictured.events).into_iter();
    // Where nobody wants causes there are none.
    let known = std::mem::take(&mut pictured.causes).into_iter().chain(std::iter::repeat(0));
    let rendered = others.zip(known).filter(|(event, _)| is_rendered(event));
    let mut all: Vec<(Event, u8)> = events.into_iter().zip(causes).chain(rendered).collect();
    // Stable: those of one pixel are all of one kind, and keep their firing order.
    all.sort_by_key(|(event, _)| event.order());
    all.into_iter().unzip()
}
