//! Two recordings' statistics as a picture.

use std::path::Path;

use evis_core::stats::{Comparison, Stats};

use crate::draw::PictureKind;
use crate::error::ChartError;
use crate::plot::canvas;
use crate::verify::plot::{Figure, Line, Panel};

/// A curve of a recording.
type Curve = fn(&Stats) -> Vec<[f64; 2]>;

/// Draws `comparison` to `path`, as SVG or PNG by its ending.
///
/// # Errors
/// Another ending, nothing to draw, a file that cannot be written.
pub fn save(comparison: &Comparison, path: &Path) -> Result<(), ChartError> {
    PictureKind::of(path)?;
    crate::verify::save(&figure(comparison)?, path)
}

/// `comparison` as SVG.
///
/// # Errors
/// Nothing to draw.
pub fn svg(comparison: &Comparison) -> Result<String, ChartError> {
    canvas::svg(&figure(comparison)?)
}

fn figure(comparison: &Comparison) -> Result<Figure, ChartError> {
    let sides = [&comparison.a, &comparison.b];
    let panel = |title: &str, x_title: &str, y_title: &str, curves: &[(&str, Curve)]| {
        let lines = sides.iter().enumerate().flat_map(|(family, side)| {
            let line =
                |(signal, (_, of)): (usize, &(&str, Curve))| Line { points: of(&side.stats), family, signal };
            curves.iter().enumerate().map(line).collect::<Vec<_>>()
        });
        let names = curves.iter().map(|(name, _)| (*name).to_owned()).filter(|name| !name.is_empty());
        Panel {
            title: title.into(),
            x_title: x_title.into(),
            y_title: y_title.into(),
            signals: names.collect(),
            lines: lines.filter(|line| line.points.iter().any(|p| p[0] > 0.0 && p[1] > 0.0)).collect(),
            ..Panel::default()
        }
    };
    let panels = [
        panel(
            "intervals",
            "between two events of a pixel, s",
            "density, 1/s per event",
            &[("", |s| s.intervals.clone())],
        ),
        panel(
            "pixels",
            "rate of a pixel, Hz",
            "share of pixels above it",
            &[("", |s| s.pixel_rates.clone())],
        ),
        panel("Fano factor", "window, s", "variance / mean of counts", &[("", |s| s.fano_by_window.clone())]),
        panel("spectrum of the rate", "frequency, Hz", "power, 1: Poisson", &[("", |s| s.spectrum.clone())]),
        panel(
            "correlation of pixels",
            "distance, pixels",
            "correlation of counts",
            &[
                ("along rows", |s| s.spatial_correlation.iter().map(|c| [c[0], c[1]]).collect()),
                ("along columns", |s| s.spatial_correlation.iter().map(|c| [c[0], c[2]]).collect()),
            ],
        ),
        panel(
            "correlation in time",
            "lag, s",
            "autocorrelation of the rate",
            &[("", |s| s.temporal_correlation.clone())],
        ),
    ];
    let panels: Vec<Panel> = panels.into_iter().filter(|panel| !panel.lines.is_empty()).collect();
    if panels.is_empty() {
        return Err(ChartError::Unreachable("neither recording has anything to draw".into()));
    }
    let note = |side: &evis_core::stats::Named| {
        let Stats { width, height, duration_s, cold_rate_hz, on_share, hot_share, .. } = side.stats;
        let told = |value: Option<f64>, digits: usize| value.map_or("-".into(), |v| format!("{v:.digits$}"));
        format!(
            "{}: {width}×{height} pixels, {duration_s:.3} s, {} Hz per pixel, ON share {}, hot pixels {:.4} %.",
            name(&side.name),
            told(cold_rate_hz, 4),
            told(on_share, 3),
            hot_share * 100.0
        )
    };
    let mut notes: Vec<String> = sides.iter().map(|side| note(side)).collect();
    notes.extend(comparison.notes().into_iter().map(|note| format!("{note}.")));
    notes.push("Hot pixels (above 20 Hz) count in the second and the fourth panel only. Values of 0 and below are left out.".into());
    Ok(Figure {
        title: "Two recordings".into(),
        notes,
        families: sides.iter().map(|side| name(&side.name)).collect(),
        panels,
    })
}

/// A file's name without its folder.
fn name(path: &str) -> String {
    path.rsplit(['/', '\\']).next().unwrap_or(path).chars().take(48).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use evis_core::stats::{Named, static_scene, stats};
    use evis_core::{SensorConfig, sensor::Noise};

    #[test]
    fn both_recordings_are_drawn() {
        let side = |name: &str, shot_hz| {
            let noise = Noise { shot_hz, burst_events: 0.3, ..Noise::default() };
            let sensor = SensorConfig { noise, ..SensorConfig::default() };
            let events = static_scene(&sensor, (64, 48), 2_000_000, 0.2, 1).unwrap();
            Named { name: name.into(), stats: stats(&events, (64, 48), (0, 2_000_000)).unwrap() }
        };
        let comparison = Comparison { a: side("folder/first.h5", 3.0), b: side("second.h5", 1.0) };
        let picture = svg(&comparison).unwrap();
        for told in ["first.h5", "second.h5", "intervals", "Fano factor", "spectrum of the rate"] {
            assert!(picture.contains(told), "{told}");
        }
        assert!(!picture.contains("folder/"));
        let other = Comparison { b: side("second.h5", 2.0), ..comparison.clone() };
        assert_ne!(svg(&other).unwrap(), picture, "canary: another recording is another picture");
        let text = serde_json::to_string(&comparison).unwrap();
        // Numbers lose their last bit on the way, and nothing more.
        let back: Comparison = serde_json::from_str(&text).unwrap();
        assert_eq!((svg(&back).unwrap(), back.to_string()), (picture, comparison.to_string()));
        let empty = stats(&[], (4, 4), (0, 1000)).unwrap();
        let nothing = Named { name: "x".into(), stats: empty };
        assert!(svg(&Comparison { a: nothing.clone(), b: nothing }).is_err());
        assert!(save(&comparison, Path::new("x.bmp")).is_err());
    }
}
