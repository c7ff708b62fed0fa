#import decoupled/regions.wgsl
// Facets at a time as the pixel sees them, and what of it each covers.

const MOST_FRAGMENTS: u32 = 16u;
const MOST_EDGES: u32 = 6u;
// Part of the product of its corners' distances below which a facet's volume is rounding.
const FLAT_FACET: f32 = 3e-7;
// Part of 1 / depth by which facets in one plane may be apart.
const COPLANAR: f32 = 1e-5;

struct Fragment {
    // Edges that cross the pixel, inside not negative.
    edges: array<vec3<f32>, MOST_EDGES>,
    edge_count: u32,
    entry: u32,
    facet: u32,
    // 1 seen from its front, -1 from behind.
    side: f32,
    // 1 / depth, the numerators of s and t, and what these are divided by.
    inverse_depth: vec3<f32>,
    place_s: vec3<f32>,
    place_t: vec3<f32>,
    weight: vec3<f32>,
};

var<private> fragments: array<Fragment, MOST_FRAGMENTS>;

// Adds a half plane to fragment `k`; false where it keeps the facet out of the pixel.
fn bound_fragment(k: u32, line: vec3<f32>) -> bool {
    let side = side_of(line);
    if (side == 0) {
        fragments[k].edges[fragments[k].edge_count] = line;
        fragments[k].edge_count += 1u;
    }
    return side >= 0;
}

// Entry `own` of the pixel at part `u` of the block as fragment `k`; false where the pixel does not see it.
fn see(k: u32, own: u32, u: f32) -> bool {
    let index = base.entries + (own & ~COVERS);
    let flags = entries[index].flags;
    let span = entries[index].span;
    // A span holds from its start up to its end; the last one also at the end of the block.
    if (u < span.x || (u >= span.y && span.y < 1.0)) {
        return false;
    }
    let h = corners_at(entries[index].points, (u - span.x) / (span.y - span.x));
    let e0 = edge_of(h[0], h[1]);
    let e3 = edge_of(h[3], h[0]);
    let across = cross(h[1], h[3]);
    let volume = dot(h[0], across);
    let front = (volume < 0.0) != ((flags & MIRRORED) != 0u);
    // What rounding leaves of a facet that has no area, or is seen from its side.
    let nothing = FLAT_FACET * length(h[0]) * length(h[1]) * length(h[3]);
    if (abs(volume) <= nothing || (!front && (flags & DOUBLE_SIDED) == 0u)) {
        return false;
    }
    let inverse = 1.0 / volume;
    let inverse_depth = (e0 + e3 + across) * inverse;
    fragments[k].edge_count = 0u;
    fragments[k].entry = index;
    fragments[k].facet = entries[index].facet;
    fragments[k].side = select(-1.0, 1.0, front);
    fragments[k].inverse_depth = inverse_depth;
    if ((job.flags & PARALLEL) != 0u) {
        fragments[k].place_s = e3 * (inverse * h[1].z);
        fragments[k].place_t = e0 * (inverse * h[3].z);
        fragments[k].weight = vec3<f32>(0.0, 0.0, 1.0);
    } else {
        fragments[k].place_s = e3 * inverse;
        fragments[k].place_t = e0 * inverse;
        fragments[k].weight = inverse_depth;
    }
    if (CLASS == PLAIN || (own & COVERS) != 0u) {
        return true;
    }
    let side = sign(volume);
    if (!(bound_fragment(k, e0 * side)
        && bound_fragment(k, edge_of(h[1], h[2]) * side)
        && bound_fragment(k, edge_of(h[2], h[3]) * side)
        && bound_fragment(k, e3 * side))) {
        return false;
    }
    if ((flags & CROSSES_NEAR) != 0u && !bound_fragment(k, depth_plane(job.near) - inverse_depth)) {
        return false;
    }
    return (flags & CROSSES_FAR) == 0u || bound_fragment(k, inverse_depth - depth_plane(job.far));
}

// Where fragment `i` lies before `k`: all of the pixel (1), nothing of it (-1), or where `difference` is not negative (0).
fn lies_before(i: u32, k: u32, difference: vec3<f32>) -> i32 {
    let far = reach(difference);
    let own = fragments[i].inverse_depth;
    let other = fragments[k].inverse_depth;
    let depth = max(abs(own.z) + reach(own), abs(other.z) + reach(other));
    if (abs(difference.z) + far < COPLANAR * depth) {
        return select(-1, 1, fragments[i].facet < fragments[k].facet);
    }
    if (difference.z >= far) {
        return 1;
    }
    return select(0, -1, difference.z <= -far);
}

// The list that holds what the pixel sees of fragment `k` among `count` of them.
fn visible_part(k: u32, count: u32) -> u32 {
    clear_list(0u);
    push_corner(0u, vec2<f32>(-0.5, -0.5));
    push_corner(0u, vec2<f32>(0.5, -0.5));
    push_corner(0u, vec2<f32>(0.5, 0.5));
    push_corner(0u, vec2<f32>(-0.5, 0.5));
    close_polygon(0u);
    var list = 0u;
    // What lies outside of each edge, then what lies behind each of the others. One loop: drivers make code for each call.
    let edges = fragments[k].edge_count;
    for (var step = 0u; step < edges + count && list_count[list] > 0u; step++) {
        var lines = 1u;
        spend(1u + MOST_EDGES);
        if (step < edges) {
            cutters[0] = -fragments[k].edges[step];
        } else {
            let other = step - edges;
            let difference = fragments[other].inverse_depth - fragments[k].inverse_depth;
            let side = lies_before(other, k, difference);
            if (other == k || side < 0) {
                continue;
            }
            lines = fragments[other].edge_count;
            for (var edge = 0u; edge < lines; edge++) {
                cutters[edge] = fragments[other].edges[edge];
            }
            if (side == 0) {
                cutters[lines] = difference;
                lines += 1u;
            }
        }
        subtract_from(all_of(list), 1u - list, lines);
        list = 1u - list;
    }
    return list;
}
