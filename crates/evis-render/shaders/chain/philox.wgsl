// Philox4x32-10 (Salmon et al., SC 2011) from 32-bit integers, and what it is keyed by. Twin: evis_core::random.

const PHILOX_FIRST: u32 = 0xd2511f53u;
const PHILOX_SECOND: u32 = 0xcd9e8d57u;
const PHILOX_KEY_LOW: u32 = 0x9e3779b9u;
const PHILOX_KEY_HIGH: u32 = 0xbb67ae85u;
// A power of two, in microseconds.
const EPOCH_SHIFT: u32 = 14u;

// Upper half of a product; its lower half is a * b.
fn upper_product(a: u32, b: u32) -> u32 {
    let low = vec2<u32>(a & 0xffffu, b & 0xffffu);
    let high = vec2<u32>(a >> 16u, b >> 16u);
    let cross = high.x * low.y + ((low.x * low.y) >> 16u);
    return high.x * high.y + (cross >> 16u) + ((low.x * high.y + (cross & 0xffffu)) >> 16u);
}

fn philox(counter: vec4<u32>, key: vec2<u32>) -> vec4<u32> {
    var c = counter;
    var k = key;
    for (var round = 0u; round < 10u; round++) {
        c = vec4<u32>(
            upper_product(c.z, PHILOX_SECOND) ^ c.y ^ k.x,
            c.z * PHILOX_SECOND,
            upper_product(c.x, PHILOX_FIRST) ^ c.w ^ k.y,
            c.x * PHILOX_FIRST,
        );
        k += vec2<u32>(PHILOX_KEY_LOW, PHILOX_KEY_HIGH);
    }
    return c;
}

// Four words for `pixel`, `stream`, `draw` and the epoch of a time of `low` and `high` word, microseconds.
fn draw(key: vec2<u32>, pixel: u32, stream: u32, low: u32, high: u32, number: u32) -> vec4<u32> {
    let epoch = (low >> EPOCH_SHIFT) | (high << (32u - EPOCH_SHIFT));
    let top = ((high >> EPOCH_SHIFT) & 0x00ffffffu) | (stream << 24u);
    return philox(vec4<u32>(pixel, epoch, top, number), key);
}

// Uniform in (0, 1), exact.
fn unit(word: u32) -> f32 {
    return (f32(word >> 9u) + 0.5) * (1.0 / 8388608.0);
}
