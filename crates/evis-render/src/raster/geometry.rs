//! What is where, and how it moves: inverse depth, flow to two other times, ids; for labels and for keyframes.

use crate::frame::draw::{Drawing, attachment, depth_attachment, draw_surfaces};
use crate::gpu::buffer::{GrowingBuffer, aligned};
use crate::gpu::commands::Commands;
use crate::gpu::sizes::UNIFORM_ALIGNMENT;
use crate::gpu::uniforms::{LabelFrame, SkyFlow};
use crate::pass::labels::{
    GEOMETRY_FORMATS, LABEL_BINDINGS, SKY_FLOW_BINDINGS, geometry_pipelines, label_layout, sky_flow_layout,
    targets,
};
use crate::pass::raster::{Pipelines, SceneConstants, SurfaceLayouts, WHOLE_PIXEL_TAPS};
use crate::pass::{self, sky};
use crate::raster::context::Context;
use crate::world::gpu_scene::GpuScene;
use crate::world::raster_lens::RasterLens;
use crate::world::transform::{columns, rigid};
use crate::world::view::View;

/// A flow component at least this large means "not defined" (`NO_FLOW` in the shader).
pub const NO_FLOW: f32 = 1e29;

/// The geometry pass, one sample at the pixel's centre.
pub struct GeometryRenderer {
    pipelines: Pipelines,
    sky: Option<wgpu::RenderPipeline>,
    label_layout: wgpu::BindGroupLayout,
    sky_layout: wgpu::BindGroupLayout,
    label_uniform: GrowingBuffer,
    sky_uniform: GrowingBuffer,
}

/// What a submission's geometry passes share.
pub struct GeometryGroups {
    label: wgpu::BindGroup,
    sky: wgpu::BindGroup,
}

/// One pass: a frame, its sky in [`GeometryRenderer::upload`]'s list, and where it goes.
pub struct GeometryPass<'a> {
    /// Frame of the submission.
    pub frame: u32,
    /// Index into the list of skies.
    pub sky: u32,
    /// Inverse depth, flow, ids; `None` where the renderer was made without.
    pub targets: [Option<&'a wgpu::TextureView>; 3],
    /// Depth.
    pub depth: &'a wgpu::TextureView,
}

impl GeometryRenderer {
    /// Builds the pipelines that write the `wanted` of inverse depth, flow and ids.
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        gpu_scene: &GpuScene,
        constants: &SceneConstants,
        wanted: [bool; 3],
    ) -> Self {
        // One sample at the pixel's centre stands for a whole pixel.
        let constants =
            SceneConstants { texture_samples: 1, grid: 1, texture_taps: WHOLE_PIXEL_TAPS, ..*constants };
        let (label_layout, sky_layout) = (label_layout(device), sky_flow_layout(device));
        let variants = gpu_scene.variants().into_iter();
        let pipelines = geometry_pipelines(device, layouts, &label_layout, variants, &constants, wanted);
        let [_, flow, _] = wanted;
        let sky = flow.then(|| {
            let targets = targets(GEOMETRY_FORMATS, wanted);
            sky::flow_pipeline(device, &layouts.frame, &sky_layout, &targets, constants.lights.count)
        });
        Self {
            pipelines,
            sky,
            label_layout,
            sky_layout,
            label_uniform: GrowingBuffer::new(device, "label", wgpu::BufferUsages::UNIFORM),
            sky_uniform: GrowingBuffer::new(device, "sky flow", wgpu::BufferUsages::UNIFORM),
        }
    }

    /// Uploads where the records of the two other times lie (`label`) and how the sky moves.
    pub fn upload(&mut self, context: &Context, label: &LabelFrame, skies: &[SkyFlow]) -> GeometryGroups {
        let gpu = &context.gpu;
        self.label_uniform.write(&gpu.device, &gpu.queue, bytemuck::bytes_of(label));
        self.sky_uniform.write(&gpu.device, &gpu.queue, &aligned(skies));
        let label = vec![
            self.label_uniform.get().as_entire_binding(),
            context.frame_buffers.instances.get().as_entire_binding(),
        ];
        let sky = vec![pass::part(self.sky_uniform.get(), 0, size_of::<SkyFlow>() as u64)];
        GeometryGroups {
            label: pass::group(&gpu.device, "label", &self.label_layout, LABEL_BINDINGS, label),
            sky: pass::group(&gpu.device, "sky flow", &self.sky_layout, SKY_FLOW_BINDINGS, sky),
        }
    }

    /// Records one pass.
    pub fn encode(
        &self,
        context: &Context,
        encoder: &mut Commands,
        frame_group: &wgpu::BindGroup,
        groups: &GeometryGroups,
        what: &GeometryPass<'_>,
    ) {
        let none = f64::from(NO_FLOW) * 10.0;
        let clears = [
            wgpu::Color::TRANSPARENT,
            wgpu::Color { r: none, g: none, b: none, a: none },
            wgpu::Color::TRANSPARENT,
        ];
        let attachments: [_; 3] =
            std::array::from_fn(|i| what.targets[i].map(|view| attachment(view, clears[i])));
        let depth = depth_attachment(what.depth, wgpu::StoreOp::Discard);
        let mut pass = encoder.render("geometry labels", &attachments, depth);
        pass.set_bind_group(3, &groups.label, &[]);
        let drawing = Drawing {
            items: &context.frame_data.visible[what.frame as usize],
            frame: what.frame,
            sample: None,
            first_record: context.object_base(what.frame),
        };
        let surroundings = Some(&context.surroundings);
        draw_surfaces(context.stage(frame_group), &mut pass, &self.pipelines, surroundings, &drawing);
        if let Some(sky) = &self.sky {
            pass.set_pipeline(sky);
            pass.set_bind_group(0, frame_group, &context.frame_offsets(what.frame, None));
            pass.set_bind_group(1, &groups.sky, &[what.sky * UNIFORM_ALIGNMENT as u32]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// How what lies at infinity moves from `view` now to the two `other_us`.
pub fn sky_flow(context: &Context, view: &View, other_us: [i64; 2]) -> SkyFlow {
    let mut state = evis_scene::SceneState::default();
    let [next_clip_from_world, last_clip_from_world] = other_us.map(|t_us| {
        let variant = context.scene.variants.get(view.environment);
        context.scene.evaluate_variant(variant, context.scene_time_s(t_us), &mut state);
        let mut world_from_camera = rigid(&state.world_from_node[view.node]);
        world_from_camera.w_axis = glam::DVec4::W;
        columns(&(view.lens.clip_from_camera() * world_from_camera.inverse()))
    });
    let half_size = [view.lens.width as f32 / 2.0, view.lens.height as f32 / 2.0];
    SkyFlow { next_clip_from_world, last_clip_from_world, half_size, pad: [0.0; 2] }
}
