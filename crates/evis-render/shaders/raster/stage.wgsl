#import raster/vertex.wgsl
// The vertex stage of passes that draw surfaces as they are.

@vertex
fn vs_main(in: VertexIn, @builtin(instance_index) instance: u32, @builtin(vertex_index) vertex: u32) -> Varyings {
    let local = deform(instance, in, vertex);
    return set_varyings(instance, in, local, input_clip(in) * vec4<f32>(local.position, 1.0));
}
