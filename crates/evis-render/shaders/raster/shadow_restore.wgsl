#import common/triangle.wgsl
// A map of what stands still, over what was drawn into another. The instance is its layer.
@group(0) @binding(0) var still_maps: texture_depth_2d_array;

struct RestoreVaryings {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) layer: u32,
};

@vertex
fn vs_main(@builtin(vertex_index) i: u32, @builtin(instance_index) layer: u32) -> RestoreVaryings {
    return RestoreVaryings(vec4<f32>(covering_corner(i), 0.0, 1.0), layer);
}

@fragment
fn fs_main(v: RestoreVaryings) -> @builtin(frag_depth) f32 {
    return textureLoad(still_maps, vec2<u32>(v.position.xy), v.layer, 0);
}
