//! Rays against triangles: a tree over boxes, split where the surface-area heuristic is least.

use glam::{DMat3, DMat4, DVec3};

/// Triangles in a leaf, at most, where splitting does not pay.
const LEAF: usize = 4;
/// Bins per axis in which a split is looked for.
const BINS: usize = 16;
/// Deeper than this, ranges are halved: the stack below then always suffices.
const HEURISTIC_DEPTH: usize = 40;
/// 40 levels by heuristic and 32 halvings of at most 2^32 triangles.
const STACK: usize = 80;

/// Distances whose ratio is this close to 1 are equal: of surfaces in one plane, rounding must not show now the one,
/// now the other.
pub const TIE: f64 = 1e-10;

/// Whether the first of two (distance, id) is seen before the other.
pub fn before<I: Ord>(a: (f64, I), b: (f64, I)) -> bool {
    let slack = TIE * b.0;
    a.0 < b.0 - slack || (a.0 <= b.0 + slack && a.1 < b.1)
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meeting {
    /// The triangle's id.
    pub id: u32,
    /// In lengths of the ray's direction.
    pub distance: f64,
    /// Weights of the second and third corner.
    pub uv: [f64; 2],
    /// The ray runs against the triangle's counter-clockwise side.
    pub counter_clockwise: bool,
}

/// A tree over triangles.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    triangles: Vec<Triangle>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// Leaf: first triangle. Inner: the right child; the left one is the next node.
    start: u32,
    /// Leaf: how many triangles, above 0. Inner: 0.
    count: u32,
}

/// Corner, the two edges that leave it, and a name.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    a: DVec3,
    ab: DVec3,
    ac: DVec3,
    /// The name.
    pub id: u32,
}

/// Points p with `normal . p + offset >= 0`.
#[derive(Clone, Copy, Debug, Default)]
pub struct HalfSpace {
    /// Not necessarily of unit length.
    pub normal: DVec3,
    /// What is added.
    pub offset: f64,
}

impl HalfSpace {
    /// Through `point`, the inside along `normal`.
    pub fn through(point: DVec3, normal: DVec3) -> Self {
        Self { normal, offset: -normal.dot(point) }
    }

    /// Not below 0 inside.
    pub fn value(&self, point: DVec3) -> f64 {
        self.normal.dot(point) + self.offset
    }

    /// The greatest value in a box.
    pub fn highest(&self, low: DVec3, high: DVec3) -> f64 {
        (self.normal * low).max(self.normal * high).element_sum() + self.offset
    }

    /// The other side.
    pub fn turned(&self) -> Self {
        Self { normal: -self.normal, offset: -self.offset }
    }

    /// This half space of the world, in the space of what `world` places.
    pub fn local(&self, world: &DMat4) -> Self {
        let normal = DMat3::from_mat4(*world).transpose() * self.normal;
        Self { normal, offset: self.value(world.w_axis.truncate()) }
    }
}

impl Bvh {
    /// A tree over `(id, corners)`; triangles with corners that are not finite are left out.
    pub fn new(triangles: impl Iterator<Item = (u32, [DVec3; 3])>) -> Self {
        let mut items: Vec<Item> = triangles
            .filter(|(_, corners)| corners.iter().all(|c| c.is_finite()))
            .map(|(id, corners)| Item::new(id, corners))
            .collect();
        let mut tree = Self { nodes: Vec::new(), triangles: Vec::with_capacity(items.len()) };
        if !items.is_empty() {
            tree.build(&mut items, 0);
        }
        tree
    }

