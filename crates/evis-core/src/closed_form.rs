//! Oracle 1: patterns whose events are known in closed form.
//!
//! A [`Signal`] gives the light of any pixel as a function of time ([`PixelLight`]): a formula with known turning points
//! and, between them, an inverse. [`solve`] walks along these monotone pieces and counts what each crosses, so no pair of
//! events can hide between samples: there are none. Everything is f64.
//!
//! Image coordinates are pixels, x to the right and y down from the top-left corner, pixel centres at +0.5; time is
//! seconds from the stream's start; light is linear, in any unit that `reference_luminance` shares.

use crate::event::Event;
use crate::packet::CameraInfo;
use crate::sensor::{ConfigError, SensorConfig};
use crate::truth::Truth;

pub mod convergence;
mod light;
mod signals;
mod solve;
#[cfg(test)]
mod tests;

pub use light::{Coverage, Piece, PixelLight, half_plane_area};
pub use signals::{Bar, Edge, ExponentialRamp, Flicker, FlickerShape, LinearRamp, Sinusoid, Spokes};
pub use solve::{Crossing, PixelTruth, Turn, solve};

/// Over what a pixel takes its mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Footprint {
    /// Its area: the reference.
    #[default]
    Box,
    /// Its centre: what one sample is asked for.
    Point,
}

/// A pattern of light in closed form.
pub trait Signal: std::fmt::Debug + Send + Sync {
    /// Name in reports.
    fn name(&self) -> &'static str;

    /// Whether its numbers make a pattern of light.
    ///
    /// # Errors
    /// Names the first that does not, and what would.
    fn check(&self) -> Result<(), ConfigError>;

    /// Light over time of the pixel whose centre is the image point (`x`, `y`).
    fn pixel(&self, x: f64, y: f64) -> PixelLight;

    /// Light of that pixel at `t_s` seconds. For many times of one pixel, ask [`Signal::pixel`] once.
    fn luminance(&self, x: f64, y: f64, t_s: f64) -> f64 {
        self.pixel(x, y).luminance(t_s)
    }

    /// How fast the pattern moves at an image point; 0 where it stands or only flickers.
    fn speed_px_per_s(&self, _x: f64, _y: f64) -> f64 {
        0.0
    }
}

/// Truth of `pixels` (in any order) of a camera that sees `signal`, over `[0, duration_us)`.
///
/// # Errors
/// A signal, sensor or duration that cannot be used, or a pixel outside the camera's image.
pub fn truth(
    signal: &dyn Signal,
    camera: &CameraInfo,
    sensor: &SensorConfig,
    reference_luminance: f64,
    pixels: &[[u16; 2]],
    duration_us: i64,
) -> Result<Truth, ConfigError> {
    signal.check()?;
    if duration_us < 0 {
        return Err(ConfigError::new("duration", duration_us, "0 microseconds or more"));
    }
    let mut pixels = pixels.to_vec();
    pixels.sort_by_key(|[x, y]| (*y, *x));
    pixels.dedup();
    let mut fired: Vec<(Event, f32)> = Vec::new();
    for &[x, y] in &pixels {
        if u32::from(x) >= camera.width || u32::from(y) >= camera.height {
            let remedy = format!("inside the image of {}x{} pixels", camera.width, camera.height);
            return Err(ConfigError::new("pixel", format!("({x}, {y})"), remedy));
        }
        let (at_x, at_y) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let one = solve(&signal.pixel(at_x, at_y), sensor, reference_luminance, duration_us as f64 * 1e-6)?;
        let speed = signal.speed_px_per_s(at_x, at_y) as f32;
        let events = one.within(0, duration_us).iter();
        fired.extend(events.map(|c| (Event::new(c.t_us, x, y, c.polarity), speed)));
    }
    fired.sort_by_key(|(event, _)| event.order());
    let (events, speed) = fired.into_iter().unzip();
    let pattern = format!("{signal:?}");
    Ok(Truth {
        camera: camera.clone(),
        sensor: sensor.clone(),
        reference_luminance,
        duration_us,
        pixels,
        events,
        speed,
        event_region: Vec::new(),
        span_start: Vec::new(),
        spans: Vec::new(),
        provenance: format!(
            "{{\"oracle\": \"closed form\", \"signal\": {:?}, \"pattern\": {pattern:?}}}",
            signal.name()
        ),
    })
}
