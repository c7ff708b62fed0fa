//! Preparing an engine: everything on the device that lasts as long as it.

use std::collections::VecDeque;
use std::sync::Arc;

use evis_core::{LabelKind, SensorConfig, TimeGrid, WarpVariant, luminance};
use evis_scene::{Scene, SceneState};

use crate::config::{Antialias, Method, RunConfig};
use crate::error::EngineError;
use crate::frame::FrameData;
use crate::frame::pattern;
use crate::frame::upload::FrameBuffers;
use crate::gpu::Gpu;
use crate::gpu::sizes::{self, DeviceLimits, MethodNeeds};
use crate::gpu::variant::LightSet;
use crate::output::frames::FrameRenderer;
use crate::output::labels::LabelRenderer;
use crate::output::packet::PacketReport;
use crate::output::poses::CameraPoses;
use crate::pass::raster::{self, SceneConstants, SurfaceLayouts};
use crate::pass::{self, sky};
use crate::raster::context::Context;
use crate::raster::layers::LayerUse;
use crate::raster::readback::measure_reference;
use crate::raster::resample::Resampler;
use crate::raster::shadow_maps::ShadowMaps;
use crate::raster::shadows::draw_still_maps;
use crate::sampling::Sampling;
use crate::sampling::adaptive::AdaptiveSampler;
use crate::sampling::native::NativeSampler;
use crate::sampling::splat::{self, SplatSampler};
use crate::sensor::chain::{ChainPlan, GroupChain};
use crate::sensor::dense::DenseArrays;
use crate::sensor::group::Group;
use crate::sensor::host::HostWalk;
use crate::sensor::passes::{Blocks, TriggerPasses, share_passes};
use crate::sensor::targets::Targets;
use crate::world::gpu_scene::GpuScene;
use crate::world::view::View;

use super::{Arrived, Engine, SUBMISSION_MS};

/// Events that a submission's buffer holds at first.
const FIRST_CAPACITY: u32 = 1 << 18;

/// The same, per pixel, where submissions are whole blocks.
const EVENTS_PER_PIXEL: u64 = 4;

impl Engine {
    /// Prepares everything; `config` gets its reference luminance filled in.
    pub fn new(
        gpu: &Gpu,
        scene: Arc<Scene>,
        views: Vec<View>,
        config: &mut RunConfig,
    ) -> Result<Self, EngineError> {
        let _span = tracing::trace_span!("build engine", views = views.len()).entered();
        let device_limits = DeviceLimits::of(&gpu.device);
        let samples = Samples::new(config);
        let classes = classes(&views);
        // The scene on the device, its shadows, and the pipelines that draw it.
        let (mut context, constants) = context(gpu, scene, views, config, &samples)?;
        context.resamplers = resamplers(&context, &samples, device_limits)?;
        draw_still_maps(&mut context)?;
        let label_renderer = LabelRenderer::new(
            &gpu.device,
            &context.layouts,
            &context.scene,
            &context.gpu_scene,
            &context.views,
            config,
            &constants,
            device_limits,
        )?;
        // What becomes of luminance, by class of views.
        let passes = trigger_passes(&context, config, &samples, &classes);
        // How instants are sampled, and where their luminance goes.
        let mut sampling = sampling(&context, config, &samples, &constants);
        let (targets, members) =
            targets(&context, config, &samples, &passes, &mut sampling, classes, device_limits)?;
        // The luminance that pixels count from.
        let reference = match config.reference_luminance {
            Some(value) => value,
            None => measure_reference(&mut context, samples.count(), samples.rendered)?,
        };
        config.reference_luminance = Some(reference);
        context.reference_luminance = reference;
        // Pixel memory, and buffers for events.
        let groups = groups(&context, &passes, &targets, members);
        let buffer = gpu.device.limits().max_buffer_size;
        let most_capacity = (device_limits.storage_binding / 8).min(buffer / 8 - 4096).min(1 << 28) as u32;
        let block = config.block();
        let caused = config.labels.contains(&LabelKind::Cause);
        let dense = config.dense.filter(|_| config.method != Method::Decoupled).and_then(|output| {
            let longest_us = context.grid.longest_interval_us() * f64::from(block);
            let groups: Vec<&Group> = groups.iter().collect();
            DenseArrays::new(gpu, output, longest_us, &passes, &targets, &groups)
        });
        Ok(Self {
            caused,
            dense,
            sampling,
            label_renderer,
            frame_renderer: FrameRenderer::new(&context, config, samples.rendered)?,
            host_walk: HostWalk::new(&context.views, reference, caused)?,
            label_grid: TimeGrid::new(config.label_rate_hz)?,
            block,
            in_flight: VecDeque::new(),
            free: Vec::new(),
            capacity: first_capacity(&groups, &targets, block).min(most_capacity),
            most_capacity,
            // Buffers for them are half as long again.
            most_feed: device_limits.storage_binding / 4 * 2 / 3 - 4,
            last_counts: vec![0; targets.len()],
            // Unknown: begins with two instants.
            instant_ms: SUBMISSION_MS / 2.0,
            collected: None,
            complete_us: vec![0; groups.len()],
            clipped_until: vec![i64::MIN; groups.len()],
            next_label: 0,
            next_label_group: 0,
            labels_complete: 0,
            arrived: context.views.iter().map(|_| Arrived::default()).collect(),
            delivered_us: 0,
            report: PacketReport::default(),
            poses: CameraPoses::new(TimeGrid::new(config.label_rate_hz)?, config.start_us),
            fires: config.method != Method::Decoupled,
            stop: Arc::default(),
            targets,
            groups,
            passes,
            context,
        })
    }
}

