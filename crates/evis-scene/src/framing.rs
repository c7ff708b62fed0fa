//! Where a scene lies, and the camera and light that a scene without any is given.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3, Vec3};

use crate::model::{Camera, Framing, Lens, Light, Node, Primitive, Scene, ShadingModel, Trs};
use crate::motion::{Motion, looking_along};
use crate::pose::SceneState;

/// Instants at which a moving scene is measured for its framing camera.
const FRAMING_INSTANTS: u32 = 33;

/// Vertical field of view of a framing camera: 45 degrees.
const FRAMING_FOV_Y: f64 = std::f64::consts::FRAC_PI_4;

impl Scene {
    /// Corners of the world-aligned box around everything drawn at `t_s`, deformed as it is then; `None` where
    /// nothing is drawn.
    pub fn bounds(&self, t_s: f64) -> Option<(DVec3, DVec3)> {
        let mut state = SceneState::default();
        self.evaluate(t_s, &mut state);
        let mut corners: Option<(DVec3, DVec3)> = None;
        let mut joints = Vec::new();
        for (index, node) in self.nodes.iter().enumerate() {
            let Some(mesh) = node.mesh.and_then(|m| self.meshes.get(m)) else { continue };
            joints.clear();
            if let Some(skin) = node.skin {
                self.joint_matrices(skin, &state, &mut joints);
            }
            let (world, weights) = (&state.world_from_node[index], &state.morph_weights[index]);
            for primitive in &mesh.primitives {
                // Vertices that no triangle uses do not count, unless looking at all of them is less work.
                let (indices, count) = (&primitive.indices, primitive.positions.len());
                let (used, all) = if indices.len() > count { (&[][..], count) } else { (&indices[..], 0) };
                for i in used.iter().map(|i| *i as usize).chain(0..all) {
                    let p = deformed(primitive, i, world, weights, &joints);
                    let Some(p) = p.filter(|p| p.is_finite()) else { continue };
                    let (low, high) = corners.unwrap_or((p, p));
                    corners = Some((low.min(p), high.max(p)));
                }
            }
        }
        corners
    }

    /// Times, in seconds, at which a camera's frame takes the scene's motion into account.
    pub(crate) fn framing_times(&self) -> impl Iterator<Item = f64> + use<> {
        let duration = self.duration_s.unwrap_or(0.0);
        let instants = if duration > 0.0 { FRAMING_INSTANTS } else { 1 };
        (0..instants).map(move |k| duration * f64::from(k) / f64::from(FRAMING_INSTANTS - 1))
    }

