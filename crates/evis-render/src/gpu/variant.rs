//! In what surface pipelines differ, and the vertex interface generated from it.

use std::fmt::Write as _;

use evis_scene::{AlphaMode, LightKind, Material, Primitive, Scene, ShadingModel, TextureRef};

/// Vertex attributes, in the order of their shader locations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attribute {
    /// vec3.
    Position,
    /// vec3.
    Normal,
    /// vec2.
    Uv0,
    /// vec2.
    Uv1,
    /// vec4, linear.
    Color,
    /// vec4, w is the bitangent's sign.
    Tangent,
    /// 4 x u16.
    Joints,
    /// vec4.
    JointWeights,
}

impl Attribute {
    /// All attributes; the position in this list is the shader location.
    pub const ALL: [Self; 8] = [
        Self::Position,
        Self::Normal,
        Self::Uv0,
        Self::Uv1,
        Self::Color,
        Self::Tangent,
        Self::Joints,
        Self::JointWeights,
    ];

    /// Vertex buffer slot: joints and their weights share one, so that the instances' slot is the eighth and last
    /// that every device has.
    pub const fn slot(self) -> usize {
        match self {
            Self::JointWeights => Self::Joints as usize,
            other => other as usize,
        }
    }

    /// Bytes from the start of a vertex in its slot.
    pub const fn offset(self) -> u64 {
        match self {
            Self::JointWeights => Self::Joints.format().size(),
            _ => 0,
        }
    }

    /// Vertex format.
    pub const fn format(self) -> wgpu::VertexFormat {
        match self {
            Self::Position | Self::Normal => wgpu::VertexFormat::Float32x3,
            Self::Uv0 | Self::Uv1 => wgpu::VertexFormat::Float32x2,
            Self::Color | Self::Tangent | Self::JointWeights => wgpu::VertexFormat::Float32x4,
            Self::Joints => wgpu::VertexFormat::Uint16x4,
        }
    }

    const fn wgsl(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Position => ("position", "vec3<f32>", "vec3<f32>(0.0)"),
            Self::Normal => ("normal", "vec3<f32>", "vec3<f32>(0.0, 0.0, 1.0)"),
            Self::Uv0 => ("uv0", "vec2<f32>", "vec2<f32>(0.0)"),
            Self::Uv1 => ("uv1", "vec2<f32>", "vec2<f32>(0.0)"),
            Self::Color => ("color", "vec4<f32>", "vec4<f32>(1.0)"),
            Self::Tangent => ("tangent", "vec4<f32>", "vec4<f32>(1.0, 0.0, 0.0, 1.0)"),
            Self::Joints => ("joints", "vec4<u32>", "vec4<u32>(0u)"),
            Self::JointWeights => ("joint_weights", "vec4<f32>", "vec4<f32>(1.0, 0.0, 0.0, 0.0)"),
        }
    }
}

/// A surface pipeline's variant: what its material and mesh need, nothing else.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SurfaceVariant {
    /// 0 unlit, 1 Lambert, 2 metallic-roughness.
    pub model: u32,
    /// Base colour texture.
    pub base_texture: bool,
    /// Metallic-roughness texture.
    pub metallic_roughness_texture: bool,
    /// Normal map.
    pub normal_texture: bool,
    /// Occlusion texture.
    pub occlusion_texture: bool,
    /// Emissive texture.
    pub emissive_texture: bool,
    /// Some texture uses the second uv set.
    pub uv1: bool,
    /// Some texture is read elsewhere than at the first uv set as it is.
    pub uv_transform: bool,
    /// Vertex colours.
    pub color: bool,
    /// Skin.
    pub skinned: bool,
    /// Morph targets.
    pub morphed: bool,
    /// Alpha mask.
    pub mask: bool,
    /// Back faces are drawn.
    pub double_sided: bool,
    /// The node's transform mirrors: its front faces wind the other way.
    pub mirrored: bool,
    /// Emission varies in time.
    pub emission_waveform: bool,
    /// A host changes the material's factors.
    pub driven: bool,
}

