//! Facets as a pixel sees them: edges and inverse depth, linear on the pixel.
//!
//! Coordinates are pixels from the pixel's centre. A facet is where its edge functions e = h_k x h_(k+1) are not
//! negative, and its inverse depth is linear there. Shared edges are exact negatives of each other, so facets neither
//! overlap nor leave gaps.

use std::cmp::Ordering;

use glam::{DMat3, DVec3, Vec4};

use crate::scene::screen::Depths;
use crate::scene::tiles::{PixelFrame, TILE, TileView};
use crate::visibility::lists::Record;

/// A linear function a x + b y + c on the pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Line {
    /// Change to the right.
    pub a: f64,
    /// Change down.
    pub b: f64,
    /// Value at the centre.
    pub c: f64,
}

impl Line {
    fn new(v: DVec3) -> Self {
        Self { a: v.x, b: v.y, c: v.z }
    }

    /// Value at (x, y).
    #[inline(always)]
    pub fn at(&self, [x, y]: [f64; 2]) -> f64 {
        self.a * x + self.b * y + self.c
    }

    /// Greatest distance of its values on the pixel from that at the centre.
    #[inline(always)]
    pub fn reach(&self) -> f64 {
        0.5 * (self.a.abs() + self.b.abs())
    }

    /// The difference.
    #[inline(always)]
    pub fn minus(self, o: Self) -> Self {
        Self { a: self.a - o.a, b: self.b - o.b, c: self.c - o.c }
    }
}

/// A facet at a time, as a pixel sees it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fragment {
    /// Index into [`crate::visibility::lists::Lists::records`].
    pub record: u32,
    /// Its facet: of equal depths the lowest is seen.
    pub facet: u32,
    /// The camera sees its outside.
    pub front: bool,
    /// Edges that cross the pixel, inside not negative.
    pub edges: [Line; 6],
    /// Which of the facet's these are; [`PLANE`] of a plane before or behind which nothing is seen.
    pub names: [u8; 6],
    /// How many of them.
    pub edge_count: usize,
    /// 1/depth.
    pub inverse_depth: Line,
}

/// The name of an edge where a plane before or behind which nothing is seen cuts a facet.
pub const PLANE: u8 = 4;

impl Fragment {
    fn add(&mut self, edge: Line, name: u8) {
        self.edges[self.edge_count] = edge;
        self.names[self.edge_count] = name;
        self.edge_count += 1;
    }

    /// Edges that cross the pixel.
    #[inline(always)]
    pub fn crossing(&self) -> &[Line] {
        &self.edges[..self.edge_count]
    }

    /// By depth at the pixel's centre, the nearest first; of equal depths the lowest facet.
    pub fn by_depth(&self, other: &Self) -> Ordering {
        other.inverse_depth.c.total_cmp(&self.inverse_depth.c).then(self.facet.cmp(&other.facet))
    }

    /// Where this is before `other`: a function that is not negative there, and 1 or -1 where that is all of the pixel
    /// or nothing of it, else 0.
    #[inline(always)]
    pub fn before(&self, other: &Self) -> (Line, i32) {
        let d = self.inverse_depth.minus(other.inverse_depth);
        let reach = d.reach();
        // What is left of a difference between equal planes is rounding.
        let noise = 1e-10 * (self.inverse_depth.c.abs() + self.inverse_depth.reach());
        if d.c.abs() + reach < noise {
            return (d, if self.facet < other.facet { 1 } else { -1 });
        }
        let side = if d.c >= reach {
            1
        } else if d.c <= -reach {
            -1
        } else {
            0
        };
        (d, side)
    }
}

/// A facet at a time as a tile sees it: shared by the tile's pixels, for each of which [`Sight::at`] is a [`Fragment`].
///
/// Coordinates are pixels from the tile's centre.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Index into [`crate::scene::world::World::facets`].
    pub facet: u32,
    /// The camera sees its outside.
    pub front: bool,
    /// Edges, inside not negative: change to the right, down, value at the centre, reach over a pixel.
    a: [f64; 4],
    b: [f64; 4],
    c: [f64; 4],
    reach: [f64; 4],
    /// 1/depth.
    pub inverse_depth: Line,
    /// Numerators of s and t over [`Sight::weight`].
    place: [Line; 2],
    /// What s and t are divided by: 1/depth, and 1 where rays are parallel.
    pub weight: Line,
    /// What is nearer than the near plane lies outside of the first, what is farther than the far plane outside of the second.
    planes: [Option<Line>; 2],
    /// See [`TileView::margin`].
    margin: f64,
}

impl Line {
    /// The same function, with (`x`, `y`) as the origin.
    #[inline(always)]
    pub fn moved(&self, x: f64, y: f64) -> Self {
        Self { a: self.a, b: self.b, c: self.c + (self.a * x + self.b * y) }
    }

