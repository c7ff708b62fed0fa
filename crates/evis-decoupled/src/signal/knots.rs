//! A tile's light during a block, for sensors with more stages than thresholds: a pixel's state changes without an event
//! then, so that all of its light counts, and not only where a threshold may be crossed.
//!
//! The pixels of a tile share their times. A block is cut into the intervals that the fastest of them asks for; each moving
//! pixel is evaluated at their ends, its knots, and light runs along cubics between them. A cubic that misses a pixel's light
//! in the middle of two knots gives way to evaluations there. What comes out is straight between parts of intervals.

use crate::scene::tiles::PIXELS;
use crate::signal::path::{INSTANT_US, stride};
use crate::signal::pixel::{Evaluator, PixelActivity, UNITS, Work};
use crate::visibility::blocks::Block;
use crate::visibility::lists::Entry;

/// Parts of an interval between two knots in which light counts as straight.
pub const PARTS: u32 = 4;
/// A cubic that is off by this part of the light in the middle of two knots gives way to evaluations.
pub const TOLERANCE: f64 = 0.002;

/// A luminance per pixel of a tile; NaN of those outside the picture.
pub(crate) type TileLuminance = [f64; PIXELS];

/// A tile's light during a block: straight between times that are equally far apart.
pub(crate) struct TileSignal {
    /// At the block's start: after a jump, where there is one.
    pub first: TileLuminance,
    /// At the ends of equal parts of the block, one after another.
    pub parts: Vec<TileLuminance>,
    /// Evaluations that it took.
    pub evaluations: u64,
}

/// When the pixels of a tile are evaluated during a block, but for where a cubic misses their light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Knots {
    /// Units of the block from one to the next.
    pub stride: u32,
    /// Intervals between them.
    count: usize,
    /// Parts of an interval in which light counts as straight.
    parts: u32,
}

impl Knots {
    /// Those of pixels in which `activities` take place; what they see moves by at most `step_px` between two.
    pub fn new(block: Block, step_px: f64, activities: &[Option<PixelActivity>; PIXELS]) -> Self {
        let strides = activities.iter().flatten().map(|a| stride(block, step_px, a));
        // Of a cut, nothing but its end is seen.
        let stride = strides.filter(|s| *s > 0).min().unwrap_or(UNITS);
        let moves = activities.iter().flatten().any(|a| !a.still);
        let is_cut = block.length_us() <= INSTANT_US;
        let parts = if is_cut || !moves { 1 } else { parts_of(stride) };
        Self { stride, count: (UNITS / stride) as usize, parts }
    }

    /// Those of pixels of which nothing changes.
    pub fn resting(block: Block) -> Self {
        Self::new(block, f64::INFINITY, &[None; PIXELS])
    }

    /// Times of [`TileSignal::parts`].
    pub fn times(&self) -> usize {
        self.count * self.parts as usize
    }
}

/// Parts of an interval of `stride` units, which begin at whole units.
fn parts_of(stride: u32) -> u32 {
    [PARTS, 2].into_iter().find(|parts| stride.is_multiple_of(*parts)).unwrap_or(1)
}

impl TileSignal {
    /// Light that stays as it is at the start.
    pub fn still(first: TileLuminance, knots: Knots) -> Self {
        Self { first, parts: vec![first; knots.times()], evaluations: 0 }
    }

    /// What the pixels of a tile that begins see at the start of the block of `evaluator`, as a picture of that time has it, and
    /// evaluations that it took.
    pub fn begin(
        (evaluator, work): (&Evaluator, &mut Work),
        (entries, activities): (&[Entry], &[Option<PixelActivity>; PIXELS]),
    ) -> (TileLuminance, u64) {
        let mut first = [f64::NAN; PIXELS];
        let seen = || (0..PIXELS).filter(|pixel| activities[*pixel].is_some());
        seen().for_each(|pixel| evaluator.expect(work, pixel, 1));
        for pixel in seen() {
            evaluator.enter_pixel(work, pixel);
            first[pixel] = evaluator.luminance(work, entries, 0);
        }
        seen().for_each(|pixel| evaluator.expect(work, pixel, 0));
        (first, seen().count() as u64)
    }

