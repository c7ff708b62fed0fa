//! Cast shadows as polygons, at any time.
//!
//! The shadow of a convex facet on a plane is where the planes through the lamp and the facet's edges, and the facet's
//! own plane, have the plane's points inside. On the screen each is a half plane: with the homogeneous point
//! h = d / q(d) that a receiver of inverse depth q shows at d = (x, y, 1), n . h - n . a >= 0 is
//! n . d - (n . a) q(d) >= 0. So shadows are cut like facets, exactly and in continuous time.

use std::sync::OnceLock;

use glam::{DVec3, Vec4};

use crate::packed::MOST_OWN;
use crate::scene::contour::area;
use crate::scene::tiles::{PixelFrame, TILE, TileView};
use crate::visibility::coverage::{Corners, Cutter, Moments, PIXEL, Polygons, moments};
use crate::visibility::fragment::Line;
use crate::visibility::lists::{powers, rows_about};
use crate::visibility::mask;

/// What lies beyond a facet by less than this part of the lamp's distance from it is the facet itself, or touches it.
const CONTACT: f64 = 1e-6;
/// What rises over a plane by less than this part of its distance from the eye touches it.
const TOUCHING: f64 = 1e-9;
/// Shadows above which masks count what is lit.
const FEW: usize = 48;

/// A facet that may throw a shadow into a tile.
#[derive(Clone, Debug)]
pub struct Occluder {
    /// Homogeneous image points as quadratics of the block's time: `[power][x z, y z, z][corner]`.
    points: [[[f64; 4]; 3]; 3],
    /// Its triangle in the tree, for tests.
    pub facet: u32,
    /// Per lamp, made when they are first needed: walls on the screen over the block, and in the world.
    walls: [OnceLock<Option<Box<Walls>>>; MOST_OWN],
    spaces: [OnceLock<Option<Box<DarkSpace>>>; MOST_OWN],
}

/// Half spaces whose intersection a facet hides from a lamp, at the start, middle and end of a span: of image points h those with
/// `normal . h >= through`.
type Walls = [[(DVec3, f64); 3]; 5];

/// The start, middle and end of a part of a block.
fn times_of([from, to]: [f64; 2]) -> [f64; 3] {
    [from, from + 0.5 * (to - from), to]
}

/// What a facet is seen as from a lamp: beyond its own plane, which comes first, and inside its edges. `None` where the lamp lies
/// in the plane.
#[inline(always)]
fn half_spaces(corners: &[DVec3; 4], (place, w): (DVec3, f64)) -> Option<[(DVec3, f64); 5]> {
    let normal = (corners[1] - corners[0]).cross(corners[3] - corners[0]);
    let height = normal.dot(place) - w * normal.dot(corners[0]);
    if height == 0.0 {
        return None;
    }
    let side = -height.signum();
    let beyond = (normal * side, normal.dot(corners[0]) * side + CONTACT * height.abs());
    let mut planes = [beyond; 5];
    let mut sign = 0.0;
    for k in 0..4 {
        let (a, b) = (corners[k], corners[(k + 1) % 4]);
        let normal = a.cross(b) * w + place.cross(a - b);
        let through = normal.dot(a);
        if sign == 0.0 {
            sign = (normal.dot(corners[3]) - through).signum();
        }
        planes[k + 1] = (normal * sign, through * sign);
    }
    Some(planes)
}

/// Where a half space meets the plane of `receiver`, in the coordinates of that.
#[inline(always)]
fn on_plane(normal: DVec3, through: f64, receiver: &Line) -> Line {
    Line {
        a: normal.x - through * receiver.a,
        b: normal.y - through * receiver.b,
        c: normal.z - through * receiver.c,
    }
}

/// The plane of a facet on which shadows may fall, at the start, middle and end of a span.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Its inverse depth as a tile sees it, and on the picture without distortion.
    lines: [Line; 3],
    planes: [DVec3; 3],
}

impl Receiver {
    /// From inverse depths that the tile `view` sees.
    pub fn new(lines: [Line; 3], view: &TileView) -> Self {
        let planes = lines.map(|line| view.image_line(DVec3::new(line.a, line.b, line.c)));
        Self { lines, planes }
    }
}

