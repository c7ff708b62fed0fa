//! The engine: batches of views, submissions in flight, and what came back of them.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Instant;

use evis_core::event::take_causes;
use evis_core::luminance;
use evis_core::{Event, LabelFrame, LabelKind, PoseSample, SensorConfig, TimeGrid, WarpVariant};
use evis_scene::{Scene, SceneState};

use crate::adaptive::AdaptiveRoom;
use crate::audit::{AuditRun, Finding};
use crate::chain::{ChainPlan, GroupChain, STRIKE_WORDS};
use crate::config::{Antialias, Method, RunConfig};
use crate::error::EngineError;
use crate::exposure::ExposureRoom;
use crate::frame::{FrameData, FrameRequest, rigid};
use crate::frame_buffers::FrameBuffers;
use crate::gpu::Gpu;
use crate::gpu_scene::GpuScene;
use crate::grid::SampleGrid;
use crate::host_walk::{HostWalk, Looks};
use crate::interval::{self, Group, Slot, Unit};
use crate::labels::{LabelJob, LabelRoom};
use crate::method::{NativeRoom, Sampling};
use crate::packet::{Packet, PacketReport, StageTimes, ViewPacket};
use crate::pass::raster::{self, Pipelines, SceneConstants, SurfaceLayouts};
use crate::pass::sky;
use crate::pass::trigger::{Blocks, TriggerPasses, WalkPasses};
use crate::shadow::{MovingShadows, ShadowPlan, ShadowRoom};
use crate::sizes::{self, DeviceLimits, MethodNeeds};
use crate::splat::{self, SplatRoom};
use crate::targets::{LayerUse, Layers, Targets, row_bytes};
use crate::uniforms::{Status, ViewSensor};
use crate::unpack;
use crate::variant::LightSet;
use crate::view::{PixelLens, View};

/// Submissions in flight: the device works on one while the host prepares the next and unpacks the last.
const RING: usize = 3;
/// Submissions are kept near this long, so that a stop, which is seen between them, is seen soon. How instants are
/// grouped never shows in the events.
const SUBMISSION_MS: f64 = 400.0;
/// Events that a submission's buffer holds at first.
const FIRST_CAPACITY: u32 = 1 << 18;
/// The same, per pixel, where submissions are whole blocks.
const EVENTS_PER_PIXEL: u64 = 4;

/// What an upload of frames brings beside them.
#[derive(Clone, Copy, Default)]
pub(crate) struct Upload {
    /// The numbers of records in place of the ids of objects.
    pub record_ids: bool,
    /// What changes from instant to instant: the group's first view and the first instant.
    pub watch: Option<(usize, i64)>,
    /// Where everything was.
    pub trail: bool,
}

/// What every submission reads.
pub struct Context {
    pub(crate) gpu: Gpu,
    pub(crate) scene: Arc<Scene>,
    pub(crate) gpu_scene: GpuScene,
    pub(crate) layouts: SurfaceLayouts,
    pub(crate) views: Vec<View>,
    pub(crate) grid: SampleGrid,
    pub(crate) start_us: i64,
    /// Sample offsets in pixels; one, at the centre, for `--aa edges`, whose places lie on a grid.
    pub(crate) offsets: Vec<[f32; 2]>,
    /// The offsets of audits that look between them, as many; they are numbered after these.
    pub(crate) other_offsets: Vec<[f32; 2]>,
    pub(crate) luminance: Pipelines,
    pub(crate) sky: Option<wgpu::RenderPipeline>,
    /// Clears a part of a luminance picture.
    pub(crate) background: wgpu::RenderPipeline,
    pub(crate) trigger: TriggerPasses,
    pub(crate) surroundings: wgpu::BindGroup,
    pub(crate) background_luminance: f64,
    /// `Y_ref` of every pixel.
    pub(crate) reference_luminance: f32,
    pub(crate) light_count: u32,
    pub(crate) shadows: Option<ShadowRoom>,
    pub(crate) frame_data: FrameData,
    pub(crate) frame_buffers: FrameBuffers,
    /// Whether what is as it was at the instant before is copied, not drawn; a test compares both.
    pub(crate) skips_still: bool,
}

impl Context {
    /// Scene time of stream time `t_us`, in seconds.
    pub(crate) fn scene_time_s(&self, t_us: i64) -> f64 {
        (self.start_us + t_us) as f64 * 1e-6
    }

    /// First record of frame `frame`.
    pub(crate) fn object_base(&self, frame: u32) -> u32 {
        frame * self.gpu_scene.objects.len() as u32
    }

    /// In pixels, of sample `sample`; those of audits with other samples come after the own ones.
    pub(crate) fn sample_offset(&self, sample: u32) -> [f32; 2] {
        let sample = sample as usize;
        let other = || self.other_offsets[sample - self.offsets.len()];
        self.offsets.get(sample).copied().unwrap_or_else(other)
    }

    /// Offsets of frame `frame` in its uniform buffer, and of what `sample` stands for; none stands for the whole pixel.
    pub(crate) fn frame_offsets(&self, frame: u32, sample: Option<u32>) -> [u32; 2] {
        let share = sample.map_or(0, |sample| sample + 1);
        [frame * raster::frame_stride(self.light_count) as u32, share * raster::UNIFORM_ALIGNMENT as u32]
    }

    /// The views of `group`.
    pub(crate) fn views_of(&self, group: &Group) -> Vec<View> {
        group.views.iter().map(|&v| self.views[v].clone()).collect()
    }

    /// Evaluates `views` at `times_us` and uploads the result; returns group 0.
    pub(crate) fn upload_frames(&mut self, views: &[View], times_us: &[i64]) -> wgpu::BindGroup {
        self.upload_frames_as(views, times_us, Upload::default())
    }

    /// The same, with what `upload` asks for.
    pub(crate) fn upload_frames_as(
        &mut self,
        views: &[View],
        times_us: &[i64],
        upload: Upload,
    ) -> wgpu::BindGroup {
        self.build_frames(views, times_us, upload);
        self.frame_buffers.upload(&self.gpu, &self.layouts, &self.gpu_scene.morph_data, &self.frame_data)
    }

