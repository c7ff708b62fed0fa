#import decoupled/fragments.wgsl
// What part of a lamp's light reaches a fragment.

// What lies beyond a facet by less than this part of the lamp's distance from it is the facet itself, or touches it.
const CONTACT: f32 = 2e-5;
// Part of the distances of a lamp and a facet within which the lamp lies in the facet's plane: what 32 bits leave of quadratics.
const IN_PLANE: f32 = 3e-6;
// What 32 bits leave of a facet's height over its longer side, as a part of its distance.
const SHRUNK: f32 = 1e-6;
// Words of a facet that throws a shadow.
const CASTER_WORDS: u32 = 3u;

fn on_plane(normal: vec3<f32>, through: f32, receiver: vec3<f32>) -> vec3<f32> {
    return normal - through * receiver;
}

// Adds a half plane of a shadow to the `count` cutters; false where it keeps the shadow out of the pixel.
fn bound_shadow(count: ptr<function, u32>, line: vec3<f32>) -> bool {
    let side = side_of(line);
    if (side == 0) {
        cutters[*count] = line;
        *count += 1u;
    }
    return side >= 0;
}

// Makes cutters of the shadow of the facet at `row` of `points`, on the plane with the 1 / depth `receiver`: how many of them,
// or -1 where it does not reach the pixel.
fn shadow_of(row: u32, lamp: u32, receiver: vec3<f32>, u: f32) -> i32 {
    let corners = corners_at(row, u);
    let h = lamp_at(lamp, u);
    let place = about_pixel(h.xyz);
    let along = corners[1] - corners[0];
    let beside = corners[3] - corners[0];
    let normal = cross(along, beside);
    // One that has shrunk to a line or a point throws none.
    if (length(normal) <= SHRUNK * length(corners[0]) * max(length(along), length(beside))) {
        return -1;
    }
    let height = dot(normal, place) - h.w * dot(normal, corners[0]);
    // Nor does one whose plane holds the lamp, but for rounding.
    if (abs(height) <= IN_PLANE * length(normal) * (length(place) + h.w * length(corners[0]))) {
        return -1;
    }
    let side = -sign(height);
    var count = 0u;
    let through = dot(normal, corners[0]) * side + CONTACT * abs(height);
    if (!bound_shadow(&count, on_plane(normal * side, through, receiver))) {
        return -1;
    }
    var turn = 0.0;
    for (var k = 0u; k < 4u; k++) {
        let a = corners[k];
        let b = corners[(k + 1u) % 4u];
        if (all(a == b)) {
            continue;
        }
        let wall = cross(a, b) * h.w + cross(place, a - b);
        let wall_through = dot(wall, a);
        if (turn == 0.0) {
            turn = sign(dot(wall, corners[3]) - wall_through);
        }
        if (!bound_shadow(&count, on_plane(wall * turn, wall_through * turn, receiver))) {
            return -1;
        }
    }
    return i32(count);
}

// What shadows leave to lamp `lamp` of fragment `k`, of which the pixel sees what is `visible`, with the moments `m`.
fn reached_by(k: u32, lamp: u32, visible: Range, m: Moments, u: f32) -> Moments {
    let shade = entries[fragments[k].entry].shades + SHADE_WORDS * lamp;
    var left = visible;
    let end = words[base.words + shade + 5u];
    for (var caster = words[base.words + shade + 4u]; caster < end && !failed; caster += CASTER_WORDS) {
        spend(1u);
        if (!has_pixel(caster)) {
            continue;
        }
        // Its edges.
        spend(4u);
        let count = shadow_of(words[base.words + caster + 2u], lamp, fragments[k].inverse_depth, u);
        if (count < 0) {
            continue;
        }
        let to = select(0u, 1u, left.list == 0u);
        subtract_from(left, to, u32(count));
        left = all_of(to);
        if (left.end == 0u) {
            break;
        }
    }
    if (left.list == visible.list) {
        return m;
    }
    return moments_of(left.list);
}
