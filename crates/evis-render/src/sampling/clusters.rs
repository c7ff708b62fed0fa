//! Bounds of parts of meshes, for deciding from poses alone what may be seen where: boxes, and the ways that the triangles
//! in them face.

use std::collections::HashMap;
use std::sync::Arc;

use evis_scene::{AlphaMode, Primitive, Scene};
use glam::{DMat4, DVec3};

use crate::frame::Shared;
use crate::world::gpu_scene::{GpuScene, Object};
use crate::world::image_bounds::{Extent, bounds, corners};

/// Triangles that share a box, where a body has many.
const PIECE_TRIANGLES: usize = 16;

/// Boxes of a body, at most (a power of two).
const MOST_PIECES: usize = 128;

/// Boxes that throw its shadows, at most (a power of two).
const MOST_CASTERS: usize = 64;

/// Boxes on which shadows fall, at most, for each of the six ways that they may face (a power of two).
const MOST_FACES: usize = 4;

/// Cosine between normals that count as one.
const ONE_NORMAL: f64 = 0.97;

/// Which ways a surface may face whose normals change as it deforms: no direction is farther than 28 degrees from one of them.
const ALL_WAYS: usize = 26;

/// Points whose convex hull holds a part of an object at any instant, from poses, joint matrices and morph weights.
#[derive(Debug)]
pub enum Hull {
    /// Rigid: a box in the node's frame.
    Rigid(Extent),
    /// Skinned or morphing.
    Deforming(Deforming),
}

/// A part of a skinned or morphing primitive.
///
/// A vertex is `sum_j w_j M_j (p + sum_t m_t d_t)` with weights `w` that sum to 1 (`raster/vertex.wgsl`). With no negative
/// weight it lies in the hull of the boxes around `p + sum_t m_t d_t`, each placed by a joint that has a weight there. Negative
/// weights reach beyond that hull, by [`Deforming::reach`] times its size.
#[derive(Debug)]
pub struct Deforming {
    /// Per joint that has a weight in the part (one entry where there is no skin): the box around its vertices, and the box
    /// around their displacements by each morph target.
    bones: Vec<Bone>,
    /// The largest sum of absolute joint weights of a vertex; 1 where none is negative.
    reach: f64,
}

#[derive(Debug)]
struct Bone {
    joint: usize,
    extent: Extent,
    targets: Vec<Extent>,
}

impl Bone {
    /// The box around the morphed vertices.
    fn morphed(&self, weights: &[f32]) -> Extent {
        let add = |(low, high): Extent, (target, weight): (&Extent, &f32)| {
            let (a, b) = (f64::from(*weight) * target.0, f64::from(*weight) * target.1);
            (low + a.min(b), high + a.max(b))
        };
        self.targets.iter().zip(weights).fold(self.extent, add)
    }
}

impl Hull {
    /// Points per instant.
    pub const fn count(&self) -> usize {
        match self {
            Self::Rigid(_) => 8,
            Self::Deforming(part) if part.reach > 1.0 => 16 * part.bones.len(),
            Self::Deforming(part) => 8 * part.bones.len(),
        }
    }

    /// Whether it is one box that only its node moves.
    pub const fn is_rigid(&self) -> bool {
        matches!(self, Self::Rigid(_))
    }

    /// Adds the points in the world at an instant, of object `index`; the same ones in the same order at every instant.
    pub fn place(&self, object: &Object, index: usize, shared: &Shared, out: &mut Vec<DVec3>) {
        let world = &shared.world[index];
        match self {
            Self::Rigid((low, high)) => out.extend(corners(*low, *high).map(|c| world.transform_point3(c))),
            Self::Deforming(part) => {
                let first = out.len();
                let weights = object.morph.map_or(&[][..], |_| shared.palettes.weights(object.node));
                let joints = object.skin.map(|skin| shared.palettes.joints(skin));
                for bone in &part.bones {
                    let placed = match joints {
                        // A skinned object's own matrix is the identity; a joint that is not there has no vertex.
                        Some(joints) => joints.get(bone.joint).copied().unwrap_or(DMat4::IDENTITY),
                        None => *world,
                    };
                    let (low, high) = bone.morphed(weights);
                    out.extend(corners(low, high).map(|c| placed.transform_point3(c)));
                }
                if part.reach > 1.0 {
                    // What weights of both signs reach from the middle, either way.
                    let count = (out.len() - first) as f64;
                    let middle = out[first..].iter().sum::<DVec3>() / count;
                    for i in first..out.len() {
                        let by = part.reach * (out[i] - middle);
                        out.push(middle - by);
                        out[i] = middle + by;
                    }
                }
            }
        }
    }
}

/// Of an object, in its node's frame.
#[derive(Debug)]
pub struct Pieces {
    /// Around its parts.
    pub boxes: Vec<Hull>,
    /// Fewer ones, which throw its shadows.
    pub casters: Vec<Hull>,
    /// What faces about one way, on which shadows fall.
    pub faces: Vec<Face>,
    /// Around it all.
    pub whole: Hull,
    /// The middle of its vertices' box, undeformed.
    pub middle: DVec3,
    /// How far the corners of the box are from there.
    pub radius: f64,
    /// Metres by which an outline of it moves, at most, per radian that it turns about each axis through its middle;
    /// infinite where it deforms, or its surface has a border or holes. What turns about its axis of symmetry keeps its
    /// outline.
    pub swing: DVec3,
}

