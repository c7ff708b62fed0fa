//! The picture: a row of two panels per scene, cost against two errors.

use std::path::Path;

use plotters::backend::DrawingBackend;

use crate::axis::LogAxis;
use crate::canvas::{self, Align, Canvas, Colour, Drawing, Type, text_width};
use crate::error::ChartError;
use crate::label::{Obstacles, Placed, Rect, Wanted, place};
use crate::ladder::number;
use crate::marker::{self, Style};
use crate::result::{ChartResult, Lens, Measure, REAL_TIME_MS, SceneChart, tolerance};

const INK: Colour = plotters::style::RGBColor(0x22, 0x22, 0x22);
const SOFT_INK: Colour = plotters::style::RGBColor(0x5a, 0x5a, 0x5a);
const AXIS: Colour = plotters::style::RGBColor(0x80, 0x80, 0x80);
const GRID: Colour = plotters::style::RGBColor(0xdd, 0xdd, 0xdd);
const FINE_GRID: Colour = plotters::style::RGBColor(0xf1, 0xf1, 0xf1);
const FRONT: Colour = plotters::style::RGBColor(0x55, 0x55, 0x55);
const REAL_TIME: Colour = plotters::style::RGBColor(0x33, 0x33, 0x33);
const FLOOR: Colour = plotters::style::RGBColor(0x99, 0x99, 0x99);

const TITLE: Type = Type { em: 19.0, colour: INK };
const SUBTITLE: Type = Type { em: 12.5, colour: SOFT_INK };
const ROW_TITLE: Type = Type { em: 15.5, colour: INK };
const AXIS_TITLE: Type = Type { em: 13.0, colour: INK };
const TICK: Type = Type { em: 12.0, colour: SOFT_INK };
const LABEL: Type = Type { em: 12.0, colour: INK };
const HINT: Type = Type { em: 12.0, colour: SOFT_INK };
const LEGEND: Type = Type { em: 12.5, colour: INK };

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

/// Rows beyond which a figure becomes too large to be looked at.
const MAX_SCENES: usize = 24;

/// How a chart is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Look {
    /// Which F1, and what rendering costs.
    pub lens: Lens,
}

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
pub fn save(chart: &ChartResult, look: &Look, path: &Path) -> Result<(), ChartError> {
    let bytes = match PictureKind::of(path)? {
        PictureKind::Png => png(chart, look)?,
        PictureKind::Svg => svg(chart, look)?.into_bytes(),
    };
    std::fs::write(path, bytes).map_err(|source| ChartError::Io { path: path.into(), source })
}

/// `chart` as SVG.
///
/// # Errors
/// Nothing to draw, too many scenes for a figure, a look that makes no sense.
pub fn svg(chart: &ChartResult, look: &Look) -> Result<String, ChartError> {
    canvas::svg(&Figure::new(chart, look)?)
}

/// `chart` as PNG, two pixels for each of the SVG's.
///
/// # Errors
/// As [`svg`].
pub fn png(chart: &ChartResult, look: &Look) -> Result<Vec<u8>, ChartError> {
    canvas::png(&Figure::new(chart, look)?)
}

/// A picture to draw.
struct Figure<'a> {
    chart: &'a ChartResult,
    lens: Lens,
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
    RealTime,
    Floor,
    Spread,
    Beaten,
}

/// Width of an entry's sample, and what follows its text.
const SAMPLE_WIDTH: f64 = 24.0;
const ENTRY_GAP: f64 = 20.0;

impl<'a> Figure<'a> {
    fn new(chart: &'a ChartResult, look: &Look) -> Result<Self, ChartError> {
        look.lens.check()?;
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
            lens: look.lens,
            families,
            title,
            notes: notes(chart, look.lens),
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
        add(Sample::RealTime, "real time");
        if self.chart.scenes.iter().any(|s| s.truth.floor.is_some()) {
            add(Sample::Floor, "error of the truth itself");
        }
        if self.chart.scenes.iter().any(|s| s.repetitions > 1) {
            add(Sample::Spread, "to the slowest run");
        }
        entries
    }

