//! Does the product converge to truth, and as fast as theory says? On closed forms the trigger alone is asked, on a
//! scene the whole engine. And does every method survive what is known to break methods ([`failures`])?

mod draw;
mod eye;
pub mod failures;
mod forms;
mod light;
pub(crate) mod plot;
mod scene;

pub use failures::{FailureReport, FailureSettings, verify_failures};
pub use forms::{FormCheck, FormsReport, SignalClass, Theory, verify_forms};
pub use light::{LightError, LightOf, LightPixel, LightReport, LightSettings, verify_light};
pub use scene::{Fit, Reference, SceneReport, SceneSettings, Swept, TOLERANCES_US, verify_scene};

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::canvas::{self, Drawing};
use crate::draw::PictureKind;
use crate::error::ChartError;

/// Version of the JSON; another one is refused.
pub const VERSION: u32 = 1;

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

/// A report as JSON.
fn to_json(report: &impl Serialize) -> Result<String, ChartError> {
    serde_json::to_string(report).map_err(|e| ChartError::Draw(format!("no JSON: {e}")))
}

/// A report from JSON; `kind` is what its `report` must say, `path` names it in errors.
fn from_json<T: DeserializeOwned>(text: &str, kind: &str, path: &Path) -> Result<T, ChartError> {
    let invalid = |reason: String| ChartError::Invalid { path: path.into(), reason };
    let value: serde_json::Value =
        serde_json::from_str(text).map_err(|e| invalid(format!("this is no JSON: {e}")))?;
    let version = value.get("evis_verify").and_then(serde_json::Value::as_u64);
    if version != Some(u64::from(VERSION)) {
        let version = version.map_or("no".to_owned(), |v| v.to_string());
        return Err(invalid(format!(
            "this is no report of this version: it has version {version}, and this program reads version {VERSION}; \
             make it again with `evis verify --json`"
        )));
    }
    let found = value.get("report").and_then(serde_json::Value::as_str).unwrap_or("nothing").to_owned();
    if found != kind {
        return Err(invalid(format!("this is a report of {found}; one of {kind} is needed")));
    }
    serde_json::from_value(value).map_err(|e| invalid(format!("this report is damaged ({e}); make it again")))
}

pub(crate) fn save(figure: &impl Drawing, path: &Path) -> Result<(), ChartError> {
    let bytes = match PictureKind::of(path)? {
        PictureKind::Png => canvas::png(figure)?,
        PictureKind::Svg => canvas::svg(figure)?.into_bytes(),
    };
    evis_core::limits::write_whole(path, &bytes)
        .map_err(|source| ChartError::Io { path: path.into(), source })
}

#[cfg(test)]
mod tests;