/// Triangles that face about one way.
#[derive(Debug)]
pub struct Face {
    /// Around them.
    pub hull: Hull,
    /// Ways that they face.
    pub normals: Vec<DVec3>,
}

/// By object.
pub fn pieces(scene: &Scene, gpu_scene: &GpuScene) -> Vec<Arc<Pieces>> {
    let mut known: HashMap<(usize, usize, bool), Arc<Pieces>> = HashMap::new();
    let of = gpu_scene.objects.iter().map(|object| {
        let skinned = object.skin.is_some();
        // Every object is drawn from a mesh.
        let mesh = scene.nodes[object.node].mesh.unwrap_or_default();
        let pieces = known.entry((mesh, object.primitive, skinned)).or_insert_with(|| {
            let primitive = &scene.meshes[mesh].primitives[object.primitive];
            // Holes end where the texture says.
            let whole = scene.materials[primitive.material].alpha == AlphaMode::Opaque;
            Arc::new(Pieces::new(primitive, skinned, whole))
        });
        pieces.clone()
    });
    of.collect()
}

impl Pieces {
    fn new(primitive: &Primitive, skinned: bool, whole: bool) -> Self {
        let corner = |i: u32| DVec3::from(primitive.positions[i as usize].map(f64::from));
        let mut triangles: Vec<Triangle> = primitive
            .indices
            .chunks_exact(3)
            .map(|t| Triangle::new([t[0], t[1], t[2]], [corner(t[0]), corner(t[1]), corner(t[2])]))
            .collect();
        let deforms = skinned || !primitive.morph_targets.is_empty();
        let hull = |extent: Extent, triangles: &[Triangle]| {
            if deforms {
                Hull::Deforming(Deforming::new(primitive, skinned, triangles))
            } else {
                Hull::Rigid(extent)
            }
        };
        let most =
            |pieces: usize, triangles: &[Triangle]| triangles.len().div_ceil(pieces).max(PIECE_TRIANGLES);
        let (low, high) = whole_extent(&triangles);
        let middle = (low + high) / 2.0;
        let mut pieces = Self {
            boxes: Vec::new(),
            casters: Vec::new(),
            faces: Vec::new(),
            whole: hull((low, high), &triangles),
            middle,
            radius: middle.distance(high),
            swing: if whole && !deforms { swing(&triangles, middle) } else { DVec3::INFINITY },
        };
        for (count, into) in [(MOST_PIECES, &mut pieces.boxes), (MOST_CASTERS, &mut pieces.casters)] {
            let most = most(count, &triangles);
            divide(&mut triangles, most, &mut |extent, triangles| into.push(hull(extent, triangles)));
        }
        if deforms {
            // Normals turn with what deforms.
            let most = most(6 * MOST_FACES, &triangles);
            divide(&mut triangles, most, &mut |extent, triangles| {
                pieces.faces.push(Face { hull: hull(extent, triangles), normals: all_ways().to_vec() });
            });
            return pieces;
        }
        for way in 0..6 {
            let mut alike: Vec<Triangle> = triangles.iter().filter(|t| t.way() == way).copied().collect();
            let most = most(MOST_FACES, &alike);
            divide(&mut alike, most, &mut |extent, triangles| {
                let mut normals: Vec<DVec3> = Vec::new();
                for t in triangles {
                    if normals.iter().all(|n| n.dot(t.normal) < ONE_NORMAL) {
                        normals.push(t.normal);
                    }
                }
                pieces.faces.push(Face { hull: hull(extent, triangles), normals });
            });
        }
        pieces
    }
}

impl Deforming {
    fn new(primitive: &Primitive, skinned: bool, triangles: &[Triangle]) -> Self {
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let grow = |extent: &mut Extent, point: [f32; 3]| {
            let point = DVec3::from(point.map(f64::from));
            *extent = (extent.0.min(point), extent.1.max(point));
        };
        let mut bones: Vec<Bone> = Vec::new();
        let mut reach: f64 = 1.0;
        for vertex in triangles.iter().flat_map(|t| t.vertices) {
            let vertex = vertex as usize;
            let of = |all: &Option<Vec<[f32; 4]>>| all.as_ref().and_then(|all| all.get(vertex)).copied();
            let joints = primitive.joints.as_ref().and_then(|all| all.get(vertex)).copied();
            let (joints, weights) = match (skinned, joints, of(&primitive.joint_weights)) {
                (true, Some(joints), Some(weights)) => (joints, weights),
                _ => ([0; 4], [1.0, 0.0, 0.0, 0.0]),
            };
            reach = reach.max(weights.iter().map(|w| f64::from(w.abs())).sum());
            for (joint, _) in joints.iter().zip(weights).filter(|(_, weight)| *weight != 0.0) {
                let joint = usize::from(*joint);
                let place = bones.iter().position(|bone| bone.joint == joint).unwrap_or_else(|| {
                    let targets = vec![none; primitive.morph_targets.len()];
                    bones.push(Bone { joint, extent: none, targets });
                    bones.len() - 1
                });
                let bone = &mut bones[place];
                grow(&mut bone.extent, primitive.positions[vertex]);
                for (target, extent) in primitive.morph_targets.iter().zip(&mut bone.targets) {
                    grow(extent, target.positions.get(vertex).copied().unwrap_or_default());
                }
            }
        }
        // Sums of weights are rounded.
        Self { bones, reach: if reach > 1.0 + 1e-5 { reach } else { 1.0 } }
    }
}

