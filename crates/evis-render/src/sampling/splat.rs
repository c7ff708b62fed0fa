//! `splat`: the instants of a gap from the keyframes at its ends, each pixel moved to where it then is.

use evis_core::{Warp, WarpVariant};
use evis_scene::SceneState;
use glam::DMat4;

use crate::error::EngineError;
use crate::gpu::buffer::GrowingBuffer;
use crate::gpu::commands::{Commands, Compute};
use crate::gpu::sizes::{DeviceLimits, MethodNeeds, UNIFORM_ALIGNMENT};
use crate::gpu::uniforms::SplatParams;
use crate::pass::raster::SceneConstants;
use crate::pass::splat::{
    ACCUMULATE_BINDINGS, HOLE_TILE, HOLES_BINDINGS, INDEX_BINDINGS, PLACE_BINDINGS, PLACED_PLANES,
    RESOLVE_BINDINGS, SHOW_BINDINGS, SPLAT_WORKGROUP, SUM_PLANES, SidePasses, SplatPasses,
};
use crate::pass::{self, ComputePass};
use crate::raster::context::Context;
use crate::raster::geometry::GeometryRenderer;
use crate::raster::layers::LayerUse;
use crate::sampling::clipped::{self, ClippedRun, Clipping};
use crate::sampling::keyframes::{KeyframeFrames, KeyframeStore, SLOTS, canvas_lens, slot_of};
use crate::sensor::group::{Group, Unit};
use crate::sensor::targets::Targets;
use crate::world::raster_lens::RasterLens;
use crate::world::transform::rigid;
use crate::world::view::View;

/// Sources that one invocation adds up where a processor stands in for a graphics card.
const CPU_RUN: u32 = 8;
/// Most light of `evis-paper`, in reference luminances: light is counted in steps of 2^-38 of it, some 5e-7 reference
/// luminances, a twentieth of the paper's eps.
const BRIGHTEST: f32 = 65_536.0;
/// Rows of a transform: x·w, y·w, w.
const ROWS: usize = 3;

/// Everything that `splat` needs.
pub struct SplatSampler {
    config: Warp,
    passes: SplatPasses,
    geometry: GeometryRenderer,
    /// Per class of views.
    stores: Vec<Store>,
    params: GrowingBuffer,
    transforms: GrowingBuffer,
    drawn: u64,
    drawn_pixels: u64,
}

/// What the views of one class have.
pub struct Store {
    /// Of both sides.
    pub keyframes: KeyframeStore,
    /// Where their pixels are.
    pub placed: wgpu::Buffer,
    /// What they add up to.
    pub sums: wgpu::Buffer,
    /// Flags of tiles with holes.
    tiles: wgpu::Buffer,
    /// Sensor pixels.
    size: [u32; 2],
}

impl Store {
    /// Allocates for `views` views of `size`.
    pub fn new(
        device: &wgpu::Device,
        config: &Warp,
        size: [u32; 2],
        views: u32,
        samples: u32,
        made: LayerUse,
    ) -> Self {
        let storage = |label, words: u64| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: words * 4 * u64::from(views),
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::COPY_DST
                    | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        };
        let canvas_size = canvas_size(config, size[0], size[1]);
        let canvas: u64 = canvas_size.map(u64::from).iter().product();
        let target: u64 = size.map(u64::from).iter().product();
        let tiles: u64 = size.map(|n| u64::from(n.div_ceil(HOLE_TILE))).iter().product();
        Self {
            keyframes: KeyframeStore::new(device, canvas_size, views, samples, made, config),
            placed: storage("placed", canvas * 2 * PLACED_PLANES),
            sums: storage("splat sums", target * 2 * SUM_PLANES),
            tiles: storage("tiles with holes", tiles),
            size,
        }
    }
}

/// One instant between keyframes, or at the newer one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    /// Its gap: from keyframe `gap` to the next.
    gap: i64,
    t_us: i64,
    /// Part of the gap that has passed, 1 at its end.
    elapsed: f64,
}

