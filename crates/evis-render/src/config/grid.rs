//! The sampled instants: keyframes at absolute times, and the instants that divide the gaps between them.

use evis_core::{ConfigError, TimeGrid};

/// Instants at integer microseconds, fixed in absolute time: keyframe j at `round(j * 1e6 / keyframe_hz)`, and `steps`
/// equal parts of each gap, rounded. A method without keyframes has one step per gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleGrid {
    keyframes: TimeGrid,
    steps: i64,
}

impl SampleGrid {
    /// `steps` instants per gap of `keyframe_hz` gaps per second.
    ///
    /// # Errors
    /// The rate of instants must be above 0 and at most 1 MHz: instants are whole microseconds.
    pub fn new(keyframe_hz: f64, steps: u32) -> Result<Self, ConfigError> {
        let keyframes = TimeGrid::new(keyframe_hz)?;
        TimeGrid::new(keyframe_hz * f64::from(steps))?;
        Ok(Self { keyframes, steps: i64::from(steps) })
    }

    /// Instants per gap.
    pub const fn steps(&self) -> i64 {
        self.steps
    }

    /// Longest time between two instants, microseconds.
    pub fn longest_interval_us(&self) -> f64 {
        1e6 / (self.keyframes.rate_hz() * self.steps as f64) + 1.0
    }

    /// Time of keyframe `j`.
    pub fn keyframe_us(&self, j: i64) -> i64 {
        self.keyframes.instant_us(j)
    }

    /// Time of instant `k`; instant `j * steps` is keyframe `j`.
    pub fn instant_us(&self, k: i64) -> i64 {
        let (j, i) = (k.div_euclid(self.steps), k.rem_euclid(self.steps));
        let start = self.keyframes.instant_us(j);
        if i == 0 {
            return start;
        }
        let gap = self.keyframes.instant_us(j + 1) - start;
        start + (gap * i + self.steps / 2) / self.steps
    }

    /// The first `k` whose instant lies at or after `t_us`.
    pub fn first_at_or_after(&self, t_us: i64) -> i64 {
        let mut k = self.keyframes.first_at_or_after(t_us) * self.steps;
        while self.instant_us(k - 1) >= t_us {
            k -= 1;
        }
        k
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_step_is_the_plain_grid() {
        let plain = TimeGrid::new(700.0).unwrap();
        let grid = SampleGrid::new(700.0, 1).unwrap();
        for t in [0, 1, 1428, 1429, 60_000, 123_456_789] {
            assert_eq!(grid.first_at_or_after(t), plain.first_at_or_after(t));
        }
        assert!((0..2000).all(|k| grid.instant_us(k) == plain.instant_us(k)));
    }

    #[test]
    fn instants_divide_their_gap_and_meet_its_keyframes() {
        for (hz, steps) in [(30.0, 8), (125.0, 8), (48.7, 3), (333_333.0, 3), (7.0, 32)] {
            let grid = SampleGrid::new(hz, steps).unwrap();
            for j in [0, 1, 2, 9, 10_007] {
                let k = j * i64::from(steps);
                assert_eq!(grid.instant_us(k), grid.keyframe_us(j));
                for i in 0..i64::from(steps) {
                    let t = grid.instant_us(k + i);
                    assert!(grid.instant_us(k + i + 1) > t, "{hz} Hz: instants are apart");
                    let even = (j * i64::from(steps) + i) as f64 * 1e6 / (hz * f64::from(steps));
                    assert!((t as f64 - even).abs() <= 1.5, "{hz} Hz {j} {i}: {t} and {even}");
                    assert_eq!(grid.first_at_or_after(t), k + i);
                    assert_eq!(grid.first_at_or_after(t + 1), k + i + 1);
                }
            }
        }
    }

    #[test]
    fn rates_beyond_a_microsecond_are_refused() {
        assert!(SampleGrid::new(125_001.0, 8).is_err() && SampleGrid::new(125_000.0, 8).is_ok());
        assert!(SampleGrid::new(f64::NAN, 8).is_err() && SampleGrid::new(0.0, 8).is_err());
    }
}
