//! Twin of `trigger/*.wgsl`: the same algorithm in f32, one pixel after another.

use evis_core::SensorConfig;
use evis_core::trigger::{PixelState, decide, fire_time_us};

/// `log_luma_at` in `trigger/sample.wgsl`: mean in linear light, then the logarithm.
pub fn log_luma(samples: impl ExactSizeIterator<Item = f32>, reference_luminance: f32, log_eps: f32) -> f32 {
    let share = 1.0 / samples.len() as f32;
    let sum: f32 = samples.fold(0.0, |a, b| a + b);
    let y = (sum * share).clamp(0.0, 1e30);
    (y * (1.0 / reference_luminance) + log_eps).ln()
}

/// One pixel's events over a submission: (microseconds since its base, ON), in firing order.
///
/// `times` holds the instant before the first and then one per instant, as `TriggerParams::times` does;
/// `state` is `None` where the first instant only sets the reference.
pub fn walk(
    config: &SensorConfig,
    state: &mut Option<PixelState>,
    log_lumas: &[f32],
    times: &[u32],
) -> Vec<(u32, bool)> {
    let mut events = Vec::new();
    for (k, &log_luma) in log_lumas.iter().enumerate() {
        let Some(old) = *state else {
            *state = Some(PixelState { reference_log: log_luma, log_luma });
            continue;
        };
        let decision = decide(config, old, log_luma);
        let (start, interval) = (times[k], times[k + 1] - times[k]);
        for i in 1..=decision.count {
            let on = decision.polarity == evis_core::Polarity::On;
            events.push((start + fire_time_us(config, &decision, i, interval), on));
        }
        *state = Some(PixelState { reference_log: decision.reference_log, log_luma });
    }
    events
}
