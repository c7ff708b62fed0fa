//! CPU twins: what the passes should have produced, computed without them.
//!
//! The trigger's twin is the same algorithm in f32. The raster passes' twin is exact geometry in f64, ray by ray;
//! nothing of it is shared with the shaders or with the code that feeds them, and its formulas are written from
//! their sources (glTF 2.0, its extensions, the Vulkan specification), so that an agreement means something.

pub mod bvh;
pub mod geometry;
pub mod pinhole;
pub mod raster;
pub mod shade;
pub mod texture;
pub mod trigger;

pub use pinhole::Pinhole;
pub use raster::{Labels, Options, Raster};
pub use texture::TextureFilter;
