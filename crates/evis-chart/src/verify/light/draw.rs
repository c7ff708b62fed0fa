//! Light as a picture of differences: darker is farther off, the hue tells the sign.

use std::path::Path;

use plotters::backend::DrawingBackend;
use plotters::style::RGBColor;

use super::LightReport;
use crate::error::ChartError;
use crate::ladder::number;
use crate::plot::canvas::{Align, Canvas, Colour, Drawing, text_width};
use crate::plot::ink::{AXIS, LEGEND, SUBTITLE, TITLE, WIDER};
use crate::plot::label::Rect;
use crate::verify::file;

impl LightReport {
    /// Draws the differences to `path`, as SVG or PNG by its ending.
    ///
    /// # Errors
    /// Another ending, nothing to draw, a file that cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ChartError> {
        file::save(&figure(self)?, path)
    }
}

const MARGIN: f64 = 22.0;
const HEAD: f64 = 62.0;
const FOOT: f64 = 46.0;
/// Least width of the picture, so that its words fit.
const LEAST: f64 = 640.0;
/// Steps of the scale on either side.
const STEPS: i32 = 12;
/// Difference that is drawn darkest: a threshold.
const DARKEST: f64 = 0.2;

/// The picture of a report.
pub(super) struct Figure<'a> {
    report: &'a LightReport,
    /// Size of a pixel.
    scale: f64,
}

/// Prepares the picture.
pub(super) fn figure(report: &LightReport) -> Result<Figure<'_>, ChartError> {
    let pixels = report.width as usize * report.height as usize;
    if pixels == 0 || report.difference.len() != pixels {
        return Err(ChartError::Unreachable("there is nothing measured to draw".into()));
    }
    Ok(Figure { report, scale: (LEAST / f64::from(report.width)).max(1.0) })
}

/// Which step of the scale `difference` is; the sign tells the side.
fn step(difference: f64) -> i32 {
    // The square root shows a tenth of a threshold, too.
    let part = (difference.abs() / DARKEST).min(1.0).sqrt();
    ((part * f64::from(STEPS)).round() as i32) * if difference < 0.0 { -1 } else { 1 }
}

/// From white to a dark blue (too dark) or a dark orange (too bright).
fn colour(step: i32) -> Colour {
    let part = f64::from(step.abs()) / f64::from(STEPS);
    let end = if step < 0 { [0.0, 60.0, 120.0] } else { [150.0, 50.0, 0.0] };
    let [r, g, b] = end.map(|c| (255.0 + (c - 255.0) * part).round() as u8);
    RGBColor(r, g, b)
}

impl Drawing for Figure<'_> {
    fn size(&self) -> [f64; 2] {
        let [width, height] = [self.report.width, self.report.height].map(|n| f64::from(n) * self.scale);
        [(width + 2.0 * MARGIN).ceil(), (HEAD + height + FOOT + 2.0 * MARGIN).ceil()]
    }

    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let report = self.report;
        canvas.text(
            &format!("Light: engine less oracle, {}", report.scene),
            [MARGIN, MARGIN + 17.0],
            Align::Left,
            TITLE,
        )?;
        let note = format!(
            "{}×{} pixels at {} ms, {} samples; median {:.4}, 95 % {:.4}. EVIS {}, {}.",
            report.width,
            report.height,
            number(report.at_us as f64 * 1e-3),
            report.samples,
            report.all.median,
            report.all.p95,
            report.evis,
            report.measured
        );
        canvas.text(&note, [MARGIN, MARGIN + 40.0], Align::Left, SUBTITLE)?;
        let (top, width) = (MARGIN + HEAD, report.width as usize);
        for (y, row) in report.difference.chunks_exact(width).enumerate() {
            // Neighbours of one colour are one rectangle.
            let mut from = 0;
            for x in 1..=width {
                let own = step(f64::from(row[from]));
                if row.get(x).is_some_and(|d| step(f64::from(*d)) == own) {
                    continue;
                }
                if own != 0 {
                    let [left, above] = [MARGIN + from as f64 * self.scale, top + y as f64 * self.scale];
                    let rect = Rect::new(left, above, (x - from) as f64 * self.scale, self.scale);
                    canvas.fill(&rect.corners(), colour(own))?;
                }
                from = x;
            }
        }
        let [right, below] =
            [MARGIN + width as f64 * self.scale, top + f64::from(report.height) * self.scale];
        let frame = [[MARGIN, top], [right, top], [right, below], [MARGIN, below], [MARGIN, top]];
        canvas.line(&frame, 1.0, AXIS)?;
        draw_scale(canvas, below + 24.0)
    }
}

/// What the colours mean.
fn draw_scale<DB: DrawingBackend>(canvas: &Canvas<DB>, y: f64) -> Result<(), ChartError> {
    const STEP: f64 = 13.0;
    let words = [format!("too dark, −{DARKEST} and less"), format!("too bright, +{DARKEST} and more")];
    let mut x = MARGIN;
    canvas.text(&words[0], [x, y + 4.4], Align::Left, LEGEND)?;
    x += text_width(&words[0], LEGEND.em) * WIDER + 10.0;
    let left = x;
    for step in -STEPS..=STEPS {
        canvas.fill(&Rect::new(x, y - 6.0, STEP, 12.0).corners(), colour(step))?;
        x += STEP;
    }
    canvas.line(
        &[[left, y - 6.0], [x, y - 6.0], [x, y + 6.0], [left, y + 6.0], [left, y - 6.0]],
        1.0,
        AXIS,
    )?;
    canvas.text(&words[1], [x + 10.0, y + 4.4], Align::Left, LEGEND)
}

#[cfg(test)]
mod tests {
    use evis_core::luminance::luminance;

    use super::*;

    #[test]
    fn colours_darken_with_the_size_and_tell_the_sign() {
        let grey = |c: Colour| luminance([c.0, c.1, c.2].map(f64::from));
        assert_eq!((step(0.0), step(0.2), step(-9.0)), (0, STEPS, -STEPS));
        assert!(step(0.01) > 0 && step(-0.01) < 0);
        for k in 0..STEPS {
            for sign in [-1, 1] {
                assert!(
                    grey(colour(sign * (k + 1))) < grey(colour(sign * k)) - 1.0,
                    "{k}: a grey print tells"
                );
            }
        }
        assert_ne!(colour(3), colour(-3));
    }
}
