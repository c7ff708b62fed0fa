//! From poses to what the passes read: matrices in f64, composed, then rounded once to f32.

use evis_scene::{LightKind, Scene, SceneState};
use glam::{DMat4, DVec3};

use crate::gpu_scene::Object;
use crate::pass::raster::FRAME_STRIDE;
use crate::shadow::ShadowPlan;
use crate::uniforms::{Frame, LightRecord, ObjectRecord, ShadowMatrix};
use crate::view::View;

/// Host side of a submission: one frame per view and instant.
#[derive(Default)]
pub struct FrameData {
    /// [`Frame`]s at [`FRAME_STRIDE`].
    pub frames: Vec<u8>,
    /// Per frame, then per shadow map: one record per object.
    pub objects: Vec<ObjectRecord>,
    /// Three rows per joint.
    pub joints: Vec<[f32; 4]>,
    /// Weights.
    pub morph_weights: Vec<f32>,
    /// Lights per environment and instant.
    pub lights: Vec<LightRecord>,
    /// Shadow maps per environment and instant.
    pub shadow_matrices: Vec<ShadowMatrix>,
    state: SceneState,
    joint_scratch: Vec<DMat4>,
}

impl FrameData {
    /// Fills for `views` at `times_s` (scene time, seconds). Frame of view v and instant k: `v * times + k`.
    /// Where `shadow_maps` is set, shadow matrices and the records that draw them are made too: those of
    /// environment e (counted within `views`), instant k and light l start at [`FrameData::shadow_record`].
    pub fn build(
        &mut self,
        scene: &Scene,
        objects: &[Object],
        views: &[View],
        times_s: &[f64],
        shadows: Option<&ShadowPlan>,
        shadow_maps: bool,
    ) {
        let frame_count = views.len() * times_s.len();
        self.frames.clear();
        self.frames.resize(frame_count * FRAME_STRIDE as usize, 0);
        self.objects.clear();
        self.objects.resize(frame_count * objects.len(), ObjectRecord::default());
        self.joints.clear();
        self.morph_weights.clear();
        self.lights.clear();
        self.shadow_matrices.clear();

        let first_environment = views.first().map_or(0, |v| v.environment);
        let mut state = std::mem::take(&mut self.state);
        // Views are environment-major: one evaluation serves all cameras of an environment at an instant.
        let mut first = 0;
        while first < views.len() {
            let environment = views[first].environment;
            let end = first + views[first..].iter().take_while(|v| v.environment == environment).count();
            for (k, &time_s) in times_s.iter().enumerate() {
                scene.evaluate_variant(scene.variants.get(environment), time_s, &mut state);
                let mut bases = self.push_state(scene, objects, &state, shadows, shadow_maps);
                let lights = shadows.map_or(0, |plan| plan.nodes.len());
                if shadow_maps {
                    bases.shadow_layer_base = ((environment - first_environment) * lights) as u32;
                } else {
                    // Maps of a still world were drawn once, for every environment.
                    bases.shadow_layer_base = (environment * lights) as u32;
                    bases.shadow_matrix_base = bases.shadow_layer_base;
                }
                for (v, view) in views[first..end].iter().enumerate() {
                    let index = (first + v) * times_s.len() + k;
                    self.write_view(scene, objects, &state, view, index, &bases);
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

    /// What all views of an environment share at an instant: joints, weights, lights, shadow maps.
    fn push_state(
        &mut self,
        scene: &Scene,
        objects: &[Object],
        state: &SceneState,
        shadows: Option<&ShadowPlan>,
        shadow_maps: bool,
    ) -> Bases {
        let mut skin_bases = vec![0; scene.skins.len()];
        for (skin, base) in skin_bases.iter_mut().enumerate() {
            *base = (self.joints.len() / 3) as u32;
            scene.joint_matrices(skin, state, &mut self.joint_scratch);
            self.joints.extend(self.joint_scratch.iter().flat_map(rows));
        }
        let mut weight_bases = vec![0; scene.nodes.len()];
        for (node, weights) in state.morph_weights.iter().enumerate().filter(|(_, w)| !w.is_empty()) {
            weight_bases[node] = self.morph_weights.len() as u32;
            self.morph_weights.extend(weights);
        }
        let light_base = self.lights.len() as u32;
        for (node_index, node) in scene.nodes.iter().enumerate() {
            let Some(light) = node.light else { continue };
            let world = state.world_from_node[node_index];
            let shadow = shadows.and_then(|plan| plan.layer_of(node_index));
            self.lights.push(light_record(scene, state, light, &world, shadow));
        }
        let mut bases = Bases {
            skin_bases,
            weight_bases,
            light_base,
            shadow_matrix_base: self.shadow_matrices.len() as u32,
            shadow_layer_base: 0,
            world: Vec::new(),
        };
        bases.world = objects
            .iter()
            .map(|o| if o.skin.is_some() { DMat4::IDENTITY } else { state.world_from_node[o.node] })
            .collect();
        if let Some(plan) = shadows.filter(|_| shadow_maps) {
            for matrix in plan.matrices(scene, state) {
                self.shadow_matrices.push(ShadowMatrix {
                    clip_from_world: columns(&matrix.clip_from_world),
                    texel: [matrix.texel as f32, 0.0, 0.0, 0.0],
                });
                for (object, world) in objects.iter().zip(&bases.world) {
                    self.objects.push(record(
                        object,
                        state,
                        &bases,
                        world,
                        &(matrix.clip_from_world * *world),
                    ));
                }
            }
        }
        bases
    }

    fn write_view(
        &mut self,
        scene: &Scene,
        objects: &[Object],
        state: &SceneState,
        view: &View,
        index: usize,
        bases: &Bases,
    ) {
        let world_from_camera = rigid(&state.world_from_node[view.node]);
        let clip_from_world = view.lens.clip_from_camera() * world_from_camera.inverse();
        let frame = frame(scene, view, &world_from_camera, bases);
        let at = index * FRAME_STRIDE as usize;
        self.frames[at..at + size_of::<Frame>()].copy_from_slice(bytemuck::bytes_of(&frame));
        let records = &mut self.objects[index * objects.len()..(index + 1) * objects.len()];
        for ((slot, object), world) in records.iter_mut().zip(objects).zip(&bases.world) {
            *slot = record(object, state, bases, world, &(clip_from_world * *world));
        }
    }
}

struct Bases {
    skin_bases: Vec<u32>,
    weight_bases: Vec<u32>,
    light_base: u32,
    shadow_matrix_base: u32,
    shadow_layer_base: u32,
    /// Per object.
    world: Vec<DMat4>,
}

fn record(object: &Object, state: &SceneState, bases: &Bases, world: &DMat4, clip: &DMat4) -> ObjectRecord {
    let [world_row_0, world_row_1, world_row_2] = rows(world);
    let morph = object.morph;
    ObjectRecord {
        clip_from_object: columns(clip),
        world_row_0,
        world_row_1,
        world_row_2,
        joint_base: object.skin.map_or(0, |s| bases.skin_bases[s]),
        morph_weight_base: bases.weight_bases[object.node],
        morph_data_base: morph.map_or(0, |m| m.data_base),
        morph_target_count: morph.map_or(0, |m| m.targets.min(state.morph_weights[object.node].len() as u32)),
        morph_vertex_count: morph.map_or(0, |m| m.vertices),
        instance_id: object.instance_id,
        semantic_id: object.semantic_id,
        emission_factor: state.emission_factor[object.material],
    }
}

fn frame(scene: &Scene, view: &View, world_from_camera: &DMat4, bases: &Bases) -> Frame {
    let p = world_from_camera.w_axis;
    let axis = |a: glam::DVec4, w: f64| [a.x as f32, a.y as f32, a.z as f32, w as f32];
    let [r, g, b] = scene.background;
    let [ar, ag, ab] = scene.ambient;
    let environment = scene.environment.as_ref();
    Frame {
        world_from_camera_right: axis(world_from_camera.x_axis, p.x),
        world_from_camera_up: axis(world_from_camera.y_axis, p.y),
        world_from_camera_back: axis(world_from_camera.z_axis, p.z),
        ray: view.lens.ray().map(|v| v as f32),
        background: [r, g, b, environment.map_or(0.0, |e| e.intensity)],
        ambient: [ar, ag, ab, environment.map_or(0.0, |e| e.rotation)],
        light_base: bases.light_base,
        shadow_matrix_base: bases.shadow_matrix_base,
        shadow_layer_base: bases.shadow_layer_base,
        pad: 0,
    }
}

fn light_record(
    scene: &Scene,
    state: &SceneState,
    light: usize,
    world: &DMat4,
    shadow: Option<u32>,
) -> LightRecord {
    let l = &scene.lights[light];
    let position = world.w_axis;
    let direction = (-world.z_axis.truncate()).normalize_or(DVec3::NEG_Z);
    let (kind, spot) = match l.kind {
        LightKind::Directional => (0.0, [0.0; 4]),
        LightKind::Point => (1.0, [0.0; 4]),
        LightKind::Spot { inner, outer } => {
            // KHR_lights_punctual: lightAngleScale and lightAngleOffset.
            let scale = 1.0 / (inner.cos() - outer.cos()).max(0.001);
            (2.0, [scale, -outer.cos() * scale, 0.0, 0.0])
        }
    };
    let factor = l.intensity * state.light_factor[light];
    LightRecord {
        position_kind: [position.x as f32, position.y as f32, position.z as f32, kind],
        direction_range: [
            direction.x as f32,
            direction.y as f32,
            direction.z as f32,
            l.range.filter(|r| *r > 0.0).map_or(0.0, |r| 1.0 / (r * r)),
        ],
        radiance_shadow: [
            l.color[0] * factor,
            l.color[1] * factor,
            l.color[2] * factor,
            shadow.map_or(-1.0, |s| s as f32),
        ],
        spot,
    }
}

/// A pose without scale: a scaled parent moves a camera or light but does not stretch what it sees or lights.
pub fn rigid(world_from_node: &DMat4) -> DMat4 {
    // Without axes there is nothing to see or light; any rotation will do.
    evis_scene::rigid(world_from_node)
        .unwrap_or_else(|| DMat4::from_translation(world_from_node.w_axis.truncate()))
}

/// Columns in f32.
pub fn columns(m: &DMat4) -> [[f32; 4]; 4] {
    m.as_mat4().to_cols_array_2d()
}

fn rows(m: &DMat4) -> [[f32; 4]; 3] {
    let t = m.transpose();
    [t.x_axis, t.y_axis, t.z_axis].map(|r| r.as_vec4().to_array())
}
