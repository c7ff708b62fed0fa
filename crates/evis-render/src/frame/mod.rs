//! From poses to what the passes read: matrices in f64, composed, then rounded once to f32.

pub mod changes;
pub mod draw;
pub mod pattern;
pub mod upload;

use std::ops::Range;

use evis_scene::{LightFactors, LightKind, PixelLens, Rays, Scene, SceneState};
use glam::{DMat4, DVec3};

use crate::frame::changes::{Change, Moment, StillWatch};
use crate::gpu::uniforms::{Frame, InstanceRecord, LightRecord, ObjectRecord, OccluderRecord};
use crate::gpu::variant::light_kind;
use crate::pass::raster::frame_stride;
use crate::shadow::bvh::{self, Occluders};
use crate::shadow::plan::{LightView, ShadowPlan};
use crate::shadow::volume::Lamp;
use crate::world::gpu_scene::{DrawItem, GpuScene, Object, push_item};
use crate::world::image_bounds::Rect;
use crate::world::raster_lens::RasterLens;
use crate::world::transform::{columns, rigid, rows};
use crate::world::view::View;

/// Host side of a submission: one frame per view and instant.
#[derive(Default)]
pub struct FrameData {
    /// [`Frame`]s with their lights, at [`frame_stride`].
    pub frames: Vec<u8>,
    /// Per frame, then per shadow map: one record per object.
    pub instances: Vec<InstanceRecord>,
    /// As `instances`.
    pub objects: Vec<ObjectRecord>,
    /// Three rows per joint.
    pub joints: Vec<[f32; 4]>,
    /// Weights.
    pub morph_weights: Vec<f32>,
    /// Per environment and instant: what moves and throws shadows.
    pub occluders: Vec<OccluderRecord>,
    /// Per frame: what is in view, nearest first.
    pub visible: Vec<Vec<DrawItem>>,
    /// Per frame: what must be drawn of it, where that was asked for.
    pub changes: Vec<Change>,
    /// Compares instants.
    pub watch: StillWatch,
    /// Where everything was, where that was asked for.
    pub trail: Trail,
    /// Per shadow map: what of it changes as things move.
    pub moved_texels: Vec<Vec<Rect>>,
    state: SceneState,
    joint_scratch: Vec<DMat4>,
}

/// What a submission's frames are made of.
pub struct FrameRequest<'a> {
    /// Environment-major.
    pub views: &'a [View],
    /// Scene time, seconds.
    pub times_s: &'a [f64],
    /// Lights that throw shadows.
    pub shadows: Option<&'a ShadowPlan>,
    /// What their rays are cast through.
    pub occluders: Option<&'a Occluders>,
    /// Whether the ids of objects are the numbers of their records, from 1, instead of their labels.
    pub record_ids: bool,
    /// Whether records that draw shadow maps are made too, of every environment, instant and light.
    pub shadow_maps: bool,
    /// Whether to tell what changes from instant to instant: the group's first view, and the first instant.
    pub watch: Option<(usize, i64)>,
    /// Whether to keep where everything was.
    pub trail: bool,
}

/// Where everything was at the instants of a submission.
#[derive(Default)]
pub struct Trail {
    /// Per frame.
    pub camera_from_world: Vec<DMat4>,
    /// Per frame: number of what its view shares with others at that instant.
    pub shared_of: Vec<usize>,
    /// What views of an environment share at an instant.
    pub shared: Vec<Shared>,
}

