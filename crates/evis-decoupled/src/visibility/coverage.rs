//! What each fragment covers of a pixel at a time.
//!
//! Among few fragments the pixel's square is cut into convex regions, of exact area; among many, [`crate::visibility::mask`] first
//! decides which are seen. Where neighbours on a surface go on across all their edges in the pixel they cover it, each facet of it
//! once, and need not be cut by each other.

use crate::scene::facets::{ALONE, CORNERS};
use crate::visibility::fragment::{Fragment, Line, PLANE};
use crate::visibility::mask;

/// Most corners of a region.
const MAX_CORNERS: usize = 14;

/// Corners of a convex polygon in the pixel, clockwise on the screen.
pub type Corners = [[f64; 2]];

/// A convex polygon in the pixel.
#[derive(Clone, Debug)]
pub struct Polygon {
    corners: [[f64; 2]; MAX_CORNERS],
    count: usize,
}

/// Corners of the whole pixel.
pub const PIXEL: [[f64; 2]; 4] = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];

impl Default for Polygon {
    fn default() -> Self {
        Self { corners: [[0.0; 2]; MAX_CORNERS], count: 0 }
    }
}

impl Polygon {
    /// Its corners.
    pub fn corners(&self) -> &Corners {
        &self.corners[..self.count]
    }

    #[inline(always)]
    fn push(&mut self, p: [f64; 2]) {
        // A pixel cut by more lines than this keeps its area but for the last corner.
        if self.count < MAX_CORNERS {
            self.corners[self.count] = p;
            self.count += 1;
        }
    }

    /// The part of the pixel inside all of `lines`.
    pub fn within<'l>(lines: impl IntoIterator<Item = &'l Line>) -> Self {
        let mut polygon = Self::default();
        PIXEL.into_iter().for_each(|p| polygon.push(p));
        let mut outside = Self::default();
        for line in lines {
            let whole = polygon.clone();
            cut(whole.corners(), line, &mut polygon, &mut outside);
        }
        polygon
    }
}

/// Whether any corner lies inside `line`, where it is not negative, and whether any lies outside.
#[inline(always)]
fn sides(corners: &Corners, line: &Line) -> (bool, bool) {
    let (mut inside, mut outside) = (false, false);
    for corner in corners {
        let is_in = line.at(*corner) >= 0.0;
        inside |= is_in;
        outside |= !is_in;
    }
    (inside, outside)
}

/// The parts of a polygon inside and outside of `line`.
#[inline(always)]
fn cut(corners: &Corners, line: &Line, inside: &mut Polygon, outside: &mut Polygon) {
    (inside.count, outside.count) = (0, 0);
    let Some(&last) = corners.last() else { return };
    let (mut a, mut va) = (last, line.at(last));
    for &b in corners {
        let vb = line.at(b);
        if (va >= 0.0) != (vb >= 0.0) {
            let w = va / (va - vb);
            let p = [a[0] + w * (b[0] - a[0]), a[1] + w * (b[1] - a[1])];
            inside.push(p);
            outside.push(p);
        }
        if vb >= 0.0 {
            inside.push(b);
        } else {
            outside.push(b);
        }
        (a, va) = (b, vb);
    }
}

/// Area and moments of a polygon.
#[inline(always)]
pub fn moments(corners: &Corners) -> Moments {
    let mut m = Moments::default();
    let Some(&last) = corners.last() else { return m };
    let mut a = last;
    for &b in corners {
        let cross = a[0] * b[1] - b[0] * a[1];
        m.area += 0.5 * cross;
        m.first[0] += cross * (a[0] + b[0]) / 6.0;
        m.first[1] += cross * (a[1] + b[1]) / 6.0;
        m.second[0] += cross * (a[0] * a[0] + a[0] * b[0] + b[0] * b[0]) / 12.0;
        m.second[1] += cross * (a[0] * b[1] + 2.0 * (a[0] * a[1] + b[0] * b[1]) + b[0] * a[1]) / 24.0;
        m.second[2] += cross * (a[1] * a[1] + a[1] * b[1] + b[1] * b[1]) / 12.0;
        a = b;
    }
    m
}

