#import chain/layout.wgsl
#import trigger/tile_rate.wgsl
// One pixel: what it is, what it remembers, and what it says.

var<private> pixel: vec2<u32>;
var<private> view: u32;
var<private> index: u32;
var<private> threshold_on: f32;
var<private> threshold_off: f32;
// Mean slope of the leak.
var<private> steady: f32;
var<private> inverse_reference: f32;
var<private> key: vec2<u32>;
// 2 pi cutoff per microsecond.
var<private> cutoff_rate: f32;
var<private> refractory_us: f32;

// At the interval's start; `reference` moves within it.
var<private> reference: f32;
var<private> input: f32;
var<private> first: f32;
var<private> second: f32;
var<private> light: f32;
// When the reference last moved, and when the pixel last fired: microseconds since the submission's base.
var<private> moved: i32;
var<private> fired: i32;
var<private> slope: f32;
// Of the last event: 0, 1, or 2 for none.
var<private> polarity: u32;
// At the interval's end.
var<private> next_input: f32;
var<private> next_first: f32;
var<private> next_second: f32;
var<private> next_light: f32;

// The interval: microseconds since the base, length, and its start in stream time.
var<private> start: u32;
var<private> interval: u32;
var<private> clock: vec2<u32>;

var<private> written: u32;
var<private> place: u32;
var<private> room: u32;
var<private> suppressed: u32;
var<private> clamped: u32;
var<private> unknown: u32;
// Whether the light of the interval's end is known.
var<private> sees: bool;

fn pixels() -> u32 {
    return params.stride * params.height * params.view_count;
}

// `of_view`: where all invocations of a workgroup share it, drivers load once.
fn load_pixel(at: vec2<u32>, of_view: u32) {
    pixel = at;
    view = of_view;
    index = (of_view * params.height + at.y) * params.stride + at.x;
    let words = of_view * VIEW_WORDS;
    threshold_on = bitcast<f32>(views[words]);
    threshold_off = bitcast<f32>(views[words + 1u]);
    steady = bitcast<f32>(views[words + 2u]);
    inverse_reference = bitcast<f32>(views[words + 3u]);
    key = vec2<u32>(views[words + 4u], views[words + 5u]);
    cutoff_rate = bitcast<f32>(views[words + 6u]);
    refractory_us = bitcast<f32>(views[words + 7u]);
    var layer = of_view;
    if (OWN_THRESHOLDS) {
        threshold_on = textureLoad(frozen, pixel, layer).r;
        threshold_off = textureLoad(frozen, pixel, layer + params.view_count).r;
        layer += 2u * params.view_count;
    }
    if (OWN_SLOPES) {
        steady = textureLoad(frozen, pixel, layer).r;
    }
}

fn word(plane: u32, fresh: bool) -> u32 {
    let layer = plane * params.view_count + view;
    if (fresh) {
        return textureLoad(memory_out, pixel, layer).r;
    }
    return textureLoad(memory_in, pixel, layer).r;
}

// `fresh`: from what an earlier dispatch of this submission wrote, whose times count from the base. In the memory of an
// earlier submission they are ages at its end.
fn load_memory(fresh: bool) {
    reference = bitcast<f32>(word(REFERENCE_PLANE, fresh));
    if (INPUT_PLANE != 0u) {
        input = bitcast<f32>(word(INPUT_PLANE, fresh));
    }
    if (FIRST_PLANE != 0u) {
        first = bitcast<f32>(word(FIRST_PLANE, fresh));
    }
    if (SECOND_PLANE != 0u) {
        second = bitcast<f32>(word(SECOND_PLANE, fresh));
    }
    if (LIGHT_PLANE != 0u) {
        light = bitcast<f32>(word(LIGHT_PLANE, fresh));
    }
    if (MOVED_PLANE != 0u) {
        let age = bitcast<i32>(word(MOVED_PLANE, fresh));
        moved = select(-age, age, fresh);
    }
    slope = steady;
    if (SLOPE_PLANE != 0u) {
        slope = bitcast<f32>(word(SLOPE_PLANE, fresh));
    }
    if (FIRED_PLANE != 0u) {
        // The polarity has the two lowest bits.
        let packed = bitcast<i32>(word(FIRED_PLANE, fresh));
        polarity = bitcast<u32>(packed) & 3u;
        let age = packed >> 2u;
        fired = select(-age, age, fresh);
    }
}

fn keep(plane: u32, value: u32) {
    textureStore(memory_out, pixel, plane * params.view_count + view, vec4<u32>(value, 0u, 0u, 0u));
}

// `last`: after this, times become ages at `end`, microseconds since the base.
fn store_memory(last: bool, end: u32) {
    if (MOVED_PLANE != 0u) {
        var age = bitcast<u32>(moved);
        if (last) {
            age = end - bitcast<u32>(moved);
            for (var fold = 0u; fold < 8u && age >= OLD; fold++) {
                // What leaked goes into the reference, before a float loses it.
                reference -= slope * f32(OLD);
                age -= OLD;
            }
        }
        keep(MOVED_PLANE, age);
    }
    keep(REFERENCE_PLANE, bitcast<u32>(reference));
    if (INPUT_PLANE != 0u) {
        keep(INPUT_PLANE, bitcast<u32>(input));
    }
    if (FIRST_PLANE != 0u) {
        keep(FIRST_PLANE, bitcast<u32>(first));
    }
    if (SECOND_PLANE != 0u) {
        keep(SECOND_PLANE, bitcast<u32>(second));
    }
    if (LIGHT_PLANE != 0u) {
        keep(LIGHT_PLANE, bitcast<u32>(light));
    }
    if (SLOPE_PLANE != 0u) {
        keep(SLOPE_PLANE, bitcast<u32>(slope));
    }
    if (FIRED_PLANE != 0u) {
        var age = fired;
        if (last) {
            age = i32(min(end - bitcast<u32>(fired), OLD - 1u));
        }
        keep(FIRED_PLANE, (bitcast<u32>(age) << 2u) | polarity);
    }
}

// A time of the stream, low and high word, `us` microseconds after another one.
fn later(time: vec2<u32>, us: u32) -> vec2<u32> {
    let low = time.x + us;
    return vec2<u32>(low, time.y + select(0u, 1u, low < us));
}

// The interval of `step` instants that ends at `instant`.
fn set_interval(instant: u32, step: u32) {
    let span = span_between(instant + 1u - step, instant);
    start = span.x;
    interval = span.y;
    clock = span.zw;
}
