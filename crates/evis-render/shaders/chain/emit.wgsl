#import chain/places.wgsl
// What counting kept of each pixel, to its place. Pixels with more events than that are walked once more.

// As in chain/layout.wgsl.
override KEPT: u32 = 4;

@group(0) @binding(5) var<storage, read> kept: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> events: array<vec2<u32>>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let own = listed(id);
    if (own.count > KEPT) {
        return;
    }
    for (var i = 0u; i < own.count; i++) {
        events[own.first + i] = kept[own.index * KEPT + i];
    }
}
