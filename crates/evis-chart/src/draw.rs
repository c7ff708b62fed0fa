//! The picture: a row of two panels per scene, cost against two errors.

use std::path::Path;

use plotters::backend::DrawingBackend;

use crate::error::ChartError;
use crate::ladder::number;
use crate::panel::Panel;
use crate::plot::canvas::{self, Align, Canvas, Drawing, text_width};
use crate::plot::ink::{FRONT, LEGEND, ROW_TITLE, SOFT_INK, SUBTITLE, TITLE, WIDER};
use crate::plot::label::Rect;
use crate::plot::marker::{self, Style};
use crate::result::{ChartResult, Criteria, Measure, SceneChart, tolerance};

const MARGIN: f64 = 22.0;
const PANEL_WIDTH: f64 = 452.0;
const PANEL_HEIGHT: f64 = 336.0;
/// For a panel's ticks and title on its left.
const LEFT: f64 = 66.0;
const WIDTH: f64 = 2.0 * (LEFT + PANEL_WIDTH + MARGIN);
/// For a panel's ticks and title below it.
const BELOW: f64 = 58.0;
const ROW_HEAD: f64 = 34.0;
const LINE: f64 = 19.0;

/// Rows beyond which a figure becomes too large to read.
const MAX_SCENES: usize = 24;

/// What a picture's ending asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureKind {
    /// Pixels.
    Png,
    /// Shapes and text.
    Svg,
}

impl PictureKind {
    /// By the ending of `path`.
    ///
    /// # Errors
    /// Any ending but .png and .svg.
    pub fn of(path: &Path) -> Result<Self, evis_core::ConfigError> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match ending.as_deref() {
            Some("png") => Ok(Self::Png),
            Some("svg") => Ok(Self::Svg),
            _ => Err(evis_core::ConfigError::new(
                "output",
                path.display(),
                "a picture whose name ends with .png or .svg",
            )),
        }
    }
}

/// Draws `chart` and writes it to `path`, as SVG or PNG by its ending.
///
/// # Errors
/// See [`svg`]; another ending; a file that cannot be written.
pub fn save(chart: &ChartResult, criteria: Criteria, path: &Path) -> Result<(), ChartError> {
    let bytes = match PictureKind::of(path)? {
        PictureKind::Png => png(chart, criteria)?,
        PictureKind::Svg => svg(chart, criteria)?.into_bytes(),
    };
    evis_core::limits::write_whole(path, &bytes)
        .map_err(|source| ChartError::Io { path: path.into(), source })
}

/// `chart` as SVG.
///
/// # Errors
/// Nothing to draw, too many scenes for a figure, criteria that make no sense.
pub fn svg(chart: &ChartResult, criteria: Criteria) -> Result<String, ChartError> {
    canvas::svg(&Figure::new(chart, criteria)?)
}

/// `chart` as PNG, two pixels for each of the SVG's.
///
/// # Errors
/// As [`svg`].
pub fn png(chart: &ChartResult, criteria: Criteria) -> Result<Vec<u8>, ChartError> {
    canvas::png(&Figure::new(chart, criteria)?)
}

/// A picture to draw.
struct Figure<'a> {
    chart: &'a ChartResult,
    criteria: Criteria,
    /// Every family of settings, and its marker.
    families: Vec<(String, Style)>,
    title: String,
    notes: Vec<String>,
    footnotes: Vec<String>,
    legend: Vec<Vec<Entry>>,
}

/// An entry of the legend.
#[derive(Clone, Debug)]
struct Entry {
    sample: Sample,
    text: String,
}

#[derive(Clone, Copy, Debug)]
enum Sample {
    Marker(Style),
    Front,
    Spread,
    Beaten,
}

/// Width of an entry's sample, and what follows its text.
const SAMPLE_WIDTH: f64 = 24.0;
const ENTRY_GAP: f64 = 20.0;

impl<'a> Figure<'a> {
    fn new(chart: &'a ChartResult, criteria: Criteria) -> Result<Self, ChartError> {
        criteria.check()?;
        if chart.scenes.len() > MAX_SCENES {
            return Err(ChartError::Draw(format!(
                "{} scenes do not fit into one figure; draw at most {MAX_SCENES} at a time",
                chart.scenes.len()
            )));
        }
        if chart.scenes.iter().all(|s| s.points.is_empty()) {
            return Err(ChartError::Unreachable(
                "there is no measured setting to draw; measure at least one".into(),
            ));
        }
        let families = families(chart);
        let title = match chart.scenes.as_slice() {
            [one] => format!("Speed against accuracy: {}", scene_name(one)),
            _ => "Speed against accuracy".to_owned(),
        };
        let mut figure = Self {
            chart,
            criteria,
            families,
            title,
            notes: notes(chart, criteria),
            footnotes: footnotes(chart),
            legend: Vec::new(),
        };
        figure.legend = rows_of(figure.entries());
        Ok(figure)
    }

