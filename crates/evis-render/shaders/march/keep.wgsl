#import march/layout.wgsl
#import common/ray.wgsl
// Keeps a tile and what surrounds it as a key. Mean light of pixels that begin at every quarter of a pixel: a pixel that is
// moved covers the cells of four others. And places; one whose neighbours show another object, or another part of it nearer or
// farther away, is an edge.

// Part of an inverse depth by which it may bend between neighbours.
const SMOOTH: f32 = 0.01;
// Cells of a pixel: each sample reads textures over one of them.
override COLUMNS: u32 = 1;
override ROWS: u32 = 1;

@group(0) @binding(3) var samples: texture_storage_2d_array<r32float, read>;
@group(0) @binding(4) var places: texture_storage_2d_array<rgba32float, read>;
@group(0) @binding(5) var kept_means: texture_storage_2d_array<rgba32float, write>;
@group(0) @binding(6) var kept_places: texture_storage_2d_array<rgba32float, write>;
// Per cell, row by row: its sample.
@group(0) @binding(7) var<uniform> sample_of: array<vec4<u32>, 16>;

// Direction of what a pixel of the sky shows.
fn direction(pixel: vec2<u32>, size: vec2<u32>) -> vec3<f32> {
    let ndc = (vec2<f32>(pixel) + 0.5) / vec2<f32>(size) * vec2<f32>(2.0, -2.0) + vec2<f32>(-1.0, 1.0);
    return direction_through(
        ndc,
        job.ray,
        job.world_from_camera_right.xyz,
        job.world_from_camera_up.xyz,
        job.world_from_camera_back.xyz);
}

// Inverse depth of a place of object `number`; far below 0 where it is of another.
fn inverse_depth(pixel: vec2<u32>, number: f32, w: vec4<f32>) -> f32 {
    let place = textureLoad(places, pixel, 0);
    return select(-1e30, select(0.0, 1.0 / dot(w, vec4<f32>(place.xyz, 1.0)), number > 0.0), place.w == number);
}

// How much of cell `i`, of `count` in a pixel, lies under a pixel that begins at each phase.
fn overlap(i: u32, count: u32) -> vec4<f32> {
    let begin = vec4<f32>(0.0, 1.0, 2.0, 3.0) / f32(PHASES) * f32(count);
    let low = max(vec4<f32>(f32(i)), begin);
    let high = min(vec4<f32>(f32(i + 1u)), begin + f32(count));
    return max(high - low, vec4<f32>(0.0));
}

@compute @workgroup_size(SIDE, 4)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) id: vec3<u32>) {
    let number = tile_number(group, job.row);
    if (number >= job.count) {
        return;
    }
    let gap = gap_of(number);
    let size = textureDimensions(places);
    let slot = job.view * 2u + gap.slot;
    for (var row = id.y; row < SIDE; row += 4u) {
        let at = gap.place * SIDE + vec2<u32>(id.x, row);
        let wanted = vec2<i32>(gap.place * TILE + vec2<u32>(id.x, row)) - i32(APRON);
        let pixel = vec2<u32>(clamp(wanted, vec2<i32>(0), vec2<i32>(size) - 1));
        let inside = all(vec2<i32>(pixel) == wanted);
        let place = textureLoad(places, pixel, 0);
        let m = motion(job.frame, place.w);
        let w = vec4<f32>(m[0].w, m[1].w, m[2].w, m[3].w);
        let here = inverse_depth(pixel, place.w, w);
        // Beyond the apron nothing is rendered. At borders there is but one neighbour: what it shows counts, how it bends
        // does not.
        let first = max(gap.place * TILE, vec2<u32>(APRON)) - APRON;
        let low = max(max(pixel, vec2<u32>(1u)) - 1u, first);
        let high = min(min(pixel + 1u, size - 1u), gap.place * TILE + TILE + APRON - 1u);
        let left = inverse_depth(vec2<u32>(low.x, pixel.y), place.w, w);
        let right = inverse_depth(vec2<u32>(high.x, pixel.y), place.w, w);
        let above = inverse_depth(vec2<u32>(pixel.x, low.y), place.w, w);
        let below = inverse_depth(vec2<u32>(pixel.x, high.y), place.w, w);
        let bend = max(
            select(abs(left + right - 2.0 * here), 0.0, high.x - low.x < 2u),
            select(abs(above + below - 2.0 * here), 0.0, high.y - low.y < 2u));
        let one = min(min(left, right), min(above, below)) > -1e29 && bend <= SMOOTH * here && place.w >= 0.0;
        let known = select(place.xyz, direction(pixel, size), place.w == 0.0);
        let shown = select(select(EDGE, place.w, one), OUTSIDE, !inside);
        textureStore(kept_places, at, slot, vec4<f32>(known, shown));

        var mean_0 = vec4<f32>(0.0);
        var mean_1 = vec4<f32>(0.0);
        var mean_2 = vec4<f32>(0.0);
        var mean_3 = vec4<f32>(0.0);
        let next = min(pixel + 1u, size - 1u);
        for (var y = 0u; y < 2u * ROWS; y++) {
            var line = vec4<f32>(0.0);
            for (var x = 0u; x < 2u * COLUMNS; x++) {
                let cell = (y % ROWS) * COLUMNS + x % COLUMNS;
                let from_pixel = vec2<u32>(select(pixel.x, next.x, x >= COLUMNS), select(pixel.y, next.y, y >= ROWS));
                line += textureLoad(samples, from_pixel, sample_of[cell / 4u][cell % 4u]).r * overlap(x, COLUMNS);
            }
            let down = overlap(y, ROWS);
            mean_0 += line * down.x;
            mean_1 += line * down.y;
            mean_2 += line * down.z;
            mean_3 += line * down.w;
        }
        let part = 1.0 / f32(COLUMNS * ROWS);
        textureStore(kept_means, at, slot * PHASES, mean_0 * part);
        textureStore(kept_means, at, slot * PHASES + 1u, mean_1 * part);
        textureStore(kept_means, at, slot * PHASES + 2u, mean_2 * part);
        textureStore(kept_means, at, slot * PHASES + 3u, mean_3 * part);
    }
}
