//! What `auto` finds out before it runs: some tiles of the picture, at some times of the scene, fire with cheap settings and
//! with fine ones, and the cheapest are taken whose events are those of the fine ones. It reads scene, poses and settings
//! alone: no truth, no clock, no packet, and no more than the first few views.

use std::sync::Arc;

use evis_core::metric::{self, ScoreSettings};
use evis_core::truth::Truth;
use evis_core::{CameraInfo, Event, ExposureShape, LabelData, LabelKind, SensorConfig};
use evis_scene::Scene;

use crate::auto::{self, Site, VIEWS};
use crate::config::{Antialias, Between, Method, RunConfig};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::pace::{TILE, tiles_along};
use crate::packet::ViewPacket;
use crate::simulator::Simulator;

/// Times of the scene at which it looks, from its start to its end.
pub const PLACES: usize = 3;
/// How long it looks at each, at least and at most: in steps of the least, which are whole blocks of adaptive time.
const LEAST_US: i64 = 16_000;
const MOST_US: i64 = 256_000;
/// How far half of the tiles that are looked at should move meanwhile: what samples miss shows as their places move over what
/// is seen, so that for less motion all settings seem good.
const MOTION_PX: f64 = 2.0;
/// Tiles, of all views together, that it looks at with the cheapest settings at each time.
const TILES: usize = 24;
/// The same with all others: so many that about [`WANTED`] events fire.
const LEAST_TILES: usize = 8;
const MOST_TILES: usize = 64;
/// With 4000 events that are independent of each other, an F1 of 0.98 is uncertain by 0.002.
const WANTED: usize = 4000;
/// Fewer events tell nothing: an F1 of 0.98 would be uncertain by 0.006 and more.
const LEAST: u64 = 500;
/// Flow is measured over the time from one label to the next, so many of them per second.
const FLOW_HZ: f64 = 1000.0;
/// Within which two events count as the same: what targets are about.
const TOLERANCE_US: i64 = 1000;

/// Looks at a scene.
pub struct Pilot<'a> {
    gpu: &'a Gpu,
    scene: Arc<Scene>,
    cameras: Vec<CameraInfo>,
    places: Vec<Place>,
    reference_luminance: Option<f32>,
    /// Told before each place, returns whether to stop.
    stop: &'a dyn Fn() -> bool,
}

/// What is looked at from one time on.
struct Place {
    start_us: i64,
    length_us: i64,
    /// Per view and tile: pixels per second, at most.
    speeds: Vec<Vec<f64>>,
    /// Per view: which tiles.
    only: Vec<Vec<bool>>,
    /// Per view and pixel: pixels per second at the start, 0 where nothing moves.
    flow: Vec<Vec<f32>>,
}

/// What fired at each place, in each view.
pub struct Fired(Vec<Vec<Vec<Event>>>);

impl Fired {
    /// How many events.
    fn count(&self) -> usize {
        self.0.iter().flatten().map(Vec::len).sum()
    }
}

/// How events agree with finer ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    matched: u64,
    unmatched: u64,
    /// Of the finer ones.
    events: u64,
}

impl Agreement {
    /// F1 within 1 ms, scaled by image speed; `None` where too little fired to tell.
    pub fn f1(&self) -> Option<f64> {
        let all = 2 * self.matched + self.unmatched;
        (self.events >= LEAST).then(|| 2.0 * self.matched as f64 / all as f64)
    }
}

impl<'a> Pilot<'a> {
    /// For what `config` renders of `scene`, of which `site` was made.
    pub fn new(
        gpu: &'a Gpu,
        scene: &Arc<Scene>,
        config: &RunConfig,
        site: &Site<'_>,
        stop: &'a dyn Fn() -> bool,
    ) -> Result<Self, EngineError> {
        // Of the first environment.
        let cameras = site.cameras[..site.cameras.len().min(VIEWS)].to_vec();
        let length_us = (auto::length_s(scene, config.start_us as f64 * 1e-6) * 1e6) as i64;
        let place = |place: usize| {
            // What ends with the scene begins before its end, as long before as things are slow there.
            let speeds_at = |before_us: i64| {
                let room_us = (length_us - before_us).max(0);
                let start_us = config.start_us + room_us * place as i64 / (PLACES as i64 - 1);
                (start_us, site.speeds(start_us, cameras.len()))
            };
            let length_us = long_enough(&speeds_at(LEAST_US).1).min(length_us.max(LEAST_US));
            let (start_us, speeds) = speeds_at(length_us);
            Place { start_us, length_us, speeds, only: Vec::new(), flow: Vec::new() }
        };
        let places = (0..PLACES).map(place).collect();
        let scene = if scene.variants.len() > 1 {
            let mut first = (**scene).clone();
            first.variants.truncate(1);
            Arc::new(first)
        } else {
            Arc::clone(scene)
        };
        let mut pilot =
            Self { gpu, scene, cameras, places, reference_luminance: config.reference_luminance, stop };
        pilot.choose_tiles(TILES);
        pilot.measure_flow(config)?;
        Ok(pilot)
    }

