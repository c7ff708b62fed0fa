#import raster/vertex.wgsl
#import raster/material.wgsl
// Depth from a light. objects[].clip_from_object is then light clip space; masked casters keep their holes.

@vertex
fn vs_main(in: VertexIn, @builtin(instance_index) instance: u32, @builtin(vertex_index) vertex: u32) -> Varyings {
    let local = deform(instance, in, vertex);
    return set_varyings(instance, in, local, input_clip(in) * vec4<f32>(local.position, 1.0));
}

@fragment
fn fs_masked(v: Varyings) {
    if (base_color(v).a < material.emissive.w) {
        discard;
    }
}
