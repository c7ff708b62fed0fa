//! A scene seen ray by ray, in f64.
//!
//! Nothing here is shared with the engine's shaders or with the code that feeds them beyond the scene's data, and
//! its formulas are written from their sources (glTF 2.0, its extensions, the Vulkan specification), so that an
//! agreement means something.

pub mod beam;
pub mod bvh;
pub mod caster;
pub mod geometry;
pub mod pinhole;
pub mod shade;
pub mod split_sum;
pub mod texture;

pub use beam::Beam;
pub use caster::{Labels, Options, RayCaster};
pub use geometry::{Geometry, Hit, Matter};
pub use pinhole::{Pinhole, Projection, Ray, SceneCamera};
pub use split_sum::SplitSum;
pub use texture::{TextureFilter, Textures};
