//! What `splat` is asked to do.

use evis_core::ConfigError;
use evis_core::emulator::check_carrying;
use serde::{Deserialize, Serialize};

/// How a surface point gets from its keyframe to an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Motion {
    /// By its motion vector times the elapsed part of the gap: all that a foreign renderer's frames allow. Rotation by an
    /// angle θ within a gap is off by up to r·θ²/8 pixels at r pixels from its centre.
    Linear,
    /// By the exact matrices of camera and object at the instant. What deforms (skins, morph targets) moves linearly.
    #[default]
    Exact,
}

pub use evis_core::Carrier;

/// `eps` of the EVIS paper's code in `ln(Y + eps)`.
pub const EVIS_PAPER_LOG_EPS: f32 = 1e-5;

/// Settings of `splat`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SplatConfig {
    /// Keyframes rendered per second, on a grid fixed in absolute time.
    pub keyframe_hz: f64,
    /// Instants per gap, the keyframe that ends it included.
    pub steps: u32,
    /// Pixels that keyframes show beyond each border.
    pub margin: u32,
    /// Keyframe pixels per sensor pixel, along each axis; each has geometry of its own.
    pub supersample: u32,
    /// How points move.
    pub motion: Motion,
    /// What is splatted.
    pub carrier: Carrier,
    /// Where both keyframes show something, the nearer surface wins; else the newer keyframe.
    pub nearest: bool,
    /// Where both show the same surface, both count, in log light and by their distance in time: the signal is then
    /// continuous at keyframes.
    pub blend: bool,
    /// Pixels by which the motion of nearer surfaces reaches over their antialiased fringe.
    pub dilate: u32,
    /// Sharpness of the softmax: importance is e^(sharpness · (1/z) / max(1/z)).
    pub sharpness: f32,
    /// A pixel with less splatted weight of colours than this is a hole.
    pub hole_below: f32,
    /// Luminance of what neither keyframe shows; `None` leaves the pixel's memory untouched and counts it as unknown.
    pub fill: Option<f32>,
}

impl Default for SplatConfig {
    fn default() -> Self {
        Self {
            keyframe_hz: 125.0,
            steps: 8,
            margin: 32,
            supersample: 1,
            motion: Motion::Exact,
            carrier: Carrier::Index,
            nearest: true,
            blend: true,
            dilate: 0,
            sharpness: 12.0,
            // On `spinner` 0.3 to 0.5 were as good, 0.2 worse.
            hole_below: 0.3,
            fill: None,
        }
    }
}

impl SplatConfig {
    /// As the EVIS paper publishes it: linear motion, softmax 12 on 1/(z + 1e-3), holes below 1e-4 of a pixel, newer
    /// keyframe first, older in its holes, black where neither shows anything.
    pub const fn evis_paper(keyframe_hz: f64, steps: u32) -> Self {
        Self {
            keyframe_hz,
            steps,
            margin: 32,
            supersample: 1,
            motion: Motion::Linear,
            carrier: Carrier::Colour,
            nearest: false,
            blend: false,
            dilate: 0,
            sharpness: 12.0,
            hole_below: 1e-4,
            fill: Some(0.0),
        }
    }

    /// Whether this is the paper's setting at some rate.
    pub fn is_evis_paper(&self) -> bool {
        *self == Self::evis_paper(self.keyframe_hz, self.steps)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// Names the first that cannot be used, and what would work.
    pub fn check(&self) -> Result<(), ConfigError> {
        if !(self.keyframe_hz.is_finite() && self.keyframe_hz > 0.0 && self.keyframe_hz <= 1e6) {
            return Err(ConfigError::new(
                "keyframe_rate",
                self.keyframe_hz,
                "above 0 and at most 1000000 Hz",
            ));
        }
        for (what, value, most) in [("steps", self.steps, 1000), ("supersample", self.supersample, 4)] {
            if !(1..=most).contains(&value) {
                return Err(ConfigError::new(what, value, format!("between 1 and {most}")));
            }
        }
        if self.keyframe_hz * f64::from(self.steps) > 1e6 {
            let remedy = format!(
                "at most {} at {} keyframes per second: instants are whole microseconds",
                (1e6 / self.keyframe_hz).floor(),
                self.keyframe_hz
            );
            return Err(ConfigError::new("steps", self.steps, remedy));
        }
        check_carrying(self.margin, self.dilate, self.sharpness, self.hole_below, self.fill)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_setting_is_known_at_any_rate() {
        let paper = SplatConfig::evis_paper(30.0, 8);
        assert!(paper.check().is_ok() && paper.is_evis_paper());
        assert!(!SplatConfig { nearest: true, ..paper }.is_evis_paper());
        assert!(SplatConfig::default().check().is_ok() && !SplatConfig::default().is_evis_paper());
    }

    #[test]
    fn values_that_cannot_be_used_are_named() {
        let good = SplatConfig::default();
        for (bad, name) in [
            (SplatConfig { keyframe_hz: 0.0, ..good }, "keyframe_rate"),
            (SplatConfig { keyframe_hz: f64::NAN, ..good }, "keyframe_rate"),
            (SplatConfig { steps: 0, ..good }, "steps"),
            (SplatConfig { keyframe_hz: 1e6, ..good }, "steps"),
            (SplatConfig { margin: 513, ..good }, "margin"),
            (SplatConfig { supersample: 5, ..good }, "supersample"),
            (SplatConfig { dilate: 9, ..good }, "dilate"),
            (SplatConfig { sharpness: f32::NAN, ..good }, "sharpness"),
            (SplatConfig { hole_below: 0.0, ..good }, "hole_below"),
            (SplatConfig { fill: Some(-1.0), ..good }, "fill"),
        ] {
            let error = bad.check().unwrap_err().to_string();
            assert!(error.starts_with(name), "{error}");
        }
    }
}
