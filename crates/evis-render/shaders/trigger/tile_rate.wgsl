#import trigger/layout.wgsl
#import common/tile.wgsl
// How often each tile of a picture is sampled. Twin: sampling/tile_rate.rs.

// Instants of a block, a power of two; 1 where every pixel is sampled at every instant.
override BLOCK_INSTANTS: u32 = 1;

// Per view and block a layer: log2 of the instants from one sample of a tile to the next.
@group(0) @binding(12) var tile_rates: texture_2d_array<u32>;

// Instants from one sample of a pixel to the next, in the block that holds `instant`. Its last instant is always one.
fn step_at(pixel: vec2<u32>, view: u32, instant: u32) -> u32 {
    if (BLOCK_INSTANTS == 1u) {
        return 1u;
    }
    let layer = view * ((params.instants + BLOCK_INSTANTS - 1u) / BLOCK_INSTANTS) + instant / BLOCK_INSTANTS;
    return 1u << textureLoad(tile_rates, pixel / TILE, layer, 0).r;
}

// The first sample of a pixel at or after `instant`, where it is sampled every `step` instants.
fn sample_from(instant: u32, step: u32) -> u32 {
    return instant | (step - 1u);
}

// From the instant before `start` to instant `end`: x when it begins, y its microseconds; zw when it begins, in stream time.
fn span_between(start: u32, end: u32) -> vec4<u32> {
    let first = params.spans[start];
    let last = params.spans[end];
    return vec4<u32>(first.x, last.x + last.y - first.x, first.zw);
}
