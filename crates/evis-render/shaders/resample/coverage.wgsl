#import resample/footprint.wgsl
// A pixel of a camera with a distorted lens: the weighted mean of the texels that lie in it, in linear light, out of a picture
// without distortion; each texel is the mean of its four coverage samples. Twin: cpu/resample.rs.
@group(0) @binding(2) var pictures: texture_multisampled_2d<f32>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let footprint = footprint_of(id.xy);
    if (footprint.begin > footprint.end) {
        return;
    }
    var sum = 0.0;
    for (var i = footprint.begin; i < footprint.end; i++) {
        let entry = entries[i];
        let texel = texel_of(entry);
        var light = 0.0;
        for (var s = 0; s < 4; s++) {
            light += textureLoad(pictures, texel, s).r;
        }
        sum += 0.25 * light * bitcast<f32>(entry.y);
    }
    textureStore(layer, footprint.pixel, vec4<f32>(sum, 0.0, 0.0, 0.0));
}
