// The samples of a pixel of a camera with a distorted lens. Twin: cpu/resample.rs.

// Bits of a texel's x and y in an entry; the layer or coverage sample has the others.
override EDGE_BITS: u32 = 12;

// Pixel p has the entries from starts[p] up to starts[p + 1]: x a packed texel, y the bits of a weight.
@group(0) @binding(0) var<storage, read> starts: array<u32>;
@group(0) @binding(1) var<storage, read> entries: array<vec2<u32>>;
@group(0) @binding(3) var layer: texture_storage_2d<r32float, write>;

fn texel_of(entry: vec2<u32>) -> vec2<u32> {
    let mask = (1u << EDGE_BITS) - 1u;
    return vec2<u32>(entry.x & mask, entry.x >> EDGE_BITS & mask);
}

fn index_of(entry: vec2<u32>) -> u32 {
    return entry.x >> (2u * EDGE_BITS);
}