impl Occluder {
    /// From corners' homogeneous image points at the start, middle and end of a block.
    pub fn new(facet: u32, h: [[DVec3; 3]; 4]) -> Self {
        let p = h.map(powers);
        let points = std::array::from_fn(|power| {
            std::array::from_fn(|axis| std::array::from_fn(|corner| p[corner][power][axis]))
        });
        Self { points, facet, walls: Default::default(), spaces: Default::default() }
    }

    /// Its image points about `centre`, as a device has them.
    pub fn rows_about(&self, centre: [f64; 2]) -> [[f32; 4]; 9] {
        rows_about(&self.points, centre)
    }

    /// Half planes about a tile's centre whose intersection is its shadow on the plane of `receiver`.
    pub fn lines(&self, lamp: &ScreenLamp, receiver: &Line, view: &TileView, u: f64) -> [Line; 5] {
        let corners = self.corners(u).map(|h| view.point(h.x, h.y, h.z));
        let (place, weight) = lamp.at(u);
        let planes = half_spaces(&corners, (view.point(place.x, place.y, place.z), weight));
        // From a lamp in its own plane a facet throws none.
        let nowhere = [Line { a: 0.0, b: 0.0, c: -1.0 }; 5];
        planes.map_or(nowhere, |planes| planes.map(|(normal, through)| on_plane(normal, through, receiver)))
    }

    /// Its homogeneous image points.
    #[inline(always)]
    fn corners(&self, u: f64) -> [DVec3; 4] {
        let [p, q, r] = &self.points;
        std::array::from_fn(|k| {
            DVec3::from_array([0, 1, 2].map(|axis| p[axis][k] + u * (q[axis][k] + u * r[axis][k])))
        })
    }

    /// Its walls for `lamp` over the part `span` of the block; `None` where the lamp lies in its plane at one of the three times.
    fn new_walls(&self, lamp: &ScreenLamp, span: [f64; 2]) -> Option<Walls> {
        let [a, b, c] = times_of(span).map(|u| half_spaces(&self.corners(u), lamp.at(u)));
        let (a, b, c) = (a?, b?, c?);
        Some(std::array::from_fn(|i| [a[i], b[i], c[i]]))
    }

    /// Whether all of it lies in or beyond the receiver's plane, seen from the lamp, at every time between the three of `span`: as
    /// neighbours on a convex surface do. It throws no shadow there.
    fn lies_beyond(&self, lamp: &ScreenLamp, receiver: &Receiver, span: [f64; 2]) -> bool {
        let mut heights = [[0.0; 4]; 3];
        let mut sides = 0.0;
        for ((heights, plane), u) in heights.iter_mut().zip(&receiver.planes).zip(times_of(span)) {
            // A point (x, y, 1) / q has the height q(x, y) / q - 1 over the plane of inverse depth q(x, y).
            let (place, w) = lamp.at(u);
            let side = (plane.dot(place) - w).signum();
            sides += side;
            *heights = self.corners(u).map(|corner| side * (plane.dot(corner) - 1.0));
        }
        let [a, b, c] = heights;
        f64::abs(sides) == 3.0
            && (0..4).all(|k| a[k].max(b[k]).max(c[k]) + (a[k] - 2.0 * b[k] + c[k]).abs() < TOUCHING)
    }

    /// Where it throws the shadow of lamp `number` in the world, made by `new` when it is first needed in a block; `None` where that
    /// is not known.
    pub fn dark_space(&self, number: usize, new: impl FnOnce() -> Option<DarkSpace>) -> Option<&DarkSpace> {
        self.spaces[number].get_or_init(|| new().map(Box::new)).as_deref()
    }
}

/// Part of the side of a pixel by which it is grown, beside how much a half plane bends, for what lies between the
/// times at which half planes are looked up.
const MARGIN: f64 = 0.2;

