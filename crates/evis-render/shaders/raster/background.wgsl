#import common/sky_vertex.wgsl
// What lies behind everything, over a part of a picture that is not cleared whole. The prelude has BACKGROUND.

@fragment
fn fs_main() -> @location(0) f32 {
    return BACKGROUND;
}
