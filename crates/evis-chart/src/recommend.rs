//! Which setting to use: the most accurate within a budget, or the cheapest that is good enough.

use evis_core::{ConfigError, SensorConfig};
use evis_render::config::EVIS_PAPER_LOG_EPS;
use serde::Serialize;

use crate::error::ChartError;
use crate::front::pareto;
use crate::ladder::{Setting, number};
use crate::result::{Criteria, Measure, REAL_TIME_MS, SceneChart, tolerance};

/// What a recommendation is to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// The most accurate within so many milliseconds of work per simulated second.
    Budget(f64),
    /// The cheapest that reaches this F1.
    TargetF1(f64),
}

impl Goal {
    fn check(self) -> Result<(), ConfigError> {
        match self {
            Self::Budget(ms) if !(ms.is_finite() && ms > 0.0) => {
                Err(ConfigError::new("budget", ms, "a number of milliseconds above 0, such as 1000"))
            }
            Self::TargetF1(f1) if !(f1 > 0.0 && f1 <= 1.0) => {
                Err(ConfigError::new("target_f1", f1, "above 0 and at most 1, such as 0.98"))
            }
            _ => Ok(()),
        }
    }
}

/// A setting to use, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recommendation {
    /// What to run.
    pub setting: Setting,
    /// Its label.
    pub label: String,
    /// Milliseconds of work per simulated second.
    pub cost_ms_per_s: f64,
    /// F1 at the scaled tolerance.
    pub f1: f64,
    /// Relative L1 of voxel grids, where it is defined.
    pub voxel_l1: Option<f64>,
    /// The same in a sentence.
    pub sentence: String,
    /// The command that runs it.
    pub command: String,
}

impl Recommendation {
    /// As JSON.
    ///
    /// # Errors
    /// None that could be put right.
    pub fn to_json(&self) -> Result<String, ChartError> {
        serde_json::to_string(self).map_err(|e| ChartError::Draw(format!("no JSON: {e}")))
    }
}

impl SceneChart {
    /// The setting that `goal` asks for.
    ///
    /// # Errors
    /// A goal that makes no sense, or that no measured setting reaches: the nearest one is told.
    pub fn recommend(&self, goal: Goal, criteria: Criteria) -> Result<Recommendation, ChartError> {
        goal.check()?;
        criteria.check()?;
        let places = self.places(Measure::F1 { tolerance_us: criteria.tolerance_us }, criteria);
        let front = pareto(&places);
        let (Some(&cheapest), Some(&best)) = (front.first(), front.last()) else {
            return Err(ChartError::Unreachable(format!(
                "no setting was measured on {}; nothing can be recommended",
                self.scene
            )));
        };
        let f1 = |i: usize| 1.0 - places[i].error;
        let told = |i: usize| {
            format!("{}: F1 {:.3}, {}", self.points[i].setting.label(), f1(i), cost(places[i].cost))
        };
        let (chosen, why) = match goal {
            // Along the front cost rises and the error falls.
            Goal::Budget(ms) => {
                let real_time = if ms == REAL_TIME_MS { " (real time)" } else { "" };
                let budget = format!("{} of work per simulated second{real_time}", milliseconds(ms));
                let within = front.iter().rev().find(|&&i| places[i].cost <= ms).copied();
                let chosen = within.ok_or_else(|| {
                    ChartError::Unreachable(format!(
                        "no setting measured on {} costs at most {budget}; the cheapest is {}; raise `budget_ms`, or \
                         measure lower `rates_hz`",
                        self.scene,
                        told(cheapest)
                    ))
                })?;
                (chosen, format!("Most accurate within {budget}"))
            }
            Goal::TargetF1(target) => {
                let reached = front.iter().find(|&&i| f1(i) >= target).copied();
                let chosen = reached.ok_or_else(|| {
                    ChartError::Unreachable(format!(
                        "no setting measured on {} reaches F1 {target} within {}; the most accurate is {}; lower \
                         `target_f1`, or measure higher `rates_hz` or more `samples`",
                        self.scene,
                        tolerance(criteria.tolerance_us),
                        told(best)
                    ))
                })?;
                (chosen, format!("Cheapest with F1 {target} or better"))
            }
        };
        let point = &self.points[chosen];
        let charge = if criteria.render_ms > 0.0 {
            format!(" (with {} per rendered frame)", milliseconds(criteria.render_ms))
        } else {
            String::new()
        };
        Ok(Recommendation {
            setting: point.setting.clone(),
            label: point.setting.label(),
            cost_ms_per_s: places[chosen].cost,
            f1: f1(chosen),
            voxel_l1: point.score.voxel_l1,
            sentence: format!(
                "{why}: {}, with F1 {:.3} within {} and {}{charge}.",
                point.setting.label(),
                f1(chosen),
                tolerance(criteria.tolerance_us),
                cost(places[chosen].cost)
            ),
            command: self.command(&point.setting),
        })
    }

