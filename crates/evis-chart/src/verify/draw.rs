//! What the reports look like.

use std::path::Path;

use evis_core::closed_form::convergence::{FLOOR_US, Variant};

use super::file;
use super::forms::{FormsReport, SignalClass, Theory};
use super::plot::{Figure, Guide, Line, Panel};
use super::scene::{SceneReport, TIMES_US, at, time_error, variant};
use crate::error::ChartError;
use crate::ladder::number;
use crate::result::Point;

const INTERVAL_TITLE: &str = "sampling interval, µs";
const MEDIAN_TITLE: &str = "median time error, µs";

impl FormsReport {
    /// Draws errors against the interval to `path`, as SVG or PNG by its ending.
    ///
    /// # Errors
    /// Another ending, nothing to draw, a file that cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ChartError> {
        file::save(&forms(self)?, path)
    }
}

impl SceneReport {
    /// Draws errors against the sampling interval to `path`, as SVG or PNG by its ending.
    ///
    /// # Errors
    /// Another ending, nothing to draw, a file that cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ChartError> {
        file::save(&scene(self)?, path)
    }
}

/// A panel per kind of signal.
pub(super) fn forms(report: &FormsReport) -> Result<Figure, ChartError> {
    if report.checks.is_empty() {
        return Err(ChartError::Unreachable("there is nothing measured to draw".into()));
    }
    let panels = SignalClass::ALL.into_iter().map(|class| form_panel(report, class));
    let passed = report.checks.iter().filter(|c| c.passed()).count();
    Ok(Figure {
        title: "Convergence to the closed forms".into(),
        notes: vec![
            "Light is exact here and pixels are integrated in closed form: the error is the trigger's alone."
                .into(),
            format!(
                "{passed} of {} rows fall as theory says; events carry whole microseconds. EVIS {}.",
                report.checks.len(),
                report.evis
            ),
        ],
        families: Variant::ALL.iter().map(|v| v.name().to_owned()).collect(),
        panels: panels.filter(|p| !p.lines.is_empty()).collect(),
    })
}

fn form_panel(report: &FormsReport, class: SignalClass) -> Panel {
    let mut panel = Panel {
        title: class.name().into(),
        x_title: INTERVAL_TITLE.into(),
        y_title: MEDIAN_TITLE.into(),
        floor: Some((FLOOR_US, "rounding".into())),
        ..Panel::default()
    };
    // Guides run below the lines that they belong to.
    let mut guides: Vec<Guide> = Vec::new();
    for check in report.checks.iter().filter(|c| c.class == class) {
        let name = &check.measured.signal;
        let signal = panel.signals.iter().position(|s| s == name).unwrap_or_else(|| {
            panel.signals.push(name.clone());
            panel.signals.len() - 1
        });
        let family = Variant::ALL.iter().position(|v| *v == check.measured.variant).unwrap_or(0);
        let point = |r: &evis_core::closed_form::convergence::Row| Some([r.interval_s * 1e6, r.median_us?]);
        let mut points: Vec<[f64; 2]> = check.measured.rows.iter().filter_map(point).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        if let (Theory::Order { order, .. }, Some(&[x, y])) = (check.theory, points.last()) {
            match guides.iter_mut().find(|g| g.order == order) {
                Some(guide) => guide.through[1] = guide.through[1].min(y / 3.0),
                None => guides.push(Guide { through: [x, y / 3.0], order }),
            }
        }
        panel.lines.push(Line { points, family, signal });
    }
    panel.guides = guides;
    panel
}

/// Events and times.
pub(super) fn scene(report: &SceneReport) -> Result<Figure, ChartError> {
    let chart = &report.chart;
    if chart.points.is_empty() {
        return Err(ChartError::Unreachable("there is nothing measured to draw".into()));
    }
    let mut families: Vec<String> = Vec::new();
    for point in &chart.points {
        let family = family(point);
        if !families.contains(&family) {
            families.push(family);
        }
    }
    let floor = chart.truth.floor.as_ref();
    let missed = |s: &evis_core::metric::Score| at(s, TIMES_US).map(|s| 1.0 - s.f1);
    let panel = |y_title: &str, of: &dyn Fn(&Point) -> Option<f64>, floor: Option<f64>| {
        let lines = families.iter().enumerate().map(|(i, name)| {
            let members = chart.points.iter().filter(|p| family(p) == *name);
            let mut points: Vec<[f64; 2]> =
                members.filter_map(|p| Some([1e6 / p.setting.rate_hz, of(p)?])).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            Line { points, family: i, signal: 0 }
        });
        Panel {
            x_title: INTERVAL_TITLE.into(),
            y_title: y_title.into(),
            lines: lines.collect(),
            floor: floor.filter(|e| *e > 0.0).map(|e| (e, "the oracle's own error".into())),
            ..Panel::default()
        }
    };
    let events = panel("error of events: 1 − F1 within 1 ms", &|p| missed(&p.score), floor.and_then(missed));
    let times = panel(MEDIAN_TITLE, &|p| time_error(&p.score), floor.and_then(time_error));
    Ok(Figure {
        title: format!("Convergence to the oracle: {}", chart.scene),
        notes: vec![
            format!(
                "{}×{} pixels, {} s; truth: {} events in {} pixels. {}. EVIS {}, {}.",
                chart.width,
                chart.height,
                number(chart.duration_us as f64 * 1e-6),
                chart.truth.events,
                chart.truth.pixels,
                chart.device.name,
                chart.evis,
                chart.measured
            ),
            "Within 1 ms, or within 0.1 px of motion; no time error where fewer than half of the events have a partner."
                .into(),
        ],
        families,
        panels: vec![
            Panel { title: "events".into(), ..events },
            Panel { title: "times".into(), ..times },
        ],
    })
}

fn family(point: &Point) -> String {
    let samples = point.setting.samples;
    let unit = if samples == 1 { "sample" } else { "samples" };
    format!("{}, {samples} {unit}", variant(&point.setting).name())
}
