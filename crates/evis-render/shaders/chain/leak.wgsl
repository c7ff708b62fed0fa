#import chain/philox.wgsl
#import chain/state.wgsl
// When the reference moves, the leak restarts.

// Streams of the generator.
const STREAM_LEAK_JITTER: u32 = 7u;
// A leak's jitter is drawn for this many microseconds, a power of two.
const JITTER_SHIFT: u32 = 12u;

fn number() -> u32 {
    return pixel.y * params.width + pixel.x;
}

// Share of the mean time that the next leak event takes, from the time at which the reference moved.
fn jitter_at(t: u32) -> f32 {
    let time = later(clock, t);
    let part = (time.x >> JITTER_SHIFT) & ((1u << (EPOCH_SHIFT - JITTER_SHIFT)) - 1u);
    let words = draw(key, number(), STREAM_LEAK_JITTER, time.x, time.y, part) >> vec4<u32>(10u);
    let sum = f32(words.x + words.y + words.z + words.w) * (1.0 / 4194304.0);
    return 1.0 + sensor.leak_jitter * ((sum - 2.0) * 1.7320508);
}

fn moved_at(t: f32) {
    if (!RAMP) {
        return;
    }
    moved = i32(start) + i32(t);
    if (LEAK_JITTER) {
        slope = steady / jitter_at(u32(t));
    }
}
