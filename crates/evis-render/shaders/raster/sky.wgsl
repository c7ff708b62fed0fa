#import common/frame.wgsl
#import common/sky_vertex.wgsl
#import common/luminance.wgsl
#import raster/environment.wgsl
// The environment behind everything.

@fragment
fn fs_luminance(v: SkyVaryings) -> @location(0) f32 {
    return luminance(environment_sky(ray_direction(v.ndc)));
}

@fragment
fn fs_color(v: SkyVaryings) -> @location(0) vec4<f32> {
    return vec4<f32>(environment_sky(ray_direction(v.ndc)), 1.0);
}