impl FrameData {
    /// Fills for `request`. Frame of view v and instant k: `v * times + k`.
    pub fn build(&mut self, scene: &Scene, gpu_scene: &GpuScene, request: &FrameRequest<'_>) {
        let objects = &gpu_scene.objects;
        let (views, times) = (request.views, request.times_s.len());
        let frame_count = views.len() * times;
        let light_count = scene.nodes.iter().filter(|n| n.light.is_some()).count() as u32;
        let stride = frame_stride(light_count) as usize;
        self.frames.clear();
        self.frames.resize(frame_count * stride, 0);
        self.instances.clear();
        self.instances.resize(frame_count * objects.len(), InstanceRecord::default());
        self.objects.clear();
        self.objects.resize(frame_count * objects.len(), ObjectRecord::default());
        self.joints.clear();
        self.morph_weights.clear();
        self.occluders.clear();
        self.visible.resize_with(frame_count, Vec::new);
        self.changes.clear();
        if let Some((group, first)) = request.watch {
            self.changes.resize_with(frame_count, Change::default);
            self.watch.begin(group, views.len(), first);
        }
        self.moved_texels.clear();
        self.trail.shared.clear();
        self.trail.camera_from_world.clear();
        self.trail.shared_of.clear();
        if request.trail {
            self.trail.camera_from_world.resize(frame_count, DMat4::IDENTITY);
            self.trail.shared_of.resize(frame_count, 0);
        }

        let mut state = std::mem::take(&mut self.state);
        let mut first = 0;
        // One evaluation serves all cameras of an environment at an instant.
        while first < views.len() {
            let environment = views[first].environment;
            let end = first + views[first..].iter().take_while(|v| v.environment == environment).count();
            for (k, &time_s) in request.times_s.iter().enumerate() {
                scene.evaluate_variant(scene.variants.get(environment), time_s, &mut state);
                let shared = self.push_state(scene, objects, &state, request, environment);
                for (v, view) in views[first..end].iter().enumerate() {
                    let index = (first + v) * times + k;
                    let bytes = index * stride..(index + 1) * stride;
                    let camera_from_world =
                        self.write_view(scene, gpu_scene, &state, view, index, bytes.clone(), &shared);
                    if request.watch.is_some() {
                        let moment = Moment {
                            view: first + v,
                            lens: &view.lens,
                            camera_from_world: &camera_from_world,
                            frame: &self.frames[bytes],
                            world: &shared.world,
                            records: &shared.records,
                            visible: &self.visible[index],
                            lamps: &shared.lamps,
                        };
                        self.changes[index] = self.watch.compare(gpu_scene, k, &moment);
                    }
                    if request.trail {
                        self.trail.camera_from_world[index] = camera_from_world;
                        self.trail.shared_of[index] = self.trail.shared.len();
                    }
                }
                if request.trail {
                    self.trail.shared.push(shared);
                }
            }
            first = end;
        }
        self.state = state;
    }

    /// First record of shadow map `map`, where there are `frames` frames and `objects` objects.
    pub fn shadow_record(frames: usize, objects: usize, map: usize) -> u32 {
        ((frames + map) * objects) as u32
    }

