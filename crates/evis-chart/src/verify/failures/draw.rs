//! The suite as a picture: a row per failure, a column per method; a mark, a number, and a bar for F1.

use std::path::Path;

use plotters::backend::DrawingBackend;

use super::table::{f1, short};
use super::{Cell, FailureReport};
use crate::error::ChartError;
use crate::plot::canvas::{Align, Canvas, Drawing, text_width};
use crate::plot::ink::{AXIS_TITLE, FINE_GRID, GRID, HINT, LABEL, LEGEND, SOFT_INK, SUBTITLE, TITLE, WIDER};
use crate::plot::label::Rect;
use crate::plot::marker::{self, Style};
use crate::verify::file;

impl FailureReport {
    /// Draws the table to `path`, as SVG or PNG by its ending.
    ///
    /// # Errors
    /// Another ending, nothing to draw, a file that cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ChartError> {
        file::save(&figure(self)?, path)
    }
}

const MARGIN: f64 = 22.0;
const HEAD: f64 = 92.0;
const ROW: f64 = 41.0;
const COLUMN: f64 = 132.0;
const FOOT: f64 = 44.0;
const BAR: f64 = 64.0;

/// The picture of a report.
pub(super) struct Figure<'a> {
    report: &'a FailureReport,
    /// Width of the column that says what the rows are.
    left: f64,
}

/// Prepares the picture.
pub(super) fn figure(report: &FailureReport) -> Result<Figure<'_>, ChartError> {
    if report.cells.is_empty() {
        return Err(ChartError::Unreachable("there is nothing measured to draw".into()));
    }
    let widths = report
        .failures
        .iter()
        .flat_map(|failure| [text_width(&failure.title, LABEL.em), text_width(&failure.number, HINT.em)]);
    let left = widths.fold(160.0, f64::max) * WIDER + 18.0;
    Ok(Figure { report, left })
}

/// What a mark says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    Kept,
    Broken,
    Unclaimed,
}

impl Mark {
    const ALL: [(Self, &'static str); 3] = [
        (Self::Kept, "the claim holds"),
        (Self::Broken, "it does not"),
        (Self::Unclaimed, "nothing is claimed"),
    ];

    fn of(cell: &Cell) -> Self {
        match cell.passed() {
            Some(true) => Self::Kept,
            Some(false) => Self::Broken,
            None => Self::Unclaimed,
        }
    }

    /// Shape, colour and filling differ, so that each alone tells.
    fn draw<DB: DrawingBackend>(self, canvas: &Canvas<DB>, at: [f64; 2]) -> Result<(), ChartError> {
        match self {
            Self::Kept => marker::draw(canvas, at, Style::nth(1), true),
            Self::Broken => marker::draw(canvas, at, Style::nth(4), true),
            Self::Unclaimed => marker::draw(canvas, at, Style::default(), false),
        }
    }
}

impl Drawing for Figure<'_> {
    fn size(&self) -> [f64; 2] {
        let columns = COLUMN * self.report.methods.len() as f64;
        let rows = ROW * self.report.failures.len() as f64;
        [(MARGIN + self.left + columns + MARGIN).ceil(), (MARGIN + HEAD + rows + FOOT + MARGIN).ceil()]
    }

    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let report = self.report;
        canvas.text("Failure modes against truth", [MARGIN, MARGIN + 17.0], Align::Left, TITLE)?;
        let note = format!(
            "Small scenes; what each row's number is stands below its name. {}, EVIS {}, {}.",
            report.device.name, report.evis, report.measured
        );
        canvas.text(&note, [MARGIN, MARGIN + 40.0], Align::Left, SUBTITLE)?;
        let top = MARGIN + HEAD;
        let right = MARGIN + self.left + COLUMN * report.methods.len() as f64;
        for (k, method) in report.methods.iter().enumerate() {
            let x = MARGIN + self.left + COLUMN * k as f64;
            canvas.text(&method.name, [x, top - 12.0], Align::Left, AXIS_TITLE)?;
        }
        for (i, failure) in report.failures.iter().enumerate() {
            let y = top + ROW * i as f64;
            if i % 2 == 0 {
                canvas.fill(&Rect::new(MARGIN - 6.0, y, right - MARGIN + 6.0, ROW).corners(), FINE_GRID)?;
            }
            canvas.text(&failure.title, [MARGIN, y + 17.0], Align::Left, LABEL)?;
            canvas.text(&failure.number, [MARGIN, y + 33.0], Align::Left, HINT)?;
            for (k, method) in report.methods.iter().enumerate() {
                if let Some(cell) = report.cell(&failure.id, &method.name) {
                    draw_cell(canvas, cell, [MARGIN + self.left + COLUMN * k as f64, y])?;
                }
            }
        }
        self.draw_legend(canvas, top + ROW * report.failures.len() as f64 + 26.0)
    }
}

fn draw_cell<DB: DrawingBackend>(
    canvas: &Canvas<DB>,
    cell: &Cell,
    [x, y]: [f64; 2],
) -> Result<(), ChartError> {
    Mark::of(cell).draw(canvas, [x + 6.0, y + 13.0])?;
    canvas.text(&short(cell.number), [x + 20.0, y + 17.5], Align::Left, LABEL)?;
    if let Some(value) = cell.f1 {
        draw_bar(canvas, [x, y + 26.0], value)?;
        canvas.text(&f1(Some(value)), [x + BAR + 6.0, y + 34.0], Align::Left, HINT)?;
    }
    Ok(())
}

/// A bar whose length is `value`, from 0 to 1.
fn draw_bar<DB: DrawingBackend>(canvas: &Canvas<DB>, [x, y]: [f64; 2], value: f64) -> Result<(), ChartError> {
    canvas.fill(&Rect::new(x, y, BAR, 8.0).corners(), GRID)?;
    canvas.fill(&Rect::new(x, y, BAR * value.clamp(0.0, 1.0), 8.0).corners(), SOFT_INK)
}

impl Figure<'_> {
    fn draw_legend<DB: DrawingBackend>(&self, canvas: &Canvas<DB>, y: f64) -> Result<(), ChartError> {
        let mut x = MARGIN + 6.0;
        for (mark, name) in Mark::ALL {
            mark.draw(canvas, [x, y])?;
            canvas.text(name, [x + 14.0, y + 4.4], Align::Left, LEGEND)?;
            x += 14.0 + text_width(name, LEGEND.em) * WIDER + 24.0;
        }
        draw_bar(canvas, [x, y - 4.0], 0.7)?;
        let name = "F1 within 1 ms, scaled by image speed";
        canvas.text(name, [x + BAR + 8.0, y + 4.4], Align::Left, LEGEND)
    }
}
