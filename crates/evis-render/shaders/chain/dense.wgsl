#import chain/places.wgsl
#import trigger/dense.wgsl
// Adds the events of a submission to dense arrays: those of a pixel lie one after the other.

@group(0) @binding(6) var<storage, read> events: array<vec2<u32>>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let own = listed(id);
    let place = dense_place(id, vec2<u32>(params.width, params.height));
    for (var i = 0u; i < own.count; i++) {
        let event = events[own.first + i];
        add_event(place, event.x, (event.y >> 26u) & 1u);
    }
}
