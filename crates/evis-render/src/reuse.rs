//! `reproject`: visibility at every instant, light from keyframes. Keyframes have times of their own, whole blocks of adaptive
//! time apart, and [`CELLS`] x [`CELLS`] cells per pixel. What stands still in the world takes its light from the two keyframes
//! around an instant, where both show it and agree; elsewhere, and on all that moves, it is shaded.
//!
//! A keyframe is a function of view and time alone: one that a restart, a split or another submission has displaced is drawn
//! again, with the same bytes.

use std::collections::HashMap;

use crate::engine::Context;
use crate::error::EngineError;
use crate::frame::{Trail, columns};
use crate::frame_buffers::{GrowingBuffer, aligned};
use crate::geometry::attachment;
use crate::gpu_scene::DrawItem;
use crate::interval::{Drawing, depth_attachment, draw_surfaces};
use crate::pass::raster::{DEPTH_FORMAT, LUMINANCE_FORMAT, SceneConstants, UNIFORM_ALIGNMENT};
use crate::pass::reuse::{CELL_MEAN_BINDINGS, KEY_FORMAT, KEYFRAME_BINDINGS, REUSE_BINDINGS, ReusePasses};
use crate::pass::{self};
use crate::sizes::DeviceLimits;
use crate::targets::{array, each, whole};
use crate::uniforms::{MeanParams, ReuseFrame};
use crate::view::View;

/// Keyframes of a view that are kept: the older, and the newer.
const SLOTS: u32 = 2;
/// Cells of a keyframe along a pixel's side.
const CELLS: u32 = 4;

/// Refuses pictures of `width` x `height` pixels whose keyframes no texture of the device holds.
///
/// # Errors
/// Names what would work.
pub fn check_size(width: u32, height: u32, limits: &DeviceLimits) -> Result<(), EngineError> {
    if width.max(height) * CELLS <= limits.texture_edge {
        return Ok(());
    }
    Err(EngineError::Device(format!(
        "{width}x{height} pixels: keyframes of reproject are {CELLS} times as wide and high, and this device has textures \
         of {} at most; choose a smaller --size, or --method native",
        limits.texture_edge
    )))
}

/// The room.
pub struct ReuseRoom {
    passes: ReusePasses,
    frames: GrowingBuffer,
    means: GrowingBuffer,
    points: wgpu::Sampler,
    /// Per class of views.
    depth: Vec<wgpu::TextureView>,
    /// By the first view of a group.
    stores: HashMap<usize, Store>,
    drawn: u64,
}

/// The keyframes of a group's views.
struct Store {
    lights: Slots,
    keys: Slots,
    means: Slots,
    /// Per layer: which keyframe it holds.
    held: Vec<Option<i64>>,
}

/// A layer per view and slot.
struct Slots {
    texture: wgpu::Texture,
    array: wgpu::TextureView,
    each: Vec<wgpu::TextureView>,
}

impl Slots {
    fn new(
        device: &wgpu::Device,
        size: [u32; 3],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> Self {
        // Tests copy them.
        let usage = usage | wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let texture = array(device, "keyframe cells", size, format, usage);
        Self { array: whole(&texture), each: each(&texture), texture }
    }
}

/// What of a view stands still at the `frames`, by number, so that its light may be used again; `None` where lights change.
pub fn steady(trail: &Trail, objects: &[crate::gpu_scene::Object], frames: impl Iterator<Item = usize>) -> Option<Vec<bool>> {
    let shared: Vec<_> = frames.map(|frame| &trail.shared[trail.shared_of[frame]]).collect();
    let first = shared.first()?;
    if shared.iter().any(|s| s.lights != first.lights) {
        return None;
    }
    Some(objects.iter().enumerate().map(|(i, o)| shared.windows(2).all(|m| m[0].is_equal(m[1], o, i))).collect())
}

/// A keyframe that is to be drawn.
#[derive(Clone, Copy, Debug)]
pub struct Keyframe {
    /// View of the group.
    pub view: u32,
    /// Its number in the stream.
    pub number: i64,
    /// Frame of the submission.
    pub frame: u32,
}

impl Keyframe {
    /// Layer of the keyframe with `number`.
    fn layer(view: u32, number: i64) -> u32 {
        view * SLOTS + (number & 1) as u32
    }
}

/// Uniforms of a submission.
pub struct ReuseGroups {
    keyframe: wgpu::BindGroup,
    instants: wgpu::BindGroup,
    mean: wgpu::BindGroup,
    /// Entry of the first keyframe.
    first_keyframe: u32,
}

/// What an instant reads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Instant {
    /// View of the group.
    pub view: u32,
    /// Its frame.
    pub frame: u32,
    /// Frames of the older and the newer keyframe.
    pub around: [u32; 2],
    /// Their numbers.
    pub keyframes: [i64; 2],
    /// Part of the newer one's light.
    pub weight: f32,
}

