//! The triangles of a primitive as convex planar polygons.

use std::collections::HashMap;

use evis_scene::Primitive;
use glam::DVec3;

use crate::hash::Words;

/// Vertices of a facet; a triangle repeats its last one.
pub const CORNERS: usize = 4;

/// No facet.
pub const ALONE: u32 = u32::MAX;

/// A convex planar polygon on which positions and vertex attributes are affine.
///
/// Its parametrisation (s, t) is 0 at corner 0, (1, 0) at corner 1 and (0, 1) at corner 3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facet {
    /// Indices into the primitive's vertices, counter-clockwise from the front; a triangle repeats its last one.
    pub corners: [u32; CORNERS],
    /// Index into [`crate::scene::world::World::surfaces`].
    pub surface: u32,
}

impl Facet {
    /// Its corners' (s, t).
    pub fn outline(&self, primitive: &Primitive) -> [[f64; 2]; CORNERS] {
        let [a, b, c, d] = self.corners.map(|c| wide(primitive.positions[c as usize]));
        let is_quad = self.corners[2] != self.corners[3] && (b - a).cross(d - a) != DVec3::ZERO;
        let third = if is_quad { coordinates(c - a, [b - a, d - a]) } else { [0.0, 1.0] };
        [[0.0; 2], [1.0, 0.0], third, [0.0, 1.0]]
    }
}

/// Coordinates of `v`, in the plane of two vectors, along these.
fn coordinates(v: DVec3, [along, across]: [DVec3; 2]) -> [f64; 2] {
    let normal = along.cross(across);
    let area = normal.length_squared();
    [v.cross(across).dot(normal) / area, along.cross(v).dot(normal) / area]
}

/// In f64.
pub fn wide(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

/// Least and greatest coordinates.
pub fn bounding_box(points: impl Iterator<Item = DVec3>) -> [DVec3; 2] {
    points.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], p| [low.min(p), high.max(p)])
}

/// The triangles of `primitive`; two that share an edge are one facet where `merge` allows it and nothing tells them
/// apart: one plane, a convex outline, and attributes that one affine map gives.
pub fn facets(primitive: &Primitive, surface: u32, merge: bool) -> Vec<Facet> {
    let count = primitive.positions.len();
    let triangles: Vec<[u32; 3]> = (primitive.indices.as_chunks::<3>().0.iter().copied())
        .filter(|corners| corners.iter().all(|c| (*c as usize) < count))
        .collect();
    let mut by_edge: HashMap<[u32; 2], usize, Words> = HashMap::default();
    if merge {
        for (index, t) in triangles.iter().enumerate() {
            for k in 0..3 {
                by_edge.entry([t[k], t[(k + 1) % 3]]).or_insert(index);
            }
        }
    }
    let mut used = vec![false; triangles.len()];
    let mut out = Vec::with_capacity(triangles.len());
    for (index, t) in triangles.iter().enumerate() {
        if std::mem::replace(&mut used[index], true) {
            continue;
        }
        let quad = (0..3).filter(|_| merge).find_map(|k| {
            let (a, b) = (t[(k + 1) % 3], t[(k + 2) % 3]);
            let other = *by_edge.get(&[b, a])?;
            let fourth = *triangles[other].iter().find(|c| **c != a && **c != b)?;
            let corners = [t[k], a, fourth, b];
            (!used[other] && one_polygon(primitive, corners)).then_some((corners, other))
        });
        let corners = match quad {
            Some((corners, other)) => {
                used[other] = true;
                corners
            }
            None => [t[0], t[1], t[2], t[2]],
        };
        out.push(Facet { corners, surface });
    }
    out
}

/// Per facet and edge, the number of the facet beyond it, counted from `first`: it has the same two vertices, as `vertex` tells
/// them apart. [`ALONE`] where there is none, or more than one.
pub fn neighbors(facets: &[Facet], first: u32, vertex: impl Fn(u32) -> u32) -> Vec<[u32; CORNERS]> {
    let mut by_edge: HashMap<[u32; 2], u32, Words> = HashMap::default();
    let edges = |facet: &Facet| {
        let corners = facet.corners.map(&vertex);
        [0, 1, 2, 3].map(|k| [corners[k], corners[(k + 1) % CORNERS]])
    };
    for (number, facet) in (first..).zip(facets) {
        for edge in edges(facet) {
            by_edge.entry(edge).and_modify(|other| *other = ALONE).or_insert(number);
        }
    }
    let across = |[a, b]: [u32; 2]| {
        let known = by_edge.get(&[a, b]).is_some_and(|own| *own != ALONE);
        if known { by_edge.get(&[b, a]).copied().unwrap_or(ALONE) } else { ALONE }
    };
    facets.iter().map(|facet| edges(facet).map(across)).collect()
}

/// Per vertex of `primitive`, the first one at the same place.
pub fn places(primitive: &Primitive) -> Vec<u32> {
    let mut first: HashMap<[u32; 3], u32, Words> = HashMap::default();
    // -0 and 0 are one place.
    let key = |p: &[f32; 3]| p.map(|v| (v + 0.0).to_bits());
    (0..).zip(&primitive.positions).map(|(index, p)| *first.entry(key(p)).or_insert(index)).collect()
}

/// Whether positions at `corners` make a convex planar polygon with affine attributes.
fn one_polygon(primitive: &Primitive, corners: [u32; 4]) -> bool {
    let p = corners.map(|c| wide(primitive.positions[c as usize]));
    let (along, across, diagonal) = (p[1] - p[0], p[3] - p[0], p[2] - p[0]);
    let normal = along.cross(across);
    let area = normal.length_squared();
    if area <= 0.0 || normal.dot(diagonal).abs() > 1e-6 * normal.length() * diagonal.length() {
        return false;
    }
    let convex = (0..4).all(|k| {
        let (a, b, c) = (p[k], p[(k + 1) % 4], p[(k + 2) % 4]);
        (b - a).cross(c - b).dot(normal) > 1e-6 * area
    });
    let [s, t] = coordinates(diagonal, [along, across]);
    let affine = |v: [f64; 4]| {
        let predicted = v[0] + s * (v[1] - v[0]) + t * (v[3] - v[0]);
        (predicted - v[2]).abs() <= 1e-4 * (1.0 + v[2].abs()).min(10.0)
    };
    let index = corners.map(|c| c as usize);
    let normals =
        (0..3).all(|k| affine(index.map(|i| primitive.normals.get(i).map_or(0.0, |n| f64::from(n[k])))));
    let uvs = primitive
        .uvs
        .iter()
        .flatten()
        .all(|uv| (0..2).all(|k| affine(index.map(|i| uv.get(i).map_or(0.0, |v| f64::from(v[k]))))));
    let colors = primitive
        .colors
        .iter()
        .all(|c| (0..4).all(|k| affine(index.map(|i| c.get(i).map_or(1.0, |v| f64::from(v[k]))))));
    let tangents = primitive
        .tangents
        .iter()
        .all(|t| (0..4).all(|k| affine(index.map(|i| t.get(i).map_or(0.0, |v| f64::from(v[k]))))));
    convex && normals && uvs && colors && tangents
}

/// The eight corners of a box.
pub fn corners(low: DVec3, high: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|k| DVec3::select(glam::BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), high, low))
}
