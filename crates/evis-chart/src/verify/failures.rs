//! The failure suite: every way in which interpolated events are known to go wrong as a small
//! scene with a number against truth, for every method.
//!
//! A *failure* is a row: one or more shots (`shots.rs`), a detector, and the number that it gives. A *method* is a column:
//! a named setting ([`methods`]). A *cell* is a failure's number for a method, with F1 and time error beside it, and
//! whether it keeps the limits that we claim ([`limit`]).

mod cases;
mod detect;
mod draw;
mod limits;
mod methods;
mod run;
mod shots;
mod still;
mod table;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use evis_core::ConfigError;
use evis_render::{Compute, Gpu};
use serde::{Deserialize, Serialize};

use super::file::{self, VERSION};
use crate::chart::{Progress, Stage, today};
use crate::error::ChartError;
use crate::result::DeviceNote;

pub use limits::{Bound, Limit, limit};
pub use methods::{NamedMethod, methods};

/// This report's kind in JSON.
pub(super) const REPORT: &str = "failures";

/// Tolerances that are scored, in microseconds: that of F1, and one that pairs also what is far off.
const SCORED_US: [i64; 2] = [1000, 5000];

/// What the suite is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureSettings {
    /// The methods, by the names that limits know; see [`methods`].
    pub methods: Vec<NamedMethod>,
    /// Ids of the failures, see [`failures`]; empty for all.
    pub failures: Vec<String>,
    /// Folder that keeps truths; `None` keeps none.
    pub cache: Option<PathBuf>,
    /// Where decoupled sampling evaluates pixels of sensors of two thresholds.
    pub compute: Compute,
}

impl Default for FailureSettings {
    fn default() -> Self {
        Self { methods: methods(), failures: Vec::new(), cache: None, compute: Compute::Cpu }
    }
}

impl FailureSettings {
    /// Checks what can be checked without a device.
    ///
    /// # Errors
    /// A failure that does not exist, no method, or two of one name.
    pub fn check(&self) -> Result<(), ConfigError> {
        cases::chosen(&self.failures)?;
        if self.methods.is_empty() {
            return Err(ConfigError::new("methods", "empty", "at least one"));
        }
        for (i, method) in self.methods.iter().enumerate() {
            if self.methods.iter().take(i).any(|m| m.name == method.name) {
                return Err(ConfigError::new("methods", &method.name, "each named once"));
            }
        }
        Ok(())
    }
}

/// A failure mode, for people.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailureNote {
    /// By which it is asked for.
    pub id: String,
    /// What goes wrong.
    pub title: String,
    /// What the number is.
    pub number: String,
}

/// Every failure that the suite knows, in the order of the table's rows.
pub fn failures() -> Vec<FailureNote> {
    cases::CASES.iter().map(cases::Case::note).collect()
}

/// A number beside the cell's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detail {
    /// What it is.
    pub name: String,
    /// Its value; `None` where there was nothing to take it from.
    pub value: Option<f64>,
}

/// A failure's number for a method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Id of the failure.
    pub failure: String,
    /// Name of the method.
    pub method: String,
    /// The number; `None` where the run gave nothing to take it from.
    pub number: Option<f64>,
    /// Where the number lies with 95 % confidence, for those that say so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// Other numbers about it.
    pub details: Vec<Detail>,
    /// F1 within 1 ms, scaled by image speed, at all pixels of truth; the worst of several shots. `None` where truth has no
    /// events.
    pub f1: Option<f64>,
    /// Median time error of the pairs in microseconds; the worst of several shots.
    pub median_us: Option<f64>,
    /// Events of truth.
    pub truth_events: u64,
    /// Events at the pixels of truth.
    pub events: u64,
    /// Events at pixels whose light does not change.
    pub at_still: u64,
    /// Pixels whose light does not change.
    pub still_pixels: u64,
    /// Events outside the interval of the packet that brought them, or outside the picture.
    pub outside: u64,
    /// Pixels and instants that the method said it could not know.
    pub unknown: u64,
    /// What is claimed; `None` where nothing is.
    pub limit: Option<Limit>,
    /// Which claims do not hold.
    pub faults: Vec<String>,
}

impl Cell {
    /// Whether all that is claimed holds; `None` where nothing is claimed.
    pub fn passed(&self) -> Option<bool> {
        self.limit.as_ref().map(|_| self.faults.is_empty())
    }
}