/// Polygons in one store of corners, each with the number of its owner.
#[derive(Clone, Debug, Default)]
pub struct Polygons {
    corners: Vec<[f64; 2]>,
    /// Owner, and where its corners end.
    items: Vec<(u32, u32)>,
}

impl Polygons {
    /// Removes all.
    pub fn clear(&mut self) {
        self.corners.clear();
        self.items.clear();
    }

    /// Adds one, unless it has no area.
    #[inline(always)]
    pub fn push(&mut self, owner: u32, corners: &Corners) {
        if corners.len() >= 3 {
            self.corners.extend_from_slice(corners);
            self.items.push((owner, self.corners.len() as u32));
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// Owners and corners.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &Corners)> {
        let mut start = 0;
        self.items.iter().map(move |&(owner, end)| {
            let corners = &self.corners[start..end as usize];
            start = end as usize;
            (owner, corners)
        })
    }
}

/// Room for cutting one polygon after another.
#[derive(Clone, Debug, Default)]
pub struct Cutter {
    inside: [Polygon; 2],
    outside: Polygon,
}

impl Cutter {
    /// What of a polygon lies inside all of `lines`; what does not goes to `rest`, in the name of `owner`. A polygon of which
    /// nothing is inside goes there as it is.
    #[inline(always)]
    pub fn cut<'s>(
        &'s mut self,
        corners: &'s Corners,
        lines: &[Line],
        (owner, rest): (u32, &mut Polygons),
    ) -> &'s Corners {
        let mut crossing = false;
        for line in lines {
            let (inside, outside) = sides(corners, line);
            if !inside {
                rest.push(owner, corners);
                return &[];
            }
            crossing |= outside;
        }
        if !crossing {
            return corners;
        }
        let [current, next] = &mut self.inside;
        let (mut current, mut next) = (current, next);
        let mut whole = true;
        for line in lines {
            let from = if whole { corners } else { current.corners() };
            match sides(from, line) {
                (true, true) => {
                    cut(from, line, next, &mut self.outside);
                    rest.push(owner, self.outside.corners());
                    std::mem::swap(&mut current, &mut next);
                    whole = false;
                }
                (true, false) => {}
                // Nothing of it is inside.
                _ => {
                    rest.push(owner, from);
                    return &[];
                }
            }
        }
        if current.count < 3 { &[] } else { current.corners() }
    }
}

/// Integrals over a part of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Of 1.
    pub area: f64,
    /// Of x and y.
    pub first: [f64; 2],
    /// Of x x, x y and y y.
    pub second: [f64; 3],
}

impl Moments {
    /// Of the whole pixel.
    pub const PIXEL: Self = Self { area: 1.0, first: [0.0; 2], second: [1.0 / 12.0, 0.0, 1.0 / 12.0] };

    /// Both together.
    pub fn add(&mut self, o: &Self) {
        self.area += o.area;
        for k in 0..2 {
            self.first[k] += o.first[k];
        }
        for k in 0..3 {
            self.second[k] += o.second[k];
        }
    }

    /// What is left of this without a part of it.
    pub fn take(&mut self, part: &Self) {
        self.area -= part.area;
        for k in 0..2 {
            self.first[k] -= part.first[k];
        }
        for k in 0..3 {
            self.second[k] -= part.second[k];
        }
    }

    /// Centroid, and second moments xx, xy and yy about it over the area.
    #[inline(always)]
    fn central(&self) -> ([f64; 2], [f64; 3]) {
        let inverse = 1.0 / self.area;
        let [x, y] = self.first.map(|v| v * inverse);
        let [xx, xy, yy] = self.second.map(|v| v * inverse);
        ([x, y], [(xx - x * x).max(1e-12), xy - x * y, (yy - y * y).max(1e-12)])
    }

    /// Centroid, and the axes of the parallelogram about it that has these moments.
    #[inline(always)]
    pub fn footprint(&self) -> ([f64; 2], [[f64; 2]; 2]) {
        let ([x, y], [xx, xy, yy]) = self.central();
        // Cholesky: a unit square has the variance 1/12 along each side.
        let l = xx.sqrt();
        let m = xy / l;
        let n = (yy - m * m).max(0.0).sqrt();
        let side = 12.0_f64.sqrt();
        ([x, y], [[side * l, side * m], [0.0, side * n]])
    }
}

