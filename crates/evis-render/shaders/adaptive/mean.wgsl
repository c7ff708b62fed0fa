#import common/mean.wgsl
#import adaptive/tiles.wgsl
// Mean of a pixel's samples in linear light, into the layer of an instant, in the tiles that were drawn: a pixel which is
// sampled always has the light that it has without tiles.

// Rows of a tile between those of one invocation, which thus looks up its tile once for several pixels.
const ROWS: u32 = 4u;

@group(0) @binding(2) var samples: texture_storage_2d_array<r32float, read>;
@group(0) @binding(3) var layers: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(TILE, ROWS)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) id: vec3<u32>) {
    let number = tile_number(group, job.row);
    if (number >= job.count) {
        return;
    }
    let corner = tile_corner(number);
    let size = textureDimensions(layers);
    for (var row = id.y; row < TILE; row += ROWS) {
        let pixel = corner + vec2<u32>(id.x, row);
        if (any(pixel >= size)) {
            return;
        }
        textureStore(layers, pixel, job.layer, vec4<f32>(mean_of_samples(samples, pixel, 0u), 0.0, 0.0, 0.0));
    }
}