    /// The same, without the way to the device: for what poses alone tell.
    pub(crate) fn build_frames(&mut self, views: &[View], times_us: &[i64], upload: Upload) {
        let times_s: Vec<f64> = times_us.iter().map(|&t| self.scene_time_s(t)).collect();
        let plan = self.shadows.as_ref().map(|s| &s.plan);
        let redrawn = plan.is_some_and(ShadowPlan::is_redrawn);
        let occluders = self.shadows.as_ref().and_then(|s| s.occluders.as_ref());
        let request = FrameRequest {
            views,
            times_s: &times_s,
            shadows: plan,
            occluders,
            record_ids: upload.record_ids,
            shadow_maps: redrawn,
            watch: upload.watch,
            trail: upload.trail,
        };
        self.frame_data.build(&self.scene, &self.gpu_scene, &request);
    }
}

/// What came back of one view and was not yet delivered.
#[derive(Default)]
struct Arrived {
    events: Vec<Event>,
    labels: Vec<LabelFrame>,
    poses: Vec<PoseSample>,
}

enum Work {
    Events {
        unit: Unit,
        slot: Slot,
        predicted: u32,
        audit: Option<PendingAudit>,
    },
    Labels(LabelJob),
    /// Light for pixels that the host walks.
    Looks(Looks),
}

/// Audits of a submission, on their way.
type PendingAudit = (AuditRun, Receiver<Result<(), wgpu::BufferAsyncError>>);

