//! Images, textures and materials.

use std::collections::BTreeMap;
use std::path::Path;

use ::gltf::json;
use ::gltf::json::texture::{MagFilter, WrappingMode};
use ::gltf::json::validation::Checked;
use rayon::prelude::*;
use serde_json::Value;

use super::document::{Document, element, label};
use super::file;
use crate::image::{Transfer, decode_within};
use crate::model::{AlphaMode, Image, Material, Scene, ShadingModel, Texture, TextureRef, Wrap};

/// Where a texture was already put, by its index and use.
type Known = BTreeMap<(usize, Transfer), usize>;

/// Appends the file's materials, and after them one for primitives that name none.
pub(super) fn read(document: &Document, folder: &Path, scene: &mut Scene) -> Result<(), String> {
    let mut images: Vec<(usize, Transfer)> = Vec::new();
    let mut known = Known::new();
    for (i, source) in document.root.materials.iter().enumerate() {
        let user = label("material", i, source.name.as_ref());
        let value = document.value.pointer(&format!("/materials/{i}"));
        let mut reader = Reader { document, scene, images: &mut images, known: &mut known, user: &user };
        let material = reader.material(source, value)?;
        scene.materials.push(material);
    }
    // Only what a material uses is decoded, each image once per use, all at the same time.
    let decoded: Result<Vec<_>, _> =
        images.par_iter().map(|&(image, transfer)| read_image(document, folder, image, transfer)).collect();
    scene.images = decoded?;
    scene.materials.push(Material { name: "default".into(), ..Material::default() });
    Ok(())
}

fn read_image(document: &Document, folder: &Path, index: usize, transfer: Transfer) -> Result<Image, String> {
    let source = element(&document.root.images, "image", index, "a texture")?;
    let what = label("image", index, source.name.as_ref());
    let name = [&source.name, &source.uri].into_iter().flatten().find(|n| !n.starts_with("data:"));
    let name = name.cloned().unwrap_or_else(|| what.clone());
    match (&source.uri, source.buffer_view) {
        (_, Some(view)) => {
            decode_within(&name, document.view(view.value(), &what)?, transfer, &document.budget)
        }
        (Some(uri), None) => {
            let bytes = file::fetch(uri, folder, &what, &document.budget)?;
            let image = decode_within(&name, &bytes, transfer, &document.budget);
            document.budget.give_back(bytes.len() as u64);
            image
        }
        (None, None) => Err(format!("{what} has neither a URI nor a buffer view")),
    }
}

struct Reader<'a> {
    document: &'a Document,
    scene: &'a mut Scene,
    images: &'a mut Vec<(usize, Transfer)>,
    known: &'a mut Known,
    user: &'a str,
}

