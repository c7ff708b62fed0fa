#import reuse/layout.wgsl
// Mean light of a pixel around every corner of a keyframe's cells; below 0 where the pixel shows more than one surface.
// Twin: cpu/reuse.rs, mean_at.

// Cells along a pixel's side, even.
override CELLS: u32 = 2;
// Part of an inverse depth by which cells of one surface may differ.
override SMOOTH: f32 = 0.02;

struct MeanParams {
    width: u32,
    height: u32,
    layer: u32,
    pad: u32,
};

@group(0) @binding(0) var<uniform> params: MeanParams;
@group(0) @binding(1) var lights: texture_2d_array<f32>;
@group(0) @binding(2) var keys: texture_2d_array<u32>;
@group(0) @binding(3) var means: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let half = CELLS / 2u;
    var mean = -1.0;
    if (all(id.xy >= vec2<u32>(half)) && id.x + half <= params.width && id.y + half <= params.height) {
        let first = textureLoad(keys, id.xy - half, params.layer, 0).r;
        let depth = bitcast<f32>(first & ~NUMBER_BITS);
        var one = depth > 0.0;
        var sum = 0.0;
        for (var y = 0u; y < CELLS; y++) {
            for (var x = 0u; x < CELLS; x++) {
                let at = id.xy - half + vec2<u32>(x, y);
                sum += textureLoad(lights, at, params.layer, 0).r;
                one &= shows(textureLoad(keys, at, params.layer, 0).r, first, depth, SMOOTH);
            }
        }
        mean = select(-1.0, sum / f32(CELLS * CELLS), one);
    }
    textureStore(means, id.xy, params.layer, vec4<f32>(mean, 0.0, 0.0, 0.0));
}
