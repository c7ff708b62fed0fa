#import chain/state.wgsl
#import chain/own_times.wgsl
#import chain/arithmetic.wgsl
// From light to the signal: curve, then low-pass.

// Y / Y_ref of the pixel at an instant, or where times are its own at light of this number; below 0 where a method does not know it.
fn light_of(instant: u32) -> f32 {
    if (OWN_TIMES) {
        return min(clamp(own_luminance(instant), 0.0, LIGHT_LIMIT) * inverse_reference, LIGHT_LIMIT);
    }
    let layer = (view * params.instants + instant) * SAMPLES;
    let mean = mean_of_samples(pixel, layer);
    if (is_unknown(mean)) {
        return -1.0;
    }
    return min(clamp(mean, 0.0, LIGHT_LIMIT) * inverse_reference, LIGHT_LIMIT);
}

// `y` has the dark light in it.
fn curve(y: f32) -> f32 {
    if (LINLOG) {
        let i = y * sensor.full_scale;
        return select(precise_ln(max(i, 1.0)), i * sensor.below_knee, i <= sensor.knee);
    }
    return precise_ln(y + sensor.log_eps);
}

// What multiplies the cutoff; `y` has the dark light in it.
fn bandwidth(y: f32) -> f32 {
    if (!LIGHT_BANDWIDTH) {
        return 1.0;
    }
    let relative = (y + sensor.bandwidth_offset) / (1.0 + sensor.bandwidth_offset);
    return clamp(relative, sensor.bandwidth_least, sensor.bandwidth_most);
}

// Of a ramp that lasts `u` time constants: what one pole and two poles follow of it, 0 to 1; then e^-u, 1 - e^-u.
fn follows(u: f32) -> vec4<f32> {
    let e = precise_exp(-u);
    if (u < 0.1) {
        return vec4<f32>(
            u * (0.5 - u * (1.0 / 6.0 - u * (1.0 / 24.0))),
            u * u * (1.0 / 6.0 - u * (1.0 / 12.0 - u * (1.0 / 40.0))),
            e,
            u * (1.0 - u * (0.5 - u * (1.0 / 6.0 - u * (1.0 / 24.0)))),
        );
    }
    return vec4<f32>(1.0 - (1.0 - e) / u, 1.0 - (2.0 - 2.0 * e - u * e) / u, e, 1.0 - e);
}

// Time constants per microsecond, over the interval.
fn filter_rate() -> f32 {
    if (LIGHT_BANDWIDTH) {
        return cutoff_rate * bandwidth(0.5 * (light + next_light) + sensor.dark_light);
    }
    return cutoff_rate;
}

// The signal as the trigger sees it: now, and at the interval's end.
fn output() -> f32 {
    if (FILTER == 0u) {
        return input;
    }
    return select(first, second, SECOND_PLANE != 0u);
}

fn next_output() -> f32 {
    if (FILTER == 0u) {
        return next_input;
    }
    return select(next_first, next_second, SECOND_PLANE != 0u);
}

// Samples at the interval's end; an unknown pixel sees what it last saw.
fn respond(instant: u32) {
    respond_to(light_of(instant));
}

// The same, to light.
fn respond_to(y: f32) {
    next_light = light;
    next_input = input;
    sees = y >= 0.0;
    if (sees) {
        next_light = y;
        next_input = curve(y + sensor.dark_light);
    }
    if (FILTER == 1u) {
        let part = min(f32(interval) * cutoff_rate * bandwidth(next_light + sensor.dark_light), 1.0);
        next_first = first + part * (next_input - first);
        if (SECOND_PLANE != 0u) {
            next_second = second + part * (next_first - second);
        }
    } else if (FILTER >= 2u) {
        let u = f32(interval) * filter_rate();
        let share = follows(u);
        let change = next_input - input;
        let behind = first - input;
        next_first = input + change * share.x + behind * share.z;
        if (FILTER == 3u) {
            next_second = input + change * share.y + (second - input + behind * u) * share.z;
        }
    }
}

// The first sample of all.
fn begin_response(instant: u32) {
    light = max(light_of(instant), 0.0);
    input = curve(light + sensor.dark_light);
    first = input;
    second = input;
}

fn advance() {
    unknown += u32(!sees);
    input = next_input;
    first = next_first;
    second = next_second;
    light = next_light;
}
