//! What a run is asked to do: a value, checked once by [`RunConfig::check`], then trusted.

pub mod dense;
pub mod grid;
pub mod scene_sensor;

pub use scene_sensor::scene_sensors;

use std::collections::BTreeMap;

use evis_core::sensor::{SensorConfig, TriggerRule};
use evis_core::{ConfigError, LabelKind, Sensor, TimeGrid, Warp, WarpVariant, Word};
use serde::{Deserialize, Serialize};

use crate::config::dense::DenseOutput;
use crate::config::grid::SampleGrid;
use crate::gpu::sizes::MAX_INSTANTS;

/// `eps` of the EVIS paper's code in `ln(Y + eps)`.
pub const EVIS_PAPER_LOG_EPS: f32 = 1e-5;

/// Seconds of a block of adaptive sampling.
const BLOCK_S: f64 = 0.016;

/// Exposure of frames where none is asked for, at most.
const USUAL_EXPOSURE_US: i64 = 10_000;

/// Cells along each side of a pixel of a distorted lens, at most, with coverage samples and with whole ones.
const COVERAGE_CELLS: f64 = 6.0;
const SAMPLE_CELLS: f64 = 8.0;

/// The share of tiles that are audited.
const USUAL_AUDIT: f64 = 0.005;

/// How an instant is sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Every instant is rendered.
    #[default]
    Native,
    /// Keyframes are rendered; the instants between two of them are splatted from both.
    Splat(Warp),
    /// Nothing is rendered: visibility is found in continuous time, light is kept on surfaces, and each pixel is evaluated at
    /// times of its own (`evis-decoupled`, on the CPU).
    Decoupled,
}

/// Defaults of a warp, of both variants.
const SPLAT: Method = Method::Splat(Warp::of(WarpVariant::Splat));
const EVIS_PAPER: Method = Method::Splat(Warp::of(WarpVariant::EvisPaper));

evis_core::words!(Method {
    Self::Native => "native", "instants are rendered";
    Self::Decoupled => "decoupled", "surfaces are followed in continuous time, each pixel is evaluated at its own times, on the CPU";
    SPLAT => "splat", "keyframes are rendered; what lies between is splatted from both";
    EVIS_PAPER => "evis-paper", "as the EVIS paper publishes it: linear motion, colours, latch, black holes";
});

impl Method {
    /// Its name: `native`, `decoupled`, `splat`, or `evis-paper` for `splat` as that paper publishes it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Splat(warp) => warp.variant.name(),
            Self::Decoupled => "decoupled",
        }
    }

    /// Whether each tile of a picture may have a rate of its own: see [`RunConfig::adaptive_px`].
    pub const fn has_adaptive_time(&self) -> bool {
        match self {
            Self::Native => true,
            Self::Splat(_) | Self::Decoupled => false,
        }
    }

    /// Keyframes per second and instants per gap, where it has keyframes.
    pub fn keyframes(&self) -> Option<(f64, u32)> {
        match self {
            Self::Native | Self::Decoupled => None,
            Self::Splat(warp) => Some((warp.scene_keyframe_hz(), warp.scene_steps())),
        }
    }
}

/// How a pixel's area is sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Antialias {
    /// Visibility and shading at every sample.
    #[default]
    Samples,
    /// Visibility at every sample, shading at one in four (MSAA), which lie on a grid: 4, 16, 36, 64, ... samples.
    /// Outlines are as fine as with as many whole samples, shading as with a quarter of them.
    Edges,
}

evis_core::words!(Antialias {
    Self::Samples => "samples", "visibility and shading at every sample";
    Self::Edges => "edges", "visibility at every sample, shading at one in four";
});

/// Where decoupled sampling evaluates pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Compute {
    /// On the processor's cores, in 64 bits.
    #[default]
    Cpu,
    /// By compute passes on the device, in 32 bits. What stays on the processor: materials with other maps than one of base
    /// colour behind a distorted lens, orthographic cameras with one, and stages of sensors that take frames.
    Gpu,
}

evis_core::words!(Compute {
    Self::Cpu => "cpu", "on the processor's cores";
    Self::Gpu => "gpu", "by compute passes on the device";
});

