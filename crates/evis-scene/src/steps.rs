//! A value that a host changes all at once.

use std::sync::{PoisonError, RwLock};

/// How far a time in microseconds may be off after a detour over seconds. Less than half of the first time after a border at
/// which decoupled sampling evaluates a scene.
const ROUNDING_US: f64 = 5e-6;

/// A value over time that changes in steps. At the time of a change it is still the old one: what was sampled there does not
/// change.
#[derive(Debug)]
pub struct Steps<T> {
    /// Times after which values hold, ascending; the first one holds before, too.
    values: RwLock<Vec<(i64, T)>>,
}

impl<T: Copy + PartialEq> Steps<T> {
    /// `value`, always.
    pub fn new(value: T) -> Self {
        Self { values: RwLock::new(vec![(i64::MIN, value)]) }
    }

    /// The value at `t_us`; of the last change where that is infinite.
    pub fn at(&self, t_us: f64) -> Option<T> {
        let values = self.values.read().unwrap_or_else(PoisonError::into_inner);
        let after = values.partition_point(|(from_us, _)| t_us > *from_us as f64 + ROUNDING_US);
        values.get(after.saturating_sub(1)).map(|(_, value)| *value)
    }

    /// Makes it `value` after `from_us`, which is not before the last change. The same value changes nothing.
    pub(crate) fn set(&self, from_us: i64, value: T) {
        let mut values = self.values.write().unwrap_or_else(PoisonError::into_inner);
        if values.last().is_none_or(|(_, last)| *last != value) {
            values.push((from_us, value));
        }
    }

    /// Makes it `value`, always.
    pub(crate) fn replace(&self, value: T) {
        *self.values.write().unwrap_or_else(PoisonError::into_inner) = vec![(i64::MIN, value)];
    }

    /// Times in (start, end), in microseconds and ascending, at which it changes.
    pub fn times(&self, start_us: f64, end_us: f64) -> Vec<f64> {
        let values = self.values.read().unwrap_or_else(PoisonError::into_inner);
        let times = values.iter().map(|(from_us, _)| *from_us as f64);
        times.filter(|t| *t > start_us && *t < end_us).collect()
    }

    /// Forgets what no time from `t_us` on needs.
    pub(crate) fn forget_before(&self, t_us: i64) {
        let mut values = self.values.write().unwrap_or_else(PoisonError::into_inner);
        let old = values.partition_point(|(from_us, _)| *from_us < t_us).saturating_sub(1);
        values.drain(..old);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_shows_after_its_time_and_equal_values_are_no_step() {
        let steps = Steps::new(1);
        steps.set(10, 1);
        steps.set(20, 2);
        steps.set(30, 2);
        steps.set(40, 3);
        assert_eq!(steps.times(-1e9, 1e9), [20.0, 40.0]);
        let at = |t_us| steps.at(t_us).unwrap();
        assert_eq!([-9e9, 20.0, 20.001, 40.0, 41.0, f64::INFINITY].map(at), [1, 1, 2, 2, 3, 3]);
        // As scenes are evaluated: at seconds.
        let wrong = (1..1_000_000_i64).filter(|t_us| {
            let t = t_us * 3600;
            let one = Steps::new(0);
            one.set(t, 1);
            one.at(t as f64 * 1e-6 * 1e6) != Some(0) || one.at((t as f64 + 1e-5) * 1e-6 * 1e6) != Some(1)
        });
        assert_eq!(wrong.count(), 0);
        steps.forget_before(25);
        assert_eq!([0.0, 30.0, 41.0].map(at), [2, 2, 3]);
        steps.replace(7);
        assert_eq!([0.0, 41.0].map(at), [7, 7]);
    }
}
