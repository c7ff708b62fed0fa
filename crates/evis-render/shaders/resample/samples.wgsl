#import resample/footprint.wgsl
// A pixel of a camera with a distorted lens: the weighted mean of the samples that fall into it, in linear light, out of a
// picture without distortion, with a layer each. Twin: cpu/resample.rs.
@group(0) @binding(2) var pictures: texture_2d_array<f32>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(layer);
    if (id.x >= size.x || id.y >= size.y) {
        return;
    }
    let pixel = id.y * size.x + id.x;
    let end = starts[pixel + 1u];
    var sum = 0.0;
    for (var i = starts[pixel]; i < end; i++) {
        let entry = entries[i];
        sum += textureLoad(pictures, texel_of(entry), index_of(entry), 0).r * bitcast<f32>(entry.y);
    }
    textureStore(layer, id.xy, vec4<f32>(sum, 0.0, 0.0, 0.0));
}
