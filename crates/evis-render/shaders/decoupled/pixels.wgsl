#import decoupled/light.wgsl
#import decoupled/knots.wgsl
// Follows pixels through a block: `PixelPath::walk` of evis-decoupled, and `TileSignal` where light is wanted throughout. In
// each round each pixel that is not at the end is evaluated once, and goes on as far as that tells; those that go on are listed
// for the next round.

// Events that a pixel fires in a round.
const MOST_EVENTS: u32 = 48u;
// Intervals that wait while earlier halves are followed.
const MOST_WAITING: u32 = 12u;
// Words of a pixel between rounds: where light is known up to, what light is wanted for and at which unit, how many intervals
// wait, and the ends and light of those.
const STATE_WORDS: u32 = 28u;
const ERROR_MARGIN: f32 = 4.0;
const RANGE_MARGIN: f32 = 0.5;
const JUMP_US: f32 = 1e-6;
// Light that comes as near to a level as this part of it reaches it: what 32 bits leave of light that returns.
const TIE: f32 = 2e-5;

struct Point {
    t_us: f32,
    luminance: f32,
};

var<private> last: Point;
var<private> before: Point;
var<private> has_before: bool;
var<private> reference_log: f32;
var<private> above: f32;
var<private> below: f32;
var<private> fired: array<u32, MOST_EVENTS>;
var<private> fired_count: u32;

// Where it is counted how many pixels of this class go on in a round.
fn count_at(round: u32) -> u32 {
    return round + CLASS * (ROUNDS + 1u);
}

// Where pixel number `number` of this class is listed in a round.
fn slot_at(round: u32, number: u32) -> u32 {
    return (round % 2u) * batch.pixels + atomicLoad(&events.firsts[CLASS]) + number;
}

fn level_at(log_level: f32) -> f32 {
    return (exp(log_level) - job.log_eps) * job.reference_luminance;
}

fn refer_to(log_level: f32) {
    reference_log = log_level;
    above = level_at(log_level + job.threshold_on);
    below = level_at(log_level - job.threshold_off);
}

fn tie(level: f32) -> f32 {
    return TIE * (level + dark_floor());
}

fn time_of_unit(unit: u32) -> f32 {
    return job.length_us * (f32(unit) / f32(UNITS));
}

fn fire(t_us: f32, on: bool) {
    if (fired_count == MOST_EVENTS) {
        failed = true;
        return;
    }
    fired[fired_count] = (u32(max(floor(job.start_us + t_us), 0.0)) << 1u) | select(0u, 1u, on);
    fired_count += 1u;
}

// The time in [from, to], a monotone part whose ends lie on either side of `level`, at which start + t (slope + t bend) is there.
fn time_of_level(level: f32, start: f32, slope: f32, bend: f32, from_t: f32, to_t: f32) -> f32 {
    let beneath = start - level;
    let root = sqrt(max(slope * slope - 4.0 * bend * beneath, 0.0));
    let q = -0.5 * (slope + select(-root, root, slope >= 0.0));
    var one = from_t;
    var off_one = 3.0e38;
    if (q != 0.0) {
        one = beneath / q;
        off_one = abs(one - clamp(one, from_t, to_t));
    }
    if (bend != 0.0) {
        let other = q / bend;
        let off = abs(other - clamp(other, from_t, to_t));
        if (off < off_one) {
            one = other;
        }
    }
    return clamp(one, from_t, to_t);
}

// Fires where light that goes from `start` to `end` crosses thresholds; `bend` is its second divided difference.
fn cross_levels(start: Point, end: Point, bend: f32) {
    let span = end.t_us - start.t_us;
    let slope = (end.luminance - start.luminance) / span - bend * span;
    var middle = span;
    if (bend != 0.0) {
        let vertex = -slope / (2.0 * bend);
        if (vertex > 0.0 && vertex < span) {
            middle = vertex;
        }
    }
    var from_t = 0.0;
    // Monotone parts: up to the vertex, and from it on.
    for (var part = 0u; part < 2u; part++) {
        let to_t = select(span, middle, part == 0u);
        if (to_t <= from_t) {
            continue;
        }
        var goal = end.luminance;
        if (to_t != span) {
            goal = start.luminance + to_t * (slope + bend * to_t);
        }
        var at = from_t;
        while (!failed) {
            let up = goal >= above - tie(above);
            // Levels below zero are never reached but for rounding: a polynomial may be negative, light is not.
            if (!up && !(goal <= below + tie(below) && below > -tie(0.0))) {
                break;
            }
            at = time_of_level(select(below, above, up), start.luminance, slope, bend, at, to_t);
            fire(start.t_us + at, up);
            refer_to(reference_log + select(-job.threshold_off, job.threshold_on, up));
        }
        from_t = to_t;
    }
}

// Second divided difference of three points.
fn bend_of(a: Point, b: Point, c: Point) -> f32 {
    let ab = (b.luminance - a.luminance) / (b.t_us - a.t_us);
    let bc = (c.luminance - b.luminance) / (c.t_us - b.t_us);
    return (bc - ab) / (c.t_us - a.t_us);
}

