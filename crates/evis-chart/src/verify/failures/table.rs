//! The suite as text.

use std::fmt::{Display, Formatter};

use evis_core::Word;
use evis_render::Compute;

use super::{Cell, FailureReport};

/// Width of the column of ids, and least width of a method's.
const ID: usize = 18;
const COLUMN: usize = 14;

/// A number in three or four digits.
pub(super) fn short(value: Option<f64>) -> String {
    let Some(x) = value else { return "-".into() };
    match x.abs() {
        _ if x == 0.0 => "0".into(),
        a if a >= 100.0 => format!("{x:.0}"),
        a if a >= 10.0 => format!("{x:.1}"),
        a if a >= 0.0995 => format!("{x:.2}"),
        a if a >= 0.001 => format!("{x:.3}"),
        _ => format!("{x:.1e}"),
    }
}

/// F1 with as many digits as it takes to tell 0.98 from 0.985.
pub(super) fn f1(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |f1| format!("{f1:.3}"))
}

impl FailureReport {
    /// A line per failure, a column per method.
    fn matrix(&self, f: &mut Formatter<'_>, head: &str, cell: impl Fn(&Cell) -> String) -> std::fmt::Result {
        write!(f, "{head:<ID$}")?;
        for method in &self.methods {
            write!(f, " {:>COLUMN$}", method.name)?;
        }
        for failure in &self.failures {
            write!(f, "\n{:<ID$}", failure.id)?;
            for method in &self.methods {
                let told = self.cell(&failure.id, &method.name).map_or_else(|| "-".into(), &cell);
                write!(f, " {told:>COLUMN$}")?;
            }
        }
        writeln!(f)
    }
}

impl Display for FailureReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "Failure modes, small scenes against truth; {}, EVIS {}, {}\n",
            self.device.name, self.evis, self.measured
        )?;
        for method in &self.methods {
            writeln!(f, "{:<ID$} {}", method.name, method.setting.label())?;
        }
        if self.compute == Compute::Gpu {
            writeln!(f, "Pixels of decoupled sampling: {}", self.compute.about())?;
        }
        writeln!(f)?;
        self.matrix(f, "number", |cell| match cell.passed() {
            None => format!("{}     ", short(cell.number)),
            Some(true) => format!("{} ok  ", short(cell.number)),
            Some(false) => format!("{} FAIL", short(cell.number)),
        })?;
        writeln!(
            f,
            "\nok, FAIL: whether what is claimed holds; nothing: nothing is claimed. The numbers are:\n"
        )?;
        for failure in &self.failures {
            writeln!(f, "{:<ID$} {}: {}", failure.id, failure.title, failure.number)?;
        }
        writeln!(f, "\nF1 within 1 ms, scaled by image speed, and median time error in microseconds:\n")?;
        self.matrix(f, "F1, time error", |cell| format!("{} {:>6}", f1(cell.f1), short(cell.median_us)))?;
        writeln!(
            f,
            "\nEvents at pixels whose light does not change / outside their packet / pixels and instants unknown:\n"
        )?;
        self.matrix(f, "spurious", |cell| {
            let still = if cell.still_pixels == 0 { "-".into() } else { cell.at_still.to_string() };
            format!("{still} / {} / {}", cell.outside, cell.unknown)
        })?;
        writeln!(f, "\nMore about each:\n")?;
        for cell in self.cells.iter().filter(|c| !c.details.is_empty() || c.interval.is_some()) {
            let interval = cell.interval.iter().map(|[low, high]| {
                format!("95 % confidence {} to {}", short(Some(*low)), short(Some(*high)))
            });
            let details = cell.details.iter().map(|d| format!("{} {}", d.name, short(d.value)));
            let told: Vec<String> = interval.chain(details).collect();
            writeln!(f, "{:<ID$} {:<COLUMN$} {}", cell.failure, cell.method, told.join("; "))?;
        }
        let claimed: Vec<&Cell> = self.cells.iter().filter(|c| c.limit.is_some()).collect();
        let kept = claimed.iter().filter(|c| c.faults.is_empty()).count();
        if kept < claimed.len() {
            writeln!(f, "\nWhat does not hold:\n")?;
            for cell in claimed.iter().filter(|c| !c.faults.is_empty()) {
                let reason = cell.limit.as_ref().map_or("", |limit| limit.reason.as_str());
                writeln!(
                    f,
                    "{:<ID$} {:<COLUMN$} {} ({reason})",
                    cell.failure,
                    cell.method,
                    cell.faults.join("; ")
                )?;
            }
        }
        match claimed.len() {
            0 => write!(f, "\nNothing is claimed of these methods"),
            all => write!(f, "\n{kept} of {all} claims hold"),
        }
    }
}
