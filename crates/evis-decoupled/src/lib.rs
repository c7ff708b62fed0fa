//! Decoupled sampling: which surfaces a pixel sees is found from geometry in continuous time, how bright they are from
//! light that lives on the surfaces, and each pixel is evaluated at its own times. Pure Rust, no GPU; pixels may be left to
//! a [`Device`].
//!
//! Folders import those above them only:
//!
//! | folder | holds |
//! |---|---|
//! | [`fours`] | numbers and vectors of four places at once |
//! | [`packed`] | what a device that follows pixels is given of a block |
//! | [`image`] | what pictures say: textures averaged over footprints, maps of materials at a place, light from all around |
//! | [`scene`] | a scene as facets, convex planar polygons without holes; where the pixels of each tile look |
//! | [`visibility`] | blocks of time and bounds of motion; what tiles and pixels may see; how much of a pixel a facet covers |
//! | [`shading`] | what a facet sends to a pixel: its material's response, shadows, and what is kept of both |
//! | [`signal`] | a pixel's light over time: where it is evaluated, the path between, the thresholds that it crosses |
//! | `run` | the loop over blocks, tiles and pixels, sensors with more stages than thresholds, and streams |

pub mod fours;
mod hash;
pub mod image;
pub mod packed;
mod run;
pub mod scene;
pub mod shading;
pub mod signal;
pub mod visibility;

pub use run::device::{Device, Devices, Stages, ViewSensor};
pub use run::limits::{CrowdedTiles, crowded, crowded_tiles, unsupported};
pub use run::settings::{Report, Settings};
pub use run::simulate::{Outcome, luminance, luminance_of, simulate};
pub use run::stream::{Cost, Piece, Stream, StreamSettings, View};

/// Why there are no events.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A camera that cannot be used.
    #[error("{0}")]
    Camera(String),
    /// A setting.
    #[error(transparent)]
    Config(#[from] evis_core::ConfigError),
    /// What a scene has and this method does not know.
    #[error("decoupled sampling cannot show {0}; use native sampling")]
    Unsupported(String),
    /// What followed pixels.
    #[error("the device that follows pixels: {0}")]
    Device(String),
    /// The thread of a stream.
    #[error("the stream's thread: {0}")]
    Thread(String),
}

impl From<evis_scene::SceneError> for Error {
    fn from(error: evis_scene::SceneError) -> Self {
        match error {
            evis_scene::SceneError::Rule(text) => Self::Camera(text),
            other => Self::Camera(other.to_string()),
        }
    }
}
