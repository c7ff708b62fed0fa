//! What can go wrong between a film and its events.

use evis_core::ConfigError;
use evis_core::format::FormatError;

/// A video error; each says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// A setting, or a frame, that the sensor cannot use.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A file that cannot be read or written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Frames between frames could not be made.
    #[error("frames between frames: {0}")]
    Between(String),
    /// ffmpeg could not be started.
    #[error(
        "films need ffmpeg, and {program} did not start ({reason}); install it (apt-get install ffmpeg, brew install \
         ffmpeg), or the Python package's extra (pip install 'evis[video]'), or name one in {variable}; folders of \
         pictures and .npy stacks need none"
    )]
    NoFfmpeg {
        /// What was started.
        program: String,
        /// Why it was not.
        reason: String,
        /// The variable that names another one.
        variable: &'static str,
    },
}
