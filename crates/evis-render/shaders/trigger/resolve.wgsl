// --aa edges: mean of the coverage samples of a pixel, four at each place of a grid, in linear light, into one layer.
override GRID: u32 = 1;

@group(0) @binding(0) var samples: texture_multisampled_2d<f32>;
@group(0) @binding(1) var layer: texture_storage_2d<r32float, write>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(layer);
    if (id.x >= size.x || id.y >= size.y) {
        return;
    }
    var sum = 0.0;
    for (var place = 0u; place < GRID * GRID; place++) {
        let at = id.xy * GRID + vec2<u32>(place % GRID, place / GRID);
        for (var s = 0; s < 4; s++) {
            sum += textureLoad(samples, at, s).r;
        }
    }
    textureStore(layer, id.xy, vec4<f32>(sum * (0.25 / f32(GRID * GRID)), 0.0, 0.0, 0.0));
}
