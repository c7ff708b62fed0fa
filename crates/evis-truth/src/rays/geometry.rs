//! Triangles in the world: morph targets, skins and node poses applied in f64.
//!
//! [`Matter`] is what does not change over time: still objects lie in one tree in the world, rigid ones each have a
//! tree in their own space, and those of deforming ones are rebuilt for each instant. [`Geometry`] is matter at an instant.

use std::sync::Arc;

use evis_scene::{Primitive, Scene, SceneState};
use glam::{DMat3, DMat4, DVec3};

use super::bvh::{Bvh, HalfSpace, Meeting, TIE, Triangle, before, enter_box};

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

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Number of the triangle: in object order, then index order, the same for every instant.
    pub triangle: usize,
    /// Index into [`Matter::objects`].
    pub object: usize,
    /// In lengths of the ray's direction.
    pub distance: f64,
    /// Weights of the three corners.
    pub barycentric: [f64; 3],
    /// The ray meets the outside.
    pub front: bool,
}

/// A triangle in the world that a beam may meet.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The triangle.
    pub triangle: Triangle,
    /// Least depth of its corners.
    pub near: f64,
    object: usize,
    mirrored: bool,
}

/// Where a triangle lies with regard to a beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// No ray meets it.
    Beside,
    /// Some rays may meet it.
    Inside,
    /// Each ray meets it, and none sees anything deeper than this.
    Across(f64),
}

impl Candidate {
    /// Where a ray meets it.
    pub fn meet(&self, origin: DVec3, direction: DVec3) -> Option<Hit> {
        self.triangle.meet(origin, direction).map(|m| hit(self.object, &m, self.mirrored))
    }
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
    /// Number of its first triangle.
    first_triangle: usize,
    /// Vertices of each triangle.
    triangles: Vec<[u32; 3]>,
    /// Flat face of each triangle; empty where the whole object is smooth.
    faces: Vec<u32>,
    body: Body,
}

#[derive(Clone, Debug)]
enum Body {
    /// In the tree of all still objects. Mirrored: clockwise triangles face the viewer (glTF 2.0, 3.7.4).
    Still { vertices: Vec<Vertex>, mirrored: bool },
    /// Moves as a whole; vertices and tree in its own space.
    Rigid { vertices: Vec<Vertex>, tree: Bvh },
    /// Skinned or morphed.
    Deforming,
}

/// Everything that can be hit, as far as it does not change over time.
#[derive(Clone, Debug, Default)]
pub struct Matter {
    /// In node order, then primitive order.
    pub objects: Vec<Object>,
    /// Object of each triangle.
    owner: Vec<u32>,
    still: Bvh,
    /// Objects that are not still.
    moving: Vec<usize>,
}

/// An object that is not still, at an instant.
#[derive(Clone, Debug)]
enum Placed {
    Rigid(Box<Pose>),
    Deformed { vertices: Vec<Vertex>, mirrored: bool, tree: Bvh },
}

/// Where a rigid object is, and the box around it.
#[derive(Clone, Debug)]
struct Pose {
    world: DMat4,
    local: DMat4,
    cofactor: DMat3,
    sign: f64,
    low: DVec3,
    high: DVec3,
}

/// Everything that can be hit, at one instant.
#[derive(Clone, Debug)]
pub struct Geometry {
    matter: Arc<Matter>,
    /// As [`Matter::moving`].
    placed: Vec<Placed>,
}

