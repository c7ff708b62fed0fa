#import trigger/layout.wgsl
// What counting kept of each pixel, to its place. Pixels with more events than that are walked once more.

// As in chain/layout.wgsl.
override KEPT: u32 = 4;

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> prefixes: array<u32>;
@group(0) @binding(3) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> status: Status;
@group(0) @binding(5) var<storage, read> kept: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> events: array<vec2<u32>>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    if (status.stalled != 0u || id.x >= params.width) {
        return;
    }
    let count = counts[index];
    if (count == 0u || count > KEPT) {
        return;
    }
    let place = block_offsets[index / BLOCK_PIXELS] + prefixes[index];
    for (var i = 0u; i < count; i++) {
        events[place + i] = kept[index * KEPT + i];
    }
}
