// Material constants and textures. Twin of the struct: gpu/uniforms.rs, MaterialUniform.
struct Material {
    base_color: vec4<f32>,
    // rgb: emitted radiance; w: alpha cutoff.
    emissive: vec4<f32>,
    // metallic, roughness, normal scale, occlusion strength.
    factors: vec4<f32>,
    // Two rows of a 2x3 matrix per texture: base color, metallic-roughness, normal, occlusion, emissive.
    // w of a first row: which uv set.
    uv_rows: array<vec4<f32>, 10>,
};

override HAS_BASE_TEXTURE: bool = false;
override HAS_METALLIC_ROUGHNESS_TEXTURE: bool = false;
override HAS_NORMAL_TEXTURE: bool = false;
override HAS_OCCLUSION_TEXTURE: bool = false;
override HAS_EMISSIVE_TEXTURE: bool = false;
override ALPHA_MASK: bool = false;
// Whether a host changes factors: then they come with the object.
override DRIVEN_FACTORS: bool = false;
// Whether any texture is read elsewhere than at the first uv set as it is.
override UV_TRANSFORM: bool = true;
// Smaller shares, by which a sample reads a texture at one place; see texture_samples() in pass/raster.rs.
override TEXTURE_SAMPLES: f32 = 1.0;
// Places at which a sample reads such a texture, at most, along each side of its share.
override TEXTURE_TAPS: f32 = 2.0;
// Pixels of the picture that is drawn, along each side of a pixel of the sensor.
override GRID: u32 = 1;

@group(1) @binding(0) var<uniform> material: Material;
@group(1) @binding(1) var base_texture: texture_2d<f32>;
@group(1) @binding(2) var base_sampler: sampler;
@group(1) @binding(3) var metallic_roughness_texture: texture_2d<f32>;
@group(1) @binding(4) var metallic_roughness_sampler: sampler;
@group(1) @binding(5) var normal_texture: texture_2d<f32>;
@group(1) @binding(6) var normal_sampler: sampler;
@group(1) @binding(7) var occlusion_texture: texture_2d<f32>;
@group(1) @binding(8) var occlusion_sampler: sampler;
@group(1) @binding(9) var emissive_texture: texture_2d<f32>;
@group(1) @binding(10) var emissive_sampler: sampler;

fn material_uv(v: Varyings, slot: u32) -> vec2<f32> {
    if (!UV_TRANSFORM) {
        return vary_uv0(v);
    }
    let row0 = material.uv_rows[slot * 2u];
    let row1 = material.uv_rows[slot * 2u + 1u];
    let uv = vec3<f32>(select(vary_uv0(v), vary_uv1(v), row0.w > 0.5), 1.0);
    return vec2<f32>(dot(row0.xyz, uv), dot(row1.xyz, uv));
}

// Level of detail at which a sample reads a texture of `size` texels. It stands for its share of the
// pixel's footprint, area for area: by the longer axis alone, as fixed-function sampling chooses, a surface seen at a slant
// would lose along the shorter one what the samples resolve. As many places along the longer axis need no finer level.
// Twin: evis_truth::rays::TextureFilter::Mipmapped.
fn texture_level(uv: vec2<f32>, size: vec2<u32>) -> f32 {
    let dx = dpdxFine(uv) * vec2<f32>(size);
    let dy = dpdyFine(uv) * vec2<f32>(size);
    let area = abs(dx.x * dy.y - dx.y * dy.x);
    let longer = max(dot(dx, dx), dot(dy, dy));
    // Off 0, where log2 is not defined: magnified beyond any level.
    return 0.5 * log2(max(max(area / TEXTURE_SAMPLES, longer / (TEXTURE_SAMPLES * TEXTURE_SAMPLES)), 1e-12));
}

// Where a sample reads a texture that light is proportional to: on a grid over its share of the pixel's footprint, as fine
// as texels are.
struct Taps {
    first: vec2<f32>,
    // From one to the next, along the picture's rows and columns.
    right: vec2<f32>,
    down: vec2<f32>,
    columns: u32,
    rows: u32,
    // What the grid is too coarse for, a mip level averages: one, a texel of which is no larger than from place to place.
    level: f32,
};

// From a place of the grid to where it reads what is sharper than the grid: in a row and a column of its own.
fn turned(at: vec2<f32>) -> vec2<f32> {
    let cell = (vec2<f32>(vec2<u32>(at) % GRID) + 0.5) / f32(GRID) - 0.5;
    return vec2<f32>(cell.y, -cell.x);
}

// Twin: evis_truth::rays::texture, taps(). `at`: place in the picture.
fn texture_taps(uv: vec2<f32>, size: vec2<u32>, at: vec2<f32>) -> Taps {
    let pixel_x = dpdxFine(uv);
    let pixel_y = dpdyFine(uv);
    let dx = pixel_x * share.size.x;
    let dy = pixel_y * share.size.y;
    let texels = vec2<f32>(length(dx * vec2<f32>(size)), length(dy * vec2<f32>(size)));
    // Along texels of half a share and more one reading would miss where light bends between them: two at least.
    let count = clamp(max(ceil(texels), min(ceil(2.0 * texels), vec2<f32>(2.0))), vec2<f32>(1.0), vec2<f32>(TEXTURE_TAPS));
    let apart = texels / count;
    // Where texels are larger than shares, light changes evenly over them: then samples, no two of which lie in one row or
    // column, tell the pixel's mean better than a grid of as many.
    let fine = clamp(2.0 * max(texels.x, texels.y) - 1.0, 0.0, 1.0);
    var shift = fine * share.shift;
    if (GRID > 1u) {
        // So it is with the places of a grid: each reads beside its middle, on a grid that is turned, and so in a row and a
        // column of its own.
        shift = (1.0 - fine) * turned(at);
    }
    let middle = uv + pixel_x * shift.x + pixel_y * shift.y;
    let first = middle - 0.5 * (dx + dy) + 0.5 * (dx / count.x + dy / count.y);
    // Off 0, where log2 is not defined: magnified beyond any level. A blend of two levels would read twice as many texels, the
    // coarser ones wider than the places are apart: it blurs.
    let level = floor(log2(max(max(apart.x, apart.y), 1e-12)));
    return Taps(first, dx / count.x, dy / count.y, u32(count.x), u32(count.y), level);
}

