#import decoupled/regions.wgsl
// The sky behind everything: `Lighting::background` of evis-decoupled.

// Places along either side of a footprint, per texel, and at most.
const SKY_DENSITY: f32 = 3.0;
const SKY_PLACES: f32 = 6.0;

// Number `index` of the sky.
fn sky_number(index: u32) -> f32 {
    return kept[job.sky + job.sky_levels + index / 4u][index % 4u];
}

// Where a direction, of any length, meets a cube: a face, and (s, t) there, both from -1 to 1.
struct CubePlace {
    face: u32,
    at: vec2<f32>,
};

// Of the four texels around such a place: number of the first one, how many a row has, and how far from it the place is.
struct CubeTexels {
    first: u32,
    row: u32,
    w: vec2<f32>,
};

// Faces of `size` texels a side, with one more beyond each edge.
fn cube_texels(on: CubePlace, size: u32) -> CubeTexels {
    let row = size + 2u;
    let place = (on.at + 1.0) * 0.5 * f32(size) + 0.5;
    let low = min(vec2<u32>(max(place, vec2<f32>(0.0))), vec2<u32>(size));
    return CubeTexels((on.face * row + low.y) * row + low.x, row, place - vec2<f32>(low));
}

// Luminance of a level, between texels' middles.
fn sky_level(level: u32, on: CubePlace) -> f32 {
    let head = bitcast<vec4<u32>>(kept[job.sky + level]);
    let around = cube_texels(on, head.y);
    let first = head.x + around.first;
    let upper = mix(sky_number(first), sky_number(first + 1u), around.w.x);
    let lower = mix(sky_number(first + around.row), sky_number(first + around.row + 1u), around.w.x);
    return mix(upper, lower, around.w.y);
}

fn cube_place(direction: vec3<f32>) -> CubePlace {
    let size = abs(direction);
    var face = 0u;
    var major = size.x;
    var at = vec2<f32>(-direction.z, -direction.y);
    if (size.z >= size.x && size.z >= size.y) {
        face = select(5u, 4u, direction.z >= 0.0);
        major = size.z;
        at = vec2<f32>(select(-direction.x, direction.x, direction.z >= 0.0), -direction.y);
    } else if (size.y >= size.x) {
        face = select(3u, 2u, direction.y >= 0.0);
        major = size.y;
        at = vec2<f32>(direction.x, select(-direction.z, direction.z, direction.y >= 0.0));
    } else if (direction.x < 0.0) {
        face = 1u;
        at = vec2<f32>(direction.z, -direction.y);
    }
    return CubePlace(face, at / max(major, 1e-30));
}

// Luminance in a direction, of any length, between two levels.
fn sky_at(direction: vec3<f32>, level: f32) -> f32 {
    let on = cube_place(direction);
    let last = job.sky_levels - 1u;
    let lower = min(u32(level), last);
    let a = sky_level(lower, on);
    let b = sky_level(min(lower + 1u, last), on);
    return mix(a, b, min(level - f32(lower), 1.0));
}

// Mean luminance of what lies behind everything, over a part of the pixel.
fn background_of(m: Moments, u: f32) -> f32 {
    if (job.sky_levels == 0u || !(m.area > 0.0)) {
        return job.background;
    }
    let sides = sides_of(m);
    let texels = max(sides.along.x, sides.down.y) * job.sky_texels;
    let count = clamp(ceil(SKY_DENSITY * texels), 1.0, SKY_PLACES);
    let level = clamp(log2(max(texels / count, 1.0)), 0.0, f32(job.sky_levels - 1u));
    let row = base.seen;
    let x = points[row].xyz + u * (points[row + 3u].xyz + u * points[row + 6u].xyz);
    let y = points[row + 1u].xyz + u * (points[row + 4u].xyz + u * points[row + 7u].xyz);
    let z = points[row + 2u].xyz + u * (points[row + 5u].xyz + u * points[row + 8u].xyz);
    let places = u32(count);
    var sum = 0.0;
    spend(places * (places + 1u));
    for (var j = 0u; j < places; j++) {
        for (var i = 0u; i < places; i++) {
            let s = (vec2<f32>(f32(i), f32(j)) + 0.5) / count - 0.5;
            let at = image_point(sides.middle + s.x * sides.along + s.y * sides.down);
            sum += sky_at(x * at.x + y * at.y + z * at.z, level);
        }
    }
    return sum / (count * count);
}
