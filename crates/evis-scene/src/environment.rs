//! Image-based light: sky, diffuse irradiance and prefiltered specular light.
//!
//! Everything is linear Rec. 709 radiance in the file's own scale. An equirectangular map is read once, on the
//! CPU, into three cube maps; see [`Environment`] for what each holds and [`direction_from_equirect`] for how a map is turned.

use std::path::Path;

use glam::{DQuat, DVec3};

use crate::error::SceneError;

mod brdf;
mod cube;
mod equirect;
mod load;
mod prefilter;
mod studio;

pub use brdf::{brdf_lut, split_sum};
pub use cube::{CubeMap, FACES, cube_coordinates, cube_direction, cube_solid_angle};
pub use equirect::{direction_from_equirect, equirect_from_direction};
pub use prefilter::{IRRADIANCE_SIZE, SPECULAR_LEVELS, SPECULAR_SIZE};

/// Light from all around.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// Name or path, for messages.
    pub name: String,
    /// What is seen behind everything; radiance, with a full mip chain.
    pub sky: CubeMap,
    /// Irradiance / pi by direction of the normal.
    pub irradiance: CubeMap,
    /// Radiance convolved with GGX; level k of n holds perceptual roughness k / (n - 1) (a single level holds
    /// all of them), so `lod = roughness * (n - 1)`.
    pub specular: CubeMap,
    /// Factor on everything above.
    pub intensity: f32,
    /// Turn about +Y in radians, applied to the world: a direction d is looked up at R_y(-rotation) d.
    pub rotation: f32,
    /// Whether it is drawn behind everything; else `Scene::background` is.
    pub visible: bool,
}

impl Environment {
    /// Reads a Radiance `.hdr` or OpenEXR `.exr` map in equirectangular projection, twice as wide as high.
    ///
    /// The format is recognised by content, not by name. Alpha is ignored (OpenEXR colours are premultiplied:
    /// they are the radiance). Values that cannot be used are repaired and reported: NaN and negative values
    /// become 0, values above 65504 (the largest 16-bit float; a bare sun) become 65504. The reports go to
    /// `tracing`; [`Environment::load_with_warnings`] hands them to the caller.
    ///
    /// # Errors
    /// The file is missing, in another format, truncated or damaged, not 2:1, or larger than 32768x16384.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let mut warnings = Vec::new();
        let environment = Self::load_with_warnings(path, &mut warnings)?;
        for warning in warnings {
            tracing::warn!("{warning}");
        }
        Ok(environment)
    }

    /// As [`Environment::load`]; what had to be repaired is appended to `warnings`.
    ///
    /// # Errors
    /// As [`Environment::load`].
    pub fn load_with_warnings(
        path: impl AsRef<Path>,
        warnings: &mut Vec<String>,
    ) -> Result<Self, SceneError> {
        let path = path.as_ref();
        let (width, height, texels) = load::read(path, warnings)?;
        let map = equirect::Equirect::new(&path.display().to_string(), width, height, texels, warnings)
            .map_err(|reason| SceneError::invalid(path, reason))?;
        Ok(Self::of_map(&path.display().to_string(), &map))
    }

    /// An environment from linear radiance in equirectangular projection, row-major from the top (+Y), `width`
    /// texels a row; repairs as in [`Environment::load`] are appended to `warnings`.
    ///
    /// # Errors
    /// [`SceneError::Rule`] where the map is empty, not 2:1, or too large.
    pub fn from_equirect(
        name: &str,
        width: usize,
        texels: Vec<[f32; 3]>,
        warnings: &mut Vec<String>,
    ) -> Result<Self, SceneError> {
        let height = texels.len().checked_div(width).unwrap_or(0);
        if texels.len() != width.saturating_mul(height) || texels.is_empty() {
            return Err(SceneError::Rule(format!(
                "environment '{name}' has {} texels in rows of {width}; give width * width / 2 texels",
                texels.len()
            )));
        }
        let map = equirect::Equirect::new(name, width, height, texels, warnings)
            .map_err(|reason| SceneError::Rule(format!("environment '{name}' {reason}")))?;
        Ok(Self::of_map(name, &map))
    }

    fn of_map(name: &str, map: &equirect::Equirect) -> Self {
        let prefilter::Cubes { sky, irradiance, specular } = prefilter::build(map);
        let name = name.to_owned();
        Self { name, sky, irradiance, specular, intensity: 1.0, rotation: 0.0, visible: true }
    }

    /// The same light from everywhere.
    pub fn uniform(rgb: [f32; 3]) -> Self {
        let cube = CubeMap::uniform(rgb);
        Self {
            name: "uniform".into(),
            sky: cube.clone(),
            irradiance: cube.clone(),
            specular: cube,
            intensity: 1.0,
            rotation: 0.0,
            visible: true,
        }
    }

    /// A soft studio, for scenes that bring no light: bright sky above a dim ground, and three soft boxes (a key
    /// light at the right front, a fill at the left, a rim behind; front is +Z, where a glTF model faces).
    pub fn studio() -> Self {
        Self::of_map("studio", &studio::map())
    }

    /// Radiance from world direction `direction`, level 0 of the sky, rotation and intensity applied.
    pub fn radiance(&self, direction: DVec3) -> DVec3 {
        self.look_up(&self.sky, direction, 0.0)
    }

    /// Irradiance / pi on a surface with world normal `normal`.
    pub fn diffuse(&self, normal: DVec3) -> DVec3 {
        self.look_up(&self.irradiance, normal, 0.0)
    }

    /// Radiance around world direction `direction` as a surface of perceptual roughness `roughness` reflects it.
    pub fn reflection(&self, direction: DVec3, roughness: f64) -> DVec3 {
        let last = self.specular.levels.len().saturating_sub(1) as f64;
        self.look_up(&self.specular, direction, roughness.clamp(0.0, 1.0) * last)
    }

    fn look_up(&self, cube: &CubeMap, direction: DVec3, level: f64) -> DVec3 {
        let turned = DQuat::from_rotation_y(-f64::from(self.rotation)) * direction;
        let [r, g, b] = cube.sample(turned, level);
        DVec3::new(f64::from(r), f64::from(g), f64::from(b)) * f64::from(self.intensity)
    }
}
