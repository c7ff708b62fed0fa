#import march/layout.wgsl
// Where the light of a pixel between two keys comes from in each of them.

@group(0) @binding(3) var kept_means: texture_storage_2d_array<rgba32float, read>;
@group(0) @binding(4) var kept_places: texture_storage_2d_array<rgba32float, read>;

// A tile at its keys.
struct Keys {
    // Texel of the tile's own first pixel, and that pixel.
    texel: vec2<i32>,
    corner: vec2<i32>,
    older: u32,
    newer: u32,
};

fn keys_of(gap: Gap) -> Keys {
    return Keys(
        vec2<i32>(gap.place * SIDE + APRON),
        vec2<i32>(gap.place * TILE),
        job.view * 2u + 1u - gap.slot,
        job.view * 2u + gap.slot);
}

fn place_at(keys: Keys, layer: u32, pixel: vec2<i32>) -> vec4<f32> {
    let apron = i32(APRON);
    let within = clamp(pixel - keys.corner, vec2<i32>(-apron), vec2<i32>(i32(TILE) + apron - 1));
    return textureLoad(kept_places, vec2<u32>(keys.texel + within), layer);
}

// Where `m` shows what the key in `layer` shows at `pixel`; z is below 0 where it does not, or where that is not `number`.
fn seen_from(keys: Keys, layer: u32, number: f32, m: mat4x4<f32>, pixel: vec2<i32>) -> vec3<f32> {
    let place = place_at(keys, layer, pixel);
    let clip = m * homogeneous(place);
    let known = place.w == number && clip.w > 0.0;
    return vec3<f32>((clip.xy / clip.w * vec2<f32>(1.0, -1.0) + 1.0) * job.half_size, select(-1.0, 1.0, known));
}

// Where the key in `layer` shows what `m` brings to `at`; z is below 0 where it does not.
fn source(keys: Keys, layer: u32, number: f32, m: mat4x4<f32>, at: vec2<f32>, guess: vec2<f32>) -> vec3<f32> {
    // Near the place first, as if everything moved alike.
    let near = floor(guess);
    let first = seen_from(keys, layer, number, m, vec2<i32>(near));
    let nearer = floor(near + 0.5 + (at - first.xy));
    // From its pixel on with the motion's slope: what turns or comes nearer does not move alike.
    let pixel = vec2<i32>(nearer);
    let side = select(vec2<i32>(1), vec2<i32>(-1), pixel - keys.corner >= vec2<i32>(i32(TILE) / 2));
    let here = seen_from(keys, layer, number, m, pixel);
    let beside = seen_from(keys, layer, number, m, pixel + vec2<i32>(side.x, 0));
    let below = seen_from(keys, layer, number, m, pixel + vec2<i32>(0, side.y));
    let along_x = (beside.xy - here.xy) * f32(side.x);
    let along_y = (below.xy - here.xy) * f32(side.y);
    let left = at - here.xy;
    let det = along_x.x * along_y.y - along_x.y * along_y.x;
    let step = vec2<f32>(left.x * along_y.y - left.y * along_y.x, along_x.x * left.y - along_x.y * left.x) / det;
    let now = nearer + 0.5 + step;
    var known = min(here.z, first.z) > 0.0;
    // A pixel around it must lie in the picture, and what it is made from in the key.
    let apron = f32(APRON);
    let low = max(vec2<f32>(keys.corner) - apron + 0.25, vec2<f32>(0.0));
    let high = min(vec2<f32>(keys.corner) + f32(TILE) + apron - 0.5, 2.0 * job.half_size);
    known = known && all(now - 0.5 >= low - 1e-3) && all(now + 0.5 <= high + 1e-3);
    return vec3<f32>(now, select(-1.0, 1.0, known));
}

// Weights of phases `d` away: Catmull and Rom's cubic.
fn cubic(d: vec4<f32>) -> vec4<f32> {
    let a = abs(d);
    let near = (1.5 * a - 2.5) * a * a + 1.0;
    let far = ((-0.5 * a + 2.5) * a - 4.0) * a + 2.0;
    return select(select(vec4<f32>(0.0), far, a < vec4<f32>(2.0)), near, a < vec4<f32>(1.0));
}

