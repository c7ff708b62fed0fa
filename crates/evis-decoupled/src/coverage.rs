//! What each fragment covers of a pixel at a time.
//!
//! Among few fragments the pixel's square is cut into convex regions, of exact area; among many, [`crate::mask`] first
//! decides which are seen.

use crate::fragment::{Fragment, Line};
use crate::mask;

/// Most corners of a region.
const MAX_CORNERS: usize = 14;

/// A convex polygon in the pixel.
#[derive(Clone, Copy, Debug)]
pub struct Polygon {
    corners: [[f64; 2]; MAX_CORNERS],
    count: usize,
}

impl Polygon {
    /// The whole pixel.
    pub const PIXEL: Self = {
        let mut corners = [[0.0; 2]; MAX_CORNERS];
        corners[0] = [-0.5, -0.5];
        corners[1] = [0.5, -0.5];
        corners[2] = [0.5, 0.5];
        corners[3] = [-0.5, 0.5];
        Self { corners, count: 4 }
    };

    /// Its corners, clockwise on the screen.
    pub fn corners(&self) -> &[[f64; 2]] {
        &self.corners[..self.count]
    }

    fn empty() -> Self {
        Self { corners: [[0.0; 2]; MAX_CORNERS], count: 0 }
    }

    #[inline(always)]
    fn push(&mut self, p: [f64; 2]) {
        // A pixel cut by more lines than this keeps its area but for the last corner.
        if self.count < MAX_CORNERS {
            self.corners[self.count] = p;
            self.count += 1;
        }
    }

    /// The parts where `line` is not negative and where it is.
    #[inline(always)]
    pub fn split(&self, line: &Line) -> (Self, Self) {
        let (mut some_in, mut some_out) = (false, false);
        for corner in self.corners() {
            let inside = line.at(*corner) >= 0.0;
            some_in |= inside;
            some_out |= !inside;
        }
        match (some_in, some_out) {
            (true, true) => self.cut(line),
            (true, false) => (*self, Self::empty()),
            _ => (Self::empty(), *self),
        }
    }

    fn cut(&self, line: &Line) -> (Self, Self) {
        let (mut inside, mut outside) = (Self::empty(), Self::empty());
        let Some(&last) = self.corners().last() else { return (inside, outside) };
        let (mut a, mut va) = (last, line.at(last));
        for &b in self.corners() {
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
        (inside, outside)
    }

    /// Whether it has an area.
    pub fn is_empty(&self) -> bool {
        self.count < 3
    }

    /// Area and moments.
    #[inline(always)]
    pub fn moments(&self) -> Moments {
        let mut m = Moments::default();
        let Some(&last) = self.corners().last() else { return m };
        let mut a = last;
        for &b in self.corners() {
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

/// What of a pixel one fragment covers, or the background where `fragment` is `None`.
#[derive(Clone, Copy, Debug)]
pub struct Region {
    /// Index into the fragments.
    pub fragment: Option<usize>,
    /// Where.
    pub polygon: Polygon,
}

/// Fragments above which masks first decide which are seen.
pub const FEW: usize = 24;

/// Room for the work on one pixel, kept between pixels.
#[derive(Default)]
pub struct Regions {
    /// Regions; they tile the pixel.
    pub regions: Vec<Region>,
    order: Vec<usize>,
    before: Vec<Region>,
    uncovered: Vec<Polygon>,
    rest: Vec<Polygon>,
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
        self.uncovered.push(Polygon::PIXEL);
        for k in 0..self.order.len() {
            self.insert(fragments, self.order[k], k);
        }
        for polygon in self.uncovered.drain(..) {
            self.regions.push(Region { fragment: None, polygon });
        }
    }

    fn insert(&mut self, fragments: &[Fragment], index: usize, earlier: usize) {
        let fragment = &fragments[index];
        // What is already covered, but perhaps by something behind this.
        let behind = |other: &usize| fragment.before(&fragments[*other]).1 >= 0;
        if self.order[..earlier].iter().any(behind) {
            self.before.clear();
            self.before.append(&mut self.regions);
            for k in 0..self.before.len() {
                let region = self.before[k];
                let Some(owner) = region.fragment else { continue };
                let (line, side) = fragment.before(&fragments[owner]);
                if side < 0 {
                    self.regions.push(region);
                    continue;
                }
                let mut inside = region.polygon;
                for edge in fragment.crossing() {
                    let (kept, cut) = inside.split(edge);
                    if !cut.is_empty() {
                        self.regions.push(Region { polygon: cut, ..region });
                    }
                    inside = kept;
                }
                if side == 0 {
                    let (kept, cut) = inside.split(&line);
                    if !cut.is_empty() {
                        self.regions.push(Region { polygon: cut, ..region });
                    }
                    inside = kept;
                }
                if !inside.is_empty() {
                    self.regions.push(Region { fragment: Some(index), polygon: inside });
                }
            }
        }
        self.rest.clear();
        for k in 0..self.uncovered.len() {
            let mut inside = self.uncovered[k];
            for edge in fragment.crossing() {
                let (kept, cut) = inside.split(edge);
                if !cut.is_empty() {
                    self.rest.push(cut);
                }
                inside = kept;
            }
            if !inside.is_empty() {
                self.regions.push(Region { fragment: Some(index), polygon: inside });
            }
        }
        std::mem::swap(&mut self.uncovered, &mut self.rest);
    }
}
