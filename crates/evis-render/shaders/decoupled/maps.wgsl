#import decoupled/sky.wgsl
#import decoupled/texture.wgsl
#import common/luminance.wgsl
// Light of surfaces with normal, roughness, occlusion or emission maps: shaded at a grid of places of what a pixel sees. Twins:
// `shading/light/maps.rs`, `shading/places.rs`, `image/maps.rs` and `image/environment.rs` of evis-decoupled.

// Places along either side of a footprint.
const MAP_PLACES: u32 = 4u;

// Rows of a facet: nine per power of the block's time (positions at (s, t) = (0, 0), (1, 0), (0, 1), normals, tangents with the
// sign of the bitangent in w of the first), two per map (its texture's number plus 1 and its origin; its change along s and t),
// then numbers of its material, and where lamps are.
const GEOMETRY_ROWS: u32 = 9u;
const MAP_ROWS: u32 = 27u;
const MATERIAL_ROW: u32 = 37u;
const EMISSION_ROW: u32 = 38u;
const LIGHTS_ROW: u32 = 39u;
// Maps.
const BASE_MAP: u32 = 0u;
const NORMAL_MAP: u32 = 1u;
const METALLIC_ROUGHNESS_MAP: u32 = 2u;
const OCCLUSION_MAP: u32 = 3u;
const EMISSION_MAP: u32 = 4u;

// Rows of lights: the eye's place by power of time (1 in w of the first: its direction, that of parallel rays), then of each lamp
// its place (1 in w of the first: it has one), direction (w of the first: its range), strength (w of the first: its number among
// those whose light is kept apart, plus 1) by power of time, and the scale and shift of its cone (1 in z: it has one).
const EYE_ROWS: u32 = 3u;
const LIGHT_ROWS: u32 = 10u;

// Rows of light from all around: irradiance's first row and edge, levels of the reflection and the split sum's first row; the
// sine and cosine of the turn about +Y; ambient light; then each level's first row and edge. Rows count from the first of these.
const AROUND_LEVELS: u32 = 3u;
// Entries per side of the split sum, two in a row.
const SPLIT_SUM: u32 = 128u;

const PI: f32 = 3.141592653589793;
const LEAST_ALPHA: f32 = 0.002;
const LEAST_COSINE: f32 = 1e-4;
const NO_LENGTH: f32 = 1e-12;

fn over_time(row: u32, stride: u32, u: f32) -> vec3<f32> {
    return points[row].xyz + u * (points[row + stride].xyz + u * points[row + 2u * stride].xyz);
}

fn normalize_or(v: vec3<f32>, other: vec3<f32>) -> vec3<f32> {
    let size = length(v);
    return select(other, v / max(size, NO_LENGTH), size > NO_LENGTH);
}

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

// Light of a level of light from all around in a direction.
fn around_at(level: vec2<u32>, direction: vec3<f32>) -> vec3<f32> {
    let around = cube_texels(cube_place(direction), level.y);
    let first = batch.around + level.x + around.first;
    let upper = mix(fixed[first].xyz, fixed[first + 1u].xyz, around.w.x);
    let lower = mix(fixed[first + around.row].xyz, fixed[first + around.row + 1u].xyz, around.w.x);
    return mix(upper, lower, around.w.y);
}

fn turned_around(v: vec3<f32>) -> vec3<f32> {
    let turn = fixed[batch.around + 1u];
    return vec3<f32>(turn.y * v.x + turn.x * v.z, v.y, turn.y * v.z - turn.x * v.x);
}

fn around_level(level: u32) -> vec2<u32> {
    return bitcast<vec4<u32>>(fixed[batch.around + AROUND_LEVELS + level]).xy;
}

fn split_sum_entry(x: u32, y: u32) -> vec2<f32> {
    let number = y * SPLIT_SUM + x;
    let both = fixed[batch.around + bitcast<vec4<u32>>(fixed[batch.around]).w + number / 2u];
    return select(both.xy, both.zw, number % 2u == 1u);
}

