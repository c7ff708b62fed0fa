//! A score for people.

use std::fmt::{Display, Formatter, Result};

use super::{MatchScore, Score};

/// The tolerance of the score that quality presets promise, where it is scaled by image speed, microseconds.
const PROMISED_US: i64 = 1000;

impl Display for Score {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        writeln!(
            f,
            "{} events against {} of truth ({:.3} times as many), {} pixels ({} fired), {} s",
            self.events,
            self.truth_events,
            self.count_ratio,
            self.pixels,
            self.fired_pixels,
            self.duration_us as f64 / 1.0e6
        )?;
        if self.ignored_unknown_pixel + self.ignored_outside_interval > 0 {
            writeln!(
                f,
                "ignored: {} events at pixels that the truth does not know, {} outside its time",
                self.ignored_unknown_pixel, self.ignored_outside_interval
            )?;
        }
        writeln!(
            f,
            "\n{:>9}          {:>7} {:>9} {:>7} {:>7}  {:>9} {:>8} {:>8} {:>8}  {:>8} {:>9}",
            "tolerance",
            "F1",
            "precision",
            "recall",
            "chance",
            "median us",
            "p95 us",
            "RMS us",
            "bias us",
            "missed",
            "spurious"
        )?;
        for level in &self.tolerances {
            let is_promised = level.tolerance_us == PROMISED_US;
            row(f, level.tolerance_us, "plain", &level.plain)?;
            row(f, level.tolerance_us, if is_promised { "scaled *" } else { "scaled" }, &level.scaled)?;
        }
        writeln!(f, "missed and spurious: per pixel and second")?;
        if self.tolerances.iter().any(|level| level.tolerance_us == PROMISED_US) {
            writeln!(
                f,
                "* the F1 of quality presets: within 1 ms, or the time to move by 0.1 px where that is longer"
            )?;
        }
        self.regions(f)?;
        writeln!(
            f,
            "\nexact polarity sequence   {:.4} of all pixels, {:.4} of those that fired",
            self.exact_sequence, self.exact_sequence_fired
        )?;
        write!(f, "voxel grids, relative L1  {}", number(self.voxel_l1))?;
        write!(f, "\nintegrated log, RMS       {}", number(self.integrated_log_rms))?;
        if self.cut_clusters > 0 {
            write!(f, "\n{} dense clusters were matched piece by piece", self.cut_clusters)?;
        }
        Ok(())
    }
}

impl Score {
    fn regions(&self, f: &mut Formatter<'_>) -> Result {
        writeln!(
            f,
            "\n{:>9}          {:<12} {:>7} {:>9} {:>7} {:>12} {:>12}",
            "tolerance", "region", "F1", "precision", "recall", "truth", "stream"
        )?;
        for level in &self.tolerances {
            for (kind, score) in [("plain", &level.plain), ("scaled", &level.scaled)] {
                for r in &score.regions {
                    writeln!(
                        f,
                        "{:>6} us {kind:<8} {:<12} {:>7.4} {:>9.4} {:>7.4} {:>12} {:>12}",
                        level.tolerance_us,
                        r.region.name(),
                        r.f1,
                        r.precision,
                        r.recall,
                        r.truth_events,
                        r.events
                    )?;
                }
            }
        }
        Ok(())
    }
}

fn row(f: &mut Formatter<'_>, tolerance_us: i64, kind: &str, score: &MatchScore) -> Result {
    let MatchScore { f1, precision, recall, chance_f1, .. } = score;
    write!(f, "{tolerance_us:>6} us {kind:<8} {f1:>7.4} {precision:>9.4} {recall:>7.4} {chance_f1:>7.4}  ")?;
    match &score.time_error {
        Some(e) => {
            write!(f, "{:>9.1} {:>8.1} {:>8.1} {:>8.1}", e.median_us, e.p95_us, e.rms_us, e.bias_us)?;
        }
        None => write!(f, "{:>9} {:>8} {:>8} {:>8}", "-", "-", "-", "-")?,
    }
    writeln!(f, "  {:>8.3} {:>9.3}", score.missed_per_pixel_s, score.spurious_per_pixel_s)
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "unknown".into(), |v| format!("{v:.4}"))
}