struct InFlight {
    work: Work,
    submitted: Instant,
    submission: wgpu::SubmissionIndex,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

/// The engine.
pub struct Engine {
    context: Context,
    sampling: Sampling,
    targets: Vec<Targets>,
    groups: Vec<Group>,
    label_room: Option<LabelRoom>,
    exposure_room: Option<ExposureRoom>,
    host_walk: HostWalk,
    label_grid: TimeGrid,
    /// Instants that no submission parts.
    block: u32,
    in_flight: VecDeque<InFlight>,
    free: Vec<Slot>,
    capacity: u32,
    most_capacity: u32,
    /// Words of strikes that a submission may have.
    most_feed: u64,
    /// Events of the last submission, by class.
    last_counts: Vec<u32>,
    /// Measured milliseconds per instant of a group, of late.
    instant_ms: f64,
    collected: Option<Instant>,
    /// Per group: events before this are complete.
    complete_us: Vec<i64>,
    next_label: i64,
    next_label_group: usize,
    labels_complete: i64,
    next_pose: i64,
    arrived: Vec<Arrived>,
    delivered_us: i64,
    report: PacketReport,
    pose_state: SceneState,
    stop: Arc<AtomicBool>,
    /// Whether events carry why they fired.
    caused: bool,
}

impl Engine {
    /// Prepares everything; `config` gets its reference luminance filled in.
    pub fn new(
        gpu: &Gpu,
        scene: Arc<Scene>,
        views: Vec<View>,
        config: &mut RunConfig,
    ) -> Result<Self, EngineError> {
        let device = &gpu.device;
        let limits = device.limits();
        let device_limits = DeviceLimits {
            texture_edge: limits.max_texture_dimension_2d,
            texture_layers: limits.max_texture_array_layers,
            storage_binding: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        };
        let mut state = SceneState::default();
        scene.evaluate_variant(scene.variants.first(), config.start_us as f64 * 1e-6, &mut state);
        let layouts = SurfaceLayouts::new(device);
        let gpu_scene = GpuScene::new(device, &gpu.queue, &layouts, &scene, &state);
        let edges = config.antialias == Antialias::Edges;
        let offsets = if edges { vec![[0.0, 0.0]] } else { crate::pattern::offsets(config.samples) };
        let grid_side = config.coverage_grid();
        let samples = offsets.len() as u32;
        // A picture that is moved by an offset is sampled at the opposite place.
        let other_offsets = crate::pattern::others(&offsets);
        let shares = [&offsets, &other_offsets].map(|offsets| {
            let places: Vec<[f32; 2]> = offsets.iter().map(|o| o.map(|v| -v)).collect();
            crate::pattern::shares(&places)
        });
        let shares = shares.concat();
        let grid = config.sample_grid()?;
        let rendered = if edges { LayerUse::Resolved(grid_side) } else { LayerUse::Rendered };
        let block = config.block();
        let blocks = Blocks { instants: block, between: config.between };
        // What the trigger averages, and how it comes to be.
        let (layer_samples, made) = match (&config.method, config.adaptive_px) {
            (Method::Splat(_), _) | (_, Some(_)) => (1, LayerUse::Computed),
            (_, None) => (samples, rendered),
        };
        let may_be_unknown =
            matches!(&config.method, Method::Splat(warp) if warp.variant == WarpVariant::Splat);
        let shadows = ShadowRoom::new(device, &layouts, &scene, &gpu_scene, config)?;
        let constants = SceneConstants {
            lights: LightSet::new(&scene, |node| shadows.as_ref()?.plan.layer_of(node)),
            shadows: shadows.is_some(),
            shadow_rays: shadows.as_ref().is_some_and(|s| s.occluders.is_some()),
            environment: scene.environment.is_some(),
            texture_samples: raster::texture_samples(samples, grid_side),
            grid: grid_side,
            texture_taps: config.taps(),
        };
        let sample_count = if edges { 4 } else { 1 };
        let pipelines = raster::luminance_pipelines(
            device,
            &layouts,
            gpu_scene.variants().into_iter(),
            &constants,
            sample_count,
        );
        let visible = scene.environment.as_ref().is_some_and(|e| e.visible);
        let sky = visible.then(|| {
            let target = [Some(raster::LUMINANCE_FORMAT.into())];
            sky::pipeline(device, &layouts, "fs_luminance", &target, sample_count, constants.lights.count)
        });
        let label_room =
            LabelRoom::new(device, &layouts, &scene, &gpu_scene, &views, config, &constants, device_limits)?;
        let shadow_maps =
            shadows.as_ref().map_or_else(|| ShadowRoom::empty(device), |room| room.array.clone());
        let surroundings = gpu_scene.surroundings.group(
            device,
            &layouts,
            &shadow_maps,
            shadows.as_ref().and_then(|s| s.occluders.as_ref()),
        );
        let background_luminance = luminance::luminance(scene.background.map(f64::from));
        let classes = classes(&views);
        let sensors: Vec<&SensorConfig> = classes.iter().map(|of| &views[of[0]].sensor).collect();
        let mut context = Context {
            gpu: gpu.clone(),
            trigger: TriggerPasses::new(device, &sensors, layer_samples, may_be_unknown, blocks, grid_side),
            gpu_scene,
            layouts,
            views,
            grid,
            start_us: config.start_us,
            offsets,
            other_offsets,
            luminance: pipelines,
            sky,
            background: sky::background(device, background_luminance, sample_count),
            surroundings,
            background_luminance,
            reference_luminance: 1.0,
            shadows,
            frame_data: FrameData::default(),
            skips_still: true,
            frame_buffers: FrameBuffers::new(device, constants.lights.count, &shares),
            light_count: constants.lights.count,
            scene,
        };
        crate::shadow::draw_still_maps(&mut context)?;

        let mut sampling = match (&config.method, config.adaptive_px) {
            (Method::Splat(splat), _) => {
                Sampling::Splat(Box::new(SplatRoom::new(&context, &constants, splat)))
            }
            (_, Some(step_px)) => Sampling::Adaptive(Box::new(AdaptiveRoom::new(
                &context,
                step_px,
                block,
                rendered,
                config.audit,
            ))),
            (_, None) => Sampling::Native(NativeRoom::default()),
        };
        // Pictures are drawn so many times as large along each side.
        let drawn_limits =
            DeviceLimits { texture_edge: device_limits.texture_edge / grid_side, ..device_limits };
        let mut targets = Vec::new();
        let mut members = Vec::new();
        for (class, views) in classes.into_iter().enumerate() {
            let PixelLens { width, height, .. } = context.views[views[0]].lens;
            let needs = match &config.method {
                Method::Native => MethodNeeds { block, ..Default::default() },
                Method::Splat(splat) => SplatRoom::needs(splat, width, height, &drawn_limits)
                    .ok_or_else(|| splat::does_not_fit(splat, width, height, &drawn_limits))?,
            };
            let (needs, most) = match context.trigger.chain(class) {
                None => (needs, sizes::MAX_INSTANTS),
                Some(chain) => {
                    let bytes = needs.bytes.max(chain.plan.view_bytes(width, height));
                    let layers = needs.layers.max(chain.plan.planes.count);
                    (
                        MethodNeeds { bytes, layers, ..needs },
                        ChainPlan::most_instants(grid.longest_interval_us()),
                    )
                }
            };
            let count = views.len() as u32;
            let plan = sizes::plan(width, height, layer_samples, count, most, needs, drawn_limits)
                .ok_or_else(|| {
                    EngineError::Device(format!(
                        "{width}x{height} pixels with {} samples do not fit this device \
                         (edge {}, layers {}, binding {} bytes); choose a smaller --size or fewer --samples",
                        config.samples,
                        drawn_limits.texture_edge,
                        drawn_limits.texture_layers,
                        drawn_limits.storage_binding
                    ))
                })?;
            let chain = context.trigger.chain(class).map(|passes| &passes.plan);
            targets.push(Targets::new(device, width, height, plan, made, chain, block));
            match (&mut sampling, targets.last()) {
                (Sampling::Splat(room), Some(targets)) => room.add_class(&context, targets, rendered),
                (Sampling::Adaptive(room), Some(targets)) => room.add_class(&context, targets),
                _ => {}
            }
            for chunk in views.chunks(plan.views_per_group as usize) {
                members.push((class, chunk.to_vec()));
            }
        }
        let reference = match config.reference_luminance {
            Some(value) => value,
            None => measure_reference(&mut context, samples, rendered)?,
        };
        config.reference_luminance = Some(reference);
        context.reference_luminance = reference;
        let groups: Vec<_> = members
            .into_iter()
            .map(|(t, views)| {
                let sensors: Vec<_> = views
                    .iter()
                    .map(|&v| ViewSensor {
                        threshold_on: context.views[v].sensor.threshold_on,
                        threshold_off: context.views[v].sensor.threshold_off,
                        log_eps: context.views[v].sensor.log_eps,
                        inverse_reference_luminance: 1.0 / reference,
                    })
                    .collect();
                let chain = context.trigger.chain(t).map(|passes| {
                    let own: Vec<&View> = views.iter().map(|&v| &context.views[v]).collect();
                    (passes, GroupChain::new(&context.gpu, &passes.plan, &targets[t], &own, reference))
                });
                Group::new(&context.gpu, t, &targets[t], views, &sensors, chain)
            })
            .collect();
        let most_capacity =
            (device_limits.storage_binding / 8).min(limits.max_buffer_size / 8 - 4096).min(1 << 28) as u32;
        let capacity = first_capacity(&groups, &targets, block).min(most_capacity);
        let caused = config.labels.contains(&LabelKind::Cause);
        Ok(Self {
            caused,
            sampling,
            label_room,
            exposure_room: ExposureRoom::new(&context, config, rendered)?,
            host_walk: HostWalk::new(&context.views, reference, layer_samples, caused)?,
            label_grid: TimeGrid::new(config.label_rate_hz)?,
            block,
            in_flight: VecDeque::new(),
            free: Vec::new(),
            capacity,
            most_capacity,
            // Buffers for them are half as long again.
            most_feed: device_limits.storage_binding / 4 * 2 / 3 - 4,
            last_counts: vec![0; targets.len()],
            // Unknown: begins with two instants.
            instant_ms: SUBMISSION_MS / 2.0,
            collected: None,
            complete_us: vec![0; groups.len()],
            next_label: 0,
            next_label_group: 0,
            labels_complete: 0,
            next_pose: 0,
            arrived: context.views.iter().map(|_| Arrived::default()).collect(),
            delivered_us: 0,
            report: PacketReport::default(),
            pose_state: SceneState::default(),
            stop: Arc::default(),
            targets,
            groups,
            context,
        })
    }

