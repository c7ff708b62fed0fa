//! A figure of panels with logarithmic axes: lines with markers, guides of known slope, a legend.

use plotters::backend::DrawingBackend;
use plotters::style::WHITE;

use crate::error::ChartError;
use crate::plot::axis::{self, LogAxis};
use crate::plot::canvas::{Align, Canvas, Drawing, text_width};
use crate::plot::ink::{AXIS_TITLE, FLOOR, HINT, LEGEND, ROW_TITLE, SOFT_INK, SUBTITLE, TITLE, WIDER};
use crate::plot::label::{Obstacles, Rect, Wanted, place};
use crate::plot::marker::{self, Style};

const MARGIN: f64 = 22.0;
const PLOT_WIDTH: f64 = 452.0;
const PLOT_HEIGHT: f64 = 290.0;
const LEFT: f64 = 66.0;
const BELOW: f64 = 58.0;
const HEAD: f64 = 30.0;
const LINE: f64 = 19.0;
const COLUMNS: usize = 2;
const WIDTH: f64 = COLUMNS as f64 * (LEFT + PLOT_WIDTH + MARGIN);
const KEY: f64 = 24.0;

/// A line of a panel.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    /// Values, from left to right; what has no logarithm is left out.
    pub points: Vec<[f64; 2]>,
    /// Index into [`Figure::families`].
    pub family: usize,
    /// Index into [`Panel::signals`].
    pub signal: usize,
}

/// A straight line of a known order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Guide {
    /// A point that it runs through, its right end.
    pub through: [f64; 2],
    /// Its slope.
    pub order: f64,
}

/// One pair of axes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Panel {
    pub title: String,
    pub x_title: String,
    pub y_title: String,
    /// Names of the dashes; none where there is but one.
    pub signals: Vec<String>,
    pub lines: Vec<Line>,
    pub guides: Vec<Guide>,
    /// A level, and what it is.
    pub floor: Option<(f64, String)>,
}

/// The whole picture.
#[derive(Clone, Debug, Default)]
pub(crate) struct Figure {
    pub title: String,
    pub notes: Vec<String>,
    /// Names of the markers.
    pub families: Vec<String>,
    pub panels: Vec<Panel>,
}

/// Dash and gap of the signals' lines; the first is solid.
const DASHES: [Option<[f64; 2]>; 3] = [None, Some([6.0, 4.0]), Some([1.5, 3.0])];

impl Figure {
    fn head(&self) -> f64 {
        MARGIN + 26.0 + LINE * self.notes.len() as f64 + 8.0
    }

    fn rows(&self) -> usize {
        self.panels.len().div_ceil(COLUMNS)
    }

    /// Families in rows that fit the figure's width.
    fn legend(&self) -> Vec<Vec<(usize, f64)>> {
        let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
        let mut left = f64::INFINITY;
        for (family, name) in self.families.iter().enumerate() {
            let width = KEY + text_width(name, LEGEND.em) * WIDER + 20.0;
            if left + width > WIDTH - MARGIN || rows.is_empty() {
                rows.push(Vec::new());
                left = MARGIN;
            }
            if let Some(row) = rows.last_mut() {
                row.push((family, left));
            }
            left += width;
        }
        rows
    }
}

impl Drawing for Figure {
    fn size(&self) -> [f64; 2] {
        let rows = (HEAD + PLOT_HEIGHT + BELOW) * self.rows() as f64;
        [WIDTH, (self.head() + rows + 14.0 + LINE * self.legend().len() as f64 + MARGIN).ceil()]
    }

    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        canvas.text(&self.title, [MARGIN, MARGIN + 17.0], Align::Left, TITLE)?;
        for (i, note) in self.notes.iter().enumerate() {
            let y = MARGIN + 26.0 + LINE * (i as f64 + 0.75);
            canvas.text(note, [MARGIN, y], Align::Left, SUBTITLE)?;
        }
        for (i, panel) in self.panels.iter().enumerate() {
            let left = LEFT + (i % COLUMNS) as f64 * (LEFT + PLOT_WIDTH + MARGIN);
            let top = self.head() + (i / COLUMNS) as f64 * (HEAD + PLOT_HEIGHT + BELOW);
            panel.draw(canvas, Rect::new(left, top + HEAD, PLOT_WIDTH, PLOT_HEIGHT))?;
        }
        let mut y = self.head() + (HEAD + PLOT_HEIGHT + BELOW) * self.rows() as f64 + 14.0 + LINE / 2.0;
        for row in self.legend() {
            for (family, left) in row {
                let style = Style::nth(family);
                canvas.line(&[[left, y], [left + KEY - 6.0, y]], 1.25, marker::pale(style.colour))?;
                marker::draw(canvas, [left + KEY / 2.0 - 3.0, y], style, true)?;
                let name = self.families.get(family).map_or("", String::as_str);
                canvas.text(name, [left + KEY, y + 4.4], Align::Left, LEGEND)?;
            }
            y += LINE;
        }
        Ok(())
    }
}

