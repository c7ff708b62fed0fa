#import decoupled/lit.wgsl
#import decoupled/texture.wgsl
// Light of surfaces with normal, roughness, occlusion or emission maps: shaded at a grid of places of what a pixel sees. Twins:
// `shading/light/maps.rs`, `shading/places.rs`, `image/maps.rs` and `image/environment.rs` of evis-decoupled.

// Places along either side of a footprint.
const MAP_PLACES: u32 = 4u;

// Rows of a facet behind those of its geometry: tangents at (s, t) = (0, 0), (1, 0) and (0, 1) by power of the block's time, with the sign
// of the bitangent in w of the first; two per map (its texture's number plus 1 and its origin; its change along s and t); then numbers of
// its material.
const TANGENT_ROWS: u32 = 9u;
const MAP_ROWS: u32 = GEOMETRY_ROWS + TANGENT_ROWS;
const MATERIAL_ROW: u32 = MAP_ROWS + 10u;
const EMISSION_ROW: u32 = MATERIAL_ROW + 1u;
// Maps.
const BASE_MAP: u32 = 0u;
const NORMAL_MAP: u32 = 1u;
const METALLIC_ROUGHNESS_MAP: u32 = 2u;
const OCCLUSION_MAP: u32 = 3u;
const EMISSION_MAP: u32 = 4u;

// Texel (x, y) of a level of texels that begin at number `first`.
fn map_texel(head: TextureHead, first: u32, size: vec2<i32>, x: i32, y: i32) -> vec3<f32> {
    let number = first + u32(wrapped(y, size.y, head.wrap_v) * size.x + wrapped(x, size.x, head.wrap_u));
    let both = bitcast<vec4<u32>>(fixed[batch.texels + number / 2u]);
    let words = select(both.xy, both.zw, number % 2u == 1u);
    return vec3<f32>(unpack2x16unorm(words.x), unpack2x16unorm(words.y).x) * head.most;
}

// What map `map` of the facet says at a place that stands for `area` of (s, t); `otherwise` where there is none.
fn map_at(row: u32, map: u32, place: vec2<f32>, area: f32, otherwise: vec3<f32>) -> vec3<f32> {
    let first = points[row + MAP_ROWS + 2u * map];
    let along = points[row + MAP_ROWS + 2u * map + 1u];
    let number = bitcast<u32>(first.x);
    if (number == 0u) {
        return otherwise;
    }
    let head = head_of(number - 1u);
    if (head.level_count == 0u) {
        return otherwise;
    }
    let texels = sqrt(abs((along.x * along.w - along.y * along.z) * area));
    let level = select(min(u32(log2(max(texels, 1.0))), head.level_count - 1u), 0u, head.steps);
    let words = bitcast<vec4<u32>>(fixed[head.levels + 2u * level]);
    let size = vec2<i32>(words.xy);
    let scale = vec2<f32>(size) / vec2<f32>(size_of(head, 0u));
    let at = (first.yz + along.xy * place.x + along.zw * place.y) * scale - 0.5;
    if (head.steps) {
        let k = vec2<i32>(floor(at + 0.5));
        return map_texel(head, words.z, size, k.x, k.y);
    }
    let k = vec2<i32>(floor(at));
    let w = at - floor(at);
    let upper = mix(map_texel(head, words.z, size, k.x, k.y), map_texel(head, words.z, size, k.x + 1, k.y), w.x);
    let lower = mix(map_texel(head, words.z, size, k.x, k.y + 1), map_texel(head, words.z, size, k.x + 1, k.y + 1), w.x);
    return mix(upper, lower, w.y);
}

// Means over the places: light of what no shadow falls on and of each lamp, luminance of base colour, what of all light is
// proportional to that, and of what it sends itself.
const MAP_LIGHTS: u32 = 1u + MOST_OWN;
var<private> map_light: array<f32, MAP_LIGHTS>;
var<private> map_base: f32;
var<private> map_proportional: f32;
var<private> map_glow: f32;