/// How samples of a pixel become its luminance.
struct Samples {
    /// Offsets in pixels; one where samples lie on a grid of coverage samples.
    offsets: Vec<[f32; 2]>,
    /// Places along each side of a pixel at which coverage samples are taken; 1 without them.
    grid: u32,
    /// How a layer is rendered.
    rendered: LayerUse,
    /// Layers of an instant that the trigger averages.
    layers: u32,
    /// How these come to be.
    made: LayerUse,
}

impl Samples {
    fn new(config: &RunConfig) -> Self {
        let coverage = config.antialias == Antialias::Edges;
        let offsets = if coverage { vec![[0.0, 0.0]] } else { pattern::offsets(config.samples) };
        let grid = config.coverage_grid();
        let rendered = if coverage { LayerUse::Resolved(grid) } else { LayerUse::Rendered };
        let (layers, made) = match (&config.method, config.adaptive_px) {
            (Method::Splat(_), _) | (Method::Native, Some(_)) => (1, LayerUse::Computed),
            (Method::Decoupled, _) | (_, None) => (offsets.len() as u32, rendered),
        };
        Self { offsets, grid, rendered, layers, made }
    }

    /// Layers of an instant of `view`, and how they come to be.
    fn of(&self, view: &View) -> (u32, LayerUse) {
        if view.distorted.is_some() { (1, LayerUse::Computed) } else { (self.layers, self.made) }
    }

    fn count(&self) -> u32 {
        self.offsets.len() as u32
    }

    /// Coverage samples that the rasteriser takes.
    const fn rasterized(&self) -> u32 {
        if matches!(self.rendered, LayerUse::Resolved(_)) { 4 } else { 1 }
    }
}

