#import splat/layout.wgsl
// Adds each placed pixel's light to the four pixels around it: bilinear weight times a softmax over inverse depth, from
// which the largest at that pixel is subtracted. All sums are of integers. Twin: cpu/splat.rs, accumulate.

override FILL_HOLES: bool = false;
// Sources that one invocation adds up: neighbours share two of their four pixels, so that a sum of the two goes out at
// once. Sums of integers: any number gives the same.
override RUN: u32 = 1;

// As in place.wgsl.
@group(0) @binding(1) var sources: texture_2d_array<f32>;
@group(0) @binding(2) var<storage, read> largest: array<u32>;
@group(0) @binding(3) var<storage, read> placed: array<u32>;
// Planes of a side: depth keys, weight, light, carries of the light.
@group(0) @binding(4) var<storage, read_write> sums: array<atomic<u32>>;

// Weights, and light in its two halves, for the upper and the lower pixel of a column.
struct Column {
    at: vec2<i32>,
    weight: vec2<u32>,
    low: vec2<u32>,
    high: vec2<u32>,
};

const FAR_AWAY: vec2<i32> = vec2<i32>(-1048576, -1048576);

fn add(at: u32, weight: u32, low: u32, high: u32) {
    let plane = target_pixels();
    atomicAdd(&sums[plane + at], weight);
    let light = low + (high << LIGHT_HALF_BITS);
    var carry = (high >> (32u - LIGHT_HALF_BITS)) + u32(light < low);
    let before = atomicAdd(&sums[2u * plane + at], light);
    // The sum of 64 bits is exact in any order: it wraps as often as it passes a multiple of 2^32.
    carry += u32(before > 0xffffffffu - light);
    if (carry != 0u) {
        atomicAdd(&sums[3u * plane + at], carry);
    }
}

fn flush(column: Column, view: u32) {
    let first = sums_base(params.side) + (view * params.height + u32(max(column.at.y, 0))) * params.width
        + u32(max(column.at.x, 0));
    if (column.weight.x != 0u) {
        add(first, column.weight.x, column.low.x, column.high.x);
    }
    if (column.weight.y != 0u) {
        // Above the picture only the lower pixel is in it.
        let below = select(first + params.width, first, column.at.y < 0);
        add(below, column.weight.y, column.low.y, column.high.y);
    }
}

// Weight of a source at one pixel; 0 outside, and where another side needs none.
fn weight_at(p: vec2<i32>, bilinear: u32, nearness: f32, sharpness: f32, view: u32) -> u32 {
    if (bilinear == 0u || p.x < 0 || p.y < 0 || p.x >= i32(params.width) || p.y >= i32(params.height)) {
        return 0u;
    }
    let at = (view * params.height + u32(p.y)) * params.width + u32(p.x);
    if (FILL_HOLES) {
        let there = atomicLoad(&sums[sums_base(1u - params.side) + target_pixels() + at]);
        if (f32(there) >= HOLE_WEIGHT) {
            return 0u;
        }
    }
    let front = nearness_of(atomicLoad(&sums[sums_base(params.side) + at]));
    let importance = exp(min(nearness - front, 0.0) * sharpness);
    return u32(f32(bilinear) * WEIGHT_UNIT * importance + 0.5);
}

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let canvas = canvas_pixels();
    let layer = key_layer(params.side, id.z);
    // A power of two, and so is what turns it around: no digit is lost.
    let per_scale = bitcast<f32>((254u << 23u) - bitcast<u32>(light_scale(largest[layer * 2u])));
    let sharpness = SHARPNESS / max(bitcast<f32>(largest[layer * 2u + 1u]), 1e-30);
    let end = min((id.x + 1u) * RUN, params.canvas_width);
    var pending = Column(FAR_AWAY, vec2<u32>(0u), vec2<u32>(0u), vec2<u32>(0u));
    for (var x = id.x * RUN; x < end; x++) {
        let source_at = params.side * 3u * canvas + canvas_index(vec2<u32>(x, id.y), id.z);
        let key = placed[source_at + 2u * canvas];
        if (key == KEY_OF_NOTHING) {
            continue;
        }
        let taps = taps_at(position(vec2<u32>(placed[source_at], placed[source_at + canvas])));
        let nearness = nearness_of(key);
        let luminance = textureLoad(sources, vec2<u32>(x, id.y), layer, 0).r;
        let halves = min(luminance, params.brightest) * per_scale * LIGHT_HALF;
        let high = u32(halves);
        let low = u32((halves - f32(high)) * LIGHT_HALF + 0.5);
        let left = vec2<u32>(
            weight_at(taps.base, taps.weights.x, nearness, sharpness, id.z),
            weight_at(taps.base + vec2<i32>(0, 1), taps.weights.z, nearness, sharpness, id.z));
        let right = vec2<u32>(
            weight_at(taps.base + vec2<i32>(1, 0), taps.weights.y, nearness, sharpness, id.z),
            weight_at(taps.base + vec2<i32>(1, 1), taps.weights.w, nearness, sharpness, id.z));
        var column = Column(taps.base, left, left * low, left * high);
        if (all(pending.at == taps.base)) {
            column.weight += pending.weight;
            column.low += pending.low;
            column.high += pending.high;
        } else {
            flush(pending, id.z);
        }
        flush(column, id.z);
        pending = Column(taps.base + vec2<i32>(1, 0), right, right * low, right * high);
    }
    flush(pending, id.z);
}
