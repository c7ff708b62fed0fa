//! Bindings and pipelines of every pass. A pass with arithmetic of its own has a CPU twin of the same name and a test.

pub mod adaptive;
pub mod decoupled;
pub mod labels;
pub mod raster;
pub mod resample;
pub mod shadow_map;
pub mod sky;
pub mod splat;
pub mod trigger;

use crate::gpu::commands::Commands;
use crate::gpu::texture::DEPTH_FORMAT;
use crate::gpu::{shader, sizes};

/// What a shader does with a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Uniform buffer.
    Uniform,
    /// Uniform buffer at a dynamic offset.
    DynamicUniform,
    /// Storage buffer, read only.
    Read,
    /// Storage buffer, written.
    Write,
    /// Float texture, filtered.
    Texture,
    /// Float texture array, not filtered.
    Layers,
    /// Multisampled float texture.
    Multisampled,
    /// Cube map, filtered.
    Cube,
    /// Depth texture array.
    DepthLayers,
    /// Float texture, not filtered.
    Picture,
    /// Unsigned texture.
    UintPicture,
    /// Unsigned texture array.
    UintLayers,
    /// `r32float` storage texture array, read: software drivers do so three times as fast as by a fetch.
    ReadLayers,
    /// `rgba32uint` storage texture array, read.
    ReadLayersWords,
    /// `r32uint` storage texture array, read.
    ReadLayersWord,
    /// `r32uint` storage texture array, read and written.
    UpdateLayersWord,
    /// `r32float` storage texture, written.
    StorageLayer,
    /// `r32float` storage texture array, written.
    StorageLayers,
    /// `rgba32float` storage texture array, written.
    StorageLayersRgba,
    /// `rgba32uint` storage texture array, written.
    StorageLayersWords,
    /// Filtering sampler.
    Sampler,
    /// Sampler that does not filter.
    PointSampler,
    /// Comparison sampler.
    ComparisonSampler,
}

/// One binding: its place, its name in the shader, what is done with it.
#[derive(Clone, Copy, Debug)]
pub struct Binding {
    /// `@binding`.
    pub binding: u32,
    /// Variable in the shader.
    #[cfg_attr(not(test), expect(dead_code, reason = "a test compares it with the shader"))]
    pub name: &'static str,
    /// Access.
    pub access: Access,
}

/// Shorthand for [`Binding`].
pub const fn bind(binding: u32, name: &'static str, access: Access) -> Binding {
    Binding { binding, name, access }
}

/// A layout for `bindings`, visible to `stages`.
pub fn layout(
    device: &wgpu::Device,
    label: &str,
    bindings: &[Binding],
    stages: wgpu::ShaderStages,
) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = bindings
        .iter()
        .map(|b| wgpu::BindGroupLayoutEntry {
            binding: b.binding,
            visibility: stages,
            ty: binding_type(b.access),
            count: None,
        })
        .collect();
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