impl Matter {
    /// The matter of `scene`. Nodes for which `moves` is true may be anywhere at another instant; all others are, and
    /// stay, as `state` has them.
    pub fn new(scene: &Scene, state: &SceneState, moves: impl Fn(usize) -> bool) -> Self {
        let mut matter = Self::default();
        let mut still: Vec<(u32, [DVec3; 3])> = Vec::new();
        for (node_index, node) in scene.nodes.iter().enumerate() {
            let Some(mesh_index) = node.mesh else { continue };
            let Some(mesh) = scene.meshes.get(mesh_index) else { continue };
            for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
                let count = primitive.positions.len();
                let triangles: Vec<[u32; 3]> = primitive
                    .indices
                    .as_chunks::<3>()
                    .0
                    .iter()
                    .copied()
                    .filter(|corners| corners.iter().all(|c| (*c as usize) < count))
                    .collect();
                let first_triangle = matter.owner.len();
                let mut object = Object {
                    node: node_index,
                    mesh: mesh_index,
                    primitive: primitive_index,
                    instance_id: node.instance_id,
                    semantic_id: node.semantic_id,
                    first_triangle,
                    faces: faces(primitive, &triangles),
                    triangles,
                    body: Body::Deforming,
                };
                let deforms = !primitive.morph_targets.is_empty() || skin_of(scene, &object).is_some();
                if !moves(node_index) {
                    let (vertices, mirrored) = object.deformed(scene, state);
                    still.extend(
                        object.numbered().map(|(id, c)| (id, c.map(|c| vertices[c as usize].position))),
                    );
                    object.body = Body::Still { vertices, mirrored };
                } else if !deforms {
                    let vertices: Vec<Vertex> =
                        (0..count).map(|v| deform(primitive, v, &[], &DMat4::IDENTITY, None)).collect();
                    let tree = Bvh::new(
                        object.numbered().map(|(id, c)| (id, c.map(|c| vertices[c as usize].position))),
                    );
                    object.body = Body::Rigid { vertices, tree };
                }
                let index = matter.objects.len();
                if !matches!(object.body, Body::Still { .. }) {
                    matter.moving.push(index);
                }
                matter.owner.extend(std::iter::repeat_n(index as u32, object.triangles.len()));
                matter.objects.push(object);
            }
        }
        matter.still = Bvh::new(still.into_iter());
        matter
    }

    /// How many triangles there are.
    pub fn triangle_count(&self) -> usize {
        self.owner.len()
    }

    /// Object of triangle `triangle`.
    pub fn object(&self, triangle: usize) -> &Object {
        &self.objects[self.owner[triangle] as usize]
    }
}

impl Object {
    /// Triangles with their numbers.
    fn numbered(&self) -> impl Iterator<Item = (u32, [u32; 3])> {
        self.triangles.iter().enumerate().map(|(i, c)| ((self.first_triangle + i) as u32, *c))
    }

    /// Vertices of triangle `triangle`, a number of the whole matter.
    pub fn corners(&self, triangle: usize) -> [usize; 3] {
        self.triangles[triangle - self.first_triangle].map(|c| c as usize)
    }

    /// Number of the flat face that triangle `triangle`, a number of the whole matter, belongs to: triangles whose
    /// corners all have one normal belong together where that normal is the same. 0 for all others.
    pub fn face(&self, triangle: usize) -> u32 {
        self.faces.get(triangle - self.first_triangle).copied().unwrap_or(0)
    }

    /// World vertices at `state`, and whether the pose mirrors.
    fn deformed(&self, scene: &Scene, state: &SceneState) -> (Vec<Vertex>, bool) {
        let primitive = &scene.meshes[self.mesh].primitives[self.primitive];
        let weights = state.morph_weights.get(self.node).map_or(&[][..], Vec::as_slice);
        let world = state.world_from_node.get(self.node).copied().unwrap_or(DMat4::IDENTITY);
        let skin = skin_of(scene, self).map(|s| joint_matrices(scene, state, s));
        let vertices = (0..primitive.positions.len())
            .map(|v| deform(primitive, v, weights, &world, skin.as_deref()))
            .collect();
        (vertices, skin.is_none() && world.determinant() < 0.0)
    }
}

impl Geometry {
    /// `scene` as `state` has it. Triangles are in the same order for every state, so that a triangle's number and a
    /// point's barycentrics name the same point of matter at any time.
    pub fn new(scene: &Scene, state: &SceneState) -> Self {
        Self { matter: Arc::new(Matter::new(scene, state, |_| false)), placed: Vec::new() }
    }

