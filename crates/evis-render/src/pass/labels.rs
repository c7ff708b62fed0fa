//! `labels/*.wgsl`: labels, one sample at the pixel's centre.

use crate::gpu::variant::{Interface, SurfaceVariant};
use crate::pass::raster::{Pipelines, SceneConstants, SurfaceLayouts, SurfacePipeline, surface_pipeline};
use crate::pass::{Access, Binding, bind, layout};

/// Group 3 of the geometry labels.
pub const LABEL_BINDINGS: &[Binding] =
    &[bind(0, "label", Access::Uniform), bind(1, "instances", Access::Read)];

/// Group 1 of the sky's flow.
pub const SKY_FLOW_BINDINGS: &[Binding] = &[bind(0, "sky", Access::DynamicUniform)];

/// Targets of the geometry labels: inverse depth, flow forward and backward, ids.
pub const GEOMETRY_FORMATS: [wgpu::TextureFormat; 3] =
    [wgpu::TextureFormat::R32Float, wgpu::TextureFormat::Rgba32Float, wgpu::TextureFormat::Rg32Uint];

/// Targets of the appearance labels: linear RGB, normal.
pub const APPEARANCE_FORMATS: [wgpu::TextureFormat; 2] =
    [wgpu::TextureFormat::Rgba32Float, wgpu::TextureFormat::Rgba32Float];

/// Which targets a run needs: an absent one is neither allocated nor written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LabelTargets {
    /// Inverse depth, flow, ids.
    pub geometry: [bool; 3],
    /// Colour, normal.
    pub appearance: [bool; 2],
}

impl LabelTargets {
    /// Whether the geometry pass runs.
    pub fn any_geometry(&self) -> bool {
        self.geometry.iter().any(|&b| b)
    }

    /// Whether the appearance pass runs.
    pub fn any_appearance(&self) -> bool {
        self.appearance.iter().any(|&b| b)
    }
}

/// Colour targets of a label pass, `None` where not asked for.
pub fn targets<const N: usize>(
    formats: [wgpu::TextureFormat; N],
    wanted: [bool; N],
) -> [Option<wgpu::ColorTargetState>; N] {
    std::array::from_fn(|i| wanted[i].then(|| formats[i].into()))
}

/// Layout of group 3.
pub fn label_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    layout(device, "label", LABEL_BINDINGS, wgpu::ShaderStages::VERTEX_FRAGMENT)
}

/// Layout of the sky's group 1.
pub fn sky_flow_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    layout(device, "sky flow", SKY_FLOW_BINDINGS, wgpu::ShaderStages::FRAGMENT)
}

/// Geometry label pipelines.
pub fn geometry_pipelines(
    device: &wgpu::Device,
    layouts: &SurfaceLayouts,
    label: &wgpu::BindGroupLayout,
    variants: impl Iterator<Item = SurfaceVariant>,
    scene: &SceneConstants,
    wanted: [bool; 3],
) -> Pipelines {
    let what = SurfacePipeline {
        file: "labels/geometry.wgsl",
        fragment: Some("fs_main"),
        groups: &[&layouts.frame, &layouts.material, &layouts.surroundings, label],
        targets: &targets(GEOMETRY_FORMATS, wanted),
        interface: Interface::default(),
        sample_count: 1,
        bias: wgpu::DepthBiasState::default(),
        cull: true,
    };
    variants.map(|v| (v, surface_pipeline(device, &what, &v, scene))).collect()
}

/// Appearance label pipelines.
pub fn appearance_pipelines(
    device: &wgpu::Device,
    layouts: &SurfaceLayouts,
    variants: impl Iterator<Item = SurfaceVariant>,
    scene: &SceneConstants,
    wanted: [bool; 2],
) -> Pipelines {
    let what = SurfacePipeline {
        file: "labels/appearance.wgsl",
        fragment: Some("fs_main"),
        groups: &[&layouts.frame, &layouts.material, &layouts.surroundings],
        targets: &targets(APPEARANCE_FORMATS, wanted),
        interface: Interface { normal_label: wanted[1], shades: true },
        sample_count: 1,
        bias: wgpu::DepthBiasState::default(),
        cull: true,
    };
    variants.map(|v| (v, surface_pipeline(device, &what, &v, scene))).collect()
}
