//! The trigger on closed forms: error of the crossing times against the sampling interval.

use std::fmt::{Display, Formatter};
use std::path::Path;

use evis_core::ConfigError;
use evis_core::closed_form::convergence::{self, Convergence, FLOOR_US, Variant};
use serde::{Deserialize, Serialize};

use super::file::{self, VERSION};
use crate::error::ChartError;

/// This report's kind in JSON.
const REPORT: &str = "closed_forms";

/// How a signal moves between two samples, which decides how well a straight line follows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SignalClass {
    /// It bends, and does so evenly.
    Smooth,
    /// It is straight, in light or in its logarithm.
    Ramp,
    /// An edge passes through a pixel's area: straight in light, with corners.
    Edge,
    /// It jumps.
    Jump,
}

impl SignalClass {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Smooth, Self::Ramp, Self::Edge, Self::Jump];

    /// Title in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Smooth => "smooth",
            Self::Ramp => "ramps",
            Self::Edge => "edges",
            Self::Jump => "jumps",
        }
    }

    fn of(signal: &str) -> Option<Self> {
        Some(match signal {
            "sinusoid" | "spokes" | "sine flicker" => Self::Smooth,
            "linear ramp" | "exponential ramp" => Self::Ramp,
            "edge along an axis" | "edge at 20 degrees" | "bar" => Self::Edge,
            "square flicker" => Self::Jump,
            _ => return None,
        })
    }
}

/// What theory says about a trigger's times on a signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Theory {
    /// The median error falls with this power of the interval.
    Order {
        /// The power.
        order: f64,
        /// How far the fit may be from it.
        within: f64,
    },
    /// All times are exact to the rounding.
    Exact,
}

impl Theory {
    /// What theory says about `variant` on the signal called `signal`.
    fn of(signal: &str, class: SignalClass, variant: Variant) -> Self {
        use Variant::{Crossing, Latch};
        match (class, variant, signal) {
            // At the sample's time, so up to an interval late. That late part is not spread evenly where samples and
            // thresholds have a common measure: steps instead of a line, hence the width.
            (_, Latch, _) => Self::Order { order: 1.0, within: 0.35 },
            // Where in the interval a jump was, no sample tells.
            (SignalClass::Jump, ..) => Self::Order { order: 1.0, within: 0.2 },
            (_, Crossing, "exponential ramp") => Self::Exact,
            // A straight line's distance from a curve.
            _ => Self::Order { order: 2.0, within: 0.25 },
        }
    }
}

impl Display for Theory {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Order { order, within } => write!(f, "order {order} ± {within}"),
            Self::Exact => write!(f, "exact"),
        }
    }
}

/// A trigger on a signal, held against theory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FormCheck {
    /// Kind of signal.
    pub class: SignalClass,
    /// What theory says.
    pub theory: Theory,
    /// What was measured.
    pub measured: Convergence,
    /// What does not agree; `None` where all does.
    pub fault: Option<String>,
}

impl FormCheck {
    /// Holds `measured` against `theory`.
    pub fn new(class: SignalClass, theory: Theory, measured: Convergence) -> Self {
        let fault = fault(theory, &measured);
        Self { class, theory, measured, fault }
    }

    /// Whether theory and measurement agree.
    pub fn passed(&self) -> bool {
        self.fault.is_none()
    }

    /// The fitted order that theory speaks of.
    pub fn order(&self) -> Option<f64> {
        self.measured.order
    }
}

