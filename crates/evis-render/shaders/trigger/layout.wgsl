// Shared by the trigger passes. Twins: gpu/uniforms.rs (structs), gpu/sizes.rs (constants).

// Invocations per workgroup of the pixel passes, along a row.
const WORKGROUP: u32 = 64u;
// Pixels per prefix block; a row is padded to whole blocks, so a block never spans two rows.
const BLOCK_PIXELS: u32 = 64u;

struct TriggerParams {
    width: u32,
    height: u32,
    // Row length of the per-pixel buffers: width rounded up to whole blocks.
    stride: u32,
    view_count: u32,
    // Of the whole chain: lists of pixels that wake, per view.
    lists: u32,
    instants: u32,
    event_capacity: u32,
    // 1: the first instant only sets the reference.
    first: u32,
    // Per instant, in microseconds: x the instant before it, since the submission's base; y how long after that it
    // is; zw the instant before it in stream time, low and high word. One vector each: a component at a varying index
    // costs software drivers a fetch of all four.
    spans: array<vec4<u32>, 32>,
};

struct ViewSensor {
    threshold_on: f32,
    threshold_off: f32,
    log_eps: f32,
    inverse_reference_luminance: f32,
};

// What survives a submission in one pixel.
struct PixelMemory {
    reference_log: f32,
    log_luminance: f32,
};

struct Status {
    // 1: a submission did not fit its event buffer; nothing is written until the host clears this.
    stalled: u32,
    event_count: u32,
    // Pixel intervals whose event count hit the limit.
    clamped: atomic<u32>,
    // Pixels whose events in the emitting pass differ from their count: never, or the driver miscompiles.
    mismatched: atomic<u32>,
    // Pixels and instants that a method left unknown.
    unknown: atomic<u32>,
    // Events that pixels lost to their refractory period.
    suppressed: atomic<u32>,
};
