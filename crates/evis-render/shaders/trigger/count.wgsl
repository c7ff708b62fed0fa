#import trigger/sample.wgsl
#import trigger/pace.wgsl
#import trigger/decide.wgsl
// Counts each pixel's events over the instants of a submission and writes its next memory beside the old one.
// The old memory stays until the submission is known to fit: that is what lets it run again.

@group(0) @binding(3) var<storage, read> memory_in: array<PixelMemory>;
@group(0) @binding(4) var<storage, read_write> memory_out: array<PixelMemory>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> status: Status;
// Per pixel, bit k: it fires at instant k.
@group(0) @binding(7) var<storage, read_write> fired: array<u32>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) workgroup: vec3<u32>) {
    if (status.stalled != 0u) {
        return;
    }
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    if (id.x >= params.width) {
        counts[index] = 0u;
        return;
    }
    let sensor = sensors[workgroup.z];
    var state = memory_in[index];
    var count = 0u;
    var fires = 0u;
    var clamped = 0u;
    var k = 0u;
    if (params.first == 1u) {
        let l = log_luma_at(sensor, id.xy, id.z, 0u);
        state = PixelMemory(l, l);
        k = 1u;
    }
    var unknown = 0u;
    while (k < params.instants) {
        // A view's tiles are sampled at their own pace.
        let at = sample_from(k, step_at(id.xy, id.z, k));
        k = at + 1u;
        if (is_unknown(id.xy, id.z, at)) {
            unknown++;
            continue;
        }
        let l = log_luma_at(sensor, id.xy, id.z, at);
        let decision = decide(sensor, state, l);
        clamped += u32(decision.clamped);
        fires |= u32(decision.count != 0u) << at;
        count += decision.count;
        state = PixelMemory(decision.reference_log, l);
    }
    if (clamped != 0u) {
        atomicAdd(&status.clamped, clamped);
    }
    if (unknown != 0u) {
        atomicAdd(&status.unknown, unknown);
    }
    counts[index] = count;
    fired[index] = fires;
    memory_out[index] = state;
}