impl SurfaceVariant {
    /// The variant that draws `primitive` with `material`.
    pub fn new(material: &Material, primitive: &Primitive, skinned: bool, mirrored: bool) -> Self {
        let lit = material.model != ShadingModel::Unlit;
        let physical = material.model == ShadingModel::MetallicRoughness;
        let has_uv = |set: u32| primitive.uvs[set as usize & 1].is_some();
        let usable = |texture: &Option<evis_scene::TextureRef>| texture.is_some_and(|t| has_uv(t.uv_set));
        let textures = [
            &material.base_color_texture,
            &material.metallic_roughness_texture,
            &material.normal_texture,
            &material.occlusion_texture,
            &material.emissive_texture,
        ];
        Self {
            model: match material.model {
                ShadingModel::Unlit => 0,
                ShadingModel::Diffuse => 1,
                ShadingModel::MetallicRoughness => 2,
            },
            base_texture: usable(&material.base_color_texture),
            metallic_roughness_texture: physical && usable(&material.metallic_roughness_texture),
            normal_texture: lit && usable(&material.normal_texture) && primitive.tangents.is_some(),
            occlusion_texture: lit && usable(&material.occlusion_texture),
            emissive_texture: lit && usable(&material.emissive_texture),
            uv1: textures.iter().any(|t| t.is_some_and(|t| t.uv_set == 1)) && has_uv(1),
            uv_transform: textures.iter().any(|t| t.is_some_and(|t| t != TextureRef::new(t.texture))),
            color: primitive.colors.is_some(),
            skinned: skinned && primitive.joints.is_some() && primitive.joint_weights.is_some(),
            morphed: !primitive.morph_targets.is_empty(),
            mask: matches!(material.alpha, AlphaMode::Mask(_)),
            double_sided: material.double_sided,
            mirrored,
            emission_waveform: material.emission_waveform.is_some(),
            driven: material.driven,
        }
    }

    /// Whether the surface answers light.
    pub const fn lit(&self) -> bool {
        self.model != 0
    }

    /// Whether any texture is read.
    pub const fn textured(&self) -> bool {
        self.base_texture
            || self.metallic_roughness_texture
            || self.normal_texture
            || self.occlusion_texture
            || self.emissive_texture
    }
}

/// Slot of the per-instance matrices.
pub const INSTANCE_SLOT: usize = 7;

/// First shader location of the per-instance matrices: four columns, then three rows.
pub const INSTANCE_LOCATION: u32 = 8;

/// Vectors of `InstanceRecord`.
pub const INSTANCE_VECTORS: u32 = 7;

/// What a pass asks of the vertex stage beyond the variant's shading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Interface {
    /// World normals are written as a label, also of unlit surfaces.
    pub normal_label: bool,
    /// Whether surfaces are shaded; else only position is needed, and what an alpha mask reads.
    pub shades: bool,
}

/// Attributes that `variant` fetches under `interface`.
pub fn attributes(variant: &SurfaceVariant, interface: Interface) -> Vec<Attribute> {
    Attribute::ALL
        .into_iter()
        .filter(|a| match a {
            Attribute::Position => true,
            Attribute::Normal => interface.shades && (variant.lit() || interface.normal_label),
            Attribute::Uv0 => variant.textured() && (interface.shades || variant.mask),
            Attribute::Uv1 => variant.uv1 && (interface.shades || variant.mask),
            Attribute::Color => variant.color && (interface.shades || variant.mask),
            Attribute::Tangent => variant.normal_texture && interface.shades,
            Attribute::Joints | Attribute::JointWeights => variant.skinned,
        })
        .collect()
}

/// WGSL declarations that every shader reading a `Frame` needs.
pub fn frame_prelude(light_count: u32) -> String {
    format!("const LIGHT_CAPACITY: u32 = {}u;\n", light_count.max(1))
}

/// Up to this many lights are summed without a loop: a uniform at a constant index is read once for all lanes by
/// software drivers, which unroll no loop of this size themselves.
const UNROLLED_LIGHTS: u32 = 16;

/// The scene's lights, as far as shaders are made for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightSet {
    /// Lights.
    pub count: u32,
    /// Kind and shadow layer (-1 for none) of the first ones, as in the device's records.
    known: [(u8, i8); UNROLLED_LIGHTS as usize],
    /// Whether shading asks where a surface point is, not only how it is turned.
    positional: bool,
}

