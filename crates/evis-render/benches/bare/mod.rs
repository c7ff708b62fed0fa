//! The yardstick: a plain wgpu renderer of a scene's triangles, independent of the engine. One vertex buffer of world
//! positions, normals and texture coordinates, one draw per instant, one matrix, one target that every instant
//! overwrites, nothing read back. It knows one material and one light, and stands still but for the camera.

use std::time::{Duration, Instant};

use bytemuck::{Pod, Zeroable};
use evis_render::scene::{Lens, Scene, SceneState};
use glam::{DMat4, DVec3, DVec4, Vec3};
use wgpu::util::DeviceExt as _;

use crate::support::Failure;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Vertex {
    position: [f32; 3],
    normal: [f32; 3],
    uv: [f32; 2],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Frame {
    clip_from_world: [[f32; 4]; 4],
    to_light: [f32; 4],
    light: [f32; 4],
    ambient: [f32; 4],
}

/// WebGPU's guaranteed dynamic offset alignment.
const FRAME_STRIDE: usize = 256;
/// Instants in one submission, as many as the engine takes at most.
pub const INSTANTS: u32 = 32;

/// The renderer.
pub struct Bare {
    device: wgpu::Device,
    queue: wgpu::Queue,
    pipeline: wgpu::RenderPipeline,
    group: wgpu::BindGroup,
    frames: wgpu::Buffer,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    index_count: u32,
    target: wgpu::TextureView,
    depth: wgpu::TextureView,
    size: [u32; 2],
    state: SceneState,
}

impl Bare {
    /// Uploads the triangles of `scene`, objects nearest first as a careful author would sort them.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        scene: &Scene,
        size: [u32; 2],
    ) -> Result<Self, Failure> {
        let mut state = SceneState::default();
        scene.evaluate(0.0, &mut state);
        let (vertices, indices) = triangles(scene, &state)?;
        let buffer = |contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
        };
        let frames = device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: FRAME_STRIDE as u64 * u64::from(INSTANTS),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let albedo = upload_texture(device, queue, scene)?;
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: None,
            entries: &[
                entry(
                    0,
                    wgpu::BindingType::Buffer {
                        ty: wgpu::BufferBindingType::Uniform,
                        has_dynamic_offset: true,
                        min_binding_size: None,
                    },
                ),
                entry(
                    1,
                    wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: true },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                ),
                entry(2, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
            ],
        });
        let trilinear = device.create_sampler(&wgpu::SamplerDescriptor {
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..Default::default()
        });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &frames,
                        offset: 0,
                        size: std::num::NonZeroU64::new(size_of::<Frame>() as u64),
                    }),
                },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&albedo) },
                wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::Sampler(&trilinear) },
            ],
        });
        let target = |format| {
            device
                .create_texture(&wgpu::TextureDescriptor {
                    label: None,
                    size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format,
                    usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
                    view_formats: &[],
                })
                .create_view(&Default::default())
        };
        Ok(Self {
            device: device.clone(),
            queue: queue.clone(),
            pipeline: pipeline(device, &layout),
            group,
            frames,
            vertices: buffer(bytemuck::cast_slice(&vertices), wgpu::BufferUsages::VERTEX),
            indices: buffer(bytemuck::cast_slice(&indices), wgpu::BufferUsages::INDEX),
            index_count: indices.len() as u32,
            target: target(wgpu::TextureFormat::R32Float),
            depth: target(wgpu::TextureFormat::Depth32Float),
            size,
            state,
        })
    }

    /// Renders the instants `times_s` in one submission (at most [`INSTANTS`]) and waits for it.
    pub fn render(&mut self, scene: &Scene, times_s: &[f64]) -> Result<Duration, Failure> {
        let started = Instant::now();
        let mut bytes = vec![0; FRAME_STRIDE * times_s.len()];
        for (slot, &time_s) in bytes.chunks_exact_mut(FRAME_STRIDE).zip(times_s) {
            scene.evaluate(time_s, &mut self.state);
            let frame = frame(scene, &self.state, self.size)?;
            slot[..size_of::<Frame>()].copy_from_slice(bytemuck::bytes_of(&frame));
        }
        self.queue.write_buffer(&self.frames, 0, &bytes);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        for k in 0..times_s.len() {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &self.target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_vertex_buffer(0, self.vertices.slice(..));
            pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.set_bind_group(0, &self.group, &[(k * FRAME_STRIDE) as u32]);
            pass.draw_indexed(0..self.index_count, 0, 0..1);
        }
        let submission = self.queue.submit([encoder.finish()]);
        self.device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: None })?;
        Ok(started.elapsed())
    }
}

fn entry(binding: u32, ty: wgpu::BindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::VERTEX_FRAGMENT, ty, count: None }
}

