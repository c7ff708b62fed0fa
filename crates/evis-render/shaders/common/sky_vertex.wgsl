#import common/triangle.wgsl
// Vertex stage of what lies behind everything: a triangle over the whole image at the far plane (reverse z: 0).
struct SkyVaryings {
    @builtin(position) position: vec4<f32>,
    @location(0) ndc: vec2<f32>,
};

@vertex
fn vs_main(@builtin(vertex_index) i: u32) -> SkyVaryings {
    let ndc = covering_corner(i);
    return SkyVaryings(vec4<f32>(ndc, 0.0, 1.0), ndc);
}
