//! A scene on the device: geometry, materials, surroundings, and the list of what to draw.

use std::collections::BTreeSet;
use std::ops::Range;

use evis_scene::{AlphaMode, Scene, SceneState, ShadingModel, TextureRef, Wrap};
use glam::{DMat4, DVec3, Vec3};
use wgpu::util::DeviceExt as _;

use crate::gpu::uniforms::MaterialUniform;
use crate::gpu::variant::{Attribute, INSTANCE_SLOT, SurfaceVariant};
use crate::pass;
use crate::pass::raster::{MATERIAL_BINDINGS, SURROUNDINGS_BINDINGS, SurfaceLayouts};
use crate::world::image_bounds::{Corners, Rect, corners};

/// Consecutive objects that share pipeline, material and triangles: one instanced draw.
#[derive(Clone, Debug)]
pub struct Draw {
    /// Pipeline.
    pub variant: SurfaceVariant,
    /// Index into [`GpuScene::materials`].
    pub material: usize,
    /// Indices.
    pub indices: Range<u32>,
    /// First vertex.
    pub base_vertex: i32,
    /// Objects, in record order.
    pub objects: Range<u32>,
}

/// A part of a [`Draw`]: what a pass really draws.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawItem {
    /// Index into [`GpuScene::draws`].
    pub draw: u32,
    /// Objects, in record order.
    pub objects: Range<u32>,
}

/// A rectangle of a picture, and what is drawn in it.
pub type Part = (Rect, Vec<DrawItem>);

/// Adds `object`, drawn by `draw`: objects that follow each other in record order are drawn at once.
pub fn push_item(items: &mut Vec<DrawItem>, draw: u32, object: u32) {
    match items.last_mut() {
        Some(last) if last.draw == draw && last.objects.end == object => last.objects.end += 1,
        _ => items.push(DrawItem { draw, objects: object..object + 1 }),
    }
}

/// One primitive of one node: what its record is made from.
#[derive(Clone, Debug)]
pub struct Object {
    /// Node.
    pub node: usize,
    /// Primitive of the node's mesh.
    pub primitive: usize,
    /// Material, for its emission waveform.
    pub material: usize,
    /// Skin, where the primitive has joints.
    pub skin: Option<usize>,
    /// Displacements, where it has morph targets.
    pub morph: Option<Morph>,
    /// Instance label.
    pub instance_id: u32,
    /// Semantic label.
    pub semantic_id: u32,
    /// Centre and radius of a sphere around its vertices, in the node's frame; `None` where it deforms.
    pub bounds: Option<(DVec3, f64)>,
    /// Least and greatest coordinates of its vertices, in the node's frame; `None` where it deforms.
    pub extent: Option<(DVec3, DVec3)>,
    /// Whether it ever moves or deforms.
    pub moving: bool,
}

/// Where a primitive's displacements lie.
#[derive(Clone, Copy, Debug)]
pub struct Morph {
    /// First float, biased by the primitive's first vertex (wrapping).
    pub data_base: u32,
    /// Targets.
    pub targets: u32,
    /// Vertices.
    pub vertices: u32,
}

/// A scene on the device.
pub struct GpuScene {
    /// Per slot; `None` where no primitive has it.
    pub vertices: [Option<wgpu::Buffer>; INSTANCE_SLOT],
    /// All indices.
    pub indices: wgpu::Buffer,
    /// All displacements.
    pub morph_data: wgpu::Buffer,
    /// Group 1, per material.
    pub materials: Vec<wgpu::BindGroup>,
    /// What to draw, in order.
    pub draws: Vec<Draw>,
    /// Record order.
    pub objects: Vec<Object>,
    /// Environment and lookup table, for group 2.
    pub surroundings: Surroundings,
}

/// The resources of group 2 that belong to the scene.
pub struct Surroundings {
    irradiance: wgpu::TextureView,
    specular: wgpu::TextureView,
    sky: wgpu::TextureView,
    cube_sampler: wgpu::Sampler,
    brdf_lut: wgpu::TextureView,
    shadow_sampler: wgpu::Sampler,
    shadow_texels: wgpu::Sampler,
}