fn pipeline(device: &wgpu::Device, layout: &wgpu::BindGroupLayout) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::include_wgsl!("raster.wgsl"));
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vs_main"),
            compilation_options: Default::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<Vertex>() as u64,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x2],
            })],
        },
        primitive: wgpu::PrimitiveState { cull_mode: Some(wgpu::Face::Back), ..Default::default() },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: wgpu::TextureFormat::Depth32Float,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fs_main"),
            compilation_options: Default::default(),
            targets: &[Some(wgpu::TextureFormat::R32Float.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// All triangles in world space.
fn triangles(scene: &Scene, state: &SceneState) -> Result<(Vec<Vertex>, Vec<u32>), Failure> {
    let eye = state.world_from_node[camera_node(scene)?].w_axis.truncate();
    let mut objects: Vec<(usize, DMat4)> = scene
        .nodes
        .iter()
        .zip(&state.world_from_node)
        .filter_map(|(node, world)| Some((node.mesh?, *world)))
        .collect();
    // Far ends decide: a wall comes after what stands before it.
    let far = |(mesh, world): &(usize, DMat4)| {
        let positions = scene.meshes[*mesh].primitives.iter().flat_map(|p| &p.positions);
        positions.map(|&p| world.transform_point3(Vec3::from(p).as_dvec3()).distance(eye)).fold(0.0, f64::max)
    };
    objects.sort_by(|a, b| far(a).total_cmp(&far(b)));
    let (mut vertices, mut indices) = (Vec::new(), Vec::new());
    for (mesh, world) in objects {
        let normal_matrix = glam::DMat3::from_mat4(world).inverse().transpose();
        for primitive in &scene.meshes[mesh].primitives {
            let first = vertices.len() as u32;
            let uvs = primitive.uvs[0].as_ref().ok_or("a primitive has no texture coordinates")?;
            for ((&position, &normal), &uv) in primitive.positions.iter().zip(&primitive.normals).zip(uvs) {
                let normal = (normal_matrix * Vec3::from(normal).as_dvec3()).normalize();
                let position = world.transform_point3(Vec3::from(position).as_dvec3());
                vertices.push(Vertex {
                    position: position.as_vec3().to_array(),
                    normal: normal.as_vec3().to_array(),
                    uv,
                });
            }
            indices.extend(primitive.indices.iter().map(|i| i + first));
        }
    }
    Ok((vertices, indices))
}

fn upload_texture(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    scene: &Scene,
) -> Result<wgpu::TextureView, Failure> {
    let image = scene.images.first().ok_or("the scene has no texture")?;
    let levels = evis_render::scene::texture::mip_chain(image);
    let size = |i: &evis_render::scene::Image| wgpu::Extent3d {
        width: i.width,
        height: i.height,
        depth_or_array_layers: 1,
    };
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: size(image),
        mip_level_count: levels.len() as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba16Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    for (mip_level, level) in levels.iter().enumerate() {
        queue.write_texture(
            wgpu::TexelCopyTextureInfo { mip_level: mip_level as u32, ..texture.as_image_copy() },
            bytemuck::cast_slice(&level.texels),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(level.width * 8),
                rows_per_image: Some(level.height),
            },
            size(level),
        );
    }
    Ok(texture.create_view(&Default::default()))
}

fn camera_node(scene: &Scene) -> Result<usize, Failure> {
    Ok(scene.cameras.first().ok_or("the scene has no camera")?.node)
}

fn frame(scene: &Scene, state: &SceneState, [width, height]: [u32; 2]) -> Result<Frame, Failure> {
    let camera = &scene.cameras[0];
    let Lens::FieldOfView { fov_y } = camera.lens else {
        return Err("the camera has no field of view".into());
    };
    let f = 1.0 / (fov_y / 2.0).tan();
    // Reverse z, infinite far plane.
    let clip_from_camera = DMat4::from_cols(
        DVec4::X * f * f64::from(height) / f64::from(width),
        DVec4::Y * f,
        DVec4::NEG_W,
        DVec4::Z * camera.near,
    );
    let clip_from_world = clip_from_camera * state.world_from_node[camera.node].inverse();
    let light_node = scene.nodes.iter().position(|n| n.light.is_some()).ok_or("the scene has no light")?;
    let light = &scene.lights[0];
    let to_light: DVec3 = state.world_from_node[light_node].z_axis.truncate().normalize();
    let scale = light.intensity / std::f32::consts::PI;
    let [r, g, b] = light.color.map(|c| c * scale);
    let [ar, ag, ab] = scene.ambient;
    Ok(Frame {
        clip_from_world: clip_from_world.as_mat4().to_cols_array_2d(),
        to_light: to_light.extend(0.0).as_vec4().to_array(),
        light: [r, g, b, 0.0],
        ambient: [ar, ag, ab, 0.0],
    })
}
