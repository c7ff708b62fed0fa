//! `march/*.wgsl`: tiles that are rendered at keys and followed between them. No twin: `tests/floor2_march.rs`
//! holds them to pictures whose light is known.

use std::collections::BTreeSet;

use super::raster::{Pipelines, SceneConstants, SurfaceLayouts, SurfacePipeline, surface_pipeline};
use super::{Access, Binding, ComputePass, bind, layout};
use crate::variant::{Interface, SurfaceVariant};

/// Where in its object a pixel lies, and the object's number.
pub const PLACE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// Group 3 of `march/geometry.wgsl`.
pub const PLACE_BINDINGS: &[Binding] = &[bind(0, "first_record", Access::DynamicUniform)];
/// `march/keep.wgsl`.
pub const KEEP_BINDINGS: &[Binding] = &[
    bind(0, "job", Access::DynamicUniform),
    bind(1, "tiles", Access::Read),
    bind(2, "motions", Access::Read),
    bind(3, "samples", Access::ReadLayers),
    bind(4, "places", Access::ReadLayersRgba),
    bind(5, "kept_means", Access::StorageLayersRgba),
    bind(6, "kept_places", Access::StorageLayersRgba),
    bind(7, "sample_of", Access::Uniform),
];
/// `march/walk.wgsl`.
pub const WALK_BINDINGS: &[Binding] = &[
    bind(0, "job", Access::DynamicUniform),
    bind(1, "tiles", Access::Read),
    bind(2, "motions", Access::Read),
    bind(3, "kept_means", Access::ReadLayersRgba),
    bind(4, "kept_places", Access::ReadLayersRgba),
    bind(5, "layers", Access::StorageLayers),
    bind(6, "verdicts", Access::Write),
];

/// Pipelines of `march`.
pub struct MarchPasses {
    /// Layout of the places' group 3.
    pub place_layout: wgpu::BindGroupLayout,
    /// Places of a picture.
    pub places: Pipelines,
    /// Keeps keys.
    pub keep: ComputePass,
    /// Follows tiles, and tells which can be followed.
    pub walk: ComputePass,
}

impl MarchPasses {
    /// For `samples` per pixel in `columns` x `rows` cells.
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        variants: &BTreeSet<SurfaceVariant>,
        scene: &SceneConstants,
        [columns, rows]: [u32; 2],
    ) -> Self {
        let stages = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let place_layout = layout(device, "places", PLACE_BINDINGS, stages);
        let SurfaceLayouts { frame, material, surroundings } = layouts;
        let what = SurfacePipeline {
            file: "march/geometry.wgsl",
            fragment: Some("fs_main"),
            groups: &[frame, material, surroundings, &place_layout],
            targets: &[Some(PLACE_FORMAT.into())],
            interface: Interface::default(),
            sample_count: 1,
            bias: wgpu::DepthBiasState::default(),
            cull: true,
        };
        let places = variants.iter().map(|v| (*v, surface_pipeline(device, &what, v, scene))).collect();
        let cells = [("COLUMNS", f64::from(columns)), ("ROWS", f64::from(rows))];
        Self {
            place_layout,
            places,
            keep: ComputePass::new(device, "march/keep.wgsl", KEEP_BINDINGS, &cells),
            walk: ComputePass::new(device, "march/walk.wgsl", WALK_BINDINGS, &[]),
        }
    }
}
