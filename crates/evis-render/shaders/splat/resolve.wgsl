#import splat/layout.wgsl
// What the two keyframes say of each pixel, and one luminance from it. Twin: cpu/splat.rs, resolve.

@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var forward: texture_2d_array<f32>;
@group(0) @binding(3) var<storage, read> placed: array<u32>;
@group(0) @binding(4) var<storage, read> largest: array<u32>;
@group(0) @binding(5) var layers: texture_storage_2d_array<r32float, write>;

// What a keyframe shows at a pixel; luminance below 0: nothing.
struct Seen {
    luminance: f32,
    nearness: f32,
};

const UNSEEN: f32 = -1.0;

fn decoded(weight: u32, low: u32, high: u32, scale: f32) -> f32 {
    if (f32(weight) < HOLE_WEIGHT) {
        return UNSEEN;
    }
    let light = f32(high) * 4294967296.0 + f32(low);
    // Beyond the scale only where more pixels met at one than its weight can count.
    return min(light / f32(weight) * (1.0 / LIGHT_HALF) * (1.0 / LIGHT_HALF) * scale, scale);
}

// Light of the splatted source, read between its keyframe's pixels as far from it as the pixel is from where it is now.
fn gathered(p: vec2<u32>, view: u32, side: u32, word: u32) -> f32 {
    let number = word & ((1u << params.index_bits) - 1u);
    let source = vec2<i32>(i32(number % params.canvas_width), i32(number / params.canvas_width));
    let canvas = canvas_pixels();
    let index = canvas_index(vec2<u32>(source), view);
    let at = side * 3u * canvas + index;
    let q = position(vec2<u32>(placed[at], placed[at + canvas]));
    let offset = vec2<f32>(vec2<i32>(p) * SUBPIXELS - q) * (1.0 / f32(SUBPIXELS));
    let base = vec2<i32>(floor(offset));
    let f = offset - floor(offset);
    let layer = key_layer(side, view);
    let own = textureLoad(forward, vec2<u32>(source), layer, 0).xy;
    let most = vec2<i32>(i32(params.canvas_width) - 1, i32(params.canvas_height) - 1);
    var sum = 0.0;
    for (var i = 0; i < 4; i++) {
        let corner = vec2<i32>(i & 1, i >> 1u);
        let beside = clamp(source + base + corner, vec2<i32>(0), most);
        let other = textureLoad(forward, vec2<u32>(beside), layer, 0).xy;
        sum += corner_weight(f, corner) * light_beside(own, other);
    }
    return sum;
}

fn seen(p: vec2<u32>, view: u32, side: u32) -> Seen {
    let plane = target_pixels();
    let at = sums_base(side) + (view * params.height + p.y) * params.width + p.x;
    let key = sums[at];
    let word = sums[at + plane];
    if (key == KEY_OF_NOTHING || word == 0u) {
        return Seen(UNSEEN, 0.0);
    }
    if (!EVIS_PAPER) {
        return Seen(gathered(p, view, side, word), nearness_of(key));
    }
    let scale = light_scale(largest[key_layer(side, view) * 2u]);
    return Seen(decoded(word, sums[at + 2u * plane], sums[at + 3u * plane], scale), nearness_of(key));
}

fn corner_weight(f: vec2<f32>, corner: vec2<i32>) -> f32 {
    return select(1.0 - f.x, f.x, corner.x == 1) * select(1.0 - f.y, f.y, corner.y == 1);
}

// Light of a neighbour on the same surface; across an edge the source's own.
fn light_beside(own: vec2<f32>, other: vec2<f32>) -> f32 {
    let apart = min(own.y, other.y) < max(own.y, other.y) * SAME_SURFACE;
    return select(other.x, own.x, apart || other.x < 0.0);
}

fn combined(older: Seen, newer: Seen) -> f32 {
    if (older.luminance < 0.0) {
        return newer.luminance;
    }
    if (newer.luminance < 0.0) {
        return older.luminance;
    }
    if (EVIS_PAPER) {
        return newer.luminance;
    }
    if (newer.nearness < older.nearness * SAME_SURFACE) {
        return older.luminance;
    }
    if (older.nearness < newer.nearness * SAME_SURFACE) {
        return newer.luminance;
    }
    let a = log(older.luminance + params.log_floor);
    let b = log(newer.luminance + params.log_floor);
    return max(exp(a + (b - a) * params.elapsed) - params.log_floor, 0.0);
}

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let newer = seen(id.xy, id.z, 1u);
    var older = Seen(UNSEEN, 0.0);
    if (!EVIS_PAPER || newer.luminance < 0.0) {
        older = seen(id.xy, id.z, 0u);
    }
    let luminance = known_or_black(combined(older, newer));
    textureStore(layers, id.xy, target_layer(id.z), vec4<f32>(luminance, 0.0, 0.0, 0.0));
}
