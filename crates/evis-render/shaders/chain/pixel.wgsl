#import chain/leak.wgsl
#import chain/shape.wgsl
// One pixel in one interval, in continuous time: crossings and noise in the order in which they happen. Times are
// microseconds since the interval's start. Twin: emulator/chain/ of evis_core.

const CAUSE_SIGNAL: u32 = 0u;
const CAUSE_LEAK: u32 = 1u;

// Within `feed`: the pixel's next candidate, and where its block's end.
var<private> candidate: u32;
var<private> candidates_end: u32;
// When that candidate comes, microseconds since the base, and what it is: read once, not at each instant.
var<private> candidate_us: u32;
var<private> candidate_kind: u32;

fn load_candidate() {
    candidate_us = 0xffffffffu;
    if (candidate < candidates_end) {
        candidate_kind = feed[candidate + 1u];
        if ((candidate_kind & 63u) == (pixel.x & 63u)) {
            candidate_us = feed[candidate];
        }
    }
}

fn pass_candidate() {
    candidate += CANDIDATE_WORDS;
    load_candidate();
}

fn drift() -> f32 {
    if (RAMP) {
        return slope;
    }
    return 0.0;
}

// What the leak has added at the interval's start, less than nothing where the reference moved later.
fn leaked() -> f32 {
    if (RAMP) {
        return slope * f32(i32(start) - moved);
    }
    return 0.0;
}

fn leaked_at_end() -> f32 {
    if (RAMP) {
        return slope * f32(i32(start + interval) - moved);
    }
    return 0.0;
}

// When the pixel is free again.
fn free_at() -> f32 {
    return f32(fired - i32(start)) + refractory_us;
}

fn is_refractory(t: f32) -> bool {
    return REFRACTORY != 0u && t < free_at();
}

fn light_at(t: f32) -> f32 {
    return light + (next_light - light) * (t / f32(interval));
}

fn fire(t: f32, on: bool, cause: u32) {
    let offset = clamp(u32(t), 1u, interval);
    var time = start + offset;
    if (LIGHT_LATENCY) {
        time += u32(sensor.latency_light_us / max(light_at(t) + sensor.dark_light, 0.01));
    }
    let kind = select(0u, 1u << 26u, on) | (cause << 27u);
    let record = vec2<u32>(time, pixel.x | (pixel.y << 13u) | kind);
    if (job.mode != MODE_EMIT) {
        if (written < KEPT) {
            kept[index * KEPT + written] = record;
        }
    } else if (written < room) {
        events[place + written] = record;
    }
    written++;
    if (FIRED_PLANE != 0u) {
        fired = i32(start + offset);
        polarity = u32(on);
    }
}

// Why a threshold was reached: by a rise of which the leak's ramp is at least half, or by light.
fn cause_of(rises: bool, leaked: f32, rise: f32) -> u32 {
    return select(CAUSE_SIGNAL, CAUSE_LEAK, rises && leaked >= 0.5 * rise && leaked > 0.0);
}

// When the candidate comes; beyond any time where none is left.
fn candidate_time() -> f32 {
    if (!TIMED_NOISE || candidate_us > start + interval) {
        return 3.0e38;
    }
    // Those of an interval that a held pixel slept through are gone.
    return f32(candidate_us - start);
}

// A candidate's turn; whether it fired.
fn take_candidate(t: f32, signal: f32) -> bool {
    let kind = candidate_kind;
    let at = i32(candidate_us);
    let below = bitcast<f32>(feed[candidate + 2u]);
    pass_candidate();
    if (below < BEYOND && light_at(t) >= below) {
        return false;
    }
    // Slow noise needs time after an event.
    let rest = i32(kind >> 12u) << 4u;
    if (rest > 0 && at - fired < rest) {
        return false;
    }
    var on = (kind & 64u) != 0u;
    if ((kind & 128u) != 0u && polarity < 2u) {
        on = (polarity == 1u) != ((kind & 256u) != 0u);
    }
    if (is_refractory(t)) {
        suppressed++;
        return false;
    }
    fire(t, on, (kind >> 9u) & 3u);
    if (NOISE_SETS_REFERENCE) {
        reference = signal;
        moved_at(t);
    }
    return true;
}

// Holds the pixel for its refractory period; when it is released, or beyond any time.
fn hold() -> f32 {
    let end = f32(interval);
    let released = free_at();
    if (released > end) {
        reference = 2.0 * BEYOND;
        return 3.0e38;
    }
    let t = max(released, 0.0);
    reference = shape_at(t);
    moved_at(t);
    return t;
}