    /// The command that runs `setting` on this scene.
    pub fn command(&self, setting: &Setting) -> String {
        let default = SensorConfig::default();
        let mut scene = self.run_as.clone().unwrap_or_else(|| shell_quoted(&self.scene));
        if self.of_cameras > 1 {
            scene += &format!(" --camera {}", shell_quoted(&self.camera));
        }
        let mut line = format!(
            "evis run {scene} -o events.h5 --size {}x{} {}",
            self.width,
            self.height,
            setting.run_flags()
        );
        let paper = setting.method == "evis-paper";
        let default_eps = if paper { EVIS_PAPER_LOG_EPS } else { default.log_eps };
        for (flag, value, default) in [
            ("--threshold-on", self.sensor.threshold_on, default.threshold_on),
            ("--threshold-off", self.sensor.threshold_off, default.threshold_off),
            ("--log-eps", self.sensor.log_eps, default_eps),
        ] {
            if value != default {
                line += &format!(" {flag} {value}");
            }
        }
        line
    }
}

/// `word` as a shell takes it.
pub fn shell_quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

fn milliseconds(ms: f64) -> String {
    format!("{} ms", number(ms))
}

/// `640 ms of work per simulated second`.
fn cost(ms_per_s: f64) -> String {
    let decimals = if ms_per_s >= 100.0 {
        0
    } else if ms_per_s >= 10.0 {
        1
    } else {
        2
    };
    format!("{ms_per_s:.decimals$} ms of work per simulated second")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up::scene_chart;
    use crate::result::{Point, f1};

    #[test]
    fn a_budget_buys_the_most_accurate_and_a_target_the_cheapest() {
        let scene = scene_chart("spinner");
        let criteria = Criteria::default();
        let cost = |p: &Point| p.cost(criteria);
        let f1 = |p: &Point| f1(&p.score, 1000);
        let rich = scene.recommend(Goal::Budget(1000.0), criteria).unwrap();
        assert!(rich.cost_ms_per_s <= 1000.0 && rich.sentence.contains("real time"), "{}", rich.sentence);
        assert!(scene.points.iter().all(|p| cost(p) > 1000.0 || f1(p) <= rich.f1));
        let good = scene.recommend(Goal::TargetF1(0.97), criteria).unwrap();
        assert!(good.f1 >= 0.97);
        assert!(scene.points.iter().all(|p| f1(p) < 0.97 || cost(p) >= good.cost_ms_per_s));
        assert!(scene.points.iter().any(|p| cost(p) < good.cost_ms_per_s), "canary: cheaper ones exist");
        assert!(good.command.starts_with("evis run spinner -o events.h5 --size 160x120 --rate "));

        let several = SceneChart { of_cameras: 2, camera: "left eye".into(), ..scene.clone() };
        let command = several.recommend(Goal::Budget(1000.0), criteria).unwrap().command;
        assert!(command.starts_with("evis run spinner --camera 'left eye' -o events.h5"), "{command}");

        let moved = SceneChart { run_as: Some("a.glb --animation Walk".into()), ..several };
        let command = moved.recommend(Goal::Budget(1000.0), criteria).unwrap().command;
        assert!(command.starts_with("evis run a.glb --animation Walk --camera 'left eye' -o"), "{command}");
        let words = [shell_quoted("a b"), shell_quoted("it's"), shell_quoted("x=1")];
        assert_eq!(words, ["'a b'", "'it'\\''s'", "x=1"]);

        // A heavier renderer makes each frame dearer, so fewer frames fit.
        let heavy = scene.recommend(Goal::Budget(6000.0), Criteria { render_ms: 10.0, ..criteria }).unwrap();
        let light = scene.recommend(Goal::Budget(6000.0), criteria).unwrap();
        assert!(heavy.setting.rendered_hz < light.setting.rendered_hz);
        assert!(heavy.sentence.contains("10 ms per rendered frame"), "{}", heavy.sentence);
    }

    #[test]
    fn goals_out_of_reach_name_the_nearest() {
        let scene = scene_chart("spinner");
        let told = |goal| scene.recommend(goal, Criteria::default()).unwrap_err().to_string();
        let poor = told(Goal::Budget(0.001));
        assert!(poor.contains("0.001 ms") && poor.contains("the cheapest is 125 Hz ×1"), "{poor}");
        let high = told(Goal::TargetF1(1.0));
        assert!(high.contains("reaches F1 1 within 1 ms") && high.contains("4000 Hz ×4"), "{high}");
        assert!(told(Goal::Budget(-1.0)).contains("budget is -1"));
        assert!(told(Goal::TargetF1(f64::NAN)).contains("target_f1 is NaN"));
        let criteria = Criteria { tolerance_us: 5, ..Criteria::default() };
        assert!(
            scene
                .recommend(Goal::Budget(1.0), criteria)
                .unwrap_err()
                .to_string()
                .contains("100us, 300us or 1ms")
        );
    }
}