impl Occluder {
    /// Where in a tile, whose side is the unit of `view`, its shadow from `lamp`, number `number` of those that are kept apart, may come
    /// on the plane of `receiver` during the part `span` of the block, among the pixels `seen`; where `receiver` is not known, that
    /// may be anywhere. Beyond edges with bits in `inner` another facet's shadow goes on.
    pub fn pixels(
        &self,
        (number, lamp): (usize, &ScreenLamp),
        (receiver, span): (Option<&Receiver>, [f64; 2]),
        view: &TileView,
        (seen, inner): (u64, u8),
    ) -> Reach {
        let everywhere = Reach { touches: seen, border: seen, motion_px: TILE as f64, ..Reach::default() };
        let nowhere = Reach::default();
        let tile = TILE as f64;
        let Some(receiver) = receiver else { return everywhere };
        if self.lies_beyond(lamp, receiver, span) {
            return nowhere;
        }
        let of_span;
        let walls = if span == [0.0, 1.0] {
            self.walls[number].get_or_init(|| self.new_walls(lamp, span).map(Box::new)).as_deref()
        } else {
            of_span = self.new_walls(lamp, span);
            of_span.as_ref()
        };
        let Some(walls) = walls else { return everywhere };
        // Most miss the tile as a whole, and most edges of the others do not cross it.
        let mut over_time = [[Line::default(); 3]; 5];
        let mut crossing = [false; 5];
        for ((planes, at), crossing) in walls.iter().zip(&mut over_time).zip(&mut crossing) {
            *at = std::array::from_fn(|k| {
                let (normal, through) = planes[k];
                on_plane(view.line(normal), through, &receiver.lines[k])
            });
            let reach =
                at.iter().map(Line::reach).fold(0.0, f64::max) * (1.0 + (MARGIN + 2.0 * view.margin) / tile);
            let [a, b, c] = [at[0].c, at[1].c, at[2].c];
            // The bend of a line's value anywhere in the tile.
            let bend = |k: [f64; 3]| (k[0] - 2.0 * k[1] + k[2]).abs();
            let slack = reach
                + bend([a, b, c])
                + 0.5 * (bend([at[0].a, at[1].a, at[2].a]) + bend([at[0].b, at[1].b, at[2].b]));
            if a.max(b).max(c) + slack < 0.0 {
                return nowhere;
            }
            *crossing = a.min(b).min(c) < slack && at.iter().any(|l| *l != Line::default());
        }
        let (mut touches, mut darkens, mut inside, mut border) = (seen, seen, seen, 0);
        let mut motion_px = 0.0_f64;
        for (k, at) in over_time.iter().enumerate().filter(|(k, _)| crossing[*k]) {
            let (some, whole, middle) = pixels_of_line(at, view.margin);
            touches &= some;
            darkens &= whole;
            inside &= middle;
            if touches == 0 {
                return nowhere;
            }
            // Line 0 is of the facet's own plane.
            if k == 0 || inner >> (k - 1) & 1 == 0 {
                border |= !whole;
            }
            if !whole != 0 {
                // An edge that comes into the tile.
                let places = at.map(|l| tile * l.c / l.a.hypot(l.b).max(1e-12));
                let moved = (places[1] - places[0]).abs() + (places[2] - places[1]).abs();
                motion_px = motion_px.max(moved.min(2.0 * tile));
            }
        }
        Reach { touches, darkens, inside: inside & touches, border: border & touches, motion_px }
    }
}

/// Pixels of a tile that may lie inside a line at some of three times, those that lie inside it at all of them, and those whose
/// middles do at the first; in
/// units of the tile's side. They lie elsewhere by `margin` pixels at most.
fn pixels_of_line(at: &[Line; 3], margin: f64) -> (u64, u64, u64) {
    let tile = TILE as f64;
    let reach = at.iter().map(Line::reach).fold(0.0, f64::max) * (1.0 + MARGIN + 2.0 * margin) / tile;
    // What rounding to 32 bits may add.
    let reach = (reach * 1.0001) as f32;
    let [p, q, r] = at.map(|l| [l.a / tile, l.b / tile, l.c].map(|v| v as f32));
    let (mut some, mut whole, mut middle) = (0, 0, 0);
    for y in 0..TILE {
        let down = y as f32 + 0.5 - 0.5 * TILE as f32;
        let start = [p, q, r].map(|l| l[2] + l[1] * down);
        for half in 0..2 {
            let across = Vec4::new(-3.5, -2.5, -1.5, -0.5) + 4.0 * half as f32;
            let a = start[0] + p[0] * across;
            let b = start[1] + q[0] * across;
            let c = start[2] + r[0] * across;
            let slack = reach + (a - 2.0 * b + c).abs();
            let most = a.max(b).max(c) + slack;
            let least = a.min(b).min(c) - slack;
            let place = TILE * y + 4 * half;
            some |= u64::from(most.cmpge(Vec4::ZERO).bitmask()) << place;
            whole |= u64::from(least.cmpge(Vec4::ZERO).bitmask()) << place;
            middle |= u64::from(a.cmpge(Vec4::ZERO).bitmask()) << place;
        }
    }
    (some, whole, middle)
}