impl LightSet {
    /// Of `scene`, whose light at node n throws a shadow into `layer_of(n)`.
    pub fn new(scene: &Scene, layer_of: impl Fn(usize) -> Option<u32>) -> Self {
        Self::of(scene.nodes.iter().enumerate().filter_map(|(index, node)| {
            let kind = light_kind(&scene.lights[node.light?].kind);
            Some((kind, layer_of(index).map_or(-1, |layer| layer as i8)))
        }))
    }

    /// Of lights of these kinds and shadow layers.
    pub fn of(lights: impl IntoIterator<Item = (u8, i8)>) -> Self {
        let mut set = Self::default();
        for (kind, layer) in lights {
            if let Some(slot) = set.known.get_mut(set.count as usize) {
                *slot = (kind, layer);
            }
            set.positional |= kind != 0 || layer >= 0 || set.count >= UNROLLED_LIGHTS;
            set.count += 1;
        }
        set
    }
}

/// 0 directional, 1 point, 2 spot.
pub const fn light_kind(kind: &LightKind) -> u8 {
    match kind {
        LightKind::Directional => 0,
        LightKind::Point => 1,
        LightKind::Spot { .. } => 2,
    }
}

/// WGSL sums over all lights. Each has its kind, and whether it throws shadows, as constants: software drivers run
/// both sides of a branch.
fn light_sums(lights: &LightSet) -> String {
    let light_count = lights.count;
    let mut out = String::from(
        "fn of_kind(light: Light, kind: f32, shadow_layer: f32) -> Light {\n    \
         var known = light;\n    known.position_kind.w = kind;\n    \
         known.radiance_shadow.w = shadow_layer;\n    return known;\n}\n",
    );
    for model in ["diffuse", "metallic_roughness"] {
        let _ = writeln!(out, "fn lit_{model}(s: Surface) -> vec3<f32> {{\n    var sum = vec3<f32>(0.0);");
        if light_count <= UNROLLED_LIGHTS {
            for (i, (kind, layer)) in lights.known.iter().enumerate().take(light_count as usize) {
                let light = format!("of_kind(frame.lights[{i}], {kind}.0, {layer}.0)");
                let _ = writeln!(out, "    sum += light_{model}({light}, s);");
            }
        } else {
            let _ = writeln!(
                out,
                "    for (var i = 0u; i < LIGHT_CAPACITY; i++) {{\n        \
                 sum += light_{model}(frame.lights[i], s);\n    }}"
            );
        }
        out.push_str("    return sum;\n}\n");
    }
    out
}

