#import decoupled/shadows.wgsl
#import decoupled/sky.wgsl
#import decoupled/texture.wgsl
#import decoupled/maps.wgsl
#import common/luminance.wgsl
// Light that a pixel gets at a time.

// Rows of `kept` per facet: base colour with the texture's number plus 1 in w, its change along s and along t with
// the texture's origin in w, the change of texture coordinates, and metallic, roughness, occlusion and 0 of what has no highlights.
const LOOK_ROWS: u32 = 5u;
// Two points of Gauss along a side, as a part of the side from its middle.
const LIT_OFFSET: f32 = 0.28867513;
// Where shadows leave such a part of an area, base colour is averaged over what they leave.
const PARTLY_LIT: vec2<f32> = vec2<f32>(0.001, 0.99);
// Parts of a pixel below this are none.
const NO_AREA: f32 = 1e-6;
const BOUNDLESS: f32 = 1e30;

struct Surface {
    place: vec2<f32>,
    base: vec3<f32>,
};

// (s, t) of fragment `k` at a place of the pixel, and their change to the right and down.
struct Spot {
    place: vec2<f32>,
    right: vec2<f32>,
    down: vec2<f32>,
};

fn spot_of(k: u32, at: vec2<f32>) -> Spot {
    let weight = fragments[k].weight;
    let place_s = fragments[k].place_s;
    let place_t = fragments[k].place_t;
    let depth = 1.0 / line_at(weight, at);
    let place = vec2<f32>(line_at(place_s, at), line_at(place_t, at)) * depth;
    let right = vec2<f32>(place_s.x - place.x * weight.x, place_t.x - place.y * weight.x) * depth;
    let down = vec2<f32>(place_s.y - place.x * weight.y, place_t.y - place.y * weight.y) * depth;
    return Spot(place, right, down);
}

// (s, t) at the centroid of a part of fragment `k`, and base colour averaged over the part.
fn surface_of(k: u32, m: Moments) -> Surface {
    let spot = spot_of(k, m.first / m.area);
    let place = spot.place;
    let look = job.looks + fragments[k].facet * LOOK_ROWS;
    let first = kept[look];
    let along_s = kept[look + 1u];
    let along_t = kept[look + 2u];
    var color = first.xyz + along_s.xyz * place.x + along_t.xyz * place.y;
    let texture = bitcast<u32>(first.w);
    if (texture > 0u) {
        let sides = sides_of(m);
        let p = sides.along;
        let q = sides.down;
        let texels = kept[look + 3u];
        let right_texels = texels.xy * spot.right.x + texels.zw * spot.right.y;
        let down_texels = texels.xy * spot.down.x + texels.zw * spot.down.y;
        let origin = vec2<f32>(along_s.w, along_t.w);
        let middle = origin + texels.xy * place.x + texels.zw * place.y;
        color *= texture_mean(
            texture - 1u,
            middle,
            right_texels * p.x + down_texels * p.y,
            right_texels * q.x + down_texels * q.y,
        );
    }
    return Surface(place, color);
}

// By which responses count: of what no shadow falls on, then of lamps.
var<private> weights: array<f32, MAP_LIGHTS>;

