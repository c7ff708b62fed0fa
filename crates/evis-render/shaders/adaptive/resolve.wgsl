#import adaptive/tiles.wgsl
// Mean of a pixel's four coverage samples in linear light, in the tiles that were drawn. Twin: trigger/resolve.wgsl has
// the same sum over whole pictures.

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
    var sum = 0.0;
    for (var s = 0; s < 4; s++) {
        sum += textureLoad(samples, pixel, s).r;
    }
    textureStore(layers, pixel, job.layer, vec4<f32>(sum * 0.25, 0.0, 0.0, 0.0));
}
