// Shadow maps: reverse z, fitted to the world.
override SHADOWS: bool = false;

@group(2) @binding(0) var shadow_maps: texture_depth_2d_array;
@group(2) @binding(1) var shadow_sampler: sampler_comparison;

// Part of the light that arrives: 1 lit, 0 in shadow.
fn shadow_visibility(light: Light, layer: u32, position: vec3<f32>, normal: vec3<f32>, to_light: vec3<f32>) -> f32 {
    let clip_here = light.shadow_clip_from_world * vec4<f32>(position, 1.0);
    // The comparison reaches a texel to each side, where a slanted surface is nearer to the light by a texel's slope.
    // Part of that is made up by the maps' own slope bias, part by a step along the normal: either alone costs more
    // of thin shadows. Less lets surfaces darken themselves (tests/floor2_raster.rs).
    let sine = sqrt(clamp(1.0 - dot(normal, to_light) * dot(normal, to_light), 0.0, 1.0));
    let shift = normal * (light.spot.z * max(clip_here.w, 0.0) * (0.3 + 0.8 * sine));
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
