//! The whole sensor chain on the device: which stages a pipeline has, what a pixel remembers, and what the host hands
//! over: what is frozen, and noise candidates.

use evis_core::emulator::parts::{FixedPattern, NoiseSampler, ReadoutQueue};
use evis_core::random::Key;
use evis_core::sensor::{
    Bandwidth, Curve, FilterRule, LeakLaw, NoiseReference, RefractoryRule, SensorConfig, Start, Times,
    TriggerRule,
};
use rayon::prelude::*;

use crate::config::OLD_US;
use crate::gpu::Gpu;
use crate::gpu::sizes::{BLOCK_PIXELS, MAX_INSTANTS, WORKGROUP, padded_pixels, row_stride};
use crate::gpu::texture::{array, whole};
use crate::gpu::uniforms::{ChainSensor, ChainStep};
use crate::pass::trigger::{CHAIN_BINDINGS, KEPT_BINDINGS};
use crate::pass::{ComputePass, part};

/// Words of a view at the start of `frozen`; `chain/layout.wgsl` has the same constant.
pub const VIEW_WORDS: u32 = 12;

/// The first of them that is of a view's block, where pixels have times of their own; `chain/own_times.wgsl` has the same constant.
pub const BLOCK_WORD: usize = 8;

/// Words of a candidate; `chain/layout.wgsl` has the same constant.
pub const CANDIDATE_WORDS: u32 = 3;

/// Events of a pixel that counting keeps for emitting.
const KEPT_EVENTS: u32 = 4;

/// Words that a view's pixels count in together; `chain/layout.wgsl` has the same constant.
pub const TALLY_WORDS: u32 = 2 * MAX_INSTANTS + 1;

/// Workgroups along a list of pixels, per view: each takes what its turn leaves over.
const LIST_WORKGROUPS: u32 = 64;

/// The constant of light that is known at times of each pixel's own.
const OWN_TIMES: &str = "OWN_TIMES";

/// In place of infinity, which WGSL has not.
const NEVER: f32 = 3.0e38;

/// Bytes from one [`ChainStep`] to the next: what every device can bind at.
const STEP_STRIDE: u64 = 256;

/// The pixel's memory, in planes: layer `plane * views + view`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Planes {
    /// How many there are; the reference has the first.
    pub count: u32,
    /// Signal before the filter; 0 where it is not kept, as all below.
    pub input: u32,
    /// First pole.
    pub first: u32,
    /// Second pole.
    pub second: u32,
    /// Light.
    pub light: u32,
    /// When the reference moved.
    pub moved: u32,
    /// Slope of the leak since then.
    pub slope: u32,
    /// When the pixel fired, and its polarity.
    pub fired: u32,
}

/// A sensor as its pipeline is specialised for it.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainPlan {
    /// What a pixel remembers.
    pub planes: Planes,
    /// WGSL's override constants.
    pub constants: Vec<(&'static str, f64)>,
    /// Numbers of the stages.
    pub sensor: ChainSensor,
    /// Whether thresholds differ from pixel to pixel.
    own_thresholds: bool,
    /// Whether slopes of the leak do.
    own_slopes: bool,
    /// Whether an instant's events depend on the busiest pixel's number, and the next instant's on them.
    pub sequential: bool,
    /// Events of a pixel that counting keeps for emitting.
    pub kept: u32,
}

