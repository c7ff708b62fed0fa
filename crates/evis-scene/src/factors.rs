//! The factors of a material that a host may change while the scene runs.

use crate::model::{Material, ShadingModel};

/// Factors of a material at a time. Textures multiply them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialFactors {
    /// Linear base colour.
    pub base_color: [f32; 3],
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Emitted radiance, linear.
    pub emissive: [f32; 3],
    /// Perceptual roughness.
    pub roughness: f32,
}

impl MaterialFactors {
    /// Those of `material` as it is.
    pub const fn of(material: &Material) -> Self {
        let [r, g, b, _] = material.base_color;
        Self {
            base_color: [r, g, b],
            metallic: material.metallic,
            emissive: material.emissive,
            roughness: material.roughness,
        }
    }

    /// These, with what `change` gives.
    #[must_use]
    pub fn with(self, change: &MaterialChange) -> Self {
        Self {
            base_color: change.base_color.unwrap_or(self.base_color),
            metallic: change.metallic.unwrap_or(self.metallic),
            emissive: change.emissive.unwrap_or(self.emissive),
            roughness: change.roughness.unwrap_or(self.roughness),
        }
    }

    /// `material` with these factors.
    pub fn applied(&self, material: &Material) -> Material {
        let ([r, g, b], alpha) = (self.base_color, material.base_color[3]);
        Material {
            base_color: [r, g, b, alpha],
            metallic: self.metallic,
            emissive: self.emissive,
            roughness: self.roughness,
            ..material.clone()
        }
    }
}

/// New factors of a material; what is `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialChange {
    /// See [`MaterialFactors::base_color`].
    pub base_color: Option<[f32; 3]>,
    /// See [`MaterialFactors::metallic`].
    pub metallic: Option<f32>,
    /// See [`MaterialFactors::emissive`].
    pub emissive: Option<[f32; 3]>,
    /// See [`MaterialFactors::roughness`].
    pub roughness: Option<f32>,
}

impl MaterialChange {
    /// The first factor that a material of this model does not have, and what it has.
    pub(crate) fn unseen(&self, model: ShadingModel) -> Option<(&'static str, &'static str)> {
        let metallic = self.metallic.map(|_| "metallic").or_else(|| self.roughness.map(|_| "roughness"));
        match model {
            ShadingModel::MetallicRoughness => None,
            ShadingModel::Diffuse => metallic.map(|factor| (factor, "color and emissive")),
            ShadingModel::Unlit => {
                metallic.or_else(|| self.emissive.map(|_| "emissive")).map(|factor| (factor, "color alone"))
            }
        }
    }
}
