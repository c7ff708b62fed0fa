//! A pixel's light over time: evaluated where it must be, a quadratic between evaluations.
//!
//! A block is cut into equal intervals in which what the pixel sees moves by less than a part of it. Each is evaluated in
//! its middle and at its end. Through these runs a quadratic; how far the next point before is from a cubic through all
//! says how far it may be off. An interval in which it may cross a threshold, and is not known well enough to say when,
//! is halved.

use crate::blocks::Block;
use crate::events::{Piece, Reference, Thresholds};
use crate::pixel::{Pace, UNITS};

/// Length of an interval where nobody says, in pixels of motion.
pub const STEP_PX: f64 = 1.0;
/// Intervals are halved down to this many pixels of motion.
const LEAST_PX: f64 = 0.05;
/// Parts of a sine's period that an interval may be long at most, and at least.
const PERIOD_PARTS: f64 = 8.0;
const LEAST_PERIOD_PARTS: f64 = 64.0;
/// What happens within a block as short as this, in microseconds, is a cut: nothing of it is seen but its end.
const INSTANT_US: f64 = 2.0;
/// A threshold is crossed on light that may be off by this part of itself.
const TOLERANCE: f64 = 0.004;
/// A quadratic's estimated error times this, and this part of its range, is what it may be off by between evaluations.
const MARGIN: [f64; 2] = [4.0, 0.5];
/// Least intervals in a block where light changes without motion.
const LEAST_PARTS: u32 = 1;

/// Light at a time, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Point {
    t_us: f64,
    luminance: f64,
}

/// The least 2^n or 3 2^n that is not below `wanted`: intervals that pixels of a tile share, about as long as each wants.
fn whole_parts(wanted: u32) -> u32 {
    let power = wanted.next_power_of_two();
    let parts = if power >= 4 && 3 * (power / 4) >= wanted { 3 * (power / 4) } else { power };
    parts.min(UNITS / 2)
}

/// What a pixel remembers between blocks.
#[derive(Clone, Copy, Debug)]
pub struct PixelPath {
    reference: Reference,
    last: Point,
    /// An evaluation before the last.
    before: Option<Point>,
}

/// Work on one pixel in one block.
struct Walk<'a, L, F> {
    thresholds: &'a Thresholds,
    block: Block,
    least: u32,
    light: L,
    fire: F,
    evaluations: u64,
}

/// Second divided difference of three points.
fn bend(a: &Point, b: &Point, c: &Point) -> f64 {
    let (ab, bc) =
        ((b.luminance - a.luminance) / (b.t_us - a.t_us), (c.luminance - b.luminance) / (c.t_us - b.t_us));
    (bc - ab) / (c.t_us - a.t_us)
}

impl<L: FnMut(u32) -> f64, F: FnMut(f64, evis_core::Polarity)> Walk<'_, L, F> {
    fn at(&mut self, unit: u32) -> Point {
        self.evaluations += 1;
        let t_us = self.block.start_us + self.block.length_us() * f64::from(unit) / f64::from(UNITS);
        Point { t_us, luminance: (self.light)(unit) }
    }

    /// Follows `path` over [from, to], at whose end light is `end`.
    fn interval(&mut self, path: &mut PixelPath, [from, to]: [u32; 2], end: Point) {
        let start = path.last;
        let half = (to - from) / 2;
        if half == 0 {
            self.cross(path, start, end, 0.0);
            (path.before, path.last) = (Some(start), end);
            return;
        }
        let middle = self.at(from + half);
        let quadratic = bend(&start, &middle, &end);
        let h = 0.5 * (end.t_us - start.t_us);
        // The remainder of a quadratic through three points h apart is at most 0.385 h^3 times the third difference.
        let error = match path.before {
            Some(before) => {
                let third = (quadratic - bend(&before, &start, &middle)) / (end.t_us - before.t_us);
                0.385 * h * h * h * third.abs()
            }
            None => 0.5 * h * h * quadratic.abs(),
        };
        // Extremes of the quadratic.
        let (mut low, mut high) = (start.luminance, start.luminance);
        for v in [middle.luminance, end.luminance] {
            (low, high) = (low.min(v), high.max(v));
        }
        let slope = (middle.luminance - start.luminance) / h - quadratic * h;
        let vertex = -slope / (2.0 * quadratic);
        if vertex > 0.0 && vertex < 2.0 * h {
            let v = start.luminance + vertex * (slope + quadratic * vertex);
            (low, high) = (low.min(v), high.max(v));
        }
        let scale = low.max(0.0) + self.thresholds.floor();
        let margin = MARGIN[0] * error + MARGIN[1] * (high - low);
        let reached = high + margin >= path.reference.above || low - margin <= path.reference.below;
        if reached && error > TOLERANCE * scale && to - from > 2 * self.least {
            self.interval(path, [from, from + half], middle);
            self.interval(path, [from + half, to], end);
            return;
        }
        self.cross(path, start, end, quadratic);
        (path.before, path.last) = (Some(middle), end);
    }

    fn cross(&mut self, path: &mut PixelPath, start: Point, end: Point, bend: f64) {
        let piece = Piece {
            t_us: start.t_us,
            length_us: end.t_us - start.t_us,
            start: start.luminance,
            end: end.luminance,
            bend,
        };
        piece.cross(&mut path.reference, self.thresholds, &mut self.fire);
    }
}

impl PixelPath {
    /// A pixel that begins at `t_us` with `luminance`.
    pub fn new(t_us: f64, luminance: f64, thresholds: &Thresholds) -> Self {
        let reference = Reference::at(thresholds.log(luminance), thresholds);
        Self { reference, last: Point { t_us, luminance }, before: None }
    }

    /// Follows the pixel through a block; `light` evaluates it at parts of the block in [`UNITS`], `fire` takes events in
    /// order. What it sees moves by at most `step_px` in an interval. Returns how often it was evaluated.
    pub fn walk(
        &mut self,
        thresholds: &Thresholds,
        block: Block,
        step_px: f64,
        pace: &Pace,
        light: impl FnMut(u32) -> f64,
        fire: impl FnMut(f64, evis_core::Polarity),
    ) -> u64 {
        let units = |px: f64| (px / pace.motion_px.max(1e-9) * f64::from(UNITS)).min(f64::from(UNITS)) as u32;
        let of_period = f64::from(UNITS) / (pace.periods * LEAST_PERIOD_PARTS).max(1.0);
        let least = units(LEAST_PX.min(0.5 * step_px)).min(of_period as u32).max(1);
        let mut walk = Walk { thresholds, block, least, light, fire, evaluations: 0 };
        if self.last.t_us != block.start_us {
            // What went before was still.
            self.last.t_us = block.start_us;
            self.before = None;
        }
        if block.jump {
            let start = walk.at(0);
            let end_us = start.t_us + 1e-6;
            let end = Point { t_us: end_us, ..start };
            walk.cross(self, self.last, end, 0.0);
            self.last = start;
            self.before = None;
        }
        if pace.still {
            return walk.evaluations;
        }
        if block.length_us() <= INSTANT_US {
            let end = walk.at(UNITS);
            walk.cross(self, self.last, end, 0.0);
            self.last = end;
            self.before = None;
            return walk.evaluations;
        }
        let parts = (pace.motion_px / step_px).max(pace.periods * PERIOD_PARTS).ceil();
        let parts = whole_parts((parts.min(f64::from(UNITS)) as u32).max(LEAST_PARTS));
        let length = UNITS / parts;
        for part in 0..parts {
            let to = (part + 1) * length;
            let end = walk.at(to);
            walk.interval(self, [part * length, to], end);
        }
        walk.evaluations
    }
}