impl ReuseRoom {
    /// For what is drawn of the scene.
    pub fn new(context: &Context, constants: &SceneConstants) -> Self {
        let device = &context.gpu.device;
        let variants = context.gpu_scene.variants();
        Self {
            passes: ReusePasses::new(device, &context.layouts, &variants, constants, CELLS),
            frames: GrowingBuffer::new(device, "reuse frames", wgpu::BufferUsages::UNIFORM),
            means: GrowingBuffer::new(device, "cell means", wgpu::BufferUsages::UNIFORM),
            points: device.create_sampler(&wgpu::SamplerDescriptor::default()),
            depth: Vec::new(),
            stores: HashMap::new(),
            drawn: 0,
        }
    }

    /// Makes room for views of `width` x `height` pixels, the next class in order.
    pub fn add_class(&mut self, device: &wgpu::Device, width: u32, height: u32) {
        let size = [width * CELLS, height * CELLS, 1];
        let depth =
            array(device, "keyframe depth", size, DEPTH_FORMAT, wgpu::TextureUsages::RENDER_ATTACHMENT);
        self.depth.push(depth.create_view(&Default::default()));
    }

    /// Lights, keys and means, of a view's two keyframes in turn.
    #[cfg(test)]
    pub fn textures(&self, first_view: usize) -> Option<[&wgpu::Texture; 3]> {
        let store = self.stores.get(&first_view)?;
        Some([&store.lights.texture, &store.keys.texture, &store.means.texture])
    }

    /// Keyframes drawn since this was last asked.
    pub fn take_keyframes(&mut self) -> u64 {
        std::mem::take(&mut self.drawn)
    }

    /// Makes room for the keyframes of `views` views of `width` x `height` pixels, the first of which is `first_view`.
    pub fn open(&mut self, device: &wgpu::Device, first_view: usize, views: u32, [width, height]: [u32; 2]) {
        self.stores.entry(first_view).or_insert_with(|| {
            let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
            let size = [width * CELLS, height * CELLS, views * SLOTS];
            let slots = |format, usage| Slots::new(device, size, format, usage);
            Store {
                lights: slots(LUMINANCE_FORMAT, drawn),
                keys: slots(KEY_FORMAT, drawn),
                means: slots(LUMINANCE_FORMAT, wgpu::TextureUsages::STORAGE_BINDING),
                held: vec![None; (views * SLOTS) as usize],
            }
        });
    }

    /// Whether keyframe `number` of `view` must be drawn; from now on it is held, in the place of the last but one.
    pub fn claim(&mut self, first_view: usize, view: u32, number: i64) -> bool {
        let Some(store) = self.stores.get_mut(&first_view) else { return false };
        let held = &mut store.held[Keyframe::layer(view, number) as usize];
        held.replace(number) != Some(number)
    }

