#import trigger/sample.wgsl
#import trigger/decide.wgsl
// Counts each pixel's events over the instants of a submission and writes its next memory beside the old one.
// The old memory stays until the submission is known to fit: that is what lets it run again.

@group(0) @binding(3) var<storage, read> memory_in: array<PixelMemory>;
@group(0) @binding(4) var<storage, read_write> memory_out: array<PixelMemory>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> status: Status;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (status.stalled != 0u) {
        return;
    }
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    if (id.x >= params.width) {
        counts[index] = 0u;
        return;
    }
    let sensor = sensors[id.z];
    var state = memory_in[index];
    var count = 0u;
    var k = 0u;
    if (params.first == 1u) {
        let l = log_luma_at(sensor, id.xy, id.z, 0u);
        state = PixelMemory(l, l);
        k = 1u;
    }
    for (; k < params.instants; k++) {
        let l = log_luma_at(sensor, id.xy, id.z, k);
        let decision = decide(sensor, state, l);
        if (decision.clamped) {
            atomicAdd(&status.clamped, 1u);
        }
        count += decision.count;
        state = PixelMemory(decision.reference_log, l);
    }
    counts[index] = count;
    memory_out[index] = state;
}
