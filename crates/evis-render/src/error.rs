//! What can go wrong while the engine runs.

/// An engine error; each says what to do.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// A setting cannot be used.
    #[error(transparent)]
    Config(#[from] evis_core::ConfigError),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] evis_scene::SceneError),
    /// A recording could not be read.
    #[error(transparent)]
    Format(#[from] evis_core::format::FormatError),
    /// This machine has no device, and one is needed.
    #[error(
        "no Vulkan, Metal or DirectX 12 device was found; without a GPU install Mesa's software driver (Debian, Ubuntu: \
         apt-get install mesa-vulkan-drivers libvulkan1; Fedora: dnf install mesa-vulkan-drivers vulkan-loader)"
    )]
    NoDevice,
    /// The device failed, or none is the one that was asked for.
    #[error("{0}")]
    Device(String),
    /// A file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: std::path::PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// A file could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: std::path::PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// It was asked to stop.
    #[error("stopped on request; the next step goes on from there")]
    Stopped,
}

impl From<evis_decoupled::Error> for EngineError {
    fn from(error: evis_decoupled::Error) -> Self {
        use evis_decoupled::Error;
        match error {
            Error::Config(error) => error.into(),
            Error::Camera(reason) => evis_scene::SceneError::Rule(reason).into(),
            Error::Unsupported(limit) => {
                let remedy = format!("native: decoupled sampling cannot show {limit}");
                evis_core::ConfigError::new("method", "decoupled", remedy).into()
            }
            // Of threads, and what is added there.
            other => Self::Device(other.to_string()),
        }
    }
}

impl From<wgpu::PollError> for EngineError {
    fn from(error: wgpu::PollError) -> Self {
        Self::Device(format!("the device stopped answering: {error}; run again, or choose another `device`"))
    }
}