    /// The box around everything drawn at some time of the scene's motion.
    pub(crate) fn bounds_over_time(&self) -> Option<(DVec3, DVec3)> {
        self.framing_times().filter_map(|t_s| self.bounds(t_s)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// Gives a scene without cameras one that frames it.
    pub(crate) fn frame_if_unseen(&mut self) {
        if self.cameras.is_empty() && self.add_framing_camera().is_some() {
            self.framing = Some(Framing::Model);
        }
    }

    /// Places the camera that [`Framing::Model`] has added again, for motion that the scene did not have then.
    pub fn frame_again(&mut self) {
        let (Some(Framing::Model), [camera]) = (self.framing, &self.cameras[..]) else { return };
        let node = camera.node;
        if let Some((pose, near)) = self.framing_pose() {
            self.nodes[node].motion = Motion::Fixed(pose.matrix());
            self.cameras[0].near = near;
        }
    }

    /// Adds the camera `default`, 45 degrees high, that sees the whole scene over its whole motion from a
    /// three-quarter view; returns its index, or `None` where there is nothing to see.
    pub fn add_framing_camera(&mut self) -> Option<usize> {
        let (pose, near) = self.framing_pose()?;
        let node = self.add_node(Node {
            name: "default camera".into(),
            motion: Motion::Fixed(pose.matrix()),
            ..Node::default()
        });
        let lens = Lens::FieldOfView { fov_y: FRAMING_FOV_Y };
        self.cameras.push(Camera { near, ..Camera::new("default", node, lens) });
        Some(self.cameras.len() - 1)
    }

    /// Pose of a framing camera, and its near plane; `None` where there is nothing to see.
    fn framing_pose(&self) -> Option<(Trs, f64)> {
        let (low, high) = self.bounds_over_time()?;
        let centre = 0.5 * (low + high);
        let rotation = looking_along(-DVec3::new(0.55, 0.45, 0.9))?;
        let corners = (0..8)
            .map(|k| DVec3::select(glam::BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), high, low) - centre);
        let distance = framing_distance(rotation, 0.5 * FRAMING_FOV_Y, 4.0 / 3.0, corners);
        let pose = Trs { translation: centre + rotation * DVec3::Z * distance, rotation, scale: DVec3::ONE };
        Some((pose, distance * 0.01))
    }

    /// Whether something is drawn that would be black: it needs light, and the scene has none.
    pub fn needs_light(&self) -> bool {
        let lit = self.nodes.iter().any(|n| n.light.is_some())
            || self.environment.is_some()
            || self.ambient.iter().any(|v| *v > 0.0);
        let drawn = self.nodes.iter().filter_map(|n| self.meshes.get(n.mesh?)).flat_map(|m| &m.primitives);
        let mut materials = drawn.filter_map(|p| self.materials.get(p.material));
        !lit && materials.any(|m| m.model != ShadingModel::Unlit)
    }

    /// Adds a soft ambient light and one directional light, from above the default camera's right shoulder, that
    /// throws no shadow: a white matte surface that faces it has a radiance near 1.
    pub fn add_default_light(&mut self) {
        self.ambient = [0.3; 3];
        self.lights.push(Light::directional("default", 0.7 * std::f32::consts::PI));
        let rotation = looking_along(-DVec3::new(0.6, 1.0, 0.35)).unwrap_or(DQuat::IDENTITY);
        self.nodes.push(Node {
            name: "default light".into(),
            motion: Motion::Fixed(DMat4::from_quat(rotation)),
            light: Some(self.lights.len() - 1),
            ..Node::default()
        });
    }

    /// `world_from_camera` of camera `camera`, without any scale of its nodes; `None` where there is no such camera
    /// or its axes vanish.
    pub fn world_from_camera(&self, camera: usize, state: &SceneState) -> Option<DMat4> {
        rigid(state.world_from_node.get(self.cameras.get(camera)?.node)?)
    }
}

/// The smallest distance from the origin at which a camera of this rotation sees every one of `points`, with a margin;
/// 1 where there is no such distance above 0.
pub(crate) fn framing_distance(
    world_from_camera: DQuat,
    half_fov_y: f64,
    aspect: f64,
    points: impl Iterator<Item = DVec3>,
) -> f64 {
    let tan_y = 0.92 * half_fov_y.tan();
    let tan_x = tan_y * aspect;
    let camera_from_world = world_from_camera.inverse();
    let distance = points
        .map(|point| camera_from_world * point)
        .map(|c| c.z + (c.x.abs() / tan_x).max(c.y.abs() / tan_y))
        .fold(0.0, f64::max);
    if distance > 0.0 && distance.is_finite() { distance } else { 1.0 }
}

/// `world_from_node` without scale, shear and mirroring: a camera or light keeps its -Z (where it looks or shines)
/// and, as far as that allows, its +Y. `None` where one of these axes vanishes.
pub fn rigid(world_from_node: &DMat4) -> Option<DMat4> {
    let back = world_from_node.z_axis.truncate().try_normalize()?;
    let up = world_from_node.y_axis.truncate();
    let up = (up - back * up.dot(back)).try_normalize()?;
    let right = up.cross(back);
    Some(DMat4::from_cols(right.extend(0.0), up.extend(0.0), back.extend(0.0), world_from_node.w_axis))
}

/// As [`rigid`], and without rotation where axes are scaled to nothing: nothing is to be seen there, and any will do.
pub fn rigid_or_unrotated(world_from_node: &DMat4) -> DMat4 {
    rigid(world_from_node).unwrap_or_else(|| DMat4::from_translation(world_from_node.w_axis.truncate()))
}

/// World position of vertex `i`, in metres, morphed by `weights`, and carried by `world` or, where the primitive has joints, by
/// `joint_matrices`; `None` where it does not exist.
pub fn deformed(
    primitive: &Primitive,
    i: usize,
    world: &DMat4,
    weights: &[f32],
    joint_matrices: &[DMat4],
) -> Option<DVec3> {
    let mut p = Vec3::from_array(*primitive.positions.get(i)?).as_dvec3();
    for (target, weight) in primitive.morph_targets.iter().zip(weights) {
        p += Vec3::from_array(*target.positions.get(i)?).as_dvec3() * f64::from(*weight);
    }
    let skin = primitive
        .joints
        .as_ref()
        .zip(primitive.joint_weights.as_ref())
        .filter(|_| !joint_matrices.is_empty());
    let Some((joints, joint_weights)) = skin else { return Some(world.transform_point3(p)) };
    let pairs = joints.get(i)?.iter().zip(joint_weights.get(i)?);
    pairs.map(|(&j, &w)| Some(joint_matrices.get(usize::from(j))?.transform_point3(p) * f64::from(w))).sum()
}

/// Wraps `path` as a node's motion.
impl From<crate::motion::Path> for Motion {
    fn from(path: crate::motion::Path) -> Self {
        Self::Path(Arc::new(path))
    }
}
