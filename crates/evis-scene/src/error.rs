//! One error type for everything that can be wrong with a scene.

use std::path::PathBuf;

/// What is wrong with a scene, where, and what would work.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// A file was read, and its content is not usable.
    #[error("{}: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong in it, and what would work.
        reason: String,
    },
    /// A scene, built in code or loaded, breaks a rule.
    #[error("scene: {0}")]
    Rule(String),
    /// A name that does not exist; the ones that do are listed.
    #[error("no {what} named '{name}'; there is {}{}", listed(known), did_you_mean(name, known))]
    Unknown {
        /// Kind of thing.
        what: &'static str,
        /// The name asked for.
        name: String,
        /// The names that exist.
        known: Vec<String>,
    },
}

fn listed(known: &[String]) -> String {
    if known.is_empty() { "none".to_owned() } else { known.join(", ") }
}

fn did_you_mean(name: &str, known: &[String]) -> String {
    let near = evis_limits::nearest(name, known.iter().map(String::as_str));
    near.map_or_else(String::new, |near| format!(" (did you mean '{near}'?)"))
}

impl SceneError {
    /// Shorthand for [`SceneError::Invalid`].
    pub fn invalid(path: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Invalid { path: path.into(), reason: reason.into() }
    }
}