impl Surroundings {
    /// Group 2 with `shadow_maps`, and the `trees` that shadow rays are cast through.
    pub fn group(
        &self,
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        shadow_maps: &wgpu::TextureView,
        trees: &[[u32; 4]],
    ) -> wgpu::BindGroup {
        use wgpu::BindingResource::{Sampler, TextureView};
        // A binding may not be empty.
        let words = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("occluders' trees"),
            contents: if trees.is_empty() { &[0; 16] } else { bytemuck::cast_slice(trees) },
            usage: wgpu::BufferUsages::STORAGE,
        });
        let resources = vec![
            TextureView(shadow_maps),
            Sampler(&self.shadow_sampler),
            TextureView(&self.irradiance),
            TextureView(&self.specular),
            TextureView(&self.sky),
            Sampler(&self.cube_sampler),
            TextureView(&self.brdf_lut),
            words.as_entire_binding(),
            Sampler(&self.shadow_texels),
        ];
        pass::group(device, "surroundings", &layouts.surroundings, SURROUNDINGS_BINDINGS, resources)
    }
}

impl GpuScene {
    /// Uploads `scene`. `state` is the scene at the start: which nodes mirror follows from it.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        layouts: &SurfaceLayouts,
        scene: &Scene,
        state: &SceneState,
    ) -> Self {
        let geometry = Geometry::gather(scene);
        let (draws, objects) = draw_list(scene, state, &geometry);
        let buffer = |label: &str, bytes: &[u8], usage| {
            // A binding may not be empty.
            let bytes = if bytes.is_empty() { &[0u8; 16] } else { bytes };
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents: bytes,
                usage,
            })
        };
        let vertices = std::array::from_fn(|slot| {
            let bytes = &geometry.slots[slot];
            (!bytes.is_empty()).then(|| buffer("vertices", bytes, wgpu::BufferUsages::VERTEX))
        });
        Self {
            vertices,
            indices: buffer("indices", bytemuck::cast_slice(&geometry.indices), wgpu::BufferUsages::INDEX),
            morph_data: buffer(
                "morph data",
                bytemuck::cast_slice(&geometry.morph_data),
                wgpu::BufferUsages::STORAGE,
            ),
            materials: upload_materials(device, queue, layouts, scene),
            draws,
            objects,
            surroundings: upload_surroundings(device, queue, scene),
        }
    }

    /// Everything that `wanted` says of an object, in draw order.
    pub fn items(&self, wanted: impl Fn(&Object) -> bool) -> Vec<DrawItem> {
        let mut items: Vec<DrawItem> = Vec::new();
        for (index, draw) in self.draws.iter().enumerate() {
            let draw_index = index as u32;
            for object in draw.objects.clone().filter(|&o| wanted(&self.objects[o as usize])) {
                push_item(&mut items, draw_index, object);
            }
        }
        items
    }

    /// The variants that are drawn.
    pub fn variants(&self) -> BTreeSet<SurfaceVariant> {
        self.draws.iter().map(|d| d.variant).collect()
    }
}

/// All primitives' vertices, end to end.
struct Geometry {
    slots: [Vec<u8>; INSTANCE_SLOT],
    indices: Vec<u32>,
    morph_data: Vec<f32>,
    /// Per mesh and primitive.
    places: Vec<Vec<Place>>,
}

struct Place {
    indices: Range<u32>,
    base_vertex: i32,
    morph: Option<Morph>,
}

