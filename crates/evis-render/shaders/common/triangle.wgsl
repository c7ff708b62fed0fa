// A triangle over all of a target: corner `i` in normalised device coordinates.
fn covering_corner(i: u32) -> vec2<f32> {
    return vec2<f32>(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0);
}
