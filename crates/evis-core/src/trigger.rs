//! The threshold decision, scalar and in f32: the twin of `shaders/trigger/decide.wgsl`.
//!
//! The events of an interval are counted first, and timed after that: a test of the kind "does a crossing lie
//! inside this interval" loses events on ties.

use crate::event::Polarity;
use crate::sensor::{SensorConfig, TriggerRule};

/// What survives an interval in one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelState {
    /// Reference that the next event is measured from, in log units.
    pub reference_log: f32,
    /// Log intensity at the last sample.
    pub log_luminance: f32,
}

/// What one sampling interval does to one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// How many events fire.
    pub count: u32,
    /// Their polarity.
    pub polarity: Polarity,
    /// Distance from the reference at the interval's start, signed so that the threshold is positive.
    pub rise_start: f32,
    /// The same at its end.
    pub rise_end: f32,
    /// The threshold of this polarity.
    pub threshold: f32,
    /// The reference afterwards.
    pub reference_log: f32,
}

pub use crate::sensor::MAX_EVENTS_PER_INTERVAL;

/// How far from a level the logarithm of an integer may be and still be on it, log units. A pixel that comes back to a value
/// comes back to its level; references in f32 have lost some digits on the way (8-bit random walks of 300 frames: without
/// this, 7 % of pixels miss events that v2e and ESIM mean to fire; with it, none of 10 000).
pub const TIE: f32 = 1.9e-6;

/// Decides for one pixel and the interval that ends with `log_luminance`.
#[inline]
pub fn decide(config: &SensorConfig, state: PixelState, log_luminance: f32) -> Decision {
    decide_within(config, state, log_luminance, 0.0)
}

/// [`decide`], where what is no farther than `tie` from a level is on it: [`TIE`] for integers. Not for `latch`, which has no
/// levels.
#[inline]
pub fn decide_within(config: &SensorConfig, state: PixelState, log_luminance: f32, tie: f32) -> Decision {
    let change = log_luminance - state.reference_log;
    let (polarity, sign, threshold) = if change >= 0.0 {
        (Polarity::On, 1.0, config.threshold_on)
    } else {
        (Polarity::Off, -1.0, config.threshold_off)
    };
    let rise_end = change * sign;
    let rise_start = (state.log_luminance - state.reference_log) * sign;
    let tie = if config.trigger == TriggerRule::Latch { 0.0 } else { tie };
    let steps = ((rise_end + tie) / threshold).floor();
    let (count, reference_log) = match config.trigger {
        // No pixel of thresholds alone forgets: `Difference` is for the whole chain.
        TriggerRule::Crossing | TriggerRule::Difference => {
            let count = steps.min(MAX_EVENTS_PER_INTERVAL as f32) as u32;
            let moved = if steps > MAX_EVENTS_PER_INTERVAL as f32 {
                log_luminance
            } else {
                let level = state.reference_log + sign * (count as f32 * threshold);
                if count > 0 && (level - log_luminance).abs() <= tie { log_luminance } else { level }
            };
            (count, moved)
        }
        TriggerRule::Latch if steps >= 1.0 => (1, log_luminance),
        TriggerRule::Latch => (0, state.reference_log),
    };
    Decision { count, polarity, rise_start, rise_end, threshold, reference_log }
}

/// Microseconds after the interval's start at which event `k` (from 1) of `decision` fires, floored;
/// `interval_us` is the interval's length.
#[inline]
pub fn fire_time_us(config: &SensorConfig, decision: &Decision, k: u32, interval_us: u32) -> u32 {
    match config.trigger {
        TriggerRule::Latch => interval_us,
        TriggerRule::Crossing | TriggerRule::Difference => {
            let run = decision.rise_end - decision.rise_start;
            let level = k as f32 * decision.threshold - decision.rise_start;
            let fraction = if run > 0.0 { (level / run).clamp(0.0, 1.0) } else { 1.0 };
            ((fraction * interval_us as f32).floor() as u32).min(interval_us)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_crossing_fires_at_its_own_time() {
        let config = SensorConfig::default();
        let state = PixelState { reference_log: 0.0, log_luminance: 0.1 };
        let decision = decide(&config, state, 0.7);
        assert_eq!((decision.count, decision.polarity), (3, Polarity::On));
        let times: Vec<_> = (1..=3).map(|k| fire_time_us(&config, &decision, k, 600)).collect();
        assert_eq!(times, [100, 300, 500]);
        assert!((decision.reference_log - 0.6).abs() < 1e-6);
    }

    #[test]
    fn latch_fires_once_at_the_sample() {
        let config = SensorConfig { trigger: TriggerRule::Latch, ..Default::default() };
        let state = PixelState { reference_log: 0.0, log_luminance: 0.0 };
        let decision = decide(&config, state, -0.9);
        assert_eq!((decision.count, decision.polarity, decision.reference_log), (1, Polarity::Off, -0.9));
        assert_eq!(fire_time_us(&config, &decision, 1, 250), 250);
        assert_eq!(decide(&config, state, 0.19).count, 0);
    }

    #[test]
    fn a_tie_is_counted_once() {
        // 0.25 is exact in f32: the signal rests exactly on the threshold for two samples.
        let config = SensorConfig { threshold_on: 0.25, ..Default::default() };
        let first = decide(&config, PixelState { reference_log: 0.0, log_luminance: 0.0 }, 0.25);
        assert_eq!(first.count, 1);
        let second =
            decide(&config, PixelState { reference_log: first.reference_log, log_luminance: 0.25 }, 0.25);
        assert_eq!(second.count, 0);
    }
}
