//! A pixel's light over time: evaluated where it must be, a cubic between evaluations.
//!
//! A block is cut into equal intervals in which what the pixel sees moves by about a pixel. Each is evaluated in its middle
//! and at its end. Through these and the middle before runs a cubic; how far it is from the quadratic without that one bounds
//! how far it is off. An interval in which it may cross a threshold, and is not known well enough to say when, is
//! halved. Thresholds are crossed on two quadratics that meet the cubic at both ends and in the middle of either half.

use crate::packed;
use crate::signal::events::{Piece, Reference, Thresholds};
use crate::signal::pixel::{PixelActivity, UNITS};
use crate::visibility::blocks::Block;

/// Length of an interval where nobody says, in pixels of motion.
pub const STEP_PX: f64 = 1.0;
/// Intervals are halved down to this many pixels of motion.
const LEAST_PX: f64 = 0.05;
/// Parts of a sine's period that an interval may be long at most, and at least.
const PERIOD_PARTS: f64 = 8.0;
const LEAST_PERIOD_PARTS: f64 = 64.0;
/// What happens within a block as short as this, in microseconds, is a cut: nothing of it is seen but its end.
pub const INSTANT_US: f64 = 2.0;
/// A threshold is crossed on light that may be off by this part of itself.
const TOLERANCE: f64 = 0.004;
/// A quadratic's estimated error times this, and this part of its range, is what it may be off by between evaluations.
const MARGIN: [f64; 2] = [4.0, 0.5];
/// How much longer than asked for an interval may be, so that pixels of a tile share them.
const ROUNDING: f64 = 1.2;
/// Least intervals in a block where light changes without motion.
const LEAST_PARTS: u32 = 1;

/// Light at a time, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Point {
    t_us: f64,
    luminance: f64,
}

/// The least 2^n or 3 2^n that is not below `wanted` but for [`ROUNDING`]: intervals that pixels of a tile share.
fn whole_parts(wanted: f64) -> u32 {
    let wanted = (wanted / ROUNDING).ceil().clamp(f64::from(LEAST_PARTS), f64::from(UNITS / 2)) as u32;
    let power = wanted.next_power_of_two();
    let parts = if power >= 4 && 3 * (power / 4) >= wanted { 3 * (power / 4) } else { power };
    parts.min(UNITS / 2)
}

/// Every how many units of `block` a pixel is evaluated at least, in intervals of `step_px`: at their middles and ends. 0 where
/// it is not evaluated that often.
pub fn stride(block: Block, step_px: f64, activity: &PixelActivity) -> u32 {
    if activity.still || block.length_us() <= INSTANT_US {
        return 0;
    }
    UNITS / whole_parts((activity.motion_px / step_px).max(activity.periods * PERIOD_PARTS)) / 2
}

