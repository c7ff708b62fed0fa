// A keyframe's pictures to what the splat passes read: light averaged over the samples, and nothing in it that is not a
// number. Twin: cpu/splat.rs, prepare and clipped.

override SAMPLES: u32 = 1;
override WITH_OBJECTS: bool = false;

// One view of one keyframe.
struct KeyParams {
    width: u32,
    height: u32,
    // View within both slots: views of slot 0, then of slot 1.
    view: u32,
    // Pixels beyond each border of the sensor.
    margin: u32,
    // Light above this counts as this.
    brightest: f32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
};

@group(0) @binding(0) var<uniform> key: KeyParams;
@group(0) @binding(1) var luminance_layers: texture_2d_array<f32>;
@group(0) @binding(2) var inverse_depths: texture_2d<f32>;
@group(0) @binding(3) var flows: texture_2d<f32>;
@group(0) @binding(4) var ids: texture_2d<u32>;
// Luminance (negative: unknown), 1 / (depth + 1e-3), pixels to where the point is at the next keyframe.
@group(0) @binding(5) var forward: texture_storage_2d_array<rgba32float, write>;
// The same, with pixels to where it is at the last one.
@group(0) @binding(6) var backward: texture_storage_2d_array<rgba32float, write>;
// Object + 1; 0 where nothing was drawn.
@group(0) @binding(7) var<storage, read_write> objects: array<u32>;
// Per view: bits of the largest luminance, and of the largest 1 / depth that the sensor itself sees; positive floats are ordered as their bits are.
@group(0) @binding(8) var<storage, read_write> largest: array<atomic<u32>>;
// Of this view and keyframe: pixels above `brightest`, and bits of the largest luminance among them.
@group(0) @binding(9) var<storage, read_write> clipped: array<atomic<u32>>;

const LARGEST_LUMINANCE: f32 = 1e30;
const LARGEST_INVERSE_DEPTH: f32 = 1e6;

// By its bits: arithmetic may assume that there are no such values.
fn is_number(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn inverse_depth_at(p: vec2<i32>) -> f32 {
    let x = textureLoad(inverse_depths, p, 0).r;
    let bits = bitcast<u32>(x);
    // Depth 0 is as near as can be; negative ones and those that are no numbers are as far.
    if (bits == 0x7f800000u) {
        return LARGEST_INVERSE_DEPTH;
    }
    return select(0.0, min(x, LARGEST_INVERSE_DEPTH), bits < 0x7f800000u);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= key.width || id.y >= key.height) {
        return;
    }
    let p = vec2<i32>(id.xy);
    var sum = 0.0;
    var known = true;
    for (var s = 0u; s < SAMPLES; s++) {
        let y = textureLoad(luminance_layers, p, s, 0).r;
        known = known && is_number(y);
        sum += clamp(y, 0.0, LARGEST_LUMINANCE);
    }
    let luminance = select(-1.0, min(sum * (1.0 / f32(SAMPLES)), LARGEST_LUMINANCE), known);
    let inverse_depth = inverse_depth_at(p);
    let index = (key.view * key.height + id.y) * key.width + id.x;
    let nearness = inverse_depth / (1.0 + 1e-3 * inverse_depth);
    let motion = textureLoad(flows, p, 0);
    textureStore(forward, id.xy, key.view, vec4<f32>(luminance, nearness, motion.xy));
    textureStore(backward, id.xy, key.view, vec4<f32>(luminance, nearness, motion.zw));
    if (WITH_OBJECTS) {
        objects[index] = textureLoad(ids, p, 0).r;
    }
    if (luminance > 0.0) {
        atomicMax(&largest[key.view * 2u], bitcast<u32>(luminance));
    }
    if (luminance > key.brightest) {
        atomicAdd(&clipped[0], 1u);
        atomicMax(&clipped[1], bitcast<u32>(luminance));
    }
    // A margin changes no weight of the softmax.
    let low = vec2<u32>(key.margin);
    if (all(id.xy >= low) && all(id.xy < vec2<u32>(key.width, key.height) - low)) {
        atomicMax(&largest[key.view * 2u + 1u], bitcast<u32>(nearness));
    }
}