/// How log light runs between two samples of a tile, in adaptive time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// Along a straight line.
    #[default]
    Line,
    /// Along a cubic through the samples, its slopes from the sample before and the one after, in straight pieces. It rises
    /// where three samples in a row rise, and rests next to a sample that does not change anything. A sensor that is more than its thresholds takes lines, and a latch has no use for either.
    Curve,
}

/// How shadows are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shadows {
    /// By maps fitted to the world: soft by a texel, which is centimetres in a street.
    #[default]
    Maps,
    /// By maps where they are sure, and by rays along shadows' borders: as sharp as the casters, for up to twice the
    /// work. Casters must be rigid and without holes.
    Rays,
}

evis_core::words!(Shadows {
    Self::Maps => "maps", "by shadow maps, soft by a texel";
    Self::Rays => "rays", "along borders by rays, as sharp as the casters, for up to twice the work";
});

/// How near to the truth events are, and how much work that is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// For a first look.
    Draft,
    /// For most uses.
    #[default]
    Standard,
    /// Sharp shadows, fine edges.
    High,
    /// As near to the truth as sampling comes within reason.
    Reference,
}

evis_core::words!(Quality {
    Self::Draft => "draft", "a sample per pixel of motion, 16 coverage samples";
    Self::Standard => "standard", "a sample per half pixel of motion, 16 coverage samples";
    Self::High => "high", "a sample per 0.3 pixels of motion, 144 coverage samples, shadow rays";
    Self::Reference => "reference", "a sample per 0.15 pixels of motion, 256 coverage samples, shadow rays";
});

impl Quality {
    /// All, the cheapest first.
    pub const ALL: [Self; 4] = [Self::Draft, Self::Standard, Self::High, Self::Reference];

    /// As users write it.
    pub fn name(self) -> &'static str {
        self.word()
    }

    /// The next cheaper preset, if there is one.
    pub fn cheaper(self) -> Option<Self> {
        let at = Self::ALL.iter().position(|quality| *quality == self)?;
        at.checked_sub(1).and_then(|at| Self::ALL.get(at).copied())
    }
}

/// Tiles that decoupled sampling leaves to rendering, in adaptive time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderedTiles {
    /// Those in which there are more triangles smaller than a pixel than so many for each pixel, at some time.
    pub triangles_per_pixel: f64,
    /// Pixels that anything may move between two samples of them.
    pub step_px: f64,
}

impl RenderedTiles {
    fn check(&self, method: &Method) -> Result<(), ConfigError> {
        let Self { triangles_per_pixel, step_px } = *self;
        if *method != Method::Decoupled {
            return Err(ConfigError::new("rendered_tiles", "set", "set with decoupled only"));
        }
        for (what, value) in [("triangles_per_pixel", triangles_per_pixel), ("step_px", step_px)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(ConfigError::new(&format!("rendered_tiles.{what}"), value, "above 0"));
            }
        }
        Ok(())
    }
}