/// Most corners of the part of a pixel that a facet and the planes of the camera leave.
const MOST_OUTLINE: usize = 12;
/// An edge of a pixel's square.
const BORDER: u8 = u8::MAX;
/// Square of the length of an edge that is none.
const NO_EDGE: f64 = 1e-20;
/// What areas of facets that tile a pixel may sum up to beside 1.
const ROUNDING: f64 = 1e-9;

/// The part of a pixel that a facet covers, with the names of its edges.
#[derive(Default)]
struct Outline {
    corners: [[f64; 2]; MOST_OUTLINE],
    /// Of the edge from a corner to the next one.
    names: [u8; MOST_OUTLINE],
    count: usize,
}

impl Outline {
    fn corners(&self) -> &Corners {
        &self.corners[..self.count]
    }

    /// `room` is overwritten.
    #[inline(always)]
    fn become_that_of(&mut self, fragment: &Fragment, room: &mut Self) {
        self.corners[..PIXEL.len()].copy_from_slice(&PIXEL);
        self.names[..PIXEL.len()].fill(BORDER);
        self.count = PIXEL.len();
        for (line, name) in fragment.crossing().iter().zip(fragment.names) {
            let values = |outline: &Self, k: usize| line.at(outline.corners[k]);
            if (0..self.count).all(|k| values(self, k) >= 0.0) {
                continue;
            }
            room.count = 0;
            let mut value = values(self, 0);
            for k in 0..self.count {
                let next = (k + 1) % self.count;
                let (a, b, after) = (self.corners[k], self.corners[next], values(self, next));
                if value >= 0.0 {
                    room.push(a, self.names[k]);
                }
                if (value >= 0.0) != (after >= 0.0) {
                    let w = value / (value - after);
                    let p = [a[0] + w * (b[0] - a[0]), a[1] + w * (b[1] - a[1])];
                    room.push(p, if value >= 0.0 { name } else { self.names[k] });
                }
                value = after;
            }
            std::mem::swap(self, room);
        }
    }

    #[inline(always)]
    fn push(&mut self, corner: [f64; 2], name: u8) {
        self.corners[self.count] = corner;
        self.names[self.count] = name;
        self.count += 1;
    }

    /// Names of its edges but for those of the pixel.
    #[inline(always)]
    fn inner(&self) -> impl Iterator<Item = u8> {
        (0..self.count).filter_map(|k| {
            let ([x, y], [u, v]) = (self.corners[k], self.corners[(k + 1) % self.count]);
            let is_edge = (u - x) * (u - x) + (v - y) * (v - y) > NO_EDGE;
            (self.names[k] != BORDER && is_edge).then_some(self.names[k])
        })
    }
}

/// Fragments above which masks first decide which are seen.
pub const FEW: usize = 24;
/// Owner of what no fragment covers.
pub const NOBODY: u32 = u32::MAX;

/// Room for the work on one pixel, kept between pixels.
#[derive(Default)]
pub struct Regions {
    /// Convex regions, which tile the pixel; their owners are the fragments' numbers, or [`NOBODY`].
    pub regions: Polygons,
    /// Moments of what each fragment covers, and of what none does.
    pub areas: Vec<Moments>,
    outlines: [Outline; 2],
    order: Vec<usize>,
    before: Polygons,
    uncovered: Polygons,
    rest: Polygons,
    cutter: Cutter,
}

impl Regions {
    /// Finds what each of `fragments` covers of the pixel: its moments in [`Regions::areas`], and its polygons in
    /// [`Regions::regions`].
    ///
    /// `neighbors` are those of [`crate::scene::world::World`], `backdrop` is that of [`Regions::backdrop`]; `plain` says that of
    /// this the moments suffice, so that there need not be regions of it.
    pub fn find(
        &mut self,
        fragments: &[Fragment],
        neighbors: &[[u32; CORNERS]],
        (backdrop, plain): (Option<usize>, bool),
    ) {
        let mut rest = Moments::PIXEL;
        let is_sheet = self.sheet(fragments, neighbors) && {
            rest = self.measure(fragments.len());
            rest.area.abs() <= ROUNDING
        };
        let known = is_sheet || plain && self.side_by_side(fragments, backdrop);
        if !known {
            self.cut(fragments);
        }
        if !is_sheet {
            rest = self.measure(fragments.len());
        }
        if known {
            self.areas[backdrop.unwrap_or(fragments.len())].add(&rest);
        }
    }

