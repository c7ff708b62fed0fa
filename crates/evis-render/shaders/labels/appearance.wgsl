#import raster/stage.wgsl
#import raster/surface.wgsl
// Appearance labels, one sample at the pixel's centre: linear RGB and the world normal.

struct AppearanceOut {
    @location(0) color: vec4<f32>,
    @location(1) normal: vec4<f32>,
};

@fragment
fn fs_main(v: Varyings, @builtin(front_facing) front: bool) -> AppearanceOut {
    // The label is the geometric (interpolated) normal; normal maps change shading only.
    let n = normalize(vary_normal(v));
    return AppearanceOut(vec4<f32>(surface_radiance(v, front), 1.0), vec4<f32>(select(-n, n, front), 1.0));
}