/// What a run is asked to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunConfig {
    /// Sensor of every camera that `sensors` does not name. Thresholds that the scene gives a camera come before those of
    /// its sensor.
    pub sensor: SensorConfig,
    /// Sensors of single cameras, by name; see [`crate::scene_sensors`].
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub sensors: BTreeMap<String, SensorConfig>,
    /// Sampling method.
    pub method: Method,
    /// The preset that method, rate, samples and shadows come from; they stand below, and are what counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality: Option<Quality>,
    /// Sampled instants per second; a method with keyframes has its own rate and ignores this one.
    pub rate_hz: f64,
    /// Pixels that anything may move between two samples. Of `native`: every tile of the picture is rendered no more often
    /// than that, and `rate_hz` at most; `None` renders everything at `rate_hz`. Of `decoupled`: the length of a pixel's
    /// intervals, halved where a threshold is near; 1 where it is `None`.
    pub adaptive_px: Option<f64>,
    /// Of `decoupled`: tiles of a picture in which triangles are smaller than pixels are rendered; `None` follows every triangle.
    /// Every triangle is followed, too, without a device, with poses from a host, in environments that differ, behind distorted
    /// lenses, and with sensors that have a readout bus or stages that are defined on frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rendered_tiles: Option<RenderedTiles>,
    /// With `adaptive_px`: how light runs between two samples. Requests and presets take curves; lines are those of settings that
    /// were stored before, and of tests.
    #[serde(skip_serializing_if = "is_line")]
    pub between: Interpolation,
    /// Samples per pixel and instant, 1 to 256.
    pub samples: u32,
    /// How they are taken.
    pub antialias: Antialias,
    /// Places at which a sample reads a texture that light is proportional to, at most, along each side of its share of the
    /// pixel, 1 to 16; beyond them mip levels average, and blur. `None` takes 2 up to 8 samples, 3 up to 15, then 4.
    pub texture_taps: Option<u32>,
    /// Where decoupled sampling evaluates pixels; other methods render on the device.
    #[serde(skip)]
    pub compute: Compute,
    /// How shadows are found; `None` leaves it to a quality preset, and is by maps without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shadows: Option<Shadows>,
    /// Texels of a shadow map's edge, 64 to 16384, and as many as the device can at most. `None` takes the power of two nearest
    /// to 12.8 times the longest edge of any of the scene's pictures, 1024 to 8192 (640x480: 8192), but 4096 at most where more
    /// than two lights throw shadows, and 2048 where one of them moves or more than eight throw any.
    pub shadow_map: Option<u32>,
    /// Names of the cameras to render; empty for all.
    pub cameras: Vec<String>,
    /// Width and height in pixels for every camera; `None` takes each camera's own (640x480 where it has none).
    pub size: Option<(u32, u32)>,
    /// Scene time at which the stream starts, in microseconds; the stream's own time starts at 0.
    pub start_us: i64,
    /// Seed of everything random.
    pub seed: u64,
    /// Labels to render.
    pub labels: Vec<LabelKind>,
    /// Label images per second.
    pub label_rate_hz: f64,
    /// Frames per second beside the events: mean linear light over an exposure. `None`: no frames.
    pub frame_rate_hz: Option<f64>,
    /// Exposure of a frame in microseconds; even, so that its middle is a whole microsecond.
    pub exposure_us: i64,
    /// The share of tiles that are skipped, or sampled less often than at every instant, which are rendered once more and
    /// compared; no event depends on it. 0 audits nothing.
    pub audit: f64,
    /// Microseconds between the ends of steps, where a host moves something: blocks of instants then end where steps may. `None`
    /// where nothing is driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose_step_us: Option<i64>,
    /// Arrays that packets carry in the place of events, made on the device where its sensors fire. No part of what
    /// recordings keep, which have events.
    #[serde(skip)]
    pub dense: Option<DenseOutput>,
    /// `Y_ref` in `ln(Y / Y_ref + eps)`; `None` takes the value that brings the first camera's log-mean to 0.18.
    pub reference_luminance: Option<f32>,
}

/// Rows of the cells of `samples` samples, of which there are no more than columns: as `frame::pattern` divides a pixel.
fn pattern_rows(samples: u32) -> u32 {
    (1..=samples.isqrt()).rev().find(|rows| samples.is_multiple_of(*rows)).unwrap_or(1)
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            sensor: SensorConfig::default(),
            sensors: BTreeMap::new(),
            method: Method::Native,
            quality: None,
            rate_hz: 1000.0,
            adaptive_px: None,
            rendered_tiles: None,
            between: Interpolation::Line,
            samples: 4,
            antialias: Antialias::Samples,
            texture_taps: None,
            compute: Compute::default(),
            shadows: None,
            shadow_map: None,
            cameras: Vec::new(),
            size: None,
            start_us: 0,
            seed: 0,
            labels: Vec::new(),
            label_rate_hz: 50.0,
            frame_rate_hz: None,
            exposure_us: USUAL_EXPOSURE_US,
            audit: USUAL_AUDIT,
            pose_step_us: None,
            dense: None,
            reference_luminance: None,
        }
    }
}

/// The longest exposure of frames, so many a second: the time between two, as an even number of microseconds.
fn longest_exposure_us(frame_rate_hz: f64) -> i64 {
    (1e6 / frame_rate_hz) as i64 / 2 * 2
}

fn is_line(between: &Interpolation) -> bool {
    *between == Interpolation::Line
}