    /// What all views of an environment share at an instant.
    fn push_state(
        &mut self,
        scene: &Scene,
        objects: &[Object],
        state: &SceneState,
        request: &FrameRequest<'_>,
        environment: usize,
    ) -> Shared {
        let mut skin_bases = vec![0; scene.skins.len()];
        let mut palettes = Palettes::default();
        for (skin, base) in skin_bases.iter_mut().enumerate() {
            *base = (self.joints.len() / 3) as u32;
            scene.joint_matrices(skin, state, &mut self.joint_scratch);
            self.joints.extend(self.joint_scratch.iter().flat_map(rows));
            palettes.skins.push(palettes.joints.len()..palettes.joints.len() + self.joint_scratch.len());
            palettes.joints.extend_from_slice(&self.joint_scratch);
        }
        let mut weight_bases = vec![0; scene.nodes.len()];
        for (node, weights) in state.morph_weights.iter().enumerate() {
            let first = palettes.weights.len();
            palettes.nodes.push(first..first + weights.len());
            palettes.weights.extend_from_slice(weights);
            if !weights.is_empty() {
                weight_bases[node] = self.morph_weights.len() as u32;
                self.morph_weights.extend(weights);
            }
        }
        let light_views: Vec<LightView> =
            request.shadows.map_or(Vec::new(), |plan| plan.matrices(scene, state).collect());
        let lights = scene
            .nodes
            .iter()
            .enumerate()
            .filter_map(|(index, node)| {
                let layer = request.shadows.and_then(|plan| plan.layer_of(index));
                let shadow = layer.map(|l| (l, light_views[l as usize]));
                let mut record =
                    light_record(scene, state, node.light?, &state.world_from_node[index], shadow);
                // Exact: there are fewer than f32 has.
                record.spot[3] =
                    request.occluders.zip(layer).map_or(0, |(o, layer)| o.cells(environment, layer)) as f32;
                Some(record)
            })
            .collect();
        let world: Vec<DMat4> = objects
            .iter()
            .map(|o| if o.skin.is_some() { DMat4::IDENTITY } else { state.world_from_node[o.node] })
            .collect();
        let mut records: Vec<ObjectRecord> =
            objects.iter().map(|o| object_record(o, state, &skin_bases, &weight_bases)).collect();
        if request.record_ids {
            for (number, record) in (1..).zip(&mut records) {
                record.instance_id = number;
            }
        }
        if let Some(plan) = request.shadows.filter(|_| request.shadow_maps) {
            for view in &light_views {
                self.moved_texels.push(plan.moved_texels(view, objects, &world));
                self.instances.extend(world.iter().map(|w| instance_record(w, &(view.clip_from_world * *w))));
                self.objects.extend(&records);
            }
        }
        let rays = request.occluders.map_or(ShadowRays::NONE, |occluders| {
            let first = self.occluders.len() as u32;
            self.occluders.extend(occluders.records(&world));
            ShadowRays { root: occluders.still_root(environment), first, count: occluders.moving_count() }
        });
        let shadow_layer_base = request.shadows.map_or(0, |plan| plan.layer_base(environment));
        let lamps = request.shadows.map_or(Vec::new(), |plan| {
            let nodes = plan.nodes.iter().zip(&light_views);
            nodes.filter_map(|(&node, view)| Lamp::new(scene, state, node, view)).collect()
        });
        let light_factors = state.lights.clone();
        Shared { lights, light_factors, lamps, world, records, palettes, shadow_layer_base, rays }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "one view of one instant, from everything that came before"
    )]
    fn write_view(
        &mut self,
        scene: &Scene,
        gpu_scene: &GpuScene,
        state: &SceneState,
        view: &View,
        index: usize,
        bytes: std::ops::Range<usize>,
        shared: &Shared,
    ) -> DMat4 {
        let world_from_camera = rigid(&state.world_from_node[view.node]);
        let camera_from_world = world_from_camera.inverse();
        let clip_from_world = view.lens.clip_from_camera() * camera_from_world;
        let frame = frame(scene, view, &world_from_camera, shared);
        let (head, tail) = self.frames[bytes].split_at_mut(size_of::<Frame>());
        head.copy_from_slice(bytemuck::bytes_of(&frame));
        let lights: &[u8] = bytemuck::cast_slice(&shared.lights);
        tail[..lights.len()].copy_from_slice(lights);
        let count = gpu_scene.objects.len();
        let range = index * count..(index + 1) * count;
        self.objects[range.clone()].copy_from_slice(&shared.records);
        for (slot, world) in self.instances[range].iter_mut().zip(&shared.world) {
            *slot = instance_record(world, &(clip_from_world * *world));
        }
        visible_items(gpu_scene, &view.lens, &camera_from_world, &shared.world, &mut self.visible[index]);
        camera_from_world
    }
}

