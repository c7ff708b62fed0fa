#import adaptive/tiles.wgsl
// Mean of a pixel's coverage samples in linear light, four at each place of a grid, in the tiles that were drawn. Twin:
// trigger/resolve.wgsl has the same sum over whole pictures.

override GRID: u32 = 1;

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
    for (var place = 0u; place < GRID * GRID; place++) {
        let at = pixel * GRID + vec2<u32>(place % GRID, place / GRID);
        for (var s = 0; s < 4; s++) {
            sum += textureLoad(samples, at, s).r;
        }
    }
    textureStore(layers, pixel, job.layer, vec4<f32>(sum * (0.25 / f32(GRID * GRID)), 0.0, 0.0, 0.0));
}