impl SplatSampler {
    /// Builds the passes.
    pub fn new(context: &Context, constants: &SceneConstants, config: &Warp) -> Self {
        let device = &context.gpu.device;
        let exact = config.variant == WarpVariant::Splat;
        // A processor waits for each atomic operation; a graphics card has threads to spare instead.
        let processor = device.adapter_info().device_type == wgpu::DeviceType::Cpu;
        let run = if processor { CPU_RUN } else { 1 };
        Self {
            config: *config,
            passes: SplatPasses::new(device, config.variant, context.offsets.len() as u32, run),
            geometry: GeometryRenderer::new(
                device,
                &context.layouts,
                &context.gpu_scene,
                constants,
                [true, true, exact],
            ),
            stores: Vec::new(),
            params: GrowingBuffer::new(device, "splat params", wgpu::BufferUsages::UNIFORM),
            transforms: GrowingBuffer::new(device, "splat transforms", wgpu::BufferUsages::STORAGE),
            drawn: 0,
            drawn_pixels: 0,
        }
    }

    /// What a view of `width` x `height` needs beside luminance, where its keyframes fit the device.
    pub fn needs(config: &Warp, width: u32, height: u32, limits: &DeviceLimits) -> Option<MethodNeeds> {
        let [canvas_width, canvas_height] = canvas_size(config, width, height);
        if canvas_width.max(canvas_height) > limits.texture_edge {
            return None;
        }
        let canvas = u64::from(canvas_width) * u64::from(canvas_height);
        let target = u64::from(width) * u64::from(height);
        let bytes = (canvas * 2 * PLACED_PLANES * 4).max(target * 2 * SUM_PLANES * 4);
        (bytes <= limits.storage_binding).then_some(MethodNeeds {
            bytes,
            layers: SLOTS,
            block: 1,
            keeps: true,
        })
    }

    /// Adds what the views of one class need, in the order of `Targets`.
    pub fn add_class(&mut self, context: &Context, targets: &Targets, made: LayerUse) {
        let samples = context.offsets.len() as u32;
        let size = [targets.width, targets.height];
        let views = targets.plan.views_per_group;
        let store = Store::new(&context.gpu.device, &self.config, size, views, samples, made);
        self.stores.push(store);
    }

    /// What the views of class `index` have.
    #[cfg(test)]
    pub fn store(&self, index: usize) -> Option<&Store> {
        self.stores.get(index)
    }

    /// Keyframes drawn since this was last asked.
    pub fn take_keyframes(&mut self) -> u64 {
        std::mem::take(&mut self.drawn)
    }

    /// Pixels of keyframes drawn since this was last asked.
    pub fn take_drawn_pixels(&mut self) -> u64 {
        std::mem::take(&mut self.drawn_pixels)
    }

    /// Fills the layers of `unit`'s instants. Returns how much light of the keyframes that this took was clipped, where any
    /// can be.
    pub fn encode(
        &mut self,
        context: &mut Context,
        encoder: &mut Commands,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
    ) -> Option<ClippedRun> {
        let steps = steps(context, unit);
        let (first, last) = (steps.first()?, steps.last()?);
        let keys = [first.gap.max(0), last.gap + 1];
        // Where everything is, at every keyframe and at those beside them.
        let config = self.config;
        let exact = config.variant == WarpVariant::Splat;
        let views: Vec<View> = group
            .views
            .iter()
            .map(|&v| {
                let view = context.views[v].clone();
                View { lens: canvas_lens(&view.lens, &config), ..view }
            })
            .collect();
        let transforms = if exact { transforms(context, &views, &steps) } else { vec![[0.0; 4]] };
        let frames = KeyframeFrames::upload(context, &mut self.geometry, views, keys, exact);
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        self.transforms.write(device, queue, bytemuck::cast_slice(&transforms));
        let count = frames.views.len() as u32;
        let params = self.params_of(context, group.targets, unit, &steps, &frames.views);
        self.params.write(device, queue, &params);
        // Keyframes as they are needed; what the last submission left is not drawn again.
        let held = &mut self.stores[group.targets].keyframes;
        let draws: Vec<[Option<i64>; 2]> = steps
            .iter()
            .map(|step| {
                let older = (step.elapsed < 1.0).then_some(step.gap);
                [older, Some(step.gap + 1)].map(|key| key.filter(|&j| !held.claim(unit.group, j)))
            })
            .collect();
        let keyframes: Vec<i64> = draws.iter().flatten().flatten().copied().collect();
        let drawn = u64::from(count) * keyframes.len() as u64;
        self.drawn += drawn;
        self.drawn_pixels += drawn * u64::from(held.width) * u64::from(held.height);

        let store = &self.stores[group.targets];
        let inputs = Inputs {
            params: self.params.get(),
            transforms: self.transforms.get(),
            layers: &targets.layers.array,
        };
        let work = Work::new(&context.gpu.device, &self.config, &self.passes, store, &inputs, count);
        let store = &store.keyframes;
        let brightest = if exact { f32::MAX } else { BRIGHTEST * context.reference_luminance };
        let clipping = Clipping::new(&context.gpu.device, brightest, drawn as usize);
        let mut first_count = 0;
        for (k, (step, draws)) in steps.iter().zip(draws).enumerate() {
            for j in draws.into_iter().flatten() {
                let clipped = (&clipping, first_count);
                frames.draw(context, encoder, &self.geometry, &self.passes.prepare, store, j, clipped);
                first_count += count;
            }
            if step.elapsed < 1.0 {
                work.encode_instant(encoder, k);
            } else {
                work.encode_keyframe(encoder, k);
            }
        }
        (!exact && drawn > 0).then(|| {
            let staging = clipping.staging(&context.gpu.device);
            encoder.copy_buffer_to_buffer(&clipping.counts, 0, &staging, 0, staging.size());
            let entry = |keyframe: i64| {
                let t_us = context.grid.keyframe_us(keyframe);
                group.views.iter().map(move |&view| clipped::ViewKeyframe { view, keyframe, t_us })
            };
            let entries = keyframes.into_iter().flat_map(entry).collect();
            ClippedRun { group: unit.group, brightest, entries, staging }
        })
    }