/// What all views of an environment share at an instant.
pub struct Shared {
    /// Every light.
    pub lights: Vec<LightRecord>,
    /// Per light of the scene: what a host may change.
    pub light_factors: Vec<LightFactors>,
    /// Of the lights that throw shadows.
    pub lamps: Vec<Lamp>,
    /// Per object: its pose.
    pub world: Vec<DMat4>,
    /// Per object.
    pub records: Vec<ObjectRecord>,
    /// What deforms objects.
    pub palettes: Palettes,
    shadow_layer_base: u32,
    rays: ShadowRays,
}

/// Joint matrices and morph weights at an instant.
#[derive(Default)]
pub struct Palettes {
    joints: Vec<DMat4>,
    skins: Vec<Range<usize>>,
    weights: Vec<f32>,
    nodes: Vec<Range<usize>>,
}

impl Palettes {
    /// World-from-vertex matrices of a skin's joints.
    pub fn joints(&self, skin: usize) -> &[DMat4] {
        &self.joints[self.skins[skin].clone()]
    }

    /// Morph weights of a node; empty where it has none.
    pub fn weights(&self, node: usize) -> &[f32] {
        &self.weights[self.nodes[node].clone()]
    }
}

impl Shared {
    /// Whether shaders read the same bytes of object `index` here and in `other`.
    pub fn is_equal(&self, other: &Self, object: &Object, index: usize) -> bool {
        // Where its joints and weights lie in a submission's buffers is not part of what it is.
        let record = |of: &Self| ObjectRecord { joint_base: 0, morph_weight_base: 0, ..of.records[index] };
        let joints = |of: &Self| object.skin.map(|skin| of.palettes.skins[skin].clone());
        let weights = |of: &Self| object.morph.map(|_| of.palettes.nodes[object.node].clone());
        self.world[index] == other.world[index]
            && record(self) == record(other)
            && joints(self).map(|range| &self.palettes.joints[range])
                == joints(other).map(|range| &other.palettes.joints[range])
            && weights(self).map(|range| &self.palettes.weights[range])
                == weights(other).map(|range| &other.palettes.weights[range])
    }
}

/// What shadow rays are cast through, at an instant.
#[derive(Clone, Copy)]
struct ShadowRays {
    root: u32,
    first: u32,
    count: u32,
}

impl ShadowRays {
    const NONE: Self = Self { root: bvh::END, first: 0, count: 0 };
}