// Scale and bias of F0 under light from all around.
fn split_sum(n_dot_v: f32, roughness: f32) -> vec2<f32> {
    let at = clamp(vec2<f32>(n_dot_v, roughness) * f32(SPLIT_SUM) - 0.5, vec2<f32>(0.0), vec2<f32>(f32(SPLIT_SUM) - 1.0));
    let low = min(vec2<u32>(at), vec2<u32>(SPLIT_SUM - 2u));
    let w = at - vec2<f32>(low);
    let upper = mix(split_sum_entry(low.x, low.y), split_sum_entry(low.x + 1u, low.y), w.x);
    let lower = mix(split_sum_entry(low.x, low.y + 1u), split_sum_entry(low.x + 1u, low.y + 1u), w.x);
    return mix(upper, lower, w.y);
}

// A point to be lit.
struct MapPoint {
    position: vec3<f32>,
    normal: vec3<f32>,
    to_eye: vec3<f32>,
    base: vec3<f32>,
    metallic: f32,
    roughness: f32,
    occlusion: f32,
    // Whether it has no highlights.
    diffuse: bool,
};

// Luminance: x what is proportional to base colour, y what is not.
fn mixed(point: MapPoint, diffuse: vec3<f32>, specular: vec3<f32>, f: f32, g: f32) -> vec2<f32> {
    let m = point.metallic;
    let dielectric = 0.04 * (1.0 - m);
    let constant = 1.0 - f * dielectric - g;
    let linear = diffuse * ((1.0 - m) * constant - (1.0 - m) * m * f * point.base) + specular * (m * f);
    return vec2<f32>(luminance(linear * point.base), luminance(specular) * (f * dielectric + g));
}

fn lit_from_around(point: MapPoint) -> vec2<f32> {
    let head = bitcast<vec4<u32>>(fixed[batch.around]);
    let ambient = fixed[batch.around + 2u].xyz * point.occlusion;
    var irradiance = vec3<f32>(0.0);
    if (head.z > 0u) {
        irradiance = around_at(head.xy, turned_around(point.normal)) * point.occlusion;
    }
    if (point.diffuse) {
        return vec2<f32>(luminance((ambient + irradiance) * point.base), 0.0);
    }
    var sum = vec2<f32>(luminance(ambient * point.base), luminance(ambient) * 0.04 * (1.0 - point.metallic));
    if (head.z > 0u) {
        let n_dot_v = max(dot(point.normal, point.to_eye), LEAST_COSINE);
        let split = split_sum(n_dot_v, point.roughness);
        let mirror = normalize_or(2.0 * dot(point.normal, point.to_eye) * point.normal - point.to_eye, point.normal);
        let level = clamp(point.roughness, 0.0, 1.0) * f32(head.z - 1u);
        let lower = u32(level);
        let direction = turned_around(mirror);
        let reflected = mix(
            around_at(around_level(lower), direction),
            around_at(around_level(min(lower + 1u, head.z - 1u)), direction),
            level - f32(lower),
        );
        sum += mixed(point, irradiance, reflected * point.occlusion, split.x, split.y);
    }
    return sum;
}