    fn style(&self, family: &str) -> Style {
        self.families.iter().find(|(name, _)| name == family).map_or_else(Style::default, |(_, s)| *s)
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
        let f1 = Measure::F1 { tolerance_us: self.lens.tolerance_us };
        for (column, measure) in [f1, Measure::Voxel].into_iter().enumerate() {
            let plot_left = LEFT + column as f64 * (LEFT + PANEL_WIDTH + MARGIN);
            let plot = Rect::new(plot_left, plot_top, PANEL_WIDTH, PANEL_HEIGHT);
            Panel::new(self, scene, measure, plot).draw(canvas)?;
        }
        Ok(())
    }
}

/// One pair of axes.
struct Panel<'a> {
    figure: &'a Figure<'a>,
    scene: &'a SceneChart,
    measure: Measure,
    plot: Rect,
    x: LogAxis,
    y: LogAxis,
    floor: Option<f64>,
}

impl<'a> Panel<'a> {
    fn new(figure: &'a Figure<'a>, scene: &'a SceneChart, measure: Measure, plot: Rect) -> Self {
        let lens = figure.lens;
        let places = scene.places(measure, lens);
        let slowest = scene.points.iter().map(|p| p.slowest(lens));
        let costs = places.iter().map(|p| p.cost).chain(slowest).chain([REAL_TIME_MS]);
        let floor = scene.truth.floor.as_ref().map(|s| measure.of(s)).filter(|e| *e > 0.0);
        let errors = places.iter().map(|p| p.error).chain(floor);
        let x = LogAxis::around(costs, [0.05, 0.05], [plot.left, plot.right]);
        // Room below for the word that says which way is better.
        let y = LogAxis::around(errors, [0.12, 0.06], [plot.bottom, plot.top]);
        // No F1 lies below 0.
        let y = if matches!(measure, Measure::F1 { .. }) { y.up_to(1.0) } else { y };
        Self { figure, scene, measure, plot, x, y, floor }
    }

    fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        self.draw_grid(canvas)?;
        self.draw_floor(canvas)?;
        self.draw_real_time(canvas)?;
        self.draw_titles(canvas)?;
        self.draw_families(canvas)?;
        self.draw_front(canvas)?;
        let labels = self.labels();
        self.draw_label_grounds(canvas, &labels)?;
        self.draw_points(canvas)?;
        self.draw_labels(canvas, &labels)
    }

    fn draw_grid<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let plot = &self.plot;
        for fine in [true, false] {
            let colour = if fine { FINE_GRID } else { GRID };
            for tick in self.x.ticks().iter().filter(|t| t.label.is_none() == fine) {
                let x = self.x.at(tick.value);
                canvas.line(&[[x, plot.top], [x, plot.bottom]], 1.0, colour)?;
            }
            for tick in self.y.ticks().iter().filter(|t| t.label.is_none() == fine) {
                let y = self.y.at(tick.value);
                canvas.line(&[[plot.left, y], [plot.right, y]], 1.0, colour)?;
            }
        }
        for tick in self.x.ticks() {
            let x = self.x.at(tick.value);
            let length = if tick.label.is_some() { 5.0 } else { 3.0 };
            canvas.line(&[[x, plot.bottom], [x, plot.bottom + length]], 1.0, AXIS)?;
            if let Some(label) = &tick.label {
                canvas.text(label, [x, plot.bottom + 18.0], Align::Centre, TICK)?;
            }
        }
        for tick in self.y.ticks() {
            let y = self.y.at(tick.value);
            let length = if tick.label.is_some() { 5.0 } else { 3.0 };
            canvas.line(&[[plot.left - length, y], [plot.left, y]], 1.0, AXIS)?;
            if let Some(label) = &tick.label {
                canvas.text(label, [plot.left - 8.0, y + 4.2], Align::Right, TICK)?;
            }
        }
        let corner = [plot.left, plot.bottom];
        canvas.line(&[[plot.left, plot.top], corner, [plot.right, plot.bottom]], 1.25, AXIS)
    }

    fn draw_titles<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let plot = &self.plot;
        let middle = (plot.top + plot.bottom) / 2.0;
        canvas.text_upward(&self.error_title(), [plot.left - 48.0, middle], AXIS_TITLE)?;
        let centre = (plot.left + plot.right) / 2.0;
        canvas.text(COST_TITLE, [centre, plot.bottom + 39.0], Align::Centre, AXIS_TITLE)?;
        // Which way is better, in the corner where it is best; no line runs through it.
        canvas.fill(&self.hint().corners(), plotters::style::WHITE)?;
        let corner = [plot.left + 10.0, plot.bottom - 10.0];
        let tail = [corner[0] + 15.0, corner[1] - 15.0];
        canvas.line(&[tail, [corner[0] + 2.0, corner[1] - 2.0]], 1.5, SOFT_INK)?;
        canvas.fill(
            &[corner, [corner[0] + 8.0, corner[1] - 2.0], [corner[0] + 2.0, corner[1] - 8.0]],
            SOFT_INK,
        )?;
        canvas.text(HINT_TEXT, [corner[0] + 20.0, corner[1] - 3.0], Align::Left, HINT)
    }

    fn error_title(&self) -> String {
        match self.measure {
            Measure::F1 { tolerance_us } => {
                format!("error of events: 1 − F1 within {}", tolerance(tolerance_us))
            }
            Measure::Voxel => "error of voxel grids: relative L1, 20 ms".into(),
        }
    }

    fn hint(&self) -> Rect {
        let width = 20.0 + text_width(HINT_TEXT, HINT.em) * WIDER;
        Rect::new(self.plot.left + 8.0, self.plot.bottom - 27.0, width + 6.0, 21.0)
    }

    fn draw_floor<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let Some(floor) = self.floor else { return Ok(()) };
        let y = self.y.at(floor);
        canvas.dashes([[self.plot.left, y], [self.plot.right, y]], 1.5, [2.0, 3.0], FLOOR)
    }

    fn draw_real_time<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let x = self.x.at(REAL_TIME_MS);
        canvas.dashes([[x, self.plot.top], [x, self.plot.bottom]], 1.5, [7.0, 4.0], REAL_TIME)
    }

    /// Where points lie on the sheet; `None` for what has no place on logarithmic axes.
    fn at(&self) -> Vec<Option<[f64; 2]>> {
        let places = self.scene.places(self.measure, self.figure.lens);
        let usable = |p: &crate::front::Place| p.error.is_finite() && p.cost.is_finite() && p.cost > 0.0;
        places.iter().map(|p| usable(p).then(|| [self.x.at(p.cost), self.y.at(p.error)])).collect()
    }

    /// Points of each family, by rate.
    fn family_lines(&self) -> Vec<(Style, Vec<[f64; 2]>)> {
        let at = self.at();
        let lines = self.figure.families.iter().map(|(name, style)| {
            let mut members: Vec<(f64, [f64; 2])> = self
                .scene
                .points
                .iter()
                .zip(&at)
                .filter(|(p, _)| p.setting.family() == *name)
                .filter_map(|(p, at)| Some((p.setting.rate_hz, (*at)?)))
                .collect();
            members.sort_by(|a, b| a.0.total_cmp(&b.0));
            (*style, members.into_iter().map(|(_, at)| at).collect::<Vec<_>>())
        });
        lines.collect()
    }

    fn draw_families<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        for (style, line) in self.family_lines() {
            canvas.line(&line, 1.25, marker::pale(style.colour))?;
        }
        Ok(())
    }

    fn front(&self) -> Vec<usize> {
        self.scene.front(self.measure, self.figure.lens)
    }

    /// The front as a staircase: what can be had at each cost.
    fn front_line(&self) -> Vec<[f64; 2]> {
        let at = self.at();
        let mut line: Vec<[f64; 2]> = Vec::new();
        for place in self.front().into_iter().filter_map(|i| at.get(i).copied().flatten()) {
            match line.last() {
                Some(&[_, y]) => line.push([place[0], y]),
                None => line.push([place[0], self.plot.top]),
            }
            line.push(place);
        }
        if let Some(&[_, y]) = line.last() {
            line.push([self.plot.right, y]);
        }
        line
    }

    fn draw_front<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        canvas.line(&self.front_line(), 1.75, FRONT)
    }

    fn bars(&self) -> Vec<[[f64; 2]; 2]> {
        let bar = |(point, at): (&crate::result::Point, &Option<[f64; 2]>)| {
            let [x, y] = (*at)?;
            let end = self.x.at(point.slowest(self.figure.lens));
            (end > x).then_some([[x, y], [end, y]])
        };
        self.scene.points.iter().zip(&self.at()).filter_map(bar).collect()
    }

    fn draw_points<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        for [from, to] in self.bars() {
            canvas.line(&[from, to], 1.0, SOFT_INK)?;
            canvas.line(&[[to[0], to[1] - 3.0], [to[0], to[1] + 3.0]], 1.0, SOFT_INK)?;
        }
        let front = self.front();
        let at = self.at();
        let places = self.scene.places(self.measure, self.figure.lens);
        // What counts most is drawn last.
        let mut order: Vec<usize> = (0..self.scene.points.len()).collect();
        order.sort_by_key(|i| front.contains(i));
        for i in order {
            let (Some(point), Some(Some(at))) = (self.scene.points.get(i), at.get(i)) else { continue };
            let style = self.figure.style(&point.setting.family());
            if point.setting.published.is_some() {
                marker::ring(canvas, *at)?;
            }
            marker::draw(canvas, *at, style, front.contains(&i))?;
            // No logarithm of 0: an arrow says that the point lies below.
            if places.get(i).is_some_and(|p| p.error < self.y.low()) {
                let [x, y] = *at;
                let tip = [x, self.plot.bottom + 1.0];
                canvas.fill(&[tip, [x - 4.0, y - 7.0], [x + 4.0, y - 7.0]], INK)?;
            }
        }
        Ok(())
    }

    /// Labels that have found a place.
    fn labels(&self) -> Vec<(Label, Placed)> {
        let at = self.at();
        let front = self.front();
        let mut named: Vec<(u8, usize, String, [f64; 2])> = Vec::new();
        for (i, (point, at)) in self.scene.points.iter().zip(&at).enumerate() {
            let Some(at) = *at else { continue };
            let rank = match (point.setting.published.is_some(), front.contains(&i)) {
                (true, _) => 0,
                (_, true) => 1,
                _ => 2,
            };
            // Beaten points say their rate; the marker tells the rest.
            let setting = &point.setting;
            let text = match &setting.published {
                Some(name) => name.clone(),
                None if rank == 2 => format!("{} Hz", number(setting.rate_hz)),
                None => setting.label(),
            };
            named.push((rank, i, text, at));
        }
        named.sort_by_key(|(rank, i, ..)| (*rank, *i));
        let mut labels: Vec<Label> = Vec::new();
        // The lines have names too, anywhere along them, best at their ends.
        let x = self.x.at(REAL_TIME_MS);
        let steps = (0..12).map(f64::from);
        let down = steps.clone().map(|k| [x, self.plot.top + 9.0 + k * 25.0]).collect();
        labels.push(Label { text: "real time".into(), at: down, rim: 2.0, set: LABEL, required: true });
        if let Some(y) = self.floor.map(|floor| self.y.at(floor)) {
            let leftward = steps.map(|k| [self.plot.right - 50.0 - k * 25.0, y]).collect();
            let text = "truth's own error".into();
            labels.push(Label { text, at: leftward, rim: 1.5, set: HINT, required: true });
        }
        labels.extend(named.into_iter().map(|(rank, _, text, at)| Label {
            text,
            at: vec![at],
            rim: if rank == 0 { marker::RING } else { marker::RADIUS },
            set: if rank < 2 { LABEL } else { HINT },
            required: rank < 2,
        }));
        let placed = self.place(&labels, x);
        labels.into_iter().zip(placed).filter_map(|(label, placed)| Some((label, placed?))).collect()
    }

    /// White under the labels: lines do not run through words.
    fn draw_label_grounds<DB: DrawingBackend>(
        &self,
        canvas: &Canvas<DB>,
        labels: &[(Label, Placed)],
    ) -> Result<(), ChartError> {
        for (_, Placed { rect, .. }) in labels {
            canvas.fill(&rect.corners(), plotters::style::WHITE)?;
        }
        Ok(())
    }

    fn draw_labels<DB: DrawingBackend>(
        &self,
        canvas: &Canvas<DB>,
        labels: &[(Label, Placed)],
    ) -> Result<(), ChartError> {
        for (label, Placed { rect, at }) in labels {
            let end = rect.nearest(*at);
            let away = (end[0] - at[0]).hypot(end[1] - at[1]);
            if away > label.rim + 8.0 {
                let start = label.rim / away;
                let from = [at[0] + (end[0] - at[0]) * start, at[1] + (end[1] - at[1]) * start];
                canvas.line(&[from, end], 0.75, AXIS)?;
            }
            // From the side that faces the point, so that a wider font of a viewer grows away from it.
            let (align, x) = if rect.right <= at[0] {
                (Align::Right, rect.right)
            } else if rect.left >= at[0] {
                (Align::Left, rect.left)
            } else {
                (Align::Centre, (rect.left + rect.right) / 2.0)
            };
            canvas.text(&label.text, [x, rect.bottom - 2.2], align, label.set)?;
        }
        Ok(())
    }

    fn place(&self, labels: &[Label], real_time_x: f64) -> Vec<Option<Placed>> {
        let wanted: Vec<_> = labels
            .iter()
            .map(|label| Wanted {
                at: label.at.clone(),
                rim: label.rim,
                width: text_width(&label.text, label.set.em) * WIDER,
                height: label.set.em,
                required: label.required,
            })
            .collect();
        let at = self.at();
        let mut solid: Vec<_> =
            at.iter().flatten().map(|at| Rect::around(*at, marker::RADIUS + 1.5)).collect();
        solid.push(self.hint());
        let mut lines: Vec<[[f64; 2]; 2]> = segments(&self.front_line()).collect();
        lines.push([[real_time_x, self.plot.top], [real_time_x, self.plot.bottom]]);
        lines.extend(self.family_lines().iter().flat_map(|(_, line)| segments(line).collect::<Vec<_>>()));
        if let Some(floor) = self.floor {
            let y = self.y.at(floor);
            lines.push([[self.plot.left, y], [self.plot.right, y]]);
        }
        let bounds = Rect::new(
            self.plot.left + 4.0,
            self.plot.top + 2.0,
            self.plot.width() - 4.0,
            self.plot.height() - 6.0,
        );
        place(&wanted, &Obstacles { bounds, solid: &solid, lines: &lines })
    }
}