/// What a pixel remembers between blocks.
#[derive(Clone, Copy, Debug)]
pub struct PixelPath {
    reference: Reference,
    last: Point,
    /// An evaluation before the last.
    before: Option<Point>,
    /// It was not followed since the last.
    rested: bool,
    /// Nor ever.
    begins: bool,
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
        let third =
            path.before.map(|before| (quadratic - bend(&before, &start, &middle)) / (end.t_us - before.t_us));
        // The remainder of a quadratic through three points h apart is at most 0.385 h^3 times the third difference.
        let error = third.map_or(0.5 * h * h * quadratic.abs(), |third| 0.385 * h * h * h * third.abs());
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
        // The cubic is the quadratic and third t (t - m) (t - l), which is bent by this in either half.
        let third = third.unwrap_or(0.0);
        let (m, l) = (middle.t_us - start.t_us, end.t_us - start.t_us);
        self.cross(path, start, middle, quadratic - third * (l - 0.5 * m));
        self.cross(path, middle, end, quadratic + third * 0.5 * (m + l));
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
        Self { reference, last: Point { t_us, luminance }, before: None, rested: false, begins: true }
    }

    /// Luminances between which it fires nothing.
    pub fn quiet(&self, thresholds: &Thresholds) -> [f64; 2] {
        let Reference { above, below, .. } = self.reference;
        // What is followed may be off by as much.
        let off = |level: f64| TOLERANCE * (level.abs() + thresholds.floor());
        [below + off(below), above - off(above)]
    }

    /// What a device needs of it to follow it through `block`, number `number` of the view's.
    pub fn pack(&self, block: Block, number: u32) -> packed::Memory {
        let Reference { log, above, below } = self.reference;
        let mut memory = packed::Memory {
            last: self.last.luminance as f32,
            log: log as f32,
            above: above as f32,
            below: below as f32,
            number: number - 1,
            ..packed::Memory::default()
        };
        // What went before was still, otherwise.
        if let Some(before) = self.before.filter(|_| self.last.t_us == block.start_us) {
            memory.before_us = (before.t_us - block.start_us) as f32;
            memory.before = before.luminance as f32;
            memory.flags |= packed::HAS_BEFORE;
        }
        memory.flags |= if self.rested { packed::RESTED } else { 0 };
        // What light returns to must have been found in the same way.
        memory.flags |= if self.begins { packed::BEGINS } else { 0 };
        memory
    }

    /// Goes on from what a device remembers of it at the start of `block`, number `number` of the view's; `None` where it was never
    /// followed.
    pub fn unpack(block: Block, number: u32, memory: &packed::Memory) -> Option<Self> {
        if memory.flags & packed::BEGINS != 0 {
            return None;
        }
        let at = |t_us: f64, luminance: f32| Point { t_us, luminance: luminance.into() };
        let has_gone_on = memory.number + 1 == number;
        let known = has_gone_on && memory.flags & packed::HAS_BEFORE != 0;
        let [log, above, below] = [memory.log, memory.above, memory.below].map(f64::from);
        Some(Self {
            reference: Reference { log, above, below },
            last: at(if has_gone_on { block.start_us } else { f64::NEG_INFINITY }, memory.last),
            before: known.then(|| at(block.start_us + f64::from(memory.before_us), memory.before)),
            rested: memory.flags & packed::RESTED != 0,
            begins: false,
        })
    }

    /// How often a device evaluates a pixel that sees what is so active, see [`packed::strides`].
    pub fn strides(block: Block, step_px: f64, activity: &PixelActivity) -> u32 {
        packed::strides(stride(block, step_px, activity), Self::least(step_px, activity))
    }

    /// Units to which intervals are halved at most.
    pub fn least(step_px: f64, activity: &PixelActivity) -> u32 {
        let units =
            |px: f64| (px / activity.motion_px.max(1e-9) * f64::from(UNITS)).min(f64::from(UNITS)) as u32;
        let of_period = f64::from(UNITS) / (activity.periods * LEAST_PERIOD_PARTS).max(1.0);
        units(LEAST_PX.min(0.5 * step_px)).min(of_period as u32).max(1)
    }

    /// Leaves out a block in which it fires nothing.
    pub fn rest(&mut self) {
        (self.rested, self.begins) = (true, false);
    }

    /// Follows the pixel through a block; `light` evaluates it at parts of the block in [`UNITS`], `fire` takes events in
    /// order. What it sees moves by at most `step_px` in an interval. Returns how often it was evaluated.
    pub fn walk(
        &mut self,
        thresholds: &Thresholds,
        block: Block,
        step_px: f64,
        activity: &PixelActivity,
        light: impl FnMut(u32) -> f64,
        fire: impl FnMut(f64, evis_core::Polarity),
    ) -> u64 {
        self.begins &= activity.still && !block.jump;
        let least = Self::least(step_px, activity);
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
        if activity.still {
            return walk.evaluations;
        }
        if std::mem::take(&mut self.rested) && !block.jump {
            self.last = walk.at(0);
        }
        if block.length_us() <= INSTANT_US {
            let end = walk.at(UNITS);
            walk.cross(self, self.last, end, 0.0);
            self.last = end;
            self.before = None;
            return walk.evaluations;
        }
        let length = 2 * stride(block, step_px, activity);
        for from in (0..UNITS).step_by(length as usize) {
            let end = walk.at(from + length);
            walk.interval(self, [from, from + length], end);
        }
        walk.evaluations
    }
}

#[cfg(test)]
mod tests {
    use evis_core::{Polarity, SensorConfig};

    use super::*;

    #[test]
    fn a_pixel_that_rests_goes_on_where_its_light_is() {
        let thresholds = Thresholds::new(&SensorConfig::default(), 1.0);
        let blocks = [0.0, 32_768.0, 65_536.0].map(|start_us| Block {
            start_us,
            end_us: start_us + 32_768.0,
            jump: false,
        });
        let light =
            |t_us: f64| 1.0 + 0.05 * (t_us * 1e-4).sin() + 1.2e-10 * (t_us - 30_000.0).max(0.0).powi(2);
        let activity = PixelActivity { still: false, motion_px: 6.0, periods: 0.0 };
        let follow = |rests: bool| {
            let mut path = PixelPath::new(0.0, light(0.0), &thresholds);
            let mut fired: Vec<(f64, Polarity)> = Vec::new();
            let mut evaluations = 0;
            for (number, block) in blocks.into_iter().enumerate() {
                if rests && number == 1 {
                    path.rest();
                    continue;
                }
                let at = |unit: u32| {
                    light(block.start_us + block.length_us() * f64::from(unit) / f64::from(UNITS))
                };
                let fire = |t, p| fired.push((t, p));
                evaluations = path.walk(&thresholds, block, STEP_PX, &activity, at, fire);
            }
            (fired, path.quiet(&thresholds), evaluations)
        };
        let ((followed, levels, count), (rested, same, more)) = (follow(false), follow(true));
        // Nothing in the block that is left out.
        assert!(followed.len() > 1 && followed.iter().all(|(t, _)| *t > 65_536.0), "{followed:?}");
        assert_eq!(followed.len(), rested.len());
        for (a, b) in followed.iter().zip(&rested) {
            assert!((a.0 - b.0).abs() < 10.0 && a.1 == b.1, "{a:?} {b:?}");
        }
        assert_eq!(levels, same);
        // One more at its start; light that was not what it goes on from would be looked for in ever shorter intervals.
        assert!(more <= count + 3, "{count} {more}");
        let [low, high] = levels;
        assert!(low < light(98_304.0) && light(98_304.0) < high, "{low} {high}");
    }
}
