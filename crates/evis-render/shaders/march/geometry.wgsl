#import raster/vertex.wgsl
// Places of a key, one sample at the pixel's centre: where in its object a pixel lies, and the object's number from 1 on.
// What deforms or has holes is an edge everywhere.

@group(3) @binding(0) var<uniform> first_record: u32;

struct PlaceVaryings {
    @builtin(position) position: vec4<f32>,
    @location(8) place: vec3<f32>,
    @location(9) @interpolate(flat) number: f32,
};

override ALPHA_MASK: bool = false;

@vertex
fn vs_main(in: VertexIn, @builtin(instance_index) instance: u32, @builtin(vertex_index) vertex: u32) -> PlaceVaryings {
    let local = deform(instance, in, vertex);
    let rigid = !(ALPHA_MASK || SKINNED || MORPHED);
    return PlaceVaryings(
        input_clip(in) * vec4<f32>(local.position, 1.0),
        local.position,
        select(-1.0, f32(instance - first_record + 1u), rigid));
}

@fragment
fn fs_main(v: PlaceVaryings) -> @location(0) vec4<f32> {
    return vec4<f32>(v.place, v.number);
}
