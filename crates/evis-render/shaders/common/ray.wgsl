// Direction of the ray through `ndc` (x right, y up) of a camera with such axes; not normalised, -1 along the optical axis.
// `ray` is tan of half the field: x scale, y scale, x offset, y offset.
fn direction_through(ndc: vec2<f32>, ray: vec4<f32>, right: vec3<f32>, up: vec3<f32>, back: vec3<f32>) -> vec3<f32> {
    let d = ndc * ray.xy + ray.zw;
    return right * d.x + up * d.y - back;
}
