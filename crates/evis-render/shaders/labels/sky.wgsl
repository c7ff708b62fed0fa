#import common/frame.wgsl
#import common/sky_vertex.wgsl
// Flow of what lies at infinity: it moves with the camera's rotation only.
struct SkyFlow {
    // clip_from_world without translation, at the next and the last label.
    next_clip_from_world: mat4x4<f32>,
    last_clip_from_world: mat4x4<f32>,
    half_size: vec2<f32>,
    pad: vec2<f32>,
};

@group(1) @binding(0) var<uniform> sky: SkyFlow;

fn flow_at_infinity(clip: vec4<f32>, ndc: vec2<f32>) -> vec2<f32> {
    if (clip.w <= 0.0) {
        return vec2<f32>(1e30, 1e30);
    }
    let d = clip.xy / clip.w - ndc;
    return vec2<f32>(d.x, -d.y) * sky.half_size;
}

struct SkyOut {
    @location(0) inverse_depth: f32,
    @location(1) flow: vec4<f32>,
    @location(2) ids: vec2<u32>,
};

@fragment
fn fs_main(v: SkyVaryings) -> SkyOut {
    let d = vec4<f32>(ray_direction(v.ndc), 0.0);
    return SkyOut(
        0.0,
        vec4<f32>(
            flow_at_infinity(sky.next_clip_from_world * d, v.ndc),
            flow_at_infinity(sky.last_clip_from_world * d, v.ndc)),
        vec2<u32>(0u, 0u));
}
