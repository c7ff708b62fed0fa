// Adds events to the dense arrays of two windows of time, one after the other, where the host takes arrays in the place of
// events. A pixel's events come in time order, and one invocation writes its values: no atomic, and sums are the same in
// every run.

// What is made: 0 events per polarity; 1 a voxel grid; 2 a voxel grid per polarity; 3 when a pixel fired last, per polarity.
override KIND: u32 = 0u;
// Of a voxel grid.
override BINS: u32 = 1u;

struct WindowBounds {
    // Microseconds from the submission's base to the first window's start, which may lie before it, and to its end, where the
    // second one begins.
    start: i32,
    end: i32,
};

@group(0) @binding(9) var<uniform> window: WindowBounds;
// View by view, plane by plane, row by row; of voxel grids the bits of floats.
@group(0) @binding(10) var<storage, read_write> dense: array<u32>;
// Of the second window. A submission's last instant mostly is the first microsecond of one.
@group(0) @binding(11) var<storage, read_write> dense_after: array<u32>;

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

fn word_at(is_after: bool, at: u32) -> u32 {
    if (is_after) {
        return dense_after[at];
    }
    return dense[at];
}

fn set_word(is_after: bool, at: u32, word: u32) {
    if (is_after) {
        dense_after[at] = word;
    } else {
        dense[at] = word;
    }
}

fn add_value(is_after: bool, at: u32, value: f32) {
    set_word(is_after, at, bitcast<u32>(bitcast<f32>(word_at(is_after, at)) + value));
}

// An event `t` microseconds after the submission's base.
fn add_event(place: DensePlace, t: u32, polarity: u32) {
    let length = window.end - window.start;
    let from_start = i32(t) - window.start;
    if (from_start < 0 || from_start >= 2 * length) {
        return;
    }
    let is_after = from_start >= length;
    let since = u32(select(from_start, from_start - length, is_after));
    if (KIND == 0u) {
        let at = place.first + polarity * place.plane;
        set_word(is_after, at, word_at(is_after, at) + 1u);
    } else if (KIND == 3u) {
        // 0 is never.
        set_word(is_after, place.first + polarity * place.plane, since + 1u);
    } else {
        let weighted = since * (BINS - 1u);
        let bin = weighted / u32(length);
        let later = f32(weighted % u32(length)) / f32(length);
        var worth = 1.0;
        var at = place.first + bin * place.plane;
        if (KIND == 2u) {
            at += polarity * BINS * place.plane;
        } else if (polarity == 0u) {
            worth = -1.0;
        }
        add_value(is_after, at, worth * (1.0 - later));
        if (bin + 1u < BINS) {
            add_value(is_after, at + place.plane, worth * later);
        }
    }
}
