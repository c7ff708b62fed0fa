#import splat/layout.wgsl
// The instant of a keyframe itself: its light without the margin.

@group(0) @binding(1) var forward: texture_2d_array<f32>;
@group(0) @binding(2) var layers: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = params.supersample;
    if (id.x * n >= params.width) {
        return;
    }
    var sum = 0.0;
    var known = 0.0;
    for (var i = 0u; i < n * n; i++) {
        let p = id.xy * n + vec2<u32>(i % n, i / n) + params.margin;
        let luminance = textureLoad(forward, p, key_layer(params.side, id.z), 0).r;
        if (luminance >= 0.0) {
            sum += luminance;
            known += 1.0;
        }
    }
    textureStore(layers, id.xy, target_layer(id.z), vec4<f32>(mean_or_fill(sum, known), 0.0, 0.0, 0.0));
}