    /// Finds [`Regions::areas`] of `count` fragments from their regions; what these leave of the pixel.
    fn measure(&mut self, count: usize) -> Moments {
        self.areas.clear();
        self.areas.resize(count + 1, Moments::default());
        let mut rest = Moments::PIXEL;
        for (owner, polygon) in self.regions.iter() {
            let own = moments(polygon);
            rest.take(&own);
            self.areas[(owner as usize).min(count)].add(&own);
        }
        rest
    }

    /// The nearest of the fragments that fill the pixel.
    pub fn backdrop(fragments: &[Fragment]) -> Option<usize> {
        let fills = (0..fragments.len()).filter(|k| fragments[*k].edge_count == 0);
        fills.min_by(|a, b| fragments[*a].by_depth(&fragments[*b]))
    }

    /// As [`Regions::cut`], where all that is seen are neighbours that go on across all their edges; else returns false.
    ///
    /// From the facet that is seen at the pixel's centre on, every edge in the pixel leads to the neighbour beyond it. All of them
    /// show the same side, so they cover the pixel once, which their areas must confirm, and what is not among them must lie behind
    /// all of them.
    fn sheet(&mut self, fragments: &[Fragment], neighbors: &[[u32; CORNERS]]) -> bool {
        if !(2..=FEW).contains(&fragments.len()) {
            return false;
        }
        let at_centre = |(_, f): &(u32, &Fragment)| f.crossing().iter().all(|edge| edge.c >= 0.0);
        let nearest = (0..).zip(fragments).filter(at_centre).min_by(|(_, a), (_, b)| a.by_depth(b));
        let Some((first, _)) = nearest.filter(|(_, f)| f.edge_count > 0) else { return false };
        let number = |facet: u32| fragments.iter().position(|f| f.facet == facet);
        self.regions.clear();
        let [outline, room] = &mut self.outlines;
        let (mut known, mut waiting) = (0_u32, 1_u32 << first);
        while waiting != 0 {
            let own = waiting.trailing_zeros();
            let fragment = &fragments[own as usize];
            known |= 1 << own;
            waiting &= waiting - 1;
            outline.become_that_of(fragment, room);
            for name in outline.inner() {
                let beyond =
                    if name == PLANE { ALONE } else { neighbors[fragment.facet as usize][name as usize] };
                let other = (beyond != ALONE).then(|| number(beyond)).flatten();
                let Some(other) = other.filter(|other| fragments[*other].front == fragment.front) else {
                    return false;
                };
                waiting |= 1 << other & !known;
            }
            self.regions.push(own, outline.corners());
        }
        (0..).zip(fragments).all(|(other, behind)| {
            let mut own = (0..).zip(fragments).filter(|(own, _)| known >> own & 1 == 1);
            known >> other & 1 == 1 || own.all(|(_, f)| f.before(behind).1 == 1) || {
                outline.become_that_of(behind, room);
                outline.count < 3
            }
        })
    }

    /// As [`Regions::cut`], where what is seen before `backdrop`, or before nothing, lies side by side; else returns false. There
    /// are no regions of the backdrop.
    fn side_by_side(&mut self, fragments: &[Fragment], backdrop: Option<usize>) -> bool {
        if fragments.len() > FEW {
            return false;
        }
        self.regions.clear();
        self.order.clear();
        let [outline, room] = &mut self.outlines;
        for (k, fragment) in fragments.iter().enumerate().filter(|(k, _)| Some(*k) != backdrop) {
            let side = backdrop.map_or(1, |backdrop| fragment.before(&fragments[backdrop]).1);
            if side == -1 {
                continue;
            }
            outline.become_that_of(fragment, room);
            if outline.count < 3 {
                continue;
            }
            let is_beside = |(number, (_, other)): (usize, (u32, &Corners))| {
                let apart = |line: &Line, corners: &Corners| {
                    let touching = ROUNDING * (line.a.abs() + line.b.abs());
                    corners.iter().all(|corner| line.at(*corner) <= touching)
                };
                fragment.crossing().iter().any(|line| apart(line, other))
                    || fragments[self.order[number]].crossing().iter().any(|l| apart(l, outline.corners()))
            };
            if side == 0 || !self.regions.iter().enumerate().all(is_beside) {
                return false;
            }
            self.order.push(k);
            self.regions.push(k as u32, outline.corners());
        }
        true
    }

