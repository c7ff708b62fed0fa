#import trigger/layout.wgsl
// Block sums to block offsets, in place, by one workgroup; the offset at which each view starts; and whether it fits.
// WGSL promises no forward progress between workgroups, so there is no look-back: each invocation sums a run of
// blocks, the runs are scanned in workgroup memory, and each invocation walks its run again.

const SCAN_WORKGROUP: u32 = 256u;

struct ScanParams {
    block_count: u32,
    blocks_per_view: u32,
    view_count: u32,
    event_capacity: u32,
};

@group(0) @binding(0) var<uniform> scan_params: ScanParams;
@group(0) @binding(1) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> view_offsets: array<u32>;
@group(0) @binding(3) var<storage, read_write> status: Status;

var<workgroup> partial: array<u32, SCAN_WORKGROUP>;

@compute @workgroup_size(SCAN_WORKGROUP)
fn main(@builtin(local_invocation_id) id: vec3<u32>) {
    let run = (scan_params.block_count + SCAN_WORKGROUP - 1u) / SCAN_WORKGROUP;
    let first = min(id.x * run, scan_params.block_count);
    let end = min(first + run, scan_params.block_count);
    var sum = 0u;
    for (var b = first; b < end; b++) {
        sum += block_sums[b];
    }
    partial[id.x] = sum;
    workgroupBarrier();
    for (var reach = 1u; reach < SCAN_WORKGROUP; reach *= 2u) {
        var add = 0u;
        if (id.x >= reach) {
            add = partial[id.x - reach];
        }
        workgroupBarrier();
        partial[id.x] += add;
        workgroupBarrier();
    }
    if (status.stalled == 0u) {
        var offset = partial[id.x] - sum;
        for (var b = first; b < end; b++) {
            let n = block_sums[b];
            block_sums[b] = offset;
            if (b % scan_params.blocks_per_view == 0u) {
                view_offsets[b / scan_params.blocks_per_view] = offset;
            }
            offset += n;
        }
    }
    workgroupBarrier();
    storageBarrier();
    if (id.x == SCAN_WORKGROUP - 1u && status.stalled == 0u) {
        let total = partial[id.x];
        view_offsets[scan_params.view_count] = total;
        status.event_count = total;
        if (total > scan_params.event_capacity) {
            status.stalled = 1u;
        }
    }
}
