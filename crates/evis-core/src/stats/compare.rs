//! Two recordings side by side.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Stats;

/// Statistics with a name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Named {
    /// What it is, a file's name for instance.
    pub name: String,
    /// What was counted.
    pub stats: Stats,
}

/// Two recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// The first.
    pub a: Named,
    /// The second.
    pub b: Named,
}

/// A figure of both; `None` where a recording has none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// What it is.
    pub name: &'static str,
    /// Of the first.
    pub a: Option<f64>,
    /// Of the second.
    pub b: Option<f64>,
}

impl Row {
    /// The second over the first, where that is a number.
    pub fn ratio(&self) -> Option<f64> {
        self.a.zip(self.b).filter(|(a, _)| *a != 0.0).map(|(a, b)| b / a)
    }
}

impl Comparison {
    /// The figures of a table.
    pub fn rows(&self) -> Vec<Row> {
        type Figure = (&'static str, fn(&Stats) -> Option<f64>);
        const FIGURES: [Figure; 20] = [
            ("duration, s", |s| Some(s.duration_s)),
            ("events", |s| Some(s.events as f64)),
            ("rate, Hz per pixel", |s| Some(s.rate_hz)),
            ("rate without hot pixels, Hz", |s| s.cold_rate_hz),
            ("  of it ON, Hz", |s| s.cold_on_hz),
            ("  of it OFF, Hz", |s| s.cold_off_hz),
            ("ON share", |s| s.on_share),
            ("silent pixels, share", |s| Some(s.silent_share)),
            ("hot pixels (> 20 Hz), share", |s| Some(s.hot_share)),
            ("  their share of events", |s| s.hot_event_share),
            ("  their mean rate, Hz", |s| s.hot_hz),
            ("Fano factor of counts", |s| s.fano),
            ("alternation of polarity", |s| s.alternation),
            ("  after ON", |s| s.alternation_after[0]),
            ("  after OFF", |s| s.alternation_after[1]),
            ("least interval, us", |s| s.least_interval_us.map(|us| us as f64)),
            ("median interval, ms", |s| s.interval_quantiles_us.map(|q| q[2] * 1e-3)),
            ("excess of intervals < 5 ms", |s| s.burst_share),
            ("correlation of neighbours", |s| s.spatial_correlation.first().map(|c| (c[1] + c[2]) / 2.0)),
            ("unsteadiness of the rate", |s| s.unsteadiness),
        ];
        let row = |(name, of): Figure| Row { name, a: of(&self.a.stats), b: of(&self.b.stats) };
        FIGURES.into_iter().map(row).collect()
    }

    /// What is to be known about the figures.
    pub fn notes(&self) -> Vec<String> {
        let note = |(side, of): (&str, &Named)| Some(format!("{side}: {}", of.stats.hot_note()?));
        [("A", &self.a), ("B", &self.b)].into_iter().filter_map(note).collect()
    }
}

/// A number of four digits.
fn digits(value: Option<f64>) -> String {
    match value {
        None => "-".into(),
        Some(v) if v != 0.0 && v.abs() < 1e-3 => format!("{v:.2e}"),
        Some(v) if v.abs() >= 1000.0 => format!("{v:.0}"),
        Some(v) => {
            let decimals =
                if v == 0.0 { 0 } else { (3 - v.abs().log10().floor() as i32).clamp(0, 6) as usize };
            format!("{v:.decimals$}")
        }
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b] = [&self.a, &self.b].map(|side| {
            let name = side.name.rsplit(['/', '\\']).next().unwrap_or(&side.name);
            let size = format!("{}x{}", side.stats.width, side.stats.height);
            (name.chars().take(30).collect::<String>(), size)
        });
        let wide = a.0.chars().count().max(b.0.chars().count()).max(12);
        writeln!(f, "{:<30} {:>wide$} {:>wide$} {:>8}", "", a.0, b.0, "B / A")?;
        write!(f, "{:<30} {:>wide$} {:>wide$}", "pixels", a.1, b.1)?;
        for row in self.rows() {
            let Row { name, a, b } = row;
            let ratio = row.ratio().map_or_else(|| "-".into(), |r| format!("{r:.3}"));
            write!(f, "\n{name:<30} {:>wide$} {:>wide$} {ratio:>8}", digits(a), digits(b))?;
        }
        for note in self.notes() {
            write!(f, "\nnote: {note}")?;
        }
        Ok(())
    }
}
