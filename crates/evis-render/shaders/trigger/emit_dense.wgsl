#import trigger/visit.wgsl
#import trigger/dense.wgsl
// Adds the events of pixels to a dense array as they fire; there is no list of events.

fn place_of(id: vec3<u32>) -> DensePlace {
    return dense_place(id, vec2<u32>(params.width, params.height));
}

fn put(place: DensePlace, number: u32, t: u32, polarity: u32) {
    add_event(place, t, polarity);
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) workgroup: vec3<u32>) {
    visit(id, workgroup);
}
