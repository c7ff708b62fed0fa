#import raster/stage.wgsl
#import raster/surface.wgsl
#import reuse/layout.wgsl
// A keyframe: light of every cell, and what is seen there. Nothing is used again of the sky.

@group(3) @binding(0) var<uniform> reuse: ReuseFrame;

struct Cell {
    @location(0) light: f32,
    @location(1) key: u32,
};

@fragment
fn fs_main(v: Varyings, @builtin(front_facing) front: bool) -> Cell {
    // 1 is added: 0 is the sky's.
    let number = vary_number(v) - reuse.first_record + 1u;
    return Cell(luminance(surface_radiance(v, front)), cell_key(number, v.position.w));
}