    /// What `bench` measures stage by stage.
    pub(crate) fn parts(&mut self) -> (&mut Context, &mut Sampling, &[Targets], &mut [Group]) {
        (&mut self.context, &mut self.sampling, &self.targets, &mut self.groups)
    }

    /// Starts with buffers of `capacity` events, never more than `most`: tests make them overflow.
    #[cfg(test)]
    pub fn limit_buffers(&mut self, capacity: u32, most: u32) {
        self.capacity = capacity;
        self.most_capacity = most;
    }

    /// Lets a submission have this many words of strikes: tests make it split.
    #[cfg(test)]
    pub fn limit_feed(&mut self, words: u64) {
        self.most_feed = words;
    }

    /// Set, it ends a delivery after the submission in work with [`EngineError::Stopped`]; nothing is lost, the
    /// next delivery goes on from there.
    pub fn stop(&self) -> &Arc<AtomicBool> {
        &self.stop
    }

    /// What view `view` shows at stream time `t_us`, as its pixels integrate it: mean luminance over the samples, row-major
    /// from the top. The stream is left as it is.
    pub fn luminance(&mut self, view: usize, t_us: i64) -> Result<Vec<f64>, EngineError> {
        let Some(group) = self.groups.iter().find(|group| group.views.contains(&view)) else {
            return Err(EngineError::Device(format!("there is no view {view}")));
        };
        mean_luminance(&mut self.context, &self.targets[group.targets].layers, view, t_us)
    }

    /// What the method makes of instants `first..first + instants` of the first view: a picture each, from the mean of
    /// its samples.
    #[cfg(test)]
    pub fn instants(&mut self, first: i64, instants: u32) -> Result<Vec<Vec<f32>>, EngineError> {
        let (group, unit) = (&self.groups[0], Unit { group: 0, first, instants });
        let targets = &self.targets[group.targets];
        let mut encoder = self.context.gpu.device.create_command_encoder(&Default::default());
        self.sampling.encode(&mut self.context, &mut encoder, targets, group, &unit);
        let samples = targets.plan.layers / (targets.plan.instants * targets.plan.views_per_group);
        let layers = read_layers(&self.context, encoder, &targets.layers, instants * samples)?;
        Ok(layers
            .chunks_exact(samples as usize)
            .map(|of| {
                let mean = |p: usize| of.iter().map(|layer| layer[p]).sum::<f32>() / of.len() as f32;
                (0..of[0].len()).map(mean).collect()
            })
            .collect())
    }

    /// Where the older side's pixels were last placed: x, y, depth key, in planes over the keyframe.
    #[cfg(test)]
    pub fn splat_store(&self) -> Option<&splat::Store> {
        match &self.sampling {
            Sampling::Splat(room) => room.store(0),
            Sampling::Native(_) | Sampling::Adaptive(_) => None,
        }
    }

    /// Sample offsets in pixels, in layer order.
    #[cfg(test)]
    pub fn offsets(&self) -> &[[f32; 2]] {
        &self.context.offsets
    }

    /// Stream time up to which packets were delivered.
    pub fn now_us(&self) -> i64 {
        self.delivered_us
    }

    /// Restarts the stream of an engine whose sensors are ideal and that has no frames, `start_us` into the scene's time. In
    /// adaptive time it renders the tiles `only` of each view from then on (all where there is nothing), and other pixels fire
    /// anything or nothing; with `every_instant` at every instant, whether they change or not.
    pub fn restart(
        &mut self,
        start_us: i64,
        only: Vec<Vec<bool>>,
        every_instant: bool,
    ) -> Result<(), EngineError> {
        while !self.in_flight.is_empty() {
            self.collect_oldest()?;
        }
        self.context.start_us = start_us;
        self.sampling.restart(only, every_instant);
        self.groups.iter_mut().for_each(|group| group.next = 0);
        self.complete_us.fill(0);
        self.arrived.iter_mut().for_each(|arrived| *arrived = Arrived::default());
        (self.next_label, self.next_label_group, self.labels_complete) = (0, 0, 0);
        (self.next_pose, self.delivered_us, self.report) = (0, 0, PacketReport::default());
        Ok(())
    }

    /// Delivers `[now, until_us)`, submitting ahead as far as `horizon_us`.
    pub fn deliver(&mut self, until_us: i64, horizon_us: i64) -> Result<Packet, EngineError> {
        let started = Instant::now();
        loop {
            while self.in_flight.len() < RING && self.submit_next(horizon_us)? {}
            if self.is_complete(until_us) {
                break;
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(EngineError::Stopped);
            }
            self.collect_oldest()?;
        }
        self.expose_frames(until_us)?;
        let packing = Instant::now();
        self.evaluate_poses(until_us);
        let mut packet = Packet { start_us: self.delivered_us, end_us: until_us, ..Default::default() };
        for (view, arrived) in self.context.views.iter().zip(&mut self.arrived) {
            let count = arrived.events.partition_point(|e| e.t < until_us);
            let rest = arrived.events.split_off(count);
            let labels = arrived.labels.partition_point(|l| l.t_us < until_us);
            let mut events = std::mem::replace(&mut arrived.events, rest);
            let causes = if self.caused { take_causes(&mut events) } else { Vec::new() };
            packet.views.push(ViewPacket {
                environment: view.environment,
                camera: view.camera,
                events,
                causes,
                labels: arrived.labels.drain(..labels).collect(),
                poses: std::mem::take(&mut arrived.poses),
            });
        }
        self.delivered_us = until_us;
        packet.report = std::mem::take(&mut self.report);
        packet.report.keyframes = self.sampling.take_keyframes();
        packet.report.drawn_pixels = self.sampling.take_drawn_pixels();
        packet.report.events = packet.views.iter().map(|v| v.events.len() as u64).sum();
        packet.report.times.pack_ms += milliseconds(packing);
        packet.report.times.total_ms = milliseconds(started);
        Ok(packet)
    }

