//! What a pixel's signal does between two samples, and when it crosses a threshold.

/// Where its slope may change sign: at most this many instants.
const MOST_TURNS: usize = 4;

/// The signal over an interval, a function of the time since its start in microseconds.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// Straight.
    Line { start: f64, slope: f64 },
    /// One pole driven by a straight line: `line(t) - slope tau + a e^(-t / tau)`.
    Pole { start: f64, slope: f64, tau: f64, a: f64 },
    /// Two poles: `line(t) - 2 slope tau + (b + a t / tau) e^(-t / tau)`.
    TwoPoles { start: f64, slope: f64, tau: f64, a: f64, b: f64 },
}

impl Shape {
    /// Straight from `start` to `end` over `length`.
    pub fn line(start: f64, end: f64, length: f64) -> Self {
        Self::Line { start, slope: (end - start) / length }
    }

    /// The answer of one pole at `y` to a line.
    pub fn pole(input: (f64, f64), length: f64, tau: f64, y: f64) -> Self {
        let slope = (input.1 - input.0) / length;
        Self::Pole { start: input.0, slope, tau, a: y - input.0 + slope * tau }
    }

    /// The answer of two poles at `y` and `z` to a line.
    pub fn two_poles(input: (f64, f64), length: f64, tau: f64, y: f64, z: f64) -> Self {
        let slope = (input.1 - input.0) / length;
        let a = y - input.0 + slope * tau;
        Self::TwoPoles { start: input.0, slope, tau, a, b: z - input.0 + 2.0 * slope * tau }
    }

    /// Its value at `t`.
    pub fn at(&self, t: f64) -> f64 {
        match *self {
            Self::Line { start, slope } => start + slope * t,
            Self::Pole { start, slope, tau, a } => start + slope * (t - tau) + a * (-t / tau).exp(),
            Self::TwoPoles { start, slope, tau, a, b } => {
                start + slope * (t - 2.0 * tau) + (b + a * t / tau) * (-t / tau).exp()
            }
        }
    }

    /// Instants within `(from, to)` at which the slope of `at(t) + drift t` changes sign, rising.
    fn turns(&self, drift: f64, from: f64, to: f64) -> ([f64; MOST_TURNS], usize) {
        let mut found = ([0.0; MOST_TURNS], 0);
        let mut add = |t: f64| {
            if t > from && t < to && found.1 < MOST_TURNS {
                found.0[found.1] = t;
                found.1 += 1;
            }
        };
        match *self {
            Self::Line { .. } => {}
            Self::Pole { slope, tau, a, .. } => {
                let ratio = (slope + drift) * tau / a;
                if ratio > 0.0 {
                    add(-tau * ratio.ln());
                }
            }
            Self::TwoPoles { slope, tau, a, b, .. } => {
                // The slope is s + g(u) / tau, g(u) = (a - b - a u) e^-u, u = t / tau; g turns once, at (2 a - b) / a.
                let target = -(slope + drift) * tau;
                let g = |t: f64| (a - b - a * t / tau) * (-t / tau).exp() - target;
                let middle = (tau * (2.0 * a - b) / a).clamp(from, to);
                let middle = if middle.is_nan() { from } else { middle };
                for (low, high) in [(from, middle), (middle, to)] {
                    if low < high && (g(low) < 0.0) != (g(high) < 0.0) {
                        add(root(g, low, high));
                    }
                }
            }
        }
        found
    }

    /// First instant in `[from, to]` at which `at(t) + drift t` is at least `high` or at most `low`, and whether it is
    /// `high`. Each monotone piece is asked for its ends, so that nothing can fall between two pieces.
    pub fn leaves(&self, drift: f64, low: f64, high: f64, from: f64, to: f64) -> Option<(f64, bool)> {
        let value = |t: f64| self.at(t) + drift * t;
        let begin = value(from);
        if begin >= high {
            return Some((from, true));
        }
        if begin <= low {
            return Some((from, false));
        }
        if let Self::Line { start, slope } = *self {
            let end = value(to);
            let (level, is_high) = if end >= high {
                (high, true)
            } else if end <= low {
                (low, false)
            } else {
                return None;
            };
            return Some((((level - start) / (slope + drift)).clamp(from, to), is_high));
        }
        let (turns, count) = self.turns(drift, from, to);
        let mut piece = (from, begin);
        for next in turns.into_iter().take(count).chain([to]) {
            let end = value(next);
            let level = if end >= high {
                high
            } else if end <= low {
                low
            } else {
                piece = (next, end);
                continue;
            };
            let at = root_between(|t| value(t) - level, (piece.0, piece.1 - level), (next, end - level));
            return Some((at, level == high));
        }
        None
    }
}

/// A shape on the interval's clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    pub shape: Shape,
    /// When it begins.
    pub from: f64,
}

impl Piece {
    /// [`Shape::at`].
    pub fn at(&self, t: f64) -> f64 {
        self.shape.at(t - self.from)
    }

    /// [`Shape::leaves`]; the drift is counted from the interval's start.
    pub fn leaves(&self, drift: f64, low: f64, high: f64, from: f64, to: f64) -> Option<(f64, bool)> {
        let drifted = drift * self.from;
        let found = self.shape.leaves(drift, low - drifted, high - drifted, from - self.from, to - self.from);
        found.map(|(t, rises)| (t + self.from, rises))
    }
}

