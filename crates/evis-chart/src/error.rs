//! What can go wrong with a chart.

use std::path::PathBuf;

use evis_core::ConfigError;
use evis_render::EngineError;
use evis_scene::SceneError;

/// A chart error; each says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ChartError {
    /// A setting cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The engine failed.
    #[error(transparent)]
    Engine(EngineError),
    /// Truth could not be had.
    #[error("truth: {0}")]
    Truth(String),
    /// Nothing fires that settings could be compared by.
    #[error(
        "none of the {pixels} pixels that truth was made for fires within {} s; choose a longer stream, another start \
         of it, or more pixels",
        *duration_us as f64 / 1e6
    )]
    Silent {
        /// Pixels of truth.
        pixels: usize,
        /// Length of the stream.
        duration_us: i64,
    },
    /// Events could not be compared with truth.
    #[error("score: {0}")]
    Score(String),
    /// Two repetitions of one setting gave different events.
    #[error(
        "{label}: repetition {repetition} gave other events than the first ({found}, not {expected}); the \
         engine must give the same bytes each time, please report the scene, the device and its driver"
    )]
    NotRepeatable {
        /// The setting.
        label: String,
        /// Which repetition, counted from 1.
        repetition: usize,
        /// Hash of the first repetition's events.
        expected: String,
        /// Hash of this one's.
        found: String,
    },
    /// No measured setting does what was asked.
    #[error("{0}")]
    Unreachable(String),
    /// A file is not a chart's JSON.
    #[error("{}: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong in it, and what would work.
        reason: String,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// The picture could not be drawn: a defect of this program.
    #[error("cannot draw the chart: {0}")]
    Draw(String),
    /// It was asked to stop.
    #[error("stopped on request")]
    Stopped,
}

impl From<EngineError> for ChartError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Config(error) => Self::Config(error),
            EngineError::Scene(error) => Self::Scene(error),
            EngineError::Stopped => Self::Stopped,
            other => Self::Engine(other),
        }
    }
}
