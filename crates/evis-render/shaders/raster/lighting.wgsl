#import common/frame.wgsl
// Punctual lights (KHR_lights_punctual).

struct Incident {
    // Unit vector from the surface to the light.
    to_light: vec3<f32>,
    // Irradiance on a surface that faces the light.
    irradiance: vec3<f32>,
    // Metres to the light.
    distance: f32,
};

// Farther than anything.
const DIRECTIONAL_DISTANCE: f32 = 1e30;

fn incident_light(light: Light, position: vec3<f32>) -> Incident {
    if (light.position_kind.w < 0.5) {
        return Incident(-light.direction_range.xyz, light.radiance_shadow.rgb, DIRECTIONAL_DISTANCE);
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
    return Incident(to_light, light.radiance_shadow.rgb * attenuation, sqrt(distance_squared));
}
