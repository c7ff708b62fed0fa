//! Shadow maps: which lights have one, and the matrices that fit them to the world, not to the view, so that
//! a shadow's edge moves only with its light and its caster.

use evis_core::ConfigError;
use evis_scene::{LightKind, Scene, SceneState};
use glam::{DMat4, DVec3, DVec4};

use crate::config::{RunConfig, Shadows};
use crate::engine::Context;
use crate::frame::{FrameData, FrameRequest, rigid};
use crate::gpu_scene::{DrawItem, GpuScene, moves};
use crate::interval::{Drawing, depth_attachment, draw_surfaces};
use crate::occluders::Occluders;
use crate::pass::raster::{DEPTH_FORMAT, Pipelines, SceneConstants, SurfaceLayouts};
use crate::pass::shadow_map;
use crate::variant::LightSet;
use crate::view::View;

/// Texels per edge of a shadow map.
pub const SHADOW_MAP_EDGE: u32 = 2048;

/// The lights that throw shadows, and whether their maps change.
#[derive(Clone, Debug)]
pub struct ShadowPlan {
    /// Nodes of the lights, in layer order.
    pub nodes: Vec<usize>,
    /// Per light: whether it moves.
    light_moves: Vec<bool>,
    /// Whether any caster moves.
    caster_moves: bool,
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
        let caster_moves = scene.nodes.iter().enumerate().any(|(index, node)| {
            node.mesh.is_some() && (node.skin.is_some() || node.morph.is_some() || moves(scene, index))
        });
        let light_moves = nodes.iter().map(|&node| moves(scene, node)).collect();
        Some(Self { nodes, light_moves, caster_moves, bounds })
    }

    /// Whether any map changes: then it is made anew at every instant, else once for the whole run.
    pub fn moves(&self) -> bool {
        self.caster_moves || self.light_moves.contains(&true)
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
///
/// What stands still is drawn once into maps that are kept; at each instant these are copied and only what moves is
/// drawn on top. Where a light moves, everything is drawn.
pub struct ShadowRoom {
    /// What is drawn, and when.
    pub plan: ShadowPlan,
    /// What rays are cast through along shadows' borders; `None` where the maps decide alone.
    pub occluders: Option<Occluders>,
    /// All layers: environment-major, then light.
    pub array: wgpu::TextureView,
    texture: wgpu::Texture,
    layers: Vec<wgpu::TextureView>,
    /// Maps of what stands still; absent where nothing moves, whose maps are `array` itself.
    still: Option<(wgpu::Texture, Vec<wgpu::TextureView>)>,
    pipelines: Pipelines,
    still_items: Vec<DrawItem>,
    moving_items: Vec<DrawItem>,
    all_items: Vec<DrawItem>,
}

impl ShadowRoom {
    /// `None` where no light throws shadows.
    ///
    /// # Errors
    /// Shadows by rays of what deforms or has holes.
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        scene: &Scene,
        gpu_scene: &GpuScene,
        config: &RunConfig,
    ) -> Result<Option<Self>, ConfigError> {
        let Some(plan) = scene_bounds(scene).and_then(|bounds| ShadowPlan::new(scene, bounds)) else {
            return Ok(None);
        };
        let occluders = match config.shadows {
            Shadows::Maps => None,
            Shadows::Rays => Some(Occluders::new(scene, gpu_scene, config.start_us)?),
        };
        let count = (plan.nodes.len() * scene.variants.len().max(1)) as u32;
        let texture = map_texture(device, SHADOW_MAP_EDGE, count);
        let still = plan.moves().then(|| {
            let texture = map_texture(device, SHADOW_MAP_EDGE, count);
            let layers = layer_views(&texture, count);
            (texture, layers)
        });
        let constants = SceneConstants {
            lights: LightSet::new(scene, |node| plan.layer_of(node)),
            shadows: false,
            shadow_rays: occluders.is_some(),
            environment: false,
            samples: 1,
            texture_taps: 1,
        };
        let pipelines = shadow_map::pipelines(device, layouts, gpu_scene.variants().into_iter(), &constants);
        Ok(Some(Self {
            plan,
            occluders,
            array: array_view(&texture),
            layers: layer_views(&texture, count),
            texture,
            still,
            pipelines,
            still_items: gpu_scene.items(|o| !o.moving),
            moving_items: gpu_scene.items(|o| o.moving),
            all_items: gpu_scene.items(|_| true),
        }))
    }

    /// A map for scenes without shadows: a binding may not be empty.
    pub fn empty(device: &wgpu::Device) -> wgpu::TextureView {
        array_view(&map_texture(device, 1, 1))
    }

    /// Makes the map of `light` in `environment` for one instant, whose records start at `first`.
    pub fn encode_instant(
        &self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        frame_group: &wgpu::BindGroup,
        environment: u32,
        light: u32,
        first: u32,
    ) {
        let layer = environment * self.plan.nodes.len() as u32 + light;
        let target = &self.layers[layer as usize];
        match &self.still {
            Some((still, _)) if !self.plan.light_moves[light as usize] => {
                let at = |texture| wgpu::TexelCopyTextureInfo {
                    texture,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                    aspect: wgpu::TextureAspect::All,
                };
                let size = wgpu::Extent3d {
                    width: SHADOW_MAP_EDGE,
                    height: SHADOW_MAP_EDGE,
                    depth_or_array_layers: 1,
                };
                encoder.copy_texture_to_texture(at(still), at(&self.texture), size);
                self.draw(
                    context,
                    encoder,
                    frame_group,
                    target,
                    wgpu::LoadOp::Load,
                    &self.moving_items,
                    first,
                );
            }
            _ => {
                let clear = wgpu::LoadOp::Clear(0.0);
                self.draw(context, encoder, frame_group, target, clear, &self.all_items, first);
            }
        }
    }

    #[expect(clippy::too_many_arguments, reason = "a pass names all that it reads and writes")]
    fn draw(
        &self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        frame_group: &wgpu::BindGroup,
        target: &wgpu::TextureView,
        load: wgpu::LoadOp<f32>,
        items: &[DrawItem],
        first: u32,
    ) {
        let mut attachment = depth_attachment(target, wgpu::StoreOp::Store);
        attachment.depth_ops = Some(wgpu::Operations { load, store: wgpu::StoreOp::Store });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow map"),
            color_attachments: &[],
            depth_stencil_attachment: Some(attachment),
            ..Default::default()
        });
        let what = Drawing { items, frame: 0, sample: None, first_record: first };
        draw_surfaces(context, &mut pass, &self.pipelines, frame_group, None, &what);
    }
}

