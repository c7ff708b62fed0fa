#import trigger/visit.wgsl
// Writes the events of pixels to their places.

@group(0) @binding(5) var<storage, read> prefixes: array<u32>;
@group(0) @binding(6) var<storage, read> block_offsets: array<u32>;
// x: microseconds since the submission's base; y: column | row << 13 | polarity << 26 | cause << 27 (0 signal).
@group(0) @binding(8) var<storage, read_write> events: array<vec2<u32>>;

// Where a pixel's events go.
struct Place {
    first: u32,
    packed_pixel: u32,
};

fn place_of(id: vec3<u32>) -> Place {
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    return Place(block_offsets[index / BLOCK_PIXELS] + prefixes[index], id.x | (id.y << 13u));
}

fn put(place: Place, number: u32, t: u32, polarity: u32) {
    events[place.first + number] = vec2<u32>(t, place.packed_pixel | (polarity << 26u));
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) workgroup: vec3<u32>) {
    visit(id, workgroup);
}