    /// Frames whose middle lies before `until_us`.
    fn expose_frames(&mut self, until_us: i64) -> Result<(), EngineError> {
        let Some(room) = &mut self.exposure_room else { return Ok(()) };
        while let Some(frames) = room.expose(&mut self.context, until_us, &self.stop)? {
            for (arrived, frame) in self.arrived.iter_mut().zip(frames) {
                let at = arrived.labels.partition_point(|l| (l.t_us, l.kind) <= (frame.t_us, frame.kind));
                arrived.labels.insert(at, frame);
            }
        }
        Ok(())
    }

    fn is_complete(&self, until_us: i64) -> bool {
        let labels_wanted =
            if self.label_room.is_some() { self.label_grid.first_at_or_after(until_us) } else { 0 };
        self.complete_us.iter().all(|&t| t >= until_us) && self.labels_complete >= labels_wanted
    }

    /// Submits the earliest work that is left before `horizon_us`; false where there is none.
    fn submit_next(&mut self, horizon_us: i64) -> Result<bool, EngineError> {
        let started = Instant::now();
        let grid = self.context.grid;
        // Each group's next instant and its last one: where pixels see frames, light is needed for longer.
        let left = self.groups.iter().enumerate().map(|(g, group)| {
            let exposure = &self.context.views[group.views[0]].sensor.exposure;
            (g, group.next, grid.first_at_or_after(exposure.needed_us(horizon_us)))
        });
        let due = left.filter(|(_, next, last)| next <= last).min_by_key(|(_, next, _)| *next);
        let label_us = self.label_grid.instant_us(self.next_label);
        let label_due = self.label_room.is_some()
            && label_us < horizon_us
            && due.is_none_or(|(_, next, _)| label_us <= grid.instant_us(next));
        if label_due {
            self.submit_label()?;
        } else if let Some((group, next, last)) = due {
            let planned = f64::from(self.targets[self.groups[group].targets].plan.instants);
            let most = (SUBMISSION_MS / self.instant_ms.max(1e-3)).clamp(1.0, planned) as i64;
            let block = i64::from(self.block);
            // The first instant of a chain has a pass of its own, and so has the one before the first block.
            let alone = next == 0 && (block > 1 || self.groups[group].chain.is_some());
            let whole = |instants: i64| (instants / block).max(1) * block;
            let left = last - next + block;
            let instants = if alone { 1 } else { whole(most).min(whole(left)) };
            let unit = Unit { group, first: next, instants: instants as u32 };
            self.submit_unit(unit)?;
        } else {
            return Ok(false);
        }
        self.report.times.host_ms += milliseconds(started);
        Ok(true)
    }

    fn submit_unit(&mut self, unit: Unit) -> Result<(), EngineError> {
        let group = &mut self.groups[unit.group];
        if matches!(*self.context.trigger.walks[group.targets], WalkPasses::Host) {
            return self.submit_looks(unit);
        }
        let submitted = Instant::now();
        let feed = group.chain.as_mut().map(|chain| unit.feed(chain, &self.context.grid));
        if let Some(words) = feed.as_ref().filter(|words| words.len() as u64 > self.most_feed) {
            let Some(halves) = unit.halves(self.block) else {
                return Err(EngineError::Device(format!(
                    "noise may strike {} times in one instant, and this device's buffers hold {}; lower the rates of \
                     the sensor's noise, raise --rate, or render fewer cameras at once",
                    words.len() / STRIKE_WORDS as usize,
                    self.most_feed / u64::from(STRIKE_WORDS)
                )));
            };
            return halves.into_iter().try_for_each(|half| self.submit_unit(half));
        }
        let header = group.header_bytes();
        let mut slot = match self.free.iter().position(|s| s.fits(self.capacity, header)) {
            Some(index) => self.free.swap_remove(index),
            None => {
                // Smaller ones are from before the capacity grew.
                self.free.clear();
                Slot::new(&self.context.gpu.device, self.capacity, header)
            }
        };
        if let Some(words) = &feed {
            slot.feed(&self.context.gpu, words);
        }
        // Half as much again as the last one had: a second copy is needed only where events surge.
        let last = self.last_counts[group.targets];
        let predicted = (last / 2 * 3).saturating_add(4096).min(slot.capacity);
        let mut encoder = self.context.gpu.device.create_command_encoder(&Default::default());
        let audit = interval::encode(
            &mut self.context,
            &mut self.sampling,
            &mut encoder,
            &self.targets[group.targets],
            group,
            &unit,
            &slot,
            predicted,
        );
        let submission = self.context.gpu.queue.submit([encoder.finish()]);
        let mapped = map(&slot.staging);
        let audit = audit.map(|run| {
            let mapped = map(&run.staging);
            (run, mapped)
        });
        group.parity = 1 - group.parity;
        group.next = unit.first + i64::from(unit.instants);
        self.in_flight.push_back(InFlight {
            work: Work::Events { unit, slot, predicted, audit },
            submitted,
            submission,
            mapped,
        });
        Ok(())
    }

    /// Submits what the host feels for its pixels.
    fn submit_looks(&mut self, unit: Unit) -> Result<(), EngineError> {
        let submitted = Instant::now();
        let group = &mut self.groups[unit.group];
        let targets = &self.targets[group.targets];
        let mut encoder = self.context.gpu.device.create_command_encoder(&Default::default());
        // Every instant of every tile is sampled: there is nothing to audit.
        let _ = self.sampling.encode(&mut self.context, &mut encoder, targets, group, &unit);
        let looks = self.host_walk.encode(&self.context.gpu, &mut encoder, targets, group, unit)?;
        let submission = self.context.gpu.queue.submit([encoder.finish()]);
        let mapped = map(&looks.staging);
        group.next = unit.first + i64::from(unit.instants);
        self.in_flight.push_back(InFlight { work: Work::Looks(looks), submitted, submission, mapped });
        Ok(())
    }