    /// `matter`, the matter of `scene`, as `state` has it.
    pub fn at(matter: &Arc<Matter>, scene: &Scene, state: &SceneState) -> Self {
        let placed = matter.moving.iter().map(|&i| place(&matter.objects[i], scene, state)).collect();
        Self { matter: matter.clone(), placed }
    }

    /// What does not change.
    pub fn matter(&self) -> &Matter {
        &self.matter
    }

    /// World boxes (low, high) of the objects that are not still.
    pub fn moving_boxes(&self) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
        self.placed.iter().filter_map(|placed| match placed {
            Placed::Rigid(pose) => Some((pose.low, pose.high)),
            Placed::Deformed { tree, .. } => tree.bounds(),
        })
    }

    /// World vertices of triangle `triangle`.
    pub fn corners(&self, triangle: usize) -> [Vertex; 3] {
        let index = self.matter.owner[triangle] as usize;
        let object = &self.matter.objects[index];
        let corners = object.corners(triangle);
        let placed = || &self.placed[self.matter.moving.partition_point(|&m| m < index)];
        match &object.body {
            Body::Still { vertices, .. } => corners.map(|c| vertices[c]),
            Body::Rigid { vertices, .. } => match placed() {
                Placed::Rigid(pose) => {
                    corners.map(|c| carried(&vertices[c], &pose.world, &pose.cofactor, pose.sign))
                }
                Placed::Deformed { vertices, .. } => corners.map(|c| vertices[c]),
            },
            Body::Deforming => match placed() {
                Placed::Deformed { vertices, .. } => corners.map(|c| vertices[c]),
                Placed::Rigid(_) => [Vertex::default(); 3],
            },
        }
    }

    /// World position of the point of matter that `hit` names.
    pub fn position(&self, triangle: usize, [u, v, w]: [f64; 3]) -> DVec3 {
        let [a, b, c] = self.corners(triangle).map(|v| v.position);
        a * u + b * v + c * w
    }

    /// The nearest hit in `[near, far]` that `accept` takes.
    pub fn nearest(
        &self,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        far: f64,
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        let matter = &*self.matter;
        let mut best = matter
            .still
            .nearest(origin, direction, near, far, |m| accept(&self.still_hit(m)))
            .map(|m| self.still_hit(&m));
        for (slot, placed) in self.placed.iter().enumerate() {
            let far = best.map_or(far, |b| b.distance * (1.0 + TIE));
            let found = self.with(slot, placed, origin, direction, near, far, |tree, o, d, hit| {
                tree.nearest(o, d, near, far, |m| accept(&hit(m))).map(|m| hit(&m))
            });
            if let Some(Some(found)) = found
                && best.is_none_or(|b| before((found.distance, found.triangle), (b.distance, b.triangle)))
            {
                best = Some(found);
            }
        }
        best
    }

    /// Whether anything in `[near, far]` is hit that `accept` takes.
    pub fn any(
        &self,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        far: f64,
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> bool {
        self.matter.still.any(origin, direction, near, far, |m| accept(&self.still_hit(m)))
            || self.placed.iter().enumerate().any(|(slot, placed)| {
                self.with(slot, placed, origin, direction, near, far, |tree, o, d, hit| {
                    tree.any(o, d, near, far, |m| accept(&hit(m)))
                })
                .unwrap_or(false)
            })
    }

    /// The triangles, in the world, that may reach into all half spaces of `bounds` and that `judge` does not put beside
    /// them, but for those that lie deeper, by `depth`, than one that shuts the view; by their least depth. `None` where
    /// there are more than `limit`.
    pub fn within(
        &self,
        bounds: &[HalfSpace],
        depth: &HalfSpace,
        limit: usize,
        judge: impl Fn(&Candidate) -> Place,
    ) -> Option<Vec<Candidate>> {
        let mut found: Vec<Candidate> = Vec::new();
        let mut far = f64::INFINITY;
        let mut add = |triangle: Triangle, object: usize, mirrored: bool, far: &mut f64| {
            let near = triangle.corners().map(|c| depth.value(c)).into_iter().fold(f64::INFINITY, f64::min);
            if near > *far {
                return false;
            }
            let candidate = Candidate { triangle, object, mirrored, near };
            match judge(&candidate) {
                Place::Beside => return false,
                Place::Inside => {}
                Place::Across(shut) => {
                    *far = far.min(shut);
                    found.retain(|c| c.near <= *far);
                }
            }
            found.push(candidate);
            found.len() > limit
        };
        let full = self.matter.still.within(bounds, depth, &mut far, |triangle, far| {
            let object = self.matter.owner[triangle.id as usize] as usize;
            let mirrored = matches!(&self.matter.objects[object].body, Body::Still { mirrored: true, .. });
            add(*triangle, object, mirrored, far)
        }) || self.placed.iter().enumerate().any(|(slot, placed)| {
            let object = self.matter.moving[slot];
            match (placed, &self.matter.objects[object].body) {
                (Placed::Rigid(pose), Body::Rigid { tree, .. }) => {
                    let met = |b: &HalfSpace| b.highest(pose.low, pose.high) >= 0.0;
                    if pose.low.x > pose.high.x || !bounds.iter().all(met) {
                        return false;
                    }
                    let local: Vec<HalfSpace> = bounds.iter().map(|b| b.local(&pose.world)).collect();
                    tree.within(&local, &depth.local(&pose.world), &mut far, |triangle, far| {
                        let corners = triangle.corners().map(|c| pose.world.transform_point3(c));
                        add(Triangle::new(triangle.id, corners), object, pose.sign < 0.0, far)
                    })
                }
                (Placed::Deformed { mirrored, tree, .. }, _) => {
                    tree.within(bounds, depth, &mut far, |triangle, far| {
                        add(*triangle, object, *mirrored, far)
                    })
                }
                _ => false,
            }
        });
        found.sort_by(|a, b| a.near.total_cmp(&b.near));
        (!full).then_some(found)
    }

    fn still_hit(&self, meeting: &Meeting) -> Hit {
        let object = self.matter.owner[meeting.id as usize] as usize;
        let mirrored = matches!(&self.matter.objects[object].body, Body::Still { mirrored: true, .. });
        hit(object, meeting, mirrored)
    }

    /// Calls `look` with the tree of an object that is not still and the ray in that tree's space; `None` where the
    /// ray misses the object's box.
    #[expect(clippy::too_many_arguments, reason = "a ray is four of them")]
    fn with<R>(
        &self,
        slot: usize,
        placed: &Placed,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        far: f64,
        look: impl FnOnce(&Bvh, DVec3, DVec3, &dyn Fn(&Meeting) -> Hit) -> R,
    ) -> Option<R> {
        let object = self.matter.moving[slot];
        match (placed, &self.matter.objects[object].body) {
            (Placed::Rigid(pose), Body::Rigid { tree, .. }) => {
                enter_box((pose.low, pose.high), origin, direction.recip(), near, far)?;
                // Affine maps keep the parameter along a ray, and the triangle keeps its own winding.
                let (o, d) = (pose.local.transform_point3(origin), pose.local.transform_vector3(direction));
                Some(look(tree, o, d, &|m| hit(object, m, false)))
            }
            (Placed::Deformed { mirrored, tree, .. }, _) => {
                Some(look(tree, origin, direction, &|m| hit(object, m, *mirrored)))
            }
            _ => None,
        }
    }
}

