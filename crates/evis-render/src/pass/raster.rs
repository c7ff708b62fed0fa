//! `raster/luminance.wgsl`: surfaces into one luminance target and depth. Also the parts that every pass
//! drawing surfaces shares: group layouts and pipeline construction by variant.

use std::collections::HashMap;

use crate::gpu::sizes::UNIFORM_ALIGNMENT;
use crate::gpu::texture::DEPTH_FORMAT;
use crate::gpu::uniforms::{Frame, InstanceRecord, LightRecord};
use crate::gpu::variant::{
    Attribute, INSTANCE_LOCATION, INSTANCE_SLOT, INSTANCE_VECTORS, Interface, LightSet, SurfaceVariant,
    attributes, prelude,
};
use crate::pass::{Access, Binding, Shader, bind, layout, pipeline_layout};

/// Luminance targets. 16 bits would quantise time: a step of 2^-11 at C = 0.2 is a quarter of a percent of a threshold.
pub const LUMINANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// Bytes of a frame with its lights, as bound.
pub const fn frame_bytes(light_count: u32) -> u64 {
    let lights = if light_count == 0 { 1 } else { light_count as u64 };
    size_of::<Frame>() as u64 + lights * size_of::<LightRecord>() as u64
}

/// Distance between frames in their uniform buffer.
pub const fn frame_stride(light_count: u32) -> u64 {
    frame_bytes(light_count).next_multiple_of(UNIFORM_ALIGNMENT)
}

/// Group 0: one view at one instant, what its vertices need, and the share of a pixel that the sample stands for.
pub const FRAME_BINDINGS: &[Binding] = &[
    bind(0, "frame", Access::DynamicUniform),
    bind(1, "objects", Access::Read),
    bind(2, "joints", Access::Read),
    bind(3, "morph_weights", Access::Read),
    bind(4, "morph_data", Access::Read),
    bind(5, "occluders", Access::Read),
    bind(6, "share", Access::DynamicUniform),
];

/// Group 1: a material.
pub const MATERIAL_BINDINGS: &[Binding] = &[
    bind(0, "material", Access::Uniform),
    bind(1, "base_texture", Access::Texture),
    bind(2, "base_sampler", Access::Sampler),
    bind(3, "metallic_roughness_texture", Access::Texture),
    bind(4, "metallic_roughness_sampler", Access::Sampler),
    bind(5, "normal_texture", Access::Texture),
    bind(6, "normal_sampler", Access::Sampler),
    bind(7, "occlusion_texture", Access::Texture),
    bind(8, "occlusion_sampler", Access::Sampler),
    bind(9, "emissive_texture", Access::Texture),
    bind(10, "emissive_sampler", Access::Sampler),
];

/// Group 2: shadows and environment.
pub const SURROUNDINGS_BINDINGS: &[Binding] = &[
    bind(0, "shadow_maps", Access::DepthLayers),
    bind(1, "shadow_sampler", Access::ComparisonSampler),
    bind(2, "irradiance_cube", Access::Cube),
    bind(3, "specular_cube", Access::Cube),
    bind(4, "sky_cube", Access::Cube),
    bind(5, "cube_sampler", Access::Sampler),
    bind(6, "brdf_lut", Access::Texture),
    bind(7, "occluder_words", Access::Read),
    bind(8, "shadow_texels", Access::PointSampler),
];

/// Layouts of the groups that surface passes share.
pub struct SurfaceLayouts {
    /// Group 0.
    pub frame: wgpu::BindGroupLayout,
    /// Group 1.
    pub material: wgpu::BindGroupLayout,
    /// Group 2.
    pub surroundings: wgpu::BindGroupLayout,
}

impl SurfaceLayouts {
    /// Creates them.
    pub fn new(device: &wgpu::Device) -> Self {
        let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
        Self {
            frame: layout(device, "frame", FRAME_BINDINGS, both),
            material: layout(device, "material", MATERIAL_BINDINGS, both),
            surroundings: layout(device, "surroundings", SURROUNDINGS_BINDINGS, wgpu::ShaderStages::FRAGMENT),
        }
    }
}

