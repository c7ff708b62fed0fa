#import common/mean.wgsl
#import common/unknown.wgsl
#import trigger/layout.wgsl
// The whole sensor chain of a pixel: what is bound, what is on, what is remembered. Twins: sensor/chain.rs, gpu/uniforms.rs.

// What is off leaves no code and no memory behind.
override LINLOG: bool = false;
// 0 none, 1 Euler's rule, 2 one pole, 3 two poles.
override FILTER: u32 = 0;
override LIGHT_BANDWIDTH: bool = false;
override OWN_THRESHOLDS: bool = false;
override PHASE_START: bool = false;
override RAMP: bool = false;
override OWN_SLOPES: bool = false;
override LEAK_JITTER: bool = false;
override TIMED_NOISE: bool = false;
override NOISE_SETS_REFERENCE: bool = false;
// 0 none, 1 suppress, 2 defer, 3 hold.
override REFRACTORY: u32 = 0;
override LATCH: bool = false;
// 0 crossing, 1 sample, 2 even, 3 shared: an instant's times depend on the busiest pixel's events.
override TIMES: u32 = 0;
override LIGHT_LATENCY: bool = false;
// Light is known at times of each pixel's own, see chain/own_times.wgsl.
override OWN_TIMES: bool = false;
// Whether shared times decide what happens next.
override SEQUENTIAL: bool = false;
// Events of a pixel that counting keeps for emitting; 0 where their times are not known yet.
override KEPT: u32 = 4;
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
// Every pixel, from the old memory to the end; if sequential, to where it wakes.
const MODE_COUNT: u32 = 0u;
// Those that woke at an instant, from there to where they wake next.
const MODE_WAKE: u32 = 1u;
// Those with more events than counting keeps, once more.
const MODE_EMIT: u32 = 2u;

struct ChainStep {
    mode: u32,
    // Of waking; else 0.
    instant: u32,
    pad: vec2<u32>,
};

struct ChainSensor {
    log_eps: f32,
    dark_light: f32,
    full_scale: f32,
    knee: f32,
    // ln(knee) / knee.
    below_knee: f32,
    bandwidth_offset: f32,
    bandwidth_least: f32,
    bandwidth_most: f32,
    leak_jitter: f32,
    latency_light_us: f32,
};

// Words of a view: thresholds, slope of the leak, 1 / Y_ref, key, 2 pi cutoff per microsecond, refractory period in
// microseconds; then its block, where pixels have times of their own.
const VIEW_WORDS: u32 = 12u;
// Words of a candidate in `feed`: time; place, kind and rest in units of 16 us; light below which it happens.
const CANDIDATE_WORDS: u32 = 3u;
// A threshold beyond this belongs to a dead pixel, a reference beyond it to a held one.
const BEYOND: f32 = 1e30;
// Ages saturate or fold here, microseconds.
const OLD: u32 = 1u << 29u;
// Light beyond this is treated as this.
const LIGHT_LIMIT: f32 = 1e30;

// Words of a view in `tallies`: per instant most events of a pixel, then pixels that woke; last, the crowded ones.
const TALLY_WORDS: u32 = 65u;

struct ChainStatus {
    status: Status,
    tallies: array<atomic<u32>>,
};

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<uniform> job: ChainStep;
@group(0) @binding(2) var<uniform> sensor: ChainSensor;
@group(0) @binding(3) var luminance_layers: texture_storage_2d_array<r32float, read>;
@group(0) @binding(4) var<storage, read> views: array<u32>;
// Where each block's candidates begin, then candidates by block, pixel and time.
@group(0) @binding(5) var<storage, read> feed: array<u32>;
// A layer per plane and view. Storage textures because software drivers read a storage buffer lane by lane.
@group(0) @binding(6) var memory_in: texture_storage_2d_array<r32uint, read>;
@group(0) @binding(7) var memory_out: texture_storage_2d_array<r32uint, read_write>;
// Counting: counts. Emitting: their exclusive prefixes within blocks.
@group(0) @binding(8) var<storage, read_write> cells: array<u32>;
@group(0) @binding(9) var<storage, read> block_offsets: array<u32>;
@group(0) @binding(10) var<storage, read_write> report: ChainStatus;
@group(0) @binding(11) var<storage, read_write> events: array<vec2<u32>>;
// The first events of each pixel.
// A layer per plane and view: ON thresholds, OFF thresholds, slopes.
@group(0) @binding(15) var frozen: texture_storage_2d_array<r32float, read>;
@group(0) @binding(13) var<storage, read_write> kept: array<vec2<u32>>;
// Pixels, by their place in a picture: per view the crowded ones, then per view and instant those that woke.
@group(0) @binding(14) var<storage, read_write> lists: array<u32>;