/// Where `f` is 0 between `low` and `high`, at which its signs differ: the Illinois method (Dowell & Jarratt, BIT 11,
/// 1971), within a fiftieth of a microsecond.
fn root(f: impl Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    let (fa, fb) = (f(low), f(high));
    root_between(f, (low, fa), (high, fb))
}

/// [`root`], where the ends' values are known.
fn root_between(f: impl Fn(f64) -> f64, (mut a, mut fa): (f64, f64), (mut b, mut fb): (f64, f64)) -> f64 {
    const CLOSE: f64 = 0.02;
    let mut last = a;
    for step in 0..80 {
        if b - a < CLOSE {
            break;
        }
        let secant = (a * fb - b * fa) / (fb - fa);
        // A late halving now and then, so that no shape can hold the method up.
        let middle = if step % 10 == 9 || !(secant > a && secant < b) { 0.5 * (a + b) } else { secant };
        if (middle - last).abs() < CLOSE {
            return middle;
        }
        let same_side = (middle - last).is_sign_positive();
        let fm = f(middle);
        if fm == 0.0 {
            return middle;
        }
        last = middle;
        if (fm < 0.0) == (fb < 0.0) {
            (b, fb) = (middle, fm);
            if step > 0 && !same_side {
                fa *= 0.5;
            }
        } else {
            (a, fa) = (middle, fm);
            if step > 0 && same_side {
                fb *= 0.5;
            }
        }
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forward integration in small steps: another way to the same answer.
    fn integrated(poles: usize, input: (f64, f64), length: f64, tau: f64, state: (f64, f64)) -> Vec<f64> {
        let steps = 400_000;
        let h = length / f64::from(steps);
        let (mut y, mut z) = state;
        let mut out = vec![if poles == 1 { y } else { z }];
        for i in 0..steps {
            // Midpoint rule.
            let x = |t: f64| input.0 + (input.1 - input.0) * t / length;
            let t = f64::from(i) * h;
            let (ky, kz) = ((x(t) - y) / tau, (y - z) / tau);
            let (my, mz) = (y + 0.5 * h * ky, z + 0.5 * h * kz);
            y += h * (x(t + 0.5 * h) - my) / tau;
            z += h * (my - mz) / tau;
            if (i + 1) % 4000 == 0 {
                out.push(if poles == 1 { y } else { z });
            }
        }
        out
    }

    /// Input at both ends, length, time constant, state of both poles.
    type Case = ((f64, f64), f64, f64, (f64, f64));

    const CASES: [Case; 5] = [
        ((0.0, 1.0), 1000.0, 300.0, (0.0, 0.0)),
        ((0.0, 1.0), 1000.0, 100.0, (0.8, 0.0)),
        ((1.0, -2.0), 1000.0, 700.0, (0.2, 0.9)),
        ((0.5, 0.5), 1000.0, 50.0, (2.0, -1.0)),
        ((0.0, 0.3), 33_000.0, 530.0, (0.9, 0.1)),
    ];

    #[test]
    fn poles_answer_a_ramp_as_their_equations_say() {
        for (input, length, tau, (y, z)) in CASES {
            for poles in [1, 2] {
                let shape = match poles {
                    1 => Shape::pole(input, length, tau, y),
                    _ => Shape::two_poles(input, length, tau, y, z),
                };
                let expected = integrated(poles, input, length, tau, (y, z));
                for (i, expected) in expected.iter().enumerate() {
                    let got = shape.at(length * i as f64 / 100.0);
                    assert!((got - expected).abs() < 1e-6, "{poles} poles, {i}: {got}, {expected}");
                }
                // Canary: the other number of poles does not answer so.
                let other = integrated(3 - poles, input, length, tau, (y, z));
                assert!(other.iter().zip(&expected).any(|(a, b)| (a - b).abs() > 1e-3));
            }
        }
    }

    #[test]
    fn the_first_crossing_is_found() {
        let mut crossed = 0;
        for (input, length, tau, (y, z)) in CASES {
            for shape in [
                Shape::line(input.0, input.1, length),
                Shape::pole(input, length, tau, y),
                Shape::two_poles(input, length, tau, y, z),
            ] {
                for drift in [0.0, 2e-4, -3e-4] {
                    for width in [0.05, 0.2, 0.45, 0.9] {
                        let (low, high) = (shape.at(0.0) - width, shape.at(0.0) + width);
                        let fine = length / 20_000.0;
                        let scanned = (0..=20_000).map(|i| f64::from(i) * fine).find_map(|t| {
                            let value = shape.at(t) + drift * t;
                            (value >= high || value <= low).then_some((t, value >= high))
                        });
                        let got = shape.leaves(drift, low, high, 0.0, length);
                        match (scanned, got) {
                            (Some((t, side)), Some((got, got_side))) => {
                                assert!((t - got).abs() <= fine + 0.02 && side == got_side, "{t} {got}");
                                crossed += 1;
                            }
                            (None, None) => {}
                            both => panic!("{shape:?} {drift} {width}: {both:?}"),
                        }
                    }
                }
            }
        }
        assert!(crossed > 60, "{crossed}");
    }
}
