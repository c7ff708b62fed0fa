//! A pixel's light over time: evaluated where it must be, a quadratic between evaluations.
//!
//! Steps are bounded by motion in pixels. A step is halved while its end is off what the steps before it extrapolate to;
//! interpolation over a step errs by about a sixteenth of that (a cubic's remainder, 6 h^3 against 0.385 h^3).

use crate::blocks::Block;
use crate::events::{Piece, Reference, Thresholds};

/// Largest step, in pixels of motion.
const STEP_PX: f64 = 0.4;
/// Smallest step, in pixels of motion.
const LEAST_PX: f64 = 0.03;
/// Extrapolation may be off by this, in log units.
const TOLERANCE: f64 = 0.03;
/// Below this, steps grow.
const CALM: f64 = 0.01;
/// Least step in microseconds, whatever the motion.
const LEAST_US: f64 = 4.0;

/// Light at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Point {
    t_us: f64,
    luminance: f64,
}

/// What a pixel remembers between blocks.
#[derive(Clone, Copy, Debug)]
pub struct PixelPath {
    reference: Reference,
    /// The latest point first.
    past: [Point; 3],
    known: usize,
    step_us: f64,
}

/// Work on one pixel in one block.
pub struct Walk<'a> {
    /// Thresholds.
    pub thresholds: &'a Thresholds,
    /// The block.
    pub block: Block,
    /// Motion near the pixel, in pixels per microsecond.
    pub speed: f64,
    /// Room for points evaluated ahead.
    pub ahead: &'a mut Vec<(f64, f64)>,
}

/// (x1 - x0) / (t1 - t0) and the second divided difference of three points.
fn bend(a: &Point, b: &Point, c: &Point) -> f64 {
    let (ab, bc) =
        ((b.luminance - a.luminance) / (b.t_us - a.t_us), (c.luminance - b.luminance) / (c.t_us - b.t_us));
    (bc - ab) / (c.t_us - a.t_us)
}

impl PixelPath {
    /// A pixel that begins at `t_us` with `luminance`.
    pub fn new(t_us: f64, luminance: f64, thresholds: &Thresholds) -> Self {
        let point = Point { t_us, luminance };
        let reference = Reference::at(thresholds.log(luminance), thresholds);
        Self { reference, past: [point; 3], known: 1, step_us: f64::INFINITY }
    }

    /// What the latest points lead to at `t_us`.
    fn predict(&self, t_us: f64) -> f64 {
        let [a, b, c] = &self.past;
        match self.known {
            1 => a.luminance,
            2 => a.luminance + (t_us - a.t_us) * (a.luminance - b.luminance) / (a.t_us - b.t_us),
            _ => {
                let slope = (a.luminance - b.luminance) / (a.t_us - b.t_us);
                a.luminance + (t_us - a.t_us) * (slope + (t_us - b.t_us) * bend(c, b, a))
            }
        }
    }

    fn push(&mut self, t_us: f64, luminance: f64) {
        self.past = [Point { t_us, luminance }, self.past[0], self.past[1]];
        self.known = (self.known + 1).min(3);
    }

    /// Follows the pixel through a block; `light` evaluates it, `fire` takes events in order. Returns how often it was
    /// evaluated.
    pub fn walk(
        &mut self,
        walk: &mut Walk,
        mut light: impl FnMut(f64) -> f64,
        mut fire: impl FnMut(f64, evis_core::Polarity),
    ) -> u64 {
        let Walk { thresholds, block, speed, ahead } = walk;
        let mut evaluations = 0;
        let end = block.end_us;
        if block.jump {
            let luminance = light(block.start_us);
            evaluations += 1;
            let last = self.past[0];
            let piece = Piece {
                t_us: block.start_us,
                length_us: 1e-6,
                start: last.luminance,
                end: luminance,
                bend: 0.0,
            };
            piece.cross(&mut self.reference, thresholds, |_, p| fire(block.start_us, p));
            self.past = [Point { t_us: block.start_us, luminance }; 3];
            self.known = 1;
            self.step_us = 0.0;
        }
        let most = (STEP_PX / speed.max(1e-12)).max(LEAST_US);
        let least = (LEAST_PX / speed.max(1e-12)).clamp(LEAST_US, most);
        ahead.clear();
        let mut step = self.step_us.clamp(least, most);
        loop {
            let now = self.past[0];
            let left = end - now.t_us;
            if left <= 1e-6 {
                break;
            }
            let (t_us, luminance) = match ahead.pop() {
                Some(known) => known,
                None => {
                    let parts = (left / step).ceil();
                    let t_us = if parts <= 1.0 { end } else { now.t_us + left / parts };
                    evaluations += 1;
                    (t_us, light(t_us))
                }
            };
            let length = t_us - now.t_us;
            let scale = luminance.min(now.luminance).max(0.0) + thresholds.floor();
            let error = (luminance - self.predict(t_us)).abs() / scale;
            if error > TOLERANCE && length > 2.0 * least {
                ahead.push((t_us, luminance));
                let middle = now.t_us + 0.5 * length;
                evaluations += 1;
                ahead.push((middle, light(middle)));
                step = 0.5 * length;
                continue;
            }
            let next = Point { t_us, luminance };
            let bend = if self.known >= 2 { bend(&self.past[1], &now, &next) } else { 0.0 };
            let piece =
                Piece { t_us: now.t_us, length_us: length, start: now.luminance, end: luminance, bend };
            piece.cross(&mut self.reference, thresholds, &mut fire);
            self.push(t_us, luminance);
            step = if error < CALM { (2.0 * length).min(most) } else { length.max(least) };
        }
        self.step_us = step;
        evaluations
    }
}
