#import trigger/layout.wgsl
// Exclusive prefix of the counts within each block of a row, and each block's sum.

struct BlockParams {
    block_count: u32,
    // Invocations per row of the dispatch.
    row: u32,
};

@group(0) @binding(0) var<uniform> block_params: BlockParams;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> prefixes: array<u32>;
@group(0) @binding(3) var<storage, read_write> block_sums: array<u32>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = id.y * block_params.row + id.x;
    if (block >= block_params.block_count) {
        return;
    }
    var sum = 0u;
    for (var i = 0u; i < BLOCK_PIXELS; i++) {
        let at = block * BLOCK_PIXELS + i;
        let n = counts[at];
        prefixes[at] = sum;
        sum += n;
    }
    block_sums[block] = sum;
}