// Mean light of a pixel around `at` in the key in slot `layer`.
fn look(keys: Keys, layer: u32, at: vec2<f32>) -> f32 {
    let begin = (at - 0.5 - vec2<f32>(keys.corner)) * f32(PHASES);
    let part = begin - floor(begin);
    // The first of four phases, counted from the texture's corner.
    let first = vec2<u32>(keys.texel * i32(PHASES) + vec2<i32>(floor(begin)) - 1);
    // Along x they lie in two texels.
    let off = vec4<f32>(0.0, 1.0, 2.0, 3.0) - f32(first.x % PHASES) - 1.0 - part.x;
    let left = cubic(off);
    let right = cubic(off + f32(PHASES));
    let down = cubic(vec4<f32>(-1.0, 0.0, 1.0, 2.0) - part.y);
    let x = first.x / PHASES;
    var sum = 0.0;
    for (var i = 0u; i < PHASES; i++) {
        let y = first.y + i;
        let at_phase = layer * PHASES + y % PHASES;
        let line = dot(left, textureLoad(kept_means, vec2<u32>(x, y / PHASES), at_phase))
            + dot(right, textureLoad(kept_means, vec2<u32>(x + 1u, y / PHASES), at_phase));
        sum += line * down[i];
    }
    return sum;
}

// The way of what a pixel shows through a key: a parabola through three exact places; time runs from 0 at the key to 1 at
// the other one.
struct Way {
    start: vec2<f32>,
    speed: vec2<f32>,
    bend: vec2<f32>,
    known: bool,
};

fn way_of(keys: Keys, layer: u32, number: f32, frames: vec2<u32>, at: vec2<f32>) -> Way {
    let last = source(keys, layer, number, motion(frames.y, number), at, at);
    let middle = source(keys, layer, number, motion(frames.x, number), at, 0.5 * (at + last.xy));
    let bend = 2.0 * (at - 2.0 * middle.xy + last.xy);
    return Way(at, last.xy - at - bend, bend, last.z > 0.0 && middle.z > 0.0);
}

fn along(way: Way, time: f32) -> vec2<f32> {
    return way.start + time * (way.speed + time * way.bend);
}

// How a pixel is followed through a gap: through one key; by what factor its light is off at the other, by a part of that it
// is corrected on the way, as if lights had changed. What enters the picture is known to the newer key only, what leaves it to the older one.
struct Walk {
    way: Way,
    layer: u32,
    // Time at which that key is, and by how much of its light that is off at the other one.
    at: f32,
    drift: f32,
    // Light at both keys, as the one that is walked tells and as it is at the other.
    told: f32,
    shown: f32,
};

fn walk_of(keys: Keys, gap: Gap, number: f32, pixel: vec2<i32>) -> Walk {
    let here = vec2<f32>(pixel) + 0.5;
    let span = 1u << gap.length;
    let middle = job.frame - span / 2u;
    var way = way_of(keys, keys.older, number, vec2<u32>(middle, job.frame), here);
    let older = way.known;
    // Loops end early on software drivers, branches do not.
    for (var i = select(1u, 0u, older); i > 0u; i--) {
        way = way_of(keys, keys.newer, number, vec2<u32>(middle, job.frame - span), here);
    }
    let layer = select(keys.newer, keys.older, older);
    // What is not known is not looked up.
    let told = look(keys, layer, select(here, along(way, 1.0), way.known));
    let shown = look(keys, select(keys.older, keys.newer, older), here);
    return Walk(way, layer, select(1.0, 0.0, older), (shown + job.dark) / (told + job.dark) - 1.0, told, shown);
}

// Light of the pixel at `time`, from 0 at the older key to 1 at the newer.
fn light_at(keys: Keys, walk: Walk, time: f32) -> f32 {
    let since = abs(time - walk.at);
    let light = look(keys, walk.layer, along(walk.way, since));
    return light + since * walk.drift * (light + job.dark);
}
