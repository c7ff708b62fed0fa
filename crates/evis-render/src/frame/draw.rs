//! Drawing the surfaces of a frame, whatever the pass is.

use crate::frame::upload::FrameBuffers;
use crate::gpu::variant::INSTANCE_SLOT;
use crate::pass::raster::Pipelines;
use crate::world::gpu_scene::{Draw, DrawItem, GpuScene};

/// What draws read: the scene, and the frames that were uploaded.
#[derive(Clone, Copy)]
pub struct Stage<'a> {
    /// Vertices, indices and materials.
    pub scene: &'a GpuScene,
    /// Matrices and records.
    pub buffers: &'a FrameBuffers,
    /// Group 0.
    pub frame_group: &'a wgpu::BindGroup,
}

/// What [`draw_surfaces`] draws.
pub struct Drawing<'a> {
    /// In order.
    pub items: &'a [DrawItem],
    /// Frame, for group 0.
    pub frame: u32,
    /// Sample of the pixel that this draws; none for the whole of it.
    pub sample: Option<u32>,
    /// Record of the first object.
    pub first_record: u32,
}

/// Reverse z: cleared to 0, the far plane.
pub fn depth_attachment(
    view: &wgpu::TextureView,
    store: wgpu::StoreOp,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store }),
        stencil_ops: None,
    }
}

/// A cleared colour target.
pub fn attachment(view: &wgpu::TextureView, clear: wgpu::Color) -> wgpu::RenderPassColorAttachment<'_> {
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Clear(clear), store: wgpu::StoreOp::Store },
    }
}

/// Draws surfaces, changing no more state than it must.
pub fn draw_surfaces(
    stage: Stage<'_>,
    pass: &mut wgpu::RenderPass<'_>,
    pipelines: &Pipelines,
    surroundings: Option<&wgpu::BindGroup>,
    what: &Drawing<'_>,
) {
    let Stage { scene, buffers, frame_group } = stage;
    for (slot, buffer) in scene.vertices.iter().enumerate() {
        if let Some(buffer) = buffer {
            pass.set_vertex_buffer(slot as u32, buffer.slice(..));
        }
    }
    pass.set_vertex_buffer(INSTANCE_SLOT as u32, buffers.instances.get().slice(..));
    pass.set_index_buffer(scene.indices.slice(..), wgpu::IndexFormat::Uint32);
    pass.set_bind_group(0, frame_group, &buffers.offsets(what.frame, what.sample));
    if let Some(surroundings) = surroundings {
        pass.set_bind_group(2, surroundings, &[]);
    }
    let mut last: Option<&Draw> = None;
    for item in what.items {
        let draw = &scene.draws[item.draw as usize];
        if last.is_none_or(|l| l.variant != draw.variant) {
            pass.set_pipeline(&pipelines[&draw.variant]);
        }
        if last.is_none_or(|l| l.material != draw.material) {
            pass.set_bind_group(1, &scene.materials[draw.material], &[]);
        }
        let records = item.objects.start + what.first_record..item.objects.end + what.first_record;
        pass.draw_indexed(draw.indices.clone(), draw.base_vertex, records);
        last = Some(draw);
    }
}
