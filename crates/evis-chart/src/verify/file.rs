//! Reports as JSON, and their figures as files.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::draw::PictureKind;
use crate::error::ChartError;
use crate::plot::canvas::{self, Drawing};

/// Version of the JSON; another one is refused.
pub const VERSION: u32 = 1;

/// A report as JSON.
pub(super) fn to_json(report: &impl Serialize) -> Result<String, ChartError> {
    serde_json::to_string(report).map_err(|e| ChartError::Draw(format!("no JSON: {e}")))
}

/// A report from JSON; `kind` is what its `report` must say, `path` names it in errors.
pub(super) fn from_json<T: DeserializeOwned>(text: &str, kind: &str, path: &Path) -> Result<T, ChartError> {
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

/// Draws `figure` to `path`, as SVG or PNG by its ending.
pub(crate) fn save(figure: &impl Drawing, path: &Path) -> Result<(), ChartError> {
    let bytes = match PictureKind::of(path)? {
        PictureKind::Png => canvas::png(figure)?,
        PictureKind::Svg => canvas::svg(figure)?.into_bytes(),
    };
    evis_core::limits::write_whole(path, &bytes)
        .map_err(|source| ChartError::Io { path: path.into(), source })
}