    /// Follows those of its pixels that are bits of `only` through the block of `evaluator`; their light may jump at its start.
    /// `activities` are of the pixels that are in the picture, and luminance of `floor` counts as none.
    pub fn follow(
        &mut self,
        (only, jumps): (u64, bool),
        (evaluator, work): (&Evaluator, &mut Work),
        (entries, activities): (&[Entry], &[Option<PixelActivity>; PIXELS]),
        (knots, floor): (Knots, f64),
    ) {
        let own = || (0..PIXELS).filter(|pixel| only >> pixel & 1 == 1);
        let moving = || own().filter(|pixel| activities[*pixel].is_some_and(|a| !a.still));
        moving().for_each(|pixel| evaluator.expect(work, pixel, knots.stride));
        for pixel in own().filter(|pixel| jumps && activities[*pixel].is_some()) {
            evaluator.enter_pixel(work, pixel);
            self.enter(pixel, evaluator.luminance(work, entries, 0));
            self.evaluations += 1;
        }
        for pixel in moving() {
            evaluator.enter_pixel(work, pixel);
            self.follow_pixel(pixel, (knots, floor), |unit| evaluator.luminance(work, entries, unit));
        }
    }

    /// Follows a pixel whose `light` is known at the start, and now at all units.
    fn follow_pixel(
        &mut self,
        pixel: usize,
        (Knots { stride, count, parts }, floor): (Knots, f64),
        mut light: impl FnMut(u32) -> f64,
    ) {
        let mut known = vec![self.first[pixel]; count + 1];
        for (k, knot) in known.iter_mut().enumerate().skip(1) {
            *knot = light(k as u32 * stride);
        }
        self.evaluations += count as u64;
        for k in 0..count {
            let mut at = |part: u32| {
                self.evaluations += 1;
                light(k as u32 * stride + part * stride / parts)
            };
            let own = &mut self.parts[k * parts as usize..(k + 1) * parts as usize];
            let curve = Curve::about(&known, k);
            let mut exact = [false; PARTS as usize];
            if parts == PARTS && curve.error > TOLERANCE * (curve.least() + floor) {
                let middle = at(2);
                own[1][pixel] = middle;
                exact[1] = true;
                if (middle - curve.at(0.5)).abs() > TOLERANCE * (middle + floor) {
                    for part in [1, 3] {
                        own[part as usize - 1][pixel] = at(part);
                        exact[part as usize - 1] = true;
                    }
                }
            }
            for (index, own) in own.iter_mut().enumerate() {
                if !exact[index] {
                    own[pixel] = curve.at((index + 1) as f64 / f64::from(parts));
                }
            }
        }
        // At its end, light is what was evaluated there, without the rounding of a cubic.
        if let Some(last) = self.parts.last_mut() {
            last[pixel] = known[count];
        }
    }

    /// A pixel sees this from the start on.
    fn enter(&mut self, pixel: usize, light: f64) {
        self.first[pixel] = light;
        self.parts.iter_mut().for_each(|part| part[pixel] = light);
    }

    /// What a device has found of a pixel: its light at the start, which is news where it `jumps` there, and, unless that stays, at
    /// the end of each part.
    pub fn take(&mut self, pixel: usize, light: &[f32], jumps: bool) {
        let Some((first, parts)) = light.split_first() else { return };
        if jumps {
            self.enter(pixel, f64::from(*first));
        }
        for (own, light) in self.parts.iter_mut().zip(parts) {
            own[pixel] = f64::from(*light);
        }
    }

    /// Light at the block's end.
    pub fn last(&self) -> &TileLuminance {
        self.parts.last().unwrap_or(&self.first)
    }

