// Shadow maps: reverse z, fitted to the world. 3x3 percentage-closer filtering.
override SHADOWS: bool = false;

@group(2) @binding(0) var shadow_maps: texture_depth_2d_array;
@group(2) @binding(1) var shadow_sampler: sampler_comparison;
@group(2) @binding(2) var<storage, read> shadow_matrices: array<ShadowMatrix>;

struct ShadowMatrix {
    clip_from_world: mat4x4<f32>,
    // World size of a texel at unit distance (spot) or everywhere (directional); 0, 0, 0.
    texel: vec4<f32>,
};

// Part of the light that arrives: 1 lit, 0 in shadow.
fn shadow_visibility(matrix: u32, layer: u32, position: vec3<f32>, normal: vec3<f32>, to_light: vec3<f32>) -> f32 {
    let m = shadow_matrices[matrix];
    let clip_here = m.clip_from_world * vec4<f32>(position, 1.0);
    // The filter reaches two texels to each side, where a slanted surface is nearer to the light by two texels'
    // slope. Half of that is made up by the maps' own slope bias, half by a step along the normal: either alone
    // costs more of thin shadows. Less lets surfaces darken themselves (tests/floor2_raster.rs).
    let sine = sqrt(clamp(1.0 - dot(normal, to_light) * dot(normal, to_light), 0.0, 1.0));
    let shift = normal * (m.texel.x * max(clip_here.w, 0.0) * (0.4 + 1.5 * sine));
    let clip = m.clip_from_world * vec4<f32>(position + shift, 1.0);
    if (clip.w <= 0.0) {
        return 1.0;
    }
    let ndc = clip.xyz / clip.w;
    if (any(abs(ndc.xy) > vec2<f32>(1.0)) || ndc.z <= 0.0) {
        return 1.0;
    }
    let size = vec2<f32>(textureDimensions(shadow_maps));
    let uv = vec2<f32>(ndc.x * 0.5 + 0.5, 0.5 - ndc.y * 0.5);
    var sum = 0.0;
    for (var y = -1; y <= 1; y++) {
        for (var x = -1; x <= 1; x++) {
            let at = uv + vec2<f32>(f32(x), f32(y)) / size;
            sum += textureSampleCompareLevel(shadow_maps, shadow_sampler, at, layer, ndc.z);
        }
    }
    return sum / 9.0;
}