// Shades the facet whose rows begin at `row` and whose appearance is at `look`, seen from its front (1) or from behind (-1), at
// places of the parallelogram about `middle` of (s, t) with the sides `p` and `q`.
fn shade_places(row: u32, look: u32, side: f32, middle: vec2<f32>, p: vec2<f32>, q: vec2<f32>, u: f32) {
    let count = MAP_PLACES * MAP_PLACES;
    let area = abs(p.x * q.y - p.y * q.x) / f32(count);
    let material = points[row + MATERIAL_ROW];
    let emission = points[row + EMISSION_ROW];
    let lamps = lamp_count();
    let facet = geometry_at(row, u);
    let tangents = row + GEOMETRY_ROWS;
    let tangent_a = over_time(tangents, TANGENT_ROWS / 3u, u);
    let tangent_b = over_time(tangents + 1u, TANGENT_ROWS / 3u, u) - tangent_a;
    let tangent_d = over_time(tangents + 2u, TANGENT_ROWS / 3u, u) - tangent_a;
    let signs = vec3<f32>(points[tangents].w, points[tangents + 1u].w, points[tangents + 2u].w);
    let eye = over_time(base.points, 1u, u);
    spend(2u * MAP_LIGHTS + count * (1u + lamps));
    for (var k = 0u; k < MAP_LIGHTS; k++) {
        map_light[k] = 0.0;
    }
    map_base = 0.0;
    map_proportional = 0.0;
    map_glow = 0.0;
    for (var k = 0u; k < count; k++) {
        let step = (vec2<f32>(f32(k % MAP_PLACES), f32(k / MAP_PLACES)) + 0.5) / f32(MAP_PLACES) - 0.5;
        let place = middle + step.x * p + step.y * q;
        let surface = map_at(row, METALLIC_ROUGHNESS_MAP, place, area, vec3<f32>(1.0));
        let occluded = map_at(row, OCCLUSION_MAP, place, area, vec3<f32>(1.0)).x;
        let factor = kept[look].xyz + kept[look + 1u].xyz * place.x + kept[look + 2u].xyz * place.y;
        var point: LitPoint;
        point.position = position_at(facet, place);
        point.to_eye = way_to_eye(eye, point.position);
        point.base = factor * map_at(row, BASE_MAP, place, area, vec3<f32>(1.0));
        point.metallic = clamp(material.x * surface.z, 0.0, 1.0);
        point.roughness = clamp(material.y * surface.y, 0.0, 1.0);
        point.occlusion = 1.0 + material.w * (occluded - 1.0);
        point.diffuse = emission.w == 0.0;
        // Towards its front, until a map has turned it.
        var normal = normal_at(facet, place);
        let local = (2.0 * map_at(row, NORMAL_MAP, place, area, vec3<f32>(0.5, 0.5, 1.0)) - 1.0)
            * vec3<f32>(material.z, material.z, 1.0);
        let flat_tangent = tangent_a + tangent_b * place.x + tangent_d * place.y;
        let tangent = normalize_or(flat_tangent - normal * dot(normal, flat_tangent), vec3<f32>(0.0));
        if (any(tangent != vec3<f32>(0.0))) {
            let sign = signs.x + (signs.y - signs.x) * place.x + (signs.z - signs.x) * place.y;
            normal = normalize_or(tangent * local.x + cross(normal, tangent) * (sign * local.y) + normal * local.z, normal);
        }
        point.normal = normal * side;
        let around = lit_from_around(point);
        map_light[0] += around.x + around.y;
        map_proportional += around.x;
        for (var lamp = 0u; lamp < lamps; lamp++) {
            let own = own_of_lamp(lamp);
            let light = lit_by(point, lamp_now(lamp, u));
            map_light[own] += light.x + light.y;
            map_proportional += light.x;
        }
        map_base += luminance(point.base);
        map_glow += dot(emission.xyz, map_at(row, EMISSION_MAP, place, area, vec3<f32>(1.0)));
    }
    for (var k = 0u; k < MAP_LIGHTS; k++) {
        map_light[k] /= f32(count);
    }
    map_base /= f32(count);
    map_proportional /= f32(count);
    map_glow /= f32(count);
}
