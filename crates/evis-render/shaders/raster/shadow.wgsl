// Shadows: maps (reverse z, fitted to the world), and rays where these cannot tell.
#import raster/occluders.wgsl

override SHADOWS: bool = false;
// Whether all that throws shadows is in the trees.
override SHADOW_RAYS: bool = false;

@group(2) @binding(0) var shadow_maps: texture_depth_2d_array;
@group(2) @binding(1) var shadow_sampler: sampler_comparison;
@group(2) @binding(8) var shadow_texels: sampler;

struct ShadowPoint {
    // Of the map, top left 0.
    uv: vec2<f32>,
    depth: f32,
    // Clip w: a texel of the map is so many times as large here as at 1.
    w: f32,
    inside: bool,
};

fn shadow_point(light: Light, position: vec3<f32>) -> ShadowPoint {
    let clip = light.shadow_clip_from_world * vec4<f32>(position, 1.0);
    let ndc = clip.xyz / max(clip.w, 1e-9);
    let inside = clip.w > 0.0 && all(abs(ndc.xy) <= vec2<f32>(1.0)) && ndc.z > 0.0;
    return ShadowPoint(vec2<f32>(ndc.x * 0.5 + 0.5, 0.5 - ndc.y * 0.5), ndc.z, clip.w, inside);
}

// Part of the light that arrives: 1 lit, 0 in shadow.
fn shadow_visibility(light: Light, layer: u32, position: vec3<f32>, normal: vec3<f32>, incident: Incident) -> f32 {
    if (SHADOW_RAYS) {
        return shadow_by_rays(light, layer, position, normal, incident);
    }
    return shadow_by_map(light, layer, position, normal, incident.to_light);
}

fn shadow_by_map(light: Light, layer: u32, position: vec3<f32>, normal: vec3<f32>, to_light: vec3<f32>) -> f32 {
    let w = max(shadow_point(light, position).w, 0.0);
    // The comparison reaches a texel to each side, where a slanted surface is nearer to the light by a texel's slope.
    // Part of that is made up by the maps' own slope bias, part by a step along the normal: either alone costs more
    // of thin shadows. Less lets surfaces darken themselves (tests/passes/raster.rs).
    let sine = sqrt(clamp(1.0 - dot(normal, to_light) * dot(normal, to_light), 0.0, 1.0));
    let at = shadow_point(light, position + normal * (light.spot.z * w * (0.3 + 0.8 * sine)));
    // One bilinear comparison. The lights are points, so real shadow edges are sharp: a wider filter would only
    // blur what the pixel's own samples average.
    let lit = textureSampleCompareLevel(shadow_maps, shadow_sampler, at.uv, layer, at.depth);
    return select(1.0, lit, at.inside);
}

// Where the four texels around a point agree whether the surface's own plane is lit there, so is the point; else a ray decides.
fn shadow_by_rays(light: Light, layer: u32, position: vec3<f32>, normal: vec3<f32>, incident: Incident) -> f32 {
    let at = shadow_point(light, position);
    // The plane's depth over the map: it is linear there, also in perspective. From two steps along the plane, each as
    // long as a texel.
    let step = light.spot.z * max(at.w, 1e-6);
    let side = normalize(cross(normal, select(vec3<f32>(1.0, 0.0, 0.0), vec3<f32>(0.0, 1.0, 0.0), abs(normal.x) > 0.7)));
    let along = shadow_point(light, position + step * side);
    let across = shadow_point(light, position + step * cross(normal, side));
    let d1 = vec3<f32>(along.uv - at.uv, along.depth - at.depth);
    let d2 = vec3<f32>(across.uv - at.uv, across.depth - at.depth);
    let determinant = d1.x * d2.y - d1.y * d2.x;
    let scale = 1.0 / select(determinant, 1e-20, abs(determinant) < 1e-20);
    let slope = vec2<f32>(d1.z * d2.y - d2.z * d1.y, d2.z * d1.x - d1.z * d2.x) * scale;

    let size = vec2<f32>(textureDimensions(shadow_maps));
    let texel = 1.0 / size;
    // What rounding may make of depths, and of the plane's.
    let unsure = 2e-7 + 0.02 * dot(abs(slope), texel);
    // Between four texels; they come as (low, high), (high, high), (high, low), (low, low) in u and v.
    let corner = (floor(at.uv * size - 0.5) + 0.5) * texel - at.uv;
    let depths = textureGather(shadow_maps, shadow_texels, at.uv + corner + 0.5 * texel, layer);
    let plane = at.depth + dot(slope, corner) + unsure;
    let right = slope.x * texel.x;
    let down = slope.y * texel.y;
    let planes = vec4<f32>(plane + down, plane + right + down, plane + right, plane);
    let dark = dot(select(vec4<f32>(0.0), vec4<f32>(0.25), depths > planes), vec4<f32>(1.0));
    if (!at.inside || dark == 0.0) {
        return 1.0;
    }
    if (dark == 1.0) {
        return 0.0;
    }
    // Off the surface by what f32 does not resolve.
    let off = 4e-6 * (1.0 + max(max(abs(position.x), abs(position.y)), abs(position.z)));
    let ray = shadow_ray(light, at.uv, position + normal * off, incident.to_light, off, incident.distance);
    // A ray that came to no end leaves it to the map.
    return select(select(1.0 - dark, 1.0, ray.left > 0u), 0.0, ray.found);
}