/// `sensor` of camera `camera`, if it can be.
pub(crate) fn checked(camera: &str, sensor: SensorConfig) -> Result<SensorConfig, ConfigError> {
    let place = |e: ConfigError| ConfigError { what: format!("camera '{camera}': {}", e.what), ..e };
    Ok(Sensor::new(sensor).map_err(place)?.config().clone())
}

impl RunConfig {
    /// The sensor of camera `camera`, but for thresholds that the scene gives it.
    pub fn sensor_of(&self, camera: &str) -> &SensorConfig {
        self.sensors.get(camera).unwrap_or(&self.sensor)
    }

    /// Says which sensor each of `cameras` has: [`RunConfig::sensor`] is that of all but those in [`RunConfig::sensors`].
    pub(crate) fn set_sensors<'a>(
        &mut self,
        cameras: impl Iterator<Item = (&'a str, &'a SensorConfig)> + Clone,
    ) {
        // One that no camera has would tell a reader something that is not true.
        if let Some((_, first)) = cameras.clone().next()
            && cameras.clone().all(|(_, sensor)| *sensor != self.sensor)
        {
            self.sensor = first.clone();
        }
        let others = cameras.filter(|(_, sensor)| **sensor != self.sensor);
        self.sensors = others.map(|(name, sensor)| (name.to_owned(), sensor.clone())).collect();
    }

    /// The sampled instants.
    ///
    /// # Errors
    /// A rate that is not above 0, or above 1 MHz.
    pub fn sample_grid(&self) -> Result<SampleGrid, ConfigError> {
        let block = self.block();
        let (keyframe_hz, steps) =
            self.method.keyframes().unwrap_or((self.rate_hz / f64::from(block), block));
        SampleGrid::new(keyframe_hz, steps)
    }

    /// Instants within which each tile of a picture has a rate of its own, a power of two: some 16 ms of them, so that what
    /// moves slowly is sampled 60 times a second. 1 where all tiles are sampled at every instant.
    pub fn block(&self) -> u32 {
        let longest = (self.rate_hz * BLOCK_S).clamp(1.0, f64::from(MAX_INSTANTS)) as u32;
        let adaptive = self.method.has_adaptive_time() && self.adaptive_px.is_some();
        if !adaptive {
            return 1;
        }
        let usual = longest.max(1).ilog2();
        // No block reaches beyond a step.
        let fits = self.pose_step_us.map_or(usual, |us| self.instants_of(us).map_or(0, u64::trailing_zeros));
        1 << usual.min(fits)
    }

    /// Instants in `us` microseconds, where that is a whole number of them and each comes after a whole number of microseconds.
    fn instants_of(&self, us: i64) -> Option<u64> {
        let apart_us = 1e6 / self.rate_hz;
        let count = us as f64 / apart_us;
        (us > 0 && apart_us.fract() == 0.0 && count.fract() == 0.0).then_some(count as u64)
    }

    /// [`RunConfig::texture_taps`], chosen where it is not given.
    ///
    /// Few samples leave edges rougher than coarse places leave textures, so finer ones are not worth their work. On the
    /// built-in `warehouse` 2 instead of 4 take 0.57 of the time with 4 samples, and 0.89 with 16.
    pub const fn taps(&self) -> u32 {
        match (self.texture_taps, self.samples) {
            (Some(taps), _) => taps,
            (None, 0..=8) => 2,
            (None, 9..=15) => 3,
            (None, _) => 4,
        }
    }

    /// The exposure of frames where none is asked for: the usual one, as far as it fits between two.
    pub fn usual_exposure_us(frame_rate_hz: Option<f64>) -> i64 {
        frame_rate_hz.map_or(USUAL_EXPOSURE_US, |rate_hz| USUAL_EXPOSURE_US.min(longest_exposure_us(rate_hz)))
    }

    /// What packets carry beside events: labels, and frames where they are on.
    pub fn carried(&self) -> Vec<LabelKind> {
        let mut kinds = self.labels.clone();
        kinds.extend(self.frame_rate_hz.map(|_| LabelKind::Frame));
        kinds.sort_unstable();
        kinds.dedup();
        kinds
    }

    /// Whether light runs along curves for any of the sensors: for those of thresholds alone, unless they latch.
    pub fn takes_curves(&self) -> bool {
        let usual = self.sensors.is_empty().then_some(&self.sensor);
        let bends = |sensor: &SensorConfig| sensor.is_ideal() && sensor.trigger == TriggerRule::Crossing;
        self.between == Interpolation::Curve && self.sensors.values().chain(usual).any(bends)
    }

    fn check_frames(&self) -> Result<(), ConfigError> {
        let Some(rate_hz) = self.frame_rate_hz else {
            if self.labels.contains(&LabelKind::Frame) {
                return Err(ConfigError::new(
                    "labels",
                    "frame",
                    "without frame: give `frame_rate_hz` instead",
                ));
            }
            return Ok(());
        };
        TimeGrid::new(rate_hz).map_err(|e| ConfigError { what: "frame_rate_hz".into(), ..e })?;
        let longest = longest_exposure_us(rate_hz);
        if longest < 2 {
            let remedy = "500000 frames per second at most: an exposure lasts 2 microseconds and more";
            return Err(ConfigError::new("frame_rate_hz", rate_hz, remedy));
        }
        if self.exposure_us % 2 != 0 || !(2..=longest).contains(&self.exposure_us) {
            return Err(ConfigError::new(
                "exposure_us",
                format!("{} us", self.exposure_us),
                format!("an even number of microseconds, from 2 to {longest} at {rate_hz} frames per second"),
            ));
        }
        Ok(())
    }

    /// Places along each side of a pixel at which it is shaded with [`Antialias::Edges`]; else 1.
    pub(crate) const fn coverage_grid(&self) -> u32 {
        match self.antialias {
            Antialias::Edges => (self.samples / 4).isqrt(),
            Antialias::Samples => 1,
        }
    }

    /// Pixels of the picture without distortion along each side of a pixel of a camera with a distorted lens.
    ///
    /// They give its area more cells than `samples`, as cells that lie across the border of a pixel blur it: half as many again
    /// along each side of coverage samples, twice as many of whole ones, up to six and eight. On `spinner` at 96x72, with 16
    /// samples, F1 (1 ms) is then 0.957 to 0.978, and 0.942 to 0.955 of a pinhole (25 November 2026, lavapipe).
    pub(crate) fn picture_density(&self) -> f64 {
        let side = f64::from(self.samples).sqrt();
        let (cells, wanted) = match self.antialias {
            Antialias::Edges => (self.coverage_grid(), (1.5 * side).min(COVERAGE_CELLS)),
            Antialias::Samples => (pattern_rows(self.samples), (2.0 * side).min(SAMPLE_CELLS)),
        };
        (wanted / f64::from(cells.max(1))).max(1.0)
    }

    /// Checks every value that can be checked without a scene or a device.
    ///
    /// # Errors
    /// Names the first setting that cannot be used, its value, and what would work.
    pub fn check(&self) -> Result<(), ConfigError> {
        Sensor::new(self.sensor.clone())?;
        for (camera, sensor) in &self.sensors {
            checked(camera, sensor.clone())?;
        }
        if let Method::Splat(warp) = &self.method {
            warp.check_scene()?;
        }
        if let Some(px) = self.adaptive_px {
            if self.method.keyframes().is_some() {
                return Err(ConfigError::new("adaptive_px", px, "set with native and decoupled only"));
            }
            if !(px.is_finite() && px > 0.0) {
                return Err(ConfigError::new("adaptive_px", px, "above 0 (pixels between two samples)"));
            }
        }
        self.rendered_tiles.map_or(Ok(()), |tiles| tiles.check(&self.method))?;
        if self.between == Interpolation::Curve && self.adaptive_px.is_none() {
            return Err(ConfigError::new("between", "curve", "line, without adaptive time (`adaptive_px`)"));
        }
        let side = self.coverage_grid();
        if self.antialias == Antialias::Edges && self.samples != 4 * side * side {
            let remedy = "4, 16, 36, 64, 100, 144, 196 or 256 with `antialias` edges: one in four is shaded, on a grid";
            return Err(ConfigError::new("samples", self.samples, remedy));
        }
        // What a rate may stretch an interval to.
        let grid = self.sample_grid().map_err(|e| ConfigError { what: "rate_hz".into(), ..e })?;
        let interval_us = grid.longest_interval_us() * f64::from(self.block());
        let all_ideal = self.sensors.values().chain([&self.sensor]).all(SensorConfig::is_ideal);
        if !all_ideal && interval_us > f64::from(OLD_US / 2) {
            return Err(ConfigError::new(
                "rate_hz",
                format!("an instant every {:.0} s", interval_us * 1e-6),
                "one in 268 s at least, for a sensor with more than thresholds",
            ));
        }
        TimeGrid::new(self.label_rate_hz).map_err(|e| ConfigError { what: "label_rate_hz".into(), ..e })?;
        self.check_frames()?;
        if !(1..=256).contains(&self.samples) {
            return Err(ConfigError::new("samples", self.samples, "between 1 and 256"));
        }
        if let Some(taps) = self.texture_taps.filter(|taps| !(1..=16).contains(taps)) {
            return Err(ConfigError::new("texture_taps", taps, "between 1 and 16"));
        }
        if let Some(edge) = self.shadow_map.filter(|edge| !(64..=16_384).contains(edge)) {
            return Err(ConfigError::new("shadow_map", edge, "between 64 and 16384 texels"));
        }
        if let Some((width, height)) = self.size {
            for (what, value) in [("width", width), ("height", height)] {
                if !(1..=8192).contains(&value) {
                    return Err(ConfigError::new(what, value, "between 1 and 8192 pixels"));
                }
            }
        }
        if !(0.0..=1.0).contains(&self.audit) {
            return Err(ConfigError::new("audit", self.audit, "from 0 to 1 (a share of the tiles)"));
        }
        if self.start_us < 0 {
            return Err(ConfigError::new("start", self.start_us as f64 * 1e-6, "0 or later (seconds)"));
        }
        if let Some(dense) = &self.dense {
            dense.check()?;
            if self.labels.contains(&LabelKind::Cause) {
                let remedy = "without cause: it is of events, and packets have dense arrays in their place";
                return Err(ConfigError::new("labels", "cause", remedy));
            }
        }
        if let Some(y) = self.reference_luminance
            && !(y.is_finite() && y > 0.0)
        {
            return Err(ConfigError::new("reference_luminance", y, "a finite number above 0"));
        }
        Ok(())
    }
}