    fn entries(&self) -> Vec<Entry> {
        let mut entries: Vec<_> = self
            .families
            .iter()
            .map(|(name, style)| Entry { sample: Sample::Marker(*style), text: name.clone() })
            .collect();
        let mut add = |sample, text: &str| entries.push(Entry { sample, text: text.into() });
        add(Sample::Front, "Pareto front (its points filled)");
        add(Sample::Beaten, "beaten by another setting");
        if self.chart.scenes.iter().any(|s| s.repetitions > 1) {
            add(Sample::Spread, "to the slowest run");
        }
        entries
    }

    fn head(&self) -> f64 {
        MARGIN + 26.0 + LINE * self.notes.len() as f64 + 8.0
    }

    fn row_height(&self) -> f64 {
        ROW_HEAD + PANEL_HEIGHT + BELOW
    }
}

impl Drawing for Figure<'_> {
    fn size(&self) -> [f64; 2] {
        let legend = LINE * (self.legend.len() + self.footnotes.len()) as f64;
        let rows = self.row_height() * self.chart.scenes.len() as f64;
        [WIDTH, (self.head() + rows + 14.0 + legend + MARGIN).ceil()]
    }

    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        canvas.text(&self.title, [MARGIN, MARGIN + 17.0], Align::Left, TITLE)?;
        for (i, note) in self.notes.iter().enumerate() {
            let y = MARGIN + 26.0 + LINE * (i as f64 + 0.75);
            canvas.text(note, [MARGIN, y], Align::Left, SUBTITLE)?;
        }
        let mut top = self.head();
        for scene in &self.chart.scenes {
            self.draw_row(canvas, scene, top)?;
            top += self.row_height();
        }
        top += 14.0;
        for row in &self.legend {
            let mut left = MARGIN;
            for entry in row {
                draw_entry(canvas, entry, [left, top + LINE / 2.0])?;
                left += entry_width(entry);
            }
            top += LINE;
        }
        for note in &self.footnotes {
            canvas.text(note, [MARGIN, top + LINE * 0.7], Align::Left, SUBTITLE)?;
            top += LINE;
        }
        Ok(())
    }
}

impl Figure<'_> {
    fn draw_row<DB: DrawingBackend>(
        &self,
        canvas: &Canvas<DB>,
        scene: &SceneChart,
        top: f64,
    ) -> Result<(), ChartError> {
        let name = if self.chart.scenes.len() > 1 { scene_name(scene) } else { "" };
        let mut left = MARGIN;
        if !name.is_empty() {
            canvas.text(name, [left, top + 19.0], Align::Left, ROW_TITLE)?;
            left += text_width(name, ROW_TITLE.em) * 1.06 + 14.0;
        }
        canvas.text(&scene_note(scene), [left, top + 19.0], Align::Left, SUBTITLE)?;

        let plot_top = top + ROW_HEAD;
        let f1 = Measure::F1 { tolerance_us: self.criteria.tolerance_us };
        for (column, measure) in [f1, Measure::Voxel].into_iter().enumerate() {
            let plot_left = LEFT + column as f64 * (LEFT + PANEL_WIDTH + MARGIN);
            let plot = Rect::new(plot_left, plot_top, PANEL_WIDTH, PANEL_HEIGHT);
            Panel::new(&self.families, self.criteria, scene, measure, plot).draw(canvas)?;
        }
        Ok(())
    }
}

/// Families of all scenes: in the order of their first appearance.
fn families(chart: &ChartResult) -> Vec<(String, Style)> {
    let mut names: Vec<String> = Vec::new();
    for point in chart.scenes.iter().flat_map(|s| &s.points) {
        let family = point.setting.family();
        if !names.contains(&family) {
            names.push(family);
        }
    }
    names.into_iter().enumerate().map(|(i, name)| (name, Style::nth(i))).collect()
}

/// A file's name without its folders.
fn scene_name(scene: &SceneChart) -> &str {
    Path::new(&scene.scene).file_name().and_then(|name| name.to_str()).unwrap_or(&scene.scene)
}

