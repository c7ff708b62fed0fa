//! `reuse/*.wgsl`: keyframes of light, and surfaces that take theirs from two of them. Twin of the means: `cpu/reuse.rs`.

use std::collections::BTreeSet;

use super::raster::{
    LUMINANCE_FORMAT, Pipelines, SceneConstants, SurfaceLayouts, SurfacePipeline, surface_pipeline,
};
use super::{Access, Binding, ComputePass, bind, layout};
use crate::variant::{Interface, SurfaceVariant};

/// What is seen in a keyframe's cells.
pub const KEY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// Group 3 of `reuse/keyframe.wgsl`.
pub const KEYFRAME_BINDINGS: &[Binding] = &[bind(0, "reuse", Access::DynamicUniform)];
/// Group 3 of `reuse/luminance.wgsl`.
pub const REUSE_BINDINGS: &[Binding] = &[
    bind(0, "reuse", Access::DynamicUniform),
    bind(1, "lights", Access::Layers),
    bind(2, "keys", Access::UintLayers),
    bind(3, "means", Access::Layers),
    bind(4, "points", Access::PointSampler),
];
/// `reuse/mean.wgsl`.
pub const CELL_MEAN_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "lights", Access::Layers),
    bind(2, "keys", Access::UintLayers),
    bind(3, "means", Access::StorageLayers),
];

/// Places per side at which a cell reads a texture, at most.
const CELL_TAPS: u32 = 2;

/// Pipelines of `reproject`.
pub struct ReusePasses {
    /// Layout of the keyframe's group 3.
    pub keyframe_layout: wgpu::BindGroupLayout,
    /// Layout of an instant's group 3.
    pub reuse_layout: wgpu::BindGroupLayout,
    /// Light and key of every cell.
    pub keyframe: Pipelines,
    /// Surfaces that stand still, their light from keyframes.
    pub surfaces: Pipelines,
    /// Mean light around every corner.
    pub mean: ComputePass,
}

impl ReusePasses {
    /// For keyframes of `cells` x `cells` cells per pixel, and four coverage samples per instant.
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        variants: &BTreeSet<SurfaceVariant>,
        scene: &SceneConstants,
        cells: u32,
    ) -> Self {
        let stages = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let keyframe_layout = layout(device, "keyframe", KEYFRAME_BINDINGS, stages);
        let reuse_layout = layout(device, "reuse", REUSE_BINDINGS, stages);
        let what = |file, own, targets, sample_count, shades| SurfacePipeline {
            file,
            fragment: Some("fs_main"),
            groups: own,
            targets,
            interface: Interface { shades, places: true, ..Default::default() },
            sample_count,
            bias: wgpu::DepthBiasState::default(),
            cull: true,
        };
        let build = |what: &SurfacePipeline<'_>, constants: &SceneConstants| -> Pipelines {
            variants.iter().map(|v| (*v, surface_pipeline(device, what, v, constants))).collect()
        };
        // A cell is a whole pixel of its own picture.
        let of_cells = SceneConstants { texture_samples: 1, grid: 1, texture_taps: CELL_TAPS, ..*scene };
        let SurfaceLayouts { frame, material, surroundings } = layouts;
        Self {
            keyframe: build(
                &what(
                    "reuse/keyframe.wgsl",
                    &[frame, material, surroundings, &keyframe_layout],
                    &[Some(LUMINANCE_FORMAT.into()), Some(KEY_FORMAT.into())],
                    1,
                    true,
                ),
                &of_cells,
            ),
            surfaces: build(
                &what(
                    "reuse/luminance.wgsl",
                    &[frame, material, surroundings, &reuse_layout],
                    &[Some(LUMINANCE_FORMAT.into())],
                    4,
                    false,
                ),
                scene,
            ),
            mean: ComputePass::new(
                device,
                "reuse/mean.wgsl",
                CELL_MEAN_BINDINGS,
                &[("CELLS", f64::from(cells))],
            ),
            keyframe_layout,
            reuse_layout,
        }
    }
}
