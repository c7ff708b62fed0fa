#import splat/layout.wgsl
// Adds each placed pixel's light to the four pixels around it: bilinear weight times a softmax over inverse depth, from
// which the largest at that pixel is subtracted. All sums are of integers. Twin: cpu/splat.rs, accumulate.

override FILL_HOLES: bool = false;

@group(0) @binding(1) var<storage, read> lights: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> largest: array<u32>;
@group(0) @binding(3) var<storage, read> placed: array<u32>;
// Planes of a side: depth keys, weight, light, carries of the light.
@group(0) @binding(4) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.canvas_width) {
        return;
    }
    let index = canvas_index(id.xy, id.z);
    let canvas = canvas_pixels();
    let source_at = params.side * 3u * canvas + index;
    let key = placed[source_at + 2u * canvas];
    if (key == KEY_OF_NOTHING) {
        return;
    }
    let plane = target_pixels();
    let depths = sums_base(params.side);
    let other_weights = sums_base(1u - params.side) + plane;
    let q = vec2<i32>(bitcast<i32>(placed[source_at]), bitcast<i32>(placed[source_at + canvas]));
    let taps = taps_at(q);
    let nearness = nearness_of(key);
    let frame = (slot_base(params.side) / canvas * params.view_count + id.z) * 2u;
    let scale = light_scale(largest[frame]);
    let luminance = lights[slot_base(params.side) + index].x;
    let light = u32(min(luminance * (LIGHT_STEPS / scale) + 0.5, LIGHT_STEPS));
    let sharpness = params.sharpness / max(bitcast<f32>(largest[frame + 1u]), 1e-30);
    for (var i = 0u; i < 4u; i++) {
        let at = tap_index(taps, i, id.z, plane);
        if (at < plane && taps.weights[i] > 0u) {
            if (!FILL_HOLES
                || f32(atomicLoad(&sums[other_weights + at])) < params.hole_below * WEIGHT_STEPS) {
                let front = nearness_of(atomicLoad(&sums[depths + at]));
                let importance = exp(min(nearness - front, 0.0) * sharpness);
                let weight = u32(f32(taps.weights[i]) * WEIGHT_UNIT * importance + 0.5);
                if (weight > 0u) {
                    let part = weight * light;
                    atomicAdd(&sums[depths + plane + at], weight);
                    let before = atomicAdd(&sums[depths + 2u * plane + at], part);
                    // The sum of 64 bits is exact in any order: it wraps as often as it passes a multiple of 2^32.
                    if (before > 0xffffffffu - part) {
                        atomicAdd(&sums[depths + 3u * plane + at], 1u);
                    }
                }
            }
        }
    }
}