/// Every failure for every method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailureReport {
    /// [`VERSION`].
    pub evis_verify: u32,
    /// What it is a report of: `failures`.
    pub report: String,
    /// Version of EVIS.
    pub evis: String,
    /// Day, YYYY-MM-DD.
    pub measured: String,
    /// Where it ran.
    pub device: DeviceNote,
    /// See [`FailureSettings::compute`].
    #[serde(default)]
    pub compute: Compute,
    /// Columns.
    pub methods: Vec<NamedMethod>,
    /// Rows.
    pub failures: Vec<FailureNote>,
    /// One per row and column, row by row.
    pub cells: Vec<Cell>,
}

impl FailureReport {
    /// Whether every claim holds.
    pub fn passed(&self) -> bool {
        !self.cells.is_empty() && self.cells.iter().all(|c| c.passed() != Some(false))
    }

    /// The cell of this failure and method.
    pub fn cell(&self, failure: &str, method: &str) -> Option<&Cell> {
        self.cells.iter().find(|c| c.failure == failure && c.method == method)
    }

    /// JSON in one line.
    ///
    /// # Errors
    /// None that could be put right.
    pub fn to_json(&self) -> Result<String, ChartError> {
        file::to_json(self)
    }

    /// Reads what [`FailureReport::to_json`] wrote; `path` names it in errors.
    ///
    /// # Errors
    /// No JSON, another report, or one of another version.
    pub fn from_json(text: &str, path: &Path) -> Result<Self, ChartError> {
        file::from_json(text, REPORT, path)
    }
}

/// Runs every failure that `settings` ask for with every method. `progress` is told what it is busy with and the part of
/// that which is done, from several threads, and stops the work by returning false.
///
/// # Errors
/// A failure that does not exist, a setting that cannot be used, a device that fails, or a stop.
pub fn verify_failures(
    gpu: &Gpu,
    settings: &FailureSettings,
    progress: &Progress<'_>,
) -> Result<FailureReport, ChartError> {
    settings.check()?;
    let cases = cases::chosen(&settings.failures)?;
    let mut ids: Vec<shots::ShotId> = Vec::new();
    for id in cases.iter().flat_map(|case| case.shots) {
        if !ids.contains(id) {
            ids.push(*id);
        }
    }
    // Truth of everything, then runs of everything: each has its own part of the bar.
    let mut known = Vec::with_capacity(ids.len());
    for (i, &id) in ids.iter().enumerate() {
        let told = |part: f64| progress(Stage::Truth, (i as f64 + part) / ids.len() as f64);
        known.push((id, run::Known::new(id, settings.cache.as_deref(), &told)?));
    }
    let total = (known.len() * settings.methods.len()) as f64;
    let mut done = 0.0;
    let mut cells: Vec<Vec<Cell>> = cases.iter().map(|_| Vec::new()).collect();
    for method in &settings.methods {
        let mut runs = Vec::with_capacity(known.len());
        for (id, known) in &known {
            let told = |part: f64| progress(Stage::Runs, (done + part) / total);
            runs.push((*id, run::Run::new(gpu, known, (method, settings.compute), &told)?));
            done += 1.0;
        }
        for (case, cells) in cases.iter().zip(&mut cells) {
            let seen = |id: &shots::ShotId| {
                let (_, known) = known.iter().find(|(k, _)| k == id)?;
                let (_, run) = runs.iter().find(|(k, _)| k == id)?;
                Some(run::Seen { known, run })
            };
            let seen: Vec<_> = case.shots.iter().filter_map(seen).collect();
            cells.push(case.cell(method, &seen)?);
        }
    }
    for cells in &mut cells {
        let native = cells.iter().find(|c| c.method == "native").and_then(|c| c.f1);
        for cell in cells {
            cell.faults = cell.limit.as_ref().map_or_else(Vec::new, |limit| limit.faults(cell, native));
        }
    }
    Ok(FailureReport {
        evis_verify: VERSION,
        report: REPORT.into(),
        evis: env!("CARGO_PKG_VERSION").into(),
        measured: today(),
        device: DeviceNote::of(gpu),
        compute: settings.compute,
        methods: settings.methods.clone(),
        failures: cases.iter().map(|case| case.note()).collect(),
        cells: cells.into_iter().flatten().collect(),
    })
}
