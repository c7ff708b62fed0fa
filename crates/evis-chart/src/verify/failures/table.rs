//! The suite as text.

use std::fmt::{Display, Formatter};

use super::{Cell, FailureReport};

/// A number in four significant digits and few characters.
pub(super) fn short(value: Option<f64>) -> String {
    let Some(x) = value else { return "-".into() };
    match x.abs() {
        _ if x == 0.0 => "0".into(),
        a if a >= 1000.0 => format!("{x:.0}"),
        a if a >= 100.0 => format!("{x:.1}"),
        a if a >= 10.0 => format!("{x:.2}"),
        a if a >= 0.001 => format!("{x:.3}"),
        _ => format!("{x:.1e}"),
    }
}

impl FailureReport {
    fn row<'a>(&'a self, failure: &'a str) -> impl Iterator<Item = &'a Cell> {
        self.methods.iter().filter_map(move |m| self.cell(failure, &m.name))
    }
}

impl Display for FailureReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        for failure in &self.failures {
            writeln!(f, "{}: {} ({})", failure.id, failure.title, failure.number)?;
            for cell in self.row(&failure.id) {
                write!(f, "  {:<14} {:>9}", cell.method, short(cell.number))?;
                if let Some([low, high]) = cell.interval {
                    write!(f, " ({low:.2}-{high:.2})")?;
                }
                write!(f, "  F1 {:>6} median {:>6} us", short(cell.f1), short(cell.median_us))?;
                write!(f, "  events {}/{} still {}@{} out {} unknown {}", cell.events, cell.truth_events, cell.at_still, cell.still_pixels, cell.outside, cell.unknown)?;
                for d in &cell.details {
                    write!(f, "; {} {}", d.name, short(d.value))?;
                }
                writeln!(f)?;
            }
        }
        Ok(())
    }
}