    fn submit_label(&mut self) -> Result<(), EngineError> {
        let submitted = Instant::now();
        let Some(room) = &mut self.label_room else { return Ok(()) };
        let group = self.next_label_group;
        let (job, submission) =
            room.submit(&mut self.context, &self.groups[group], group, self.next_label, &self.label_grid);
        let mapped = map(&job.staging);
        self.in_flight.push_back(InFlight { work: Work::Labels(job), submitted, submission, mapped });
        self.next_label_group += 1;
        if self.next_label_group == self.groups.len() {
            self.next_label_group = 0;
            self.next_label += 1;
        }
        Ok(())
    }

    /// Waits for the oldest submission and takes what it brought.
    fn collect_oldest(&mut self) -> Result<(), EngineError> {
        let Some(oldest) = self.in_flight.pop_front() else {
            return Err(EngineError::Device("nothing is in flight, and the interval is not complete".into()));
        };
        let waiting = Instant::now();
        self.wait(&oldest)?;
        self.report.times.device_wait_ms += milliseconds(waiting);
        // The device works in order: on this one since it was submitted, or since the one before it was done.
        let began = self.collected.map_or(oldest.submitted, |done| done.max(oldest.submitted));
        self.collected = Some(Instant::now());
        if let Work::Events { unit, .. } | Work::Looks(Looks { unit, .. }) = &oldest.work {
            self.instant_ms = 0.5 * (self.instant_ms + milliseconds(began) / f64::from(unit.instants));
        }
        match oldest.work {
            Work::Events { unit, slot, predicted, audit } => {
                if self.take_events(unit, slot, predicted)?
                    && let Some((run, mapped)) = audit
                {
                    wait_mapped(&self.context.gpu, &oldest.submission, &mapped)?;
                    self.take_audit(&run)?;
                }
                Ok(())
            }
            Work::Looks(looks) => self.take_looks(looks),
            Work::Labels(job) => {
                let packing = Instant::now();
                let room = self.label_room.as_mut();
                let label = job.index;
                let last_group = job.group + 1 == self.groups.len();
                if let Some(room) = room {
                    for (view, labels) in room.take(&self.context, &self.groups[job.group], job)? {
                        self.arrived[view].labels.extend(labels);
                    }
                }
                if last_group {
                    self.labels_complete = label + 1;
                }
                self.report.times.pack_ms += milliseconds(packing);
                Ok(())
            }
        }
    }

    fn wait(&self, flight: &InFlight) -> Result<(), EngineError> {
        wait_mapped(&self.context.gpu, &flight.submission, &flight.mapped)
    }

    /// Reports what audits found.
    fn take_audit(&mut self, run: &AuditRun) -> Result<(), EngineError> {
        let failed = |e: wgpu::MapRangeError| EngineError::Device(format!("cannot read audits back: {e}"));
        let words: Vec<u32> = {
            let bytes = run.staging.get_mapped_range(..).map_err(failed)?;
            bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()
        };
        run.staging.unmap();
        self.report.audited += run.entries.len() as u64;
        self.report.audited_with_others += run.entries.iter().filter(|e| e.other_samples).count() as u64;
        for (entry, change, pixel) in run.changes(&words) {
            let view = &self.context.views[entry.view];
            if change <= 0.5 * view.sensor.threshold_on.min(view.sensor.threshold_off) {
                continue;
            }
            self.report.changed += 1;
            let scene = &self.context.scene;
            self.report.findings.push(Finding {
                environment: view.environment,
                camera: scene
                    .cameras
                    .iter()
                    .find(|c| c.node == view.node)
                    .map_or_else(String::new, |c| c.name.clone()),
                pixel,
                t_us: entry.t_us,
                object: entry.node.map(|node| scene.nodes[node].name.clone()),
                skipped: entry.skipped,
                other_samples: entry.other_samples,
                change,
            });
        }
        Ok(())
    }

    /// Takes a submission's events; false where it has to run again.
    fn take_events(&mut self, unit: Unit, slot: Slot, predicted: u32) -> Result<bool, EngineError> {
        let packing = Instant::now();
        let group = &self.groups[unit.group];
        let header = group.header_bytes();
        let failed = |e: wgpu::MapRangeError| EngineError::Device(format!("cannot read events back: {e}"));
        let (status, offsets) = {
            let bytes = slot.staging.get_mapped_range(0..header).map_err(failed)?;
            let status: Status = bytemuck::pod_read_unaligned(&bytes[..size_of::<Status>()]);
            let offsets: Vec<u32> = bytes[size_of::<Status>()..]
                .chunks_exact(4)
                .take(group.views.len() + 1)
                .map(bytemuck::pod_read_unaligned)
                .collect();
            (status, offsets)
        };
        if status.mismatched > 0 {
            return Err(EngineError::Device(format!(
                "{} pixels fired other events than were counted: the driver computes the same expression in two \
                 ways; please report device and driver",
                status.mismatched
            )));
        }
        if status.stalled != 0 {
            slot.staging.unmap();
            return self.recover(unit, status.event_count).map(|()| false);
        }
        let count = status.event_count;
        if count > predicted {
            self.fetch_rest(&slot, header, predicted, count)?;
        }
        let base_us = unit.base_us(&self.context.grid);
        let span_us = (unit.end_us(&self.context.grid) - base_us) as u32;
        {
            let end = header + u64::from(count) * 8;
            let bytes;
            let records: &[[u32; 2]] = if count == 0 {
                &[]
            } else {
                bytes = slot.staging.get_mapped_range(header..end).map_err(failed)?;
                bytemuck::try_cast_slice(&bytes)
                    .map_err(|e| EngineError::Device(format!("events came back misaligned: {e}")))?
            };
            let group = &mut self.groups[unit.group];
            let end_us = unit.end_us(&self.context.grid);
            match group.chain.as_mut().filter(|chain| !chain.wires.is_empty()) {
                None => {
                    let views = group.views.iter().copied();
                    unpack::views(records, &offsets, base_us, span_us, self.caused, views, |v, e| {
                        unpack::append(&mut self.arrived[v].events, e)
                    })
                }
                Some(chain) => {
                    let parts = offsets.windows(2).map(|w| &records[w[0] as usize..w[1] as usize]);
                    for ((wire, records), v) in chain.wires.iter_mut().zip(parts).zip(&group.views) {
                        let mut fired = unpack::events(records, base_us, self.caused);
                        self.report.dropped += wire.pass(&mut fired, end_us, &mut self.arrived[*v].events);
                    }
                }
            }
        }
        slot.staging.unmap();
        self.free.push(slot);
        self.complete_us[unit.group] = unit.end_us(&self.context.grid);
        let group = &mut self.groups[unit.group];
        self.last_counts[group.targets] = count;
        self.report.clamped += u64::from(status.clamped.wrapping_sub(group.clamped));
        group.clamped = status.clamped;
        self.report.unknown += u64::from(status.unknown.wrapping_sub(group.unknown));
        group.unknown = status.unknown;
        self.report.suppressed += u64::from(status.suppressed.wrapping_sub(group.suppressed));
        group.suppressed = status.suppressed;
        self.report.instants += u64::from(unit.instants);
        self.report.times.pack_ms += milliseconds(packing);
        Ok(true)
    }