impl ChainPlan {
    /// For `samples` layers per instant; `unknown`: whether a luminance below 0 stands for one that is not known; `block`:
    /// instants of a block within which tiles have rates of their own, 1 without.
    pub fn new(sensor: &SensorConfig, samples: u32, unknown: bool, block: u32) -> Self {
        let (receptor, noise) = (&sensor.photoreceptor, &sensor.noise);
        let filter = match (receptor.cutoff_hz > 0.0, receptor.filter, receptor.order) {
            (false, ..) => 0,
            (true, FilterRule::Euler, _) => 1,
            (true, FilterRule::Exact, 1) => 2,
            (true, FilterRule::Exact, _) => 3,
        };
        let light_bandwidth = filter > 0 && receptor.bandwidth == Bandwidth::Light;
        let ramp = noise.leak_hz > 0.0 && noise.leak_law == LeakLaw::Ramp;
        let poisson_leak = noise.leak_hz > 0.0 && !ramp;
        let hot = noise.hot_share > 0.0 && noise.hot_hz > 0.0;
        let shot = noise.shot_hz > 0.0;
        let light_latency = sensor.readout.latency_light_us > 0.0;
        let own_thresholds =
            [sensor.pattern.sigma, sensor.pattern.dead_share, sensor.pattern.sensitive_share]
                .iter()
                .any(|share| *share > 0.0);
        let refractory = match (sensor.refractory.period_us, sensor.refractory.rule) {
            (0, _) => 0,
            (_, RefractoryRule::Suppress) => 1,
            (_, RefractoryRule::Defer) => 2,
            (_, RefractoryRule::Hold) => 3,
        };
        let latch = sensor.trigger == TriggerRule::Latch;
        let times = match sensor.times {
            Times::Crossing => 0,
            Times::Sample => 1,
            Times::Even => 2,
            Times::Shared => 3,
        };
        let alternates = shot && noise.alternation >= 0.0;
        // What is not read is not kept.
        let mut planes = Planes { count: 1, ..Planes::default() };
        let mut keep = |wanted: bool| {
            planes.count += u32::from(wanted);
            if wanted { planes.count - 1 } else { 0 }
        };
        let thins = shot && noise.shot_light_share > 0.0;
        let two_poles = filter > 0 && receptor.order == 2;
        let (input, first, second) = (keep(filter != 1 || unknown), keep(filter > 0), keep(two_poles));
        let light = keep(thins || light_latency || (light_bandwidth && (filter > 1 || unknown)));
        let (moved, slope) = (keep(ramp), keep(ramp && noise.leak_jitter > 0.0));
        let fired = keep(refractory > 0 || alternates || (shot && noise.shot_recovery_us > 0.0));
        planes = Planes { input, first, second, light, moved, slope, fired, ..planes };
        // Where events do not change what comes after them, their times may be found later.
        let shared = !latch && sensor.times == Times::Shared;
        let sequential = shared && fired > 0;
        let kept = if shared && !sequential { 0 } else { KEPT_EVENTS };
        let own_slopes = ramp && (own_thresholds || noise.leak_spread_decades > 0.0);
        let flag = |on: bool| f64::from(u8::from(on));
        let constants = vec![
            ("SAMPLES", f64::from(samples)),
            ("MAY_BE_UNKNOWN", flag(unknown)),
            ("BLOCK_INSTANTS", f64::from(block)),
            ("LINLOG", flag(receptor.curve == Curve::Linlog)),
            ("FILTER", f64::from(filter)),
            ("LIGHT_BANDWIDTH", flag(light_bandwidth)),
            ("OWN_THRESHOLDS", flag(own_thresholds)),
            ("PHASE_START", flag(sensor.pattern.start == Start::Phase)),
            ("RAMP", flag(ramp)),
            ("OWN_SLOPES", flag(own_slopes)),
            ("LEAK_JITTER", flag(slope > 0)),
            ("TIMED_NOISE", flag(poisson_leak || shot || hot)),
            ("NOISE_SETS_REFERENCE", flag(noise.reference == NoiseReference::Signal)),
            ("REFRACTORY", f64::from(refractory)),
            ("LATCH", flag(latch)),
            ("TIMES", f64::from(if latch { 0 } else { times })),
            ("LIGHT_LATENCY", flag(light_latency)),
            (OWN_TIMES, 0.0),
            ("SEQUENTIAL", flag(sequential)),
            ("KEPT", f64::from(kept)),
            ("MOST_EVENTS", f64::from(sensor.most_events)),
            ("INPUT_PLANE", f64::from(input)),
            ("FIRST_PLANE", f64::from(first)),
            ("SECOND_PLANE", f64::from(second)),
            ("LIGHT_PLANE", f64::from(light)),
            ("MOVED_PLANE", f64::from(moved)),
            ("SLOPE_PLANE", f64::from(slope)),
            ("FIRED_PLANE", f64::from(fired)),
        ];
        let numbers = ChainSensor {
            log_eps: sensor.log_eps,
            dark_light: receptor.dark_light,
            full_scale: receptor.full_scale,
            knee: receptor.knee,
            below_knee: receptor.knee.ln() / receptor.knee,
            bandwidth_offset: receptor.bandwidth_offset,
            bandwidth_least: receptor.bandwidth_least,
            bandwidth_most: receptor.bandwidth_most,
            leak_jitter: noise.leak_jitter,
            latency_light_us: sensor.readout.latency_light_us,
        };
        Self { planes, constants, sensor: numbers, own_thresholds, own_slopes, sequential, kept }
    }