    /// Light at `u` in [0, 1] of the block.
    pub fn at(&self, u: f64) -> TileLuminance {
        let place = u.clamp(0.0, 1.0) * self.parts.len() as f64;
        let part = (place as usize).min(self.parts.len() - 1);
        let from = if part > 0 { &self.parts[part - 1] } else { &self.first };
        let (to, within) = (&self.parts[part], place - part as f64);
        std::array::from_fn(|pixel| from[pixel] + within * (to[pixel] - from[pixel]))
    }
}

/// The cubic through four knots, between the second and the third.
struct Curve {
    knots: [f64; 4],
    /// About how far the quadratic through three of them is off in the middle.
    error: f64,
}

impl Curve {
    /// Between `knots` number `k` and the next one; at either end, the quadratic of the three that there are.
    fn about(knots: &[f64], k: usize) -> Self {
        let [a, b] = [knots[k], knots[k + 1]];
        let before = if k > 0 { Some(knots[k - 1]) } else { None };
        let after = knots.get(k + 2).copied();
        let (p, q) = match (before, after) {
            (Some(before), Some(after)) => (before, after),
            (Some(before), None) => (before, 3.0 * b - 3.0 * a + before),
            (None, Some(after)) => (3.0 * a - 3.0 * b + after, after),
            (None, None) => (2.0 * a - b, 2.0 * b - a),
        };
        // Of three knots, how far the line between two is off bounds it.
        let error = match (before, after) {
            (Some(_), Some(_)) => (q - 3.0 * b + 3.0 * a - p).abs() / 16.0,
            (Some(_), None) => (a - 2.0 * b + q).abs() / 8.0,
            (None, Some(_)) => (p - 2.0 * a + b).abs() / 8.0,
            (None, None) => (b - a).abs() / 8.0,
        };
        Self { knots: [p, a, b, q], error }
    }

    fn least(&self) -> f64 {
        self.knots[1].min(self.knots[2]).max(0.0)
    }

    /// Its value at `u` in [0, 1].
    fn at(&self, u: f64) -> f64 {
        let [p, a, b, q] = self.knots;
        let (before, after) = (u + 1.0, u - 2.0);
        let v = u - 1.0;
        -p * u * v * after / 6.0 + a * before * v * after / 2.0 - b * before * u * after / 2.0
            + q * before * u * v / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_straight_between_parts() {
        let at = |value: f64| [value; PIXELS];
        let signal = TileSignal { first: at(1.0), parts: vec![at(2.0), at(6.0)], evaluations: 0 };
        for (u, expected) in [(0.0, 1.0), (0.25, 1.5), (0.5, 2.0), (0.75, 4.0), (1.0, 6.0), (1.1, 6.0)] {
            assert_eq!(signal.at(u), at(expected), "{u}");
        }
    }

    #[test]
    fn a_curve_meets_cubics_and_knows_where_it_does_not() {
        let cubic = |t: f64| 2.0 + 0.3 * t - 0.2 * t * t + 0.05 * t * t * t;
        let knots: Vec<f64> = (0..6).map(|k| cubic(f64::from(k))).collect();
        for k in 1..4 {
            let curve = Curve::about(&knots, k);
            for u in [0.0, 0.25, 0.5, 0.75, 1.0] {
                assert!((curve.at(u) - cubic(k as f64 + u)).abs() < 1e-12);
            }
        }
        // At either end of a block it is a parabola.
        let parabola: Vec<f64> = (0..4).map(|k| 1.0 + f64::from(k * k)).collect();
        assert!((Curve::about(&parabola, 0).at(0.5) - 1.25).abs() < 1e-12);
        assert!((Curve::about(&parabola, 2).at(0.5) - 7.25).abs() < 1e-12);
        // An edge that passes.
        for k in 0..3 {
            assert!(Curve::about(&[1.0, 1.0, 10.0, 10.0], k).error > 0.5);
        }
    }
}
