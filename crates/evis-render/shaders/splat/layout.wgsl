// Shared by the splat passes. Twins: gpu/uniforms.rs (structs), pass/splat.rs (constants), cpu/splat.rs (algorithms).

// Invocations per workgroup, along a row.
const SPLAT_WORKGROUP: u32 = 64u;
// Positions are whole multiples of 1 / SUBPIXELS of a pixel: integers, so that sums do not depend on their order.
const SUBPIXELS: i32 = 1024;
// Depth of a point at infinity; 0 means empty.
const KEY_OF_NOTHING: u32 = 0u;

// Depths at least this part of one another are taken for one surface.
const SAME_SURFACE: f32 = 0.95;

// One instant, seen from one of its two keyframes.
struct SplatParams {
    // Target: the sensor's pixels.
    width: u32,
    height: u32,
    // Keyframe: the target with a margin all around.
    canvas_width: u32,
    canvas_height: u32,
    margin: u32,
    view_count: u32,
    // Row of `transforms` of view 0; each view has `objects` + 1, three rows each.
    transform_base: u32,
    objects: u32,
    // 0: the older keyframe, which moves forward; 1: the newer one, which moves back.
    side: u32,
    // Which half of the keyframe buffers this side has; the other side has the other half.
    slot: u32,
    // Part of the way to the other keyframe.
    moved: f32,
    // The same from the older keyframe, whatever the side.
    elapsed: f32,
    // Layer of view 0 at this instant, and from a view to the next.
    first_layer: u32,
    layers_per_view: u32,
    // Bits of a splatted index; the rest of its word is how near it came.
    index_bits: u32,
    // Added to luminance before a logarithm is taken.
    log_floor: f32,
    // Light above this counts as this for colours, in keyframes and between them: one glint must not take the steps of all
    // others.
    brightest: f32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
};

@group(0) @binding(0) var<uniform> params: SplatParams;

// Full weight. Light has 38 bits below the scale, in two halves of 19, so that the sum of two products of a half and a weight
// fits 32 bits: beside a lamp, what is a thousand million times darker is told apart. Sums of 64 bits hold 16 000 whole pixels.
const WEIGHT_STEPS: f32 = 4096.0;
const LIGHT_HALF_BITS: u32 = 19u;
const LIGHT_HALF: f32 = 524288.0;
// Weights are products of a bilinear part of 1 / 2^20 each.
const WEIGHT_UNIT: f32 = 0.00390625;

fn nearness_of(key: u32) -> f32 {
    return bitcast<f32>(key - 1u);
}

// A power of two above the brightest light of a keyframe: it seldom changes from one to the next.
fn light_scale(bits: u32) -> f32 {
    let within = clamp(bits, 0x00800000u, max(bitcast<u32>(params.brightest), 0x00800000u));
    return bitcast<f32>(((within >> 23u) + 1u) << 23u);
}

// As the EVIS paper publishes it: linear motion, colours, the older keyframe in the newer one's holes, black where neither
// shows anything. Else the nearest surface of both, by the matrices of objects, and unknown where neither shows anything.
override EVIS_PAPER: bool = false;

// Of the paper: sharpness of the softmax, and the splatted weight below which a pixel is a hole.
const SHARPNESS: f32 = 12.0;
const HOLE_WEIGHT: f32 = 1e-4 * WEIGHT_STEPS;

// Luminance of a pixel; below 0: unknown.
fn known_or_black(luminance: f32) -> f32 {
    return select(select(-1.0, 0.0, EVIS_PAPER), luminance, luminance >= 0.0);
}

// The layer that a view's instant goes to.
fn target_layer(view: u32) -> u32 {
    return params.first_layer + view * params.layers_per_view;
}

fn target_pixels() -> u32 {
    return params.width * params.height * params.view_count;
}

fn canvas_pixels() -> u32 {
    return params.canvas_width * params.canvas_height * params.view_count;
}

// Index of a keyframe pixel within one side's part of a buffer.
fn canvas_index(p: vec2<u32>, view: u32) -> u32 {
    return (view * params.canvas_height + p.y) * params.canvas_width + p.x;
}

// Layer of a view's keyframe on `side`, and its entry in per-view buffers.
fn key_layer(side: u32, view: u32) -> u32 {
    return select(1u - params.slot, params.slot, side == params.side) * params.view_count + view;
}

// The four pixels around a position, and the area that each has of a pixel put there, in 1 / SUBPIXELS².
struct Taps {
    base: vec2<i32>,
    weights: vec4<u32>,
};

fn taps_at(q: vec2<i32>) -> Taps {
    let base = q >> vec2<u32>(10u);
    let f = vec2<u32>(q & vec2<i32>(SUBPIXELS - 1));
    let g = vec2<u32>(u32(SUBPIXELS)) - f;
    return Taps(base, vec4<u32>(g.x * g.y, f.x * g.y, g.x * f.y, f.x * f.y));
}

// A position with a bit below each coordinate: whether the source reaches beyond the pixel that its centre is in.
fn packed(q: vec2<i32>, reaches: vec2<bool>) -> vec2<u32> {
    return bitcast<vec2<u32>>(q * 2 + select(vec2<i32>(0), vec2<i32>(1), reaches));
}

fn position(place: vec2<u32>) -> vec2<i32> {
    return bitcast<vec2<i32>>(place) >> vec2<u32>(1u);
}

// Whether a position is nearer to the second of the two pixels around it, along each axis.
fn leans(q: vec2<i32>) -> vec2<bool> {
    return (q & vec2<i32>(SUBPIXELS - 1)) >= vec2<i32>(SUBPIXELS / 2);
}

// The pixels that a placed source reaches: the others have no weight.
fn reached(place: vec2<u32>) -> Taps {
    let q = position(place);
    let beyond = (place & vec2<u32>(1u)) != vec2<u32>(0u);
    let second = beyond | leans(q);
    let first = beyond | !leans(q);
    let wanted = vec4<bool>(first.x, second.x, first.x, second.x) & vec4<bool>(first.y, first.y, second.y, second.y);
    let taps = taps_at(q);
    return Taps(taps.base, select(vec4<u32>(0u), taps.weights, wanted));
}

// Target pixels that share a flag "some of these are holes", along each axis.
const HOLE_TILE: u32 = 16u;

fn hole_tile(p: vec2<i32>, view: u32) -> u32 {
    let tiles = (vec2<u32>(params.width, params.height) + HOLE_TILE - 1u) / HOLE_TILE;
    let inside = clamp(p, vec2<i32>(0), vec2<i32>(i32(params.width) - 1, i32(params.height) - 1));
    let tile = vec2<u32>(inside) / HOLE_TILE;
    return (view * tiles.y + tile.y) * tiles.x + tile.x;
}

// Which planes of sums a side has: depth keys, then what the splat adds up.
const SUM_PLANES: u32 = 4u;

fn sums_base(side: u32) -> u32 {
    return side * SUM_PLANES * target_pixels();
}

// Index of tap `i` (x fastest) in a plane of the target; `outside` where there is none.
fn tap_index(taps: Taps, i: u32, view: u32, outside: u32) -> u32 {
    let p = taps.base + vec2<i32>(i32(i & 1u), i32(i >> 1u));
    if (p.x < 0 || p.y < 0 || p.x >= i32(params.width) || p.y >= i32(params.height)) {
        return outside;
    }
    return (view * params.height + u32(p.y)) * params.width + u32(p.x);
}