/// Where in a tile a shadow may come.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reach {
    /// Pixels into which it may come.
    pub touches: u64,
    /// Pixels that it darkens throughout.
    pub darkens: u64,
    /// Those of which it holds the middle at first.
    pub inside: u64,
    /// Those into which an edge of it may come beyond which no other one goes on.
    pub border: u64,
    /// How far its edges move meanwhile, at most twice the tile's side.
    pub motion_px: f64,
}

/// Where a facet throws a lamp's shadow in the world, at the start, middle and end of a block.
#[derive(Clone, Copy, Debug)]
pub struct DarkSpace {
    /// Unit normals inwards, and where along these the wall is; of a triangle's repeated corner a wall of nothing, which has none.
    walls: [[(DVec3, f64); 3]; 5],
}

impl DarkSpace {
    /// From the facet's corners at the three times, and where the lamp is (the direction to it where `weight` is 0); `None` where the
    /// lamp comes into the facet's plane, or changes its side.
    pub fn new(occluder: &[[DVec3; 4]; 3], lamp: &[DVec3; 3], weight: f64) -> Option<Self> {
        let own: [DVec3; 3] = [0, 1, 2].map(|k| {
            let [a, b, _, d] = occluder[k];
            (b - a).cross(d - a)
        });
        let heights = [0, 1, 2].map(|k| own[k].dot(lamp[k] - occluder[k][0] * weight));
        let side = -heights[0].signum();
        if heights.iter().any(|h| h * side >= 0.0) {
            return None;
        }
        let through = |normals: [DVec3; 3], corner: usize| {
            let of = |k: usize| {
                let normal = normals[k].normalize_or_zero();
                (normal, normal.dot(occluder[k][corner]))
            };
            [0, 1, 2].map(of)
        };
        let mut walls = [through(own.map(|normal| normal * side), 0); 5];
        for corner in 0..4 {
            let normals = [0, 1, 2].map(|k| {
                let (a, b) = (occluder[k][corner], occluder[k][(corner + 1) % 4]);
                // Inwards, since the occluder's own normal points beyond it.
                (lamp[k] - a * weight).cross(a - b) * side
            });
            walls[corner + 1] = through(normals, corner);
        }
        Some(Self { walls })
    }

    /// Whether it misses a polygon throughout the block; corners in the world at the same times. What only touches is missed. Most
    /// miss by one of the first walls.
    pub fn misses(&self, receiver: &[[DVec3; 4]; 3]) -> bool {
        self.walls.iter().filter(|wall| wall[0].0 != DVec3::ZERO).any(|wall| {
            let heights: [[f64; 4]; 3] = std::array::from_fn(|k| {
                let (normal, through) = wall[k];
                receiver[k].map(|place| normal.dot(place) - through)
            });
            let [a, b, c] = heights;
            (0..4).all(|k| {
                let touching = TOUCHING * (1.0 + receiver[0][k].abs().max_element());
                a[k].max(b[k]).max(c[k]) + (a[k] - 2.0 * b[k] + c[k]).abs() < touching
            })
        })
    }
}

/// Half planes of a shadow that cross a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Shadow {
    lines: [Line; 5],
    count: usize,
}

impl Shadow {
    /// What of a shadow bounded by `lines` crosses a pixel; `None` where it does not reach it.
    #[inline(always)]
    pub fn at(lines: &[Line; 5], frame: &PixelFrame) -> Option<Self> {
        let mut shadow = Self::default();
        for line in lines {
            if !shadow.add(line.in_pixel(frame)) {
                return None;
            }
        }
        Some(shadow)
    }

    /// Adds a half plane; false where it keeps the shadow out.
    #[inline(always)]
    fn add(&mut self, line: Line) -> bool {
        let reach = line.reach();
        // A degenerate edge, of a triangle's repeated corner.
        if line.c == 0.0 && reach == 0.0 {
            return true;
        }
        if line.c < -reach {
            return false;
        }
        if line.c < reach {
            self.lines[self.count] = line;
            self.count += 1;
        }
        true
    }

    /// Half planes.
    pub fn lines(&self) -> &[Line] {
        &self.lines[..self.count]
    }
}

/// A lamp as the screen has it.
#[derive(Clone, Copy, Debug)]
pub struct ScreenLamp {
    powers: [DVec3; 3],
    /// Of a pinhole 1 for a place, 0 for a direction. In the space of parallel rays directions are places, and weights are what
    /// the projective map makes of them.
    weights: [f64; 3],
}

