// One view at one instant. Twin: uniforms.rs, Frame.
struct Frame {
    // Camera axes in world space; w of right, up, back: camera position x, y, z.
    world_from_camera_right: vec4<f32>,
    world_from_camera_up: vec4<f32>,
    world_from_camera_back: vec4<f32>,
    // tan of half the field: x scale, y scale, x offset, y offset (direction = ndc * scale + offset).
    ray: vec4<f32>,
    // Linear RGB shown where nothing is hit; w: factor of the environment.
    background: vec4<f32>,
    // Irradiance / pi from everywhere; w: environment rotation about +Y, radians.
    ambient: vec4<f32>,
    // First light of this environment and instant.
    light_base: u32,
    // First shadow matrix of this environment and instant, and first layer of this environment.
    shadow_matrix_base: u32,
    shadow_layer_base: u32,
    pad: u32,
};

fn camera_position(frame: Frame) -> vec3<f32> {
    return vec3<f32>(
        frame.world_from_camera_right.w, frame.world_from_camera_up.w, frame.world_from_camera_back.w);
}

// World direction of the ray through `ndc` (x right, y up); not normalised, -1 along the optical axis.
fn ray_direction(frame: Frame, ndc: vec2<f32>) -> vec3<f32> {
    let d = ndc * frame.ray.xy + frame.ray.zw;
    return frame.world_from_camera_right.xyz * d.x
        + frame.world_from_camera_up.xyz * d.y
        - frame.world_from_camera_back.xyz;
}
