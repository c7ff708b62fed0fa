#import trigger/layout.wgsl
// The whole sensor chain of a pixel: what is bound, what is on, what is remembered. Twins: chain.rs, uniforms.rs.

// What is off leaves no code and no memory behind.
override SAMPLES: u32 = 1;
override MAY_BE_UNKNOWN: bool = false;
override LINLOG: bool = false;
// 0 none, 1 Euler's rule, 2 one pole, 3 two poles.
override FILTER: u32 = 0;
override LIGHT_BANDWIDTH: bool = false;
override OWN_THRESHOLDS: bool = false;
override PHASE_START: bool = false;
override RAMP: bool = false;
override OWN_SLOPES: bool = false;
override LEAK_JITTER: bool = false;
override STRIKES: bool = false;
override STRIKES_SET_REFERENCE: bool = false;
// 0 none, 1 suppress, 2 defer, 3 hold.
override REFRACTORY: u32 = 0;
override LATCH: bool = false;
// 0 crossing, 1 sample, 2 even, 3 shared.
override TIMES: u32 = 0;
override LIGHT_LATENCY: bool = false;
// Whether an instant's events depend on the busiest pixel's, and the next instant's on them: a dispatch each.
override SEQUENTIAL: bool = false;
override MOST_EVENTS: u32 = 65535;

// Planes of the pixel memory; one that is off is never touched.
override INPUT_PLANE: u32 = 1;
override FIRST_PLANE: u32 = 0;
override SECOND_PLANE: u32 = 0;
override LIGHT_PLANE: u32 = 0;
override MOVED_PLANE: u32 = 0;
override SLOPE_PLANE: u32 = 0;
override FIRED_PLANE: u32 = 0;
const REFERENCE_PLANE: u32 = 0u;

// What a dispatch does.
const MODE_COUNT: u32 = 0u;
const MODE_EMIT: u32 = 1u;
const MODE_PEAK: u32 = 2u;

struct ChainStep {
    mode: u32,
    // First instant, and one past the last.
    first: u32,
    end: u32,
    pad: u32,
};

struct ChainSensor {
    log_eps: f32,
    dark_light: f32,
    full_scale: f32,
    knee: f32,
    // ln(knee) / knee.
    below_knee: f32,
    // 2 pi cutoff per microsecond.
    filter_rate: f32,
    bandwidth_offset: f32,
    bandwidth_least: f32,
    bandwidth_most: f32,
    leak_jitter: f32,
    refractory_us: f32,
    latency_light_us: f32,
};

// Words of a view at the start of `frozen`: thresholds, slope of the leak, 1 / Y_ref, key.
const VIEW_WORDS: u32 = 8u;
// Words of a strike in `feed`: time; place and kind; light below which it happens.
const STRIKE_WORDS: u32 = 3u;
// A threshold beyond this belongs to a dead pixel, a reference beyond it to a held one.
const BEYOND: f32 = 1e30;
// Ages saturate or fold here, microseconds.
const OLD: u32 = 1u << 29u;
// Light beyond this is treated as this.
const LIGHT_LIMIT: f32 = 1e30;

struct ChainStatus {
    status: Status,
    // Per view and instant: most events of a pixel (shared times only).
    peaks: array<atomic<u32>>,
};

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<uniform> job: ChainStep;
@group(0) @binding(2) var<uniform> sensor: ChainSensor;
@group(0) @binding(3) var luminance_layers: texture_storage_2d_array<r32float, read>;
// Views, then planes: ON thresholds, OFF thresholds, slopes.
@group(0) @binding(4) var<storage, read> frozen: array<u32>;
// Where each block's strikes begin, then strikes by block, pixel and time.
@group(0) @binding(5) var<storage, read> feed: array<u32>;
@group(0) @binding(6) var<storage, read> memory_in: array<u32>;
@group(0) @binding(7) var<storage, read_write> memory_out: array<u32>;
// Counting: counts. Emitting: their exclusive prefixes within blocks.
@group(0) @binding(8) var<storage, read_write> cells: array<u32>;
@group(0) @binding(9) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(10) var<storage, read_write> report: ChainStatus;
@group(0) @binding(11) var<storage, read_write> events: array<vec2<u32>>;