impl ScreenLamp {
    /// From homogeneous image points and their weights at the start, middle and end of a block.
    pub fn new(h: [(DVec3, f64); 3]) -> Self {
        Self { powers: powers(h.map(|(place, _)| place)), weights: powers(h.map(|(_, weight)| weight)) }
    }

    /// Its image point about `centre` and its weight, by power of time, as a device has them.
    pub fn rows_about(&self, centre: [f64; 2]) -> [[f32; 4]; 3] {
        std::array::from_fn(|power| {
            let h = self.powers[power];
            let about = [h.x - centre[0] * h.z, h.y - centre[1] * h.z, h.z, self.weights[power]];
            about.map(|v| v as f32)
        })
    }

    #[inline(always)]
    fn at(&self, u: f64) -> (DVec3, f64) {
        let [p, q, r] = &self.powers;
        let [a, b, c] = self.weights;
        (*p + (*q + *r * u) * u, a + (b + c * u) * u)
    }
}

/// Room for the work on one pixel.
#[derive(Default)]
pub struct Lit {
    shadows: Vec<Shadow>,
    lit: Polygons,
    rest: Polygons,
    cutter: Cutter,
}

/// What no shadow reaches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reached {
    /// Part of the area.
    pub part: f64,
    /// Where that is, if shadows are cut out of the area and leave some of it.
    pub lit: Option<Moments>,
}

impl Reached {
    const ALL: Self = Self { part: 1.0, lit: None };
    const NOTHING: Self = Self { part: 0.0, lit: None };
}

impl Lit {
    /// What of a fragment's part of a pixel (all of it where `regions` is `None`) no shadow reaches; `shadows` are their half
    /// planes.
    pub fn part<'o>(
        &mut self,
        regions: Option<(&Polygons, u32)>,
        shadows: impl Iterator<Item = &'o [Line; 5]>,
        frame: &PixelFrame,
    ) -> Reached {
        self.shadows.clear();
        for lines in shadows {
            if let Some(shadow) = Shadow::at(lines, frame) {
                if shadow.count == 0 {
                    return Reached::NOTHING;
                }
                self.shadows.push(shadow);
            }
        }
        if self.shadows.is_empty() {
            return Reached::ALL;
        }
        if self.shadows.len() > FEW {
            return Reached { part: self.counted(regions), lit: None };
        }
        self.lit.clear();
        let whole = match regions {
            None => {
                self.lit.push(0, &PIXEL);
                1.0
            }
            Some((regions, own)) => {
                for (_, polygon) in regions.iter().filter(|r| r.0 == own) {
                    self.lit.push(0, polygon);
                }
                self.lit.iter().map(|p| area(p.1)).sum::<f64>()
            }
        };
        for shadow in &self.shadows {
            self.rest.clear();
            for (_, polygon) in self.lit.iter() {
                // What is inside all of them is dark.
                self.cutter.cut(polygon, shadow.lines(), (0, &mut self.rest));
            }
            std::mem::swap(&mut self.lit, &mut self.rest);
            if self.lit.is_empty() {
                return Reached::NOTHING;
            }
        }
        let mut lit = Moments::default();
        for (_, polygon) in self.lit.iter() {
            lit.add(&moments(polygon));
        }
        let part = (lit.area / whole.max(1e-12)).clamp(0.0, 1.0);
        Reached { part, lit: (part < 1.0).then_some(lit) }
    }

    /// The same by samples.
    fn counted(&self, regions: Option<(&Polygons, u32)>) -> f64 {
        let own = regions.map_or(u64::MAX, |(regions, own)| {
            let of = |corners: &Corners| mask::of_polygon(corners);
            regions.iter().filter(|r| r.0 == own).fold(0, |m, r| m | of(r.1))
        });
        let dark = |shadow: &Shadow| shadow.lines().iter().fold(u64::MAX, |m, line| m & mask::of_line(line));
        let lit = self.shadows.iter().fold(own, |m, shadow| m & !dark(shadow));
        if own == 0 {
            // A sliver between samples: as its pixel.
            let lit = self.shadows.iter().fold(u64::MAX, |m, shadow| m & !dark(shadow));
            return f64::from(lit.count_ones()) / mask::SAMPLES as f64;
        }
        f64::from(lit.count_ones()) / f64::from(own.count_ones())
    }
}

