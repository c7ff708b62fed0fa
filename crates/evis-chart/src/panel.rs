//! A panel: cost against one error, on logarithmic axes.

use plotters::backend::DrawingBackend;
use plotters::style::WHITE;

use crate::error::ChartError;
use crate::front::Place;
use crate::ladder::number;
use crate::plot::axis::{self, LogAxis};
use crate::plot::canvas::{Align, Canvas, Type, text_width};
use crate::plot::ink::{AXIS, AXIS_TITLE, FLOOR, FRONT, HINT, INK, LABEL, REAL_TIME, SOFT_INK, WIDER};
use crate::plot::label::{Obstacles, Placed, Rect, Wanted, place};
use crate::plot::marker::{self, Style};
use crate::result::{Criteria, Measure, Point, REAL_TIME_MS, SceneChart, tolerance};

/// One pair of axes.
pub(crate) struct Panel<'a> {
    /// Every family of settings, and its marker.
    families: &'a [(String, Style)],
    criteria: Criteria,
    scene: &'a SceneChart,
    measure: Measure,
    plot: Rect,
    x: LogAxis,
    y: LogAxis,
    floor: Option<f64>,
}

impl<'a> Panel<'a> {
    pub(crate) fn new(
        families: &'a [(String, Style)],
        criteria: Criteria,
        scene: &'a SceneChart,
        measure: Measure,
        plot: Rect,
    ) -> Self {
        let places = scene.places(measure, criteria);
        let slowest = scene.points.iter().map(|p| p.slowest(criteria));
        let costs = places.iter().map(|p| p.cost).chain(slowest).chain([REAL_TIME_MS]);
        let floor = scene.truth.floor.as_ref().map(|s| measure.of(s)).filter(|e| *e > 0.0);
        let errors = places.iter().map(|p| p.error).chain(floor);
        let x = LogAxis::around(costs, [0.05, 0.05], [plot.left, plot.right]);
        // Room below for the word that says which way is better.
        let y = LogAxis::around(errors, [0.12, 0.06], [plot.bottom, plot.top]);
        // No F1 lies below 0.
        let y = if matches!(measure, Measure::F1 { .. }) { y.up_to(1.0) } else { y };
        Self { families, criteria, scene, measure, plot, x, y, floor }
    }

    pub(crate) fn draw<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        axis::draw(canvas, &self.plot, &self.x, &self.y)?;
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

    fn draw_titles<DB: DrawingBackend>(&self, canvas: &Canvas<DB>) -> Result<(), ChartError> {
        let plot = &self.plot;
        let middle = (plot.top + plot.bottom) / 2.0;
        canvas.text_upward(&self.error_title(), [plot.left - 48.0, middle], AXIS_TITLE)?;
        let centre = (plot.left + plot.right) / 2.0;
        canvas.text(COST_TITLE, [centre, plot.bottom + 39.0], Align::Centre, AXIS_TITLE)?;
        // Which way is better, in the corner where it is best; no line runs through it.
        canvas.fill(&self.hint().corners(), WHITE)?;
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
        let places = self.scene.places(self.measure, self.criteria);
        let usable = |p: &Place| p.error.is_finite() && p.cost.is_finite() && p.cost > 0.0;
        places.iter().map(|p| usable(p).then(|| [self.x.at(p.cost), self.y.at(p.error)])).collect()
    }

    /// Points of each family, by rate.
    fn family_lines(&self) -> Vec<(Style, Vec<[f64; 2]>)> {
        let at = self.at();
        let lines = self.families.iter().map(|(name, style)| {
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
            // Piece by piece: where a line turns back, the drawing library would draw its corner across the sheet.
            for piece in line.windows(2) {
                canvas.line(piece, 1.25, marker::pale(style.colour))?;
            }
        }
        Ok(())
    }

    fn front(&self) -> Vec<usize> {
        self.scene.front(self.measure, self.criteria)
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
        let bar = |(point, at): (&Point, &Option<[f64; 2]>)| {
            let [x, y] = (*at)?;
            let end = self.x.at(point.slowest(self.criteria));
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
        let places = self.scene.places(self.measure, self.criteria);
        // What counts most is drawn last.
        let mut order: Vec<usize> = (0..self.scene.points.len()).collect();
        order.sort_by_key(|i| front.contains(i));
        for i in order {
            let (Some(point), Some(Some(at))) = (self.scene.points.get(i), at.get(i)) else { continue };
            let family = point.setting.family();
            let style =
                self.families.iter().find(|(name, _)| *name == family).map_or_else(Style::default, |f| f.1);
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
        labels.push(Label { text: "real time".into(), at: down, rim: 3.5, set: LABEL, required: true });
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
            canvas.fill(&rect.corners(), WHITE)?;
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
        let solid = self.solid();
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

    /// What labels must not cover: markers, bars, the hint.
    fn solid(&self) -> Vec<Rect> {
        let rim = |published: bool| if published { marker::RING } else { marker::RADIUS + 1.0 };
        let of_point = |(point, at): (&Point, &Option<[f64; 2]>)| {
            Some(Rect::around((*at)?, rim(point.setting.published.is_some())))
        };
        let bar = |[from, to]: [[f64; 2]; 2]| Rect::new(from[0], from[1] - 3.0, to[0] - from[0] + 1.0, 6.0);
        let mut solid: Vec<_> = self.scene.points.iter().zip(&self.at()).filter_map(of_point).collect();
        solid.extend(self.bars().into_iter().map(bar));
        solid.push(self.hint());
        solid
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

fn segments(line: &[[f64; 2]]) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
    line.windows(2).filter_map(|pair| Some([*pair.first()?, *pair.get(1)?]))
}
