#import march/path.wgsl
// Light of tiles between two keys: each pixel walks its way. Whether quarters of tiles can be followed so is told too: they and
// what may come into them show one surface without edges, a key knows where it went, and both agree about its light.

// By how much the logarithm of a pixel's light may differ between the keys.
const AGREE: f32 = 0.05;

@group(0) @binding(5) var layers: texture_storage_2d_array<r32float, write>;
@group(0) @binding(6) var<storage, read_write> verdicts: array<atomic<u32>>;

// Why a quarter of a tile is not followed: three bits each.
const IS_EDGE: u32 = 1u;
const IS_LOST: u32 = 2u;
const IS_OTHER: u32 = 4u;

const LINES: u32 = 4u;
const HALF: i32 = i32(TILE / 2u);

fn differ(a: f32, b: f32) -> bool {
    return !(abs(log((a + job.dark) / (b + job.dark))) <= AGREE);
}

@compute @workgroup_size(TILE, LINES)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) id: vec3<u32>) {
    let tile = tile_number(group, job.row);
    if (tile >= job.count) {
        return;
    }
    let gap = gap_of(tile);
    let keys = keys_of(gap);
    let size = vec2<i32>(textureDimensions(layers));
    let steps = 1u << (gap.length - gap.pace);
    let first = job.layer - (1u << gap.length);
    let reach = i32(gap.reach);
    var why = 0u;
    for (var quarter = 0u; quarter < 4u; quarter++) {
        let corner = keys.corner + vec2<i32>(vec2<u32>(quarter & 1u, quarter >> 1u)) * HALF;
        // One object, which is that of the first pixel.
        let number = place_at(keys, keys.older, corner).w;
        var edge = number < 0.0;
        for (var y = i32(id.y) - reach; y < HALF + reach; y += i32(LINES)) {
            for (var x = i32(id.x) - reach; x < HALF + reach; x += i32(TILE)) {
                let older = place_at(keys, keys.older, corner + vec2<i32>(x, y)).w;
                let newer = place_at(keys, keys.newer, corner + vec2<i32>(x, y)).w;
                edge |= (older != number && older != OUTSIDE) || (newer != number && newer != OUTSIDE);
            }
        }
        why |= select(0u, IS_EDGE, edge) << (3u * quarter);
    }
    for (var row = id.y; row < TILE; row += LINES) {
        let own = vec2<i32>(vec2<u32>(id.x, row));
        let pixel = keys.corner + own;
        let quarter = own / HALF;
        let number = place_at(keys, keys.older, keys.corner + quarter * HALF).w;
        let walk = walk_of(keys, gap, number, pixel);
        let asked = all(pixel < size);
        let known = walk.way.known;
        let apart = known && differ(walk.told, walk.shown);
        let found = select(0u, select(IS_LOST, 0u, known) | select(0u, IS_OTHER, apart), asked);
        why |= found << u32(3 * (quarter.x + 2 * quarter.y));
        // Loops end early on software drivers, branches do not. What other pixels say is not known here: where a quarter
        // cannot be followed, it is rendered over this.
        let count = select(0u, steps, asked && found == 0u);
        for (var step = 1u; step < count; step++) {
            let light = light_at(keys, walk, f32(step) / f32(steps));
            textureStore(layers, vec2<u32>(pixel), first + (step << gap.pace), vec4<f32>(light, 0.0, 0.0, 0.0));
        }
    }
    if (why != 0u) {
        atomicOr(&verdicts[job.verdict + tile], why);
    }
}