// Luminance per area that a part of fragment `k` with the moments `m` and base colour sends of the `responses` whose bits are set, each
// by its weight: 0 of what no shadow falls on, then lamp by lamp.
fn lit_part(k: u32, m: Moments, surface: Surface, responses: u32, u: f32) -> f32 {
    let entry = fragments[k].entry;
    let facet = geometry_at(base.points + entries[entry].light, u);
    let eye = over_time(base.points, 1u, u);
    let matter = kept[job.looks + fragments[k].facet * LOOK_ROWS + 4u];
    // Two points of Gauss along either side, where light has an edge or a highlight.
    var places = 1u;
    var p = vec2<f32>(0.0);
    var q = vec2<f32>(0.0);
    var middle = surface.place;
    if ((entries[entry].flags & SHARP) != 0u) {
        let sides = sides_of(m);
        let spot = spot_of(k, sides.middle);
        places = 4u;
        middle = spot.place;
        p = LIT_OFFSET * (spot.right * sides.along.x + spot.down * sides.along.y);
        q = LIT_OFFSET * (spot.right * sides.down.x + spot.down * sides.down.y);
    }
    let lamps = lamp_count();
    spend(places * (1u + lamps));
    var sum = 0.0;
    for (var place = 0u; place < places; place++) {
        let at = middle + select(-p, p, (place & 1u) == 1u) + select(-q, q, place > 1u);
        var point: LitPoint;
        point.position = position_at(facet, at);
        point.normal = normal_at(facet, at) * fragments[k].side;
        point.to_eye = way_to_eye(eye, point.position);
        point.base = surface.base;
        point.metallic = matter.x;
        point.roughness = matter.y;
        point.occlusion = matter.z;
        point.diffuse = matter.w == 0.0;
        if ((responses & 1u) == 1u) {
            let around = lit_from_around(point);
            sum += around.x + around.y;
        }
        for (var lamp = 0u; lamp < lamps; lamp++) {
            let own = own_of_lamp(lamp);
            if (((responses >> own) & 1u) == 1u) {
                let light = lit_by(point, lamp_now(lamp, u));
                sum += weights[own] * (light.x + light.y);
            }
        }
    }
    return sum / f32(places);
}

// Parts of a fragment whose base colour is averaged: all that the pixel sees of it, and what a lamp reaches of that, where
// shadows leave some of it.
const MOST_TASKS: u32 = 9u;
var<private> task_moments: array<Moments, MOST_TASKS>;
// Bits of the responses that a part has: 0 of what no shadow falls on, then lamp by lamp.
var<private> task_responses: array<u32, MOST_TASKS>;

// What the pixel sees of facets.
struct Part {
    fragment: u32,
    visible: Range,
    moments: Moments,
};

const MOST_SEEN: u32 = 10u;
var<private> seen: array<Part, MOST_SEEN>;

// Luminance per area of fragment `k`, which has maps, over a part of it with the moments `m`; each of the lamps `lit` counts by its
// weight.
fn light_of_maps(k: u32, m: Moments, lit: u32, u: f32) -> f32 {
    let entry = fragments[k].entry;
    let sides = sides_of(m);
    let spot = spot_of(k, sides.middle);
    let p = spot.right * sides.along.x + spot.down * sides.along.y;
    let q = spot.right * sides.down.x + spot.down * sides.down.y;
    let look = job.looks + fragments[k].facet * LOOK_ROWS;
    shade_places(base.points + entries[entry].light, look, fragments[k].side, spot.place, p, q, u);
    let glow = wave_at(entries[entry].glow, u) * map_glow;
    let apart = (entries[entry].flags & GLOWS_APART) != 0u;
    var sum = map_light[0] + select(glow, 0.0, apart);
    var whole = sum;
    for (var lamp = 0u; lamp < job.lamps; lamp++) {
        whole += map_light[lamp + 1u];
        sum += select(0.0, weights[lamp + 1u] * map_light[lamp + 1u], ((lit >> lamp) & 1u) == 1u);
    }
    // Places are too few for the detail of a texture: its exact mean takes the place of what they have of it.
    if (bitcast<u32>(kept[look].w) > 0u && map_base > 0.0 && whole > 0.0) {
        let off = clamp(luminance(surface_of(k, m).base) / map_base - 1.0, -0.5, 1.0);
        sum *= 1.0 + off * clamp(map_proportional / whole, 0.0, 1.0);
    }
    return sum + select(0.0, glow, apart);
}