fn binding_type(access: Access) -> wgpu::BindingType {
    use wgpu::{
        BufferBindingType, StorageTextureAccess, TextureFormat, TextureSampleType, TextureViewDimension,
    };
    let buffer =
        |ty, has_dynamic_offset| wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None };
    let texture = |sample_type, view_dimension, multisampled| wgpu::BindingType::Texture {
        sample_type,
        view_dimension,
        multisampled,
    };
    match access {
        Access::Uniform => buffer(BufferBindingType::Uniform, false),
        Access::DynamicUniform => buffer(BufferBindingType::Uniform, true),
        Access::Read => buffer(BufferBindingType::Storage { read_only: true }, false),
        Access::Write => buffer(BufferBindingType::Storage { read_only: false }, false),
        Access::Texture => {
            texture(TextureSampleType::Float { filterable: true }, TextureViewDimension::D2, false)
        }
        Access::Layers => {
            texture(TextureSampleType::Float { filterable: false }, TextureViewDimension::D2Array, false)
        }
        Access::Multisampled => {
            texture(TextureSampleType::Float { filterable: false }, TextureViewDimension::D2, true)
        }
        Access::Cube => {
            texture(TextureSampleType::Float { filterable: true }, TextureViewDimension::Cube, false)
        }
        Access::DepthLayers => texture(TextureSampleType::Depth, TextureViewDimension::D2Array, false),
        Access::Picture => {
            texture(TextureSampleType::Float { filterable: false }, TextureViewDimension::D2, false)
        }
        Access::UintPicture => texture(TextureSampleType::Uint, TextureViewDimension::D2, false),
        Access::UintLayers => texture(TextureSampleType::Uint, TextureViewDimension::D2Array, false),
        Access::ReadLayers => storage_layers(TextureFormat::R32Float, StorageTextureAccess::ReadOnly),
        Access::ReadLayersWords => storage_layers(TextureFormat::Rgba32Uint, StorageTextureAccess::ReadOnly),
        Access::ReadLayersWord => storage_layers(TextureFormat::R32Uint, StorageTextureAccess::ReadOnly),
        Access::UpdateLayersWord => storage_layers(TextureFormat::R32Uint, StorageTextureAccess::ReadWrite),
        Access::StorageLayer => wgpu::BindingType::StorageTexture {
            access: StorageTextureAccess::WriteOnly,
            format: TextureFormat::R32Float,
            view_dimension: TextureViewDimension::D2,
        },
        Access::StorageLayers => storage_layers(TextureFormat::R32Float, StorageTextureAccess::WriteOnly),
        Access::StorageLayersRgba => {
            storage_layers(TextureFormat::Rgba32Float, StorageTextureAccess::WriteOnly)
        }
        Access::StorageLayersWords => {
            storage_layers(TextureFormat::Rgba32Uint, StorageTextureAccess::WriteOnly)
        }
        Access::Sampler => wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
        Access::PointSampler => wgpu::BindingType::Sampler(wgpu::SamplerBindingType::NonFiltering),
        Access::ComparisonSampler => wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison),
    }
}

const fn storage_layers(
    format: wgpu::TextureFormat,
    access: wgpu::StorageTextureAccess,
) -> wgpu::BindingType {
    wgpu::BindingType::StorageTexture { access, format, view_dimension: wgpu::TextureViewDimension::D2Array }
}

/// `bytes` of `buffer` from `offset` on.
pub fn part(buffer: &wgpu::Buffer, offset: u64, bytes: u64) -> wgpu::BindingResource<'_> {
    wgpu::BindingResource::Buffer(wgpu::BufferBinding {
        buffer,
        offset,
        size: std::num::NonZeroU64::new(bytes),
    })
}

/// A compiled shader file.
pub struct Shader {
    module: wgpu::ShaderModule,
    file: String,
    /// What was compiled: `tests/portability.rs` translates it to the languages of other backends.
    #[cfg(test)]
    text: String,
}

impl Shader {
    /// Compiles `file` with `prelude` before it.
    pub fn new(device: &wgpu::Device, file: &str, prelude: &str) -> Self {
        let text = shader::compose(file, prelude);
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(file),
            source: wgpu::ShaderSource::Wgsl(text.as_str().into()),
        };
        // Injected loop counters keep drivers from unrolling the loops over samples and lights.
        let checks =
            wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..wgpu::ShaderRuntimeChecks::checked() };
        // SAFETY: every loop of our shaders counts to a bound that the host sets; bounds checks stay on.
        let module = unsafe { device.create_shader_module_trusted(descriptor, checks) };
        Self {
            module,
            file: file.to_owned(),
            #[cfg(test)]
            text,
        }
    }

    /// The module, of which a pipeline uses `entry` with `constants`. All pipelines take it from here, so that tests know
    /// every variant that is built.
    pub fn entry(
        &self,
        stage: naga::ShaderStage,
        entry: &str,
        constants: &[(&str, f64)],
    ) -> &wgpu::ShaderModule {
        #[cfg(test)]
        crate::tests::portability::record(&self.file, &self.text, stage, entry, constants);
        #[cfg(not(test))]
        let _ = (stage, entry, constants);
        &self.module
    }
}