    /// The same function in a pixel's own coordinates.
    #[inline(always)]
    pub fn in_pixel(&self, frame: &PixelFrame) -> Self {
        let [x, y] = frame.middle;
        let moved = self.moved(x, y);
        match &frame.axes {
            None => moved,
            Some(axes) => {
                let [a, b] = axes.map(|[x, y]| self.a * x + self.b * y);
                Self { a, b, ..moved }
            }
        }
    }
}

/// Pixels of a tile, row by row from bit 0, in which a line about the tile's centre is above -`reach` anywhere and above
/// `reach` everywhere, `reach` being its change from a pixel's centre to a corner: no pixel lacks in the first, and none is
/// wrong in the second.
#[inline(always)]
fn pixels_above(line: &Line, reach: f64, margin: f64) -> (u64, u64) {
    // Where pixels lie elsewhere, and what rounding to 32 bits may do.
    let bent = margin * (line.a.abs() + line.b.abs());
    let slack = bent + 1e-6 * (line.c.abs() + TILE as f64 * (line.a.abs() + line.b.abs()));
    let [a, b, c, least, most] = [line.a, line.b, line.c, -(reach + slack), reach + slack].map(|v| v as f32);
    let (mut some, mut whole) = (0, 0);
    let across = [Vec4::new(-3.5, -2.5, -1.5, -0.5), Vec4::new(0.5, 1.5, 2.5, 3.5)].map(|x| x * a + c);
    for y in 0..TILE {
        let down = (y as f32 + 0.5 - 0.5 * TILE as f32) * b;
        for (half, across) in across.into_iter().enumerate() {
            let values = across + down;
            let place = TILE * y + 4 * half;
            some |= u64::from(values.cmpge(Vec4::splat(least)).bitmask()) << place;
            whole |= u64::from(values.cmpge(Vec4::splat(most)).bitmask()) << place;
        }
    }
    (some, whole)
}

impl Sight {
    /// Pixels of the tile that this may cover a part of, and pixels that it covers.
    pub fn pixels(&self) -> (u64, u64) {
        let edges = (0..4).map(|k| (Line { a: self.a[k], b: self.b[k], c: self.c[k] }, self.reach[k]));
        let planes = self.planes.iter().flatten().map(|line| (*line, line.reach()));
        let (mut some, mut whole) = (u64::MAX, u64::MAX);
        for (line, reach) in edges.chain(planes) {
            let (own_some, own_whole) = pixels_above(&line, reach, self.margin);
            some &= own_some;
            whole &= own_whole;
            if some == 0 {
                break;
            }
        }
        (some, whole)
    }

    /// Pixels of the tile whose centres this covers for certain.
    pub fn centres(&self) -> u64 {
        let edges = (0..4).map(|k| Line { a: self.a[k], b: self.b[k], c: self.c[k] });
        edges
            .chain(self.planes.into_iter().flatten())
            .fold(u64::MAX, |all, line| all & pixels_above(&line, 0.0, self.margin).1)
    }

    /// Pixels of the tile in all of which this lies before `other`.
    pub fn pixels_before(&self, other: &Self) -> u64 {
        let d = self.inverse_depth.minus(other.inverse_depth);
        let (reach, tile) = (d.reach(), TILE as f64);
        let own = &self.inverse_depth;
        // As of [`Fragment::before`], for all of the tile.
        if d.c.abs() + tile * reach < 1e-10 * (own.c.abs() - tile * own.reach()) {
            return if self.facet < other.facet { u64::MAX } else { 0 };
        }
        pixels_above(&d, reach, self.margin).1
    }

    /// How far, in pixels, the borders move that planes before or behind which nothing is seen cut into `record` in a tile during
    /// its span, at most twice the tile's side. What is cut may move along the rays, and nowhere in the picture.
    pub fn cut_motion(record: &Record, view: &TileView, depths: &Depths) -> f64 {
        if !record.crosses_near && !record.crosses_far {
            return 0.0;
        }
        let tile = TILE as f64;
        let [first, middle, last] = [0.0, 0.5, 1.0].map(|v| Self::new(record, view, v, depths));
        let (Some(first), Some(middle), Some(last)) = (first, middle, last) else { return 2.0 * tile };
        let moved = |plane: usize| {
            // How far the tile's centre lies inside the border; infinitely far where all of the facet has one depth.
            let inside = |sight: &Self| {
                let Line { a, b, c } = sight.planes[plane]?;
                Some((c / a.hypot(b)).clamp(-1e6, 1e6))
            };
            let [Some(a), Some(b), Some(c)] = [&first, &middle, &last].map(inside) else { return 0.0 };
            let comes_near = [a, b, c].into_iter().any(|place| place.abs() < tile);
            let passes = a.signum() != b.signum() || b.signum() != c.signum();
            if comes_near || passes { ((b - a).abs() + (c - b).abs()).min(2.0 * tile) } else { 0.0 }
        };
        moved(0).max(moved(1))
    }

