#import splat/layout.wgsl
// The instant of a keyframe itself: its light without the margin.

@group(0) @binding(1) var forward: texture_2d_array<f32>;
@group(0) @binding(2) var layers: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let luminance = textureLoad(forward, id.xy + params.margin, key_layer(params.side, id.z), 0).r;
    // Clipped as between keyframes: what stands still stays the same.
    let shown = select(luminance, min(luminance, params.brightest), EVIS_PAPER);
    textureStore(layers, id.xy, target_layer(id.z), vec4<f32>(known_or_black(shown), 0.0, 0.0, 0.0));
}
