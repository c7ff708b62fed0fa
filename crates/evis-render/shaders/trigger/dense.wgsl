// Adds events to the dense array of one window of time, where the host takes arrays in the place of events. A pixel's events
// come in time order, and one invocation writes its values: no atomic, and sums are the same in every run.

// What is made: 0 events per polarity; 1 a voxel grid; 2 a voxel grid per polarity; 3 when a pixel fired last, per polarity.
override KIND: u32 = 0u;
// Of a voxel grid.
override BINS: u32 = 1u;

struct WindowBounds {
    // Microseconds from the submission's base to the window's start, which may lie before it, and to its end.
    start: i32,
    end: i32,
};

@group(0) @binding(9) var<uniform> window: WindowBounds;
// View by view, plane by plane, row by row; of voxel grids the bits of floats.
@group(0) @binding(10) var<storage, read_write> dense: array<u32>;

// Where the values of a pixel of `size` pixels begin, and how far apart its planes are.
struct DensePlace {
    first: u32,
    plane: u32,
};

fn dense_place(id: vec3<u32>, size: vec2<u32>) -> DensePlace {
    let plane = size.x * size.y;
    let planes = select(2u, select(BINS, 2u * BINS, KIND == 2u), KIND == 1u || KIND == 2u);
    return DensePlace(id.z * planes * plane + id.y * size.x + id.x, plane);
}

fn add_value(at: u32, value: f32) {
    dense[at] = bitcast<u32>(bitcast<f32>(dense[at]) + value);
}

// An event `t` microseconds after the submission's base.
fn add_event(place: DensePlace, t: u32, polarity: u32) {
    if (i32(t) < window.start || i32(t) >= window.end) {
        return;
    }
    let since = u32(i32(t) - window.start);
    if (KIND == 0u) {
        dense[place.first + polarity * place.plane] += 1u;
    } else if (KIND == 3u) {
        // 0 is never.
        dense[place.first + polarity * place.plane] = since + 1u;
    } else {
        let length = u32(window.end - window.start);
        let weighted = since * (BINS - 1u);
        let bin = weighted / length;
        let later = f32(weighted % length) / f32(length);
        var worth = 1.0;
        var at = place.first + bin * place.plane;
        if (KIND == 2u) {
            at += polarity * BINS * place.plane;
        } else if (polarity == 0u) {
            worth = -1.0;
        }
        add_value(at, worth * (1.0 - later));
        if (bin + 1u < BINS) {
            add_value(at + place.plane, worth * later);
        }
    }
}