// Luminance that fragment `k` adds, of which the pixel sees what is `visible`, with the moments `m`.
fn light_of(k: u32, m: Moments, visible: Range, u: f32) -> f32 {
    let entry = fragments[k].entry;
    let unlit = (entries[entry].flags & UNLIT) != 0u;
    let has_maps = sees_maps() && (entries[entry].flags & HAS_MAPS) != 0u;
    let lit = select(entries[entry].lit, 0u, unlit);
    // Lamps, what is averaged, and responses of that.
    spend(2u * job.lamps + 2u * MOST_TASKS);
    // Software drivers execute both sides of every branch, so the lamps whose shadows come into the pixel are found first.
    var responses = select(1u, 0u, unlit);
    var shadowed = 0u;
    weights[0] = 1.0;
    for (var lamp = 0u; lamp < job.lamps; lamp++) {
        let shade = entries[entry].shades + SHADE_WORDS * lamp;
        if (((lit >> lamp) & 1u) == 1u && !has_pixel(shade)) {
            weights[lamp + 1u] = lamp_strength(lamp, u);
            responses |= 2u << lamp;
            shadowed |= select(0u, 1u << lamp, has_pixel(shade + 2u));
        }
    }
    task_moments[0] = m;
    var tasks = 1u;
    for (; CLASS != PLAIN && shadowed != 0u && !failed; shadowed &= shadowed - 1u) {
        let lamp = firstTrailingBit(shadowed);
        let reached = reached_by(k, lamp, visible, m, u);
        let left = clamp(reached.area / m.area, 0.0, 1.0);
        weights[lamp + 1u] *= left;
        let apart = left >= PARTLY_LIT.x && left < PARTLY_LIT.y && !has_maps;
        if (apart) {
            // What the lamp reaches may look otherwise than the rest.
            task_moments[tasks] = reached;
            task_responses[tasks] = 2u << lamp;
            tasks += 1u;
        }
        if (apart || left <= 0.0) {
            responses &= ~(2u << lamp);
        }
    }
    if (sees_maps()) {
        if (has_maps) {
            return m.area * light_of_maps(k, m, responses >> 1u, u);
        }
    }
    task_responses[0] = responses;
    let glow = wave_at(entries[entry].glow, u);
    var sum = select(glow, 0.0, unlit);
    for (var task = 0u; task < tasks; task++) {
        let surface = surface_of(k, task_moments[task]);
        if (unlit) {
            sum = glow * luminance(surface.base);
        }
        if (task_responses[task] != 0u) {
            sum += lit_part(k, task_moments[task], surface, task_responses[task], u);
        }
    }
    return m.area * sum;
}

// Number `at` of the lists of entries: of pixels of tiles they are made here.
fn entry_of(at: u32) -> u32 {
    if (is_of_tile) {
        return scratch[batch.own + at];
    }
    return words[base.words + at];
}

// Mean luminance of a pixel that may see several facets.
fn light_of_all(own: u32, own_count: u32, u: f32) -> f32 {
    var count = 0u;
    spend(own_count);
    for (var k = 0u; k < own_count && !failed; k++) {
        if (count == MOST_FRAGMENTS) {
            failed = true;
            break;
        }
        if (see(count, entry_of(own + k), u)) {
            count += 1u;
        }
    }
    // What is seen first, and then its light: of most facets nothing is.
    var rest = whole_pixel();
    var parts = 0u;
    clear_list(KEPT);
    for (var k = 0u; k < count && !failed; k++) {
        let list = visible_part(k, count);
        let m = moments_of(list);
        if (m.area > NO_AREA) {
            if (parts == MOST_SEEN) {
                failed = true;
                break;
            }
            rest = minus_moments(rest, m);
            seen[parts] = Part(k, keep_list(list), m);
            parts += 1u;
        }
    }
    var sum = 0.0;
    for (var part = 0u; part < parts && !failed; part++) {
        let own = seen[part];
        sum += light_of(own.fragment, own.moments, own.visible, u);
    }
    if (rest.area > NO_AREA && !failed) {
        sum += rest.area * background_of(rest, u);
    }
    return sum;
}

// Mean luminance of a pixel at part `u` of the block.
fn light_at(own: u32, own_count: u32, u: f32) -> f32 {
    var light = 0.0;
    if (CLASS == PLAIN) {
        if (see(0u, entry_of(own), u)) {
            light = light_of(0u, whole_pixel(), all_of(0u), u);
        }
    } else {
        light = light_of_all(own, own_count, u);
    }
    // What is no number is left to 64 bits.
    failed = failed || !(abs(light) < BOUNDLESS);
    return light;
}
