#import trigger/layout.wgsl
// Where the events of each pixel lie in the list of a submission.

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> prefixes: array<u32>;
@group(0) @binding(3) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> status: Status;

// `count` events from `first` on, of the pixel with this index in buffers.
struct Listed {
    index: u32,
    first: u32,
    count: u32,
};

// None outside of the image, and where the submission did not fit.
fn listed(id: vec3<u32>) -> Listed {
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    if (status.stalled != 0u || id.x >= params.width) {
        return Listed(index, 0u, 0u);
    }
    let count = counts[index];
    if (count == 0u) {
        return Listed(index, 0u, 0u);
    }
    return Listed(index, block_offsets[index / BLOCK_PIXELS] + prefixes[index], count);
}
