//! What a material is but for its textures, what a light gives, and how a host changes both while the scene runs.

use crate::error::SceneError;

/// How a surface answers light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShadingModel {
    /// Base colour is the radiance (KHR_materials_unlit).
    Unlit,
    /// Lambert: no highlight.
    Diffuse,
    /// glTF 2.0 metallic-roughness (appendix B).
    #[default]
    MetallicRoughness,
}

impl ShadingModel {
    /// Its name in scene files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unlit => "unlit",
            Self::Diffuse => "diffuse",
            Self::MetallicRoughness => "metallic_roughness",
        }
    }
}

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
    /// Whether they are in range.
    ///
    /// # Errors
    /// Names the first that is not, and its range.
    pub(crate) fn check(&self) -> Result<(), SceneError> {
        light_color("base_color", self.base_color)?;
        light_color("emissive", self.emissive)?;
        within("metallic", self.metallic.into(), 0.0, 1.0)?;
        within("roughness", self.roughness.into(), 0.0, 1.0)
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
}

/// What a light gives at a time, but for its waveform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightFactors {
    /// Linear colour.
    pub color: [f32; 3],
    /// Lux (directional) or candela.
    pub intensity: f32,
    /// Whether it shines.
    pub on: bool,
}

impl Default for LightFactors {
    fn default() -> Self {
        Self { color: [1.0; 3], intensity: 1.0, on: true }
    }
}

impl LightFactors {
    /// Whether they are in range.
    ///
    /// # Errors
    /// Names the first that is not, and its range.
    pub(crate) fn check(&self) -> Result<(), SceneError> {
        light_color("color", self.color)?;
        if self.intensity.is_finite() && self.intensity >= 0.0 {
            return Ok(());
        }
        let intensity = self.intensity;
        Err(SceneError::Rule(format!("intensity is {intensity}; it takes lux or candela, 0 or more")))
    }

    /// The intensity, 0 where it does not shine.
    pub const fn shining(&self) -> f32 {
        if self.on { self.intensity } else { 0.0 }
    }

    /// These, with what `change` gives.
    #[must_use]
    pub fn with(self, change: &LightChange) -> Self {
        Self {
            color: change.color.unwrap_or(self.color),
            intensity: change.intensity.unwrap_or(self.intensity),
            on: change.on.unwrap_or(self.on),
        }
    }
}

/// New factors of a light; what is `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightChange {
    /// See [`LightFactors::color`].
    pub color: Option<[f32; 3]>,
    /// See [`LightFactors::intensity`].
    pub intensity: Option<f32>,
    /// See [`LightFactors::on`].
    pub on: Option<bool>,
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

pub(crate) fn within(what: &str, value: f64, low: f64, high: f64) -> Result<(), SceneError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(SceneError::Rule(format!("{what} is {value}; it takes a number between {low} and {high}")))
}

/// Linear light: no upper bound that matters, but halves of floats end at 65504.
pub(crate) fn light_color(what: &str, color: [f32; 3]) -> Result<(), SceneError> {
    if color.iter().all(|c| (0.0..=65504.0).contains(c)) {
        return Ok(());
    }
    Err(SceneError::Rule(format!("{what} is {color:?}; it takes linear RGB, each between 0 and 65504")))
}
