//! What was measured: data that survives as JSON.

use std::path::Path;

use evis_core::metric::{DEFAULT_TOLERANCES_US, Score};
use evis_core::{ConfigError, SensorConfig};
use evis_render::Gpu;
use serde::{Deserialize, Serialize};

use crate::error::ChartError;
use crate::front::{Place, pareto};
use crate::ladder::Setting;

/// Version of the JSON; another one is refused.
pub const VERSION: u32 = 1;

/// Milliseconds of work per simulated second at which a simulation keeps up with the clock.
pub const REAL_TIME_MS: f64 = 1000.0;

/// Charts of one or several scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChartResult {
    /// [`VERSION`].
    pub evis_chart: u32,
    /// One per scene.
    pub scenes: Vec<SceneChart>,
}

/// Everything measured on one scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneChart {
    /// The scene, as it was called, with what was changed.
    pub scene: String,
    /// What `run` is given to open the scene as it was measured: its name or file, and options. `None`: [`Self::scene`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run_as: Option<String>,
    /// The camera.
    pub camera: String,
    /// Cameras of the scene; the others were neither rendered nor timed.
    pub of_cameras: usize,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Scene time at which the stream starts, in microseconds.
    pub start_us: i64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// The camera's sensor; each point sets the trigger rule.
    pub sensor: SensorConfig,
    /// `Y_ref` in `ln(Y / Y_ref + eps)`, the same for truth and every point.
    #[serde(with = "nan_as_null")]
    pub reference_luminance: f64,
    /// Version of EVIS that measured.
    pub evis: String,
    /// Day of the measurement, YYYY-MM-DD in UTC.
    pub measured: String,
    /// What rendered.
    pub device: DeviceNote,
    /// Runs of each setting.
    pub repetitions: usize,
    /// What the points were scored against.
    pub truth: TruthNote,
    /// Settings measured, in the ladder's order.
    pub points: Vec<Point>,
    /// Settings that could not be.
    pub not_measured: Vec<NotMeasured>,
}

/// What rendered.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceNote {
    /// Name that the driver gives.
    pub name: String,
    /// Driver and version.
    pub driver: String,
    /// Cores of the host that the process may use.
    pub cores: usize,
}

impl DeviceNote {
    /// Of `gpu`, and of this process.
    pub(crate) fn of(gpu: &Gpu) -> Self {
        let device = gpu.summary();
        Self {
            name: device.name.clone(),
            driver: device.driver.clone(),
            cores: std::thread::available_parallelism().map_or(0, usize::from),
        }
    }
}

/// What the points were scored against.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TruthNote {
    /// Pixels that it knows.
    pub pixels: usize,
    /// Their events.
    pub events: usize,
    /// How many of them have any; 0 in files of versions that did not count them.
    #[serde(default)]
    pub firing: usize,
    /// Truth's own error, where it is known: two truths with different lattices, scored
    /// against each other on a part of the pixels.
    pub floor: Option<Score>,
    /// Where it comes from, as it says itself.
    pub provenance: serde_json::Value,
}

/// One setting, timed and scored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// What was run.
    pub setting: Setting,
    /// Least milliseconds of preparation: pipelines and uploads, no part of the cost.
    pub setup_ms: f64,
    /// Wall milliseconds of work per simulated second, one per repetition.
    pub wall_ms_per_s: Vec<f64>,
    /// Events fired, all pixels.
    pub events: u64,
    /// Pixel intervals at the limit of events, where some are lost.
    pub clamped: u64,
    /// Hash of the events, the same for each repetition.
    pub hash: String,
    /// Against truth.
    pub score: Score,
}

/// A setting that could not be measured, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NotMeasured {
    /// The setting.
    pub setting: Setting,
    /// Why.
    pub reason: String,
}

/// An error of a stream, 0 at best.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// 1 - F1.
    F1 {
        /// One of [`DEFAULT_TOLERANCES_US`].
        tolerance_us: i64,
    },
    /// Relative L1 of voxel grids.
    Voxel,
}

