#import common/tile.wgsl
// How far the light of a tile at an instant that was not sampled lies outside of what the samples around it say: the largest
// excursion of any pixel's log luminance beyond the interval between both. Twin: cpu/audit.rs.

// Twin: gpu/uniforms.rs, AuditJob.
struct AuditJob {
    // Pixels of the tile within the picture.
    size: vec2<u32>,
    // Of `changes`; three layers each.
    slot: u32,
    // Added to the luminance before the logarithm.
    offset: f32,
};

// Fixed point of an excursion, and the bits of the pixel below it.
const SCALE: f32 = 65536.0;
const MOST: f32 = 16777215.0;
const PIXEL_BITS: u32 = 8u;

@group(0) @binding(0) var<uniform> job: AuditJob;
// Three per tile: as it is at the instant, before it and after it.
@group(0) @binding(1) var layers: texture_storage_2d_array<r32float, read>;
// Per audited tile: the excursion, then the pixel within the tile.
@group(0) @binding(2) var<storage, read_write> changes: array<atomic<u32>>;

fn log_luminance(pixel: vec2<u32>, layer: u32) -> f32 {
    return log(max(textureLoad(layers, pixel, 3u * job.slot + layer).r, 0.0) + job.offset);
}

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(local_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if (any(pixel >= job.size)) {
        return;
    }
    let now = log_luminance(pixel, 0u);
    let before = log_luminance(pixel, 1u);
    let after = log_luminance(pixel, 2u);
    let beyond = max(now - max(before, after), min(before, after) - now);
    let fixed = u32(clamp(beyond * SCALE, 0.0, MOST));
    atomicMax(&changes[job.slot], (fixed << PIXEL_BITS) | (id.y * TILE + id.x));
}