/// A cone from a lamp about a sphere, or the cylinder of a directional lamp: what reaches into it may throw a shadow on
/// what is in the sphere.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    apex: DVec3,
    axis: DVec3,
    sin: f64,
    cos: f64,
    /// Of a cylinder.
    radius: f64,
    /// Distance from the apex beyond which nothing matters.
    end: f64,
}

impl Beam {
    /// From a lamp at `place` (a direction to it where `weight` is 0) about the sphere; `None` from within.
    pub fn new(place: DVec3, weight: f64, centre: DVec3, radius: f64) -> Option<Self> {
        if weight == 0.0 {
            let axis = -place.normalize_or(DVec3::Y);
            return Some(Self { apex: centre, axis, sin: 0.0, cos: 1.0, radius, end: radius });
        }
        let offset = centre - place;
        let distance = offset.length();
        let sin = radius / distance;
        let axis = offset / distance;
        (sin < 0.99).then(|| Self {
            apex: place,
            axis,
            sin,
            cos: (1.0 - sin * sin).sqrt(),
            radius: 0.0,
            end: distance + radius,
        })
    }

    /// Whether a sphere reaches into it.
    pub fn meets(&self, centre: DVec3, radius: f64) -> bool {
        let v = centre - self.apex;
        let along = v.dot(self.axis);
        let across = (v - self.axis * along).length();
        along - radius <= self.end
            && (self.sin == 0.0 || along >= -radius)
            && across * self.cos - along * self.sin <= radius + self.radius
    }
}

/// Flat walls about a part of space.
#[derive(Clone, Copy, Debug)]
pub struct Hull {
    /// Unit normals inwards, and offsets; a wall of nothing where an edge has no length.
    walls: [(DVec3, f64); 5],
    /// What lies behind the first wall by less than this touches it.
    contact: f64,
}

/// What rounding may do to a wall, as a part of one and its offset.
const WALL_SLACK: f64 = 1e-7;

impl Hull {
    /// Between a lamp at `place` (a direction to it where `weight` is 0) and the cell with these corners: what lies outside
    /// throws no shadow on the cell.
    pub fn before(cell: [DVec3; 4], place: DVec3, weight: f64) -> Self {
        let (mut planes, height) = volume(cell, place, weight);
        planes[0] = (-planes[0].0, -planes[0].1);
        Self::of(planes, height)
    }

    /// Beyond a polygon, seen from the lamp: what lies outside is not darkened by it.
    pub fn beyond(polygon: [DVec3; 4], place: DVec3, weight: f64) -> Self {
        let (planes, height) = volume(polygon, place, weight);
        Self::of(planes, height)
    }

    fn of(planes: [(DVec3, f64); 5], height: f64) -> Self {
        // Seen from a lamp in its own plane, nothing is known.
        if height == 0.0 {
            return Self { walls: [(DVec3::ZERO, 0.0); 5], contact: 0.0 };
        }
        let contact = CONTACT * height.abs() / planes[0].0.length();
        let walls = planes.map(|(normal, through)| {
            let length = normal.length();
            let through = through / length;
            // Rounding moves a wall outwards.
            if length > 0.0 {
                (normal / length, through - WALL_SLACK * (1.0 + through.abs()))
            } else {
                (normal, 0.0)
            }
        });
        Self { walls, contact }
    }

    /// Whether a polygon may reach into it.
    pub fn meets(&self, corners: &[DVec3; 4]) -> bool {
        self.walls.iter().all(|(n, t)| corners.iter().any(|c| n.dot(*c) >= *t))
    }

    /// Whether a convex polygon surely lies in it.
    pub fn holds(&self, corners: &[DVec3; 4]) -> bool {
        let within = |(n, t): &(DVec3, f64)| {
            let least = t + self.contact + 3.0 * WALL_SLACK * (1.0 + t.abs());
            *n == DVec3::ZERO || corners.iter().all(|c| n.dot(*c) > least)
        };
        self.walls[0].0 != DVec3::ZERO && self.walls.iter().all(within)
    }

    /// Whether a sphere may.
    pub fn meets_sphere(&self, centre: DVec3, radius: f64) -> bool {
        self.walls.iter().all(|(n, t)| n.dot(centre) + radius >= *t)
    }
}

