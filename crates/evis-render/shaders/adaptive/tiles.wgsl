#import common/tile.wgsl
// A workgroup per tile that was drawn.

// Twin: gpu/uniforms.rs, MeanJob.
struct MeanJob {
    // Of `tiles`.
    first: u32,
    count: u32,
    // Workgroups per row of the dispatch.
    row: u32,
    layer: u32,
};

@group(0) @binding(0) var<uniform> job: MeanJob;
// Column | row << 16.
@group(0) @binding(1) var<storage, read> tiles: array<u32>;

// The upper left pixel of a tile.
fn tile_corner(number: u32) -> vec2<u32> {
    let tile = tiles[job.first + number];
    return vec2<u32>(tile & 0xffffu, tile >> 16u) * TILE;
}