fn lit_by(point: MapPoint, row: u32, u: f32) -> vec2<f32> {
    let strength = over_time(row + 6u, 1u, u);
    let toward = normalize_or(over_time(row + 3u, 1u, u), vec3<f32>(0.0, 0.0, -1.0));
    var to_light = -toward;
    var irradiance = strength;
    if (points[row].w > 0.0) {
        let offset = over_time(row, 1u, u) - point.position;
        let squared = dot(offset, offset);
        to_light = normalize_or(offset, -toward);
        // KHR_lights_punctual, "Range Property".
        let range = points[row + 3u].w;
        let part = squared / max(range * range, 1e-30);
        var attenuation = select(1.0, clamp(1.0 - part * part, 0.0, 1.0), range > 0.0) / max(squared, 1e-6);
        let cone = points[row + 9u];
        if (cone.z > 0.0) {
            let angular = clamp(cone.x * dot(-toward, to_light) + cone.y, 0.0, 1.0);
            attenuation *= angular * angular;
        }
        irradiance = strength * attenuation;
    }
    let n_dot_l = dot(point.normal, to_light);
    if (n_dot_l <= 0.0) {
        return vec2<f32>(0.0);
    }
    let light = irradiance * n_dot_l;
    if (point.diffuse) {
        return vec2<f32>(luminance(light * point.base) / PI, 0.0);
    }
    // glTF 2.0, appendix B.3; height-correlated masking (E. Heitz, JCGT 2014).
    let half_way = normalize_or(point.to_eye + to_light, point.normal);
    let n_dot_h = max(dot(point.normal, half_way), 0.0);
    let n_dot_v = max(dot(point.normal, point.to_eye), LEAST_COSINE);
    let alpha = max(point.roughness * point.roughness, LEAST_ALPHA);
    let alpha2 = alpha * alpha;
    // 1 - n_dot_h^2, which cancels where a highlight is: by the difference of the vectors.
    let off = half_way - point.normal;
    let sine2 = select(1.0, dot(off, off) * (1.0 - 0.25 * dot(off, off)), n_dot_h > 0.0);
    let narrow = alpha2 + sine2 * (1.0 - alpha2);
    let distribution = alpha2 / (PI * narrow * narrow);
    let masked_l = n_dot_l * sqrt(n_dot_v * n_dot_v * (1.0 - alpha2) + alpha2);
    let masked_v = n_dot_v * sqrt(n_dot_l * n_dot_l * (1.0 - alpha2) + alpha2);
    let visibility = 0.5 / (masked_l + masked_v);
    let grazing = pow(1.0 - clamp(dot(point.to_eye, half_way), 0.0, 1.0), 5.0);
    return mixed(point, light / PI, light * (distribution * visibility), 1.0 - grazing, grazing);
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
    let numbers = bitcast<vec4<u32>>(points[row + LIGHTS_ROW]);
    let lights = base.points + numbers.x;
    let a = over_time(row, GEOMETRY_ROWS, u);
    let b = over_time(row + 1u, GEOMETRY_ROWS, u) - a;
    let d = over_time(row + 2u, GEOMETRY_ROWS, u) - a;
    let normal_a = over_time(row + 3u, GEOMETRY_ROWS, u);
    let normal_b = over_time(row + 4u, GEOMETRY_ROWS, u) - normal_a;
    let normal_d = over_time(row + 5u, GEOMETRY_ROWS, u) - normal_a;
    let tangent_a = over_time(row + 6u, GEOMETRY_ROWS, u);
    let tangent_b = over_time(row + 7u, GEOMETRY_ROWS, u) - tangent_a;
    let tangent_d = over_time(row + 8u, GEOMETRY_ROWS, u) - tangent_a;
    let signs = vec3<f32>(points[row + 6u].w, points[row + 7u].w, points[row + 8u].w);
    let eye = over_time(lights, 1u, u);
    let parallel = points[lights].w > 0.0;
    spend(2u * MAP_LIGHTS + count * (1u + numbers.y));
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
        let position = a + b * place.x + d * place.y;
        var point: MapPoint;
        point.position = position;
        point.to_eye = normalize_or(select(eye - position, -eye, parallel), vec3<f32>(0.0, 0.0, 1.0));
        point.base = factor * map_at(row, BASE_MAP, place, area, vec3<f32>(1.0));
        point.metallic = clamp(material.x * surface.z, 0.0, 1.0);
        point.roughness = clamp(material.y * surface.y, 0.0, 1.0);
        point.occlusion = 1.0 + material.w * (occluded - 1.0);
        point.diffuse = emission.w == 0.0;
        // Towards its front, until a map has turned it.
        var normal = normalize_or(normal_a + normal_b * place.x + normal_d * place.y, vec3<f32>(0.0, 0.0, 1.0));
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
        for (var lamp = 0u; lamp < numbers.y; lamp++) {
            let at = lights + EYE_ROWS + LIGHT_ROWS * lamp;
            let light = lit_by(point, at, u);
            let own = bitcast<u32>(points[at + 6u].w);
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