    /// Params of every step: the older side, then the newer one.
    fn params_of(
        &self,
        context: &Context,
        class: usize,
        unit: &Unit,
        steps: &[Step],
        views: &[View],
    ) -> Vec<u8> {
        let Store { keyframes, size: [width, height], .. } = &self.stores[class];
        // All have it.
        let log_eps = views[0].sensor.log_eps;
        let config = &self.config;
        let objects = context.gpu_scene.objects.len() as u32;
        let rows = views.len() as u32 * (objects + 1) * ROWS as u32;
        let pixels = keyframes.width * keyframes.height;
        let mut bytes = vec![0; 2 * steps.len() * UNIFORM_ALIGNMENT as usize];
        for (i, entry) in bytes.chunks_exact_mut(UNIFORM_ALIGNMENT as usize).enumerate() {
            let (k, side) = (i / 2, i as u32 % 2);
            let step = &steps[k];
            let moved = if side == 0 { step.elapsed } else { 1.0 - step.elapsed };
            let params = SplatParams {
                width: *width,
                height: *height,
                canvas_width: keyframes.width,
                canvas_height: keyframes.height,
                margin: config.scene_margin(),
                view_count: views.len() as u32,
                transform_base: i as u32 * rows,
                objects,
                side,
                slot: slot_of(step.gap + i64::from(side)),
                moved: moved as f32,
                elapsed: step.elapsed as f32,
                first_layer: k as u32,
                layers_per_view: unit.instants,
                index_bits: u32::BITS - pixels.leading_zeros(),
                // Blending in the logarithm, which the sensor model takes.
                log_floor: log_eps * context.reference_luminance,
                brightest: BRIGHTEST * context.reference_luminance,
                ..SplatParams::default()
            };
            entry[..size_of::<SplatParams>()].copy_from_slice(bytemuck::bytes_of(&params));
        }
        bytes
    }
}

type Bound<'a> = (&'a wgpu::ComputePipeline, wgpu::BindGroup);

/// What a submission's passes read and write beside a [`Store`].
pub struct Inputs<'a> {
    /// [`SplatParams`], a pair per step.
    pub params: &'a wgpu::Buffer,
    /// Rows of transforms.
    pub transforms: &'a wgpu::Buffer,
    /// Luminance of the instants.
    pub layers: &'a wgpu::TextureView,
}