    /// Lets the host's pixels feel what a submission brought.
    fn take_looks(&mut self, looks: Looks) -> Result<(), EngineError> {
        let packing = Instant::now();
        let unit = looks.unit;
        let group = &self.groups[unit.group];
        for felt in self.host_walk.take(&self.context, &self.targets[group.targets], group, looks)? {
            self.arrived[felt.view].events.extend(felt.events);
            self.report.clamped += felt.report.clamped;
            self.report.unknown += felt.report.unknown;
            self.report.suppressed += felt.report.suppressed;
            self.report.dropped += felt.report.dropped;
        }
        let exposure = &self.context.views[group.views[0]].sensor.exposure;
        self.complete_us[unit.group] = exposure.known_us(unit.end_us(&self.context.grid));
        self.report.instants += u64::from(unit.instants);
        self.report.times.pack_ms += milliseconds(packing);
        Ok(())
    }

    /// More events came than were predicted: copies the rest too.
    fn fetch_rest(&self, slot: &Slot, header: u64, have: u32, count: u32) -> Result<(), EngineError> {
        slot.staging.unmap();
        let mut encoder = self.context.gpu.device.create_command_encoder(&Default::default());
        let (from, bytes) = (u64::from(have) * 8, u64::from(count - have) * 8);
        encoder.copy_buffer_to_buffer(&slot.events, from, &slot.staging, header + from, bytes);
        let submission = self.context.gpu.queue.submit([encoder.finish()]);
        let mapped = map(&slot.staging);
        wait_mapped(&self.context.gpu, &submission, &mapped)
    }

    /// A submission had more events than its buffer holds: nothing was written by it nor by those of its group
    /// that followed. Enlarges the buffers, or splits the submission, and runs them again.
    fn recover(&mut self, unit: Unit, needed: u32) -> Result<(), EngineError> {
        let mut again = vec![unit];
        let mut others = VecDeque::new();
        for flight in std::mem::take(&mut self.in_flight) {
            match &flight.work {
                Work::Events { unit: later, slot, .. } if later.group == unit.group => {
                    self.wait(&flight)?;
                    slot.staging.unmap();
                    again.push(*later);
                }
                _ => others.push_back(flight),
            }
        }
        self.in_flight = others;
        self.report.reruns += again.len() as u64;
        if needed > self.most_capacity {
            let Some(halves) = unit.halves(self.block) else {
                return Err(EngineError::Device(format!(
                    "{needed} events in one instant, and this device's buffers hold {}; raise --rate or the \
                     thresholds, or render fewer cameras at once",
                    self.most_capacity
                )));
            };
            again.splice(0..1, halves);
        } else {
            self.capacity = needed.saturating_add(needed / 4).next_power_of_two().min(self.most_capacity);
        }
        let group = &mut self.groups[unit.group];
        // Every submission flipped it, and none took effect.
        let flips = again.len() - usize::from(needed > self.most_capacity);
        group.parity = (group.parity + flips) % 2;
        group.next = unit.first;
        group.clamped = 0;
        group.unknown = 0;
        group.suppressed = 0;
        self.context.gpu.queue.write_buffer(&group.status, 0, bytemuck::bytes_of(&Status::default()));
        for unit in again {
            self.submit_unit(unit)?;
        }
        // The queue of flights is in submission order again, and the oldest of this group is first of its kind.
        Ok(())
    }