fn hit(object: usize, meeting: &Meeting, mirrored: bool) -> Hit {
    let [u, v] = meeting.uv;
    Hit {
        triangle: meeting.id as usize,
        object,
        distance: meeting.distance,
        barycentric: [1.0 - u - v, u, v],
        front: meeting.counter_clockwise != mirrored,
    }
}

fn place(object: &Object, scene: &Scene, state: &SceneState) -> Placed {
    let Body::Rigid { tree, .. } = &object.body else {
        let (vertices, mirrored) = object.deformed(scene, state);
        let tree = Bvh::new(object.numbered().map(|(id, c)| (id, c.map(|c| vertices[c as usize].position))));
        return Placed::Deformed { vertices, mirrored, tree };
    };
    let world = state.world_from_node.get(object.node).copied().unwrap_or(DMat4::IDENTITY);
    let local = world.inverse();
    let (cofactor, sign) = cofactor(&world);
    let mut corners = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    // What has no volume to look into, or lies nowhere, is not there: its empty box is never entered.
    if let Some((low, high)) = tree.bounds()
        && local.is_finite()
    {
        for k in 0..8 {
            let pick = glam::BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0);
            let p = world.transform_point3(DVec3::select(pick, high, low));
            corners = (corners.0.min(p), corners.1.max(p));
        }
        // Rounding must not cut off what lies in the box's face.
        let slack = 1e-9 * (1.0 + corners.0.abs().max(corners.1.abs()));
        corners = (corners.0 - slack, corners.1 + slack);
    }
    Placed::Rigid(Box::new(Pose { world, local, cofactor, sign, low: corners.0, high: corners.1 }))
}