impl Panel {
    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>, plot: Rect) -> Result<(), ChartError> {
        let drawn = || self.lines.iter().flat_map(|l| l.points.iter().copied()).filter(|p| usable(*p));
        let floor = self.floor.as_ref().map(|f| f.0);
        let x = LogAxis::around(drawn().map(|p| p[0]), [0.04, 0.04], [plot.left, plot.right]);
        let y = LogAxis::around(drawn().map(|p| p[1]).chain(floor), [0.06, 0.06], [plot.bottom, plot.top]);
        self.draw_title(canvas, &plot)?;
        axis::draw(canvas, &plot, &x, &y)?;
        let centre = (plot.left + plot.right) / 2.0;
        canvas.text(&self.x_title, [centre, plot.bottom + 39.0], Align::Centre, AXIS_TITLE)?;
        let middle = (plot.top + plot.bottom) / 2.0;
        canvas.text_upward(&self.y_title, [plot.left - 48.0, middle], AXIS_TITLE)?;

        let at = |p: [f64; 2]| [x.at(p[0]), y.at(p[1])];
        let mut segments: Vec<[[f64; 2]; 2]> = Vec::new();
        let mut named: Vec<(String, Vec<[f64; 2]>)> = Vec::new();
        if let Some((level, name)) = &self.floor {
            let ends = [[plot.left, y.at(*level)], [plot.right, y.at(*level)]];
            canvas.dashes(ends, 1.5, [2.0, 3.0], FLOOR)?;
            segments.push(ends);
            named.push((name.clone(), along(ends)));
        }
        for guide in &self.guides {
            let lowest = drawn().map(|p| p[0]).fold(guide.through[0], f64::min);
            let left = guide.at(lowest);
            // Down to the axis, if it comes there first.
            let left = if left[1] < y.low() { guide.down_to(y.low()) } else { left };
            let ends = [at(left), at(guide.through)];
            canvas.dashes(ends, 1.0, [7.0, 4.0], SOFT_INK)?;
            segments.push(ends);
            named.push((format!("order {}", guide.order), along(ends)));
        }
        let mut solid = Vec::new();
        for line in &self.lines {
            let points: Vec<_> = line.points.iter().filter(|p| usable(**p)).map(|p| at(*p)).collect();
            let colour = marker::pale(Style::nth(line.family).colour);
            for pair in points.windows(2) {
                let &[from, to] = pair else { continue };
                match DASHES[line.signal % DASHES.len()] {
                    None => canvas.line(&[from, to], 1.25, colour)?,
                    Some(dash) => canvas.dashes([from, to], 1.5, dash, colour)?,
                }
                segments.push([from, to]);
            }
            solid.extend(points.iter().map(|p| Rect::around(*p, marker::RADIUS + 1.0)));
        }
        for line in &self.lines {
            for point in line.points.iter().filter(|p| usable(**p)) {
                marker::draw(canvas, at(*point), Style::nth(line.family), true)?;
            }
        }
        draw_names(canvas, &named, plot, &solid, &segments)
    }

    /// The title, and what each dash stands for.
    fn draw_title<DB: DrawingBackend>(&self, canvas: &Canvas<DB>, plot: &Rect) -> Result<(), ChartError> {
        let base = plot.top - 12.0;
        canvas.text(&self.title, [plot.left, base], Align::Left, ROW_TITLE)?;
        let mut left = plot.left + text_width(&self.title, ROW_TITLE.em) * WIDER + 18.0;
        for (i, name) in self.signals.iter().enumerate() {
            let ends = [[left, base - 4.0], [left + KEY, base - 4.0]];
            match DASHES[i % DASHES.len()] {
                None => canvas.line(&ends, 1.25, SOFT_INK)?,
                Some(dash) => canvas.dashes(ends, 1.5, dash, SOFT_INK)?,
            }
            canvas.text(name, [left + KEY + 5.0, base], Align::Left, SUBTITLE)?;
            left += KEY + text_width(name, SUBTITLE.em) * WIDER + 20.0;
        }
        Ok(())
    }
}

/// Names of lines, each beside its own.
fn draw_names<DB: DrawingBackend>(
    canvas: &Canvas<DB>,
    named: &[(String, Vec<[f64; 2]>)],
    plot: Rect,
    solid: &[Rect],
    segments: &[[[f64; 2]; 2]],
) -> Result<(), ChartError> {
    let wanted: Vec<_> = named
        .iter()
        .map(|(name, at)| Wanted {
            at: at.clone(),
            rim: 1.5,
            width: text_width(name, HINT.em) * WIDER,
            height: HINT.em,
            required: true,
        })
        .collect();
    let bounds = Rect::new(plot.left + 4.0, plot.top + 2.0, plot.width() - 4.0, plot.height() - 6.0);
    let placed = place(&wanted, &Obstacles { bounds, solid, lines: segments });
    for ((name, _), placed) in named.iter().zip(placed) {
        let Some(placed) = placed else { continue };
        canvas.fill(&placed.rect.corners(), WHITE)?;
        let middle = (placed.rect.left + placed.rect.right) / 2.0;
        canvas.text(name, [middle, placed.rect.bottom - 2.2], Align::Centre, HINT)?;
    }
    Ok(())
}

impl Guide {
    fn at(&self, x: f64) -> [f64; 2] {
        [x, self.through[1] * (x / self.through[0]).powf(self.order)]
    }

    fn down_to(&self, y: f64) -> [f64; 2] {
        [self.through[0] * (y / self.through[1]).powf(1.0 / self.order), y]
    }
}

/// Points along a straight line, those near its right end first.
fn along([from, to]: [[f64; 2]; 2]) -> Vec<[f64; 2]> {
    (0..9)
        .map(|k| {
            let s = 0.9 - 0.1 * f64::from(k);
            [from[0] + (to[0] - from[0]) * s, from[1] + (to[1] - from[1]) * s]
        })
        .collect()
}

fn usable(point: [f64; 2]) -> bool {
    point.into_iter().all(|v| v.is_finite() && v > 0.0)
}
