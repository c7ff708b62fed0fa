//! Does the product converge to truth, and as fast as theory says? On closed forms the trigger alone is asked, on a
//! scene the whole engine. And does every method survive what is known to break methods ([`failures`])?

mod draw;
mod eye;
pub mod failures;
mod file;
mod forms;
mod light;
pub(crate) mod plot;
mod scene;

pub use failures::{FailureReport, FailureSettings, verify_failures};
pub use file::VERSION;
pub(crate) use file::save;
pub use forms::{FormCheck, FormsReport, SignalClass, Theory, verify_forms};
pub use light::{LightError, LightOf, LightPixel, LightReport, LightSettings, verify_light};
pub use scene::{Fit, Reference, SceneReport, SceneSettings, Swept, TOLERANCES_US, verify_scene};

use std::path::Path;

use crate::error::ChartError;

/// Any report, for those who only pass it on.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// Of triggers on closed forms.
    Forms(Box<FormsReport>),
    /// Of the engine on a scene.
    Scene(Box<SceneReport>),
    /// Of failure modes.
    Failures(Box<FailureReport>),
    /// Of light at one instant.
    Light(Box<LightReport>),
}

impl Report {
    /// Reads any report's JSON; `path` names it in errors.
    ///
    /// # Errors
    /// No JSON, no report, or one of another version.
    pub fn from_json(text: &str, path: &Path) -> Result<Self, ChartError> {
        let value: Option<serde_json::Value> = serde_json::from_str(text).ok();
        let kind = value.as_ref().and_then(|v| v.get("report")).and_then(serde_json::Value::as_str);
        match kind {
            Some(scene::REPORT) => SceneReport::from_json(text, path).map(|r| Self::Scene(Box::new(r))),
            Some(failures::REPORT) => {
                FailureReport::from_json(text, path).map(|r| Self::Failures(Box::new(r)))
            }
            Some(light::REPORT) => LightReport::from_json(text, path).map(|r| Self::Light(Box::new(r))),
            _ => FormsReport::from_json(text, path).map(|r| Self::Forms(Box::new(r))),
        }
    }

    /// Draws it to `path`, as SVG or PNG by its ending.
    ///
    /// # Errors
    /// Another ending, nothing to draw, a file that cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ChartError> {
        match self {
            Self::Forms(report) => report.save(path),
            Self::Scene(report) => report.save(path),
            Self::Failures(report) => report.save(path),
            Self::Light(report) => report.save(path),
        }
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Forms(report) => report.fmt(f),
            Self::Scene(report) => report.fmt(f),
            Self::Failures(report) => report.fmt(f),
            Self::Light(report) => report.fmt(f),
        }
    }
}

#[cfg(test)]
mod tests;
