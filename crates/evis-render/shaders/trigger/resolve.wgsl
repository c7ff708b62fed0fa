#import common/coverage.wgsl
// --antialias edges: mean of the coverage samples of a pixel, in linear light, into one layer.
@group(0) @binding(0) var samples: texture_multisampled_2d<f32>;
@group(0) @binding(1) var layer: texture_storage_2d<r32float, write>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(layer);
    if (id.x >= size.x || id.y >= size.y) {
        return;
    }
    textureStore(layer, id.xy, vec4<f32>(coverage_mean(samples, id.xy), 0.0, 0.0, 0.0));
}
