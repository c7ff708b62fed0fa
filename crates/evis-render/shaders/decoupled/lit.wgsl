#import decoupled/sky.wgsl
#import common/luminance.wgsl
// Light that points of facets send: glTF 2.0 metallic-roughness. Twins: `shading/places.rs` and `image/environment.rs` of evis-decoupled.

// Rows of a facet: by power of the block's time positions at (s, t) = (0, 0), (1, 0) and (0, 1), then normals.
const GEOMETRY_ROWS: u32 = 18u;
const POWER_ROWS: u32 = GEOMETRY_ROWS / 3u;

// Rows of lights, the first of a row's points: the eye's place by power of time (1 in w of the first: its direction, that of parallel
// rays; in w of the second: how many lamps there are), then of each lamp
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

// A facet at a time: positions and normals at (s, t) = (0, 0), and their change with s and t.
struct Geometry {
    position: vec3<f32>,
    position_s: vec3<f32>,
    position_t: vec3<f32>,
    normal: vec3<f32>,
    normal_s: vec3<f32>,
    normal_t: vec3<f32>,
};

fn geometry_at(row: u32, u: f32) -> Geometry {
    let position = over_time(row, POWER_ROWS, u);
    let normal = over_time(row + 3u, POWER_ROWS, u);
    return Geometry(
        position,
        over_time(row + 1u, POWER_ROWS, u) - position,
        over_time(row + 2u, POWER_ROWS, u) - position,
        normal,
        over_time(row + 4u, POWER_ROWS, u) - normal,
        over_time(row + 5u, POWER_ROWS, u) - normal,
    );
}

fn position_at(facet: Geometry, place: vec2<f32>) -> vec3<f32> {
    return facet.position + facet.position_s * place.x + facet.position_t * place.y;
}

fn normal_at(facet: Geometry, place: vec2<f32>) -> vec3<f32> {
    return normalize_or(facet.normal + facet.normal_s * place.x + facet.normal_t * place.y, vec3<f32>(0.0, 0.0, 1.0));
}

fn lamp_count() -> u32 {
    return bitcast<u32>(points[base.points + 1u].w);
}

// Its number among those whose light is kept apart, plus 1.
fn own_of_lamp(lamp: u32) -> u32 {
    return bitcast<u32>(points[base.points + EYE_ROWS + LIGHT_ROWS * lamp + 6u].w);
}

// The direction from a position to `eye`, which is that of parallel rays, maybe.
fn way_to_eye(eye: vec3<f32>, position: vec3<f32>) -> vec3<f32> {
    return normalize_or(select(eye - position, -eye, points[base.points].w > 0.0), vec3<f32>(0.0, 0.0, 1.0));
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
struct LitPoint {
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
fn mixed(point: LitPoint, diffuse: vec3<f32>, specular: vec3<f32>, f: f32, g: f32) -> vec2<f32> {
    let m = point.metallic;
    let dielectric = 0.04 * (1.0 - m);
    let constant = 1.0 - f * dielectric - g;
    let linear = diffuse * ((1.0 - m) * constant - (1.0 - m) * m * f * point.base) + specular * (m * f);
    return vec2<f32>(luminance(linear * point.base), luminance(specular) * (f * dielectric + g));
}

fn lit_from_around(point: LitPoint) -> vec2<f32> {
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

// A lamp at a time.
struct LampNow {
    position: vec3<f32>,
    // Against its axis.
    back: vec3<f32>,
    strength: vec3<f32>,
    has_place: bool,
    range: f32,
    // Scale and shift of its cone; 1 if it has one.
    cone: vec3<f32>,
};

fn lamp_now(lamp: u32, u: f32) -> LampNow {
    let row = base.points + EYE_ROWS + LIGHT_ROWS * lamp;
    let toward = normalize_or(over_time(row + 3u, 1u, u), vec3<f32>(0.0, 0.0, -1.0));
    return LampNow(
        over_time(row, 1u, u),
        -toward,
        over_time(row + 6u, 1u, u),
        points[row].w > 0.0,
        points[row + 3u].w,
        points[row + 9u].xyz,
    );
}

// What a point sends of a lamp's light if nothing is in between.
fn lit_by(point: LitPoint, lamp: LampNow) -> vec2<f32> {
    var to_light = lamp.back;
    var irradiance = lamp.strength;
    if (lamp.has_place) {
        let offset = lamp.position - point.position;
        let squared = dot(offset, offset);
        to_light = normalize_or(offset, lamp.back);
        // KHR_lights_punctual, "Range Property".
        let part = squared / max(lamp.range * lamp.range, 1e-30);
        var attenuation = select(1.0, clamp(1.0 - part * part, 0.0, 1.0), lamp.range > 0.0) / max(squared, 1e-6);
        if (lamp.cone.z > 0.0) {
            let angular = clamp(lamp.cone.x * dot(lamp.back, to_light) + lamp.cone.y, 0.0, 1.0);
            attenuation *= angular * angular;
        }
        irradiance *= attenuation;
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