    /// Corners of the box around everything; `None` where there is nothing.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.nodes.first().map(|n| (n.low, n.high))
    }

    /// The nearest meeting in `[near, far]` that `accept` takes; of equal distances (see [`before`]) the lowest id, as
    /// the depth test of a raster pass keeps the first triangle.
    pub fn nearest(
        &self,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        far: f64,
        mut accept: impl FnMut(&Meeting) -> bool,
    ) -> Option<Meeting> {
        let mut best: Option<Meeting> = None;
        self.walk(origin, direction, near, far, |meeting, far| {
            let first = best.is_none_or(|b| before((meeting.distance, meeting.id), (b.distance, b.id)));
            if first && accept(meeting) {
                best = Some(*meeting);
                *far = meeting.distance * (1.0 + TIE);
            }
            false
        });
        best
    }

    /// Whether anything in `[near, far]` is met that `accept` takes.
    pub fn any(
        &self,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        far: f64,
        mut accept: impl FnMut(&Meeting) -> bool,
    ) -> bool {
        self.walk(origin, direction, near, far, |meeting, _| accept(meeting))
    }

    /// Visits meetings, nearer boxes first, until `visit` says that it is done; `visit` may shorten the ray.
    fn walk(
        &self,
        origin: DVec3,
        direction: DVec3,
        near: f64,
        mut far: f64,
        mut visit: impl FnMut(&Meeting, &mut f64) -> bool,
    ) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let inverse = direction.recip();
        let enters = |node: &Node, far: f64| enter_box((node.low, node.high), origin, inverse, near, far);
        let mut stack = [(0_u32, 0.0_f64); STACK];
        let mut depth = 0;
        let mut current = enters(&self.nodes[0], far).map(|_| 0_u32);
        loop {
            let Some(index) = current.take() else {
                // The next box that the ray, perhaps shorter by now, still enters.
                loop {
                    if depth == 0 {
                        return false;
                    }
                    depth -= 1;
                    if stack[depth].1 <= far {
                        current = Some(stack[depth].0);
                        break;
                    }
                }
                continue;
            };
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                let from = node.start as usize;
                for triangle in &self.triangles[from..from + node.count as usize] {
                    if let Some(meeting) = triangle.meet(origin, direction)
                        && meeting.distance >= near
                        && meeting.distance <= far
                        && visit(&meeting, &mut far)
                    {
                        return true;
                    }
                }
                continue;
            }
            let (left, right) = (index + 1, node.start);
            let enter = [left, right].map(|child| enters(&self.nodes[child as usize], far));
            current = match enter {
                [Some(l), Some(r)] => {
                    let (first, second) = if l <= r { (left, (right, r)) } else { (right, (left, l)) };
                    stack[depth] = second;
                    depth += 1;
                    Some(first)
                }
                [Some(_), None] => Some(left),
                [None, Some(_)] => Some(right),
                [None, None] => None,
            };
        }
    }

    /// Visits the triangles that may reach into all half spaces of `bounds` no deeper than `far` by `depth`, nearer
    /// boxes first, until `visit` says that it is done; `visit` may lower `far`.
    pub fn within(
        &self,
        bounds: &[HalfSpace],
        depth: &HalfSpace,
        far: &mut f64,
        mut visit: impl FnMut(&Triangle, &mut f64) -> bool,
    ) -> bool {
        let lowest = |index: u32, far: f64| {
            let node = &self.nodes[index as usize];
            let inside = bounds.iter().all(|b| b.highest(node.low, node.high) >= 0.0);
            let near = -depth.turned().highest(node.low, node.high);
            (inside && near <= far).then_some(near)
        };
        if self.nodes.is_empty() || lowest(0, *far).is_none() {
            return false;
        }
        let mut stack = [(0_u32, f64::NEG_INFINITY); STACK];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (index, near) = stack[height];
            if near > *far {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                let from = node.start as usize;
                for triangle in &self.triangles[from..from + node.count as usize] {
                    let corners = triangle.corners();
                    let outside = |b: &HalfSpace| corners.iter().all(|c| b.value(*c) < 0.0);
                    if !bounds.iter().any(outside) && visit(triangle, far) {
                        return true;
                    }
                }
                continue;
            }
            let (left, right) = (index + 1, node.start);
            let mut push = |index: u32, near: Option<f64>| {
                if let Some(near) = near {
                    stack[height] = (index, near);
                    height += 1;
                }
            };
            // The nearer one last: it is visited first.
            match [lowest(left, *far), lowest(right, *far)] {
                [Some(l), Some(r)] if l <= r => {
                    push(right, Some(r));
                    push(left, Some(l));
                }
                [l, r] => {
                    push(left, l);
                    push(right, r);
                }
            }
        }
        false
    }

    fn build(&mut self, items: &mut [Item], depth: usize) -> u32 {
        let index = self.nodes.len();
        let (low, high) = items.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), item| {
            (low.min(item.low), high.max(item.high))
        });
        let start = self.triangles.len() as u32;
        self.nodes.push(Node { low, high, start, count: items.len() as u32 });
        let Some(middle) = split(items, depth) else {
            self.triangles.extend(items.iter().map(|i| i.triangle));
            return index as u32;
        };
        let (left, right) = items.split_at_mut(middle);
        self.build(left, depth + 1);
        let right = self.build(right, depth + 1);
        self.nodes[index].start = right;
        self.nodes[index].count = 0;
        index as u32
    }
}

impl Triangle {
    /// A triangle by its corners.
    pub fn new(id: u32, [a, b, c]: [DVec3; 3]) -> Self {
        Self { a, ab: b - a, ac: c - a, id }
    }

    /// Its corners.
    pub fn corners(&self) -> [DVec3; 3] {
        [self.a, self.a + self.ab, self.a + self.ac]
    }

    /// Weights of the corners at a point of its plane.
    pub fn barycentric(&self, point: DVec3) -> [f64; 3] {
        let normal = self.ab.cross(self.ac);
        let area = normal.length_squared().max(f64::MIN_POSITIVE);
        let v = normal.dot((point - self.a).cross(self.ac)) / area;
        let w = normal.dot(self.ab.cross(point - self.a)) / area;
        [1.0 - v - w, v, w]
    }

