#import decoupled/shadows.wgsl
#import decoupled/texture.wgsl
#import common/luminance.wgsl
// Light that a pixel gets at a time.

// Rows of `fixed` per facet: base colour with the texture's number plus 1 in w, its change along s and along t with
// the texture's origin in w, and the change of texture coordinates.
const LOOK_ROWS: u32 = 4u;
// Where shadows leave such a part of an area, base colour is averaged over what they leave.
const PARTLY_LIT: vec2<f32> = vec2<f32>(0.001, 0.99);
// Parts of a pixel below this are none.
const NO_AREA: f32 = 1e-6;
const BOUNDLESS: f32 = 1e30;
const NO_VARIANCE: f32 = 1e-9;

struct Surface {
    place: vec2<f32>,
    base: vec3<f32>,
};

// (s, t) at the centroid of a part of fragment `k`, and base colour averaged over the part.
fn surface_of(k: u32, m: Moments) -> Surface {
    let at = m.first / m.area;
    let weight = fragments[k].weight;
    let place_s = fragments[k].place_s;
    let place_t = fragments[k].place_t;
    let depth = 1.0 / line_at(weight, at);
    let place = vec2<f32>(line_at(place_s, at), line_at(place_t, at)) * depth;
    let look = fragments[k].facet * LOOK_ROWS;
    let first = fixed[look];
    let along_s = fixed[look + 1u];
    let along_t = fixed[look + 2u];
    var color = first.xyz + along_s.xyz * place.x + along_t.xyz * place.y;
    let texture = bitcast<u32>(first.w);
    if (texture > 0u) {
        let v = m.second / m.area - vec3<f32>(at.x * at.x, at.x * at.y, at.y * at.y);
        // Cholesky: a unit square has the variance 1/12 along each side.
        let l = sqrt(max(v.x, NO_VARIANCE));
        let across = v.y / l;
        let n = sqrt(max(v.z - across * across, 0.0));
        let side = sqrt(12.0);
        let p = vec2<f32>(side * l, side * across);
        let q = vec2<f32>(0.0, side * n);
        let texels = fixed[look + 3u];
        let right = vec2<f32>(place_s.x - place.x * weight.x, place_t.x - place.y * weight.x) * depth;
        let down = vec2<f32>(place_s.y - place.x * weight.y, place_t.y - place.y * weight.y) * depth;
        let right_texels = texels.xy * right.x + texels.zw * right.y;
        let down_texels = texels.xy * down.x + texels.zw * down.y;
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

// A patch's nodes at `within` of it, for lamp `lamp` of `lamps`.
fn patch_at(word: u32, within: vec2<f32>, lamp: u32, lamps: u32) -> vec4<f32> {
    let start = base.nodes + words[base.words + word];
    let intervals = bitcast<u32>(nodes[start].x);
    let at = within * f32(intervals);
    let low = min(vec2<u32>(at), vec2<u32>(intervals - 1u));
    let w = at - vec2<f32>(low);
    let row = intervals + 1u;
    let corner = start + 1u + (low.y * row + low.x) * lamps + lamp;
    let upper = mix(nodes[corner], nodes[corner + lamps], w.x);
    let lower = mix(nodes[corner + row * lamps], nodes[corner + (row + 1u) * lamps], w.x);
    return mix(upper, lower, w.y);
}

// Response of an entry at (s, t) to what no shadow falls on (lamp 0) or to one of its lamps.
fn response_at(entry: u32, place: vec2<f32>, u: f32, lamp: u32) -> vec4<f32> {
    let count = entries[entry].count;
    let at = clamp(
        place * entries[entry].cells - entries[entry].first,
        vec2<f32>(0.0),
        vec2<f32>(count),
    );
    let cell = min(vec2<u32>(at), count - 1u);
    let within = at - vec2<f32>(cell);
    let word = entries[entry].patches + cell.y * count.x + cell.x;
    let intervals = entries[entry].intervals;
    let lamps = 1u + job.lamps;
    let time = u * f32(intervals);
    let interval = min(u32(time), max(intervals, 1u) - 1u);
    let moment = select(0u, count.x * count.y, intervals > 0u);
    let a = patch_at(word + interval * moment, within, lamp, lamps);
    let b = patch_at(word + (interval + 1u) * moment, within, lamp, lamps);
    return mix(a, b, time - f32(interval));
}

// Luminance that fragment `k` adds, of which the pixel sees what is in list `visible`, with the moments `m`.
fn light_of(k: u32, m: Moments, visible: u32, u: f32) -> f32 {
    let entry = fragments[k].entry;
    let glow = wave_at(entries[entry].glow, u);
    let unlit = (entries[entry].flags & UNLIT) != 0u;
    var surface: Surface;
    var sum = select(glow, 0.0, unlit);
    // What no shadow falls on, then lamp by lamp.
    for (var number = 0u; number <= job.lamps; number++) {
        var reached = Reached(1.0, false, m);
        if (number > 0u) {
            if (unlit || ((entries[entry].lit >> (number - 1u)) & 1u) == 0u) {
                continue;
            }
            reached = arriving(k, number - 1u, visible, m.area, u);
            if (reached.part <= 0.0) {
                continue;
            }
        }
        // What the lamp reaches may look otherwise than the rest.
        let left = reached.moments.area / m.area;
        let apart = reached.partly && left >= PARTLY_LIT.x && left < PARTLY_LIT.y;
        var seen = surface;
        if (number == 0u || apart) {
            seen = surface_of(k, reached.moments);
        }
        if (number == 0u) {
            surface = seen;
        }
        if (unlit) {
            sum = glow * luminance(seen.base);
        } else {
            let response = response_at(entry, seen.place, u, number);
            sum += reached.part * (dot(seen.base, response.xyz) + response.w);
        }
    }
    return m.area * sum;
}

// Mean luminance of a pixel at part `u` of the block.
fn light_at(own: u32, own_count: u32, u: f32) -> f32 {
    var count = 0u;
    count_iterations(own_count);
    for (var k = 0u; k < own_count; k++) {
        if (count == MOST_FRAGMENTS) {
            failed = true;
            break;
        }
        if (see(count, words[base.words + own + k], u)) {
            count += 1u;
        }
    }
    var rest = whole_pixel();
    var sum = 0.0;
    for (var k = 0u; k < count; k++) {
        let visible = visible_part(k, count);
        let m = moments_of(visible);
        if (m.area > NO_AREA) {
            rest = minus_moments(rest, m);
            sum += light_of(k, m, visible, u);
        }
    }
    let light = sum + max(rest.area, 0.0) * job.background;
    // What is no number is left to 64 bits.
    failed = failed || !(abs(light) < BOUNDLESS);
    return light;
}
