//! Thresholds of an ideal sensor, crossed by light that is a quadratic in time.

use evis_core::{Polarity, SensorConfig};

use crate::packed;

/// Light that comes as near to a level as this, in log units, reaches it: a lamp that blinks returns to the same light but for
/// rounding, of 1 in 10^8 where it was found in another way.
const TIE: f64 = 1e-6;

/// Levels of an ideal sensor, as luminance.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    on: f64,
    off: f64,
    eps: f64,
    reference_luminance: f64,
}

impl Thresholds {
    /// Those of `sensor`, with Y_ref in l = ln(Y / Y_ref + eps).
    pub fn new(sensor: &SensorConfig, reference_luminance: f64) -> Self {
        Self {
            on: f64::from(sensor.threshold_on),
            off: f64::from(sensor.threshold_off),
            eps: f64::from(sensor.log_eps),
            reference_luminance,
        }
    }

    /// As a device has them.
    pub fn pack(&self) -> packed::Job {
        packed::Job {
            threshold_on: self.on as f32,
            threshold_off: self.off as f32,
            log_eps: self.eps as f32,
            reference_luminance: self.reference_luminance as f32,
            ..packed::Job::default()
        }
    }

    /// Logarithm of a luminance.
    pub fn log(&self, luminance: f64) -> f64 {
        (luminance / self.reference_luminance + self.eps).ln()
    }

    fn luminance(&self, log: f64) -> f64 {
        (log.exp() - self.eps) * self.reference_luminance
    }

    /// How near to `level` light reaches it.
    fn tie(&self, level: f64) -> f64 {
        TIE * (level + self.floor())
    }

    /// Luminance that counts as none: a small part of what `eps` adds.
    pub fn floor(&self) -> f64 {
        self.eps * self.reference_luminance
    }
}

/// A pixel's reference, and the luminances at which it fires next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// In log units.
    pub log: f64,
    /// Luminance of the next ON event.
    pub above: f64,
    /// Luminance of the next OFF event; not above 0 where darkness does not reach it.
    pub below: f64,
}

impl Reference {
    /// At the logarithm `log`.
    pub fn at(log: f64, thresholds: &Thresholds) -> Self {
        Self {
            log,
            above: thresholds.luminance(log + thresholds.on),
            below: thresholds.luminance(log - thresholds.off),
        }
    }
}

/// Light over an interval: `start + time * (slope + time * bend)`.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// Microseconds at its start.
    pub t_us: f64,
    /// Length in microseconds.
    pub length_us: f64,
    /// Luminance at the start.
    pub start: f64,
    /// Luminance at the end.
    pub end: f64,
    /// Second divided difference: per microsecond squared.
    pub bend: f64,
}

impl Piece {
    fn value(&self, t: f64) -> f64 {
        self.start + t * (self.slope() + self.bend * t)
    }

    fn slope(&self) -> f64 {
        (self.end - self.start) / self.length_us - self.bend * self.length_us
    }

    /// The time in [from, to], a monotone part whose ends lie on either side of `level`, at which it is reached.
    fn reach(&self, level: f64, from: f64, to: f64) -> f64 {
        let (slope, below) = (self.slope(), self.start - level);
        // The two roots without cancellation; rounding may leave none where the level is touched at the vertex.
        let root = (slope * slope - 4.0 * self.bend * below).max(0.0).sqrt();
        let q = -0.5 * (slope + root.copysign(slope));
        let off = |t: f64| (t - t.clamp(from, to)).abs();
        let [one, other] = [below / q, q / self.bend];
        let t = if off(one) <= off(other) || other.is_nan() { one } else { other };
        if t.is_nan() { from } else { t.clamp(from, to) }
    }

