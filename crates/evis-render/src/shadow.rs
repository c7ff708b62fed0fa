//! Shadow maps: which lights have one, and the matrices that fit them to the world, not to the view, so that
//! a shadow's edge moves only with its light and its caster.

use evis_scene::{LightKind, Motion, Scene, SceneState};
use glam::{DMat4, DVec3, DVec4};

use crate::engine::Context;
use crate::frame::{FrameData, rigid};
use crate::gpu_scene::GpuScene;
use crate::interval::{depth_attachment, draw_surfaces};
use crate::pass::raster::{DEPTH_FORMAT, Pipelines, SceneConstants, SurfaceLayouts};
use crate::pass::shadow_map;
use crate::view::View;

/// Texels per edge of a shadow map.
pub const SHADOW_MAP_EDGE: u32 = 2048;

/// The lights that throw shadows, and whether their maps change.
#[derive(Clone, Debug)]
pub struct ShadowPlan {
    /// Nodes of the lights, in layer order.
    pub nodes: Vec<usize>,
    /// Whether a caster or a light moves: then there is a map per instant, else one for the whole run.
    pub moving: bool,
    /// Bounds of the world over the run.
    bounds: (DVec3, DVec3),
}

/// One shadow map's view.
#[derive(Clone, Copy, Debug)]
pub struct LightView {
    /// Reverse z.
    pub clip_from_world: DMat4,
    /// World size of a texel per unit of clip w.
    pub texel: f64,
}

impl ShadowPlan {
    /// `None` where no light throws shadows. `bounds` holds everything that is ever drawn.
    pub fn new(scene: &Scene, bounds: (DVec3, DVec3)) -> Option<Self> {
        let nodes: Vec<usize> = scene
            .nodes
            .iter()
            .enumerate()
            .filter(|(_, node)| {
                node.light.is_some_and(|l| {
                    let light = &scene.lights[l];
                    light.casts_shadow && light.kind != LightKind::Point
                })
            })
            .map(|(index, _)| index)
            .collect();
        if nodes.is_empty() {
            return None;
        }
        let fixed = |mut index: usize| {
            loop {
                let node = &scene.nodes[index];
                if !matches!(node.motion, Motion::Fixed(_)) {
                    return false;
                }
                match node.parent {
                    Some(parent) => index = parent,
                    None => return true,
                }
            }
        };
        let moving = scene.nodes.iter().enumerate().any(|(index, node)| {
            let deforms = node.skin.is_some() || node.morph.is_some();
            let caster = node.mesh.is_some();
            (caster && (deforms || !fixed(index))) || (nodes.contains(&index) && !fixed(index))
        });
        Some(Self { nodes, moving, bounds })
    }

    /// Layer of the light at `node`, within a frame.
    pub fn layer_of(&self, node: usize) -> Option<u32> {
        self.nodes.iter().position(|&n| n == node).map(|i| i as u32)
    }

    /// The lights' views, in layer order.
    pub fn matrices<'a>(
        &'a self,
        scene: &'a Scene,
        state: &'a SceneState,
    ) -> impl Iterator<Item = LightView> + 'a {
        self.nodes.iter().filter_map(move |&node| {
            let light = &scene.lights[scene.nodes[node].light?];
            let world = state.world_from_node[node];
            Some(match light.kind {
                LightKind::Spot { outer, .. } => self.spot(&world, f64::from(outer)),
                _ => self.directional(&world),
            })
        })
    }

    fn corners(&self) -> impl Iterator<Item = DVec3> + '_ {
        (0..8).map(|i| {
            let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
            let (low, high) = self.bounds;
            DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
        })
    }

    fn directional(&self, world_from_light: &DMat4) -> LightView {
        let mut world_from_light = rigid(world_from_light);
        world_from_light.w_axis = DVec4::W;
        let light_from_world = world_from_light.inverse();
        let (mut low, mut high) = (DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY));
        for corner in self.corners() {
            let p = light_from_world.transform_point3(corner);
            low = low.min(p);
            high = high.max(p);
        }
        // Square, so that a texel has one size; a margin keeps the filter inside.
        let half = ((high - low).truncate().max_element() / 2.0).max(1e-6) * 1.01;
        let center = (low + high) / 2.0;
        let depth = (high.z - low.z).max(1e-6) * 1.02;
        // z: 1 at the nearest corner (largest z, towards the light), 0 behind the farthest.
        let far = center.z - depth / 2.0;
        let clip_from_light = DMat4::from_cols(
            DVec4::new(1.0 / half, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 1.0 / half, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 1.0 / depth, 0.0),
            DVec4::new(-center.x / half, -center.y / half, -far / depth, 1.0),
        );
        LightView {
            clip_from_world: clip_from_light * light_from_world,
            texel: 2.0 * half / f64::from(SHADOW_MAP_EDGE),
        }
    }

    fn spot(&self, world_from_light: &DMat4, outer: f64) -> LightView {
        let light_from_world = rigid(world_from_light).inverse();
        // The cone touches the map's edge; a small margin keeps the filter inside.
        let tangent = outer.min(1.5).tan() * 1.02;
        let near =
            self.corners().map(|c| -light_from_world.transform_point3(c).z).fold(0.0, f64::max).max(1e-3)
                * 1e-3;
        let clip_from_light = DMat4::from_cols(
            DVec4::new(1.0 / tangent, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 1.0 / tangent, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 0.0, -1.0),
            DVec4::new(0.0, 0.0, near, 0.0),
        );
        LightView {
            clip_from_world: clip_from_light * light_from_world,
            texel: 2.0 * tangent / f64::from(SHADOW_MAP_EDGE),
        }
    }
}

