//! A logarithmic axis: where values lie, and which of them get a tick.

use plotters::backend::DrawingBackend;

use crate::error::ChartError;
use crate::plot::canvas::{Align, Canvas};
use crate::plot::ink::{AXIS, FINE_GRID, GRID, TICK};
use crate::plot::label::Rect;

/// Values from `low` to `high` over pixels from `from` to `to`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LogAxis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

/// A tick.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tick {
    pub(crate) value: f64,
    /// None for a fine one.
    pub(crate) label: Option<String>,
}

impl LogAxis {
    /// An axis that holds all of `values` that are above 0, at least a factor of ten long, with these shares of it kept
    /// free below and above.
    pub(crate) fn around(
        values: impl IntoIterator<Item = f64>,
        margins: [f64; 2],
        [from, to]: [f64; 2],
    ) -> Self {
        let (mut low, mut high) = (f64::INFINITY, 0.0_f64);
        for value in values.into_iter().filter(|v| v.is_finite() && *v > 0.0) {
            low = low.min(value);
            high = high.max(value);
        }
        if high == 0.0 {
            (low, high) = (0.1, 1.0);
        }
        let short = 10.0 * low / high;
        if short > 1.0 {
            (low, high) = (low / short.sqrt(), high * short.sqrt());
        }
        let whole = (high / low).ln() / (1.0 - margins[0] - margins[1]);
        (low, high) = (low * (-whole * margins[0]).exp(), high * (whole * margins[1]).exp());
        Self { low, high, from, to }
    }

    /// The same with values up to `limit` at most.
    pub(crate) fn up_to(mut self, limit: f64) -> Self {
        if self.high > limit && self.low < limit / 2.0 {
            self.high = limit;
        }
        self
    }

    pub(crate) fn low(&self) -> f64 {
        self.low
    }

    /// Pixel of `value`; what lies off the axis goes to its end.
    pub(crate) fn at(&self, value: f64) -> f64 {
        let share = (value.max(f64::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln();
        self.from + (self.to - self.from) * share.clamp(0.0, 1.0)
    }

    /// Ticks at 1 to 9 times the powers of ten; short axes label 1, 2 and 5, long ones the powers alone.
    pub(crate) fn ticks(&self) -> Vec<Tick> {
        let decades = (self.high / self.low).log10();
        let labelled: &[u32] = if decades < 2.6 { &[1, 2, 5] } else { &[1] };
        let mut ticks = Vec::new();
        for power in self.low.log10().floor() as i32..=self.high.log10().ceil() as i32 {
            for digit in 1..=9_u32 {
                let value = f64::from(digit) * 10.0_f64.powi(power);
                if value >= self.low * 0.999 && value <= self.high * 1.001 {
                    let label = labelled.contains(&digit).then(|| plain(value));
                    ticks.push(Tick { value, label });
                }
            }
        }
        ticks
    }
}

/// Draws the axes of `plot` with their grid and ticks.
pub(crate) fn draw<DB: DrawingBackend>(
    canvas: &Canvas<DB>,
    plot: &Rect,
    x_axis: &LogAxis,
    y_axis: &LogAxis,
) -> Result<(), ChartError> {
    for fine in [true, false] {
        let colour = if fine { FINE_GRID } else { GRID };
        for tick in x_axis.ticks().iter().filter(|t| t.label.is_none() == fine) {
            let x = x_axis.at(tick.value);
            canvas.line(&[[x, plot.top], [x, plot.bottom]], 1.0, colour)?;
        }
        for tick in y_axis.ticks().iter().filter(|t| t.label.is_none() == fine) {
            let y = y_axis.at(tick.value);
            canvas.line(&[[plot.left, y], [plot.right, y]], 1.0, colour)?;
        }
    }
    for tick in x_axis.ticks() {
        let x = x_axis.at(tick.value);
        let length = if tick.label.is_some() { 5.0 } else { 3.0 };
        canvas.line(&[[x, plot.bottom], [x, plot.bottom + length]], 1.0, AXIS)?;
        if let Some(label) = &tick.label {
            canvas.text(label, [x, plot.bottom + 18.0], Align::Centre, TICK)?;
        }
    }
    for tick in y_axis.ticks() {
        let y = y_axis.at(tick.value);
        let length = if tick.label.is_some() { 5.0 } else { 3.0 };
        canvas.line(&[[plot.left - length, y], [plot.left, y]], 1.0, AXIS)?;
        if let Some(label) = &tick.label {
            canvas.text(label, [plot.left - 8.0, y + 4.2], Align::Right, TICK)?;
        }
    }
    let corner = [plot.left, plot.bottom];
    canvas.line(&[[plot.left, plot.top], corner, [plot.right, plot.bottom]], 1.25, AXIS)
}

/// `0.002`, `20`, `20 000`: digits, no exponent.
fn plain(value: f64) -> String {
    if value < 1.0 {
        let decimals = (-value.log10() + 0.999).floor().clamp(0.0, 12.0) as usize;
        return format!("{value:.decimals$}");
    }
    let digits = format!("{value:.0}");
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        // A narrow space every three digits, where there are more than four.
        if i > 0 && (digits.len() - i).is_multiple_of(3) && digits.len() > 4 {
            out.push('\u{a0}');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decades_lie_evenly() {
        let axis = LogAxis::around([1.0, 1000.0], [0.0; 2], [0.0, 300.0]);
        for (value, pixel) in [(1.0, 0.0), (10.0, 100.0), (100.0, 200.0), (1000.0, 300.0), (0.0, 0.0)] {
            assert!((axis.at(value) - pixel).abs() < 1e-9, "{value}");
        }
        assert_ne!(axis.at(500.0), 150.0, "canary: not a linear axis");
        let labels: Vec<_> = axis.ticks().into_iter().filter_map(|t| t.label).collect();
        assert_eq!(labels, ["1", "10", "100", "1000"]);
    }

    #[test]
    fn narrow_and_empty_ranges_still_make_an_axis() {
        for values in [vec![], vec![0.3], vec![f64::NAN, 0.0, -1.0]] {
            let axis = LogAxis::around(values, [0.1; 2], [0.0, 1.0]);
            assert!(axis.ticks().iter().filter(|t| t.label.is_some()).count() >= 3);
        }
    }

    #[test]
    fn labels_are_plain_digits() {
        let said: Vec<_> = [0.001, 0.02, 0.5, 1.0, 5000.0, 20_000.0].into_iter().map(plain).collect();
        assert_eq!(said, ["0.001", "0.02", "0.5", "1", "5000", "20\u{a0}000"]);
    }
}
