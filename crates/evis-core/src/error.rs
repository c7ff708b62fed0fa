//! The error of a setting.

/// A configuration value that cannot be used: which one, what it was, and what would work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{what} is {value}; it must be {remedy}")]
pub struct ConfigError {
    /// Name of the setting, as the user wrote it.
    pub what: String,
    /// The refused value.
    pub value: String,
    /// What would work.
    pub remedy: String,
}

impl ConfigError {
    /// An error about setting `what` with `value`; `remedy` completes "it must be …".
    pub fn new(what: &str, value: impl std::fmt::Display, remedy: impl Into<String>) -> Self {
        Self { what: what.into(), value: value.to_string(), remedy: remedy.into() }
    }
}