    /// Uploads what `instants` and `keyframes` need.
    pub fn upload(
        &mut self,
        context: &Context,
        first_view: usize,
        views: &[View],
        instants: &[Instant],
        keyframes: &[Keyframe],
    ) -> Option<ReuseGroups> {
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        let store = self.stores.get(&first_view)?;
        let size = store.lights.texture.size();
        let trail = &context.frame_data.trail;
        let clip = |view: &View, frame: u32| {
            columns(&(view.lens.clip_from_camera() * trail.camera_from_world[frame as usize]))
        };
        let mut entries = Vec::new();
        for instant in instants {
            let view = &views[instant.view as usize];
            let [older, newer] = instant.around;
            for offset in &context.offsets {
                entries.push(ReuseFrame {
                    older_clip_from_world: clip(view, older),
                    newer_clip_from_world: clip(view, newer),
                    cells: [size.width as f32, size.height as f32],
                    // A picture that is moved by an offset is sampled at the opposite place.
                    shift: *offset,
                    older: Keyframe::layer(instant.view, instant.keyframes[0]),
                    newer: Keyframe::layer(instant.view, instant.keyframes[1]),
                    weight: instant.weight,
                    first_record: context.object_base(instant.frame),
                });
            }
        }
        let first_keyframe = entries.len() as u32;
        for keyframe in keyframes {
            entries
                .push(ReuseFrame { first_record: context.object_base(keyframe.frame), ..Default::default() });
        }
        let means: Vec<MeanParams> = keyframes
            .iter()
            .map(|keyframe| MeanParams {
                width: size.width,
                height: size.height,
                layer: Keyframe::layer(keyframe.view, keyframe.number),
                pad: 0,
            })
            .collect();
        self.frames.write(device, queue, &aligned(&entries));
        self.means.write(device, queue, &aligned(&means));
        let frame = || pass::part(self.frames.get(), 0, size_of::<ReuseFrame>() as u64);
        let cells = || [&store.lights, &store.keys, &store.means].map(|slots| &slots.array);
        let textures = || cells().into_iter().map(wgpu::BindingResource::TextureView);
        let points = wgpu::BindingResource::Sampler(&self.points);
        let instants = std::iter::once(frame()).chain(textures()).chain([points]).collect();
        let params = pass::part(self.means.get(), 0, size_of::<MeanParams>() as u64);
        let mean = std::iter::once(params).chain(textures()).collect();
        let passes = &self.passes;
        Some(ReuseGroups {
            keyframe: pass::group(
                device,
                "keyframe",
                &passes.keyframe_layout,
                KEYFRAME_BINDINGS,
                vec![frame()],
            ),
            instants: pass::group(device, "reuse", &passes.reuse_layout, REUSE_BINDINGS, instants),
            mean: pass::group(device, "cell mean", &passes.mean.layout, CELL_MEAN_BINDINGS, mean),
            first_keyframe,
        })
    }

    /// Records `keyframe`, the `entry`th of the submission.
    #[expect(clippy::too_many_arguments, reason = "what a keyframe is made of, in order")]
    pub fn encode_keyframe(
        &mut self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        frame_group: &wgpu::BindGroup,
        groups: &ReuseGroups,
        class: usize,
        first_view: usize,
        keyframe: &Keyframe,
        entry: u32,
    ) {
        let Some(store) = self.stores.get(&first_view) else { return };
        self.drawn += 1;
        let size = store.lights.texture.size();
        let layer = Keyframe::layer(keyframe.view, keyframe.number) as usize;
        let nothing = wgpu::Color::TRANSPARENT;
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("keyframe"),
            color_attachments: &[
                Some(attachment(&store.lights.each[layer], nothing)),
                Some(attachment(&store.keys.each[layer], nothing)),
            ],
            depth_stencil_attachment: Some(depth_attachment(&self.depth[class], wgpu::StoreOp::Discard)),
            ..Default::default()
        });
        let offset = (groups.first_keyframe + entry) * UNIFORM_ALIGNMENT as u32;
        pass.set_bind_group(3, &groups.keyframe, &[offset]);
        let what = Drawing {
            items: &context.frame_data.visible[keyframe.frame as usize],
            frame: keyframe.frame,
            // A cell reads textures over all of itself.
            sample: None,
            first_record: context.object_base(keyframe.frame),
        };
        let surroundings = Some(&context.surroundings);
        draw_surfaces(context, &mut pass, &self.passes.keyframe, frame_group, surroundings, &what);
        drop(pass);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.passes.mean.pipeline);
        pass.set_bind_group(0, &groups.mean, &[entry * UNIFORM_ALIGNMENT as u32]);
        pass.dispatch_workgroups(size.width.div_ceil(64), size.height, 1);
    }

    /// Draws what takes its light from keyframes, in sample `sample` of the submission's look `number`.
    pub fn draw(
        &self,
        context: &Context,
        pass: &mut wgpu::RenderPass<'_>,
        frame_group: &wgpu::BindGroup,
        groups: &ReuseGroups,
        still: &[DrawItem],
        (frame, sample, number): (u32, u32, u32),
    ) {
        let entry = number * context.offsets.len() as u32 + sample;
        pass.set_bind_group(3, &groups.instants, &[entry * UNIFORM_ALIGNMENT as u32]);
        let what =
            Drawing { items: still, frame, sample: Some(sample), first_record: context.object_base(frame) };
        let surroundings = Some(&context.surroundings);
        draw_surfaces(context, pass, &self.passes.surfaces, frame_group, surroundings, &what);
    }
}
