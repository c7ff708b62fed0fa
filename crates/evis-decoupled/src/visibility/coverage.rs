//! What each fragment covers of a pixel at a time.
//!
//! Among few fragments the pixel's square is cut into convex regions, of exact area; among many, [`crate::visibility::mask`] first
//! decides which are seen.

use crate::visibility::fragment::{Fragment, Line};
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

    /// Centroid, and second moments xx, xy and yy about it over the area.
    #[inline(always)]
    pub fn central(&self) -> ([f64; 2], [f64; 3]) {
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

/// Fragments above which masks first decide which are seen.
pub const FEW: usize = 24;
/// Owner of what no fragment covers.
pub const NOBODY: u32 = u32::MAX;

/// Room for the work on one pixel, kept between pixels.
#[derive(Default)]
pub struct Regions {
    /// Convex regions, which tile the pixel; their owners are the fragments' numbers, or [`NOBODY`].
    pub regions: Polygons,
    order: Vec<usize>,
    before: Polygons,
    uncovered: Polygons,
    rest: Polygons,
    cutter: Cutter,
}

impl Regions {
    /// Cuts the pixel into what each of `fragments` covers.
    pub fn cut(&mut self, fragments: &[Fragment]) {
        self.order.clear();
        if fragments.len() > FEW {
            let seen = mask::seen(fragments);
            self.order.extend((0..fragments.len()).filter(|i| seen[*i]));
        } else {
            self.order.extend(0..fragments.len());
        }
        self.order.sort_by(|a, b| {
            let (a, b) = (&fragments[*a], &fragments[*b]);
            b.inverse_depth.c.total_cmp(&a.inverse_depth.c).then(a.facet.cmp(&b.facet))
        });
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
