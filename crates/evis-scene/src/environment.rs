//! Image-based light: sky, diffuse irradiance and prefiltered specular light.

use half::f16;

/// A cube map: six square faces in the order +X, -X, +Y, -Y, +Z, -Z (the layout of Vulkan and WebGPU), per mip level.
#[derive(Clone, Debug, PartialEq)]
pub struct CubeMap {
    /// Edge of level 0, in texels.
    pub size: u32,
    /// Per level: six faces of `(size >> level)^2` linear RGBA texels, face after face.
    pub levels: Vec<Vec<[f16; 4]>>,
}

/// Light from all around.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// Name or path, for messages.
    pub name: String,
    /// What is seen behind everything; radiance.
    pub sky: CubeMap,
    /// Irradiance / pi by direction of the normal.
    pub irradiance: CubeMap,
    /// Radiance convolved with GGX; level k of n holds perceptual roughness k / (n - 1).
    pub specular: CubeMap,
    /// Factor on everything above.
    pub intensity: f32,
    /// Turn about +Y in radians, applied to the world: a direction d is looked up at R_y(-rotation) d.
    pub rotation: f32,
    /// Whether it is drawn behind everything; else `Scene::background` is.
    pub visible: bool,
}