/// Directions to the corners, edges' middles and faces' middles of a cube.
fn all_ways() -> [DVec3; ALL_WAYS] {
    std::array::from_fn(|i| {
        // 13 is the cube's middle.
        let i = if i < 13 { i } else { i + 1 };
        let part = |unit: usize| (i / unit % 3) as f64 - 1.0;
        DVec3::new(part(1), part(3), part(9)).normalize()
    })
}

/// The box around all of them.
fn whole_extent(triangles: &[Triangle]) -> Extent {
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    triangles.iter().fold(none, |all, t| (all.0.min(t.extent.0), all.1.max(t.extent.1)))
}

/// [`Pieces::swing`]. An outline lies along edges between a triangle that faces the light and one that does not, and its
/// normal between theirs: nothing moves it but what moves them along their normals.
fn swing(triangles: &[Triangle], middle: DVec3) -> DVec3 {
    // What lies this near is one corner: seams are closed up to rounding.
    let (low, high) = whole_extent(triangles);
    let grain = (1e-5 * low.distance(high)).max(f64::MIN_POSITIVE);
    let place = |corner: DVec3| ((corner - low) / grain).round().to_array().map(|v| v as i64);
    let whole = || triangles.iter().filter(|t| t.normal != DVec3::ZERO);
    let mut normals = HashMap::new();
    let mut most = DVec3::ZERO;
    for t in whole() {
        for i in 0..3 {
            most = most.max((t.corners[i] - middle).cross(t.normal).abs());
            if normals.insert((place(t.corners[i]), place(t.corners[(i + 1) % 3])), t.normal).is_some() {
                return DVec3::INFINITY;
            }
        }
    }
    // The cosine of the sharpest edge.
    let mut sharpest: f64 = 1.0;
    for ((a, b), normal) in &normals {
        let Some(other) = normals.get(&(*b, *a)) else { return DVec3::INFINITY };
        sharpest = sharpest.min(normal.dot(*other));
    }
    // Between normals so far apart, one that is their sum is as short as half of that angle's cosine.
    most / ((1.0 + sharpest) / 2.0).max(0.0).sqrt()
}

#[derive(Clone, Copy)]
struct Triangle {
    vertices: [u32; 3],
    corners: [DVec3; 3],
    extent: Extent,
    normal: DVec3,
}

impl Triangle {
    fn new(vertices: [u32; 3], corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        Self { vertices, corners, extent: bounds(&corners), normal }
    }

    /// Which of the six axes it faces most.
    fn way(&self) -> usize {
        let axis = self.normal.abs().max_position();
        2 * axis + usize::from(self.normal[axis] < 0.0)
    }
}

/// Halves `triangles` along the longest side of their box until no more than `most` share one; each box goes to `out`.
fn divide(triangles: &mut [Triangle], most: usize, out: &mut impl FnMut(Extent, &[Triangle])) {
    if triangles.is_empty() {
        return;
    }
    let all = whole_extent(triangles);
    if triangles.len() <= most {
        out(all, triangles);
        return;
    }
    let size = all.1 - all.0;
    let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
    let middle = triangles.len() / 2;
    let key = |t: &Triangle| t.extent.0[axis] + t.extent.1[axis];
    triangles.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)));
    let (front, back) = triangles.split_at_mut(middle);
    divide(front, most, out);
    divide(back, most, out);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_are_divided_among_boxes_that_hold_them() {
        let mut triangles: Vec<Triangle> = (0..100)
            .map(|i| {
                let at = DVec3::new(f64::from(i * 37 % 100), f64::from(i * 11 % 10), 0.0);
                let extent = (at, at + DVec3::ONE);
                Triangle { vertices: [0; 3], corners: [at; 3], extent, normal: DVec3::Z }
            })
            .collect();
        let all = triangles.clone();
        let mut pieces: Vec<Extent> = Vec::new();
        divide(&mut triangles, 16, &mut |extent, _| pieces.push(extent));
        assert!(pieces.len() >= 7, "{}", pieces.len());
        let holds =
            |piece: &Extent, t: &Triangle| piece.0.cmple(t.extent.0).all() && piece.1.cmpge(t.extent.1).all();
        assert!(all.iter().all(|t| pieces.iter().any(|piece| holds(piece, t))));
        let wide = pieces.iter().filter(|p| (p.1 - p.0).x > 30.0).count();
        assert_eq!(wide, 0, "along the longest side");
    }
}
