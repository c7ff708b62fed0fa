#import trigger/layout.wgsl
// Adds the events of a submission to a dense array of one window of time, where the host takes arrays in the place of
// events. A pixel's events lie one after the other, in time order, and its invocation alone writes its values: no atomic,
// and sums are the same in every run.

// What is made: 0 events per polarity; 1 a voxel grid; 2 a voxel grid per polarity; 3 when a pixel fired last, per polarity.
override KIND: u32 = 0u;
// Of a voxel grid.
override BINS: u32 = 1u;

struct DenseWindow {
    // Microseconds from the submission's base to the window's start, which may lie before it, and to its end.
    start: i32,
    end: i32,
};

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<uniform> window: DenseWindow;
@group(0) @binding(2) var<storage, read> counts: array<u32>;
@group(0) @binding(3) var<storage, read> prefixes: array<u32>;
@group(0) @binding(4) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(5) var<storage, read_write> status: Status;
@group(0) @binding(6) var<storage, read> events: array<vec2<u32>>;
// View by view, plane by plane, row by row; of voxel grids the bits of floats.
@group(0) @binding(7) var<storage, read_write> dense: array<u32>;

fn add(at: u32, value: f32) {
    dense[at] = bitcast<u32>(bitcast<f32>(dense[at]) + value);
}

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
    let plane = params.width * params.height;
    let planes = select(2u, select(BINS, 2u * BINS, KIND == 2u), KIND == 1u || KIND == 2u);
    let pixel = id.z * planes * plane + id.y * params.width + id.x;
    for (var i = 0u; i < count; i++) {
        let event = events[first + i];
        let t = i32(event.x);
        if (t < window.start || t >= window.end) {
            continue;
        }
        let since = u32(t - window.start);
        let polarity = (event.y >> 26u) & 1u;
        if (KIND == 0u) {
            dense[pixel + polarity * plane] += 1u;
        } else if (KIND == 3u) {
            // 0 is never.
            dense[pixel + polarity * plane] = since + 1u;
        } else {
            let length = u32(window.end - window.start);
            let place = since * (BINS - 1u);
            let bin = place / length;
            let later = f32(place % length) / f32(length);
            var worth = 1.0;
            var at = pixel + bin * plane;
            if (KIND == 2u) {
                at += polarity * BINS * plane;
            } else if (polarity == 0u) {
                worth = -1.0;
            }
            add(at, worth * (1.0 - later));
            if (bin + 1u < BINS) {
                add(at + plane, worth * later);
            }
        }
    }
}