/// Shares of the footprint of a drawn pixel, `grid` of which lie along each side of a sensor's, that each of its `samples`
/// reads textures by. Trilinear filtering is a tent two texels wide: a
/// sample that stood for exactly its share would reach over its neighbours' and blur; half of the share was the best of
/// 1, 1/2, 1/4 and 1/8 on the built-in `warehouse` (16 samples: F1 0.82, 0.87, 0.87, 0.86). A lone sample has no neighbours.
pub const fn texture_samples(samples: u32, grid: u32) -> u32 {
    if samples * grid > 1 { 2 * samples } else { 1 }
}

/// Places per side at which a texture is read for a whole pixel, by labels.
pub const WHOLE_PIXEL_TAPS: u32 = 4;

/// What the scene, not the material, decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneConstants {
    /// Lights that reach every surface.
    pub lights: LightSet,
    /// Whether any light throws shadows.
    pub shadows: bool,
    /// Whether rays decide along their borders.
    pub shadow_rays: bool,
    /// Whether there is an environment.
    pub environment: bool,
    /// [`texture_samples`], of a pixel of the picture that is drawn.
    pub texture_samples: u32,
    /// Pixels of that picture along each side of a pixel.
    pub grid: u32,
    /// Places per side of a sample's share at which it reads textures, at most.
    pub texture_taps: u32,
}

/// Everything that a surface pipeline is built from.
pub struct SurfacePipeline<'a> {
    /// Shader file.
    pub file: &'a str,
    /// Fragment entry point; `None` for depth only.
    pub fragment: Option<&'a str>,
    /// Groups, in order.
    pub groups: &'a [&'a wgpu::BindGroupLayout],
    /// Colour targets.
    pub targets: &'a [Option<wgpu::ColorTargetState>],
    /// Vertex interface.
    pub interface: Interface,
    /// Samples per pixel of the targets.
    pub sample_count: u32,
    /// Depth bias, for shadow maps.
    pub bias: wgpu::DepthBiasState,
    /// Whether back faces are culled where the material allows it.
    pub cull: bool,
}

