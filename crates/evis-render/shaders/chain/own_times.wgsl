#import chain/state.wgsl
// Light of pixels at times of their own, as decoupled sampling finds it: at the ends of equal parts of a view's block. What light a
// pixel sees is in the place of `tile_rates`, a layer per view and a texel per pixel; all light lies in `luminance_layers`, number
// by number.

// Flags beside the number of parts: light jumps to the first of it at the start, the pixel is left as it is, it begins.
const LIGHT_PARTS: u32 = 0xffffu;
const LIGHT_JUMPS: u32 = 0x10000u;
const LIGHT_RESTS: u32 = 0x20000u;
const LIGHT_BEGINS: u32 = 0x40000u;
// Numbers in a row of light, and rows in a layer, as powers of two.
const LIGHT_SHIFT: u32 = 10u;

// Words of a view from here on: microseconds from the base to the whole one in which the block begins, what it begins at beyond
// that, its length, and microseconds from the base to its end.
const BLOCK_WORD: u32 = 8u;

struct OwnTimes {
    // Number of the first light.
    first: u32,
    parts: u32,
    flags: u32,
};

fn own_luminance(number: u32) -> f32 {
    let side = (1u << LIGHT_SHIFT) - 1u;
    let at = vec2<u32>(number & side, (number >> LIGHT_SHIFT) & side);
    return textureLoad(luminance_layers, at, number >> (2u * LIGHT_SHIFT)).r;
}

fn block_word(word: u32) -> u32 {
    return views[view * VIEW_WORDS + BLOCK_WORD + word];
}

// Of a view without a block all pixels rest, whatever they saw before.
fn own_times() -> OwnTimes {
    if (block_word(2u) == 0u) {
        return OwnTimes(0u, 0u, LIGHT_RESTS);
    }
    let own = textureLoad(tile_rates, pixel, view, 0);
    return OwnTimes(own.x, own.y & LIGHT_PARTS, own.y);
}

// The whole microsecond, since the base, at which part `number` of `parts` begins.
fn own_time(number: u32, parts: u32) -> u32 {
    let within = bitcast<f32>(block_word(2u)) * (f32(number) / f32(parts));
    return block_word(0u) + u32(bitcast<f32>(block_word(1u)) + within + 0.5);
}

// The interval from `from_us` to `to_us` since the base.
fn set_own_interval(from_us: u32, to_us: u32) {
    start = from_us;
    interval = to_us - from_us;
    clock = later(params.spans[0].zw, from_us);
}
