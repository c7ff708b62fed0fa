#import trigger/sample.wgsl
#import trigger/decide.wgsl
// Walks the pixels that fire once more, through the same decision, and writes their events to their places.

@group(0) @binding(3) var<storage, read> memory_in: array<PixelMemory>;
@group(0) @binding(4) var<storage, read> counts: array<u32>;
@group(0) @binding(5) var<storage, read> prefixes: array<u32>;
@group(0) @binding(6) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(7) var<storage, read_write> status: Status;
// x: microseconds since the submission's base; y: column | row << 13 | polarity << 26 | cause << 27 (0 signal).
@group(0) @binding(8) var<storage, read_write> events: array<vec2<u32>>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    let count = counts[index];
    if (count == 0u || status.stalled != 0u) {
        return;
    }
    let sensor = sensors[id.z];
    let packed_pixel = id.x | (id.y << 13u);
    let base = block_offsets[index / BLOCK_PIXELS] + prefixes[index];
    var state = memory_in[index];
    var written = 0u;
    var k = 0u;
    if (params.first == 1u) {
        let l = log_luma_at(sensor, id.xy, id.z, 0u);
        state = PixelMemory(l, l);
        k = 1u;
    }
    for (; k < params.instants; k++) {
        let l = log_luma_at(sensor, id.xy, id.z, k);
        let decision = decide(sensor, state, l);
        let start = instant_time(k);
        let interval = instant_time(k + 1u) - start;
        for (var i = 1u; i <= decision.count && written < count; i++) {
            let t = start + fire_time(decision, i, interval);
            events[base + written] = vec2<u32>(t, packed_pixel | (decision.polarity << 26u));
            written++;
        }
        state = PixelMemory(decision.reference_log, l);
    }
    if (written != count) {
        atomicAdd(&status.mismatched, 1u);
    }
}
