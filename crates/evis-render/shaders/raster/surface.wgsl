#import raster/vertex.wgsl
#import raster/material.wgsl
#import raster/lighting.wgsl
#import raster/brdf.wgsl
#import raster/shadow.wgsl
#import raster/environment.wgsl
#import common/luminance.wgsl
// What a surface sends towards the camera, in linear RGB.

// 0 unlit, 1 Lambert, 2 glTF metallic-roughness.
override SHADING_MODEL: u32 = 0;

fn lit_by(light: Light, s: Surface) -> Incident {
    var incident = incident_light(light, s.position);
    if (SHADOWS) {
        if (light.radiance_shadow.w >= 0.0 && dot(s.normal, incident.to_light) > 0.0) {
            let layer = frame.shadow_layer_base + u32(light.radiance_shadow.w);
            incident.irradiance *= shadow_visibility(light, layer, s.shadowed, s.surface_normal, incident);
        }
    }
    return incident;
}

// Everything about a surface point that its lights need.
struct Surface {
    position: vec3<f32>,
    // Where its shadow is looked up.
    shadowed: vec3<f32>,
    // For shading, normal map included.
    normal: vec3<f32>,
    // Of the surface itself: the shadow's bias follows it.
    surface_normal: vec3<f32>,
    to_eye: vec3<f32>,
    n_v: f32,
    diffuse_color: vec3<f32>,
    f0: vec3<f32>,
    alpha: f32,
};

// Borders of shadows are as sharp as outlines, and what lies along an axis crosses a grid's places row by row: each looks
// beside its middle, on a grid that is turned.
fn shadowed_position(v: Varyings) -> vec3<f32> {
    let position = vary_world(v);
    if (!SHADOWS || GRID == 1u) {
        return position;
    }
    let shift = turned(v.position.xy);
    return position + dpdxFine(position) * shift.x + dpdyFine(position) * shift.y;
}

// One light's share; the prelude's lit_diffuse() and lit_metallic_roughness() sum these over all lights.
fn light_diffuse(light: Light, s: Surface) -> vec3<f32> {
    let incident = lit_by(light, s);
    return incident.irradiance * (max(dot(s.normal, incident.to_light), 0.0) * (1.0 / PI));
}

fn light_metallic_roughness(light: Light, s: Surface) -> vec3<f32> {
    let incident = lit_by(light, s);
    let n_l = dot(s.normal, incident.to_light);
    if (n_l <= 0.0) {
        return vec3<f32>(0.0);
    }
    let h = normalize(incident.to_light + s.to_eye);
    let fresnel = schlick(s.f0, dot(s.to_eye, h));
    let specular = fresnel * ggx_specular(s.alpha, n_l, s.n_v, max(dot(s.normal, h), 0.0));
    return incident.irradiance * n_l * ((1.0 - fresnel) * s.diffuse_color * (1.0 / PI) + specular);
}

fn diffuse_radiance(v: Varyings, base: vec3<f32>, front: bool) -> vec3<f32> {
    var s: Surface;
    s.position = vary_world(v);
    s.shadowed = shadowed_position(v);
    s.normal = shading_normal(v, front);
    s.surface_normal = surface_normal(v, front);
    var indirect = frame.ambient.rgb;
    if (ENVIRONMENT) {
        indirect += environment_irradiance(s.normal);
    }
    return (lit_diffuse(s) + indirect * ambient_occlusion(v)) * base;
}

fn metallic_roughness_radiance(v: Varyings, base: vec3<f32>, front: bool) -> vec3<f32> {
    let mr = metallic_roughness(v);
    var s: Surface;
    s.position = vary_world(v);
    s.shadowed = shadowed_position(v);
    s.normal = shading_normal(v, front);
    s.surface_normal = surface_normal(v, front);
    s.to_eye = normalize(to_camera(s.position));
    s.n_v = max(dot(s.normal, s.to_eye), 1e-4);
    s.diffuse_color = base * (1.0 - mr.x);
    s.f0 = mix(vec3<f32>(0.04), base, mr.x);
    // Below 0.045 the highlight of a punctual light is narrower than f32 resolves.
    s.alpha = max(mr.y * mr.y, 0.002);
    var indirect = frame.ambient.rgb * (s.diffuse_color + s.f0);
    if (ENVIRONMENT) {
        let lut = split_sum(s.n_v, mr.y);
        let specular = s.f0 * lut.x + lut.y;
        let r = reflect(-s.to_eye, s.normal);
        indirect += environment_irradiance(s.normal) * s.diffuse_color * (1.0 - specular)
            + environment_specular(r, mr.y) * specular;
    }
    return lit_metallic_roughness(s) + indirect * ambient_occlusion(v);
}

// Linear radiance towards the camera. Discards where the alpha mask says so.
fn surface_radiance(v: Varyings, front: bool) -> vec3<f32> {
    let base = base_color(v);
    if (ALPHA_MASK) {
        if (base.a < material.emissive.w) {
            discard;
        }
    }
    if (SHADING_MODEL == 0u) {
        return base.rgb * vary_emission_factor(v);
    }
    if (SHADING_MODEL == 1u) {
        return diffuse_radiance(v, base.rgb, front) + emitted(v);
    }
    return metallic_roughness_radiance(v, base.rgb, front) + emitted(v);
}
