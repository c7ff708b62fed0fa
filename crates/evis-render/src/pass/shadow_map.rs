//! `raster/shadow_map.wgsl`: depth from a light.

use super::raster::{Pipelines, SceneConstants, SurfaceLayouts, SurfacePipeline, surface_pipeline};
use crate::variant::{Interface, SurfaceVariant};

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