/// F1 at the scaled tolerance of `tolerance_us`; NaN where it was not scored.
pub fn f1(score: &Score, tolerance_us: i64) -> f64 {
    score.at(tolerance_us).map_or(f64::NAN, |t| t.scaled.f1)
}

impl Measure {
    /// This error of a stream; NaN where it is not defined.
    pub fn of(self, score: &Score) -> f64 {
        match self {
            Self::F1 { tolerance_us } => 1.0 - f1(score, tolerance_us),
            Self::Voxel => score.voxel_l1.unwrap_or(f64::NAN),
        }
    }
}

/// What points are compared by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Criteria {
    /// Tolerance of F1 in microseconds, one of [`DEFAULT_TOLERANCES_US`].
    pub tolerance_us: i64,
    /// Milliseconds that each rendered frame costs on top, as a heavier renderer would.
    pub render_ms: f64,
}

impl Default for Criteria {
    fn default() -> Self {
        Self { tolerance_us: 1000, render_ms: 0.0 }
    }
}

impl Criteria {
    /// Checks both values.
    ///
    /// # Errors
    /// A tolerance that is not scored, a negative or infinite charge.
    pub fn check(&self) -> Result<(), ConfigError> {
        if !DEFAULT_TOLERANCES_US.contains(&self.tolerance_us) {
            return Err(ConfigError::new("f1", format!("{} us", self.tolerance_us), "100us, 300us or 1ms"));
        }
        if !(self.render_ms.is_finite() && (0.0..=1.0e6).contains(&self.render_ms)) {
            return Err(ConfigError::new("render_ms", self.render_ms, "between 0 and 1000000 milliseconds"));
        }
        Ok(())
    }
}

impl Point {
    /// Least milliseconds of work per simulated second, `criteria`'s charge included.
    pub fn cost(&self, criteria: Criteria) -> f64 {
        self.charged(self.wall_ms_per_s.iter().copied().fold(f64::INFINITY, f64::min), criteria)
    }

    /// The slowest repetition's, likewise.
    pub fn slowest(&self, criteria: Criteria) -> f64 {
        self.charged(self.wall_ms_per_s.iter().copied().fold(f64::NEG_INFINITY, f64::max), criteria)
    }

    fn charged(&self, ms_per_s: f64, criteria: Criteria) -> f64 {
        ms_per_s + criteria.render_ms * self.setting.rendered_hz
    }
}

impl SceneChart {
    /// Where each point lies.
    pub fn places(&self, measure: Measure, criteria: Criteria) -> Vec<Place> {
        let place = |p: &Point| Place { cost: p.cost(criteria), error: measure.of(&p.score) };
        self.points.iter().map(place).collect()
    }

    /// Indices of the points that no other one beats, by rising cost.
    pub fn front(&self, measure: Measure, criteria: Criteria) -> Vec<usize> {
        pareto(&self.places(measure, criteria))
    }
}

impl ChartResult {
    /// Charts of `scenes`.
    pub fn new(scenes: Vec<SceneChart>) -> Self {
        Self { evis_chart: VERSION, scenes }
    }

    /// JSON in one line: full scores of many settings, for programs to read.
    ///
    /// # Errors
    /// None that could be put right.
    pub fn to_json(&self) -> Result<String, ChartError> {
        serde_json::to_string(self).map_err(|e| ChartError::Draw(format!("no JSON: {e}")))
    }

