// What anyone would write first: textured Lambert under one light, as luminance.
struct Frame {
    clip_from_world: mat4x4<f32>,
    // Towards the light.
    to_light: vec4<f32>,
    // Irradiance / pi.
    light: vec4<f32>,
    ambient: vec4<f32>,
};

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var albedo: texture_2d<f32>;
@group(0) @binding(2) var trilinear: sampler;

struct Varyings {
    @builtin(position) position: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) uv: vec2<f32>,
};

@vertex
fn vs_main(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) uv: vec2<f32>,
) -> Varyings {
    return Varyings(frame.clip_from_world * vec4<f32>(position, 1.0), normal, uv);
}

@fragment
fn fs_main(v: Varyings) -> @location(0) f32 {
    let lambert = max(dot(normalize(v.normal), frame.to_light.xyz), 0.0);
    let rgb = textureSample(albedo, trilinear, v.uv).rgb * (frame.light.rgb * lambert + frame.ambient.rgb);
    return dot(rgb, vec3<f32>(0.2126, 0.7152, 0.0722));
}