/// A label in a panel.
struct Label {
    text: String,
    at: Vec<[f64; 2]>,
    rim: f64,
    set: Type,
    required: bool,
}

const COST_TITLE: &str = "cost: milliseconds of work per simulated second";
const HINT_TEXT: &str = "faster, more accurate";

/// Viewers of an SVG may have a wider font than ours.
const WIDER: f64 = 1.08;

fn segments(line: &[[f64; 2]]) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
    line.windows(2).filter_map(|pair| Some([*pair.first()?, *pair.get(1)?]))
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
fn notes(chart: &ChartResult, lens: Lens) -> Vec<String> {
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
    let us = lens.tolerance_us as f64;
    let mut measures = format!(
        "An event counts where truth has one of its polarity at its pixel within {}, or within {} px of motion.",
        tolerance(lens.tolerance_us),
        number(0.1 * us / 1000.0)
    );
    if lens.render_ms > 0.0 {
        measures += &format!(" Each rendered frame is charged {} ms.", number(lens.render_ms));
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
        Sample::RealTime => canvas.dashes([from, to], 1.5, [7.0, 4.0], REAL_TIME)?,
        Sample::Floor => canvas.dashes([from, to], 1.5, [2.0, 3.0], FLOOR)?,
        Sample::Spread => {
            canvas.line(&[from, to], 1.0, SOFT_INK)?;
            canvas.line(&[[to[0], middle - 3.0], [to[0], middle + 3.0]], 1.0, SOFT_INK)?;
        }
        Sample::Beaten => marker::draw(canvas, centre, Style::default(), false)?,
    }
    canvas.text(&entry.text, [left + SAMPLE_WIDTH, middle + 4.4], Align::Left, LEGEND)
}