    /// Cuts the pixel into what each of `fragments` covers.
    fn cut(&mut self, fragments: &[Fragment]) {
        self.order.clear();
        if fragments.len() > FEW {
            let seen = mask::seen(fragments);
            self.order.extend((0..fragments.len()).filter(|i| seen[*i]));
        } else {
            self.order.extend(0..fragments.len());
        }
        self.order.sort_by(|a, b| fragments[*a].by_depth(&fragments[*b]));
        self.regions.clear();
        self.uncovered.clear();
        self.uncovered.push(NOBODY, &PIXEL);
        for k in 0..self.order.len() {
            self.insert(fragments, self.order[k], k);
        }
        for (_, polygon) in self.uncovered.iter() {
            self.regions.push(NOBODY, polygon);
        }
    }

    fn insert(&mut self, fragments: &[Fragment], index: usize, earlier: usize) {
        let fragment = &fragments[index];
        let own = index as u32;
        // What is already covered, but perhaps by something behind this.
        let behind = |other: &usize| fragment.before(&fragments[*other]).1 >= 0;
        if self.order[..earlier].iter().any(behind) {
            std::mem::swap(&mut self.before, &mut self.regions);
            self.regions.clear();
            let mut lines = [Line::default(); 6];
            let count = fragment.crossing().len();
            lines[..count].copy_from_slice(fragment.crossing());
            for (owner, polygon) in self.before.iter() {
                let (line, side) = fragment.before(&fragments[owner as usize]);
                if side < 0 {
                    self.regions.push(owner, polygon);
                    continue;
                }
                lines[count] = line;
                let lines = &lines[..count + usize::from(side == 0)];
                let inside = self.cutter.cut(polygon, lines, (owner, &mut self.regions));
                self.regions.push(own, inside);
            }
        }
        self.rest.clear();
        for (owner, polygon) in self.uncovered.iter() {
            let inside = self.cutter.cut(polygon, fragment.crossing(), (owner, &mut self.rest));
            self.regions.push(own, inside);
        }
        std::mem::swap(&mut self.uncovered, &mut self.rest);
    }
}

#[cfg(test)]
mod tests {
    use evis_scene::primitive::Shape;
    use evis_scene::{Camera, Lens, Material, Motion, Node, Primitive, Scene, ShadingModel};
    use glam::{DMat4, DQuat, DVec3};

    use super::*;
    use crate::scene::testing;
    use crate::scene::tiles::PIXELS;
    use crate::scene::world::World;
    use crate::visibility::blocks::{Block, Clock};
    use crate::visibility::fragment::Sight;
    use crate::visibility::lists::Lists;