/// The scene on the device at the start of the run, and what draws it.
fn context(
    gpu: &Gpu,
    scene: Arc<Scene>,
    views: Vec<View>,
    config: &RunConfig,
    samples: &Samples,
) -> Result<(Context, SceneConstants), EngineError> {
    let device = &gpu.device;
    let mut state = SceneState::default();
    scene.evaluate_variant(scene.variants.first(), config.start_us as f64 * 1e-6, &mut state);
    let layouts = SurfaceLayouts::new(device);
    let gpu_scene = GpuScene::new(device, &gpu.queue, &layouts, &scene, &state);
    let shadows = ShadowMaps::new(device, &layouts, &scene, &gpu_scene, config)?;
    let occluders = shadows.as_ref().and_then(|s| s.occluders.as_ref());
    let constants = SceneConstants {
        lights: LightSet::new(&scene, |node| shadows.as_ref()?.plan.layer_of(node)),
        shadows: shadows.is_some(),
        shadow_rays: occluders.is_some(),
        environment: scene.environment.is_some(),
        texture_samples: raster::texture_samples(samples.count(), samples.grid),
        grid: samples.grid,
        texture_taps: config.taps(),
    };
    let rasterized = samples.rasterized();
    let variants = gpu_scene.variants().into_iter();
    let luminance_pipelines = raster::luminance_pipelines(device, &layouts, variants, &constants, rasterized);
    let visible = scene.environment.as_ref().is_some_and(|e| e.visible);
    let sky = visible.then(|| {
        let target = [Some(raster::LUMINANCE_FORMAT.into())];
        sky::pipeline(device, &layouts, "fs_luminance", &target, rasterized, constants.lights.count)
    });
    let shadow_maps = shadows.as_ref().map_or_else(|| ShadowMaps::empty(device), |maps| maps.array.clone());
    let trees = occluders.map_or(&[][..], |o| &o.words);
    let surroundings = gpu_scene.surroundings.group(device, &layouts, &shadow_maps, trees);
    let background_luminance = luminance::luminance(scene.background.map(f64::from));
    let other_offsets = pattern::others(&samples.offsets);
    // A picture that is moved by an offset is sampled at the opposite place.
    let shares = [&samples.offsets, &other_offsets].map(|offsets| {
        let places: Vec<[f32; 2]> = offsets.iter().map(|o| o.map(|v| -v)).collect();
        pattern::shares(&places)
    });
    let context = Context {
        gpu: gpu.clone(),
        resolve: pass::trigger::resolve(device, samples.grid),
        gpu_scene,
        layouts,
        views,
        grid: config.sample_grid()?,
        start_us: config.start_us,
        offsets: samples.offsets.clone(),
        other_offsets,
        luminance: luminance_pipelines,
        sky,
        background: sky::background(device, background_luminance, rasterized),
        resamplers: Vec::new(),
        surroundings,
        background_luminance,
        reference_luminance: 1.0,
        shadows,
        frame_data: FrameData::default(),
        skips_still: true,
        frame_buffers: FrameBuffers::new(device, constants.lights.count, &shares.concat()),
        scene,
    };
    Ok((context, constants))
}

/// What renders the distorted lenses of the views.
fn resamplers(
    context: &Context,
    samples: &Samples,
    limits: DeviceLimits,
) -> Result<Vec<Resampler>, EngineError> {
    let mut found: Vec<Resampler> = Vec::new();
    for view in &context.views {
        let Some(own) = view.distorted.as_ref().filter(|own| found.iter().all(|of| of.camera != **own))
        else {
            continue;
        };
        let device = &context.gpu.device;
        let resampler = Resampler::new(device, Arc::clone(own), &samples.offsets, samples.rendered, limits)?;
        found.push(resampler);
    }
    Ok(found)
}

fn trigger_passes(
    context: &Context,
    config: &RunConfig,
    samples: &Samples,
    classes: &[Vec<usize>],
) -> TriggerPasses {
    let views = classes.iter().map(|of| &context.views[of[0]]);
    let sensors: Vec<(&SensorConfig, u32)> = views.map(|view| (&view.sensor, samples.of(view).0)).collect();
    let unknown = matches!(&config.method, Method::Splat(warp) if warp.variant == WarpVariant::Splat);
    let blocks = Blocks { instants: config.block(), between: config.between };
    let dense = config.dense.as_ref().map(|output| &output.kind);
    TriggerPasses::new(&context.gpu.device, &sensors, unknown, blocks, dense)
}

fn sampling(
    context: &Context,
    config: &RunConfig,
    samples: &Samples,
    constants: &SceneConstants,
) -> Sampling {
    match (&config.method, config.adaptive_px) {
        (Method::Splat(splat), _) => Sampling::Splat(Box::new(SplatSampler::new(context, constants, splat))),
        (Method::Native, Some(step_px)) => {
            let (block, rendered) = (config.block(), samples.rendered);
            Sampling::Adaptive(Box::new(AdaptiveSampler::new(
                context,
                step_px,
                block,
                rendered,
                config.audit,
            )))
        }
        (Method::Decoupled, _) | (_, None) => Sampling::Native(NativeSampler::default()),
    }
}

/// Views that share a submission: their class, and their indices.
type Member = (usize, Vec<usize>);