/// The passes of a submission, bound.
pub struct Work<'a> {
    newer: [Bound<'a>; 2],
    holes: Option<Bound<'a>>,
    older: [Bound<'a>; 2],
    resolve: Bound<'a>,
    show: Bound<'a>,
    /// Workgroups: keyframe pixels; what is added up at once; sensor pixels.
    canvas: (u32, u32, u32),
    runs: (u32, u32, u32),
    sensor: (u32, u32, u32),
    sums: &'a wgpu::Buffer,
    sums_bytes: u64,
    tiles: &'a wgpu::Buffer,
}

impl<'a> Work<'a> {
    /// Binds `passes` for `views` views of `store`.
    pub fn new(
        device: &wgpu::Device,
        config: &Warp,
        passes: &'a SplatPasses,
        store: &'a Store,
        inputs: &Inputs<'_>,
        views: u32,
    ) -> Self {
        let Store { keyframes, placed, sums, tiles, size } = store;
        let params = || pass::part(inputs.params, 0, size_of::<SplatParams>() as u64);
        let layers = || wgpu::BindingResource::TextureView(inputs.layers);
        let group = |label, pass: &ComputePass, bindings, resources| {
            pass::group(device, label, &pass.layout, bindings, resources)
        };
        let texture = wgpu::BindingResource::TextureView;
        let forward = || texture(&keyframes.forward);
        let largest = || keyframes.largest.as_entire_binding();
        let side = |passes: &'a SidePasses, sources: &'a wgpu::TextureView| {
            let place = vec![
                params(),
                texture(sources),
                keyframes.objects.as_entire_binding(),
                inputs.transforms.as_entire_binding(),
                placed.as_entire_binding(),
                sums.as_entire_binding(),
                tiles.as_entire_binding(),
            ];
            let (bindings, carry) = match config.variant {
                WarpVariant::EvisPaper => (
                    ACCUMULATE_BINDINGS,
                    vec![
                        params(),
                        texture(sources),
                        largest(),
                        placed.as_entire_binding(),
                        sums.as_entire_binding(),
                    ],
                ),
                WarpVariant::Splat => {
                    (INDEX_BINDINGS, vec![params(), placed.as_entire_binding(), sums.as_entire_binding()])
                }
            };
            [
                (&passes.place.pipeline, group("place", &passes.place, PLACE_BINDINGS, place)),
                (&passes.carry.pipeline, group("carry", &passes.carry, bindings, carry)),
            ]
        };
        let carry_width = match config.variant {
            WarpVariant::EvisPaper => keyframes.width.div_ceil(passes.run),
            WarpVariant::Splat => keyframes.width,
        };
        let resolve = vec![
            params(),
            sums.as_entire_binding(),
            forward(),
            placed.as_entire_binding(),
            largest(),
            layers(),
        ];
        Self {
            newer: side(&passes.newer, &keyframes.backward),
            holes: passes.holes.as_ref().map(|holes| {
                let resources = vec![params(), sums.as_entire_binding(), tiles.as_entire_binding()];
                (&holes.pipeline, group("holes", holes, HOLES_BINDINGS, resources))
            }),
            older: side(&passes.older, &keyframes.forward),
            resolve: (&passes.resolve.pipeline, group("resolve", &passes.resolve, RESOLVE_BINDINGS, resolve)),
            show: (
                &passes.show.pipeline,
                group("show", &passes.show, SHOW_BINDINGS, vec![params(), forward(), layers()]),
            ),
            canvas: (keyframes.width.div_ceil(SPLAT_WORKGROUP), keyframes.height, views),
            runs: (carry_width.div_ceil(SPLAT_WORKGROUP), keyframes.height, views),
            sensor: (size[0].div_ceil(SPLAT_WORKGROUP), size[1], views),
            sums,
            sums_bytes: u64::from(size[0] * size[1] * views) * 2 * SUM_PLANES * 4,
            tiles,
        }
    }

    /// Instant `k` of the submission, between two keyframes: the newer one first, for the older one may ask for its
    /// holes.
    pub fn encode_instant(&self, encoder: &mut Commands, k: usize) {
        encoder.clear_buffer(self.sums, 0, Some(self.sums_bytes));
        if self.holes.is_some() {
            encoder.clear_buffer(self.tiles, 0, None);
        }
        let mut pass = encoder.compute("splat");
        let [older, newer] = [0, 1].map(|side| (2 * k as u32 + side) * UNIFORM_ALIGNMENT as u32);
        run(&mut pass, &self.newer[0], newer, self.canvas);
        run(&mut pass, &self.newer[1], newer, self.runs);
        if let Some(holes) = &self.holes {
            run(&mut pass, holes, newer, self.sensor);
        }
        run(&mut pass, &self.older[0], older, self.canvas);
        run(&mut pass, &self.older[1], older, self.runs);
        run(&mut pass, &self.resolve, older, self.sensor);
    }

    /// Instant `k`, at the newer keyframe.
    pub fn encode_keyframe(&self, encoder: &mut Commands, k: usize) {
        let mut pass = encoder.compute("splat/show.wgsl");
        run(&mut pass, &self.show, (2 * k as u32 + 1) * UNIFORM_ALIGNMENT as u32, self.sensor);
    }
}

fn run(pass: &mut Compute<'_>, (pipeline, group): &Bound<'_>, offset: u32, workgroups: (u32, u32, u32)) {
    pass.dispatch(pipeline, group, &[offset], workgroups);
}

fn canvas_size(config: &Warp, width: u32, height: u32) -> [u32; 2] {
    [width, height].map(|n| n + 2 * config.scene_margin())
}

/// The instants of `unit`, each within the gap that it ends or lies in.
fn steps(context: &Context, unit: &Unit) -> Vec<Step> {
    let grid = &context.grid;
    (unit.first..unit.first + i64::from(unit.instants))
        .map(|k| {
            let gap = (k - 1).div_euclid(grid.steps());
            let t_us = grid.instant_us(k);
            let [start, end] = [gap, gap + 1].map(|j| grid.keyframe_us(j));
            Step { gap, t_us, elapsed: (t_us - start) as f64 / (end - start) as f64 }
        })
        .collect()
}

/// Rows that take (x, y, 1 / depth, 1) of a keyframe pixel to (x·w, y·w, w) at an instant, by step, side, view, and object
/// + 1; object 0 stands still. Zeros where an object deforms or cannot be told.
fn transforms(context: &Context, views: &[View], steps: &[Step]) -> Vec<[f32; 4]> {
    let objects = &context.gpu_scene.objects;
    let mut state = SceneState::default();
    let mut poses = |view: &View, t_us: i64| {
        let variant = context.scene.variants.get(view.environment);
        context.scene.evaluate_variant(variant, context.scene_time_s(t_us), &mut state);
        let camera_from_world = rigid(&state.world_from_node[view.node]).inverse();
        let clip_from_world = view.lens.clip_from_camera() * camera_from_world;
        let rigid_objects = objects.iter().map(|object| {
            let deforms = object.skin.is_some() || object.morph.is_some();
            (!deforms).then(|| clip_from_world * state.world_from_node[object.node])
        });
        std::iter::once(Some(clip_from_world)).chain(rigid_objects).collect::<Vec<Option<DMat4>>>()
    };
    let inverses = |poses: Vec<Option<DMat4>>| -> Vec<Option<DMat4>> {
        poses.into_iter().map(|m| m.filter(|m| m.determinant() != 0.0).map(|m| m.inverse())).collect()
    };
    let size = views.len() * (objects.len() + 1) * ROWS;
    let mut rows = vec![[0.0; 4]; 2 * steps.len() * size];
    for (v, view) in views.iter().enumerate() {
        let (to_pixels, from_pixels) = (view.lens.pixels_from_clip(), view.lens.clip_from_pixels());
        let mut ends: Option<(i64, [Vec<Option<DMat4>>; 2])> = None;
        for (k, step) in steps.iter().enumerate().filter(|(_, s)| s.elapsed < 1.0) {
            let now = poses(view, step.t_us);
            let ends = match ends.take() {
                Some(known) if known.0 == step.gap => ends.insert(known),
                _ => {
                    let at = [0, 1].map(|side| context.grid.keyframe_us(step.gap + side));
                    ends.insert((step.gap, at.map(|t| inverses(poses(view, t)))))
                }
            };
            for (side, key) in ends.1.iter().enumerate() {
                let first = (2 * k + side) * size + v * (objects.len() + 1) * ROWS;
                for ((clip, from_clip), rows) in now.iter().zip(key).zip(rows[first..].chunks_exact_mut(ROWS))
                {
                    if let (Some(clip), Some(from_clip)) = (clip, from_clip) {
                        let all = to_pixels * *clip * *from_clip * from_pixels;
                        if all.is_finite() {
                            let t = all.transpose();
                            rows.copy_from_slice(
                                &[t.x_axis, t.y_axis, t.w_axis].map(|r| r.as_vec4().to_array()),
                            );
                        }
                    }
                }
            }
        }
    }
    rows
}

/// What to say where keyframes do not fit.
pub fn does_not_fit(config: &Warp, width: u32, height: u32, limits: &DeviceLimits) -> EngineError {
    let [canvas_width, canvas_height] = canvas_size(config, width, height);
    EngineError::Device(format!(
        "keyframes of {canvas_width}x{canvas_height} pixels do not fit this device (edge {}, binding {} bytes); \
         choose a smaller `size` or `margin`",
        limits.texture_edge, limits.storage_binding
    ))
}
