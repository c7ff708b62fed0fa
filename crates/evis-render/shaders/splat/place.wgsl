#import splat/layout.wgsl
// Where each pixel of a keyframe is at an instant, and the nearest depth that reaches each pixel there.
// Twin: cpu/splat.rs, place.

// Only into the holes of the other side: what is seen there already needs no more.
override FILL_HOLES: bool = false;

// Luminance, 1 / (depth + 1e-3), motion to the other keyframe.
@group(0) @binding(1) var sources: texture_2d_array<f32>;
// Object + 1; 0 where nothing was drawn.
@group(0) @binding(2) var<storage, read> objects: array<u32>;
// Rows x·w, y·w, w of (x, y, 1 / depth, 1), in keyframe pixels; w row of zeros: the object deforms.
@group(0) @binding(3) var<storage, read> transforms: array<vec4<f32>>;
// Per side, planes: x, y as `packed` makes them, depth key (0: not placed).
@group(0) @binding(4) var<storage, read_write> placed: array<u32>;
@group(0) @binding(5) var<storage, read_write> sums: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read> hole_tiles: array<u32>;

// Bits of 16 384 pixels: beyond, or not a number, a motion vector is none.
const MOTION_LIMIT_BITS: u32 = 0x46800000u;

fn is_motion(d: vec2<f32>) -> bool {
    let bits = bitcast<vec2<u32>>(d) & vec2<u32>(0x7fffffffu);
    return bits.x < MOTION_LIMIT_BITS && bits.y < MOTION_LIMIT_BITS;
}

struct Place {
    // Displacement in keyframe pixels.
    moved: vec2<f32>,
    nearness: f32,
    known: bool,
};

fn linear_place(source: vec4<f32>) -> Place {
    return Place(source.zw * params.moved, source.y, is_motion(source.zw));
}

fn exact_place(p: vec2<u32>, view: u32, source: vec4<f32>) -> Place {
    let nearness = source.y;
    let object = objects[key_layer(params.side, 0u) * (canvas_pixels() / params.view_count) + canvas_index(p, view)];
    let row = params.transform_base + (view * (params.objects + 1u) + object) * 3u;
    let row_w = transforms[row + 2u];
    if (all(row_w == vec4<f32>(0.0))) {
        return linear_place(source);
    }
    // Undo 1 / (depth + 1e-3).
    let inverse_depth = nearness / max(1.0 - 1e-3 * nearness, 1e-6);
    let here = vec2<f32>(p) + 0.5;
    let point = vec4<f32>(here, inverse_depth, 1.0);
    let w = dot(row_w, point);
    let d = vec2<f32>(dot(transforms[row], point), dot(transforms[row + 1u], point)) / max(w, 1e-20) - here;
    let there = inverse_depth / max(w, 1e-20);
    return Place(d, there / (1.0 + 1e-3 * there), w > 1e-20 && is_motion(d));
}

// Whether the other side shows nothing at target pixel `at`.
fn is_hole(at: u32) -> bool {
    return f32(atomicLoad(&sums[sums_base(1u - params.side) + target_pixels() + at])) < HOLE_WEIGHT;
}

// Whether an index reaches beyond the pixel that its centre is in: where the keyframe shows its surface on that side too.
// So no crack opens where pixels move apart, and no outline grows between keyframes. Colours weigh less there anyway.
fn reaches(p: vec2<u32>, view: u32, nearness: f32, q: vec2<i32>) -> vec2<bool> {
    if (EVIS_PAPER) {
        return vec2<bool>(true);
    }
    let beside = vec2<i32>(p) + select(vec2<i32>(1), vec2<i32>(-1), leans(q));
    return vec2<bool>(
        goes_on(vec2<i32>(beside.x, i32(p.y)), view, nearness),
        goes_on(vec2<i32>(i32(p.x), beside.y), view, nearness));
}

fn goes_on(p: vec2<i32>, view: u32, nearness: f32) -> bool {
    if (p.x < 0 || p.y < 0 || p.x >= i32(params.canvas_width) || p.y >= i32(params.canvas_height)) {
        return false;
    }
    let other = textureLoad(sources, vec2<u32>(p), key_layer(params.side, view), 0).y;
    return min(nearness, other) >= max(nearness, other) * SAME_SURFACE;
}

@compute @workgroup_size(SPLAT_WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.canvas_width) {
        return;
    }
    let canvas = canvas_pixels();
    let plane = target_pixels();
    let depths = sums_base(params.side);
    let source = textureLoad(sources, id.xy, key_layer(params.side, id.z), 0);
    var place: Place;
    if (EVIS_PAPER) {
        place = linear_place(source);
    } else {
        place = exact_place(id.xy, id.z, source);
    }
    var key = KEY_OF_NOTHING;
    let out = params.side * 3u * canvas + canvas_index(id.xy, id.z);
    if (place.known && source.x >= 0.0) {
        let d = vec2<i32>(floor(place.moved * f32(SUBPIXELS) + 0.5));
        let q = (vec2<i32>(id.xy) - i32(params.margin)) * SUBPIXELS + d;
        let place_word = packed(q, reaches(id.xy, id.z, source.y, q));
        let taps = reached(place_word);
        if (!FILL_HOLES || hole_tiles[hole_tile(taps.base, id.z)] != 0u) {
            let depth = bitcast<u32>(max(place.nearness, 0.0)) + 1u;
            for (var i = 0u; i < 4u; i++) {
                let at = tap_index(taps, i, id.z, plane);
                if (at < plane && taps.weights[i] > 0u) {
                    if (!FILL_HOLES || is_hole(at)) {
                        // A look is cheaper than a change, and mostly a neighbour was there before.
                        if (atomicLoad(&sums[depths + at]) < depth) {
                            atomicMax(&sums[depths + at], depth);
                        }
                        key = depth;
                    }
                }
            }
        }
        if (key != KEY_OF_NOTHING) {
            placed[out] = place_word.x;
            placed[out + canvas] = place_word.y;
        }
    }
    placed[out + 2u * canvas] = key;
}
