//! What the raster passes should have drawn, computed without them: exact geometry in f64, ray by ray.
//!
//! Nothing here is shared with the shaders or with the code that feeds them. Formulas are written from their
//! sources (glTF 2.0, its extensions, the Vulkan specification), so that an agreement means something.

pub mod bvh;
pub mod geometry;
pub mod pinhole;
pub mod raster;
pub mod shade;
pub mod texture;

pub use pinhole::Pinhole;
pub use raster::{Labels, Options, Raster};
pub use texture::TextureFilter;