// Light to cross levels on: from `start` to `end`, with its second divided difference.
struct Piece {
    start: Point,
    end: Point,
    bend: f32,
};

var<private> pieces: array<Piece, 2>;
var<private> piece_count: u32;

// Makes pieces of light up to `end`; false where the interval must be halved.
fn follow_interval(middle: Point, end: Point, may_halve: bool) -> bool {
    let quadratic = bend_of(last, middle, end);
    let h = 0.5 * (end.t_us - last.t_us);
    var third = 0.0;
    var error = 0.5 * h * h * abs(quadratic);
    if (has_before) {
        third = (quadratic - bend_of(before, last, middle)) / (end.t_us - before.t_us);
        error = 0.385 * h * h * h * abs(third);
    }
    // Extremes of the quadratic.
    var low = min(last.luminance, min(middle.luminance, end.luminance));
    var high = max(last.luminance, max(middle.luminance, end.luminance));
    let slope = (middle.luminance - last.luminance) / h - quadratic * h;
    if (quadratic != 0.0) {
        let vertex = -slope / (2.0 * quadratic);
        if (vertex > 0.0 && vertex < 2.0 * h) {
            let v = last.luminance + vertex * (slope + quadratic * vertex);
            low = min(low, v);
            high = max(high, v);
        }
    }
    let scale = max(low, 0.0) + dark_floor();
    let margin = ERROR_MARGIN * error + RANGE_MARGIN * (high - low);
    let reached = high + margin >= above || low - margin <= below;
    if (reached && error > TOLERANCE * scale && may_halve) {
        return false;
    }
    // The cubic is the quadratic and third t (t - m) (t - l), which is bent by this in either half.
    let m = middle.t_us - last.t_us;
    let l = end.t_us - last.t_us;
    pieces[0] = Piece(last, middle, quadratic - third * (l - 0.5 * m));
    pieces[1] = Piece(middle, end, quadratic + third * 0.5 * (m + l));
    piece_count = 2u;
    return true;
}

fn straight_to(end: Point) {
    pieces[0] = Piece(last, end, 0.0);
    piece_count = 1u;
}

// What light is wanted for.
const AT_START: u32 = 0u;
const AT_GOAL: u32 = 1u;
const AT_MIDDLE: u32 = 2u;
const AT_CUT: u32 = 3u;
// An interval of one unit has no middle.
const AT_END: u32 = 4u;

// Where light is known up to, what it is wanted for next and at which unit, and how many intervals wait.
var<private> at: u32;
var<private> wanted: u32;
var<private> unit: u32;
var<private> waiting: u32;
// It is at the end of the block.
var<private> done: bool;

// Fires what light that is found at `unit` tells, and goes on; ends of intervals wait in pairs of words of `scratch` from `ends` on.
fn go_along_levels(pixel: Pixel, found: Point, ends: u32) {
    let alone = (job.flags & LIGHT_ALONE) != 0u;
    let is_cut = job.length_us <= INSTANT_US;
    let step = 2u * pixel.stride;
    let top = ends + 2u * (max(waiting, 1u) - 1u);
    var goal = found;
    if (wanted == AT_START) {
        if ((pixel.memory.flags & BEGINS) != 0u) {
            refer_to(log(found.luminance / job.reference_luminance + job.log_eps));
        } else if ((job.flags & JUMPS) != 0u && !alone) {
            straight_to(Point(JUMP_US, found.luminance));
        }
        has_before = false;
        // Nothing else of a still pixel changes.
        done = alone || (pixel.stride == 0u && !is_cut);
    } else if (wanted == AT_CUT) {
        straight_to(found);
        has_before = false;
        done = true;
    } else if (wanted == AT_END) {
        straight_to(found);
        before = last;
        has_before = true;
        at = unit;
        waiting -= 1u;
    } else if (wanted == AT_GOAL) {
        scratch[top] = unit;
        scratch[top + 1u] = bitcast<u32>(found.luminance);
        goal = last;
        waiting = 1u;
    } else {
        let goal_unit = scratch[top];
        goal = Point(time_of_unit(goal_unit), bitcast<f32>(scratch[top + 1u]));
        if (follow_interval(found, goal, goal_unit - at > 2u * pixel.least)) {
            before = found;
            has_before = true;
            at = goal_unit;
            waiting -= 1u;
        } else if (waiting == MOST_WAITING) {
            failed = true;
        } else {
            scratch[top + 2u] = unit;
            scratch[top + 3u] = bitcast<u32>(found.luminance);
            goal = last;
            waiting += 1u;
        }
    }
    for (var k = 0u; k < piece_count; k++) {
        cross_levels(pieces[k].start, pieces[k].end, pieces[k].bend);
    }
    last = goal;

    if (wanted == AT_START) {
        wanted = select(AT_GOAL, AT_CUT, is_cut);
        unit = select(step, UNITS, is_cut);
    } else if (waiting == 0u) {
        done = done || at == UNITS;
        wanted = AT_GOAL;
        unit = at + step;
    } else {
        let goal_unit = scratch[ends + 2u * (waiting - 1u)];
        let half = (goal_unit - at) / 2u;
        wanted = select(AT_MIDDLE, AT_END, half == 0u);
        unit = select(at + half, goal_unit, half == 0u);
    }
}

