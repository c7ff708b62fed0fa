//! Settings of a run, and what it took.

use std::sync::Arc;

use evis_core::emulator::tiled::Losses;
use evis_core::random::Key;
use evis_core::{ConfigError, Sensor, SensorConfig, TimeGrid};

use crate::Error;
use crate::run::device::Devices;
use crate::run::frames::block_us;
use crate::signal::path::STEP_PX;

/// Limits of [`Settings::step_px`].
const LEAST_STEP_PX: f64 = 0.05;
const MOST_STEP_PX: f64 = 8.0;

/// Settings of a run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The sensor.
    pub sensor: SensorConfig,
    /// Of all that is random in it.
    pub key: Key,
    /// Frames per second that a sensor takes whose stages are defined on them ([`SensorConfig::needs_frames`]).
    pub rate_hz: f64,
    /// Threads that such a sensor's pixels are shared among; 0: as many as there are cores.
    pub sensor_threads: usize,
    /// Index of the camera.
    pub camera: usize,
    /// Width and height in pixels; `None` takes the camera's own.
    pub size: Option<(u32, u32)>,
    /// Scene time at which the stream starts, in microseconds.
    pub start_us: i64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// Length of a block in microseconds, a power of two.
    pub block_us: i64,
    /// Pixels by which anything that a pixel sees moves in an interval, at most: light is a quadratic there, and intervals
    /// in which a threshold may be crossed are halved as often as it takes.
    pub step_px: f64,
    /// `Y_ref`; `None` takes the luminance that brings the picture's log-mean at the start to 0.18.
    pub reference_luminance: Option<f64>,
    /// What follows pixels where it can; the processor's cores where this is `None`.
    pub devices: Option<Arc<dyn Devices>>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            sensor: SensorConfig::default(),
            key: Key::new(0, 0, 0),
            rate_hz: 1000.0,
            sensor_threads: 0,
            camera: 0,
            size: None,
            start_us: 0,
            duration_us: 250_000,
            block_us: 32_768,
            step_px: STEP_PX,
            reference_luminance: None,
            devices: None,
        }
    }
}

impl Settings {
    pub(crate) fn check(&self) -> Result<(), Error> {
        Sensor::new(self.sensor.clone())?;
        TimeGrid::new(self.rate_hz)?;
        if !(64..=1 << 20).contains(&self.block_us) || self.block_us.count_ones() != 1 {
            let remedy = "a power of two between 64 and 1048576 microseconds";
            return Err(ConfigError::new("block_us", self.block_us, remedy).into());
        }
        if !(LEAST_STEP_PX..=MOST_STEP_PX).contains(&self.step_px) {
            let remedy = format!("between {LEAST_STEP_PX} and {MOST_STEP_PX} pixels");
            return Err(ConfigError::new("adaptive_px", self.step_px, remedy).into());
        }
        if !(1..=86_400_000_000).contains(&self.duration_us) {
            return Err(ConfigError::new("duration_us", self.duration_us, "above 0 and at most a day").into());
        }
        if !(0..=86_400_000_000).contains(&self.start_us) {
            return Err(ConfigError::new("start_us", self.start_us, "between 0 and a day").into());
        }
        Ok(())
    }

    /// The length of blocks: that asked for, or a shorter one that holds the frames of a sensor that takes them.
    pub(crate) fn most_us(&self) -> i64 {
        match self.sensor.needs_frames() {
            Some(_) => block_us(self.block_us, self.rate_hz),
            None => self.block_us,
        }
    }
}

/// What a run took. Seconds are of wall time, summed over threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Report {
    /// Records and tile lists.
    pub lists_s: f64,
    /// Light that is prepared per block.
    pub light_s: f64,
    /// All work on pixels.
    pub pixels_s: f64,
    /// Of that, coverage, extrapolated from every 64th evaluation.
    pub coverage_s: f64,
    /// Of that, shading, extrapolated likewise.
    pub shading_s: f64,
    /// Evaluations of a pixel. What a device has followed of several views is in the report of the first of them, here and below.
    pub evaluations: u64,
    /// Entries of all pixels' lists, over all blocks.
    pub entries: u64,
    /// Pixels times blocks.
    pub pixel_blocks: u64,
    /// Of these, those in which something moves and light stays between a pixel's thresholds, as bounds say.
    pub quiet: u64,
    /// Pixels, counted for each block, in tiles of which nothing changes: these are left out.
    pub resting: u64,
    /// Of the evaluations, those on a device.
    pub on_device: u64,
    /// Pixels times blocks that a device left to the processor, since something of them did not fit.
    pub refollowed: u64,
    /// Evaluations of a pixel that one facet covers.
    pub plain: u64,
    /// Places of surfaces shaded before evaluations.
    pub places: u64,
    /// What the sensor lost.
    pub losses: Losses,
}