fn fault(theory: Theory, measured: &Convergence) -> Option<String> {
    let Some(last) = measured.rows.last() else { return Some("nothing was measured".into()) };
    let fitted = |order: f64, within: f64, found: Option<f64>| match found {
        None => Some(format!("no order to fit, {order} is expected")),
        Some(found) if (found - order).abs() <= within => None,
        Some(found) => Some(format!("order {found:.2}, {order} ± {within} is expected")),
    };
    let below = || {
        let worst = measured.rows.iter().map(|row| row.rms_us).find(|e| e.is_none_or(|e| e > FLOOR_US))?;
        Some(format!("rms {} us, at most {FLOOR_US} is expected", text(worst)))
    };
    let times = match theory {
        Theory::Order { order, within } => fitted(order, within, measured.order),
        Theory::Exact => below(),
    };
    times.or_else(|| {
        // A latch fires once per sample, however many thresholds were passed: no count is promised.
        let counted = last.count_error == 0 && last.matched == last.expected && last.expected > 0;
        (measured.variant != Variant::Latch && !counted).then(|| {
            format!("{} of {} crossings at the highest rate, all are expected", last.matched, last.expected)
        })
    })
}

/// Every trigger on every closed form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FormsReport {
    /// [`VERSION`].
    pub evis_verify: u32,
    /// What it is a report of: `closed_forms`.
    pub report: String,
    /// Version of EVIS that measured.
    pub evis: String,
    /// By signal, then trigger.
    pub checks: Vec<FormCheck>,
}

/// Measures every trigger on every closed form, and holds it against theory.
///
/// # Errors
/// A closed form that cannot be used: a defect of this program.
pub fn verify_forms() -> Result<FormsReport, ConfigError> {
    let mut checks = Vec::new();
    for measured in convergence::report()? {
        let class = SignalClass::of(&measured.signal).ok_or_else(|| {
            ConfigError::new("signal", &measured.signal, "one that theory is written down for")
        })?;
        let theory = Theory::of(&measured.signal, class, measured.variant);
        checks.push(FormCheck::new(class, theory, measured));
    }
    let evis = env!("CARGO_PKG_VERSION").into();
    Ok(FormsReport { evis_verify: VERSION, report: REPORT.into(), evis, checks })
}

impl FormsReport {
    /// Whether every row agrees with theory, and there is one.
    pub fn passed(&self) -> bool {
        !self.checks.is_empty() && self.checks.iter().all(FormCheck::passed)
    }

    /// JSON in one line.
    ///
    /// # Errors
    /// None that could be put right.
    pub fn to_json(&self) -> Result<String, ChartError> {
        file::to_json(self)
    }

    /// Reads what [`FormsReport::to_json`] wrote; `path` names it in errors.
    ///
    /// # Errors
    /// No JSON, another report, or one of another version.
    pub fn from_json(text: &str, path: &Path) -> Result<Self, ChartError> {
        file::from_json(text, REPORT, path)
    }
}

impl Display for FormsReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "Closed forms: median |time error| in microseconds at each sampling rate.")?;
        let rates = self.checks.first().map_or(&[][..], |c| &c.measured.rows);
        write!(f, "\n{:<18}  {:<15}  {:<18} {:>6}", "signal", "trigger", "theory", "fitted")?;
        for row in rates {
            write!(f, " {:>8}", format!("{:.0} Hz", 1.0 / row.interval_s))?;
        }
        writeln!(f, "  {:>11}", "matched")?;
        for check in &self.checks {
            let Convergence { signal, variant, rows, .. } = &check.measured;
            let order = check.order().map_or_else(|| "-".into(), |o| format!("{o:.2}"));
            write!(f, "{signal:<18}  {:<15}  {:<18} {order:>6}", variant.name(), check.theory.to_string())?;
            for row in rows {
                write!(f, " {:>8}", text(row.median_us))?;
            }
            if let Some(last) = rows.last() {
                write!(f, "  {:>11}", format!("{} of {}", last.matched, last.expected))?;
            }
            match &check.fault {
                None => writeln!(f, "  PASS")?,
                Some(fault) => writeln!(f, "  FAIL: {fault}")?,
            }
        }
        writeln!(
            f,
            "\nmatched: events compared at the highest rate, of all crossings; below 1 us is rounding."
        )?;
        let passed = self.checks.iter().filter(|c| c.passed()).count();
        write!(f, "{passed} of {} rows PASS", self.checks.len())
    }
}

fn text(us: Option<f64>) -> String {
    us.map_or_else(|| "-".into(), |us| format!("{us:.1}"))
}