/// WGSL declarations of `VertexIn`, `Varyings` and their accessors: an attribute that the variant does not use
/// is neither fetched nor interpolated, its accessor returns a constant.
pub fn prelude(variant: &SurfaceVariant, interface: Interface, lights: &LightSet) -> String {
    let used = attributes(variant, interface);
    let has = |a: Attribute| used.contains(&a);
    let mut out = frame_prelude(lights.count);
    if interface.shades {
        let none = LightSet::default();
        out.push_str(&light_sums(if variant.lit() { lights } else { &none }));
    }
    out.push_str("struct VertexIn {\n");
    for (location, a) in Attribute::ALL.iter().enumerate().filter(|(_, a)| has(**a)) {
        let (name, kind, _) = a.wgsl();
        let _ = writeln!(out, "    @location({location}) {name}: {kind},");
    }
    for i in 0..INSTANCE_VECTORS {
        let _ = writeln!(out, "    @location({}) instance_{i}: vec4<f32>,", INSTANCE_LOCATION + i);
    }
    out.push_str("};\n");
    out.push_str(
        "fn input_clip(v: VertexIn) -> mat4x4<f32> {\n    \
         return mat4x4<f32>(v.instance_0, v.instance_1, v.instance_2, v.instance_3);\n}\n\
         fn input_instance(v: VertexIn) -> InstanceRecord {\n    \
         return InstanceRecord(input_clip(v), v.instance_4, v.instance_5, v.instance_6);\n}\n",
    );
    for a in Attribute::ALL {
        let (name, kind, default) = a.wgsl();
        let value = if has(a) { format!("v.{name}") } else { default.to_owned() };
        let _ = writeln!(out, "fn input_{name}(v: VertexIn) -> {kind} {{ return {value}; }}");
    }

    let normal = has(Attribute::Normal);
    let shading = interface.shades;
    // (name, type, qualifier, value in the vertex stage, default, used)
    let varyings = [
        ("uv0", "vec2<f32>", "", "input_uv0(in)", "vec2<f32>(0.0)", has(Attribute::Uv0)),
        ("uv1", "vec2<f32>", "", "input_uv1(in)", "vec2<f32>(0.0)", has(Attribute::Uv1)),
        ("color", "vec4<f32>", "", "input_color(in)", "vec4<f32>(1.0)", has(Attribute::Color)),
        (
            "normal",
            "vec3<f32>",
            "",
            "world_normal(input_instance(in), local.normal)",
            "vec3<f32>(0.0, 0.0, 1.0)",
            normal,
        ),
        (
            "world",
            "vec3<f32>",
            "",
            "world_from_object(input_instance(in), local.position)",
            "vec3<f32>(0.0)",
            shading && variant.lit() && (lights.positional || variant.model == 2),
        ),
        (
            "tangent",
            "vec4<f32>",
            "",
            "world_tangent(input_instance(in), local.tangent)",
            "vec4<f32>(1.0, 0.0, 0.0, 1.0)",
            has(Attribute::Tangent),
        ),
        (
            "emission_factor",
            "f32",
            "@interpolate(flat) ",
            "objects[instance].emission_factor",
            "1.0",
            shading && variant.emission_waveform,
        ),
        (
            "base_metallic",
            "vec4<f32>",
            "@interpolate(flat) ",
            "objects[instance].base_metallic",
            "vec4<f32>(0.0)",
            shading && variant.driven,
        ),
        (
            "emissive_roughness",
            "vec4<f32>",
            "@interpolate(flat) ",
            "objects[instance].emissive_roughness",
            "vec4<f32>(0.0)",
            shading && variant.driven,
        ),
    ];
    out.push_str("struct Varyings {\n    @builtin(position) position: vec4<f32>,\n");
    for (location, (name, kind, qualifier, .., used)) in varyings.iter().enumerate() {
        if *used {
            let _ = writeln!(out, "    @location({location}) {qualifier}{name}: {kind},");
        }
    }
    out.push_str("};\n");
    for (name, kind, _, _, default, used) in &varyings {
        let value = if *used { format!("v.{name}") } else { (*default).to_owned() };
        let _ = writeln!(out, "fn vary_{name}(v: Varyings) -> {kind} {{ return {value}; }}");
    }
    out.push_str(
        "fn set_varyings(instance: u32, in: VertexIn, local: LocalVertex, clip: vec4<f32>) -> Varyings {\n    \
         var out: Varyings;\n    out.position = clip;\n",
    );
    for (name, _, _, value, _, used) in &varyings {
        if *used {
            let _ = writeln!(out, "    out.{name} = {value};");
        }
    }
    out.push_str("    return out;\n}\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lit(model: u32, lights: &LightSet) -> String {
        let variant = SurfaceVariant { model, ..Default::default() };
        prelude(&variant, Interface { shades: true, ..Default::default() }, lights)
    }

    #[test]
    fn a_world_position_is_interpolated_only_where_light_asks_for_it() {
        let asks = |model, kinds: &[u8], shadows| {
            let layer = if shadows { 0 } else { -1 };
            lit(model, &LightSet::of(kinds.iter().map(|&kind| (kind, layer)))).contains("out.world =")
        };
        assert!(!asks(1, &[0, 0], false), "sunlight is the same everywhere");
        assert!(!asks(0, &[1], false), "unlit");
        assert!(asks(2, &[0], false), "highlights need the direction to the eye");
        assert!(asks(1, &[0], true), "shadows");
        assert!(asks(1, &[0, 1], false), "point light");
        assert!(asks(1, &[0; UNROLLED_LIGHTS as usize + 1], false), "kinds are not known beyond these");
    }

    #[test]
    fn each_light_is_told_its_own_kind_and_shadow() {
        let text = lit(1, &LightSet::of([(0, -1), (2, 1), (1, -1)]));
        for (i, kind, layer) in [(0, 0, -1), (1, 2, 1), (2, 1, -1)] {
            assert!(text.contains(&format!("of_kind(frame.lights[{i}], {kind}.0, {layer}.0)")), "{text}");
        }
    }
}
