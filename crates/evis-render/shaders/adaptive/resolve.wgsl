#import adaptive/tiles.wgsl
#import common/coverage.wgsl
// Mean of a pixel's coverage samples in linear light, in the tiles that were drawn; trigger/resolve.wgsl has it of whole
// pictures.

@group(0) @binding(2) var samples: texture_multisampled_2d<f32>;
@group(0) @binding(3) var layers: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) id: vec3<u32>) {
    let number = tile_number(group, job.row);
    if (number >= job.count) {
        return;
    }
    let pixel = tile_corner(number) + id.xy;
    if (any(pixel >= textureDimensions(layers))) {
        return;
    }
    textureStore(layers, pixel, job.layer, vec4<f32>(coverage_mean(samples, pixel), 0.0, 0.0, 0.0));
}