// Crossings at their own times, and noise between them.
fn walk_continuous() {
    begin_shape();
    let end = f32(interval);
    var t = 0.0;
    var count = 0u;
    if (REFRACTORY == 3u && reference > BEYOND) {
        t = hold();
        if (t > end) {
            return;
        }
    }
    // Each turn takes a crossing, of which there are MOST_EVENTS, or a candidate, of which there are so many.
    loop {
        let before = leaked();
        var crossing = Leaving(0u, 0.0);
        var begin = t;
        if (REFRACTORY == 2u) {
            begin = max(free_at(), t);
        }
        if (begin <= end) {
            let level = reference - shape_base - before;
            crossing = leaves(drift(), level - threshold_off, level + threshold_on, begin, end);
        }
        let noise_at = candidate_time();
        if (noise_at <= end && (crossing.side == 0u || noise_at <= crossing.t)) {
            // A held pixel hears nothing.
            if (noise_at < t) {
                pass_candidate();
                continue;
            }
            t = noise_at;
            let fires = take_candidate(t, shape_at(t));
            if (REFRACTORY == 3u && fires) {
                t = hold();
                if (t > end) {
                    return;
                }
            }
            continue;
        }
        if (crossing.side == 0u) {
            return;
        }
        t = crossing.t;
        count++;
        if (is_refractory(t)) {
            suppressed++;
        } else {
            fire(t, crossing.side == 1u, cause_of(crossing.side == 1u, before + drift() * t, threshold_on));
        }
        if (count > MOST_EVENTS) {
            clamped++;
            reference = next_output();
            moved_at(end);
            return;
        }
        if (REFRACTORY == 3u) {
            t = hold();
            if (t > end) {
                return;
            }
            continue;
        }
        let threshold = select(-threshold_off, threshold_on, crossing.side == 1u);
        reference += threshold - (before + drift() * t);
        moved_at(t);
    }
}

// How far the signal is from the reference at the interval's end.
fn change_at_end() -> f32 {
    return next_output() - reference + leaked_at_end();
}

// Thresholds between them.
fn steps_of(change: f32) -> u32 {
    let steps = abs(change) / select(threshold_off, threshold_on, change >= 0.0);
    return u32(min(steps, 1073741824.0));
}

// The rules of other simulators: decided at the sample, times by rule. `most`: events of the busiest pixel.
fn walk_sampled(most: u32) {
    let end = f32(interval);
    let from_signal = output();
    let to_signal = next_output();
    if (REFRACTORY == 3u && reference > BEYOND) {
        if (free_at() <= end) {
            reference = to_signal;
            moved_at(end);
        }
        return;
    }
    let leak = leaked_at_end();
    let change = change_at_end();
    let on = change >= 0.0;
    let steps = steps_of(change);
    let count = min(steps, select(MOST_EVENTS, 1u, LATCH));
    var fires = 0u;
    var struck = false;
    var next = 1u;
    // Each turn takes an event or a candidate.
    loop {
        var t = 3.0e38;
        if (next <= count) {
            t = end;
            if (!LATCH && TIMES == 2u) {
                t = end * f32(next) / f32(count);
            } else if (!LATCH && TIMES == 3u) {
                t = end * f32(next) / f32(max(most, count));
            }
        }
        let noise_at = candidate_time();
        if (noise_at <= min(t, end)) {
            struck |= take_candidate(noise_at, from_signal + (to_signal - from_signal) * noise_at / end);
            continue;
        }
        if (next > count) {
            break;
        }
        let silent = is_refractory(t);
        if (silent) {
            suppressed++;
        } else {
            fire(t, on, cause_of(on, leak, change));
        }
        fires += u32(!silent || REFRACTORY == 1u);
        next++;
    }
    if (NOISE_SETS_REFERENCE && struck) {
        // The sample is memorised, whatever else the pixel fired.
        clamped += u32(!LATCH && steps > count);
        reference = to_signal;
        moved_at(end);
        return;
    }
    if (count == 0u) {
        return;
    }
    if (REFRACTORY == 3u) {
        reference = select(to_signal, 2.0 * BEYOND, free_at() > end);
        moved_at(end);
    } else if (LATCH) {
        if (fires > 0u) {
            reference = to_signal;
            moved_at(end);
        }
    } else if (steps > count) {
        clamped++;
        reference = to_signal;
        moved_at(end);
    } else if (fires > 0u) {
        let step = f32(fires) * select(-threshold_off, threshold_on, on);
        reference += step - leak;
        moved_at(end);
    }
}

// Whether anything could happen in the interval; most pixels stop here. As the emulator's first pass has it.
fn wakes() -> bool {
    if (candidate_time() < BEYOND || (REFRACTORY == 3u && reference > BEYOND)) {
        return true;
    }
    let leak = leaked_at_end();
    let change = next_output() - reference + leak;
    if (change >= threshold_on || change <= -threshold_off) {
        return true;
    }
    if (FILTER < 2u) {
        return false;
    }
    // It may turn on its way.
    var turns_within = (input - first) * (next_input - next_first) < 0.0;
    var most = max(input, next_input);
    var least = min(input, next_input);
    if (FILTER == 3u) {
        turns_within = turns_within || (first - second) * (next_first - next_second) < 0.0;
        most = max(most, first);
        least = min(least, first);
    }
    return turns_within
        && (most - reference + leak >= threshold_on || least - reference + leak <= -threshold_off);
}