    /// Dense meshes that hide parts of each other and of themselves before a wall that some lie beside, and through which one goes.
    fn scene() -> Scene {
        let mut scene = Scene::default();
        let unlit = Material { model: ShadingModel::Unlit, ..Material::default() };
        scene.materials.extend([unlit.clone(), Material { double_sided: true, ..unlit }]);
        let of = |shape: Shape, segments: [u32; 2]| shape.build(Some(segments), [1.0; 2]).unwrap();
        let mut add = |primitive: Primitive, place: DVec3, turn: f64| {
            let rotation = DQuat::from_axis_angle(DVec3::new(0.4, 1.0, 0.2).normalize(), turn);
            testing::add(
                &mut scene,
                primitive,
                Motion::Fixed(DMat4::from_rotation_translation(rotation, place)),
            );
        };
        add(of(Shape::Card { size: [3.0, 2.0] }, [1, 1]), DVec3::new(0.3, 0.0, -4.0), 0.0);
        let ring = testing::torus([0.45, 0.2], [40, 20]);
        let both_sides = Primitive { material: 1, ..ring.clone() };
        add(ring, DVec3::new(-0.4, 0.1, -2.5), 1.2);
        add(both_sides, DVec3::new(-0.5, -0.6, -2.8), 0.5);
        add(of(Shape::Sphere { radius: 0.4 }, [48, 24]), DVec3::new(0.3, 0.2, -2.8), 0.7);
        add(of(Shape::Sphere { radius: 0.35 }, [24, 12]), DVec3::new(0.7, -0.4, -4.0), 0.3);
        add(of(Shape::Box { size: [0.5; 3] }, [1, 1]), DVec3::new(0.2, -0.5, -2.2), 0.6);
        let node = scene.add_node(Node::default());
        scene.cameras.push(Camera::new("camera", node, Lens::FieldOfView { fov_y: 0.8 }));
        scene
    }

    #[test]
    fn what_lies_side_by_side_is_what_cutting_finds() {
        let scene = scene();
        let world = World::new(&scene, 0, Some((160, 120))).unwrap();
        let mut clock = Clock::new(&world, Block { start_us: 0.0, end_us: 8192.0, jump: false });
        let lists = Lists::new(&world, &mut clock).unwrap();
        let [mut quick, mut cut] = [Regions::default(), Regions::default()];
        // Pixels by how they are found: as a sheet, side by side, by cutting.
        let (mut ways, mut worst, mut canary) = ([0; 3], 0.0_f64, 0);
        for (row, column) in (0..lists.row_count()).flat_map(|row| (0..lists.columns).map(move |c| (row, c)))
        {
            let view = world.tile([column, row]);
            let entries = &lists.row(&world, row)[column].entries;
            let sights: Vec<Option<Sight>> = entries
                .iter()
                .map(|e| Sight::new(&lists.records[e.record as usize], &view, 0.5, &lists.depths))
                .collect();
            for pixel in 0..PIXELS {
                let frame = view.pixel(pixel);
                let seen = entries.iter().zip(&sights).filter(|(e, _)| e.touches >> pixel & 1 == 1);
                let of = |(e, sight): (&crate::visibility::lists::Entry, &Option<Sight>)| {
                    sight.as_ref()?.at(e.record, &frame, false)
                };
                let fragments: Vec<Fragment> = seen.filter_map(of).collect();
                if fragments.len() < 2 {
                    continue;
                }
                let backdrop = Regions::backdrop(&fragments);
                let way = if quick.sheet(&fragments, &world.neighbors) {
                    0
                } else if quick.side_by_side(&fragments, backdrop) {
                    1
                } else {
                    2
                };
                ways[way] += 1;
                quick.find(&fragments, &world.neighbors, (backdrop, true));
                cut.cut(&fragments);
                let mut areas = vec![Moments::default(); fragments.len() + 1];
                for (owner, polygon) in cut.regions.iter() {
                    areas[(owner as usize).min(fragments.len())].add(&moments(polygon));
                }
                for (found, wanted) in quick.areas.iter().zip(&areas) {
                    let off = (found.area - wanted.area).abs();
                    let first = [0, 1].map(|k| (found.first[k] - wanted.first[k]).abs());
                    let second = [0, 1, 2].map(|k| (found.second[k] - wanted.second[k]).abs());
                    worst = first.into_iter().chain(second).fold(worst.max(off), f64::max);
                }
                // Canary: had every facet its own outline, whatever lies before it.
                let [mut outline, mut room] = [Outline::default(), Outline::default()];
                let whole: f64 = fragments
                    .iter()
                    .map(|f| {
                        outline.become_that_of(f, &mut room);
                        moments(outline.corners()).area
                    })
                    .sum();
                canary += usize::from(whole > 1.01);
            }
        }
        println!("{ways:?} pixels, off by {worst:.1e} at most; {canary} hide something");
        assert!(ways.iter().all(|count| *count > 100), "{ways:?}");
        assert!(worst < 1e-7, "{worst}");
        assert!(canary > 1000, "{canary}");
    }
}
