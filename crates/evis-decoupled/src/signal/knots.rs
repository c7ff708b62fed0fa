//! A tile's light during a block, for sensors with more stages than thresholds: a pixel's state changes without an event
//! then, so that all of its light counts, and not only where a threshold may be crossed.
//!
//! The pixels of a tile share their times. A block is cut into the intervals that the fastest of them asks for; each moving
//! pixel is evaluated at their ends, its knots, and light runs along cubics between them. A cubic that misses a pixel's light
//! in the middle of two knots gives way to evaluations there. What comes out is straight between parts of intervals.

use crate::scene::tiles::PIXELS;
use crate::signal::path::{INSTANT_US, stride};
use crate::signal::pixel::{Evaluator, PixelActivity, UNITS, Work};
use crate::visibility::lists::Entry;

/// Parts of an interval between two knots in which light counts as straight.
const PARTS: u32 = 4;
/// A cubic that is off by this part of the light in the middle of two knots gives way to evaluations.
const TOLERANCE: f64 = 0.002;

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

impl TileSignal {
    /// Follows a tile that had the light `before` at the end of the last block (`None` for one that begins) through the block of
    /// `evaluator`. `activities` are of the pixels that are in the picture; what they see moves by at most `step_px` between knots,
    /// and luminance of `floor` counts as none.
    pub fn follow(
        before: Option<&TileLuminance>,
        (evaluator, work): (&Evaluator, &mut Work),
        (entries, activities): (&[Entry], &[Option<PixelActivity>; PIXELS]),
        (step_px, floor): (f64, f64),
    ) -> Self {
        let block = evaluator.block;
        let mut evaluations = 0;
        let moves = |pixel: usize| activities[pixel].is_some_and(|a| !a.still);
        let strides = activities.iter().flatten().map(|a| stride(block, step_px, a));
        // Of a cut, nothing but its end is seen.
        let shortest = strides.filter(|s| *s > 0).min().unwrap_or(UNITS);
        for pixel in (0..PIXELS).filter(|p| moves(*p)) {
            evaluator.expect(work, pixel, shortest);
        }
        let mut first = before.copied().unwrap_or([f64::NAN; PIXELS]);
        if before.is_none() || block.jump {
            for pixel in (0..PIXELS).filter(|p| activities[*p].is_some()) {
                evaluator.enter_pixel(work, pixel);
                first[pixel] = match before {
                    Some(_) => evaluator.luminance(work, entries, 0),
                    None => evaluator.first_luminance(work, entries),
                };
                evaluations += 1;
            }
        }
        let count = (UNITS / shortest) as usize;
        let parts = [PARTS, 2, 1].into_iter().find(|p| shortest.is_multiple_of(*p)).unwrap_or(1);
        let parts = if block.length_us() <= INSTANT_US || !(0..PIXELS).any(moves) { 1 } else { parts };
        // What stands still has its light already.
        let mut light = vec![first; count * parts as usize];
        let mut knots = vec![0.0; count + 1];
        for pixel in (0..PIXELS).filter(|p| moves(*p)) {
            evaluator.enter_pixel(work, pixel);
            knots[0] = first[pixel];
            for (k, knot) in knots.iter_mut().enumerate().skip(1) {
                *knot = evaluator.luminance(work, entries, k as u32 * shortest);
            }
            evaluations += count as u64;
            for k in 0..count {
                let mut at = |part: u32| {
                    evaluations += 1;
                    evaluator.luminance(work, entries, k as u32 * shortest + part * shortest / parts)
                };
                let own = &mut light[k * parts as usize..(k + 1) * parts as usize];
                let curve = Curve::about(&knots, k);
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
            if let Some(last) = light.last_mut() {
                last[pixel] = knots[count];
            }
        }
        Self { first, parts: light, evaluations }
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