    /// How fast what each pixel shows moves through it: tolerances are scaled by that.
    fn measure_flow(&mut self, config: &RunConfig) -> Result<(), EngineError> {
        let flow = RunConfig {
            method: Method::Native,
            adaptive_px: None,
            between: Between::Line,
            samples: 1,
            antialias: Antialias::Samples,
            shadows: None,
            labels: vec![LabelKind::FlowForward],
            label_rate_hz: FLOW_HZ,
            // Nothing fires before the first instant, whatever it is.
            reference_luminance: Some(1.0),
            ..self.plain(config)
        };
        let mut simulator = Simulator::new(self.gpu, Arc::clone(&self.scene), flow)?;
        let speed = |xy: &[f32]| {
            let speed = xy[0].hypot(xy[1]) * FLOW_HZ as f32;
            if speed.is_finite() { speed } else { 0.0 }
        };
        for place in &mut self.places {
            simulator.begin_again(place.start_us, Vec::new())?;
            let of = |view: ViewPacket| match view.labels.into_iter().next().map(|label| label.data) {
                Some(LabelData::F32(flow)) => flow.chunks_exact(2).map(speed).collect(),
                _ => Vec::new(),
            };
            place.flow = simulator.step(1)?.views.into_iter().map(of).collect();
        }
        Ok(())
    }

    /// What `config` renders, of the views that are looked at, with thresholds alone: what else a sensor does is the same for
    /// the same light.
    fn plain(&self, config: &RunConfig) -> RunConfig {
        let plain = |sensor: &SensorConfig| SensorConfig {
            threshold_on: sensor.threshold_on,
            threshold_off: sensor.threshold_off,
            log_eps: sensor.log_eps,
            ..SensorConfig::default()
        };
        RunConfig {
            cameras: self.cameras.iter().map(|camera| camera.name.clone()).collect(),
            sensor: plain(&config.sensor),
            sensors: config.sensors.iter().map(|(name, sensor)| (name.clone(), plain(sensor))).collect(),
            labels: Vec::new(),
            frame_rate_hz: None,
            exposure_shape: ExposureShape::Box,
            ..config.clone()
        }
    }

    /// Looks at `count` tiles at each place from now on.
    fn choose_tiles(&mut self, count: usize) {
        let each = count.div_ceil(self.cameras.len().max(1));
        for place in &mut self.places {
            place.only = place.speeds.iter().map(|of| spread(of, each)).collect();
        }
    }

    /// Looks at as many tiles as it takes for enough events, by what `fired`.
    pub fn adjust(&mut self, fired: &Fired) {
        let enough = TILES * WANTED / fired.count().max(1);
        self.choose_tiles(enough.clamp(LEAST_TILES, MOST_TILES));
    }

    /// Tiles that it looks at, at all places.
    pub fn tiles(&self) -> usize {
        self.places.iter().flat_map(|place| &place.only).flatten().filter(|only| **only).count()
    }

    /// What `config`, which has been settled, fires.
    ///
    /// # Errors
    /// A device that fails, or a stop.
    pub fn fire(&mut self, config: &RunConfig) -> Result<Fired, EngineError> {
        let config = RunConfig { reference_luminance: self.reference_luminance, ..self.plain(config) };
        let mut simulator = Simulator::new(self.gpu, Arc::clone(&self.scene), config)?;
        self.reference_luminance = simulator.config().reference_luminance;
        let mut fired = Vec::new();
        for place in &self.places {
            if (self.stop)() {
                return Err(EngineError::Stopped);
            }
            simulator.begin_again(place.start_us, place.only.clone())?;
            let views = simulator.step(place.length_us)?.views;
            let seen = views.into_iter().zip(&place.only).zip(&self.cameras).map(|((view, only), camera)| {
                let columns = tiles_along(camera.width);
                view.events.into_iter().filter(|event| only[tile_of(event, columns)]).collect()
            });
            fired.push(seen.collect());
        }
        Ok(Fired(fired))
    }

