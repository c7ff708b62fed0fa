// Punctual lights (KHR_lights_punctual). Twin of the struct: uniforms.rs, LightRecord.
struct Light {
    // World position; w: kind (0 directional, 1 point, 2 spot).
    position_kind: vec4<f32>,
    // World direction in which it shines; w: 1 / range^2, 0 for no limit.
    direction_range: vec4<f32>,
    // rgb: colour * intensity * waveform; w: shadow map index within the frame, -1 for none.
    radiance_shadow: vec4<f32>,
    // Spot: scale and offset of the angular falloff.
    spot: vec4<f32>,
};

override LIGHT_COUNT: u32 = 0;

@group(0) @binding(5) var<storage, read> lights: array<Light>;

struct Incident {
    // Unit vector from the surface to the light.
    to_light: vec3<f32>,
    // Irradiance on a surface that faces the light.
    irradiance: vec3<f32>,
};

fn incident_light(light: Light, position: vec3<f32>) -> Incident {
    if (light.position_kind.w < 0.5) {
        return Incident(-light.direction_range.xyz, light.radiance_shadow.rgb);
    }
    let offset = light.position_kind.xyz - position;
    // A light on the surface itself: closer than a millimetre counts as a millimetre.
    let distance_squared = max(dot(offset, offset), 1e-6);
    let to_light = offset * inverseSqrt(distance_squared);
    // KHR_lights_punctual, range: max(min(1 - (d / range)^4, 1), 0) / d^2.
    let ratio = distance_squared * light.direction_range.w;
    var attenuation = clamp(1.0 - ratio * ratio, 0.0, 1.0) / distance_squared;
    if (light.position_kind.w > 1.5) {
        // KHR_lights_punctual, inner and outer cone angles.
        let cd = dot(light.direction_range.xyz, -to_light);
        let angular = clamp(cd * light.spot.x + light.spot.y, 0.0, 1.0);
        attenuation *= angular * angular;
    }
    return Incident(to_light, light.radiance_shadow.rgb * attenuation);
}
