//! Light as text.

use std::fmt::{Display, Formatter};

use evis_render::Shadows;

use super::{LightError, LightReport};
use crate::ladder::number;

/// Objects in the table; the others are in the JSON.
const OBJECTS: usize = 14;

/// Width of the names.
const NAME: usize = 40;

fn row(f: &mut Formatter<'_>, name: &str, e: &LightError) -> std::fmt::Result {
    writeln!(
        f,
        "{name:<NAME$} {:>8} {:>9.4} {:>9.4} {:>9.4} {:>9.4}",
        e.pixels, e.median, e.p95, e.worst, e.bias
    )
}

impl Display for LightReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let shadows = match self.shadows {
            Shadows::Maps => "maps",
            Shadows::Rays => "rays",
        };
        writeln!(
            f,
            "{}: {}x{} pixels at {} ms, {} samples, shadows by {shadows}; {}",
            self.scene,
            self.width,
            self.height,
            number(self.at_us as f64 * 1e-3),
            self.samples,
            self.device.name
        )?;
        writeln!(
            f,
            "Log light, ln(Y / {:.4} + {}), engine less oracle. A threshold is usually 0.2.\n",
            self.reference_luminance,
            number(self.log_eps)
        )?;
        let head = |f: &mut Formatter<'_>, what: &str| {
            writeln!(
                f,
                "{what:<NAME$} {:>8} {:>9} {:>9} {:>9} {:>9}",
                "pixels", "median", "p95", "worst", "bias"
            )
        };
        head(f, "region")?;
        row(f, "all", &self.all)?;
        for region in &self.regions {
            row(f, &region.name, &region.error)?;
        }
        writeln!(f)?;
        head(f, "object / material, interior pixels")?;
        for object in self.objects.iter().take(OBJECTS) {
            row(f, &object.name, &object.error)?;
        }
        if self.objects.len() > OBJECTS {
            writeln!(f, "and {} that are off less", self.objects.len() - OBJECTS)?;
        }
        if !self.worst.is_empty() {
            write!(
                f,
                "\n{:>5} {:>5} {:>10} {:>10} {:>10}  worst pixels",
                "x", "y", "engine", "oracle", "off by"
            )?;
        }
        for p in &self.worst {
            write!(
                f,
                "\n{:>5} {:>5} {:>10.5} {:>10.5} {:>+10.4}  {}, {}",
                p.x,
                p.y,
                p.engine,
                p.oracle,
                p.difference,
                p.region.name(),
                p.object
            )?;
        }
        Ok(())
    }
}
