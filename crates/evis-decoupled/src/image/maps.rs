//! What a surface's normal, roughness, occlusion and emission maps say at a place.

use evis_scene::{Material, Primitive, TextureRef};
use glam::{DMat2, DVec2, Vec4};

use crate::fours::Four;
use crate::image::texture::{About, Textures};
use crate::packed;

/// The maps of a material beside that of its base colour, which counts as one of them where there are others.
#[derive(Clone, Debug)]
pub struct Maps {
    base: Option<TextureRef>,
    normal: Option<TextureRef>,
    normal_scale: f64,
    metallic_roughness: Option<TextureRef>,
    occlusion: Option<TextureRef>,
    occlusion_strength: f64,
    emission: Option<TextureRef>,
}

impl Maps {
    /// Those of `material`; `None` where base colour is all that varies.
    pub fn of(material: &Material) -> Option<Self> {
        let others = [
            material.normal_texture,
            material.metallic_roughness_texture,
            material.occlusion_texture,
            material.emissive_texture,
        ];
        others.iter().any(Option::is_some).then(|| Self {
            base: material.base_color_texture,
            normal: material.normal_texture,
            normal_scale: f64::from(material.normal_scale),
            metallic_roughness: material.metallic_roughness_texture,
            occlusion: material.occlusion_texture,
            occlusion_strength: f64::from(material.occlusion_strength),
            emission: material.emissive_texture,
        })
    }

    /// Their textures.
    pub fn textures(&self) -> impl Iterator<Item = usize> {
        [self.base, self.normal, self.metallic_roughness, self.occlusion, self.emission]
            .into_iter()
            .flatten()
            .map(|map| map.texture)
    }

    /// As the facet with these corners has them.
    pub fn on(&self, textures: &Textures, primitive: &Primitive, corners: [u32; 4]) -> FacetMaps {
        let place =
            |texture: Option<TextureRef>| texture.and_then(|t| Map::new(textures, primitive, corners, t));
        FacetMaps {
            base: place(self.base),
            normal: place(self.normal),
            normal_scale: self.normal_scale,
            metallic_roughness: place(self.metallic_roughness),
            occlusion: place(self.occlusion),
            occlusion_strength: self.occlusion_strength,
            emission: place(self.emission),
            is_joint: self.occlusion == self.metallic_roughness,
        }
    }
}

/// A texture on a facet.
#[derive(Clone, Copy, Debug)]
pub struct Map {
    /// Its number.
    pub texture: usize,
    /// Base texels at (s, t) = 0.
    pub origin: DVec2,
    /// Their change with s and t.
    pub along: DMat2,
}

/// Where vertices lie on a texture of `size` texels, in texels; `None` where the primitive has no coordinates for it.
pub fn texels(primitive: &Primitive, corners: [u32; 4], map: &TextureRef, size: DVec2) -> Option<[DVec2; 4]> {
    let uvs = primitive.uvs.get(map.uv_set as usize).and_then(Option::as_ref)?;
    // KHR_texture_transform.
    let [m0, m1, m2, m3, m4, m5] = map.transform.map(f64::from);
    Some(corners.map(|corner| {
        let [u, v] = uvs.get(corner as usize).copied().unwrap_or_default().map(f64::from);
        DVec2::new(m0 * u + m1 * v + m2, m3 * u + m4 * v + m5) * size
    }))
}

impl Map {
    /// `texture` on the facet of `primitive` with these corners; `None` where it has no coordinates or no texels.
    pub fn new(
        textures: &Textures,
        primitive: &Primitive,
        corners: [u32; 4],
        texture: TextureRef,
    ) -> Option<Self> {
        let size = DVec2::from_array(textures.size(texture.texture)?);
        let [a, b, _, d] = texels(primitive, corners, &texture, size)?;
        Some(Self { texture: texture.texture, origin: a, along: DMat2::from_cols(b - a, d - a) })
    }

    /// About `place`, as far as a footprint with the `sides` reaches, both in (s, t), of which a place that is read stands for
    /// `part`.
    #[inline(always)]
    fn about<'t>(&self, textures: &'t Textures, place: DVec2, sides: DMat2, part: f64) -> Option<About<'t>> {
        textures.about(self.texture, self.origin + self.along * place, self.along * sides, part)
    }
}

