#import trigger/layout.wgsl
#import trigger/dense.wgsl
// Adds the events of a submission to a dense array: those of a pixel lie one after the other.

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> prefixes: array<u32>;
@group(0) @binding(3) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> status: Status;
@group(0) @binding(6) var<storage, read> events: array<vec2<u32>>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    if (status.stalled != 0u || id.x >= params.width) {
        return;
    }
    let count = counts[index];
    if (count == 0u) {
        return;
    }
    let first = block_offsets[index / BLOCK_PIXELS] + prefixes[index];
    let place = dense_place(id, vec2<u32>(params.width, params.height));
    for (var i = 0u; i < count; i++) {
        let event = events[first + i];
        add_event(place, event.x, (event.y >> 26u) & 1u);
    }
}
