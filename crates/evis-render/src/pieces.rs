//! What of a mesh stands for its parts where poses alone tell what may be seen: boxes, and which ways what is in them faces.

use std::collections::HashMap;
use std::sync::Arc;

use evis_scene::{AlphaMode, Primitive, Scene};
use glam::DVec3;

use crate::area::bounds;
use crate::gpu_scene::GpuScene;

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

/// A box: least and greatest coordinates.
pub type Extent = (DVec3, DVec3);

/// Of an object, in its node's frame.
#[derive(Debug, Default)]
pub struct Pieces {
    /// Boxes around its parts.
    pub boxes: Vec<Extent>,
    /// Fewer ones, which throw its shadows.
    pub casters: Vec<Extent>,
    /// What faces about one way, on which shadows fall.
    pub faces: Vec<Face>,
    /// The box around it all.
    pub extent: Extent,
    /// Its middle.
    pub middle: DVec3,
    /// How far its corners are from there.
    pub radius: f64,
    /// Metres by which an outline of it moves, at most, per radian that it turns about each axis through its middle; without
    /// end where its surface has a border or holes. What turns about its axis of symmetry keeps its outline.
    pub swing: DVec3,
}

/// Triangles that face about one way.
#[derive(Debug)]
pub struct Face {
    /// The box around them.
    pub extent: Extent,
    /// Ways that they face.
    pub normals: Vec<DVec3>,
}

/// By object; `None` where it deforms.
pub fn pieces(scene: &Scene, gpu_scene: &GpuScene) -> Vec<Option<Arc<Pieces>>> {
    let mut known: HashMap<(usize, usize), Arc<Pieces>> = HashMap::new();
    let of = gpu_scene.objects.iter().map(|object| {
        object.extent?;
        let mesh = scene.nodes[object.node].mesh?;
        let pieces = known.entry((mesh, object.primitive)).or_insert_with(|| {
            let primitive = &scene.meshes[mesh].primitives[object.primitive];
            // Holes end where the texture says.
            let whole = scene.materials[primitive.material].alpha == AlphaMode::Opaque;
            Arc::new(Pieces::new(primitive, whole))
        });
        Some(pieces.clone())
    });
    of.collect()
}

impl Pieces {
    fn new(primitive: &Primitive, whole: bool) -> Self {
        let corner = |i: u32| DVec3::from(primitive.positions[i as usize].map(f64::from));
        let mut triangles: Vec<Triangle> = primitive
            .indices
            .chunks_exact(3)
            .map(|t| Triangle::new([corner(t[0]), corner(t[1]), corner(t[2])]))
            .collect();
        let most =
            |pieces: usize, triangles: &[Triangle]| triangles.len().div_ceil(pieces).max(PIECE_TRIANGLES);
        let (low, high) = whole_extent(&triangles);
        let middle = (low + high) / 2.0;
        let mut pieces = Self {
            extent: (low, high),
            middle,
            radius: middle.distance(high),
            swing: if whole { swing(&triangles, middle) } else { DVec3::INFINITY },
            ..Self::default()
        };
        for (count, into) in [(MOST_PIECES, &mut pieces.boxes), (MOST_CASTERS, &mut pieces.casters)] {
            let most = most(count, &triangles);
            divide(&mut triangles, most, &mut |extent, _| into.push(extent));
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
                pieces.faces.push(Face { extent, normals });
            });
        }
        pieces
    }
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
    corners: [DVec3; 3],
    extent: Extent,
    normal: DVec3,
}

impl Triangle {
    fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        Self { corners, extent: bounds(&corners), normal: (b - a).cross(c - a).normalize_or_zero() }
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
                Triangle { corners: [at; 3], extent: (at, at + DVec3::ONE), normal: DVec3::Z }
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
