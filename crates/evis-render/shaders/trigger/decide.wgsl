// The threshold decision, one function for count and emit. Twin: evis_core::trigger::decide.
const MAX_EVENTS_PER_INTERVAL: f32 = 65535.0;

// 0 crossing, 1 latch.
override TRIGGER_RULE: u32 = 0;

struct Decision {
    count: u32,
    // 1 ON, 0 OFF.
    polarity: u32,
    rise_start: f32,
    rise_end: f32,
    threshold: f32,
    reference_log: f32,
    clamped: bool,
};

fn decide(sensor: ViewSensor, state: PixelMemory, log_luminance: f32) -> Decision {
    let change = log_luminance - state.reference_log;
    let on = change >= 0.0;
    let sign = select(-1.0, 1.0, on);
    let threshold = select(sensor.threshold_off, sensor.threshold_on, on);
    let rise_end = change * sign;
    let rise_start = (state.log_luminance - state.reference_log) * sign;
    var decision = Decision(0u, select(0u, 1u, on), rise_start, rise_end, threshold, state.reference_log, false);
    if (rise_end >= threshold) {
        if (TRIGGER_RULE == 0u) {
            let steps = floor(rise_end / threshold);
            let count = min(steps, MAX_EVENTS_PER_INTERVAL);
            decision.count = u32(count);
            decision.clamped = steps > MAX_EVENTS_PER_INTERVAL;
            decision.reference_log =
                select(state.reference_log + sign * (count * threshold), log_luminance, decision.clamped);
        } else {
            decision.count = 1u;
            decision.reference_log = log_luminance;
        }
    }
    return decision;
}

// Microseconds after the interval's start at which event `k` (from 1) fires, floored.
fn fire_time(decision: Decision, k: u32, interval: u32) -> u32 {
    if (TRIGGER_RULE == 1u) {
        return interval;
    }
    let run = decision.rise_end - decision.rise_start;
    let level = f32(k) * decision.threshold - decision.rise_start;
    let fraction = select(1.0, clamp(level / run, 0.0, 1.0), run > 0.0);
    return min(u32(floor(fraction * f32(interval))), interval);
}