    fn evaluate_poses(&mut self, until_us: i64) {
        let mut t = self.label_grid.instant_us(self.next_pose);
        while t < until_us {
            let time_s = self.context.scene_time_s(t);
            let mut environment = usize::MAX;
            for (view, arrived) in self.context.views.iter().zip(&mut self.arrived) {
                if view.environment != environment {
                    environment = view.environment;
                    let scene = &self.context.scene;
                    scene.evaluate_variant(scene.variants.get(environment), time_s, &mut self.pose_state);
                }
                let world = rigid(&self.pose_state.world_from_node[view.node]);
                let (_, rotation, position) = world.to_scale_rotation_translation();
                arrived.poses.push(PoseSample {
                    t_us: t,
                    position: position.to_array(),
                    rotation: rotation.to_array(),
                });
            }
            self.next_pose += 1;
            t = self.label_grid.instant_us(self.next_pose);
        }
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        // Nothing of ours may still run when the caller's device is handed on.
        let _ = self.context.gpu.device.poll(wgpu::PollType::wait_indefinitely());
    }
}

/// Events that buffers hold at first: blocks of instants bring many at once, and running them again is dear.
fn first_capacity(groups: &[Group], targets: &[Targets], block: u32) -> u32 {
    let pixels = |group: &Group| {
        let targets = &targets[group.targets];
        u64::from(targets.width) * u64::from(targets.height) * group.views.len() as u64
    };
    let most = groups.iter().map(pixels).max().unwrap_or(0);
    let events = if block > 1 { EVENTS_PER_PIXEL * most } else { 0 };
    (events.min(1 << 24) as u32).max(FIRST_CAPACITY)
}

/// Views that are alike, in order of first appearance: they share targets and passes.
pub(crate) fn classes(views: &[View]) -> Vec<Vec<usize>> {
    let mut classes: Vec<Vec<usize>> = Vec::new();
    for (index, view) in views.iter().enumerate() {
        match classes.iter_mut().find(|of| views[of[0]].is_alike(view)) {
            Some(members) => members.push(index),
            None => classes.push(vec![index]),
        }
    }
    classes
}

/// Asks for `buffer` to be mapped once the work submitted so far is done.
pub(crate) fn map(buffer: &wgpu::Buffer) -> Receiver<Result<(), wgpu::BufferAsyncError>> {
    let (send, receive) = channel();
    buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| {
        // The receiver is gone only when the engine is.
        let _ = send.send(result);
    });
    receive
}

/// Waits until `submission` is done and its buffer mapped.
pub(crate) fn wait_mapped(
    gpu: &Gpu,
    submission: &wgpu::SubmissionIndex,
    mapped: &Receiver<Result<(), wgpu::BufferAsyncError>>,
) -> Result<(), EngineError> {
    loop {
        match mapped.try_recv() {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(e)) => return Err(EngineError::Device(format!("cannot map what came back: {e}"))),
            Err(TryRecvError::Empty) => {
                gpu.device.poll(wgpu::PollType::Wait {
                    submission_index: Some(submission.clone()),
                    timeout: None,
                })?;
            }
            Err(TryRecvError::Disconnected) => {
                return Err(EngineError::Device(
                    "the device was lost; run again, or choose another --device".into(),
                ));
            }
        }
    }
}

/// `Y_ref` that brings the log-mean of the first camera's lit pixels at the start to 0.18 (Reinhard's middle grey).
fn measure_reference(context: &mut Context, samples: u32, made: LayerUse) -> Result<f32, EngineError> {
    let Some(lens) = context.views.first().map(|view| view.lens) else { return Ok(1.0) };
    let layers = Layers::new(&context.gpu.device, lens.width, lens.height, samples, made);
    let image = mean_luminance(context, &layers, 0, 0)?;
    let (mut sum, mut lit) = (0.0, 0u64);
    for luminance in image {
        if luminance > 0.0 && luminance.is_finite() {
            sum += luminance.ln();
            lit += 1;
        }
    }
    if lit == 0 {
        return Ok(1.0);
    }
    let reference = ((sum / lit as f64).exp() / 0.18) as f32;
    Ok(if reference.is_finite() && reference > 0.0 { reference } else { 1.0 })
}

/// Renders view `view` at stream time `t_us` and reads it back: mean over the samples, row-major from the top.
pub(crate) fn mean_luminance(
    context: &mut Context,
    layers: &Layers,
    view: usize,
    t_us: i64,
) -> Result<Vec<f64>, EngineError> {
    let view = [context.views[view].clone()];
    let frame_group = context.upload_frames(&view, &[t_us]);
    let device = &context.gpu.device;
    let mut encoder = device.create_command_encoder(&Default::default());
    MovingShadows::new(&frame_group, &view, 1).show(context, &mut encoder, 0, 0);
    interval::encode_luminance(context, &mut encoder, layers, &frame_group, 0, 0, None);
    read_mean(context, encoder, layers)
}

/// Runs `encoder` and reads the mean over the samples in `layers` back, row-major from the top.
pub(crate) fn read_mean(
    context: &Context,
    encoder: wgpu::CommandEncoder,
    layers: &Layers,
) -> Result<Vec<f64>, EngineError> {
    let samples = context.offsets.len();
    let read = read_layers(context, encoder, layers, samples as u32)?;
    let pixels = layers.width as usize * layers.height as usize;
    let mean = |p: usize| read.iter().map(|layer| f64::from(layer[p])).sum::<f64>() / samples as f64;
    Ok((0..pixels).map(mean).collect())
}

/// Runs `encoder` and reads the first `count` of `layers` back, each row-major from the top.
fn read_layers(
    context: &Context,
    mut encoder: wgpu::CommandEncoder,
    layers: &Layers,
    count: u32,
) -> Result<Vec<Vec<f32>>, EngineError> {
    let staging = context.gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("luminance for the host"),
        size: layers.host_bytes(count),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    layers.encode_read(&mut encoder, &staging, count);
    let submission = context.gpu.queue.submit([encoder.finish()]);
    let mapped = map(&staging);
    wait_mapped(&context.gpu, &submission, &mapped)?;
    let bytes = staging
        .get_mapped_range(..)
        .map_err(|e| EngineError::Device(format!("cannot read the luminance back: {e}")))?;
    let pixels = |row: &[u8]| -> Vec<f32> {
        row.chunks_exact(4).take(layers.width as usize).map(bytemuck::pod_read_unaligned).collect()
    };
    Ok(bytes
        .chunks_exact(layers.host_bytes(1) as usize)
        .map(|layer| layer.chunks_exact(row_bytes(layers.width) as usize).flat_map(pixels).collect())
        .collect())
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

impl StageTimes {
    /// Adds another packet's.
    pub fn add(&mut self, other: &Self) {
        self.host_ms += other.host_ms;
        self.device_wait_ms += other.device_wait_ms;
        self.pack_ms += other.pack_ms;
        self.total_ms += other.total_ms;
    }
}