/// Half spaces of what a polygon hides from a lamp, the one beyond its plane first, and how far the lamp is before that;
/// inside is not below the second.
fn volume(p: [DVec3; 4], place: DVec3, weight: f64) -> ([(DVec3, f64); 5], f64) {
    let normal = (p[1] - p[0]).cross(p[3] - p[0]);
    let height = normal.dot(place) - weight * normal.dot(p[0]);
    let side = -height.signum();
    let mut planes = [(normal * side, normal.dot(p[0]) * side); 5];
    let middle = (p[0] + p[1] + p[2] + p[3]) * 0.25;
    for k in 0..4 {
        let (a, b) = (p[k], p[(k + 1) % 4]);
        let normal = a.cross(b) * weight + place.cross(a - b);
        let through = normal.dot(a);
        let sign = (normal.dot(middle) - through).signum();
        planes[k + 1] = (normal * sign, through * sign);
    }
    (planes, height)
}

/// Nodes from a tree's root to a leaf at most, and one.
const MOST_DEPTH: usize = 33;

/// A tree over spheres.
#[derive(Default)]
pub struct Tree {
    /// Box centre and radius; of leaves, the items.
    nodes: Vec<Node>,
    items: Vec<(DVec3, f64, u32)>,
}

struct Node {
    centre: DVec3,
    radius: f64,
    start: u32,
    /// Items of a leaf; 0 for an inner node, whose left child is next and whose right one is `start`.
    count: u32,
}

impl Tree {
    /// Over items of (centre, radius, id).
    pub fn new(items: impl Iterator<Item = (DVec3, f64, u32)>) -> Self {
        let mut items: Vec<_> = items.filter(|(c, r, _)| c.is_finite() && r.is_finite()).collect();
        let mut tree = Self::default();
        if !items.is_empty() {
            let count = items.len();
            tree.build(&mut items, 0, count);
        }
        tree.items = items;
        tree
    }

    fn build(&mut self, items: &mut [(DVec3, f64, u32)], from: usize, to: usize) {
        let own = &mut items[from..to];
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for (c, r, _) in own.iter() {
            low = low.min(*c - *r);
            high = high.max(*c + *r);
        }
        let centre = 0.5 * (low + high);
        let radius = own.iter().map(|(c, r, _)| c.distance(centre) + r).fold(0.0, f64::max);
        let index = self.nodes.len();
        self.nodes.push(Node { centre, radius, start: from as u32, count: own.len() as u32 });
        if own.len() <= 4 {
            return;
        }
        let size = high - low;
        let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
        let middle = own.len() / 2;
        own.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.2.cmp(&b.2)));
        self.nodes[index].count = 0;
        self.build(items, from, from + middle);
        self.nodes[index].start = self.nodes.len() as u32;
        self.build(items, from + middle, to);
    }

    /// A sphere that holds all of it, unless it is empty.
    pub fn whole(&self) -> Option<(DVec3, f64)> {
        self.nodes.first().map(|node| (node.centre, node.radius))
    }

    /// Calls `visit` with every item.
    pub fn all(&self, mut visit: impl FnMut(u32)) {
        self.items.iter().for_each(|(.., id)| visit(*id));
    }

    /// Whether it has no items.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// Calls `visit` with each item that `meets`, which holds for every sphere around one for which it holds.
    pub fn within(&self, meets: impl Fn(DVec3, f64) -> bool, mut visit: impl FnMut(u32)) {
        self.any(meets, |id| {
            visit(id);
            false
        });
    }

    /// Whether any item that `meets` is `wanted`: those that follow it are left out.
    pub fn any(&self, meets: impl Fn(DVec3, f64) -> bool, mut wanted: impl FnMut(u32) -> bool) -> bool {
        // Halves of halves: as many as a number has bits.
        let (mut stack, mut count) = ([0_u32; MOST_DEPTH], 1);
        while count > 0 {
            count -= 1;
            let index = stack[count];
            let Some(node) = self.nodes.get(index as usize) else { return false };
            if !meets(node.centre, node.radius) {
                continue;
            }
            if node.count > 0 {
                let from = node.start as usize;
                for (centre, radius, id) in &self.items[from..from + node.count as usize] {
                    if meets(*centre, *radius) && wanted(*id) {
                        return true;
                    }
                }
            } else {
                stack[count] = node.start;
                stack[count + 1] = index + 1;
                count += 2;
            }
        }
        false
    }
}