    /// The same, for light that is known at times of each pixel's own.
    pub fn with_own_times(mut self) -> Self {
        let own = self.constants.iter_mut().filter(|(name, _)| *name == OWN_TIMES);
        own.for_each(|(_, value)| *value = 1.0);
        self
    }

    /// Bytes of the widest binding per view.
    pub fn view_bytes(&self, width: u32, height: u32) -> u64 {
        u64::from(padded_pixels(width, height)) * 8 * u64::from(self.kept)
    }

    /// Most instants of a submission whose instants are `interval_us` apart: times within it must not grow old.
    pub fn most_instants(interval_us: f64) -> u32 {
        (f64::from(OLD_US / 2) / interval_us.max(1.0)).clamp(1.0, f64::from(MAX_INSTANTS)) as u32
    }
}

/// The chain's pipelines.
pub struct ChainPasses {
    /// What it is made for.
    pub plan: ChainPlan,
    /// Counts, and emits what is not kept.
    pub walk: ComputePass,
    /// Emits what is.
    pub emit: ComputePass,
    /// The first instant.
    pub begin: ComputePass,
    sensor: wgpu::Buffer,
    /// Every [`ChainStep`] that a submission may ask for.
    steps: wgpu::Buffer,
}

/// What a dispatch of the chain does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walk {
    /// Counts every pixel's events; where times are shared, up to the first instant at which it is active.
    Count,
    /// Counts, of pixels that are active at an instant, up to the next one at which they are.
    Wake(u32),
    /// Emits crowded pixels' events.
    Emit,
}

impl Walk {
    const fn step(self) -> (u32, ChainStep) {
        const fn step(mode: u32, instant: u32) -> ChainStep {
            ChainStep { mode, instant, pad: [0; 2] }
        }
        match self {
            Self::Wake(k) => (k, step(1, k)),
            Self::Count => (MAX_INSTANTS, step(0, 0)),
            Self::Emit => (MAX_INSTANTS + 1, step(2, 0)),
        }
    }

    /// Workgroups over `size` pixels of `views` views.
    pub fn workgroups(self, [width, height]: [u32; 2], views: u32) -> (u32, u32, u32) {
        match self {
            Self::Count => (row_stride(width) / WORKGROUP, height, views),
            Self::Wake(_) | Self::Emit => {
                ((width * height).div_ceil(WORKGROUP).min(LIST_WORKGROUPS), 1, views)
            }
        }
    }
}

impl ChainPasses {
    /// Builds the pipeline of `plan`.
    pub fn new(device: &wgpu::Device, plan: ChainPlan) -> Self {
        let walk = ComputePass::new(device, "chain/walk.wgsl", CHAIN_BINDINGS, &plan.constants);
        let begin = ComputePass::new(device, "chain/begin.wgsl", CHAIN_BINDINGS, &plan.constants);
        let emit =
            ComputePass::new(device, "chain/emit.wgsl", KEPT_BINDINGS, &[("KEPT", f64::from(plan.kept))]);
        let uniform = |label, bytes: &[u8]| {
            let buffer = device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes.len() as u64,
                usage: wgpu::BufferUsages::UNIFORM,
                mapped_at_creation: true,
            });
            // The backend of tests gives no memory.
            if let Ok(mut mapped) = buffer.get_mapped_range_mut(..) {
                mapped.copy_from_slice(bytes);
            }
            buffer.unmap();
            buffer
        };
        let mut steps = vec![0; STEP_STRIDE as usize * (MAX_INSTANTS + 2) as usize];
        for walk in (0..MAX_INSTANTS).map(Walk::Wake).chain([Walk::Count, Walk::Emit]) {
            let (place, step) = walk.step();
            let at = place as usize * STEP_STRIDE as usize;
            let bytes = bytemuck::bytes_of(&step);
            steps[at..at + bytes.len()].copy_from_slice(bytes);
        }
        let sensor = uniform("chain sensor", bytemuck::bytes_of(&plan.sensor));
        Self { walk, emit, begin, sensor, steps: uniform("chain steps", &steps), plan }
    }

    /// The dispatches that count `instants` instants.
    pub fn counting(&self, instants: u32) -> Vec<Walk> {
        let wakes = if self.plan.sequential { instants } else { 0 };
        std::iter::once(Walk::Count).chain((0..wakes).map(Walk::Wake)).collect()
    }

    /// The numbers of the stages.
    pub fn sensor(&self) -> wgpu::BindingResource<'_> {
        self.sensor.as_entire_binding()
    }

    /// What a dispatch does.
    pub fn step(&self, walk: Walk) -> wgpu::BindingResource<'_> {
        part(&self.steps, u64::from(walk.step().0) * STEP_STRIDE, size_of::<ChainStep>() as u64)
    }
}

