//! The absolute grid of sampling instants.

use crate::sensor::ConfigError;

/// Instants at integer microseconds, `round(k * 1e6 / rate_hz)`, fixed in absolute time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeGrid {
    rate_hz: f64,
}

impl TimeGrid {
    /// A grid of `rate_hz` instants per second.
    ///
    /// # Errors
    /// `rate_hz` must be at least 1 mHz (an interval's microseconds are 32 bits) and at most 1 MHz (instants are whole
    /// microseconds).
    pub fn new(rate_hz: f64) -> Result<Self, ConfigError> {
        if (1.0e-3..=1.0e6).contains(&rate_hz) {
            Ok(Self { rate_hz })
        } else {
            Err(ConfigError::new("rate", rate_hz, "between 0.001 and 1000000 Hz"))
        }
    }

    /// Samples per second.
    pub const fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Time of instant `k`, in microseconds.
    pub fn instant_us(&self, k: i64) -> i64 {
        (k as f64 * 1.0e6 / self.rate_hz).round() as i64
    }

    /// The first `k` whose instant lies at or after `t_us`.
    pub fn first_at_or_after(&self, t_us: i64) -> i64 {
        let mut k = (t_us as f64 * self.rate_hz / 1.0e6).floor() as i64 - 1;
        while self.instant_us(k) < t_us {
            k += 1;
        }
        k
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_whose_intervals_overflow_are_refused() {
        for rate in [0.0, -1.0, 1e-9, 1.0 / 4295.0, 1.1e6, f64::NAN, f64::INFINITY] {
            let error = TimeGrid::new(rate).unwrap_err().to_string();
            assert!(error.contains("between 0.001 and 1000000 Hz"), "{error}");
        }
        assert!(TimeGrid::new(1e-3).is_ok() && TimeGrid::new(1e6).is_ok());
    }

    #[test]
    fn instants_do_not_drift() {
        let grid = TimeGrid::new(300.0).unwrap();
        assert_eq!((grid.instant_us(1), grid.instant_us(2), grid.instant_us(3)), (3333, 6667, 10_000));
        assert_eq!(grid.instant_us(300 * 3600), 3_600_000_000);
    }

    #[test]
    fn first_at_or_after_is_exact_at_grid_points() {
        for rate in [1.0, 30.0, 48.7, 300.0, 1000.0, 999_999.0] {
            let grid = TimeGrid::new(rate).unwrap();
            for k in [0, 1, 7, 1000, 123_457] {
                let t = grid.instant_us(k);
                assert_eq!(grid.instant_us(grid.first_at_or_after(t)), t);
                assert!(grid.instant_us(grid.first_at_or_after(t + 1)) > t);
            }
        }
    }

    #[test]
    fn impossible_rates_are_refused() {
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 2.0e6] {
            assert!(TimeGrid::new(rate).is_err(), "{rate}");
        }
    }
}
