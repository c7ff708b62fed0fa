#import common/sky_vertex.wgsl
// What lies behind everything, over a part of a picture that is not cleared whole.

// Luminance.
override BACKGROUND: f32 = 0.0;

@fragment
fn fs_main() -> @location(0) f32 {
    return BACKGROUND;
}
