//! Keyframes: what the cameras see, with a margin around it, at the ends of a gap; light, depth, and motion to the
//! neighbouring keyframes. Two are kept at a time: the newer one of a gap is the older one of the next.

use evis_core::{Warp, WarpVariant};
use evis_scene::PixelLens;

use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::sizes::UNIFORM_ALIGNMENT;
use crate::gpu::texture::DEPTH_FORMAT;
use crate::gpu::uniforms::{KeyParams, LabelFrame};
use crate::pass::labels::GEOMETRY_FORMATS;
use crate::pass::splat::{PREPARE_BINDINGS, SPLAT_WORKGROUP};
use crate::pass::{self, ComputePass};
use crate::raster::context::{Context, Upload};
use crate::raster::geometry::{GeometryGroups, GeometryPass, GeometryRenderer, sky_flow};
use crate::raster::layers::{LayerUse, Layers};
use crate::raster::luminance::encode_luminance;
use crate::raster::shadows::MovingShadows;
use crate::sampling::clipped::{CLIPPED_BYTES, CLIPPED_STRIDE, Clipping};
use crate::world::view::View;

/// Keyframes that are kept.
pub const SLOTS: u32 = 2;

/// The slot of keyframe `j`.
pub const fn slot_of(j: i64) -> u32 {
    (j & 1) as u32
}

/// A lens that sees `margin` pixels more at each border.
pub fn canvas_lens(lens: &PixelLens, config: &Warp) -> PixelLens {
    let margin = config.scene_margin();
    PixelLens {
        width: lens.width + 2 * margin,
        height: lens.height + 2 * margin,
        focal: lens.focal,
        center: lens.center.map(|c| c + f64::from(margin)),
        near: lens.near,
        rays: lens.rays,
    }
}

/// Keyframes of the views of one size.
pub struct KeyframeStore {
    /// Pixels per row, margins included.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Of the pixels, those beyond each border of the sensor.
    margin: u32,
    /// A layer per slot and view: luminance (negative: unknown), 1 / (depth + 1e-3), pixels to where it is at the next
    /// keyframe.
    pub forward: wgpu::TextureView,
    /// The same, with pixels to where it is at the last keyframe.
    pub backward: wgpu::TextureView,
    /// Per slot, view and pixel: object + 1, 0 for none.
    pub objects: wgpu::Buffer,
    /// Per slot and view: largest luminance, largest 1 / depth that the sensor sees, as bits.
    pub largest: wgpu::Buffer,
    /// Luminance, a layer per sample.
    pub layers: Layers,
    /// Inverse depth, flow, ids.
    pub pictures: [wgpu::TextureView; 3],
    depth: wgpu::TextureView,
    keys: wgpu::Buffer,
    /// What each slot holds: a group's keyframe. A slot's content is a function of that alone.
    held: [Option<(usize, i64)>; SLOTS as usize],
    with_objects: bool,
}

impl KeyframeStore {
    /// Allocates for `views` views of canvas size `width` x `height`.
    pub fn new(
        device: &wgpu::Device,
        [width, height]: [u32; 2],
        views: u32,
        samples: u32,
        made: LayerUse,
        config: &Warp,
    ) -> Self {
        let with_objects = config.variant == WarpVariant::Splat;
        let entries = u64::from(SLOTS * views) * u64::from(width) * u64::from(height);
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let storage = wgpu::BufferUsages::STORAGE;
        let picture = |format, wanted: bool| {
            let (width, height) = if wanted { (width, height) } else { (1, 1) };
            device
                .create_texture(&wgpu::TextureDescriptor {
                    label: Some("keyframe"),
                    size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format,
                    usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                        | wgpu::TextureUsages::TEXTURE_BINDING
                        | wgpu::TextureUsages::COPY_DST,
                    view_formats: &[],
                })
                .create_view(&Default::default())
        };
        let sources = |label| {
            device
                .create_texture(&wgpu::TextureDescriptor {
                    label: Some(label),
                    size: wgpu::Extent3d { width, height, depth_or_array_layers: SLOTS * views },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format: wgpu::TextureFormat::Rgba32Float,
                    usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING,
                    view_formats: &[],
                })
                .create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2Array),
                    ..Default::default()
                })
        };
        let [inverse_depth, flow, ids] = GEOMETRY_FORMATS;
        let keys = buffer(
            "keyframe params",
            u64::from(SLOTS * views) * UNIFORM_ALIGNMENT,
            wgpu::BufferUsages::UNIFORM,
        );
        Self {
            width,
            height,
            margin: config.scene_margin(),
            forward: sources("keyframes, forward"),
            backward: sources("keyframes, backward"),
            objects: buffer("keyframe objects", if with_objects { entries * 4 } else { 16 }, storage),
            largest: buffer("largest of keyframes", u64::from(SLOTS * views) * 8, storage),
            layers: Layers::new(device, width, height, samples, made),
            pictures: [picture(inverse_depth, true), picture(flow, true), picture(ids, with_objects)],
            depth: picture(DEPTH_FORMAT, true),
            keys,
            held: [None; SLOTS as usize],
            with_objects,
        }
    }

    /// From the pictures to `entry`: views of slot 0, then of slot 1. What is clipped goes to count `count` of `clipping`.
    pub fn encode_prepare(
        &self,
        gpu: &Gpu,
        encoder: &mut Commands,
        prepare: &ComputePass,
        entry: u32,
        (clipping, count): (&Clipping, u32),
    ) {
        let params = KeyParams {
            width: self.width,
            height: self.height,
            view: entry,
            margin: self.margin,
            brightest: clipping.brightest,
            ..Default::default()
        };
        let offset = u64::from(entry) * UNIFORM_ALIGNMENT;
        gpu.queue.write_buffer(&self.keys, offset, bytemuck::bytes_of(&params));
        let texture = wgpu::BindingResource::TextureView;
        let [inverse_depth, flow, ids] = self.pictures.each_ref().map(texture);
        let resources = vec![
            pass::part(&self.keys, offset, size_of::<KeyParams>() as u64),
            texture(&self.layers.array),
            inverse_depth,
            flow,
            ids,
            texture(&self.forward),
            texture(&self.backward),
            self.objects.as_entire_binding(),
            self.largest.as_entire_binding(),
            pass::part(&clipping.counts, u64::from(count) * CLIPPED_STRIDE, CLIPPED_BYTES),
        ];
        let group = pass::group(&gpu.device, "prepare", &prepare.layout, PREPARE_BINDINGS, resources);
        let workgroups = (self.width.div_ceil(SPLAT_WORKGROUP), self.height, 1);
        prepare.encode(encoder, &group, &[], workgroups);
    }

    /// Whether slot of keyframe `j` holds it for `group`; from now on it does.
    pub fn claim(&mut self, group: usize, j: i64) -> bool {
        let slot = &mut self.held[slot_of(j) as usize];
        slot.replace((group, j)) == Some((group, j))
    }
}

