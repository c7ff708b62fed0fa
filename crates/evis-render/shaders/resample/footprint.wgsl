// The samples of a pixel of a camera with a distorted lens. Twin: cpu/resample.rs.

// Bits of a texel's x and y in an entry; the layer has the others.
override EDGE_BITS: u32 = 12;

// Of a band of rows: its first row, then, for pixel p of the band, where its entries begin; the next begin where they end.
@group(0) @binding(0) var<storage, read> starts: array<u32>;
// x a packed texel, y the bits of a weight.
@group(0) @binding(1) var<storage, read> entries: array<vec2<u32>>;
@group(0) @binding(3) var layer: texture_storage_2d<r32float, write>;

struct Footprint {
    pixel: vec2<u32>,
    begin: u32,
    end: u32,
};

// Of the band's pixel `id`; `end` is 0 outside of the band.
fn footprint_of(id: vec2<u32>) -> Footprint {
    let width = textureDimensions(layer).x;
    let place = id.y * width + id.x;
    if (id.x >= width || place + 2u >= arrayLength(&starts)) {
        return Footprint(vec2<u32>(0u), 1u, 0u);
    }
    return Footprint(vec2<u32>(id.x, id.y + starts[0]), starts[place + 1u], starts[place + 2u]);
}

fn texel_of(entry: vec2<u32>) -> vec2<u32> {
    let mask = (1u << EDGE_BITS) - 1u;
    return vec2<u32>(entry.x & mask, entry.x >> EDGE_BITS & mask);
}

fn index_of(entry: vec2<u32>) -> u32 {
    return entry.x >> (2u * EDGE_BITS);
}
