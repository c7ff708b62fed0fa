#import splat/layout.wgsl
// To each pixel the number of the source that is on the nearest surface there and nearest to the pixel's centre: one word,
// how near before which. Twin: cpu/splat.rs, index.

@group(0) @binding(1) var<storage, read> placed: array<u32>;
// Planes of a side: depth keys, index words (0: a hole).
@group(0) @binding(2) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.canvas_width) {
        return;
    }
    let canvas = canvas_pixels();
    let source_at = params.side * 3u * canvas + canvas_index(id.xy, id.z);
    let key = placed[source_at + 2u * canvas];
    if (key == KEY_OF_NOTHING) {
        return;
    }
    let plane = target_pixels();
    let depths = sums_base(params.side);
    let taps = reached(vec2<u32>(placed[source_at], placed[source_at + canvas]));
    let nearness = nearness_of(key);
    let source = id.y * params.canvas_width + id.x;
    let most = (1u << (32u - params.index_bits)) - 1u;
    for (var i = 0u; i < 4u; i++) {
        let at = tap_index(taps, i, id.z, plane);
        if (at < plane && taps.weights[i] > 0u) {
            if (nearness >= nearness_of(atomicLoad(&sums[depths + at])) * SAME_SURFACE) {
                let near = clamp(u32(f32(taps.weights[i]) * (f32(most) / 1048576.0)), 1u, most);
                atomicMax(&sums[depths + plane + at], (near << params.index_bits) | source);
            }
        }
    }
}