/// Targets of each class of views, and which views share submissions.
fn targets(
    context: &Context,
    config: &RunConfig,
    samples: &Samples,
    passes: &TriggerPasses,
    sampling: &mut Sampling,
    classes: Vec<Vec<usize>>,
    limits: DeviceLimits,
) -> Result<(Vec<Targets>, Vec<Member>), EngineError> {
    let block = config.block();
    // Pictures are drawn so many times as large along each side.
    let limits = DeviceLimits { texture_edge: limits.texture_edge / samples.grid, ..limits };
    let (mut targets, mut members) = (Vec::new(), Vec::new());
    for (class, views) in classes.into_iter().enumerate() {
        let (width, height) = context.views[views[0]].size();
        let (layers, made) = samples.of(&context.views[views[0]]);
        let needs = match &config.method {
            Method::Native | Method::Decoupled => MethodNeeds { block, ..Default::default() },
            Method::Splat(splat) => SplatSampler::needs(splat, width, height, &limits)
                .ok_or_else(|| splat::does_not_fit(splat, width, height, &limits))?,
        };
        let chain = passes.chain(class).map(|passes| &passes.plan);
        let (needs, most) = match chain {
            None => (needs, sizes::MAX_INSTANTS),
            Some(chain) => {
                let bytes = needs.bytes.max(chain.view_bytes(width, height));
                let layers = needs.layers.max(chain.planes.count);
                let longest_us = context.grid.longest_interval_us();
                (MethodNeeds { bytes, layers, ..needs }, ChainPlan::most_instants(longest_us))
            }
        };
        let count = views.len() as u32;
        let plan = sizes::plan(width, height, layers, count, most, needs, limits).ok_or_else(|| {
            EngineError::Device(format!(
                "{width}x{height} pixels with {} samples do not fit this device \
                     (edge {}, layers {}, binding {} bytes); choose a smaller `size` or fewer `samples`",
                config.samples, limits.texture_edge, limits.texture_layers, limits.storage_binding
            ))
        })?;
        let own = Targets::new(&context.gpu.device, width, height, plan, made, chain, block);
        match sampling {
            Sampling::Splat(sampler) => sampler.add_class(context, &own, samples.rendered),
            Sampling::Adaptive(sampler) => sampler.add_class(context, &own),
            Sampling::Native(_) => {}
        }
        targets.push(own);
        members.extend(views.chunks(plan.views_per_group as usize).map(|chunk| (class, chunk.to_vec())));
    }
    Ok((targets, members))
}

fn groups(
    context: &Context,
    passes: &TriggerPasses,
    targets: &[Targets],
    members: Vec<Member>,
) -> Vec<Group> {
    let reference = context.reference_luminance;
    let group = |(class, views): Member| {
        let sensors = context.view_sensors(&views);
        let chain = passes.chain(class).map(|passes| {
            let size = [targets[class].width, targets[class].height];
            let own: Vec<_> = views.iter().map(|&v| context.views[v].sensing()).collect();
            (passes, GroupChain::new(&context.gpu, &passes.plan, size, &own, reference))
        });
        Group::new(&context.gpu, class, &targets[class], views, &sensors, chain)
    };
    members.into_iter().map(group).collect()
}

/// Events that buffers hold at first: blocks of instants bring many at once, and running them again is expensive.
fn first_capacity(groups: &[Group], targets: &[Targets], block: u32) -> u32 {
    let pixels = |group: &Group| {
        let targets = &targets[group.targets];
        u64::from(targets.width) * u64::from(targets.height) * group.views.len() as u64
    };
    let most = groups.iter().map(pixels).max().unwrap_or(0);
    let events = if block > 1 { EVENTS_PER_PIXEL * most } else { 0 };
    (events.min(1 << 24) as u32).max(FIRST_CAPACITY)
}

/// Views that share targets, passes and submissions, in order of first appearance.
pub(crate) fn classes(views: &[View]) -> Vec<Vec<usize>> {
    let mut classes: Vec<Vec<usize>> = Vec::new();
    for (index, view) in views.iter().enumerate() {
        let alike = |of: &&mut Vec<usize>| {
            let first = &views[of[0]];
            first.shares_targets(view) && share_passes(&first.sensor, &view.sensor)
        };
        match classes.iter_mut().find(alike) {
            Some(members) => members.push(index),
            None => classes.push(vec![index]),
        }
    }
    classes
}
