// Light that is used again: where a keyframe's cells lie, and what an instant reads of two keyframes.

// Twin: uniforms.rs, ReuseFrame.
struct ReuseFrame {
    // From the world to the older and the newer keyframe's clip space.
    older_clip_from_world: mat4x4<f32>,
    newer_clip_from_world: mat4x4<f32>,
    // Cells of a keyframe: pixels times CELLS.
    cells: vec2<f32>,
    // From the sample to the pixel's centre, in pixels.
    shift: vec2<f32>,
    // Layers.
    older: u32,
    newer: u32,
    // Part of the newer keyframe's light.
    weight: f32,
    // Record of the first object of this frame.
    first_record: u32,
};

// A cell's key: its inverse depth, the last bits of which are the object's number.
const NUMBER_BITS: u32 = 0xffu;

fn cell_key(number: u32, inverse_depth: f32) -> u32 {
    return (bitcast<u32>(inverse_depth) & ~NUMBER_BITS) | (number & NUMBER_BITS);
}

// Whether a cell with `key` shows what object `number` shows at `inverse_depth`, within a part of it.
fn shows(key: u32, number: u32, inverse_depth: f32, within: f32) -> bool {
    let there = bitcast<f32>(key & ~NUMBER_BITS);
    return (key & NUMBER_BITS) == (number & NUMBER_BITS) && abs(there - inverse_depth) <= within * inverse_depth;
}