/// What `lens` may see, nearest first: what is hidden is then rarely shaded. The order is a function of poses
/// alone, so it gives the same bytes in every run.
fn visible_items(
    scene: &GpuScene,
    lens: &PixelLens,
    camera_from_world: &DMat4,
    world: &[DMat4],
    items: &mut Vec<DrawItem>,
) {
    // (far end of the object, draw, object). By the far end, floors and walls come after what stands on them.
    let mut found: Vec<(f64, u32, u32)> = Vec::new();
    for (draw_index, draw) in scene.draws.iter().enumerate() {
        for object in draw.objects.clone() {
            let key = match scene.objects[object as usize].bounds {
                None => Some(0.0),
                Some((center, radius)) => {
                    let world = &world[object as usize];
                    let scale = [world.x_axis, world.y_axis, world.z_axis]
                        .iter()
                        .map(|a| a.truncate().length())
                        .fold(0.0, f64::max);
                    let center = camera_from_world.transform_point3(world.transform_point3(center));
                    // A node may shear: a sphere grows by no more than the sum of its axes.
                    let radius = radius * scale * 3f64.sqrt();
                    lens.may_see(center, radius).then_some(-center.z + radius)
                }
            };
            if let Some(key) = key {
                found.push((key, draw_index as u32, object));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    items.clear();
    for (_, draw, object) in found {
        push_item(items, draw, object);
    }
}

fn object_record(object: &Object, state: &SceneState, skins: &[u32], weights: &[u32]) -> ObjectRecord {
    let morph = object.morph;
    let factors = &state.factors[object.material];
    let with = |[r, g, b]: [f32; 3], w: f32| [r, g, b, w];
    ObjectRecord {
        joint_base: object.skin.map_or(0, |s| skins[s]),
        morph_weight_base: weights[object.node],
        morph_data_base: morph.map_or(0, |m| m.data_base),
        morph_target_count: morph.map_or(0, |m| m.targets.min(state.morph_weights[object.node].len() as u32)),
        morph_vertex_count: morph.map_or(0, |m| m.vertices),
        instance_id: object.instance_id,
        semantic_id: object.semantic_id,
        emission_factor: state.emission_factor[object.material],
        base_metallic: with(factors.base_color, factors.metallic),
        emissive_roughness: with(factors.emissive, factors.roughness),
    }
}

fn instance_record(world: &DMat4, clip: &DMat4) -> InstanceRecord {
    let [world_row_0, world_row_1, world_row_2] = rows(world);
    InstanceRecord { clip_from_object: columns(clip), world_row_0, world_row_1, world_row_2 }
}

fn frame(scene: &Scene, view: &View, world_from_camera: &DMat4, shared: &Shared) -> Frame {
    let p = world_from_camera.w_axis;
    let depth = match view.lens.rays {
        Rays::Central => [1.0, 0.0, 0.0, 0.0],
        Rays::Parallel { far } => [0.0, far, far - view.lens.near, 0.0],
    };
    let axis = |a: glam::DVec4, w: f64| [a.x as f32, a.y as f32, a.z as f32, w as f32];
    let [r, g, b] = scene.background;
    let [ar, ag, ab] = scene.ambient;
    let environment = scene.environment.as_ref();
    Frame {
        world_from_camera_right: axis(world_from_camera.x_axis, p.x),
        world_from_camera_up: axis(world_from_camera.y_axis, p.y),
        world_from_camera_back: axis(world_from_camera.z_axis, p.z),
        ray: view.lens.ray_from_ndc().map(|v| v as f32),
        depth: depth.map(|v| v as f32),
        background: [r, g, b, environment.map_or(0.0, |e| e.intensity)],
        ambient: [ar, ag, ab, environment.map_or(0.0, |e| e.rotation)],
        shadow_layer_base: shared.shadow_layer_base,
        occluder_root: shared.rays.root,
        occluder_first: shared.rays.first,
        occluder_count: shared.rays.count,
    }
}

fn light_record(
    scene: &Scene,
    state: &SceneState,
    light: usize,
    world: &DMat4,
    shadow: Option<(u32, LightView)>,
) -> LightRecord {
    let l = &scene.lights[light];
    let position = world.w_axis;
    let direction = (-world.z_axis.truncate()).normalize_or(DVec3::NEG_Z);
    let texel = shadow.map_or(0.0, |(_, view)| view.texel as f32);
    let kind = f32::from(light_kind(&l.kind));
    let spot = match l.kind {
        LightKind::Directional => [0.0, 0.0, texel, 0.0],
        LightKind::Point => [0.0; 4],
        LightKind::Spot { inner, outer } => {
            // KHR_lights_punctual: lightAngleScale and lightAngleOffset.
            let scale = 1.0 / (inner.cos() - outer.cos()).max(0.001);
            [scale, -outer.cos() * scale, texel, 0.0]
        }
    };
    let own = &state.lights[light];
    let factor = own.shining() * state.light_factor[light];
    LightRecord {
        position_kind: [position.x as f32, position.y as f32, position.z as f32, kind],
        direction_range: [
            direction.x as f32,
            direction.y as f32,
            direction.z as f32,
            l.range.filter(|r| *r > 0.0).map_or(0.0, |r| 1.0 / (r * r)),
        ],
        radiance_shadow: [
            own.color[0] * factor,
            own.color[1] * factor,
            own.color[2] * factor,
            shadow.map_or(-1.0, |(layer, _)| layer as f32),
        ],
        spot,
        shadow_clip_from_world: shadow.map_or([[0.0; 4]; 4], |(_, view)| columns(&view.clip_from_world)),
    }
}
