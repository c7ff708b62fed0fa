//! Twin of `trigger/*.wgsl`: the same algorithm in f32, one pixel after another.

use evis_core::SensorConfig;
use evis_core::trigger::{PixelState, decide, fire_time_us};

/// `mean_at` in `trigger/count.wgsl`, then `log_luminance_of` in `trigger/sample.wgsl`: mean in linear light, then the
/// logarithm.
pub fn log_luminance(
    samples: impl ExactSizeIterator<Item = f32>,
    reference_luminance: f32,
    log_eps: f32,
) -> f32 {
    let share = 1.0 / samples.len() as f32;
    let sum: f32 = samples.fold(0.0, |a, b| a + b);
    let y = (sum * share).clamp(0.0, 1e30);
    (y * (1.0 / reference_luminance) + log_eps).ln()
}

/// Straight pieces that stand for a curve.
pub const PIECES: usize = 4;

/// `trigger/between.wgsl`: from `at[0]` to `at[1]`, along a cubic that takes its slopes from the samples `before` and
/// `after`, where the block has them; the ends of its pieces.
pub fn curve(before: Option<f32>, at: [f32; 2], after: Option<f32>) -> [f32; PIECES] {
    let [start, end] = at;
    let change = end - start;
    let within = |a: f32, b: f32| {
        let most = 3.0 * a.abs().min(b.abs());
        (0.5 * (a + b)).clamp(-most, most)
    };
    let at_end = |other: f32| {
        let most = 3.0 * change;
        (2.0 * change - other).clamp(most.min(0.0), most.max(0.0))
    };
    let slope_before = before.map(|before| within(start - before, change));
    let slope_after = after.map(|after| within(change, after - end));
    let [first, last] = match (slope_before, slope_after) {
        (Some(first), Some(last)) => [first, last],
        (Some(first), None) => [first, at_end(first)],
        (None, Some(last)) => [at_end(last), last],
        (None, None) => [change; 2],
    };
    let (square, cube) = (3.0 * change - 2.0 * first - last, first + last - 2.0 * change);
    std::array::from_fn(|piece| {
        let u = (piece + 1) as f32 / PIECES as f32;
        if piece + 1 == PIECES { end } else { start + u * (first + u * (square + u * cube)) }
    })
}

/// One pixel's events over a block of which it is sampled at `log_luminances`, along curves; otherwise as [`walk`], of a pixel
/// that has a state.
pub fn walk_curves(
    config: &SensorConfig,
    state: &mut Option<PixelState>,
    log_luminances: &[f32],
    times: &[u32],
) -> Vec<(u32, bool)> {
    let known = state.map(|old| old.log_luminance);
    let samples: Vec<f32> = known.into_iter().chain(log_luminances.iter().copied()).collect();
    let mut events = Vec::new();
    for (k, at) in samples.array_windows().enumerate() {
        let before = k.checked_sub(1).map(|before| samples[before]);
        let ends = curve(before, *at, samples.get(k + 2).copied());
        let interval = times[k + 1] - times[k];
        let of_piece = |piece: usize| times[k] + (u64::from(interval) * piece as u64 / PIECES as u64) as u32;
        let pieces: Vec<u32> = (0..=PIECES).map(of_piece).collect();
        events.extend(walk(config, state, &ends, &pieces));
    }
    events
}

/// One pixel's events over a submission: (microseconds since its base, ON), in firing order.
///
/// `times` holds the instant before the first and then one per instant, as `TriggerParams::times` does;
/// `state` is `None` where the first instant only sets the reference.
pub fn walk(
    config: &SensorConfig,
    state: &mut Option<PixelState>,
    log_luminances: &[f32],
    times: &[u32],
) -> Vec<(u32, bool)> {
    let mut events = Vec::new();
    for (k, &log_luminance) in log_luminances.iter().enumerate() {
        let Some(old) = *state else {
            *state = Some(PixelState { reference_log: log_luminance, log_luminance });
            continue;
        };
        let decision = decide(config, old, log_luminance);
        let (start, interval) = (times[k], times[k + 1] - times[k]);
        for i in 1..=decision.count {
            let on = decision.polarity == evis_core::Polarity::On;
            events.push((start + fire_time_us(config, &decision, i, interval), on));
        }
        *state = Some(PixelState { reference_log: decision.reference_log, log_luminance });
    }
    events
}
