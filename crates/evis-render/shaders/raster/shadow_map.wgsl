#import raster/stage.wgsl
#import raster/material.wgsl
// Depth from a light. objects[].clip_from_object is then light clip space; masked casters keep their holes.

@fragment
fn fs_masked(v: Varyings) {
    if (alpha(v) < material.emissive.w) {
        discard;
    }
}
