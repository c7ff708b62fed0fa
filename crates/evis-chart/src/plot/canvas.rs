//! A sheet to draw on: plotters with fractional coordinates, dashes, baselines, and one font.

use std::sync::OnceLock;

use ab_glyph::{Font, FontRef};
use plotters::backend::{BitMapBackend, DrawingBackend, SVGBackend};
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Polygon, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{
    Color, FontDesc, FontFamily, FontStyle, FontTransform, RGBColor, ShapeStyle, TextStyle, WHITE,
};

use crate::error::ChartError;
use crate::plot::indexed;

/// Backends count in whole pixels; this many of them make one of ours, for smooth curves and even gaps.
const FINE: f64 = 4.0;

/// PNG pixels per unit of ours: sharp on dense screens and in print.
const PNG_SCALE: usize = 2;

/// Family of every text. The bitmap takes the embedded font of this name, an SVG's viewer the first that it has.
const FAMILY: &str = "Ubuntu, Helvetica, Arial, sans-serif";

/// Height from ascender to descender of the embedded font, in ems: 932 + 189 of 1000.
const FONT_HEIGHT_EM: f64 = 1.121;

pub(crate) type Colour = RGBColor;

/// Which side of its place a text lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Align {
    Left,
    Centre,
    Right,
}

/// What a text is set in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Type {
    /// Size of an em.
    pub(crate) em: f64,
    pub(crate) colour: Colour,
}

/// How a backend places text: plotters' SVG and bitmap backends differ in both.
#[derive(Clone, Copy)]
struct Medium {
    /// Size to ask for, per em.
    size: f64,
    /// From a text's top anchor down to its baseline, in ems.
    baseline: f64,
    /// Whether the backend sets a text as one piece.
    whole: bool,
}

/// plotters divides sizes by 1.24, and sets the top at 0.76 em above the baseline.
const SVG: Medium = Medium { size: 1.24, baseline: 0.76, whole: true };

/// The bitmap's size is the font's height, and its baseline lies at half of it.
const BITMAP: Medium = Medium { size: FONT_HEIGHT_EM, baseline: FONT_HEIGHT_EM / 2.0, whole: false };

/// The embedded font: Ubuntu Light, under the Ubuntu font licence, which lets it be embedded and pictures made with it
/// be used freely. plotters keeps fonts in a table of its own, by name; it is registered there once per process.
fn font() -> Result<&'static FontRef<'static>, ChartError> {
    static FONT: OnceLock<Option<FontRef<'static>>> = OnceLock::new();
    let found = FONT.get_or_init(|| {
        let bytes = epaint_default_fonts::UBUNTU_LIGHT;
        plotters::style::register_font(FAMILY, FontStyle::Normal, bytes).ok()?;
        FontRef::try_from_slice(bytes).ok()
    });
    found.as_ref().ok_or_else(|| ChartError::Draw("the embedded font cannot be read".into()))
}

/// Where each glyph of `text` starts, in ems, and how long the text is.
fn glyphs(font: &FontRef<'_>, text: &str) -> (Vec<(char, f64)>, f64) {
    let per_em = f64::from(font.units_per_em().unwrap_or(1000.0));
    let mut pen = 0.0;
    let mut before = None;
    let mut starts = Vec::with_capacity(text.len());
    for c in text.chars() {
        let glyph = font.glyph_id(c);
        if let Some(before) = before {
            pen += f64::from(font.kern_unscaled(before, glyph)) / per_em;
        }
        // plotters draws a glyph from its first inked column on and forgets the bearing before it.
        starts.push((c, pen + f64::from(font.h_side_bearing_unscaled(glyph)) / per_em));
        pen += f64::from(font.h_advance_unscaled(glyph)) / per_em;
        before = Some(glyph);
    }
    (starts, pen)
}

/// Width of `text` in the embedded font at this em.
pub(crate) fn text_width(text: &str, em: f64) -> f64 {
    font().map_or(0.0, |font| glyphs(font, text).1 * em)
}

/// A sheet.
pub(crate) struct Canvas<DB: DrawingBackend> {
    area: DrawingArea<DB, Shift>,
    medium: Medium,
}

fn fine(value: f64) -> i32 {
    (value * FINE).round().clamp(-1.0e6, 1.0e6) as i32
}

fn at([x, y]: [f64; 2]) -> (i32, i32) {
    (fine(x), fine(y))
}

fn failed(error: impl std::fmt::Display) -> ChartError {
    ChartError::Draw(error.to_string())
}

impl<DB: DrawingBackend> Canvas<DB> {
    /// A filled polygon.
    pub(crate) fn fill(&self, corners: &[[f64; 2]], colour: Colour) -> Result<(), ChartError> {
        let corners: Vec<_> = corners.iter().map(|p| at(*p)).collect();
        self.area.draw(&Polygon::new(corners, colour.filled())).map_err(failed)
    }

    /// A filled circle.
    pub(crate) fn disc(&self, centre: [f64; 2], radius: f64, colour: Colour) -> Result<(), ChartError> {
        let radius = fine(radius).max(1);
        self.area.draw(&Circle::new(at(centre), radius, colour.filled())).map_err(failed)
    }

    /// A line through `points`.
    pub(crate) fn line(&self, points: &[[f64; 2]], width: f64, colour: Colour) -> Result<(), ChartError> {
        let mut fine_points: Vec<_> = points.iter().map(|p| at(*p)).collect();
        fine_points.dedup();
        if fine_points.len() < 2 {
            return Ok(());
        }
        let style =
            ShapeStyle { color: colour.to_rgba(), filled: false, stroke_width: fine(width).max(1) as u32 };
        self.area.draw(&PathElement::new(fine_points, style)).map_err(failed)
    }