/// Builds the pipeline of `variant`.
pub fn surface_pipeline(
    device: &wgpu::Device,
    what: &SurfacePipeline<'_>,
    variant: &SurfaceVariant,
    scene: &SceneConstants,
) -> wgpu::RenderPipeline {
    let shader = Shader::new(device, what.file, &prelude(variant, what.interface, &scene.lights));
    let flag = |b: bool| f64::from(u8::from(b));
    let all = [
        ("SKINNED", flag(variant.skinned)),
        ("MORPHED", flag(variant.morphed)),
        ("HAS_BASE_TEXTURE", flag(variant.base_texture)),
        ("HAS_METALLIC_ROUGHNESS_TEXTURE", flag(variant.metallic_roughness_texture)),
        ("HAS_NORMAL_TEXTURE", flag(variant.normal_texture)),
        ("HAS_OCCLUSION_TEXTURE", flag(variant.occlusion_texture)),
        ("HAS_EMISSIVE_TEXTURE", flag(variant.emissive_texture)),
        ("ALPHA_MASK", flag(variant.mask)),
        // Only what shades is given them.
        ("DRIVEN_FACTORS", flag(variant.driven && what.interface.shades)),
        ("UV_TRANSFORM", flag(variant.uv_transform)),
        ("TEXTURE_SAMPLES", f64::from(scene.texture_samples)),
        ("TEXTURE_TAPS", f64::from(scene.texture_taps)),
        ("GRID", f64::from(scene.grid)),
        ("SHADING_MODEL", f64::from(variant.model)),
        ("SHADOWS", flag(scene.shadows && variant.lit())),
        ("SHADOW_RAYS", flag(scene.shadow_rays)),
        ("ENVIRONMENT", flag(scene.environment && variant.lit())),
    ];
    // A constant that the file does not declare is an error: pass only the ones that it has.
    let source = crate::gpu::shader::compose(what.file, "");
    let constants: Vec<_> =
        all.into_iter().filter(|(name, _)| source.contains(&format!("override {name}:"))).collect();
    let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
    let used = attributes(variant, what.interface);
    let mut slots: [Vec<wgpu::VertexAttribute>; INSTANCE_SLOT + 1] = Default::default();
    for (location, attribute) in Attribute::ALL.into_iter().enumerate().filter(|(_, a)| used.contains(a)) {
        slots[attribute.slot()].push(wgpu::VertexAttribute {
            format: attribute.format(),
            offset: attribute.offset(),
            shader_location: location as u32,
        });
    }
    slots[INSTANCE_SLOT] = (0..INSTANCE_VECTORS)
        .map(|i| wgpu::VertexAttribute {
            format: wgpu::VertexFormat::Float32x4,
            offset: u64::from(i) * 16,
            shader_location: INSTANCE_LOCATION + i,
        })
        .collect();
    let buffers: Vec<_> = slots
        .iter()
        .enumerate()
        .map(|(slot, attributes)| {
            (!attributes.is_empty()).then(|| wgpu::VertexBufferLayout {
                array_stride: slot_stride(slot),
                step_mode: if slot == INSTANCE_SLOT {
                    wgpu::VertexStepMode::Instance
                } else {
                    wgpu::VertexStepMode::Vertex
                },
                attributes,
            })
        })
        .collect();
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(what.file),
        layout: Some(&pipeline_layout(device, what.file, what.groups)),
        vertex: wgpu::VertexState {
            module: shader.entry(naga::ShaderStage::Vertex, "vs_main", &constants),
            entry_point: Some("vs_main"),
            compilation_options: options.clone(),
            buffers: &buffers,
        },
        primitive: wgpu::PrimitiveState {
            front_face: if variant.mirrored { wgpu::FrontFace::Cw } else { wgpu::FrontFace::Ccw },
            cull_mode: (what.cull && !variant.double_sided).then_some(wgpu::Face::Back),
            ..Default::default()
        },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: what.bias,
        }),
        multisample: wgpu::MultisampleState { count: what.sample_count, ..Default::default() },
        fragment: what.fragment.map(|entry| wgpu::FragmentState {
            module: shader.entry(naga::ShaderStage::Fragment, entry, &constants),
            entry_point: Some(entry),
            compilation_options: options.clone(),
            targets: what.targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// Bytes from one vertex (or instance) to the next in `slot`.
fn slot_stride(slot: usize) -> u64 {
    if slot == INSTANCE_SLOT {
        return size_of::<InstanceRecord>() as u64;
    }
    Attribute::ALL.iter().filter(|a| a.slot() == slot).map(|a| a.format().size()).sum()
}

/// Pipelines by variant.
pub type Pipelines = HashMap<SurfaceVariant, wgpu::RenderPipeline>;

/// The luminance pipelines of `variants`.
pub fn luminance_pipelines(
    device: &wgpu::Device,
    layouts: &SurfaceLayouts,
    variants: impl Iterator<Item = SurfaceVariant>,
    scene: &SceneConstants,
    sample_count: u32,
) -> Pipelines {
    let what = SurfacePipeline {
        file: "raster/luminance.wgsl",
        fragment: Some("fs_main"),
        groups: &[&layouts.frame, &layouts.material, &layouts.surroundings],
        targets: &[Some(LUMINANCE_FORMAT.into())],
        interface: Interface { shades: true, ..Default::default() },
        sample_count,
        bias: wgpu::DepthBiasState::default(),
        cull: true,
    };
    variants.map(|v| (v, surface_pipeline(device, &what, &v, scene))).collect()
}