fn texture_mean(image: texture_2d<f32>, filtering: sampler, uv: vec2<f32>, at: vec2<f32>) -> vec4<f32> {
    let taps = texture_taps(uv, textureDimensions(image), at);
    var sum = vec4<f32>(0.0);
    for (var row = 0u; row < taps.rows; row++) {
        for (var column = 0u; column < taps.columns; column++) {
            let at = taps.first + f32(column) * taps.right + f32(row) * taps.down;
            sum += textureSampleLevel(image, filtering, at, taps.level);
        }
    }
    return sum / f32(taps.rows * taps.columns);
}

// Factor of the base colour, and alpha.
fn base_factor(v: Varyings) -> vec4<f32> {
    if (DRIVEN_FACTORS) {
        return vec4<f32>(vary_base_metallic(v).rgb, material.base_color.a);
    }
    return material.base_color;
}

// `factor` * texture * vertex colour.
fn textured(v: Varyings, factor: vec4<f32>) -> vec4<f32> {
    var color = factor * vary_color(v);
    if (HAS_BASE_TEXTURE) {
        let uv = material_uv(v, 0u);
        if (ALPHA_MASK) {
            // A hole's border lies where the texture is cut, not where its mean is.
            color *= textureSampleLevel(
                base_texture, base_sampler, uv, texture_level(uv, textureDimensions(base_texture)));
        } else {
            color *= texture_mean(base_texture, base_sampler, uv, v.position.xy);
        }
    }
    return color;
}

// Linear base colour and alpha.
fn base_color(v: Varyings) -> vec4<f32> {
    return textured(v, base_factor(v));
}

// Alpha alone, which no host changes.
fn alpha(v: Varyings) -> f32 {
    return textured(v, material.base_color).a;
}

fn emitted(v: Varyings) -> vec3<f32> {
    var color = material.emissive.rgb;
    if (DRIVEN_FACTORS) {
        color = vary_emissive_roughness(v).rgb;
    }
    if (HAS_EMISSIVE_TEXTURE) {
        let uv = material_uv(v, 4u);
        color *= texture_mean(emissive_texture, emissive_sampler, uv, v.position.xy).rgb;
    }
    return color * vary_emission_factor(v);
}

// Metallic, perceptual roughness.
fn metallic_roughness(v: Varyings) -> vec2<f32> {
    var value = material.factors.xy;
    if (DRIVEN_FACTORS) {
        value = vec2<f32>(vary_base_metallic(v).w, vary_emissive_roughness(v).w);
    }
    if (HAS_METALLIC_ROUGHNESS_TEXTURE) {
        let uv = material_uv(v, 1u);
        let level = texture_level(uv, textureDimensions(metallic_roughness_texture));
        value *= textureSampleLevel(metallic_roughness_texture, metallic_roughness_sampler, uv, level).bg;
    }
    return vec2<f32>(clamp(value.x, 0.0, 1.0), clamp(value.y, 0.0, 1.0));
}

fn ambient_occlusion(v: Varyings) -> f32 {
    if (HAS_OCCLUSION_TEXTURE) {
        let uv = material_uv(v, 3u);
        let level = texture_level(uv, textureDimensions(occlusion_texture));
        let r = textureSampleLevel(occlusion_texture, occlusion_sampler, uv, level).r;
        return 1.0 + material.factors.w * (r - 1.0);
    }
    return 1.0;
}

// Unit normal of the surface in world space, facing the viewer; normal maps do not count.
fn surface_normal(v: Varyings, front: bool) -> vec3<f32> {
    let n = normalize(vary_normal(v));
    return select(-n, n, front);
}

// Unit normal in world space, facing the viewer.
fn shading_normal(v: Varyings, front: bool) -> vec3<f32> {
    var n = normalize(vary_normal(v));
    if (HAS_NORMAL_TEXTURE) {
        let t4 = vary_tangent(v);
        // A degenerate tangent (no uv gradient) leaves the geometric normal.
        let t_raw = t4.xyz - n * dot(n, t4.xyz);
        let length_squared = dot(t_raw, t_raw);
        if (length_squared > 1e-12) {
            let t = t_raw * inverseSqrt(length_squared);
            let b = cross(n, t) * t4.w;
            let uv = material_uv(v, 2u);
            let level = texture_level(uv, textureDimensions(normal_texture));
            let m = textureSampleLevel(normal_texture, normal_sampler, uv, level).xyz * 2.0 - 1.0;
            n = normalize(t * (m.x * material.factors.z) + b * (m.y * material.factors.z) + n * m.z);
        }
    }
    return select(-n, n, front);
}