/// Shadow maps on the device.
pub struct ShadowRoom {
    /// What is drawn, and when.
    pub plan: ShadowPlan,
    /// All layers: environment-major, then light.
    pub array: wgpu::TextureView,
    layers: Vec<wgpu::TextureView>,
    pipelines: Pipelines,
    /// Matrices of a world that stands still.
    pub still_matrices: Option<wgpu::Buffer>,
}

impl ShadowRoom {
    /// `None` where no light throws shadows.
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        scene: &Scene,
        gpu_scene: &GpuScene,
        environments: u32,
    ) -> Option<Self> {
        let plan = ShadowPlan::new(scene, scene_bounds(scene)?)?;
        let count = plan.nodes.len() as u32 * environments;
        let texture = map_texture(device, SHADOW_MAP_EDGE, count);
        let layers = (0..count)
            .map(|layer| {
                texture.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2),
                    base_array_layer: layer,
                    array_layer_count: Some(1),
                    ..Default::default()
                })
            })
            .collect();
        let constants = SceneConstants { light_count: 0, shadows: false, environment: false, lod_bias: 0.0 };
        let pipelines = shadow_map::pipelines(device, layouts, gpu_scene.variants().into_iter(), &constants);
        Some(Self { plan, array: array_view(&texture), layers, pipelines, still_matrices: None })
    }

    /// A map for scenes without shadows: a binding may not be empty.
    pub fn empty(device: &wgpu::Device) -> wgpu::TextureView {
        array_view(&map_texture(device, 1, 1))
    }

    /// Draws layer `layer` from the records that start at `first`.
    pub fn encode(
        &self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        frame_group: &wgpu::BindGroup,
        layer: u32,
        first: u32,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow map"),
            color_attachments: &[],
            depth_stencil_attachment: Some(depth_attachment(
                &self.layers[layer as usize],
                wgpu::StoreOp::Store,
            )),
            ..Default::default()
        });
        draw_surfaces(context, &mut pass, &self.pipelines, frame_group, None, 0, first);
    }
}

/// Draws the maps of a world that stands still, once, for every environment.
pub fn draw_still_maps(context: &mut Context) {
    let Some(mut room) = context.shadows.take() else { return };
    if !room.plan.moving {
        // One view per environment, at the start, is enough to place every caster.
        let mut views: Vec<View> = context.views.clone();
        views.dedup_by_key(|v| v.environment);
        let mut data = FrameData::default();
        let time_s = context.scene_time_s(0);
        let objects = &context.gpu_scene.objects;
        data.build(&context.scene, objects, &views, &[time_s], Some(&room.plan), true);
        let gpu = &context.gpu;
        let (group, _) = context.frame_buffers.upload(
            &gpu.device,
            &gpu.queue,
            &context.layouts,
            &context.gpu_scene.morph_data,
            &data,
        );
        let bytes: &[u8] = bytemuck::cast_slice(&data.shadow_matrices);
        let matrices = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("still shadow matrices"),
            size: bytes.len() as u64,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        gpu.queue.write_buffer(&matrices, 0, bytes);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for map in 0..data.shadow_matrices.len() {
            let first = FrameData::shadow_record(views.len(), objects.len(), map);
            room.encode(context, &mut encoder, &group, map as u32, first);
        }
        gpu.queue.submit([encoder.finish()]);
        room.still_matrices = Some(matrices);
    }
    context.shadows = Some(room);
    context.bind_surroundings();
}

fn map_texture(device: &wgpu::Device, edge: u32, layers: u32) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("shadow maps"),
        size: wgpu::Extent3d { width: edge, height: edge, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: DEPTH_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })
}

fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

/// Bounds of everything over the scene's duration, from samples in time.
fn scene_bounds(scene: &Scene) -> Option<(DVec3, DVec3)> {
    const SAMPLES: u32 = 64;
    let duration = scene.duration_s.unwrap_or(10.0);
    (0..=SAMPLES)
        .filter_map(|i| scene.bounds(duration * f64::from(i) / f64::from(SAMPLES)))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> ShadowPlan {
        ShadowPlan { nodes: vec![0], moving: false, bounds: (DVec3::splat(-2.0), DVec3::new(2.0, 3.0, 4.0)) }
    }

    #[test]
    fn every_corner_of_the_world_is_inside_a_directional_map() {
        let plan = plan();
        let light = DMat4::from_rotation_x(-1.0) * DMat4::from_rotation_y(0.4);
        let view = plan.directional(&light);
        for corner in plan.corners() {
            let clip = view.clip_from_world * corner.extend(1.0);
            assert!(clip.x.abs() <= 1.0 && clip.y.abs() <= 1.0 && (0.0..=1.0).contains(&clip.z), "{clip}");
        }
        // Towards the light is nearer: larger z.
        let toward = light.z_axis.truncate();
        let a = view.clip_from_world.transform_point3(DVec3::ZERO);
        let b = view.clip_from_world.transform_point3(toward * 0.1);
        assert!(b.z > a.z);
    }

    #[test]
    fn a_spot_map_covers_its_cone() {
        let view = plan().spot(&DMat4::from_translation(DVec3::new(0.0, 5.0, 0.0)), 0.6);
        let edge = DVec3::new(0.6f64.tan(), 5.0, -1.0);
        let clip = view.clip_from_world * edge.extend(1.0);
        let x = clip.x / clip.w;
        assert!((0.9..1.0).contains(&x), "{x}");
    }
}
