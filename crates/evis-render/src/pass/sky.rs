//! `raster/sky.wgsl`: the environment behind everything; `raster/background.wgsl`: nothing, for a part of a picture.

use crate::gpu::variant::frame_prelude;
use crate::pass::raster::{LUMINANCE_FORMAT, SurfaceLayouts};
use crate::pass::{Shader, covering, pipeline_layout};

/// The sky pipeline writing `format` through fragment entry point `entry`.
pub fn pipeline(
    device: &wgpu::Device,
    layouts: &SurfaceLayouts,
    entry: &str,
    targets: &[Option<wgpu::ColorTargetState>],
    sample_count: u32,
    light_count: u32,
) -> wgpu::RenderPipeline {
    // Group 1 is a material elsewhere; the sky has none.
    let groups = [Some(&layouts.frame), None, Some(&layouts.surroundings)];
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("sky"),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    full_tile(device, "raster/sky.wgsl", &layout, entry, targets, sample_count, light_count)
}

/// The pipeline that clears parts of a luminance picture, and their depth.
pub fn background(device: &wgpu::Device, luminance: f64, sample_count: u32) -> wgpu::RenderPipeline {
    let file = "raster/background.wgsl";
    let shader = Shader::new(device, file, "");
    let layout = pipeline_layout(device, file, &[]);
    let depth = (true, wgpu::CompareFunction::Always);
    let targets = [Some(LUMINANCE_FORMAT.into())];
    covering(
        device,
        (&shader, "fs_main"),
        &[("BACKGROUND", luminance)],
        &layout,
        &targets,
        sample_count,
        depth,
    )
}

/// The pipeline of `labels/sky.wgsl`: flow at infinity.
pub fn flow_pipeline(
    device: &wgpu::Device,
    frame: &wgpu::BindGroupLayout,
    sky: &wgpu::BindGroupLayout,
    targets: &[Option<wgpu::ColorTargetState>],
    light_count: u32,
) -> wgpu::RenderPipeline {
    let layout = pipeline_layout(device, "sky flow", &[frame, sky]);
    full_tile(device, "labels/sky.wgsl", &layout, "fs_main", targets, 1, light_count)
}

fn full_tile(
    device: &wgpu::Device,
    file: &str,
    layout: &wgpu::PipelineLayout,
    entry: &str,
    targets: &[Option<wgpu::ColorTargetState>],
    sample_count: u32,
    light_count: u32,
) -> wgpu::RenderPipeline {
    let shader = Shader::new(device, file, &frame_prelude(light_count));
    // Drawn last, at depth 0: only where nothing was drawn.
    let depth = (false, wgpu::CompareFunction::GreaterEqual);
    covering(device, (&shader, entry), &[], layout, targets, sample_count, depth)
}