    /// Where a ray meets it: T. Möller and B. Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997; both sides.
    pub fn meet(&self, origin: DVec3, direction: DVec3) -> Option<Meeting> {
        let p = direction.cross(self.ac);
        let determinant = self.ab.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let inverse = determinant.recip();
        let s = origin - self.a;
        let u = s.dot(p) * inverse;
        // A hair of overlap, so that no ray slips between two triangles that share an edge.
        let slack = 1e-12;
        if !(u >= -slack && u <= 1.0 + slack) {
            return None;
        }
        let q = s.cross(self.ab);
        let v = direction.dot(q) * inverse;
        (v >= -slack && u + v <= 1.0 + slack).then(|| Meeting {
            id: self.id,
            distance: self.ac.dot(q) * inverse,
            uv: [u, v],
            counter_clockwise: determinant > 0.0,
        })
    }
}

/// Where within `[near, far]` a ray enters the box (low, high); `None` where it does not. `inverse` is one over its
/// direction.
pub(super) fn enter_box(
    (low, high): (DVec3, DVec3),
    origin: DVec3,
    inverse: DVec3,
    near: f64,
    far: f64,
) -> Option<f64> {
    let (a, b) = ((low - origin) * inverse, (high - origin) * inverse);
    // A ray within a slab's face gives 0 * inf: min and max drop the NaN, which keeps the box.
    let enter = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(near);
    let leave = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z)).min(far);
    (enter <= leave).then_some(enter)
}

/// A triangle while the tree is built.
struct Item {
    low: DVec3,
    high: DVec3,
    centre: DVec3,
    triangle: Triangle,
}

impl Item {
    fn new(id: u32, [a, b, c]: [DVec3; 3]) -> Self {
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let triangle = Triangle::new(id, [a, b, c]);
        Self { low, high, centre: 0.5 * (low + high), triangle }
    }
}

/// Half of the area of a box's surface.
fn area(low: DVec3, high: DVec3) -> f64 {
    let size = (high - low).max(DVec3::ZERO);
    size.x * size.y + size.y * size.z + size.z * size.x
}

/// Sorts `items` into two parts and returns where the second begins; `None` where they are better left together.
/// (I. Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007.)
fn split(items: &mut [Item], depth: usize) -> Option<usize> {
    if items.len() <= LEAF {
        return None;
    }
    let (low, high) = items
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), i| (l.min(i.centre), h.max(i.centre)));
    let size = high - low;
    let halve = |items: &mut [Item]| {
        let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
        let middle = items.len() / 2;
        items.select_nth_unstable_by(middle, |a, b| a.centre[axis].total_cmp(&b.centre[axis]));
        Some(middle)
    };
    if depth >= HEURISTIC_DEPTH {
        return halve(items);
    }
    let mut best = (f64::INFINITY, 0, 0);
    for axis in 0..3 {
        if size[axis] <= 0.0 {
            continue;
        }
        let mut bins = [(DVec3::INFINITY, DVec3::NEG_INFINITY, 0_usize); BINS];
        for item in items.iter() {
            let bin = &mut bins[bin_of(item, axis, low, size)];
            *bin = (bin.0.min(item.low), bin.1.max(item.high), bin.2 + 1);
        }
        let mut right = [(0.0, 0); BINS];
        let mut sum = (DVec3::INFINITY, DVec3::NEG_INFINITY, 0);
        for k in (1..BINS).rev() {
            sum = (sum.0.min(bins[k].0), sum.1.max(bins[k].1), sum.2 + bins[k].2);
            right[k] = (area(sum.0, sum.1), sum.2);
        }
        let mut sum = (DVec3::INFINITY, DVec3::NEG_INFINITY, 0);
        for k in 1..BINS {
            sum = (sum.0.min(bins[k - 1].0), sum.1.max(bins[k - 1].1), sum.2 + bins[k - 1].2);
            if sum.2 == 0 || right[k].1 == 0 {
                continue;
            }
            let cost = area(sum.0, sum.1) * sum.2 as f64 + right[k].0 * right[k].1 as f64;
            if cost < best.0 {
                best = (cost, axis, k);
            }
        }
    }
    let (_, axis, bin) = best;
    if bin == 0 {
        // All centres in one place.
        return halve(items);
    }
    items.sort_unstable_by_key(|item| bin_of(item, axis, low, size) >= bin);
    Some(items.partition_point(|item| bin_of(item, axis, low, size) < bin))
}

fn bin_of(item: &Item, axis: usize, low: DVec3, size: DVec3) -> usize {
    (((item.centre[axis] - low[axis]) / size[axis] * BINS as f64) as usize).min(BINS - 1)
}
