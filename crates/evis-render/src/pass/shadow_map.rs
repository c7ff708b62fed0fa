//! `raster/shadow_map.wgsl`: depth from a light. `raster/shadow_restore.wgsl`: what stands still, again.

use crate::gpu::variant::{Interface, SurfaceVariant};
use crate::pass::raster::{Pipelines, SceneConstants, SurfaceLayouts, SurfacePipeline, surface_pipeline};
use crate::pass::{Access, Binding, Shader, bind, covering, layout, pipeline_layout};

/// `raster/shadow_restore.wgsl`.
pub const RESTORE_BINDINGS: &[Binding] = &[bind(0, "still_maps", Access::DepthLayers)];

/// Shadow pipelines of `variants`. Back faces are drawn too: an open mesh throws its shadow from both sides.
pub fn pipelines(
    device: &wgpu::Device,
    layouts: &SurfaceLayouts,
    variants: impl Iterator<Item = SurfaceVariant>,
    scene: &SceneConstants,
) -> Pipelines {
    variants
        .map(|v| {
            let what = SurfacePipeline {
                file: "raster/shadow_map.wgsl",
                fragment: v.mask.then_some("fs_masked"),
                groups: &[&layouts.frame, &layouts.material],
                targets: &[],
                interface: Interface::default(),
                sample_count: 1,
                // Reverse z: away from the light is towards 0. The rest of the bias is in `raster/shadow.wgsl`. Rays need
                // none: there, the map is compared with the surface's own plane.
                bias: if scene.shadow_rays {
                    wgpu::DepthBiasState::default()
                } else {
                    wgpu::DepthBiasState { constant: -2, slope_scale: -1.25, clamp: 0.0 }
                },
                cull: false,
            };
            (v, surface_pipeline(device, &what, &v, scene))
        })
        .collect()
}

/// The pipeline that writes parts of a layer of the still maps over what was drawn, and the layout of its group: copies of depth
/// are of whole maps only.
pub fn restore(device: &wgpu::Device) -> (wgpu::RenderPipeline, wgpu::BindGroupLayout) {
    let file = "raster/shadow_restore.wgsl";
    let group = layout(device, "still maps", RESTORE_BINDINGS, wgpu::ShaderStages::FRAGMENT);
    let shader = Shader::new(device, file, "");
    let layout = pipeline_layout(device, file, &[&group]);
    let depth = (true, wgpu::CompareFunction::Always);
    let pipeline = covering(device, (&shader, "fs_main"), &[], &layout, &[], 1, depth);
    (pipeline, group)
}