    /// A dashed straight line.
    pub(crate) fn dashes(
        &self,
        [a, b]: [[f64; 2]; 2],
        width: f64,
        [dash, gap]: [f64; 2],
        colour: Colour,
    ) -> Result<(), ChartError> {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].hypot(along[1]);
        let point = |s: f64| [a[0] + along[0] * s / length, a[1] + along[1] * s / length];
        let mut from = 0.0;
        while from < length {
            self.line(&[point(from), point((from + dash).min(length))], width, colour)?;
            from += dash + gap;
        }
        Ok(())
    }

    /// A text whose baseline runs through `place`.
    pub(crate) fn text(
        &self,
        text: &str,
        place: [f64; 2],
        align: Align,
        set: Type,
    ) -> Result<(), ChartError> {
        self.set(text, place, align, set, FontTransform::None)
    }

    /// The same, turned to be read from below; it is centred at `place`.
    pub(crate) fn text_upward(&self, text: &str, place: [f64; 2], set: Type) -> Result<(), ChartError> {
        self.set(text, place, Align::Centre, set, FontTransform::Rotate270)
    }

    fn set(
        &self,
        text: &str,
        [x, y]: [f64; 2],
        align: Align,
        set: Type,
        turn: FontTransform,
    ) -> Result<(), ChartError> {
        let drop = set.em * self.medium.baseline;
        // `along` runs with the text, from the place on.
        let anchor = |along: f64| match turn {
            FontTransform::Rotate270 => at([x - drop, y - along]),
            _ => at([x + along, y - drop]),
        };
        let size = set.em * self.medium.size * FINE;
        let desc = FontDesc::new(FontFamily::Name(FAMILY), size, FontStyle::Normal).transform(turn.clone());
        let style = |horizontal| {
            TextStyle::from(desc.clone()).color(&set.colour).pos(Pos::new(horizontal, VPos::Top))
        };
        if self.medium.whole {
            let style = style(match align {
                Align::Left => HPos::Left,
                Align::Centre => HPos::Center,
                Align::Right => HPos::Right,
            });
            return self.area.draw(&Text::new(text.to_owned(), anchor(0.0), style)).map_err(failed);
        }
        let (glyphs, length) = glyphs(font()?, text);
        let start = match align {
            Align::Left => 0.0,
            Align::Centre => -length / 2.0,
            Align::Right => -length,
        };
        for (glyph, from) in glyphs {
            let place = anchor((start + from) * set.em);
            let glyph = Text::new(glyph.to_string(), place, style(HPos::Left));
            self.area.draw(&glyph).map_err(failed)?;
        }
        Ok(())
    }

    fn finish(self) -> Result<(), ChartError> {
        self.area.present().map_err(failed)
    }
}

/// What is drawn on a sheet, of either kind.
pub(crate) trait Drawing {
    /// Width and height.
    fn size(&self) -> [f64; 2];
    /// Draws it.
    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError>;
}

fn on<DB: DrawingBackend>(backend: DB, medium: Medium, drawing: &impl Drawing) -> Result<(), ChartError> {
    font()?;
    let canvas = Canvas { area: backend.into_drawing_area(), medium };
    canvas.area.fill(&WHITE).map_err(failed)?;
    drawing.draw(&canvas)?;
    canvas.finish()
}

/// `drawing` as SVG.
pub(crate) fn svg(drawing: &impl Drawing) -> Result<String, ChartError> {
    let [width, height] = drawing.size();
    let (fine_width, fine_height) = (fine(width).max(1) as u32, fine(height).max(1) as u32);
    let mut text = String::new();
    on(SVGBackend::with_string(&mut text, (fine_width, fine_height)), SVG, drawing)?;
    // The backend gives the picture the size of its own pixels; its view box already is in them.
    let told = format!("width=\"{fine_width}\" height=\"{fine_height}\"");
    Ok(text.replacen(&told, &format!("width=\"{width:.0}\" height=\"{height:.0}\""), 1))
}

/// `drawing` as PNG.
pub(crate) fn png(drawing: &impl Drawing) -> Result<Vec<u8>, ChartError> {
    let [width, height] = drawing.size();
    let shrink = FINE as usize / PNG_SCALE;
    let (columns, rows) = (width.ceil() as usize * PNG_SCALE, height.ceil() as usize * PNG_SCALE);
    let (fine_columns, fine_rows) = (columns * shrink, rows * shrink);
    let mut fine_pixels = vec![255; fine_columns * fine_rows * 3];
    on(
        BitMapBackend::with_buffer(&mut fine_pixels, (fine_columns as u32, fine_rows as u32)),
        BITMAP,
        drawing,
    )?;
    let mut pixels = Vec::with_capacity(columns * rows * 3);
    for row in 0..rows {
        for column in 0..columns {
            for channel in 0..3 {
                let sum: usize = (0..shrink * shrink)
                    .map(|k| {
                        let (x, y) = (column * shrink + k % shrink, row * shrink + k / shrink);
                        usize::from(fine_pixels[(y * fine_columns + x) * 3 + channel])
                    })
                    .sum();
                pixels.push((sum / (shrink * shrink)) as u8);
            }
        }
    }
    indexed::png(columns as u32, rows as u32, &pixels)
}
