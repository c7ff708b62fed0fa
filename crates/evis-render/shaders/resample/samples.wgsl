#import resample/footprint.wgsl
// A pixel of a camera with a distorted lens: the weighted mean of the samples whose cells lie in it, in linear light, out of a
// picture without distortion, with a layer for each. Twin: cpu/resample.rs.
@group(0) @binding(2) var pictures: texture_2d_array<f32>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let footprint = footprint_of(id.xy);
    if (footprint.begin > footprint.end) {
        return;
    }
    var sum = 0.0;
    for (var i = footprint.begin; i < footprint.end; i++) {
        let entry = entries[i];
        sum += textureLoad(pictures, texel_of(entry), index_of(entry), 0).r * bitcast<f32>(entry.y);
    }
    textureStore(layer, footprint.pixel, vec4<f32>(sum, 0.0, 0.0, 0.0));
}
