#import adaptive/tiles.wgsl
// Mean of a pixel's samples in linear light, into the layer of an instant, in the tiles that were drawn. Summed as
// trigger/count.wgsl does, so that a pixel which is sampled always has the light that it has without tiles.

// Rows of a tile between those of one invocation, which thus looks up its tile once for several pixels.
const ROWS: u32 = 4u;
override SAMPLES: u32 = 1;

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
        var sum = 0.0;
        for (var s = 0u; s < SAMPLES; s++) {
            sum += textureLoad(samples, pixel, s).r;
        }
        textureStore(layers, pixel, job.layer, vec4<f32>(sum * (1.0 / f32(SAMPLES)), 0.0, 0.0, 0.0));
    }
}
