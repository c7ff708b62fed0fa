// Shadow rays through the trees of shadow/bvh.rs, and the lists of shadow/light_grid.rs.

// A rigid thing that moves, at one instant. Twin: gpu/uniforms.rs, OccluderRecord.
struct OccluderRecord {
    // Around it: middle and radius.
    sphere: vec4<f32>,
    // Rows of object_from_world.
    object_row_0: vec4<f32>,
    object_row_1: vec4<f32>,
    object_row_2: vec4<f32>,
    root: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
};

@group(0) @binding(5) var<storage, read> occluders: array<OccluderRecord>;
// A node: low corner, where to go on after a miss; high corner, first triangle << 3 | triangles (0: its first child comes
// next). A triangle: a corner, the edges from there. Two cells of a map: where the list of each is, and how long. Four
// triangles of a list.
@group(2) @binding(7) var<storage, read> occluder_words: array<vec4<u32>>;

// Where a tree ends.
const OCCLUDERS_END: u32 = 0xffffffffu;
// Part of an edge by which triangles are larger than they are, so that no ray passes between two that touch.
const OCCLUDER_OVERLAP: f32 = 1e-5;

fn meets_triangle(at: u32, origin: vec3<f32>, direction: vec3<f32>, near: f32, far: f32) -> bool {
    let corner = bitcast<vec3<f32>>(occluder_words[at].xyz);
    let edge_1 = bitcast<vec3<f32>>(occluder_words[at + 1u].xyz);
    let edge_2 = bitcast<vec3<f32>>(occluder_words[at + 2u].xyz);
    // T. Moeller and B. Trumbore, 1997.
    let p = cross(direction, edge_2);
    let determinant = dot(edge_1, p);
    let scale = 1.0 / select(determinant, 1e-30, determinant == 0.0);
    let s = origin - corner;
    let q = cross(s, edge_1);
    let u = dot(s, p) * scale;
    let v = dot(direction, q) * scale;
    let t = dot(edge_2, q) * scale;
    return determinant != 0.0 && u >= -OCCLUDER_OVERLAP && v >= -OCCLUDER_OVERLAP && u + v <= 1.0 + OCCLUDER_OVERLAP
        && t > near && t < far;
}

// Nodes that a ray may visit: so much that rays that matter end, and little enough that a device does not wait for one
// that runs along a crowd of triangles.
const OCCLUDER_NODES: u32 = 400u;

struct ShadowRay {
    found: bool,
    // Nodes that it may still visit.
    left: u32,
};

fn follow(ray: ShadowRay, root: u32, origin: vec3<f32>, direction: vec3<f32>, near: f32, far: f32) -> ShadowRay {
    // Off 0: a ray along a plane of a box would be neither inside nor outside.
    let steady = select(direction, vec3<f32>(1e-20), abs(direction) < vec3<f32>(1e-20));
    let inverse = 1.0 / steady;
    var at = root;
    var found = ray.found;
    var left = ray.left;
    while (at != OCCLUDERS_END && !found && left > 0u) {
        left--;
        let low = occluder_words[at];
        let high = occluder_words[at + 1u];
        let a = (bitcast<vec3<f32>>(low.xyz) - origin) * inverse;
        let b = (bitcast<vec3<f32>>(high.xyz) - origin) * inverse;
        let enters = min(a, b);
        let leaves = max(a, b);
        let enter = max(max(enters.x, enters.y), max(enters.z, near));
        let leave = min(min(leaves.x, leaves.y), min(leaves.z, far));
        if (enter <= leave) {
            let count = high.w & 7u;
            let first = high.w >> 3u;
            for (var i = 0u; i < count; i++) {
                found = found || meets_triangle(first + 3u * i, origin, direction, near, far);
            }
            at = select(at + 2u, low.w, count != 0u);
        } else {
            at = low.w;
        }
    }
    return ShadowRay(found, left);
}

// Cells along a map's edge. Twin: shadow/light_grid.rs.
const OCCLUDER_CELLS: u32 = 1024u;
// The length of a list that is too long to be one.
const OCCLUDERS_CROWDED: u32 = 0xffffffffu;

// What stands still, for a ray to the light whose map shows the ray at `uv`.
fn follow_still(light: Light, uv: vec2<f32>, origin: vec3<f32>, direction: vec3<f32>, near: f32, far: f32) -> ShadowRay {
    var ray = ShadowRay(false, OCCLUDER_NODES);
    var entry = vec2<u32>(0u, OCCLUDERS_CROWDED);
    if (light.spot.w > 0.0) {
        let place = min(vec2<u32>(uv * f32(OCCLUDER_CELLS)), vec2<u32>(OCCLUDER_CELLS - 1u));
        let cell = place.y * OCCLUDER_CELLS + place.x;
        let pair = occluder_words[u32(light.spot.w) + cell / 2u];
        entry = select(pair.xy, pair.zw, (cell & 1u) == 1u);
    }
    if (entry.y == OCCLUDERS_CROWDED) {
        return follow(ray, frame.occluder_root, origin, direction, near, far);
    }
    for (var i = 0u; i < entry.y && !ray.found; i++) {
        let four = occluder_words[entry.x + i / 4u];
        let two = select(four.xy, four.zw, (i & 2u) != 0u);
        ray.found = meets_triangle(select(two.x, two.y, (i & 1u) != 0u), origin, direction, near, far);
    }
    return ray;
}

// Whether anything lies between `origin` and a light `far` away in `direction`, a unit vector; nearer than `near` nothing
// counts. Where no nodes are left, nothing was found so far. The light's map shows the ray at `uv`.
fn shadow_ray(light: Light, uv: vec2<f32>, origin: vec3<f32>, direction: vec3<f32>, near: f32, far: f32) -> ShadowRay {
    var ray = follow_still(light, uv, origin, direction, near, far);
    let end = frame.occluder_first + frame.occluder_count;
    for (var i = frame.occluder_first; i < end && !ray.found; i++) {
        let sphere = occluders[i].sphere;
        let apart = sphere.xyz - origin;
        let nearest = apart - clamp(dot(apart, direction), 0.0, far) * direction;
        if (dot(nearest, nearest) > sphere.w * sphere.w) {
            continue;
        }
        let o = occluders[i];
        let from_here = vec4<f32>(origin, 1.0);
        let local = vec3<f32>(dot(o.object_row_0, from_here), dot(o.object_row_1, from_here), dot(o.object_row_2, from_here));
        // Not a unit vector where the thing is scaled: distances along it stay those of the world.
        let along = vec3<f32>(
            dot(o.object_row_0.xyz, direction), dot(o.object_row_1.xyz, direction), dot(o.object_row_2.xyz, direction));
        ray = follow(ray, o.root, local, along, near, far);
    }
    return ray;
}
