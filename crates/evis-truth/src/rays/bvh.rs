//! Rays against triangles: a median-split tree over boxes.

use glam::DVec3;

use super::geometry::Geometry;

/// Triangles in a leaf.
const LEAF: usize = 4;

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index into [`Geometry::triangles`].
    pub triangle: usize,
    /// In lengths of the ray's direction.
    pub distance: f64,
    /// Weights of the three corners.
    pub barycentric: [f64; 3],
    /// The ray runs against the triangle's counter-clockwise side.
    pub counter_clockwise: bool,
}

/// A tree over the triangles of a [`Geometry`].
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    order: Vec<usize>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// Leaf: first and one past the last of `order`. Inner: left child is the next node, `end` the right one.
    start: usize,
    end: usize,
    leaf: bool,
}

impl Bvh {
    /// Builds a tree; triangles with corners that are not finite are left out.
    pub fn new(geometry: &Geometry) -> Self {
        let boxes: Vec<(DVec3, DVec3)> = (0..geometry.triangles.len())
            .map(|i| {
                let [a, b, c] = geometry.corners(i).map(|v| v.position);
                (a.min(b).min(c), a.max(b).max(c))
            })
            .collect();
        let mut order: Vec<usize> = (0..boxes.len())
            .filter(|&i| geometry.corners(i).iter().all(|v| v.position.is_finite()))
            .collect();
        let mut nodes = Vec::new();
        let end = order.len();
        if end > 0 {
            split(&boxes, &mut order, 0, end, &mut nodes);
        }
        Self { nodes, order }
    }

    /// The nearest hit farther than `near` that `accept` takes.
    pub fn nearest(
        &self,
        geometry: &Geometry,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        let inverse = direction.recip();
        let mut best: Option<Hit> = None;
        let mut stack = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index];
            let limit = best.map_or(f64::INFINITY, |hit| hit.distance);
            let (a, b) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
            // A ray within a slab's face gives 0 * inf: min and max drop the NaN, which keeps the box.
            let enter = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(near);
            let leave = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z)).min(limit);
            if enter > leave {
                continue;
            }
            if !node.leaf {
                stack.extend([index + 1, node.end]);
                continue;
            }
            for &triangle in &self.order[node.start..node.end] {
                let Some(hit) = intersect(geometry, triangle, origin, direction) else { continue };
                let nearer = best.is_none_or(|b| {
                    // Equal distances: the first triangle, as the depth test of a raster pass keeps it.
                    hit.distance < b.distance || (hit.distance == b.distance && triangle < b.triangle)
                });
                if hit.distance >= near && nearer && accept(&hit) {
                    best = Some(hit);
                }
            }
        }
        best
    }
}

fn split(
    boxes: &[(DVec3, DVec3)],
    order: &mut [usize],
    start: usize,
    end: usize,
    nodes: &mut Vec<Node>,
) -> usize {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for &i in &order[start..end] {
        low = low.min(boxes[i].0);
        high = high.max(boxes[i].1);
    }
    let index = nodes.len();
    nodes.push(Node { low, high, start, end, leaf: end - start <= LEAF });
    if end - start > LEAF {
        let size = high - low;
        let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
        let middle = (end - start) / 2;
        order[start..end].select_nth_unstable_by(middle, |&a, &b| {
            let centre = |i: usize| boxes[i].0[axis] + boxes[i].1[axis];
            centre(a).total_cmp(&centre(b))
        });
        split(boxes, order, start, start + middle, nodes);
        let right = split(boxes, order, start + middle, end, nodes);
        nodes[index].end = right;
    }
    index
}

/// T. Möller and B. Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997; both sides.
pub fn intersect(geometry: &Geometry, triangle: usize, origin: DVec3, direction: DVec3) -> Option<Hit> {
    let [a, b, c] = geometry.corners(triangle).map(|v| v.position);
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = origin - a;
    let q = s.cross(ab);
    let u = s.dot(p) / determinant;
    let v = direction.dot(q) / determinant;
    // A hair of overlap, so that no ray slips between two triangles that share an edge.
    let slack = 1e-12;
    (u >= -slack && v >= -slack && u + v <= 1.0 + slack).then(|| Hit {
        triangle,
        distance: ac.dot(q) / determinant,
        barycentric: [1.0 - u - v, u, v],
        counter_clockwise: determinant > 0.0,
    })
}

/// Change of the barycentrics of `hit` where `direction` changes by `change`: exact, on the triangle's plane.
pub fn barycentric_change(
    geometry: &Geometry,
    hit: &Hit,
    origin: DVec3,
    direction: DVec3,
    change: DVec3,
) -> [f64; 3] {
    let [a, b, c] = geometry.corners(hit.triangle).map(|v| v.position);
    let (ab, ac) = (b - a, c - a);
    let (s, q) = (origin - a, (origin - a).cross(ab));
    // u = U(d) / D(d), v = V(d) / D(d), each linear in the direction.
    let determinant = ab.dot(direction.cross(ac));
    let slope = ab.dot(change.cross(ac));
    let u = (s.dot(change.cross(ac)) - hit.barycentric[1] * slope) / determinant;
    let v = (change.dot(q) - hit.barycentric[2] * slope) / determinant;
    [-u - v, u, v]
}
