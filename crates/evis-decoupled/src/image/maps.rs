//! What a surface's normal, roughness, occlusion and emission maps say at a place.

use evis_scene::{Material, Primitive, TextureRef};
use glam::{DMat2, DVec2, DVec3};

use crate::image::texture::{Places, Textures};
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

    /// As it is read where a place stands for `area` of (s, t).
    fn reader<'t>(&self, textures: &'t Textures, area: f64) -> Option<(Self, Places<'t>)> {
        let texels = (self.along.determinant() * area).abs().sqrt();
        Some((*self, textures.places(self.texture, texels)?))
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

/// What maps say at a place.
#[derive(Clone, Copy, Debug)]
pub struct Texels {
    /// Multiplies base colour.
    pub base: DVec3,
    /// Along the tangent, the bitangent and the normal, of any length (glTF 2.0, 3.9.3).
    pub normal: Option<DVec3>,
    /// Multiplies metallic.
    pub metallic: f64,
    /// Multiplies roughness.
    pub roughness: f64,
    /// Part of the indirect light that arrives.
    pub occlusion: f64,
    /// Multiplies emission.
    pub emission: DVec3,
}

impl FacetMaps {
    /// As they are read where a place stands for `area` of (s, t).
    pub fn reader<'t>(&self, textures: &'t Textures, area: f64) -> MapReader<'t> {
        let of = |map: &Option<Map>| map.and_then(|m| m.reader(textures, area));
        MapReader {
            base: of(&self.base),
            normal: of(&self.normal),
            normal_scale: self.normal_scale,
            metallic_roughness: of(&self.metallic_roughness),
            occlusion: of(&self.occlusion),
            occlusion_strength: self.occlusion_strength,
            emission: of(&self.emission),
        }
    }

    /// Texels of the finest one along s and t; `None` where it has none.
    pub fn finest(&self) -> Option<DMat2> {
        [self.base, self.normal, self.metallic_roughness, self.occlusion, self.emission]
            .into_iter()
            .flatten()
            .map(|map| map.along)
            .max_by(|a, b| a.determinant().abs().total_cmp(&b.determinant().abs()))
    }
}

/// The maps of a facet, read on levels of one detail.
pub struct MapReader<'t> {
    base: Option<(Map, Places<'t>)>,
    normal: Option<(Map, Places<'t>)>,
    normal_scale: f64,
    metallic_roughness: Option<(Map, Places<'t>)>,
    occlusion: Option<(Map, Places<'t>)>,
    occlusion_strength: f64,
    emission: Option<(Map, Places<'t>)>,
}

impl MapReader<'_> {
    /// At (s, t).
    pub fn at(&self, place: DVec2) -> Texels {
        let of = |map: &Option<(Map, Places)>| {
            map.as_ref().map(|(map, places)| {
                let [r, g, b, _] = places.at((map.origin + map.along * place).to_array());
                DVec3::new(f64::from(r), f64::from(g), f64::from(b))
            })
        };
        let surface = of(&self.metallic_roughness).unwrap_or(DVec3::ONE);
        let scale = DVec3::new(self.normal_scale, self.normal_scale, 1.0);
        Texels {
            base: of(&self.base).unwrap_or(DVec3::ONE),
            normal: of(&self.normal).map(|n| (2.0 * n - 1.0) * scale),
            metallic: surface.z,
            roughness: surface.y,
            occlusion: of(&self.occlusion).map_or(1.0, |o| 1.0 + self.occlusion_strength * (o.x - 1.0)),
            emission: of(&self.emission).unwrap_or(DVec3::ONE),
        }
    }
}