impl Geometry {
    fn gather(scene: &Scene) -> Self {
        let primitives = || scene.meshes.iter().flat_map(|m| &m.primitives);
        let used = [
            true,
            true,
            primitives().any(|p| p.uvs[0].is_some()),
            primitives().any(|p| p.uvs[1].is_some()),
            primitives().any(|p| p.colors.is_some()),
            primitives().any(|p| p.tangents.is_some()),
            primitives().any(|p| p.joints.is_some() && p.joint_weights.is_some()),
        ];
        let mut out = Self {
            slots: Default::default(),
            indices: Vec::new(),
            morph_data: Vec::new(),
            places: Vec::new(),
        };
        let mut first_vertex = 0u32;
        for mesh in &scene.meshes {
            let mut places = Vec::new();
            for primitive in &mesh.primitives {
                let count = primitive.positions.len();
                for (slot, bytes) in out.slots.iter_mut().enumerate().filter(|(slot, _)| used[*slot]) {
                    match Attribute::ALL[slot] {
                        Attribute::Position => {
                            bytes.extend(bytemuck::cast_slice::<_, u8>(&primitive.positions))
                        }
                        Attribute::Normal => bytes.extend(bytemuck::cast_slice::<_, u8>(&primitive.normals)),
                        Attribute::Uv0 => fill(bytes, primitive.uvs[0].as_deref(), [0.0; 2], count),
                        Attribute::Uv1 => fill(bytes, primitive.uvs[1].as_deref(), [0.0; 2], count),
                        Attribute::Color => fill(bytes, primitive.colors.as_deref(), [1.0; 4], count),
                        Attribute::Tangent => {
                            fill(bytes, primitive.tangents.as_deref(), [1.0, 0.0, 0.0, 1.0], count);
                        }
                        Attribute::Joints | Attribute::JointWeights => fill_joints(bytes, primitive, count),
                    }
                }
                let first_index = out.indices.len() as u32;
                out.indices.extend(&primitive.indices);
                let morph = (!primitive.morph_targets.is_empty()).then(|| {
                    let first = out.morph_data.len() as u32;
                    for target in &primitive.morph_targets {
                        for v in 0..count {
                            out.morph_data.extend(target.positions.get(v).copied().unwrap_or_default());
                            out.morph_data.extend(target.normals.get(v).copied().unwrap_or_default());
                        }
                    }
                    Morph {
                        data_base: first.wrapping_sub(first_vertex.wrapping_mul(6)),
                        targets: primitive.morph_targets.len() as u32,
                        vertices: count as u32,
                    }
                });
                places.push(Place {
                    indices: first_index..out.indices.len() as u32,
                    base_vertex: first_vertex as i32,
                    morph,
                });
                first_vertex += count as u32;
            }
            out.places.push(places);
        }
        out
    }
}

fn fill<T: bytemuck::Pod>(bytes: &mut Vec<u8>, values: Option<&[T]>, default: T, count: usize) {
    match values {
        Some(values) => bytes.extend(bytemuck::cast_slice::<_, u8>(values)),
        None => bytes.extend(bytemuck::cast_slice::<_, u8>(&vec![default; count])),
    }
}

/// Joints and their weights, vertex by vertex: they share a slot.
fn fill_joints(bytes: &mut Vec<u8>, primitive: &evis_scene::Primitive, count: usize) {
    for v in 0..count {
        let joints = primitive.joints.as_ref().and_then(|j| j.get(v)).copied().unwrap_or_default();
        let weights = primitive.joint_weights.as_ref().and_then(|w| w.get(v)).copied();
        bytes.extend(bytemuck::bytes_of(&joints));
        bytes.extend(bytemuck::bytes_of(&weights.unwrap_or([1.0, 0.0, 0.0, 0.0])));
    }
}

fn draw_list(scene: &Scene, state: &SceneState, geometry: &Geometry) -> (Vec<Draw>, Vec<Object>) {
    // (variant, material, mesh, primitive, node): equal but for the node means one instanced draw.
    let mut keys = Vec::new();
    for (node_index, node) in scene.nodes.iter().enumerate() {
        let Some(mesh_index) = node.mesh else { continue };
        let mesh = &scene.meshes[mesh_index];
        for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
            if primitive.indices.is_empty() {
                continue;
            }
            let skinned = node.skin.is_some();
            let mirrored = !skinned && state.world_from_node[node_index].determinant() < 0.0;
            let variant =
                SurfaceVariant::new(&scene.materials[primitive.material], primitive, skinned, mirrored);
            keys.push((variant, primitive.material, mesh_index, primitive_index, node_index));
        }
    }
    keys.sort_unstable();
    let mut draws: Vec<Draw> = Vec::new();
    let mut objects = Vec::new();
    let mut last = None;
    for (variant, material, mesh, primitive, node_index) in keys {
        let place = &geometry.places[mesh][primitive];
        let node = &scene.nodes[node_index];
        let record = objects.len() as u32;
        let positions = &scene.meshes[mesh].primitives[primitive].positions;
        let extent = (!variant.skinned && !variant.morphed).then(|| extent(positions));
        objects.push(Object {
            node: node_index,
            primitive,
            material,
            skin: node.skin.filter(|_| variant.skinned),
            morph: place.morph,
            bounds: extent.map(|extent| bounding_sphere(positions, extent)),
            extent,
            moving: node.skin.is_some() || node.morph.is_some() || moves(scene, node_index),
            instance_id: node.instance_id,
            semantic_id: node.semantic_id,
        });
        match draws.last_mut() {
            Some(draw) if last == Some((variant, material, mesh, primitive)) => draw.objects.end = record + 1,
            _ => draws.push(Draw {
                variant,
                material,
                indices: place.indices.clone(),
                base_vertex: place.base_vertex,
                objects: record..record + 1,
            }),
        }
        last = Some((variant, material, mesh, primitive));
    }
    (draws, objects)
}

