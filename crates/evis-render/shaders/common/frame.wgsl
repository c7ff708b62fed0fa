#import common/ray.wgsl
// The prelude declares LIGHT_CAPACITY: the scene's lights, at least 1.
// One view at one instant. Twin: gpu/uniforms.rs, Frame.
struct Frame {
    // Camera axes in world space; w of right, up, back: camera position x, y, z.
    world_from_camera_right: vec4<f32>,
    world_from_camera_up: vec4<f32>,
    world_from_camera_back: vec4<f32>,
    // tan of half the field: x scale, y scale, x offset, y offset (direction = ndc * scale + offset).
    ray: vec4<f32>,
    // x: 1 of central rays, 0 of parallel ones. Of these, depth is y - z * z_ndc.
    depth: vec4<f32>,
    // Linear RGB shown where nothing is hit; w: factor of the environment.
    background: vec4<f32>,
    // Irradiance / pi from everywhere; w: environment rotation about +Y, radians.
    ambient: vec4<f32>,
    // First shadow map layer of this environment.
    shadow_layer_base: u32,
    // Shadow rays: root of the tree of what never moves; records of what does.
    occluder_root: u32,
    occluder_first: u32,
    occluder_count: u32,
    lights: array<Light, LIGHT_CAPACITY>,
};

// A punctual light (KHR_lights_punctual), in the frame's uniform at a constant index once the loop is unrolled:
// software drivers read that once for all lanes. Twin: gpu/uniforms.rs, LightRecord.
struct Light {
    // World position; w: kind (0 directional, 1 point, 2 spot).
    position_kind: vec4<f32>,
    // World direction in which it shines; w: 1 / range^2, 0 for no limit.
    direction_range: vec4<f32>,
    // rgb: colour * intensity * waveform; w: shadow map layer within the environment, -1 for none.
    radiance_shadow: vec4<f32>,
    // Spot: scale and offset of the angular falloff; z: world size of a shadow texel per unit of clip w; w: where the cells of
    // its map begin, 0 for none.
    spot: vec4<f32>,
    shadow_clip_from_world: mat4x4<f32>,
};

@group(0) @binding(0) var<uniform> frame: Frame;

// The part of a pixel's area by which the sample being drawn reads textures. Twin: frame/pattern.rs, Share.
struct Share {
    // From the sample to its middle, in pixels.
    shift: vec2<f32>,
    // Width and height, in pixels.
    size: vec2<f32>,
};

@group(0) @binding(6) var<uniform> share: Share;

// World direction from `position` to the camera; not normalised.
fn to_camera(position: vec3<f32>) -> vec3<f32> {
    let eye = vec3<f32>(
        frame.world_from_camera_right.w, frame.world_from_camera_up.w, frame.world_from_camera_back.w);
    return select(frame.world_from_camera_back.xyz, eye - position, frame.depth.x > 0.5);
}

// 1 / planar depth of a fragment.
fn inverse_depth(position: vec4<f32>) -> f32 {
    return select(1.0 / (frame.depth.y - frame.depth.z * position.z), position.w, frame.depth.x > 0.5);
}

// World direction of the ray through `ndc`.
fn ray_direction(ndc: vec2<f32>) -> vec3<f32> {
    return direction_through(
        ndc,
        frame.ray,
        frame.world_from_camera_right.xyz,
        frame.world_from_camera_up.xyz,
        frame.world_from_camera_back.xyz);
}