/// A pipeline layout of `groups`, in order.
pub fn pipeline_layout(
    device: &wgpu::Device,
    label: &str,
    groups: &[&wgpu::BindGroupLayout],
) -> wgpu::PipelineLayout {
    let groups: Vec<_> = groups.iter().map(|g| Some(*g)).collect();
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: &groups,
        immediate_size: 0,
    })
}

/// The pipeline of a triangle over all of its targets, by the fragment entry point `entry` of `shader`.
/// `constants` are of the fragment stage; `writes_depth`, and where its depth passes.
pub fn covering(
    device: &wgpu::Device,
    (shader, entry): (&Shader, &str),
    constants: &[(&str, f64)],
    layout: &wgpu::PipelineLayout,
    targets: &[Option<wgpu::ColorTargetState>],
    sample_count: u32,
    (writes_depth, passes): (bool, wgpu::CompareFunction),
) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(&shader.file),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module: shader.entry(naga::ShaderStage::Vertex, "vs_main", &[]),
            entry_point: Some("vs_main"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(writes_depth),
            depth_compare: Some(passes),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState { count: sample_count, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: shader.entry(naga::ShaderStage::Fragment, entry, constants),
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A compute pass: its layout and pipeline.
pub struct ComputePass {
    /// Its shader file, which is its label.
    pub file: &'static str,
    /// Group 0.
    pub layout: wgpu::BindGroupLayout,
    /// Pipeline.
    pub pipeline: wgpu::ComputePipeline,
}

impl ComputePass {
    /// Builds `file`'s `main`.
    pub fn new(
        device: &wgpu::Device,
        file: &'static str,
        bindings: &[Binding],
        constants: &[(&str, f64)],
    ) -> Self {
        let layout = layout(device, file, bindings, wgpu::ShaderStages::COMPUTE);
        let pipeline = compute_pipeline(device, file, &layout, constants);
        Self { file, layout, pipeline }
    }

    /// Records the pass alone, with `group` at `offsets`.
    pub fn encode(
        &self,
        encoder: &mut Commands,
        group: &wgpu::BindGroup,
        offsets: &[u32],
        workgroups: (u32, u32, u32),
    ) {
        encoder.compute(self.file).dispatch(&self.pipeline, group, offsets, workgroups);
    }

    /// Records the pass alone, with as many workgroups as a buffer says at a byte, along each axis.
    pub fn encode_indirect(
        &self,
        encoder: &mut Commands,
        group: &wgpu::BindGroup,
        offsets: &[u32],
        counts: (&wgpu::Buffer, u64),
    ) {
        encoder.compute(self.file).dispatch_indirect(&self.pipeline, group, offsets, counts);
    }

    /// Records the pass over `tiles` tiles, a workgroup each, with the `job`th entry of its uniforms.
    pub fn encode_tiles(&self, encoder: &mut Commands, group: &wgpu::BindGroup, job: u32, tiles: u32) {
        let (x, y) = sizes::dispatch(tiles, 1);
        self.encode(encoder, group, &[job * sizes::UNIFORM_ALIGNMENT as u32], (x, y, 1));
    }
}

/// A compute pipeline of `file`'s `main`.
pub fn compute_pipeline(
    device: &wgpu::Device,
    file: &str,
    group: &wgpu::BindGroupLayout,
    constants: &[(&str, f64)],
) -> wgpu::ComputePipeline {
    let shader = Shader::new(device, file, "");
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(file),
        layout: Some(&pipeline_layout(device, file, &[group])),
        module: shader.entry(naga::ShaderStage::Compute, "main", constants),
        entry_point: Some("main"),
        compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
        cache: None,
    })
}

/// A bind group whose entries follow `bindings` in order.
pub fn group(
    device: &wgpu::Device,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    bindings: &[Binding],
    resources: Vec<wgpu::BindingResource<'_>>,
) -> wgpu::BindGroup {
    debug_assert_eq!(bindings.len(), resources.len());
    let entries: Vec<_> = bindings
        .iter()
        .zip(resources)
        .map(|(b, resource)| wgpu::BindGroupEntry { binding: b.binding, resource })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}