/// What a group of views has for its chain, beside its memory.
pub struct GroupChain {
    /// Words of views.
    pub views: wgpu::Buffer,
    words: Vec<u32>,
    /// What is frozen, in planes: layer `plane * views + view`.
    pub frozen: wgpu::TextureView,
    noises: Vec<Option<NoiseSampler>>,
    /// Where events wait for the bus, per view; empty where they leave at once.
    pub readouts: Vec<ReadoutQueue>,
    width: u32,
    height: u32,
}

impl GroupChain {
    /// For `views` that are alike.
    pub fn new(
        gpu: &Gpu,
        plan: &ChainPlan,
        [width, height]: [u32; 2],
        views: &[(&SensorConfig, Key)],
        reference_luminance: f32,
    ) -> Self {
        let each: Vec<FixedPattern> = views
            .par_iter()
            .map(|(sensor, key)| FixedPattern::draw(sensor, *key, 0, width as usize * height as usize))
            .collect();
        let mut words: Vec<u32> = Vec::with_capacity(views.len() * VIEW_WORDS as usize);
        for ((sensor, key), frozen) in views.iter().zip(&each) {
            let slope = frozen.slope.first().copied().unwrap_or(0.0);
            let [low, high] = key.words();
            words.extend([sensor.threshold_on, sensor.threshold_off, slope].map(f32::to_bits));
            let cutoff_rate = sensor.photoreceptor.cutoff_hz * std::f32::consts::TAU * 1e-6;
            let refractory_us = sensor.refractory.period_us as f32;
            words.extend([(1.0 / reference_luminance).to_bits(), low, high]);
            words.extend([cutoff_rate, refractory_us].map(f32::to_bits));
            words.resize(words.len() + VIEW_WORDS as usize - BLOCK_WORD, 0);
        }
        type Choose = fn(&FixedPattern) -> &Vec<f32>;
        let planes: [(bool, Choose); 3] = [
            (plan.own_thresholds, |frozen| &frozen.on),
            (plan.own_thresholds, |frozen| &frozen.off),
            (plan.own_slopes, |frozen| &frozen.slope),
        ];
        let chosen: Vec<Choose> =
            planes.iter().filter(|(wanted, _)| *wanted).map(|(_, choose)| *choose).collect();
        let layers = (chosen.len() * views.len()) as u32;
        let texture = array(
            &gpu.device,
            "frozen",
            if layers == 0 { [1; 3] } else { [width, height, layers] },
            wgpu::TextureFormat::R32Float,
            wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST,
        );
        for (layer, (choose, frozen)) in
            (0..).zip(chosen.iter().flat_map(|choose| each.iter().map(move |own| (choose, own))))
        {
            let values: Vec<f32> = choose(frozen).iter().map(|value| value.min(NEVER)).collect();
            gpu.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                    ..texture.as_image_copy()
                },
                bytemuck::cast_slice(&values),
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(4 * width),
                    rows_per_image: Some(height),
                },
                wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            );
        }
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("views of a chain"),
            size: words.len() as u64 * 4,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&words));
        let noises = each
            .iter()
            .zip(views)
            .map(|(frozen, (sensor, key))| NoiseSampler::new(sensor, *key, frozen))
            .collect();
        let readout = |(sensor, key): &(&SensorConfig, Key)| ReadoutQueue::new(&sensor.readout, *key, width);
        let at_once = views.iter().all(|(sensor, _)| sensor.readout.is_off());
        let readouts = if at_once { Vec::new() } else { views.iter().map(readout).collect() };
        Self { views: buffer, words, frozen: whole(&texture), noises, readouts, width, height }
    }

    /// Takes what waits for the bus off the readouts of those `views` that `beginning` names.
    pub fn clear_readout(&mut self, views: &[(&SensorConfig, Key)], beginning: &[bool]) {
        for ((readout, (sensor, key)), _) in
            self.readouts.iter_mut().zip(views).zip(beginning).filter(|(_, begins)| **begins)
        {
            *readout = ReadoutQueue::new(&sensor.readout, *key, self.width);
        }
    }

    /// Takes over noise, readouts and what is frozen from `fresh`, which was made for the same views; those views that
    /// `beginning` does not name keep their noise and their readouts.
    pub fn reset_views(&mut self, mut fresh: Self, beginning: &[bool]) {
        for (view, _) in beginning.iter().enumerate().filter(|(_, begins)| !**begins) {
            if let (Some(new), Some(old)) = (fresh.noises.get_mut(view), self.noises.get_mut(view)) {
                std::mem::swap(new, old);
            }
            if let (Some(new), Some(old)) = (fresh.readouts.get_mut(view), self.readouts.get_mut(view)) {
                std::mem::swap(new, old);
            }
        }
        *self = fresh;
    }

    /// Says of each view when its block is, where pixels have times of their own: see `chain/own_times.wgsl`.
    pub fn write_blocks(&mut self, gpu: &Gpu, blocks: impl Iterator<Item = [u32; 4]>) {
        for (words, block) in self.words.chunks_exact_mut(VIEW_WORDS as usize).zip(blocks) {
            words[BLOCK_WORD..].copy_from_slice(&block);
        }
        gpu.queue.write_buffer(&self.views, 0, bytemuck::cast_slice(&self.words));
    }

    /// Noise candidates in `(base_us, end_us]`: where each block's begin, then the candidates.
    pub fn feed(&mut self, base_us: i64, end_us: i64) -> Vec<u32> {
        self.feed_within(base_us, |_| Some((base_us, end_us)))
    }

    /// The same, in a span of each view's own; none of those without one.
    pub fn feed_within(&mut self, base_us: i64, span_us: impl Fn(usize) -> Option<(i64, i64)>) -> Vec<u32> {
        let row_blocks = (row_stride(self.width) / BLOCK_PIXELS) as usize;
        let view_blocks = row_blocks * self.height as usize;
        let blocks = view_blocks * self.noises.len();
        let mut words = vec![0; blocks + 1];
        let mut begun = 0;
        for (view, noise) in self.noises.iter_mut().enumerate() {
            let (Some(noise), Some((from_us, to_us))) = (noise, span_us(view)) else { continue };
            for candidate in noise.candidates(from_us, to_us) {
                let (x, y) = (candidate.pixel % self.width, candidate.pixel / self.width);
                let block = view * view_blocks + y as usize * row_blocks + (x / BLOCK_PIXELS) as usize;
                // Candidates come block by block.
                let here = words.len() as u32;
                if let Some(starts) = words.get_mut(begun..=block) {
                    starts.fill(here);
                    begun = block + 1;
                }
                let side = candidate.relative.map_or(0, |other| 2 | (other.as_i16() as u32) << 2);
                let kind = (candidate.polarity.as_i16() as u32 | side) << 6
                    | (candidate.cause as u32) << 9
                    | candidate.rest << 12;
                words.push((candidate.t_us - base_us) as u32);
                words.push((x % BLOCK_PIXELS) | kind);
                words.push(candidate.light_below.clamp(-NEVER, NEVER).to_bits());
            }
        }
        let end = words.len() as u32;
        if let Some(starts) = words.get_mut(begun..=blocks) {
            starts.fill(end);
        }
        words
    }
}
