//! What a truth is asked for.

use evis_core::{ConfigError, Sensor, SensorConfig, TimeGrid};
use serde::{Deserialize, Serialize};

use crate::lattice::Lattice;

/// Pixels that a truth is made for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelChoice {
    /// The whole picture.
    #[default]
    All,
    /// A rectangle.
    Crop {
        /// First column.
        x: u32,
        /// First row.
        y: u32,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// About this many, spread evenly over the picture.
    Count(usize),
}

/// What a truth is asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TruthSettings {
    /// Thresholds and `eps`; a camera's own thresholds come first, and the trigger rule counts only with `sampled_hz`:
    /// truth crosses thresholds in continuous time.
    pub sensor: SensorConfig,
    /// Name of the camera; `None` takes the first.
    pub camera: Option<String>,
    /// Width and height in pixels; `None` takes the camera's own (640x480 where it has none).
    pub size: Option<(u32, u32)>,
    /// Scene time at which the stream starts, in microseconds.
    pub start_us: i64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// Which pixels.
    pub pixels: PixelChoice,
    /// `Y_ref` in `ln(Y / Y_ref + eps)`; `None` takes the value that brings the camera's log-mean at the start to 0.18.
    pub reference_luminance: Option<f32>,
    /// Which family of samples.
    pub lattice: Lattice,
    /// Time between two samples of a pixel, in microseconds, before any crossing is looked for; `None` takes, for each
    /// pixel and time, what the fastest thing near it needs to move by a quarter of a pixel: 64 to 1024.
    pub step_us: Option<i64>,
    /// Part of the steps in which nothing fired that are sampled again, 16 times as finely; see [`crate::Audit`].
    pub audit_share: f64,
    /// Error of an event's time to aim at, in microseconds; the samples are refined until their estimated error is below
    /// it, or no more are left. `None` takes 0.15 of the strictest tolerance: 100, or the time to move by 0.01 px, at
    /// most 1000.
    pub time_error_us: Option<f64>,
    /// Not truth, but what an engine without any error of light would fire at this rate: the sensor's trigger on exact
    /// light at the engine's instants, and nothing between them. `step_us`, `audit_share` and `time_error_us` do not
    /// count then.
    pub sampled_hz: Option<f64>,
}

impl Default for TruthSettings {
    fn default() -> Self {
        Self {
            sensor: SensorConfig::default(),
            camera: None,
            size: None,
            start_us: 0,
            duration_us: 250_000,
            pixels: PixelChoice::Count(1000),
            reference_luminance: None,
            lattice: Lattice::First,
            step_us: None,
            audit_share: 1.0 / 64.0,
            time_error_us: None,
            sampled_hz: None,
        }
    }
}

impl TruthSettings {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the first setting that cannot be used, its value, and what would work.
    pub fn check(&self) -> Result<(), ConfigError> {
        Sensor::new(self.sensor.clone())?.thresholds_only("the oracle")?;
        if let Some((width, height)) = self.size {
            for (what, value) in [("width", width), ("height", height)] {
                if !(1..=8192).contains(&value) {
                    return Err(ConfigError::new(what, value, "between 1 and 8192 pixels"));
                }
            }
        }
        if self.start_us < 0 {
            return Err(ConfigError::new("start_us", self.start_us, "0 or later"));
        }
        // A day: sums of two such times never overflow, and nobody waits for a truth of that length.
        if !(1..=86_400_000_000).contains(&self.duration_us) {
            return Err(ConfigError::new("duration_us", self.duration_us, "above 0 and at most a day"));
        }
        if let Some(step) = self.step_us
            && !(10..=100_000).contains(&step)
        {
            return Err(ConfigError::new("step_us", step, "between 10 and 100000 microseconds"));
        }
        if !(0.0..=1.0).contains(&self.audit_share) {
            return Err(ConfigError::new("audit_share", self.audit_share, "between 0 and 1"));
        }
        if let Some(error) = self.time_error_us
            && !(error.is_finite() && error > 0.0)
        {
            return Err(ConfigError::new("time_error_us", error, "a finite number above 0"));
        }
        self.grid()?;
        if let Some(y) = self.reference_luminance
            && !(y.is_finite() && y > 0.0)
        {
            return Err(ConfigError::new("reference_luminance", y, "a finite number above 0"));
        }
        Ok(())
    }

    /// With `sampled_hz`, the engine's instants.
    fn grid(&self) -> Result<Option<TimeGrid>, ConfigError> {
        let Some(rate_hz) = self.sampled_hz else { return Ok(None) };
        let grid = TimeGrid::new(rate_hz)?;
        // The trigger counts an interval's microseconds as u32.
        if rate_hz < 1e-3 {
            return Err(ConfigError::new("sampled_hz", rate_hz, "at least 0.001 Hz"));
        }
        Ok(Some(grid))
    }