/// Ages saturate or fold here, in microseconds; `chain/layout.wgsl` has the same constant.
pub const OLD_US: u32 = 1 << 29;

#[cfg(test)]
mod tests {
    use evis_core::sensor::Photoreceptor;

    use super::*;

    #[test]
    fn pictures_of_distorted_lenses_are_as_dense_as_their_cells_ask() {
        let density =
            |antialias, samples| RunConfig { antialias, samples, ..RunConfig::default() }.picture_density();
        assert_eq!([4, 16, 144, 256].map(|n| density(Antialias::Edges, n)), [3.0, 3.0, 1.0, 1.0]);
        assert_eq!([1, 4, 16, 64].map(|n| density(Antialias::Samples, n)), [2.0, 2.0, 2.0, 1.0]);
        for n in 1..=256_u32 {
            let [_, rows] = crate::frame::pattern::grid(n as usize);
            assert_eq!(pattern_rows(n) as usize, rows, "{n} samples");
        }
    }

    #[test]
    fn curves_are_for_sensors_of_thresholds_that_do_not_latch() {
        let curved = RunConfig { between: Interpolation::Curve, ..RunConfig::default() };
        assert!(curved.takes_curves() && !RunConfig::default().takes_curves());
        let latch = SensorConfig { trigger: TriggerRule::Latch, ..SensorConfig::default() };
        let photoreceptor = Photoreceptor { cutoff_hz: 100.0, ..Photoreceptor::default() };
        let slow = SensorConfig { photoreceptor, ..SensorConfig::default() };
        for sensor in [latch.clone(), slow.clone()] {
            assert!(!RunConfig { sensor: sensor.clone(), ..curved.clone() }.takes_curves(), "{sensor:?}");
        }
        // Cameras' own come before the one for all.
        let own = |of: [(&str, SensorConfig); 2]| RunConfig {
            sensors: of.map(|(name, sensor)| (name.into(), sensor)).into(),
            ..curved.clone()
        };
        assert!(!own([("left", latch.clone()), ("right", slow)]).takes_curves());
        assert!(own([("left", latch), ("right", SensorConfig::default())]).takes_curves());
    }
}