    /// How `fired` agrees with `finer`.
    ///
    /// # Errors
    /// Streams that are no streams of these cameras.
    pub fn agreement(&self, fired: &Fired, finer: &Fired) -> Result<Agreement, EngineError> {
        let mut sum = Agreement::default();
        let settings = ScoreSettings { tolerances_us: vec![TOLERANCE_US], ..ScoreSettings::default() };
        for ((place, fired), finer) in self.places.iter().zip(&fired.0).zip(&finer.0) {
            let streams = fired.iter().zip(finer).zip(&place.flow).zip(&self.cameras);
            for (((fired, finer), flow), camera) in streams {
                if finer.is_empty() {
                    sum.unmatched += fired.len() as u64;
                    continue;
                }
                let pixel = |event: &Event| u32::from(event.y) * camera.width + u32::from(event.x);
                let speed = |event: &Event| flow.get(pixel(event) as usize).copied().unwrap_or_default();
                let truth = Truth {
                    speed: finer.iter().map(speed).collect(),
                    ..Truth::from_events(
                        finer.clone(),
                        camera.clone(),
                        SensorConfig::default(),
                        1.0,
                        place.length_us,
                    )
                };
                let score = metric::score(fired, &truth, &settings)
                    .map_err(|e| EngineError::Device(format!("two streams cannot be compared: {e}")))?;
                for of in &score.tolerances {
                    sum.matched += of.scaled.matched;
                    sum.unmatched += of.scaled.missed + of.scaled.spurious;
                }
                sum.events += score.truth_events;
            }
        }
        Ok(sum)
    }
}

/// The tile of an event, in a picture of `columns` tiles.
fn tile_of(event: &Event, columns: u32) -> usize {
    (u32::from(event.y) / TILE * columns + u32::from(event.x) / TILE) as usize
}

/// How long it takes half of the tiles that move to move by [`MOTION_PX`].
fn long_enough(speeds: &[Vec<f64>]) -> i64 {
    let mut moving: Vec<f64> = speeds.iter().flatten().copied().filter(|speed| *speed > 0.0).collect();
    moving.sort_by(f64::total_cmp);
    // Where poses tell no speed it is infinite, and looks are short.
    let Some(middle) = moving.get(moving.len() / 2) else { return LEAST_US };
    let steps = (MOTION_PX / middle * 1e6 / LEAST_US as f64).ceil();
    (steps.max(1.0) as i64 * LEAST_US).min(MOST_US)
}

/// `count` of the tiles that move, evenly spread among them.
fn spread(speeds: &[f64], count: usize) -> Vec<bool> {
    let moving: Vec<usize> = (0..speeds.len()).filter(|tile| speeds[*tile] != 0.0).collect();
    let mut only = vec![false; speeds.len()];
    let count = count.min(moving.len());
    for k in 0..count {
        only[moving[(2 * k + 1) * moving.len() / (2 * count)]] = true;
    }
    only
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_spread_over_what_moves() {
        let speeds = [0.0, 3.0, 0.0, 1.0, f64::INFINITY, 2.0, 0.0];
        let chosen = |count| {
            let only = spread(&speeds, count);
            (0..speeds.len()).filter(|tile| only[*tile]).collect::<Vec<_>>()
        };
        assert_eq!(chosen(0), [0; 0]);
        assert_eq!(chosen(1), [4]);
        assert_eq!(chosen(2), [3, 5]);
        assert_eq!(chosen(4), [1, 3, 4, 5]);
        assert_eq!(chosen(100), [1, 3, 4, 5]);
        assert_eq!(spread(&[0.0; 3], 5), [false; 3]);
    }

    #[test]
    fn what_is_slow_is_looked_at_for_longer() {
        let of = |speeds: &[f64]| long_enough(&[speeds.to_vec(), vec![0.0]]);
        assert_eq!(of(&[]), 16_000);
        assert_eq!(of(&[0.0, 500.0, 130.0, 1000.0]), 16_000);
        assert_eq!(of(&[40.0, 30.0, 0.0, 0.0, 50.0]), 64_000);
        assert_eq!(of(&[1e-300, 1.0]), 256_000);
        assert_eq!(of(&[f64::INFINITY; 2]), 16_000);
    }

    #[test]
    fn few_events_tell_nothing() {
        let of = |matched, unmatched, events| Agreement { matched, unmatched, events }.f1();
        assert_eq!(of(0, 0, 0), None);
        assert_eq!(of(499, 0, 499), None);
        assert_eq!(of(500, 0, 500), Some(1.0));
        assert_eq!(of(450, 100, 500), Some(0.9));
    }
}
