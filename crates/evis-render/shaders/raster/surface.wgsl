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

// `normal` is the shading normal, `surface` that of the surface itself, which the shadow's bias follows.
fn lit_by(i: u32, position: vec3<f32>, normal: vec3<f32>, surface: vec3<f32>) -> Incident {
    let light = lights[frame.light_base + i];
    var incident = incident_light(light, position);
    if (SHADOWS) {
        if (light.radiance_shadow.w >= 0.0 && dot(normal, incident.to_light) > 0.0) {
            let index = u32(light.radiance_shadow.w);
            incident.irradiance *= shadow_visibility(
                frame.shadow_matrix_base + index, frame.shadow_layer_base + index,
                position, surface, incident.to_light);
        }
    }
    return incident;
}

fn diffuse_radiance(v: Varyings, base: vec3<f32>, front: bool) -> vec3<f32> {
    let surface = surface_normal(v, front);
    let n = shading_normal(v, front);
    let position = vary_world(v);
    var irradiance = vec3<f32>(0.0);
    for (var i = 0u; i < LIGHT_COUNT; i++) {
        let incident = lit_by(i, position, n, surface);
        irradiance += incident.irradiance * max(dot(n, incident.to_light), 0.0);
    }
    var indirect = frame.ambient.rgb;
    if (ENVIRONMENT) {
        indirect += environment_irradiance(frame, n);
    }
    return (irradiance * (1.0 / PI) + indirect * ambient_occlusion(v)) * base;
}

fn metallic_roughness_radiance(v: Varyings, base: vec3<f32>, front: bool) -> vec3<f32> {
    let surface = surface_normal(v, front);
    let n = shading_normal(v, front);
    let position = vary_world(v);
    let to_eye = normalize(camera_position(frame) - position);
    let mr = metallic_roughness(v);
    // Below 0.045 the highlight of a punctual light is narrower than f32 resolves.
    let alpha = max(mr.y * mr.y, 0.002);
    let f0 = mix(vec3<f32>(0.04), base, mr.x);
    let diffuse_color = base * (1.0 - mr.x);
    let n_v = max(dot(n, to_eye), 1e-4);
    var out = vec3<f32>(0.0);
    for (var i = 0u; i < LIGHT_COUNT; i++) {
        let incident = lit_by(i, position, n, surface);
        let n_l = dot(n, incident.to_light);
        if (n_l > 0.0) {
            let h = normalize(incident.to_light + to_eye);
            let fresnel = schlick(f0, dot(to_eye, h));
            let specular = fresnel * ggx_specular(alpha, n_l, n_v, max(dot(n, h), 0.0));
            out += incident.irradiance * n_l * ((1.0 - fresnel) * diffuse_color * (1.0 / PI) + specular);
        }
    }
    let occlusion = ambient_occlusion(v);
    var indirect = frame.ambient.rgb * (diffuse_color + f0);
    if (ENVIRONMENT) {
        let lut = split_sum(n_v, mr.y);
        let specular = f0 * lut.x + lut.y;
        let r = reflect(-to_eye, n);
        indirect += environment_irradiance(frame, n) * diffuse_color * (1.0 - specular)
            + environment_specular(frame, r, mr.y) * specular;
    }
    return out + indirect * occlusion;
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