// Keeps light that is found at `unit`, and goes on.
fn go_along_knots(pixel: Pixel, found: Point) {
    last = found;
    if (wanted == AT_START) {
        put_light(0u, found.luminance);
        done = pixel.stride == 0u;
        at = 1u;
        wanted = AT_KNOT;
    } else {
        let next = take_knot(at, wanted, found.luminance);
        at = next.at;
        wanted = next.wanted;
        done = next.done;
        if (done) {
            last.luminance = knot(intervals);
        }
    }
    unit = unit_of_knot(pixel, at, wanted);
}

fn follow_pixel(index: u32, pixel: Pixel) {
    let state = 2u * batch.pixels + index * STATE_WORDS;
    let alone = (job.flags & LIGHT_ALONE) != 0u;
    let senses = (job.flags & SENSES) != 0u && !alone;
    let jumps = (job.flags & JUMPS) != 0u && !alone;
    let is_cut = job.length_us <= INSTANT_US;
    if (senses) {
        enter_knots(pixel);
    }
    if (turn.first == 0u) {
        at = scratch[state];
        wanted = scratch[state + 1u];
        unit = scratch[state + 2u];
        waiting = scratch[state + 3u];
    } else if (jumps || alone || (!senses && (pixel.memory.flags & (RESTED | BEGINS)) != 0u)) {
        wanted = AT_START;
        unit = select(0u, job.number, alone);
    } else if (senses) {
        put_light(0u, pixel.memory.last);
        at = 1u;
        wanted = AT_KNOT;
        unit = pixel.stride;
    } else {
        wanted = select(AT_GOAL, AT_CUT, is_cut);
        unit = select(2u * pixel.stride, UNITS, is_cut);
    }
    last = Point(time_of_unit(select(at, 0u, senses)), pixel.memory.last);
    before = Point(pixel.memory.before_us, pixel.memory.before);
    has_before = (pixel.memory.flags & HAS_BEFORE) != 0u;
    reference_log = pixel.memory.log;
    above = pixel.memory.above;
    below = pixel.memory.below;
    fired_count = 0u;
    piece_count = 0u;

    let found = Point(time_of_unit(unit), light_at(pixel.own, pixel.own_count, f32(unit) / f32(UNITS)));
    if (senses) {
        go_along_knots(pixel, found);
    } else {
        go_along_levels(pixel, found, state + 4u);
    }
    scratch[state] = at;
    scratch[state + 1u] = wanted;
    scratch[state + 2u] = unit;
    scratch[state + 3u] = waiting;

    if (fired_count > 0u && !failed) {
        // Where its events begin depends on who comes first; those of one pixel are in order.
        let first = atomicAdd(&events.used, fired_count);
        failed = first + fired_count > batch.capacity;
        for (var k = 0u; k < fired_count && !failed; k++) {
            events.fired[first + k] = Event(index, fired[k]);
        }
    }
    failed = failed || !loops_run(pixel.own_count + 2u);
    let flags = select(0u, HAS_BEFORE, has_before);
    let memory =
        Memory(last.luminance, before.t_us, before.luminance, reference_log, above, below, flags, job.number);
    pixels[index].memory = memory;
    pixels[index].evaluations = pixel.evaluations + 1u;
    pixels[index].failed = select(0u, 1u, failed);
    if (!done && !failed) {
        let next = atomicAdd(&events.going_on[count_at(turn.round + 1u)], 1u);
        scratch[slot_at(turn.round + 1u, next)] = index;
        if (next % 64u == 0u) {
            atomicAdd(&events.groups[groups_at(turn.round + 1u, CLASS)], 1u);
        }
    } else if (is_of_tile) {
        leave(index, memory, pixel.evaluations + 1u);
    }
}

// Keeps what a pixel of a tile remembers at the end of the block, evaluated so often, or gives it back as it was before.
fn leave(index: u32, memory: Memory, evaluations: u32) {
    if ((job.flags & LIGHT_ALONE) != 0u) {
        scratch[batch.light + index - batch.given] = bitcast<u32>(select(last.luminance, NOT_FOUND, failed));
    } else if (failed) {
        give_back(index);
    } else {
        var kept = memory;
        kept.before_us -= job.length_us;
        remember(memory_of(index), kept);
        atomicAdd(&events.evaluations, evaluations);
    }
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let slot = group.x * 64u + local;
    if (slot >= atomicLoad(&events.going_on[count_at(turn.round)])) {
        return;
    }
    let index = scratch[slot_at(turn.round, slot)];
    let pixel = pixels[index];
    enter_row(pixel.bases);
    centre = pixel.centre;
    if (is_bent()) {
        enter_frame(base.points + pixel.frame);
    }
    number = pixel.number;
    is_of_tile = index >= batch.given;
    failed = false;
    follow_pixel(index, pixel);
}