/// Draws the maps of what stands still, once, for every environment.
pub fn draw_still_maps(context: &mut Context) {
    let Some(room) = context.shadows.take() else { return };
    // One view per environment, at the start, is enough to place every caster.
    let mut views: Vec<View> = context.views.clone();
    views.dedup_by_key(|v| v.environment);
    let request = FrameRequest {
        views: &views,
        times_s: &[context.scene_time_s(0)],
        shadows: Some(&room.plan),
        occluders: room.occluders.as_ref(),
        record_ids: false,
        shadow_maps: true,
        watch: None,
        trail: false,
    };
    context.frame_data.build(&context.scene, &context.gpu_scene, &request);
    let group = context.frame_buffers.upload(
        &context.gpu,
        &context.layouts,
        &context.gpu_scene.morph_data,
        &context.frame_data,
    );
    let mut encoder = context.gpu.device.create_command_encoder(&Default::default());
    let targets = room.still.as_ref().map_or(&room.layers, |(_, layers)| layers);
    for (map, target) in targets.iter().enumerate() {
        let first = FrameData::shadow_record(views.len(), context.gpu_scene.objects.len(), map);
        room.draw(context, &mut encoder, &group, target, wgpu::LoadOp::Clear(0.0), &room.still_items, first);
    }
    context.gpu.queue.submit([encoder.finish()]);
    context.shadows = Some(room);
}

fn layer_views(texture: &wgpu::Texture, count: u32) -> Vec<wgpu::TextureView> {
    (0..count)
        .map(|layer| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: layer,
                array_layer_count: Some(1),
                ..Default::default()
            })
        })
        .collect()
}

fn map_texture(device: &wgpu::Device, edge: u32, layers: u32) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("shadow maps"),
        size: wgpu::Extent3d { width: edge, height: edge, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: DEPTH_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::COPY_DST,
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
        ShadowPlan {
            nodes: vec![0],
            light_moves: vec![false],
            caster_moves: false,
            bounds: (DVec3::splat(-2.0), DVec3::new(2.0, 3.0, 4.0)),
        }
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