/// Whether `node` or a parent of it has any motion.
pub fn moves(scene: &Scene, mut node: usize) -> bool {
    loop {
        if !scene.nodes[node].motion.is_fixed() {
            return true;
        }
        match scene.nodes[node].parent {
            Some(parent) => node = parent,
            None => return false,
        }
    }
}

/// Least and greatest coordinates of `points`.
fn extent(points: &[[f32; 3]]) -> (DVec3, DVec3) {
    let points = || points.iter().map(|&p| Vec3::from(p).as_dvec3());
    (points().fold(DVec3::INFINITY, DVec3::min), points().fold(DVec3::NEG_INFINITY, DVec3::max))
}

/// Centre and radius of a sphere around `points`: of their box, which is near enough for culling.
fn bounding_sphere(points: &[[f32; 3]], (low, high): (DVec3, DVec3)) -> (DVec3, f64) {
    let center = (low + high) / 2.0;
    let distances = points.iter().map(|&p| Vec3::from(p).as_dvec3().distance(center));
    (center, distances.fold(0.0, f64::max))
}

fn upload_materials(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    layouts: &SurfaceLayouts,
    scene: &Scene,
) -> Vec<wgpu::BindGroup> {
    let images: Vec<_> = scene.images.iter().map(|image| upload_image(device, queue, image)).collect();
    let samplers: Vec<_> = scene.textures.iter().map(|texture| sampler(device, texture)).collect();
    let white = upload_texels(device, queue, "white", &[(1, 1, vec![[half::f16::ONE; 4]])], false);
    let descriptor = wgpu::SamplerDescriptor { label: Some("texels"), ..Default::default() };
    let plain = device.create_sampler(&descriptor);
    scene
        .materials
        .iter()
        .map(|material| {
            let refs = [
                material.base_color_texture,
                material.metallic_roughness_texture,
                material.normal_texture,
                material.occlusion_texture,
                material.emissive_texture,
            ];
            let mut uv_rows = [[0.0; 4]; 10];
            for (slot, reference) in refs.iter().enumerate() {
                let reference = reference.unwrap_or(TextureRef::new(0));
                let m = reference.transform;
                uv_rows[slot * 2] = [m[0], m[1], m[2], reference.uv_set as f32];
                uv_rows[slot * 2 + 1] = [m[3], m[4], m[5], 0.0];
            }
            let [r, g, b] = material.emissive;
            let cutoff = match material.alpha {
                AlphaMode::Opaque => 0.0,
                AlphaMode::Mask(cutoff) => cutoff,
            };
            let metallic = if material.model == ShadingModel::Diffuse { 0.0 } else { material.metallic };
            let uniform = MaterialUniform {
                base_color: material.base_color,
                emissive: [r, g, b, cutoff],
                factors: [metallic, material.roughness, material.normal_scale, material.occlusion_strength],
                uv_rows,
            };
            let uniform = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("material"),
                contents: bytemuck::bytes_of(&uniform),
                usage: wgpu::BufferUsages::UNIFORM,
            });
            let mut resources = vec![uniform.as_entire_binding()];
            for reference in refs {
                match reference {
                    Some(reference) => {
                        let image = scene.textures[reference.texture].image;
                        resources.push(wgpu::BindingResource::TextureView(&images[image]));
                        resources.push(wgpu::BindingResource::Sampler(&samplers[reference.texture]));
                    }
                    None => {
                        resources.push(wgpu::BindingResource::TextureView(&white));
                        resources.push(wgpu::BindingResource::Sampler(&plain));
                    }
                }
            }
            pass::group(device, &material.name, &layouts.material, MATERIAL_BINDINGS, resources)
        })
        .collect()
}

