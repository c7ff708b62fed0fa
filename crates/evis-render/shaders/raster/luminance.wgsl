#import raster/stage.wgsl
#import raster/surface.wgsl
// The raster pass of `native`: one luminance target and depth, nothing else.

@fragment
fn fs_main(v: Varyings, @builtin(front_facing) front: bool) -> @location(0) f32 {
    return luminance(surface_radiance(v, front));
}