impl Reader<'_> {
    fn material(&mut self, source: &json::Material, value: Option<&Value>) -> Result<Material, String> {
        let pbr = &source.pbr_metallic_roughness;
        let extensions = source.extensions.as_ref();
        let unlit = extensions.is_some_and(|e| e.unlit.is_some());
        let strength =
            extensions.and_then(|e| e.emissive_strength.as_ref()).map_or(1.0, |e| e.emissive_strength.0);
        let mut texture = |slot: &str, transfer| {
            value.and_then(|v| v.pointer(slot)).map_or(Ok(None), |info| self.texture(slot, info, transfer))
        };
        let base_color_texture = texture("/pbrMetallicRoughness/baseColorTexture", Transfer::Srgb)?;
        let emissive_texture = texture("/emissiveTexture", Transfer::Srgb)?;
        let metallic_roughness_texture =
            texture("/pbrMetallicRoughness/metallicRoughnessTexture", Transfer::Linear)?;
        let normal_texture = texture("/normalTexture", Transfer::Linear)?;
        let occlusion_texture = texture("/occlusionTexture", Transfer::Linear)?;
        let alpha = match source.alpha_mode {
            Checked::Valid(json::material::AlphaMode::Opaque) => AlphaMode::Opaque,
            Checked::Valid(json::material::AlphaMode::Mask) => {
                AlphaMode::Mask(source.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0))
            }
            Checked::Valid(json::material::AlphaMode::Blend) => {
                let warning = format!("{} is blended; it is drawn where its alpha reaches 0.5", self.user);
                self.scene.warnings.push(warning);
                AlphaMode::Mask(0.5)
            }
            Checked::Invalid => return Err(format!("{} has an unknown alpha mode", self.user)),
        };
        Ok(Material {
            name: source.name.clone().unwrap_or_default(),
            model: if unlit { ShadingModel::Unlit } else { ShadingModel::MetallicRoughness },
            base_color: pbr.base_color_factor.0,
            base_color_texture,
            metallic: pbr.metallic_factor.0,
            roughness: pbr.roughness_factor.0,
            metallic_roughness_texture,
            // An unlit surface has no normal, occlusion or emission (KHR_materials_unlit).
            normal_texture: normal_texture.filter(|_| !unlit),
            normal_scale: source.normal_texture.as_ref().map_or(1.0, |t| t.scale),
            occlusion_texture: occlusion_texture.filter(|_| !unlit),
            occlusion_strength: source.occlusion_texture.as_ref().map_or(1.0, |t| t.strength.0),
            emissive: if unlit { [0.0; 3] } else { source.emissive_factor.0.map(|v| v * strength) },
            emissive_texture: emissive_texture.filter(|_| !unlit),
            emission_waveform: None,
            alpha,
            double_sided: source.double_sided,
            driven: false,
        })
    }

    /// A texture as a material uses it; `None`, with a warning, where it cannot be.
    fn texture(
        &mut self,
        slot: &str,
        info: &Value,
        transfer: Transfer,
    ) -> Result<Option<TextureRef>, String> {
        let user = format!("{}, {}", self.user, slot.rsplit('/').next().unwrap_or(slot));
        let integer = |v: Option<&Value>| v.and_then(Value::as_u64).and_then(|v| usize::try_from(v).ok());
        let index = integer(info.get("index")).ok_or_else(|| format!("{user} names no texture"))?;
        let source = element(&self.document.root.textures, "texture", index, &user)?;
        let transform = info.pointer("/extensions/KHR_texture_transform");
        let set = transform.and_then(|t| t.get("texCoord")).or_else(|| info.get("texCoord"));
        let uv_set = set.map_or(Some(0), |v| integer(Some(v))).unwrap_or(usize::MAX);
        if uv_set > 1 {
            self.scene
                .warnings
                .push(format!("{user} uses UV set {uv_set} and is ignored; sets 0 and 1 work"));
            return Ok(None);
        }
        let image = source.source.value();
        if image == u32::MAX as usize {
            self.scene.warnings.push(format!("{user} has no PNG or JPEG image and is ignored"));
            return Ok(None);
        }
        element(&self.document.root.images, "image", image, &user)?;
        let texture = match self.known.get(&(index, transfer)) {
            Some(texture) => *texture,
            None => {
                let slot =
                    self.images.iter().position(|known| *known == (image, transfer)).unwrap_or_else(|| {
                        self.images.push((image, transfer));
                        self.images.len() - 1
                    });
                let texture = self.sampled(source, slot, &user)?;
                self.scene.textures.push(texture);
                self.known.insert((index, transfer), self.scene.textures.len() - 1);
                self.scene.textures.len() - 1
            }
        };
        Ok(Some(TextureRef { texture, uv_set: uv_set as u32, transform: matrix(transform) }))
    }

    fn sampled(&self, source: &json::Texture, image: usize, user: &str) -> Result<Texture, String> {
        let Some(sampler) = source.sampler else {
            return Ok(Texture::new(image));
        };
        let sampler = element(&self.document.root.samplers, "sampler", sampler.value(), user)?;
        let wrap = |mode| match mode {
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        let nearest = matches!(sampler.mag_filter, Some(Checked::Valid(MagFilter::Nearest)));
        Ok(Texture { image, wrap_u: wrap(sampler.wrap_s), wrap_v: wrap(sampler.wrap_t), nearest })
    }
}

/// KHR_texture_transform: offset after rotation after scale. Positive angles turn the UVs counter-clockwise as seen in
/// the image, whose v runs down; so u' = cos u + sin v.
fn matrix(transform: Option<&Value>) -> [f32; 6] {
    let number = |key: &str, default: f64| {
        transform.and_then(|t| t.pointer(key)).and_then(Value::as_f64).unwrap_or(default)
    };
    let (sin, cos) = number("/rotation", 0.0).sin_cos();
    let (x, y) = (number("/scale/0", 1.0), number("/scale/1", 1.0));
    let (u, v) = (number("/offset/0", 0.0), number("/offset/1", 0.0));
    [cos * x, sin * y, u, -sin * x, cos * y, v].map(|m| m as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_transforms_select_what_the_extension_says() {
        assert_eq!(matrix(None), [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let at = |json: &str, u: f32, v: f32| {
            let m = matrix(Some(&serde_json::from_str(json).expect("valid JSON")));
            (m[0] * u + m[1] * v + m[2], m[3] * u + m[4] * v + m[5])
        };
        let near = |a: (f32, f32), b: (f32, f32)| (a.0 - b.0).abs() < 1e-6 && (a.1 - b.1).abs() < 1e-6;
        // The extension's own first example takes the lower left quadrant (v runs down), turned by 90 degrees.
        let quadrant = r#"{"offset":[0,1],"rotation":1.57079632679,"scale":[0.5,0.5]}"#;
        assert!(near(at(quadrant, 0.0, 0.0), (0.0, 1.0)));
        assert!(near(at(quadrant, 1.0, 0.0), (0.0, 0.5)));
        assert!(near(at(quadrant, 0.0, 1.0), (0.5, 1.0)));
        // Its second turns the image upside down.
        assert!(near(at(r#"{"offset":[0,1],"scale":[1,-1]}"#, 0.25, 0.25), (0.25, 0.75)));
    }
}
