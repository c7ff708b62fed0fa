#import common/tile.wgsl
// Tiles that are rendered at keys, and followed between them. No twin: `tests/floor2_march.rs` holds the passes to pictures
// whose light is known.

// Pixels around a tile that its key holds too: `march.rs` has the same constant.
const APRON: u32 = 4u;
const SIDE: u32 = TILE + 2u * APRON;

// Pixels that the picture does not have, and pixels that show an edge, in place of a number.
const OUTSIDE: f32 = -2.0;
const EDGE: f32 = -1.0;

// Places per pixel and axis at which a key knows the mean light of a pixel that begins there.
const PHASES: u32 = 4u;

// What happens at a key of a view. Twin: uniforms.rs, MarchJob.
struct MarchJob {
    // Camera axes and field as in `Frame`: the sky is known by its direction.
    world_from_camera_right: vec4<f32>,
    world_from_camera_up: vec4<f32>,
    world_from_camera_back: vec4<f32>,
    ray: vec4<f32>,
    // Of `tiles`.
    first: u32,
    count: u32,
    // Workgroups per row of the dispatch.
    row: u32,
    // Frame of the key, and matrices of a frame.
    frame: u32,
    matrices: u32,
    // View of the group: it has two slots of keys.
    view: u32,
    // Layer of the key's instant.
    layer: u32,
    // Place of the first tile's verdict.
    verdict: u32,
    // Half of the picture, in pixels.
    half_size: vec2<f32>,
    // Light below which logarithms bend.
    dark: f32,
    pad: u32,
};

@group(0) @binding(0) var<uniform> job: MarchJob;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
// Per frame: clip from world for what is infinitely far, then clip from object of every object.
@group(0) @binding(2) var<storage, read> motions: array<mat4x4<f32>>;

// A tile and the gap that ends with its key. Twin: march.rs, Gap::word.
struct Gap {
    // In tiles.
    place: vec2<u32>,
    // The key's slot; the one before has the other.
    slot: u32,
    // The tile is looked at every 2^pace instants, and its keys are 2^length instants apart.
    pace: u32,
    length: u32,
    // Pixels around the tile that may come into it.
    reach: u32,
};

fn gap_of(number: u32) -> Gap {
    let word = tiles[job.first + number];
    return Gap(
        vec2<u32>(word & 0x3ffu, (word >> 10u) & 0x3ffu),
        (word >> 20u) & 1u,
        (word >> 21u) & 0xfu,
        (word >> 25u) & 0xfu,
        word >> 29u);
}

// What carries points of object `number` to the clip space of frame `frame`.
fn motion(frame: u32, number: f32) -> mat4x4<f32> {
    return motions[frame * job.matrices + u32(max(number, 0.0))];
}

// Number 0 is the sky's: its places are directions.
fn homogeneous(place: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(place.xyz, select(1.0, 0.0, place.w == 0.0));
}
