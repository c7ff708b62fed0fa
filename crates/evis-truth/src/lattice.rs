//! Where in a pixel light is sampled: Fibonacci lattices.
//!
//! A rank-1 lattice with consecutive Fibonacci numbers has the least discrepancy known for its size (H. Niederreiter,
//! "Random Number Generation and Quasi-Monte Carlo Methods", 1992, 5.1). It is shifted by half of a lattice vector,
//! so that it equals its own mirror image through the pixel's centre: the centroid is exact. Along either axis its n
//! points have n different places, so that an upright edge meets n equal steps.

use serde::{Deserialize, Serialize};

/// Which of two independent families of samples: truths from both are held against each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Lattice {
    /// 144, 610 and 2584 samples.
    #[default]
    First,
    /// 233, 987 and 4181 samples, mirrored.
    Second,
}

evis_core::words!(Lattice {
    Self::First => "first", "one family of samples";
    Self::Second => "second", "another one, independent of it";
});

/// Sizes of a family.
pub const LEVELS: usize = 3;

impl Lattice {
    /// Samples at `level`, 0 to 2.
    pub fn size(self, level: usize) -> usize {
        self.fibonacci(level).0 as usize
    }

    /// Points of one family at `level`, as offsets from the pixel's centre in pixels, within (-0.5, 0.5).
    pub fn offsets(self, level: usize) -> Vec<[f64; 2]> {
        let (n, g) = self.fibonacci(level);
        // Twice the shift is a lattice point; the half keeps every coordinate off the pixel's border.
        let half = if g % 2 == 1 { g } else { g + n };
        let place = |numerator: u64| ((numerator % (2 * n)) as f64) / (2 * n) as f64 - 0.5;
        (0..n)
            .map(|i| [place(2 * i + 1), place(2 * i * g + half)])
            .map(|[x, y]| if self == Self::Second { [-x, y] } else { [x, y] })
            .collect()
    }

    /// Lines along either axis of a pixel on which edges are looked for; see `signal.rs`.
    pub const fn lines(self) -> usize {
        match self {
            Self::First => 48,
            Self::Second => 61,
        }
    }

    const fn fibonacci(self, level: usize) -> (u64, u64) {
        match (self, level) {
            (Self::First, 0) => (144, 89),
            (Self::First, 1) => (610, 377),
            (Self::First, _) => (2584, 1597),
            (Self::Second, 0) => (233, 144),
            (Self::Second, 1) => (987, 610),
            (Self::Second, _) => (4181, 2584),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lattices_are_centred_symmetric_and_fill_every_row() {
        for (lattice, level) in
            [Lattice::First, Lattice::Second].iter().flat_map(|l| [0, 1, 2].map(|k| (l, k)))
        {
            let points = lattice.offsets(level);
            let n = points.len();
            assert_eq!(n, lattice.size(level));
            for axis in 0..2 {
                let mut at: Vec<f64> = points.iter().map(|p| p[axis]).collect();
                at.sort_by(f64::total_cmp);
                for (i, v) in at.iter().enumerate() {
                    assert!(
                        (v - ((i as f64 + 0.5) / n as f64 - 0.5)).abs() < 1e-12,
                        "{lattice:?} {level}: {v}"
                    );
                }
            }
            let has = |p: [f64; 2]| points.iter().any(|q| (q[0] - p[0]).abs() + (q[1] - p[1]).abs() < 1e-9);
            assert!(points.iter().take(200).all(|p| has([-p[0], -p[1]])), "its own mirror image");
            assert!(!has([points[0][0] + 0.3 / n as f64, points[0][1]]), "canary");
        }
    }
}