/// Most flat faces that are told apart in one object: a shape of more is as good as smooth.
const MAX_FACES: usize = 64;

/// Flat face of each triangle, see [`Object::face`]; empty where there are none or too many.
fn faces(primitive: &Primitive, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut normals: Vec<[f32; 3]> = Vec::new();
    let mut faces = Vec::with_capacity(triangles.len());
    for corners in triangles {
        let [a, b, c] = corners.map(|c| primitive.normals.get(c as usize).copied().unwrap_or_default());
        let close = |p: [f32; 3], q: [f32; 3]| p.iter().zip(q).all(|(p, q)| (p - q).abs() < 1e-3);
        if !close(a, b) || !close(a, c) {
            faces.push(0);
            continue;
        }
        let known = normals.iter().position(|n| close(*n, a));
        let face = known.unwrap_or_else(|| {
            normals.push(a);
            normals.len() - 1
        });
        if normals.len() > MAX_FACES {
            return Vec::new();
        }
        faces.push(face as u32 + 1);
    }
    if normals.len() < 2 && !faces.contains(&0) { Vec::new() } else { faces }
}

/// The skin that deforms `object`, if any.
fn skin_of(scene: &Scene, object: &Object) -> Option<usize> {
    let skinned = scene.meshes[object.mesh].primitives[object.primitive].joints.is_some();
    scene.nodes[object.node].skin.filter(|_| skinned)
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

/// Normals stay at right angles to the surface under the cofactor matrix, det(M) times the inverse transpose; it also
/// serves where M cannot be inverted. The determinant's sign goes apart, so that a mirrored outside stays outside.
fn cofactor(world: &DMat4) -> (DMat3, f64) {
    let linear = DMat3::from_mat4(*world);
    let cofactor = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    );
    (cofactor, if linear.determinant() < 0.0 { -1.0 } else { 1.0 })
}

/// A vertex under the pose `world`.
fn carried(vertex: &Vertex, world: &DMat4, cofactor: &DMat3, sign: f64) -> Vertex {
    // glTF 2.0, 3.7.2.1: the bitangent is cross(normal, tangent) * w in the mesh's own space; carried by a mirroring
    // pose, it points against the cross product of what that pose makes of the two.
    let (tangent, w) = vertex.tangent;
    Vertex {
        position: world.transform_point3(vertex.position),
        normal: (*cofactor * vertex.normal * sign).normalize_or(DVec3::Z),
        tangent: (world.transform_vector3(tangent), w * sign),
    }
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
    let tangent = primitive
        .tangents
        .as_ref()
        .and_then(|t| t.get(v))
        .map_or((DVec3::ZERO, 0.0), |[x, y, z, w]| (wide([*x, *y, *z]), f64::from(*w)));
    let (cofactor, sign) = cofactor(&world);
    carried(&Vertex { position, normal, tangent }, &world, &cofactor, sign)
}
