#import decoupled/layout.wgsl
// A pixel's light throughout a block, for sensors with more stages than thresholds and those that take frames: evaluated at
// knots, then in the middle of two and at the quarters where a cubic misses it. Twin: `signal/knots.rs` of evis-decoupled.

// As there.
const PARTS: u32 = 4u;
const KNOT_TOLERANCE: f32 = 0.002;

// Word of `scratch` at which its light begins: at the start, then at the end of each part.
var<private> own_light: u32;
// Intervals between knots, and parts of each.
var<private> intervals: u32;
var<private> interval_parts: u32;

// How many parts intervals of `stride` units have, which begin at whole units.
fn parts_of(stride: u32) -> u32 {
    return select(select(1u, 2u, stride % 2u == 0u), PARTS, stride % PARTS == 0u);
}

fn enter_knots(pixel: Pixel) {
    own_light = base.light + pixel.least;
    intervals = UNITS / max(pixel.stride, 1u);
    interval_parts = select(parts_of(pixel.stride), 1u, job.length_us <= INSTANT_US);
}

fn put_light(place: u32, luminance: f32) {
    scratch[own_light + place] = bitcast<u32>(luminance);
}

fn knot(number: u32) -> f32 {
    return bitcast<f32>(scratch[own_light + number * interval_parts]);
}

// The cubic through four knots, between the second and the third.
struct Curve {
    knots: vec4<f32>,
    // About how far the quadratic through three of them is off in the middle.
    error: f32,
};

// Between knot `k` and the next one; at either end of the block, the quadratic of the three that there are.
fn curve_about(k: u32) -> Curve {
    let a = knot(k);
    let b = knot(k + 1u);
    let has_before = k > 0u;
    let has_after = k + 1u < intervals;
    var p = 2.0 * a - b;
    var q = 2.0 * b - a;
    if (has_before) {
        p = knot(k - 1u);
        q = 3.0 * b - 3.0 * a + p;
    }
    if (has_after) {
        q = knot(k + 2u);
        if (!has_before) {
            p = 3.0 * a - 3.0 * b + q;
        }
    }
    // Of three knots, how far the line between two is off bounds it.
    var error = abs(b - a) / 8.0;
    if (has_before && has_after) {
        error = abs(q - 3.0 * b + 3.0 * a - p) / 16.0;
    } else if (has_before) {
        error = abs(a - 2.0 * b + q) / 8.0;
    } else if (has_after) {
        error = abs(p - 2.0 * a + b) / 8.0;
    }
    return Curve(vec4<f32>(p, a, b, q), error);
}

fn curve_at(curve: Curve, u: f32) -> f32 {
    let v = u - 1.0;
    let w = u - 2.0;
    let x = u + 1.0;
    return dot(vec4<f32>(-u * v * w / 6.0, x * v * w / 2.0, -x * u * w / 2.0, x * u * v / 6.0), curve.knots);
}

// Ends of the parts within interval `k`, but for its middle where that was evaluated (`halved`).
fn fill_parts(k: u32, curve: Curve, halved: bool) {
    for (var part = 1u; part < interval_parts; part++) {
        if (!(halved && part == 2u)) {
            put_light(k * interval_parts + part, curve_at(curve, f32(part) / f32(interval_parts)));
        }
    }
}

// Whether light in the middle of interval `k` must be evaluated.
fn needs_middle(curve: Curve) -> bool {
    let least = max(min(curve.knots.y, curve.knots.z), 0.0);
    return interval_parts == PARTS && curve.error > KNOT_TOLERANCE * (least + dark_floor());
}

// What light is wanted for: knot `at` of the block, or in interval `at` its middle and its quarters.
const AT_KNOT: u32 = 5u;
const AT_HALF: u32 = 6u;
const AT_QUARTER: u32 = 7u;
const AT_LAST_QUARTER: u32 = 8u;

fn unit_of_knot(pixel: Pixel, at: u32, wanted: u32) -> u32 {
    var quarters = select(0u, 1u, wanted == AT_QUARTER);
    quarters = select(quarters, 2u, wanted == AT_HALF);
    quarters = select(quarters, 3u, wanted == AT_LAST_QUARTER);
    return at * pixel.stride + quarters * (pixel.stride / 4u);
}

// What is wanted next, and where.
struct Next {
    at: u32,
    wanted: u32,
    done: bool,
};

// Goes on once light is known where it was wanted.
fn take_knot(at: u32, wanted: u32, found: f32) -> Next {
    var k = at;
    if (wanted == AT_KNOT) {
        put_light(at * interval_parts, found);
        if (at < intervals) {
            return Next(at + 1u, AT_KNOT, false);
        }
        k = 0u;
    } else if (wanted == AT_HALF) {
        put_light(at * interval_parts + 2u, found);
        let curve = curve_about(at);
        if (abs(found - curve_at(curve, 0.5)) > KNOT_TOLERANCE * (found + dark_floor())) {
            return Next(at, AT_QUARTER, false);
        }
        fill_parts(at, curve, true);
        k = at + 1u;
    } else if (wanted == AT_QUARTER) {
        put_light(at * interval_parts + 1u, found);
        return Next(at, AT_LAST_QUARTER, false);
    } else {
        put_light(at * interval_parts + 3u, found);
        k = at + 1u;
    }
    for (; k < intervals; k++) {
        let curve = curve_about(k);
        if (needs_middle(curve)) {
            return Next(k, AT_HALF, false);
        }
        fill_parts(k, curve, false);
    }
    return Next(k, AT_KNOT, true);
}