fn sampler(device: &wgpu::Device, texture: &evis_scene::Texture) -> wgpu::Sampler {
    let address = |wrap| match wrap {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::Mirror => wgpu::AddressMode::MirrorRepeat,
        Wrap::Clamp => wgpu::AddressMode::ClampToEdge,
    };
    let (filter, mips) = if texture.nearest {
        (wgpu::FilterMode::Nearest, wgpu::MipmapFilterMode::Nearest)
    } else {
        (wgpu::FilterMode::Linear, wgpu::MipmapFilterMode::Linear)
    };
    device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("texture"),
        address_mode_u: address(texture.wrap_u),
        address_mode_v: address(texture.wrap_v),
        mag_filter: filter,
        min_filter: filter,
        mipmap_filter: mips,
        ..Default::default()
    })
}

type Level = (u32, u32, Vec<[half::f16; 4]>);

fn upload_image(device: &wgpu::Device, queue: &wgpu::Queue, image: &evis_scene::Image) -> wgpu::TextureView {
    let levels: Vec<Level> = evis_scene::texture::mip_chain(image)
        .into_iter()
        .map(|level| (level.width, level.height, level.texels))
        .collect();
    upload_texels(device, queue, &image.name, &levels, false)
}

/// Uploads mip levels; a cube has its six faces end to end in each level.
fn upload_texels(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    label: &str,
    levels: &[Level],
    cube: bool,
) -> wgpu::TextureView {
    let layers = if cube { 6 } else { 1 };
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width: levels[0].0, height: levels[0].1, depth_or_array_layers: layers },
        mip_level_count: levels.len() as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba16Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    for (level, (width, height, texels)) in levels.iter().enumerate() {
        queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &texture,
                mip_level: level as u32,
                origin: wgpu::Origin3d::ZERO,
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(texels),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(width * 8),
                rows_per_image: Some(*height),
            },
            wgpu::Extent3d { width: *width, height: *height, depth_or_array_layers: layers },
        );
    }
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: cube.then_some(wgpu::TextureViewDimension::Cube),
        ..Default::default()
    })
}

fn upload_surroundings(device: &wgpu::Device, queue: &wgpu::Queue, scene: &Scene) -> Surroundings {
    let cube = |label: &str, map: Option<&evis_scene::environment::CubeMap>| {
        let levels: Vec<Level> = match map {
            Some(map) => map
                .levels
                .iter()
                .enumerate()
                .map(|(level, texels)| {
                    let edge = (map.size >> level).max(1);
                    (edge, edge, texels.clone())
                })
                .collect(),
            None => vec![(1, 1, vec![[half::f16::ZERO; 4]; 6])],
        };
        upload_texels(device, queue, label, &levels, true)
    };
    let environment = scene.environment.as_ref();
    let brdf_lut = match environment {
        Some(_) => {
            let size = 64u32;
            let texels = evis_scene::environment::brdf_lut(size as usize)
                .into_iter()
                .map(|[scale, bias]| [scale, bias, 0.0, 1.0].map(half::f16::from_f32))
                .collect();
            upload_texels(device, queue, "brdf lut", &[(size, size, texels)], false)
        }
        None => upload_texels(device, queue, "brdf lut", &[(1, 1, vec![[half::f16::ZERO; 4]])], false),
    };
    let linear = wgpu::SamplerDescriptor {
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        ..Default::default()
    };
    Surroundings {
        irradiance: cube("irradiance", environment.map(|e| &e.irradiance)),
        specular: cube("specular", environment.map(|e| &e.specular)),
        sky: cube("sky", environment.map(|e| &e.sky)),
        cube_sampler: device.create_sampler(&linear),
        brdf_lut,
        shadow_texels: device
            .create_sampler(&wgpu::SamplerDescriptor { label: Some("shadow texels"), ..Default::default() }),
        shadow_sampler: device.create_sampler(&wgpu::SamplerDescriptor {
            // Reverse z: lit where the surface is at least as near to the light as what the map holds.
            compare: Some(wgpu::CompareFunction::GreaterEqual),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        }),
    }
}

/// The corners of `object`'s box in the world; `None` where it deforms.
pub fn place(object: &Object, world: &DMat4) -> Option<Corners> {
    let (low, high) = object.extent?;
    Some(corners(low, high).map(|c| world.transform_point3(c)))
}
