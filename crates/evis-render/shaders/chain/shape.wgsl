#import chain/response.wgsl
// What the signal does between two samples, and when it leaves the band between two levels. All is counted from the
// signal at the start: a float has too few digits for levels and their differences at once. Twin: shape.rs
// of evis_core's emulator.

// Time constants per microsecond; its inverse.
var<private> shape_rate: f32;
var<private> shape_tau: f32;
// The signal at the start, and the slope of its input.
var<private> shape_base: f32;
var<private> shape_slope: f32;
// Of the poles behind the input, at the start.
var<private> shape_behind: f32;
var<private> shape_behind_second: f32;

fn begin_shape() {
    shape_base = output();
    if (FILTER <= 1u) {
        shape_slope = (next_output() - shape_base) / f32(interval);
        return;
    }
    shape_slope = (next_input - input) / f32(interval);
    shape_rate = filter_rate();
    shape_tau = 1.0 / shape_rate;
    shape_behind = first - input;
    shape_behind_second = second - input;
}

// What the signal has risen by, `t` microseconds after the start.
fn rise_at(t: f32) -> f32 {
    if (FILTER <= 1u) {
        return shape_slope * t;
    }
    let u = t * shape_rate;
    let share = follows(u);
    if (FILTER == 2u) {
        return shape_slope * t * share.x - shape_behind * share.w;
    }
    return shape_slope * t * share.y + (shape_behind * u * share.z - shape_behind_second * share.w);
}

// The signal.
fn shape_at(t: f32) -> f32 {
    return shape_base + rise_at(t);
}

// Two poles: their slope less `target` times tau, up to a constant factor; it turns once.
fn bend(t: f32, a: f32, b: f32, aim: f32) -> f32 {
    let u = t * shape_rate;
    return (a - b - a * u) * precise_exp(-u) - aim;
}

// Where `bend` is 0 between `low` and `high`, by halving; beyond `high` where its sign stays.
fn bend_root(low: f32, high: f32, a: f32, b: f32, aim: f32) -> f32 {
    var left = low;
    var right = high;
    let rising = bend(left, a, b, aim) < 0.0;
    if (left >= right || rising == (bend(right, a, b, aim) < 0.0)) {
        return 3.0e38;
    }
    for (var i = 0u; i < 24u && right - left > 0.02; i++) {
        let middle = 0.5 * (left + right);
        if ((bend(middle, a, b, aim) < 0.0) == rising) {
            left = middle;
        } else {
            right = middle;
        }
    }
    return right;
}

// Instants within (low, high) at which the slope of signal + drift t changes sign, rising; 3e38 for none.
fn turns(drift: f32, low: f32, high: f32) -> vec2<f32> {
    var found = vec2<f32>(3.0e38);
    if (FILTER <= 1u) {
        return found;
    }
    // In units of the signal per time constant.
    let aim = (shape_slope + drift) * shape_tau;
    let a = shape_behind + shape_slope * shape_tau;
    if (FILTER == 2u) {
        let ratio = aim / a;
        if (abs(a) > 0.0 && ratio > 1e-30 && ratio < 1e30) {
            let t = -shape_tau * precise_ln(ratio);
            found.x = select(found.x, t, t > low && t < high);
        }
        return found;
    }
    let b = shape_behind_second + 2.0 * shape_slope * shape_tau;
    var middle = low;
    if (abs(a) > 1e-30) {
        middle = clamp(shape_tau * (2.0 - b / a), low, high);
    }
    let early = bend_root(low, middle, a, b, -aim);
    let late = bend_root(middle, high, a, b, -aim);
    return vec2<f32>(min(early, late), max(early, late));
}

// Where rise + drift t - level is 0 between `low` and `high`, at which it has the values `f_low` and `f_high` of two
// signs: the Illinois method (Dowell & Jarratt, BIT 11, 1971), within a fiftieth of a microsecond.
fn level_root(drift: f32, level: f32, low: f32, f_low: f32, high: f32, f_high: f32) -> f32 {
    var a = low;
    var fa = f_low;
    var b = high;
    var fb = f_high;
    var last = a;
    for (var i = 0u; i < 60u && b - a >= 0.02; i++) {
        let secant = (a * fb - b * fa) / (fb - fa);
        // A late halving now and then, so that no shape can hold the method up.
        var middle = 0.5 * (a + b);
        if (i % 10u != 9u && secant > a && secant < b) {
            middle = secant;
        }
        if (abs(middle - last) < 0.02) {
            return middle;
        }
        let same_side = middle >= last;
        let fm = rise_at(middle) + drift * middle - level;
        if (fm == 0.0) {
            return middle;
        }
        last = middle;
        if ((fm < 0.0) == (fb < 0.0)) {
            b = middle;
            fb = fm;
            fa *= select(1.0, 0.5, i > 0u && !same_side);
        } else {
            a = middle;
            fa = fm;
            fb *= select(1.0, 0.5, i > 0u && same_side);
        }
    }
    return b;
}

struct Leaving {
    // 0 never, 1 at the upper level, 2 at the lower one.
    side: u32,
    t: f32,
};

// First instant in [from, to] at which rise + drift t is at least `high` or at most `low`. Each monotone piece is
// asked for its ends, so that nothing can fall between two pieces.
fn leaves(drift: f32, low: f32, high: f32, begin: f32, end: f32) -> Leaving {
    var left = begin;
    var value_left = rise_at(left) + drift * left;
    if (value_left >= high) {
        return Leaving(1u, left);
    }
    if (value_left <= low) {
        return Leaving(2u, left);
    }
    let bends = turns(drift, begin, end);
    for (var i = 0u; i < 3u; i++) {
        var right = end;
        if (i == 0u && bends.x < end) {
            right = bends.x;
        } else if (i <= 1u && bends.y < end && bends.y > left) {
            right = bends.y;
        }
        let value = rise_at(right) + drift * right;
        if (value >= high || value <= low) {
            let level = select(low, high, value >= high);
            let side = select(2u, 1u, value >= high);
            if (FILTER <= 1u) {
                return Leaving(side, clamp(level / (shape_slope + drift), begin, end));
            }
            return Leaving(side, level_root(drift, level, left, value_left - level, right, value - level));
        }
        if (right >= end) {
            break;
        }
        left = right;
        value_left = value;
    }
    return Leaving(0u, 0.0);
}
