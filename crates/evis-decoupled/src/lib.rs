//! Decoupled sampling: which surfaces a pixel sees is found from geometry in continuous time, how bright they are from
//! light that lives on the surfaces, and each pixel is evaluated at its own times. Pure Rust, no GPU.
//!
//! Modules read earlier ones only: [`holes`] cuts holes out of masked surfaces; [`world`] flattens a scene; [`tiles`] says
//! what a tile of pixels sees of it; [`blocks`] cuts time and bounds motion; [`lists`] says what tiles and pixels may see;
//! [`coverage`] how much of a pixel each facet covers at a time; [`texture`], [`light`] and [`shadow`] what it sends;
//! [`path`] follows a pixel's light; [`events`] crosses thresholds; `knots` gives a tile's light to sensors with more
//! stages than these: `sensing` tile by tile, `frames` as pictures.

pub mod blocks;
mod contour;
pub mod coverage;
pub mod environment;
pub mod events;
pub mod facets;
pub mod fragment;
mod frames;
mod hash;
pub mod holes;
pub mod keyframe;
mod knots;
pub mod light;
mod limits;
pub mod lists;
pub mod maps;
pub mod mask;
pub mod material;
pub mod pages;
pub mod path;
pub mod pixel;
mod sensing;
pub mod shadow;
mod simulate;
mod stream;
pub mod texture;
pub mod tiles;
pub mod world;

pub use limits::{crowded, unsupported};
pub use simulate::{Outcome, Report, Settings, luminance, luminance_of, simulate};
pub use stream::{Cost, Piece, Stream, StreamSettings, View};

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