/// The frames of a submission's keyframes.
pub struct KeyframeFrames {
    /// With the canvas as their pixels.
    pub views: Vec<View>,
    /// First keyframe.
    pub first: i64,
    /// Instants that were uploaded: a keyframe more at either end, to tell motion.
    times: u32,
    frame_group: wgpu::BindGroup,
    geometry: GeometryGroups,
}

impl KeyframeFrames {
    /// Evaluates and uploads keyframes `first..=last` of `views`, whose lenses are those of the canvas.
    pub fn upload(
        context: &mut Context,
        renderer: &mut GeometryRenderer,
        views: Vec<View>,
        [first, last]: [i64; 2],
        record_ids: bool,
    ) -> Self {
        // Nothing lies before the stream: there a keyframe is its own neighbour.
        let times: Vec<i64> = (first - 1..=last + 1).map(|j| context.grid.keyframe_us(j.max(0))).collect();
        let frame_group =
            context.upload_frames_as(&views, &times, Upload { record_ids, ..Default::default() });
        let objects = context.gpu_scene.objects.len() as u32;
        let (width, height) = views.first().map_or((1, 1), |v| (v.lens.width, v.lens.height));
        let label = LabelFrame {
            next_offset: objects,
            // Back by one frame: the sum wraps.
            last_offset: 0u32.wrapping_sub(objects),
            half_size: [width as f32 / 2.0, height as f32 / 2.0],
        };
        let neighbours = times.windows(3).map(|t| [t[2], t[0]]);
        let skies: Vec<_> = neighbours.flat_map(|others| views.iter().map(move |v| (v, others))).collect();
        let skies: Vec<_> = skies.into_iter().map(|(view, others)| sky_flow(context, view, others)).collect();
        let geometry = renderer.upload(context, &label, &skies);
        Self { views, first, times: times.len() as u32, frame_group, geometry }
    }

    /// Draws keyframe `j` into its slot of `store`. What is clipped of its views goes to the counts from `first_count` on.
    #[expect(clippy::too_many_arguments, reason = "what a keyframe is drawn from, and where it goes")]
    pub fn draw(
        &self,
        context: &Context,
        encoder: &mut Commands,
        renderer: &GeometryRenderer,
        prepare: &ComputePass,
        store: &KeyframeStore,
        j: i64,
        (clipping, first_count): (&Clipping, u32),
    ) {
        let (count, slot) = (self.views.len() as u32, slot_of(j));
        let place = (j - self.first) as u32;
        let mut shadows = MovingShadows::new(&self.frame_group, &self.views, self.times);
        let bytes = 8 * u64::from(count);
        encoder.clear_buffer(&store.largest, u64::from(slot) * bytes, Some(bytes));
        for view in 0..count {
            let frame = view * self.times + place + 1;
            shadows.show(context, encoder, view, place + 1);
            encode_luminance(context, encoder, &store.layers, &self.frame_group, frame, 0, None);
            let [inverse_depth, flow, ids] = &store.pictures;
            let what = GeometryPass {
                frame,
                sky: place * count + view,
                targets: [Some(inverse_depth), Some(flow), store.with_objects.then_some(ids)],
                depth: &store.depth,
            };
            renderer.encode(context, encoder, &self.frame_group, &self.geometry, &what);
            let clipped = (clipping, first_count + view);
            store.encode_prepare(&context.gpu, encoder, prepare, slot * count + view, clipped);
        }
    }
}
