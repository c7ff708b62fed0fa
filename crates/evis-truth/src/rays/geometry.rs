//! World-space triangles at one instant: morph targets, skins and node poses applied in f64.

use evis_scene::{Primitive, Scene, SceneState};
use glam::{DMat3, DMat4, DVec3};

/// A vertex in the world.
#[derive(Clone, Copy, Debug, Default)]
pub struct Vertex {
    /// Metres.
    pub position: DVec3,
    /// Unit normal.
    pub normal: DVec3,
    /// Tangent, and the sign of the bitangent: -1 or 1, 0 where there is no tangent.
    pub tangent: (DVec3, f64),
}

/// One primitive of one node.
#[derive(Clone, Debug)]
pub struct Object {
    /// Index into [`Scene::nodes`].
    pub node: usize,
    /// Index into [`Scene::meshes`].
    pub mesh: usize,
    /// Index into the mesh's primitives.
    pub primitive: usize,
    /// Instance label.
    pub instance_id: u32,
    /// Semantic label.
    pub semantic_id: u32,
    /// The node's pose mirrors: clockwise triangles face the viewer (glTF 2.0, 3.7.4).
    pub mirrored: bool,
    /// The primitive's vertices.
    pub vertices: Vec<Vertex>,
}

/// A triangle of an object.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Index into [`Geometry::objects`].
    pub object: usize,
    /// Vertices of the object.
    pub corners: [usize; 3],
}

/// Everything that can be hit, at one instant.
#[derive(Clone, Debug, Default)]
pub struct Geometry {
    /// In node order, then primitive order.
    pub objects: Vec<Object>,
    /// In object order, then index order.
    pub triangles: Vec<Triangle>,
}

impl Geometry {
    /// `scene` as `state` has it. Objects and triangles are in the same order for every state, so that a triangle's
    /// index and a point's barycentrics name the same point of matter at any time.
    pub fn new(scene: &Scene, state: &SceneState) -> Self {
        let mut geometry = Self::default();
        for (node_index, node) in scene.nodes.iter().enumerate() {
            let Some(mesh_index) = node.mesh else { continue };
            let Some(mesh) = scene.meshes.get(mesh_index) else { continue };
            let weights = state.morph_weights.get(node_index).map_or(&[][..], Vec::as_slice);
            let world = state.world_from_node.get(node_index).copied().unwrap_or(DMat4::IDENTITY);
            for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
                let skin =
                    node.skin.filter(|_| primitive.joints.is_some()).map(|s| joint_matrices(scene, state, s));
                let object = geometry.objects.len();
                geometry.triangles.extend(
                    primitive
                        .indices
                        .as_chunks::<3>()
                        .0
                        .iter()
                        .map(|corners| corners.map(|c| c as usize))
                        .filter(|corners| corners.iter().all(|c| *c < primitive.positions.len()))
                        .map(|corners| Triangle { object, corners }),
                );
                geometry.objects.push(Object {
                    node: node_index,
                    mesh: mesh_index,
                    primitive: primitive_index,
                    instance_id: node.instance_id,
                    semantic_id: node.semantic_id,
                    mirrored: skin.is_none() && world.determinant() < 0.0,
                    vertices: (0..primitive.positions.len())
                        .map(|v| deform(primitive, v, weights, &world, skin.as_deref()))
                        .collect(),
                });
            }
        }
        geometry
    }

    /// The corners of triangle `index`.
    pub fn corners(&self, index: usize) -> [&Vertex; 3] {
        let triangle = &self.triangles[index];
        triangle.corners.map(|c| &self.objects[triangle.object].vertices[c])
    }
}

/// `world_from_bind` per joint: glTF 2.0, 3.7.3.3 (the skinned mesh's own node does not count).
fn joint_matrices(scene: &Scene, state: &SceneState, skin: usize) -> Vec<DMat4> {
    let Some(skin) = scene.skins.get(skin) else { return Vec::new() };
    skin.joints
        .iter()
        .enumerate()
        .map(|(i, &joint)| {
            let world = state.world_from_node.get(joint).copied().unwrap_or(DMat4::IDENTITY);
            world * skin.inverse_bind.get(i).copied().unwrap_or(DMat4::IDENTITY)
        })
        .collect()
}

fn deform(
    primitive: &Primitive,
    v: usize,
    weights: &[f32],
    world_from_node: &DMat4,
    joints: Option<&[DMat4]>,
) -> Vertex {
    let wide = |a: [f32; 3]| DVec3::from_array(a.map(f64::from));
    let at = |list: &[[f32; 3]]| list.get(v).map_or(DVec3::ZERO, |a| wide(*a));
    let (mut position, mut normal) = (at(&primitive.positions), at(&primitive.normals));
    // glTF 2.0, 3.7.2.2: base + sum of weight * displacement.
    for (target, weight) in primitive.morph_targets.iter().zip(weights) {
        position += at(&target.positions) * f64::from(*weight);
        normal += at(&target.normals) * f64::from(*weight);
    }
    let world = match joints {
        None => *world_from_node,
        Some(joints) => {
            let index = primitive.joints.as_ref().and_then(|j| j.get(v)).copied().unwrap_or_default();
            let weight = primitive.joint_weights.as_ref().and_then(|w| w.get(v)).copied().unwrap_or_default();
            index.into_iter().zip(weight).fold(DMat4::ZERO, |sum, (index, weight)| {
                sum + joints.get(usize::from(index)).copied().unwrap_or(DMat4::IDENTITY) * f64::from(weight)
            })
        }
    };
    let linear = DMat3::from_mat4(world);
    // Normals stay at right angles to the surface under the cofactor matrix, det(M) times the inverse transpose;
    // it also serves where M cannot be inverted. The determinant's sign is taken out, so that a mirrored outside
    // stays outside.
    let cofactor = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    );
    let sign = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
    let tangent =
        primitive.tangents.as_ref().and_then(|t| t.get(v)).map_or((DVec3::ZERO, 0.0), |[x, y, z, w]| {
            // glTF 2.0, 3.7.2.1: the bitangent is cross(normal, tangent) * w in the mesh's own space; carried by a
            // mirroring pose, it points against the cross product of what that pose makes of the two.
            (linear * wide([*x, *y, *z]), f64::from(*w) * sign)
        });
    Vertex {
        position: world.transform_point3(position),
        normal: (cofactor * normal * sign).normalize_or(DVec3::Z),
        tangent,
    }
}