/// Lines under the title: what holds for all scenes.
fn notes(chart: &ChartResult, criteria: Criteria) -> Vec<String> {
    let mut notes = Vec::new();
    for scene in &chart.scenes {
        let device = &scene.device;
        let cores = if device.cores == 1 { "1 core".into() } else { format!("{} cores", device.cores) };
        let runs = if scene.repetitions == 1 {
            "one run each".into()
        } else {
            format!("the fastest of {} runs each", scene.repetitions)
        };
        let note = format!("{}, {cores}; EVIS {}, {}; {runs}", device.name, scene.evis, scene.measured);
        if !notes.contains(&note) {
            notes.push(note);
        }
    }
    let us = criteria.tolerance_us as f64;
    let mut measures = format!(
        "An event counts where truth has one of its polarity at its pixel within {}, or within {} px of motion.",
        tolerance(criteria.tolerance_us),
        number(0.1 * us / 1000.0)
    );
    if criteria.render_ms > 0.0 {
        measures += &format!(" Each rendered frame is charged {} ms.", number(criteria.render_ms));
    }
    notes.push(measures);
    notes
}

fn scene_note(scene: &SceneChart) -> String {
    let sensor = &scene.sensor;
    let thresholds = if sensor.threshold_on == sensor.threshold_off {
        format!("threshold {}", sensor.threshold_on)
    } else {
        format!("thresholds {} and {}", sensor.threshold_on, sensor.threshold_off)
    };
    let pixels = u64::from(scene.width) * u64::from(scene.height);
    let known = if scene.truth.pixels as u64 >= pixels {
        "all pixels".to_owned()
    } else {
        format!("{} of the pixels", grouped(scene.truth.pixels))
    };
    format!(
        "{}×{} pixels, {} s, {thresholds}; truth: {} events in {known}",
        scene.width,
        scene.height,
        number(scene.duration_us as f64 * 1.0e-6),
        grouped(scene.truth.events)
    )
}

/// `12 345`, with spaces that do not break.
fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let space = |i: usize| i > 0 && (digits.len() - i).is_multiple_of(3) && digits.len() > 4;
    digits.char_indices().flat_map(|(i, d)| space(i).then_some('\u{a0}').into_iter().chain([d])).collect()
}

/// What could not be measured, by reason.
fn footnotes(chart: &ChartResult) -> Vec<String> {
    let mut reasons: Vec<(&str, Vec<String>)> = Vec::new();
    for lacking in chart.scenes.iter().flat_map(|s| &s.not_measured) {
        let name = lacking.setting.published.clone().unwrap_or_else(|| lacking.setting.label());
        match reasons.iter_mut().find(|(reason, _)| *reason == lacking.reason) {
            Some((_, names)) if names.contains(&name) => {}
            Some((_, names)) => names.push(name),
            None => reasons.push((&lacking.reason, vec![name])),
        }
    }
    reasons.iter().map(|(reason, names)| format!("Not measured: {} ({reason}).", names.join(", "))).collect()
}

fn entry_width(entry: &Entry) -> f64 {
    SAMPLE_WIDTH + text_width(&entry.text, LEGEND.em) * WIDER + ENTRY_GAP
}

/// Entries in rows that fit the figure's width.
fn rows_of(entries: Vec<Entry>) -> Vec<Vec<Entry>> {
    let mut rows: Vec<Vec<Entry>> = Vec::new();
    let mut used = f64::INFINITY;
    for entry in entries {
        let width = entry_width(&entry);
        match rows.last_mut() {
            Some(row) if used + width <= WIDTH - 2.0 * MARGIN + ENTRY_GAP => {
                used += width;
                row.push(entry);
            }
            _ => {
                used = width;
                rows.push(vec![entry]);
            }
        }
    }
    rows
}

fn draw_entry<DB: DrawingBackend>(
    canvas: &Canvas<DB>,
    entry: &Entry,
    [left, middle]: [f64; 2],
) -> Result<(), ChartError> {
    let (from, to) = ([left, middle], [left + SAMPLE_WIDTH - 6.0, middle]);
    let centre = [(from[0] + to[0]) / 2.0, middle];
    match entry.sample {
        Sample::Marker(style) => {
            canvas.line(&[from, to], 1.25, marker::pale(style.colour))?;
            marker::draw(canvas, centre, style, true)?;
        }
        Sample::Front => {
            let (low, high) = (middle + 4.0, middle - 4.0);
            let step = [[from[0], high], [centre[0], high], [centre[0], low], [to[0], low]];
            canvas.line(&step, 1.75, FRONT)?;
        }
        Sample::Spread => {
            canvas.line(&[from, to], 1.0, SOFT_INK)?;
            canvas.line(&[[to[0], middle - 3.0], [to[0], middle + 3.0]], 1.0, SOFT_INK)?;
        }
        Sample::Beaten => marker::draw(canvas, centre, Style::default(), false)?,
    }
    canvas.text(&entry.text, [left + SAMPLE_WIDTH, middle + 4.4], Align::Left, LEGEND)
}