/// The maps of a facet.
#[derive(Clone, Debug)]
pub struct FacetMaps {
    base: Option<Map>,
    normal: Option<Map>,
    normal_scale: f64,
    metallic_roughness: Option<Map>,
    occlusion: Option<Map>,
    occlusion_strength: f64,
    emission: Option<Map>,
    /// Occlusion is a channel of what has metallic and roughness, too.
    is_joint: bool,
}

impl FacetMaps {
    /// Rows of a device, see [`packed::MAPPED_ROWS`]: of each map, then the scale of normals and the strength of occlusion.
    pub fn pack(&self) -> ([[[f32; 4]; 2]; packed::MAPS], [f32; 2]) {
        let of = |map: Option<Map>| {
            let Some(Map { texture, origin, along }) = map else { return [[0.0; 4]; 2] };
            let [s, t] = [along.x_axis, along.y_axis].map(DVec2::as_vec2);
            let [x, y] = origin.as_vec2().to_array();
            [[f32::from_bits(texture as u32 + 1), x, y, 0.0], [s.x, s.y, t.x, t.y]]
        };
        let maps = [self.base, self.normal, self.metallic_roughness, self.occlusion, self.emission];
        (maps.map(of), [self.normal_scale, self.occlusion_strength].map(|v| v as f32))
    }
}

/// What maps say at four places.
#[derive(Clone, Copy, Debug)]
pub struct Texels {
    /// Multiplies base colour.
    pub base: Four,
    /// Along the tangent, the bitangent and the normal, of any length (glTF 2.0, 3.9.3).
    pub normal: Option<Four>,
    /// Multiplies metallic.
    pub metallic: Vec4,
    /// Multiplies roughness.
    pub roughness: Vec4,
    /// Part of the indirect light that arrives.
    pub occlusion: Vec4,
    /// Multiplies emission.
    pub emission: Option<Four>,
}

impl FacetMaps {
    /// About `place`, as far as a footprint with the `sides` reaches, both in (s, t), of which a place that is read stands for
    /// `part`.
    #[inline(always)]
    pub fn about<'t>(&self, textures: &'t Textures, place: DVec2, sides: DMat2, part: f64) -> MapsAbout<'t> {
        let of = |map: &Option<Map>| map.as_ref().and_then(|m| m.about(textures, place, sides, part));
        MapsAbout {
            base: of(&self.base),
            normal: of(&self.normal),
            normal_scale: self.normal_scale as f32,
            metallic_roughness: of(&self.metallic_roughness),
            occlusion: if self.is_joint { None } else { of(&self.occlusion) },
            is_joint: self.is_joint,
            occlusion_strength: self.occlusion_strength as f32,
            emission: of(&self.emission),
        }
    }
}

/// The maps of a facet about a place.
pub struct MapsAbout<'t> {
    base: Option<About<'t>>,
    normal: Option<About<'t>>,
    normal_scale: f32,
    metallic_roughness: Option<About<'t>>,
    occlusion: Option<About<'t>>,
    is_joint: bool,
    occlusion_strength: f32,
    emission: Option<About<'t>>,
}

impl MapsAbout<'_> {
    /// At four places: `s` and `t` are parts of the footprint's sides from its middle, -1/2 to 1/2.
    #[inline(always)]
    pub fn at(&self, s: Vec4, t: Vec4) -> Texels {
        let of = |map: &Option<About>| map.as_ref().map(|map| map.at(s, t));
        let surface = of(&self.metallic_roughness).unwrap_or(Four::ONE);
        let occlusion =
            if self.is_joint { surface.x } else { of(&self.occlusion).map_or(Vec4::ONE, |o| o.x) };
        let scale = self.normal_scale;
        Texels {
            base: of(&self.base).unwrap_or(Four::ONE),
            normal: of(&self.normal).map(|n| Four {
                x: (n.x * 2.0 - 1.0) * scale,
                y: (n.y * 2.0 - 1.0) * scale,
                z: n.z * 2.0 - 1.0,
            }),
            metallic: surface.z,
            roughness: surface.y,
            occlusion: (occlusion - 1.0) * self.occlusion_strength + 1.0,
            emission: of(&self.emission),
        }
    }
}
