#import splat/layout.wgsl
// Flags the tiles in which the newer keyframe leaves holes, so that the older one is asked there only.

@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> hole_tiles: array<u32>;

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let at = (id.z * params.height + id.y) * params.width + id.x;
    let word = sums[sums_base(1u) + target_pixels() + at];
    if (f32(word) < HOLE_WEIGHT) {
        // A source looks at the first of its four pixels: this one may be any of them. All write the same.
        let p = vec2<i32>(id.xy);
        hole_tiles[hole_tile(p, id.z)] = 1u;
        hole_tiles[hole_tile(p - vec2<i32>(1, 0), id.z)] = 1u;
        hole_tiles[hole_tile(p - vec2<i32>(0, 1), id.z)] = 1u;
        hole_tiles[hole_tile(p - 1, id.z)] = 1u;
    }
}
