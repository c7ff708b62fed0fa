#import common/frame.wgsl
// Image-based light: diffuse irradiance and prefiltered specular light by the split-sum approximation.
override ENVIRONMENT: bool = false;

@group(2) @binding(2) var irradiance_cube: texture_cube<f32>;
@group(2) @binding(3) var specular_cube: texture_cube<f32>;
@group(2) @binding(4) var sky_cube: texture_cube<f32>;
@group(2) @binding(5) var cube_sampler: sampler;
@group(2) @binding(6) var brdf_lut: texture_2d<f32>;

// World direction to the environment's own axes: a turn of -rotation about +Y.
fn environment_direction(d: vec3<f32>) -> vec3<f32> {
    let c = cos(frame.ambient.w);
    let s = sin(frame.ambient.w);
    return vec3<f32>(c * d.x - s * d.z, d.y, s * d.x + c * d.z);
}

fn environment_irradiance(n: vec3<f32>) -> vec3<f32> {
    let d = environment_direction(n);
    return textureSampleLevel(irradiance_cube, cube_sampler, d, 0.0).rgb * frame.background.w;
}

fn environment_specular(r: vec3<f32>, roughness: f32) -> vec3<f32> {
    let top = f32(textureNumLevels(specular_cube) - 1u);
    let d = environment_direction(r);
    return textureSampleLevel(specular_cube, cube_sampler, d, roughness * top).rgb * frame.background.w;
}

fn environment_sky(direction: vec3<f32>) -> vec3<f32> {
    let d = environment_direction(direction);
    return textureSampleLevel(sky_cube, cube_sampler, d, 0.0).rgb * frame.background.w;
}

// Scale and bias of F0.
fn split_sum(n_v: f32, roughness: f32) -> vec2<f32> {
    return textureSampleLevel(brdf_lut, cube_sampler, vec2<f32>(n_v, roughness), 0.0).rg;
}