    /// With `sampled_hz`, the instants at which light is known, from the start to the first one at or after the end.
    ///
    /// # Errors
    /// A rate that cannot be used.
    pub fn instants(&self) -> Result<Option<Vec<i64>>, ConfigError> {
        let Some(grid) = self.grid()? else { return Ok(None) };
        let last = grid.first_at_or_after(self.duration_us);
        Ok(Some((0..=last).map(|k| grid.instant_us(k)).collect()))
    }

    /// The chosen pixels of a picture, ordered by row, then column.
    ///
    /// # Errors
    /// A crop that leaves the picture, or no pixel at all.
    pub fn pixels(&self, width: u32, height: u32) -> Result<Vec<[u16; 2]>, ConfigError> {
        let whole = |x: u32, y: u32, w: u32, h: u32| -> Vec<[u16; 2]> {
            (y..y + h).flat_map(|y| (x..x + w).map(move |x| [x as u16, y as u16])).collect()
        };
        match self.pixels {
            PixelChoice::All => Ok(whole(0, 0, width, height)),
            PixelChoice::Crop { x, y, width: w, height: h } => {
                let fits = |from: u32, size: u32, all: u32| {
                    size > 0 && from.checked_add(size).is_some_and(|end| end <= all)
                };
                if !fits(x, w, width) || !fits(y, h, height) {
                    let remedy = format!("a rectangle inside the picture, {width}x{height} pixels");
                    return Err(ConfigError::new("crop", format!("{w}x{h} at ({x}, {y})"), remedy));
                }
                Ok(whole(x, y, w, h))
            }
            PixelChoice::Count(0) => Err(ConfigError::new("pixels", 0, "at least 1")),
            PixelChoice::Count(count) if count as u64 >= u64::from(width) * u64::from(height) => {
                Ok(whole(0, 0, width, height))
            }
            PixelChoice::Count(count) => Ok(spread(count, width, height)),
        }
    }
}

/// `count` pixels of a picture along the R2 sequence (M. Roberts, "The Unreasonable Effectiveness of Quasirandom
/// Sequences", 2018): evenly spread, in no step with any texture; fewer where two fall on the same pixel.
fn spread(count: usize, width: u32, height: u32) -> Vec<[u16; 2]> {
    // The plastic number, the real root of x^3 = x + 1.
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let at = |i: usize, step: f64, size: u32| {
        ((((i as f64 + 1.0) * step + 0.5).fract() * f64::from(size)) as u32).min(size - 1) as u16
    };
    let mut pixels: Vec<[u16; 2]> =
        (0..count).map(|i| [at(i, 1.0 / PLASTIC, width), at(i, 1.0 / (PLASTIC * PLASTIC), height)]).collect();
    pixels.sort_unstable_by_key(|[x, y]| (*y, *x));
    pixels.dedup();
    pixels
}

/// Why there is no truth.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TruthError {
    /// A setting that cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The scene does not serve.
    #[error(transparent)]
    Scene(#[from] evis_scene::SceneError),
    /// The caller's progress said so.
    #[error("stopped before the truth was complete")]
    Stopped,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chosen_pixels_are_spread_ordered_and_inside() {
        let settings = TruthSettings { pixels: PixelChoice::Count(1000), ..Default::default() };
        let pixels = settings.pixels(160, 120).unwrap();
        assert!((950..=1000).contains(&pixels.len()), "{}", pixels.len());
        assert!(pixels.is_sorted_by_key(|[x, y]| (*y, *x)));
        // A quarter of them in each quarter, within four standard deviations of chance: far less, in truth.
        let left = pixels.iter().filter(|[x, y]| *x < 80 && *y < 60).count();
        assert!((left as f64 - 250.0).abs() < 25.0, "{left}");
        let few = TruthSettings { pixels: PixelChoice::Count(99_999), ..Default::default() };
        assert_eq!(few.pixels(16, 12).unwrap().len(), 192);
    }

    #[test]
    fn instants_are_the_engine_s_and_pass_the_end() {
        let at = |hz| TruthSettings { sampled_hz: hz, duration_us: 10_001, ..Default::default() };
        assert_eq!(at(None).instants().unwrap(), None);
        assert_eq!(at(Some(300.0)).instants().unwrap().unwrap(), [0, 3333, 6667, 10_000, 13_333]);
        for bad in [0.0, -5.0, 1e-4, 2e6, f64::NAN] {
            let error = at(Some(bad)).check().unwrap_err().to_string();
            assert!(error.contains("Hz"), "{error}");
        }
    }

    #[test]
    fn a_crop_outside_the_picture_is_refused() {
        let crop = |x, width| TruthSettings {
            pixels: PixelChoice::Crop { x, y: 0, width, height: 2 },
            ..Default::default()
        };
        assert_eq!(crop(3, 1).pixels(4, 4).unwrap(), [[3, 0], [3, 1]]);
        for bad in [crop(4, 1), crop(0, 0), crop(u32::MAX, 2)] {
            assert!(bad.pixels(4, 4).unwrap_err().to_string().contains("4x4"));
        }
    }
}
