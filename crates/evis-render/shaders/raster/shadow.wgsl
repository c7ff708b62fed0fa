// Shadow maps: reverse z, fitted to the world.
override SHADOWS: bool = false;

@group(2) @binding(0) var shadow_maps: texture_depth_2d_array;
@group(2) @binding(1) var shadow_sampler: sampler_comparison;
// Part of the light that arrives: 1 lit, 0 in shadow.
fn shadow_visibility(light: Light, layer: u32, position: vec3<f32>, normal: vec3<f32>, to_light: vec3<f32>) -> f32 {
    let clip_here = light.shadow_clip_from_world * vec4<f32>(position, 1.0);
    // Offset along the normal by the footprint of a texel, more where light grazes.
    let sine = sqrt(clamp(1.0 - dot(normal, to_light) * dot(normal, to_light), 0.0, 1.0));
    let shift = normal * (light.spot.z * max(clip_here.w, 0.0) * (0.5 + 1.5 * sine));
    let clip = light.shadow_clip_from_world * vec4<f32>(position + shift, 1.0);
    if (clip.w <= 0.0) {
        return 1.0;
    }
    let ndc = clip.xyz / clip.w;
    if (any(abs(ndc.xy) > vec2<f32>(1.0)) || ndc.z <= 0.0) {
        return 1.0;
    }
    // One bilinear comparison. The lights are points, so real shadow edges are sharp: a wider filter would only
    // blur what the pixel's own samples average.
    let uv = vec2<f32>(ndc.x * 0.5 + 0.5, 0.5 - ndc.y * 0.5);
    return textureSampleCompareLevel(shadow_maps, shadow_sampler, uv, layer, ndc.z);
}
