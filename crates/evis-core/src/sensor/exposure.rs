//! Exposures: frames of light in the place of light.

use serde::{Deserialize, Serialize};

use super::ConfigError;

/// Exposures and periods, at most: ten seconds.
const LONGEST_US: u32 = 10_000_000;

/// What pixels see: frames of light, each the mean of linear light over an exposure, in the place of light itself. The
/// EVIS paper's option of letting events see motion-blurred frames; real pixels have a bandwidth
/// ([`super::Photoreceptor`]) and no exposure. Off by default.
///
/// Exposures begin at the multiples of their period. A frame is a sample of the light at its exposure's middle, rounded down
/// to a microsecond; between two of them a pixel's signal is what it is between any two samples.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Exposure {
    /// How long light is gathered, up to 10 000 000; 0: pixels see light itself.
    pub time_us: u32,
    /// From the start of one exposure to that of the next, `time_us` to 10 000 000; 0: one begins where another ends.
    pub period_us: u32,
}

impl Exposure {
    /// Whether pixels see light itself.
    pub const fn is_off(&self) -> bool {
        self.time_us == 0
    }

    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let (time_us, period_us) = (self.time_us, self.period_us);
        if self.is_off() && *self != Self::default() {
            let remedy = "above 0 where the exposure has a period";
            return Err(ConfigError::new("exposure.time_us", time_us, remedy));
        }
        if time_us > LONGEST_US {
            let remedy = format!("at most {LONGEST_US} (ten seconds)");
            return Err(ConfigError::new("exposure.time_us", time_us, remedy));
        }
        if period_us != 0 && !(time_us..=LONGEST_US).contains(&period_us) {
            let remedy =
                format!("0 (one exposure after the other) or from {time_us}, its time_us, to {LONGEST_US}");
            return Err(ConfigError::new("exposure.period_us", period_us, remedy));
        }
        Ok(())
    }

    fn period(&self) -> i64 {
        i64::from(if self.period_us == 0 { self.time_us } else { self.period_us }).max(1)
    }

    /// Number of the first exposure that begins at `t_us` or later.
    pub(crate) fn first_from(&self, t_us: i64) -> i64 {
        t_us.div_euclid(self.period()) + i64::from(t_us.rem_euclid(self.period()) > 0)
    }

    /// When exposure `k` begins.
    pub(crate) fn start_us(&self, k: i64) -> i64 {
        k.saturating_mul(self.period())
    }

    /// When its frame is a sample of the light.
    pub(crate) fn middle_us(&self, k: i64) -> i64 {
        self.start_us(k).saturating_add(i64::from(self.time_us / 2))
    }

    /// When it ends.
    pub(crate) fn end_us(&self, k: i64) -> i64 {
        self.start_us(k).saturating_add(i64::from(self.time_us))
    }

    /// All events before this time are known once light is known until `t_us`, in a stream that begins at 0.
    pub fn known_us(&self, t_us: i64) -> i64 {
        let ended = t_us.saturating_sub(i64::from(self.time_us)).div_euclid(self.period());
        if self.is_off() { t_us } else { self.middle_us(ended).max(0) }
    }

    /// Light must be known until then so that all events before `t_us` are: no earlier than `t_us`, and later by less than
    /// a period and an exposure.
    pub fn needed_us(&self, t_us: i64) -> i64 {
        if self.is_off() {
            t_us
        } else {
            self.end_us(self.first_from(t_us.saturating_sub(i64::from(self.time_us / 2))))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_known_is_what_is_needed() {
        for (time_us, period_us) in [(1, 0), (7, 0), (10, 0), (10, 33), (11, 12)] {
            let exposure = Exposure { time_us, period_us };
            for t in 0..200 {
                let needed = exposure.needed_us(t);
                let late = needed - t;
                assert!((0..exposure.period() + i64::from(time_us)).contains(&late), "{exposure:?} {t}");
                assert!(exposure.known_us(needed) >= t && exposure.known_us(needed - 1) < t.max(1), "{t}");
            }
        }
        assert_eq!((Exposure::default().needed_us(5), Exposure::default().known_us(5)), (5, 5));
    }
}
