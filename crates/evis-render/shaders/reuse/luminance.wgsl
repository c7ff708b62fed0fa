#import raster/stage.wgsl
#import reuse/layout.wgsl
// The first raster pass of `reproject`: what stands still in the world takes its light from the two keyframes around,
// where both show it and agree. Elsewhere nothing is drawn, and the pass that shades finds the place empty: software drivers
// run both sides of a branch, but shade nothing that is behind what was drawn. Test: tests/floor3_reproject.rs.

// Part of an inverse depth by which a keyframe's cell may differ from what is looked for.
override NEAR: f32 = 0.03;
// Part by which the keyframes' lights may differ, beside what a place's neighbours do.
override AGREE: f32 = 0.03;

@group(3) @binding(0) var<uniform> reuse: ReuseFrame;
@group(3) @binding(1) var lights: texture_2d_array<f32>;
@group(3) @binding(2) var keys: texture_2d_array<u32>;
@group(3) @binding(3) var means: texture_2d_array<f32>;
@group(3) @binding(4) var points: sampler;

// What a keyframe knows of a place: light (below 0: nothing), and by how much that differs nearby.
struct Known {
    light: f32,
    spread: f32,
};

// From four texels, as they are gathered, to the place between them.
fn between(four: vec4<f32>, part: vec2<f32>) -> f32 {
    return mix(mix(four.w, four.z, part.x), mix(four.x, four.y, part.x), part.y);
}

fn spread_of(four: vec4<f32>) -> f32 {
    return max(max(four.x, four.y), max(four.z, four.w)) - min(min(four.x, four.y), min(four.z, four.w));
}

fn known(clip_from_world: mat4x4<f32>, layer: u32, world: vec3<f32>, number: u32) -> Known {
    let clip = clip_from_world * vec4<f32>(world, 1.0);
    // Behind the keyframe's camera, this brings the place far outside of its picture. (Mesa 22.3's lavapipe crashes on a
    // comparison of clip.w here.)
    let inverse_depth = 1.0 / max(clip.w, 1e-9);
    let exact = (vec2<f32>(0.5, -0.5) * clip.xy * inverse_depth + 0.5) * reuse.cells;
    let at = clamp(exact, vec2<f32>(1.0), reuse.cells - 1.0);
    let from_border = min(min(exact.x, exact.y), min(reuse.cells.x - exact.x, reuse.cells.y - exact.y));
    let size = 1.0 / reuse.cells;
    let corner = floor(at);
    let here = shows(textureLoad(keys, vec2<u32>(corner), layer, 0).r, number, inverse_depth, NEAR);
    let around = textureGather(0, means, points, (corner + 1.0) * size, layer);
    // Near a border: of the four cells around, those that show this surface.
    let low = floor(at - 0.5);
    let part = at - 0.5 - low;
    let middle = (low + 1.0) * size;
    let four_keys = textureGather(0, keys, points, middle, layer);
    let four = textureGather(0, lights, points, middle, layer);
    let shown = vec4<bool>(
        shows(four_keys.x, number, inverse_depth, NEAR),
        shows(four_keys.y, number, inverse_depth, NEAR),
        shows(four_keys.z, number, inverse_depth, NEAR),
        shows(four_keys.w, number, inverse_depth, NEAR));
    let rest = 1.0 - part;
    let parts = vec4<f32>(rest.x * part.y, part.x * part.y, part.x * rest.y, rest.x * rest.y);
    let weights = select(vec4<f32>(0.0), parts, shown);
    let sum = dot(weights, vec4<f32>(1.0));
    let near_border = select(-1.0, dot(weights, four) / sum, sum > 0.25);
    let inside = here && all(around >= vec4<f32>(0.0));
    let light = select(near_border, between(around, at - corner), inside);
    let spread = select(spread_of(four), spread_of(around), inside);
    return Known(select(-1.0, light, from_border >= 1.0), spread);
}

@fragment
fn fs_main(v: Varyings) -> @location(0) f32 {
    let number = vary_number(v) - reuse.first_record + 1u;
    // The whole pixel's light is looked for, wherever in it this sample lies.
    let world = vary_world(v) + reuse.shift.x * dpdxFine(vary_world(v)) + reuse.shift.y * dpdyFine(vary_world(v));
    let a = known(reuse.older_clip_from_world, reuse.older, world, number);
    let b = known(reuse.newer_clip_from_world, reuse.newer, world, number);
    let least = min(a.light, b.light);
    let allowed = AGREE * least + 0.25 * (a.spread + b.spread);
    if (least < 0.0 || abs(a.light - b.light) > allowed) {
        discard;
    }
    return mix(a.light, b.light, reuse.weight);
}
