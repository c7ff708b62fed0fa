//! `decoupled/*.wgsl`: pixels followed through a block. Twin: `PixelPath::walk` of `evis-decoupled` and what it calls.

use crate::pass::{Access, Binding, ComputePass, bind};

/// Pixels of a workgroup.
pub const GROUP: u32 = 64;

/// Rounds of a submission, an even number: the list of the next one is where the first one's is.
pub const ROUNDS: u32 = 64;
/// Words of what is known of a pixel between rounds.
pub const STATE_WORDS: u32 = 28;
/// Words per pixel that stay on the device between rounds: two lists, and what is known of it.
pub const SCRATCH_WORDS: u32 = 2 + STATE_WORDS;
/// By how many entries pixels of a class are listed side by side.
pub const COUNTS: u32 = 32;
/// Classes of pixels, which have pipelines of their own: plain ones, those behind a distorted lens, those that may see facets with
/// maps, those to which both applies, and all others.
pub const PLAIN: usize = 0;
/// See there.
pub const OTHERS: usize = 1;
/// See there.
pub const BENT: usize = 2;
/// See there.
pub const MAPPED: usize = 3;
/// See there.
pub const BENT_MAPPED: usize = 4;
/// How many there are.
pub const CLASSES: usize = 5;
/// Words before those that count pixels: events, evaluations, quiet pixels, and those that failed.
pub const TOTAL_WORDS: u32 = 4;
/// Words of what is counted of a class for each round: pixels that go on, and their workgroups along each axis.
pub const ROUND_WORDS: u32 = 1 + AXES;
/// Axes of a dispatch.
pub const AXES: u32 = 3;
/// Words before the events: totals, what is counted of each class for each round and once more, and what listing them needs.
pub const HEAD_WORDS: u32 = TOTAL_WORDS + CLASSES as u32 * (ROUND_WORDS * (ROUNDS + 1) + 1 + 2 * COUNTS);

/// `decoupled/pixels.wgsl`, and those before it.
pub const PIXELS_BINDINGS: &[Binding] = &[
    bind(0, "batch", Access::Uniform),
    bind(1, "entries", Access::Read),
    bind(2, "words", Access::Read),
    bind(3, "points", Access::Read),
    bind(4, "kept", Access::Read),
    bind(5, "fixed", Access::Read),
    bind(6, "pixels", Access::Write),
    bind(7, "events", Access::Write),
    bind(8, "scratch", Access::Write),
    bind(9, "turn", Access::DynamicUniform),
];

/// The pass that prepares pixels of tiles.
pub fn prepare(device: &wgpu::Device) -> ComputePass {
    ComputePass::new(device, "decoupled/prepare.wgsl", PIXELS_BINDINGS, &[])
}

/// The pass that lists pixels for their first round.
pub fn list(device: &wgpu::Device) -> ComputePass {
    ComputePass::new(device, "decoupled/list.wgsl", PIXELS_BINDINGS, &[])
}

/// The pass that follows pixels of a class.
pub fn pixels(device: &wgpu::Device, class: usize) -> ComputePass {
    ComputePass::new(device, "decoupled/pixels.wgsl", PIXELS_BINDINGS, &[("CLASS", class as f64)])
}