    /// Reads JSON that [`ChartResult::to_json`] wrote; `path` names it in errors.
    ///
    /// # Errors
    /// No JSON, not a chart, or a chart of another version; a chart without scenes or points.
    pub fn from_json(text: &str, path: &Path) -> Result<Self, ChartError> {
        let invalid = |reason: String| ChartError::Invalid { path: path.into(), reason };
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|e| invalid(format!("this is no JSON: {e}")))?;
        let version = value.get("evis_chart").and_then(serde_json::Value::as_u64).ok_or_else(|| {
            invalid("this is no chart; `evis chart SCENE --report R.json` writes one".to_owned())
        })?;
        if version != u64::from(VERSION) {
            return Err(invalid(format!(
                "this chart has version {version}, and this program reads version {VERSION}; measure it again, or \
                 read it with the program that wrote it"
            )));
        }
        let chart: Self = serde_json::from_value(value)
            .map_err(|e| invalid(format!("this chart is damaged ({e}); measure it again")))?;
        chart.check().map_err(invalid)?;
        Ok(chart)
    }

    /// Whether there is anything to draw.
    fn check(&self) -> Result<(), String> {
        if self.scenes.is_empty() {
            return Err("this chart has no scene; measure one with `evis chart SCENE`".into());
        }
        for scene in &self.scenes {
            if scene.points.is_empty() {
                return Err(format!("no setting was measured on {}; there is nothing to draw", scene.scene));
            }
            let timed = |p: &Point| {
                !p.wall_ms_per_s.is_empty() && p.wall_ms_per_s.iter().all(|ms| ms.is_finite() && *ms > 0.0)
            };
            if let Some(point) = scene.points.iter().find(|p| !timed(p)) {
                return Err(format!(
                    "{} on {} has no usable time ({:?}); measure it again",
                    point.setting.label(),
                    scene.scene,
                    point.wall_ms_per_s
                ));
            }
            let usable = |s: &Setting| {
                [s.rate_hz, s.rendered_hz].into_iter().all(|hz| hz.is_finite() && hz > 0.0 && hz <= 1.0e6)
            };
            if let Some(point) = scene.points.iter().find(|p| !usable(&p.setting)) {
                return Err(format!("a setting on {} has no usable rate: {:?}", scene.scene, point.setting));
            }
        }
        Ok(())
    }
}

/// `1 ms`, `300 µs`.
pub(crate) fn tolerance(us: i64) -> String {
    if us >= 1000 && us % 1000 == 0 { format!("{} ms", us / 1000) } else { format!("{us} µs") }
}

/// JSON knows no NaN.
mod nan_as_null {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
    pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        value.is_finite().then_some(*value).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::NAN))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::scene_chart;

    #[test]
    fn results_survive_as_json_and_other_versions_are_told() {
        let chart = ChartResult::new(vec![scene_chart("spinner")]);
        let text = chart.to_json().unwrap();
        let path = Path::new("r.json");
        let back = ChartResult::from_json(&text, path).unwrap();
        // Reading decimals may cost the last bit of a number.
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-15 * a.abs();
        let pairs = back.scenes[0].points.iter().zip(&chart.scenes[0].points);
        assert!(
            pairs
                .clone()
                .all(|(a, b)| a.setting == b.setting && close(f1(&a.score, 1000), f1(&b.score, 1000)))
        );
        assert_eq!(pairs.count(), chart.scenes[0].points.len());
        let told = |text: &str| ChartResult::from_json(text, path).unwrap_err().to_string();
        let newer = text.replacen("\"evis_chart\":1", "\"evis_chart\":7", 1);
        assert_ne!(newer, text, "canary: the version is in the text");
        assert!(told(&newer).contains("version 7") && told(&newer).contains("r.json"), "{}", told(&newer));
        assert!(told("{}").contains("this is no chart"));
        assert!(told("scene").contains("no JSON"));
        assert!(told("{\"evis_chart\": 1, \"scenes\": []}").contains("no scene"));
        let mut empty = chart.clone();
        empty.scenes[0].points.clear();
        assert!(told(&empty.to_json().unwrap()).contains("no setting was measured on spinner"));
        let mut untimed = chart;
        untimed.scenes[0].points[0].wall_ms_per_s = vec![0.0];
        assert!(told(&untimed.to_json().unwrap()).contains("no usable time"));
    }
}
