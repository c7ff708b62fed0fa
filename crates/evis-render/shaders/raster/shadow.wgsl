// Shadow maps: reverse z, fitted to the world. 3x3 percentage-closer filtering.
override SHADOWS: bool = false;

@group(2) @binding(0) var shadow_maps: texture_depth_2d_array;
@group(2) @binding(1) var shadow_sampler: sampler_comparison;
// Part of the light that arrives: 1 lit, 0 in shadow.
fn shadow_visibility(light: Light, layer: u32, position: vec3<f32>, normal: vec3<f32>, to_light: vec3<f32>) -> f32 {
    let clip_here = light.shadow_clip_from_world * vec4<f32>(position, 1.0);
    // Offset along the normal by the footprint of the filter: a texel and a half, more where light grazes.
    let sine = sqrt(clamp(1.0 - dot(normal, to_light) * dot(normal, to_light), 0.0, 1.0));
    let shift = normal * (light.spot.z * max(clip_here.w, 0.0) * (0.5 + 2.5 * sine));
    let clip = light.shadow_clip_from_world * vec4<f32>(position + shift, 1.0);
    if (clip.w <= 0.0) {
        return 1.0;
    }
    let ndc = clip.xyz / clip.w;
    if (any(abs(ndc.xy) > vec2<f32>(1.0)) || ndc.z <= 0.0) {
        return 1.0;
    }
    let size = vec2<f32>(textureDimensions(shadow_maps));
    let at = vec2<f32>(ndc.x * 0.5 + 0.5, 0.5 - ndc.y * 0.5) * size;
    // Nine bilinear taps around `at` weigh a 4x4 block of texels: 1 - f, 1, 1, f along each axis. Four gathers
    // read those sixteen, where nine filtered taps would read thirty-six.
    let corner = floor(at - 0.5);
    let f = at - 0.5 - corner;
    var sum = 0.0;
    for (var j = 0u; j < 2u; j++) {
        for (var i = 0u; i < 2u; i++) {
            let uv = (corner + vec2<f32>(f32(i), f32(j)) * 2.0) / size;
            let lit = textureGatherCompare(shadow_maps, shadow_sampler, uv, layer, ndc.z);
            // Gather order: (0, 1), (1, 1), (1, 0), (0, 0).
            let wx = select(vec2<f32>(1.0 - f.x, 1.0), vec2<f32>(1.0, f.x), i == 1u);
            let wy = select(vec2<f32>(1.0 - f.y, 1.0), vec2<f32>(1.0, f.y), j == 1u);
            sum += wy.y * (wx.x * lit.x + wx.y * lit.y) + wy.x * (wx.y * lit.z + wx.x * lit.w);
        }
    }
    return sum / 9.0;
}