    /// Calls `fire` with time and polarity of each crossing and moves `reference` along.
    pub fn cross(
        &self,
        reference: &mut Reference,
        thresholds: &Thresholds,
        mut fire: impl FnMut(f64, Polarity),
    ) {
        // Monotone parts: up to the vertex, and from it on.
        let vertex = if self.bend == 0.0 { 0.0 } else { -self.slope() / (2.0 * self.bend) };
        let middle = if vertex > 0.0 && vertex < self.length_us { vertex } else { self.length_us };
        for [from, to] in [[0.0, middle], [middle, self.length_us]] {
            if to <= from {
                continue;
            }
            let end = if to == self.length_us { self.end } else { self.value(to) };
            let mut at = from;
            loop {
                let (level, polarity) = if end >= reference.above - thresholds.tie(reference.above) {
                    (reference.above, Polarity::On)
                } else if end <= reference.below + thresholds.tie(reference.below)
                    && reference.below > -thresholds.tie(0.0)
                {
                    // Levels below zero are never reached but for rounding: a polynomial may be negative, light is not, and
                    // levels converge towards -eps, so that following it there would not terminate.
                    (reference.below, Polarity::Off)
                } else {
                    break;
                };
                at = self.reach(level, at, to);
                fire(self.t_us + at, polarity);
                let step = if polarity == Polarity::On { thresholds.on } else { -thresholds.off };
                *reference = Reference::at(reference.log + step, thresholds);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thresholds() -> Thresholds {
        Thresholds::new(&SensorConfig::default(), 1.0)
    }

    fn events(piece: Piece) -> Vec<(f64, Polarity)> {
        let t = thresholds();
        let mut reference = Reference::at(t.log(piece.start), &t);
        let mut out = Vec::new();
        piece.cross(&mut reference, &t, |t, p| out.push((t, p)));
        out
    }

    #[test]
    fn a_parabola_fires_up_and_down_at_its_roots() {
        // 1 at both ends, 1.5 in the middle: 2 up, 2 down.
        let piece = Piece { t_us: 100.0, length_us: 1000.0, start: 1.0, end: 1.0, bend: -2e-6 };
        let fired = events(piece);
        let level = |k: f64| (0.2_f32 as f64 * k).exp() * 1.001 - 0.001;
        let root = |y: f64| 500.0 - ((1.5 - y) / 2e-6_f64).sqrt();
        let expected = [
            (100.0 + root(level(1.0)), Polarity::On),
            (100.0 + root(level(2.0)), Polarity::On),
            (1100.0 - root(level(1.0)), Polarity::Off),
            (1100.0, Polarity::Off),
        ];
        // The end, level with the start, counts as the next level.
        assert_eq!(fired.len(), 4, "{fired:?}");
        for (got, want) in fired.iter().zip(expected) {
            assert!((got.0 - want.0).abs() < 0.01 && got.1 == want.1, "{got:?} {want:?}");
        }
        // Canary: a straight line between the same ends is silent.
        assert!(events(Piece { bend: 0.0, ..piece }).is_empty());
    }

    #[test]
    fn light_that_returns_to_a_level_but_for_rounding_reaches_it() {
        let t = thresholds();
        for off in [-1e-8, 0.0, 1e-8, 1e-3] {
            let (low, high) = (0.5, 0.65);
            let mut reference = Reference::at(t.log(low), &t);
            let mut fired = Vec::new();
            for [start, end] in [[low, high], [high, low * (1.0 + off)]] {
                let piece = Piece { t_us: 0.0, length_us: 1e-6, start, end, bend: 0.0 };
                piece.cross(&mut reference, &t, |_, p| fired.push(p));
            }
            let expected = if off < 1e-4 { &[Polarity::On, Polarity::Off][..] } else { &[Polarity::On] };
            assert_eq!(fired, expected, "{off}");
        }
    }

    #[test]
    fn light_that_returns_to_darkness_reaches_the_level_it_came_from() {
        let t = thresholds();
        for high in (1..200).map(|k| 0.05 * f64::from(k)) {
            let mut reference = Reference::at(t.log(0.0), &t);
            let mut counts = [0; 2];
            for [start, end] in [[0.0, high], [high, 0.0]] {
                let piece = Piece { t_us: 0.0, length_us: 1e-6, start, end, bend: 0.0 };
                piece.cross(&mut reference, &t, |_, p| counts[usize::from(p == Polarity::On)] += 1);
            }
            assert!(counts[1] > 10 && counts[0] == counts[1], "{high}: {counts:?}");
        }
    }

    #[test]
    fn what_falls_below_darkness_fires_down_to_it() {
        let t = thresholds();
        let piece = Piece { t_us: 0.0, length_us: 1000.0, start: 1.0, end: 1.0, bend: 1.2e-5 };
        assert!(piece.value(500.0) < -1.0);
        let mut reference = Reference::at(t.log(piece.start), &t);
        let mut fired = Vec::new();
        piece.cross(&mut reference, &t, |t, p| {
            assert!(fired.len() < 1000, "without end");
            fired.push((t, p));
        });
        let down = ((t.log(1.0) - t.log(0.0)) / 0.2_f32 as f64).floor() as usize;
        assert_eq!(fired.iter().filter(|f| f.1 == Polarity::Off).count(), down);
        assert!(fired.is_sorted_by(|a, b| a.0 <= b.0) && fired.len() >= 2 * down - 1);
    }

    #[test]
    fn every_crossing_of_a_rise_fires() {
        let piece = Piece { t_us: 0.0, length_us: 10.0, start: 0.01, end: 10.0, bend: 0.0 };
        let t = thresholds();
        let count = ((t.log(10.0) - t.log(0.01)) / 0.2_f32 as f64).floor() as usize;
        let fired = events(piece);
        assert_eq!(fired.len(), count);
        assert!(fired.is_sorted_by(|a, b| a.0 <= b.0));
    }
}
