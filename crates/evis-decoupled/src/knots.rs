//! A tile's light for sensors with more stages than thresholds: such a pixel's state changes without an event, so that all
//! of its light counts, and not only where a threshold may be crossed.
//!
//! The pixels of a tile share their times. A block is cut into the intervals that the fastest of them asks for; each moving
//! pixel is evaluated at their ends, its knots, and light runs along cubics between them. A cubic that misses a pixel's light
//! in the middle of two knots gives way to evaluations there. The sensor takes logarithms that are straight
//! between parts of intervals.

use evis_core::Event;
use evis_core::emulator::tiled::{Losses, SensorTile, TiledSensor};

use crate::lists::{Entry, PIXELS, TILE};
use crate::path::{INSTANT_US, stride};
use crate::pixel::{Evaluator, PixelActivity, UNITS, Work};

const _: () = assert!(evis_core::emulator::tiled::SIDE == TILE);

/// Parts of an interval between two knots in which the sensor takes light for straight.
const PARTS: u32 = 4;
/// A cubic that is off by this part of the light in the middle of two knots gives way to evaluations.
const TOLERANCE: f64 = 0.002;

/// What a tile's pixels remember between blocks.
#[derive(Clone, Debug)]
pub(crate) struct SensedTile {
    sensor: SensorTile,
    /// The luminance that they saw last.
    luminance: [f64; PIXELS],
}

/// A sensor, and how it follows light.
#[derive(Clone, Debug)]
pub(crate) struct Sensing {
    pub sensor: TiledSensor,
    pub step_px: f64,
    pub start_us: i64,
    /// `Y_ref`.
    pub reference: f64,
    /// Luminance that counts as none.
    pub floor: f64,
}

/// What following a tile took, and what its pixels lost.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Followed {
    pub evaluations: u64,
    pub losses: Losses,
}

impl Sensing {
    /// The tile at (column, row), whose pixels see `luminance` first, at `t_us` of scene time.
    pub fn begin(&self, place: [usize; 2], luminance: [f64; PIXELS], t_us: f64) -> SensedTile {
        let [x, y] = place.map(|v| (v * TILE) as u32);
        let mut tile = SensedTile { sensor: self.sensor.tile(x, y), luminance };
        self.take(&mut tile.sensor, &luminance, self.stream_us(t_us), &mut Vec::new());
        tile
    }

    fn stream_us(&self, t_us: f64) -> i64 {
        t_us.round() as i64 - self.start_us
    }

    fn take(
        &self,
        tile: &mut SensorTile,
        luminance: &[f64; PIXELS],
        t_us: i64,
        events: &mut Vec<Event>,
    ) -> Losses {
        let light =
            luminance.map(|v| if v.is_nan() { f32::NAN } else { (v / self.reference).max(0.0) as f32 });
        self.sensor.advance(tile, &light, t_us, events)
    }

    /// Follows a tile through the block of `evaluator`. `activities` are of the pixels that are in the picture.
    pub fn follow(
        &self,
        tile: &mut Option<SensedTile>,
        (evaluator, work): (&Evaluator, &mut Work),
        (entries, place): (&[Entry], [usize; 2]),
        activities: &[Option<PixelActivity>; PIXELS],
        events: &mut Vec<Event>,
    ) -> Followed {
        let block = evaluator.block;
        let mut followed = Followed::default();
        let moves = |pixel: usize| activities[pixel].is_some_and(|a| !a.still);
        let strides = activities.iter().flatten().map(|a| stride(block, self.step_px, a));
        // Of a cut, nothing but its end is seen.
        let shortest = strides.filter(|s| *s > 0).min().unwrap_or(UNITS);
        for pixel in (0..PIXELS).filter(|p| moves(*p)) {
            evaluator.expect(work, pixel, shortest);
        }
        if tile.is_none() {
            let mut first = [f64::NAN; PIXELS];
            for pixel in (0..PIXELS).filter(|p| activities[*p].is_some()) {
                evaluator.enter_pixel(work, pixel);
                first[pixel] = evaluator.first_luminance(work, entries);
            }
            followed.evaluations += PIXELS as u64;
            *tile = Some(self.begin(place, first, block.start_us));
        }
        let Some(SensedTile { sensor, luminance }) = tile else { return followed };
        if block.jump {
            for pixel in (0..PIXELS).filter(|p| activities[*p].is_some()) {
                evaluator.enter_pixel(work, pixel);
                luminance[pixel] = evaluator.luminance(work, entries, 0);
                followed.evaluations += 1;
            }
            // Light was as before until now.
            followed.losses.add(self.take(sensor, luminance, self.stream_us(block.start_us) + 1, events));
        }
        let count = (UNITS / shortest) as usize;
        let parts = [PARTS, 2, 1].into_iter().find(|p| shortest.is_multiple_of(*p)).unwrap_or(1);
        let parts = if block.length_us() <= INSTANT_US || !(0..PIXELS).any(moves) { 1 } else { parts };
        // Light at all parts, from the second on: what stands still has it already.
        let mut light = vec![*luminance; count * parts as usize];
        let mut knots = vec![0.0; count + 1];
        for pixel in (0..PIXELS).filter(|p| moves(*p)) {
            evaluator.enter_pixel(work, pixel);
            knots[0] = luminance[pixel];
            for (k, knot) in knots.iter_mut().enumerate().skip(1) {
                *knot = evaluator.luminance(work, entries, k as u32 * shortest);
            }
            followed.evaluations += count as u64;
            for k in 0..count {
                let mut at = |part: u32| {
                    followed.evaluations += 1;
                    evaluator.luminance(work, entries, k as u32 * shortest + part * shortest / parts)
                };
                let own = &mut light[k * parts as usize..(k + 1) * parts as usize];
                let curve = Curve::about(&knots, k);
                let mut exact = [false; PARTS as usize];
                if parts == PARTS && curve.error > TOLERANCE * (curve.least() + self.floor) {
                    let middle = at(2);
                    own[1][pixel] = middle;
                    exact[1] = true;
                    if (middle - curve.at(0.5)).abs() > TOLERANCE * (middle + self.floor) {
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
            luminance[pixel] = knots[count];
        }
        for (index, light) in light.iter().enumerate() {
            let u = (index + 1) as f64 / (count * parts as usize) as f64;
            followed.losses.add(self.take(sensor, light, self.stream_us(block.at(u)), events));
        }
        followed
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