    /// `record` as a tile sees it at `v` of its span; `None` where nobody does.
    pub fn new(record: &Record, view: &TileView, v: f64, depths: &Depths) -> Option<Self> {
        let [p, q, r] = &record.points;
        let mut h = [[0.0; 4]; 3];
        for axis in 0..3 {
            for corner in 0..4 {
                h[axis][corner] = p[axis][corner] + v * (q[axis][corner] + v * r[axis][corner]);
            }
        }
        let point = |k: usize| view.point(h[0][k], h[1][k], h[2][k]);
        let [h0, h1, h2, h3] = [point(0), point(1), point(2), point(3)];
        // Of the triangle of corners 0, 1 and 3, which all but degenerate facets have.
        let (e0, e3, across) = (h0.cross(h1), h3.cross(h0), h1.cross(h3));
        let volume = h0.dot(across);
        let front = (volume < 0.0) != record.mirrored;
        if volume == 0.0 || (!front && !record.double_sided) {
            return None;
        }
        let sign = volume.signum();
        let edges = [e0, h1.cross(h2), h2.cross(h3), e3].map(|e| e * sign);
        let inverse = 1.0 / volume;
        let inverse_depth = Line::new((e0 + e3 + across) * inverse);
        let near = record.crosses_near.then(|| Line::new(view.inverse_of(depths.near)).minus(inverse_depth));
        let far = record.crosses_far.then(|| inverse_depth.minus(Line::new(view.inverse_of(depths.far))));
        let mut place = [Line::new(e3 * inverse), Line::new(e0 * inverse)];
        let mut weight = inverse_depth;
        if depths.far.is_finite() {
            // Of parallel rays (s, t) is linear on the image: image points are (x, y, 1) times depth.
            place = [Line::new(e3 * (inverse * h1.z)), Line::new(e0 * (inverse * h3.z))];
            weight = Line { a: 0.0, b: 0.0, c: 1.0 };
        }
        Some(Self {
            facet: record.facet,
            front,
            a: edges.map(|e| e.x),
            b: edges.map(|e| e.y),
            c: edges.map(|e| e.z),
            reach: edges.map(|e| 0.5 * (e.x.abs() + e.y.abs())),
            inverse_depth,
            place,
            weight,
            planes: [near, far],
            margin: view.margin,
        })
    }

    /// (s, t) of the facet at a point, and their change to the right and down.
    #[inline(always)]
    pub fn parameters(&self, at: [f64; 2]) -> ([f64; 2], [[f64; 2]; 2]) {
        let w = &self.weight;
        let depth = 1.0 / w.at(at);
        let value = self.place.map(|n| n.at(at) * depth);
        let right = [0, 1].map(|k| (self.place[k].a - value[k] * w.a) * depth);
        let down = [0, 1].map(|k| (self.place[k].b - value[k] * w.b) * depth);
        (value, [right, down])
    }

    /// (s, t) at a point.
    #[inline(always)]
    pub fn place(&self, at: [f64; 2]) -> [f64; 2] {
        let depth = 1.0 / self.weight.at(at);
        self.place.map(|n| n.at(at) * depth)
    }

    /// From image points to (s, t, 1) over depth, or not divided where rays are parallel.
    pub fn facet_from_image(&self) -> DMat3 {
        let [s, t] = &self.place;
        let w = &self.weight;
        DMat3::from_cols_array(&[s.a, t.a, w.a, s.b, t.b, w.b, s.c, t.c, w.c])
    }

    /// As a pixel sees it, in that pixel's own coordinates; `None` where it does not. `covers` says that it is known to fill
    /// the pixel.
    pub fn at(&self, record: u32, frame: &PixelFrame, covers: bool) -> Option<Fragment> {
        let mut fragment = Fragment::default();
        self.fill(&mut fragment, record, frame, covers).then_some(fragment)
    }

    /// The same, into `fragment`; false where the pixel does not see it.
    #[inline(always)]
    pub fn fill(&self, fragment: &mut Fragment, record: u32, frame: &PixelFrame, covers: bool) -> bool {
        (fragment.record, fragment.facet, fragment.front) = (record, self.facet, self.front);
        fragment.edge_count = 0;
        fragment.inverse_depth = self.inverse_depth.in_pixel(frame);
        if covers {
            return true;
        }
        let edge = |k: usize| Line { a: self.a[k], b: self.b[k], c: self.c[k] };
        let lines: [Line; 4] = std::array::from_fn(|k| edge(k).in_pixel(frame));
        let reaches = if frame.axes.is_none() { self.reach } else { lines.map(|line| line.reach()) };
        let (mut outside, mut crossing) = (false, false);
        for (line, reach) in lines.iter().zip(&reaches) {
            outside |= line.c < -reach;
            crossing |= line.c < *reach;
        }
        if outside {
            return false;
        }
        if crossing {
            for (name, (line, _)) in (0..).zip(lines.iter().zip(&reaches)).filter(|(_, (l, r))| l.c < **r) {
                fragment.add(*line, name);
            }
        }
        for line in self.planes.iter().flatten() {
            let line = line.in_pixel(frame);
            let reach = line.reach();
            if line.c < -reach {
                return false;
            }
            if line.c < reach {
                fragment.add(line, PLANE);
            }
        }
        true
    }
}
