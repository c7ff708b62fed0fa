//! As few keys of a spline as follow the poses of a simulation.

use evis_scene::motion::{Curve, Interpolation};

/// What stays this long within half the tolerance of where it was rests, and keeps its bits.
const REST_S: f64 = 0.05;

/// Poses at the ends of steps, `N` numbers each, and where a curve may bend.
pub(crate) struct Samples<'a, const N: usize> {
    /// The first one at time 0.
    pub values: &'a [[f64; N]],
    /// Per pose: whether the velocity may jump there.
    pub knots: &'a [bool],
    /// Seconds.
    pub step_s: f64,
    /// Distance of two poses; the first one is of a spline, the second one is given.
    pub distance: fn(&[f64; N], &[f64; N]) -> f64,
    /// Largest distance of the curve from a pose.
    pub tolerance: f64,
}

/// A stretch of the curve from one pose to another one.
struct Segment<const N: usize> {
    end: usize,
    /// The value at its end.
    value: [f64; N],
    /// Change per second at its start and its end.
    slopes: [[f64; N]; 2],
}

impl<const N: usize> Samples<'_, N> {
    /// The curve through the first and the last pose that stays within the tolerance of all others.
    pub fn curve(&self) -> Curve {
        let mut curve = Curve { width: N, interpolation: Interpolation::CubicSpline, ..Curve::default() };
        let Some(mut value) = self.values.first().copied() else { return curve };
        let last = self.values.len() - 1;
        let knots: Vec<bool> =
            self.knots.iter().zip(self.rests()).map(|(knot, rests)| *knot || rests).collect();
        let (mut start, mut arriving) = (0, [0.0; N]);
        while start < last {
            let segment = self.rest(start, value).unwrap_or_else(|| self.longest(start, value, &knots));
            self.push(&mut curve, start, arriving, value, segment.slopes[0]);
            (start, value, arriving) = (segment.end, segment.value, segment.slopes[1]);
        }
        self.push(&mut curve, start, arriving, value, [0.0; N]);
        curve
    }

    /// A glTF spline has (in-tangent, value, out-tangent) per key.
    fn push(&self, curve: &mut Curve, at: usize, arriving: [f64; N], value: [f64; N], leaving: [f64; N]) {
        curve.times.push(at as f64 * self.step_s);
        [arriving, value, leaving].iter().for_each(|row| curve.values.extend_from_slice(row));
    }

    /// The stretch from `start` on in which nothing moves. Bits that do not change come first: a launch keeps its time.
    fn rest(&self, start: usize, value: [f64; N]) -> Option<Segment<N>> {
        let run = |near: &dyn Fn(&[f64; N]) -> bool| {
            start + self.values[start + 1..].iter().take_while(|v| near(v)).count()
        };
        let least = (REST_S / self.step_s).ceil() as usize;
        // Most poses of what moves are told by the end of the shortest rest.
        self.values.get(start + least).filter(|v| (self.distance)(&value, v) <= 0.5 * self.tolerance)?;
        let same = run(&|v| *v == value);
        let end = if same - start >= least {
            same
        } else {
            run(&|v| (self.distance)(&value, v) <= 0.5 * self.tolerance)
        };
        (end - start >= least).then_some(Segment { end, value, slopes: [[0.0; N]; 2] })
    }

    /// Per pose: whether a stretch begins in which nothing moves. Curves end there, so that none leads slowly through it.
    fn rests(&self) -> Vec<bool> {
        (0..self.values.len()).map(|start| self.rest(start, self.values[start]).is_some()).collect()
    }

    /// The longest stretch from `start` to at most the next of `knots` whose spline stays within the tolerance.
    fn longest(&self, start: usize, value: [f64; N], knots: &[bool]) -> Segment<N> {
        let last = self.values.len() - 1;
        let limit = (start + 1..last).find(|k| knots[*k]).unwrap_or(last);
        // Double the length while it fits, then halve the doubt.
        let (mut fits, mut reach) = (self.segment(start, start + 1, value), 2);
        let mut fails = limit + 1;
        while fits.end < limit {
            let end = limit.min(start + reach);
            let tried = self.segment(start, end, value);
            if !self.follows(start, value, &tried) {
                fails = end;
                break;
            }
            (fits, reach) = (tried, 2 * reach);
        }
        while fits.end + 1 < fails {
            let end = fits.end.midpoint(fails);
            let tried = self.segment(start, end, value);
            if self.follows(start, value, &tried) { fits = tried } else { fails = end }
        }
        fits
    }

    /// From `value` at `start` to the pose at `end`: straight within a step, else with the slopes that are closest to the
    /// poses in between, by least squares. A parabola gets its own slopes.
    fn segment(&self, start: usize, end: usize, value: [f64; N]) -> Segment<N> {
        let (steps, last) = ((end - start) as f64, self.values[end]);
        let length_s = steps * self.step_s;
        let slopes = if end == start + 1 {
            [std::array::from_fn(|i| (last[i] - value[i]) / length_s); 2]
        } else {
            // Normal equations of the two slopes, which all components share on the left.
            let (mut left, mut right) = ([0.0; 3], [[0.0; N]; 2]);
            for k in start + 1..end {
                let u = (k - start) as f64 / steps;
                let v = 1.0 - u;
                let (a, b) = (u * v * v, -u * u * v);
                left = [left[0] + a * a, left[1] + a * b, left[2] + b * b];
                for i in 0..N {
                    let straight = value[i] + (last[i] - value[i]) * u * u * (3.0 - 2.0 * u);
                    let rest = self.values[k][i] - straight;
                    right[0][i] += a * rest;
                    right[1][i] += b * rest;
                }
            }
            let [aa, ab, bb] = left;
            let determinant = aa * bb - ab * ab;
            // One pose in between leaves one slope open: the parabola through all three.
            if end == start + 2 {
                let middle = self.values[start + 1];
                let parabola = |sign: f64| {
                    std::array::from_fn(|i| {
                        let bend = value[i] - 2.0 * middle[i] + last[i];
                        (last[i] - value[i] - sign * 2.0 * bend) / length_s
                    })
                };
                [parabola(1.0), parabola(-1.0)]
            } else {
                let solve = |x: &[f64; N], y: &[f64; N], p: f64, q: f64| {
                    std::array::from_fn(|i| (p * x[i] - q * y[i]) / (determinant * length_s))
                };
                [solve(&right[0], &right[1], bb, ab), solve(&right[1], &right[0], aa, ab)]
            }
        };
        Segment { end, value: last, slopes }
    }

    /// Whether `segment`, from `value` at `start`, stays within the tolerance of the poses in it.
    fn follows(&self, start: usize, value: [f64; N], segment: &Segment<N>) -> bool {
        let mut curve = Curve { width: N, interpolation: Interpolation::CubicSpline, ..Curve::default() };
        self.push(&mut curve, start, [0.0; N], value, segment.slopes[0]);
        self.push(&mut curve, segment.end, segment.slopes[1], segment.value, [0.0; N]);
        (start + 1..segment.end).all(|k| {
            let mut there = [0.0; N];
            curve.sample(k as f64 * self.step_s, &mut there);
            (self.distance)(&there, &self.values[k]) <= self.tolerance
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may panic")]

    use super::*;

    fn distance(a: &[f64; 1], b: &[f64; 1]) -> f64 {
        (a[0] - b[0]).abs()
    }

    fn fitted(values: &[[f64; 1]], knots: &[usize]) -> Curve {
        let knots: Vec<bool> = (0..values.len()).map(|k| knots.contains(&k)).collect();
        let curve = Samples { values, knots: &knots, step_s: 0.001, distance, tolerance: 1e-5 }.curve();
        curve.check().unwrap();
        for (k, value) in values.iter().enumerate() {
            let mut there = [0.0];
            curve.sample(k as f64 * 0.001, &mut there);
            assert!((there[0] - value[0]).abs() <= 1e-5, "step {k}: {there:?}, not {value:?}");
        }
        curve
    }

    #[test]
    fn a_parabola_has_two_keys_and_a_bounce_keeps_its_corner() {
        let fall = |k: usize| 1.0 - 4.9 * (k as f64 * 0.001).powi(2);
        let flight: Vec<[f64; 1]> = (0..400).map(|k| [fall(k)]).collect();
        assert_eq!(fitted(&flight, &[]).times.len(), 2);
        // Up again after step 200, at the same speed.
        let bounce: Vec<[f64; 1]> = (0..400).map(|k| [fall(if k <= 200 { k } else { 400 - k })]).collect();
        let curve = fitted(&bounce, &[200]);
        assert_eq!(curve.times, [0.0, 0.2, 0.399]);
        let line: Vec<[f64; 1]> = (0..400).map(|k| [k as f64]).collect();
        assert_eq!(fitted(&line, &[150]).times, [0.0, 0.15, 0.399], "a knot is kept where nothing bends");
        assert_eq!(fitted(&line, &[]).times, [0.0, 0.399], "canary");
    }

    #[test]
    fn what_rests_has_two_equal_keys() {
        // Half a micrometre of noise about a place, after a fall; nobody says when it ends.
        let values: Vec<[f64; 1]> = (0..600)
            .map(|k| if k < 100 { [1.0 - k as f64 * 1e-3] } else { [0.9 + 5e-7 * f64::from(k as u32 % 3)] })
            .collect();
        let curve = fitted(&values, &[]);
        assert_eq!(curve.times, [0.0, 0.1, 0.599]);
        let at = |t: f64| {
            let mut there = [0.0];
            curve.sample(t, &mut there);
            there[0].to_bits()
        };
        assert!((0..4990).all(|k| at(0.1 + f64::from(k) * 1e-4) == at(0.1)));
        assert_ne!(at(0.0999), at(0.1), "canary");
    }
}
