#import raster/surface.wgsl
// The raster pass of `native`: one luminance target and depth, nothing else.

@vertex
fn vs_main(in: VertexIn, @builtin(instance_index) instance: u32, @builtin(vertex_index) vertex: u32) -> Varyings {
    let local = deform(instance, in, vertex);
    return set_varyings(instance, in, local, input_clip(in) * vec4<f32>(local.position, 1.0));
}

@fragment
fn fs_main(v: Varyings, @builtin(front_facing) front: bool) -> @location(0) f32 {
    return luminance(surface_radiance(v, front));
}
