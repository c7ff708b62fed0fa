//! Renders some tiles of the picture at some times of the scene, and compares what fires with what a reference fires. It reads
//! scene, poses and settings alone, and no more than the first few views.

use std::collections::BTreeSet;
use std::sync::Arc;

use evis_core::metric::{self, ScoreSettings};
use evis_core::truth::Truth;
use evis_core::{CameraInfo, Event, LabelData, LabelKind, SensorConfig};
use evis_scene::{Scene, SceneState};
use serde::{Deserialize, Serialize};

use crate::config::{Antialias, Interpolation, Method, RunConfig, Shadows};
use crate::engine::simulator::Simulator;
use crate::error::EngineError;
use crate::frame::{FrameData, FrameRequest};
use crate::gpu::Gpu;
use crate::output::packet::ViewPacket;
use crate::pass::raster::SurfaceLayouts;
use crate::sampling::tile_rate::TileRateEstimator;
use crate::sampling::view_motion::ViewMotion;
use crate::world::gpu_scene::GpuScene;
use crate::world::tiles::tile_at;
use crate::world::view::{self, View};

/// Views that are rendered.
const VIEWS: usize = 4;

/// Seconds over which a speed is taken.
const SPAN_S: f64 = 0.000_5;

/// Instants of the reference at each place, at most: its rate is the largest of these that needs no more.
const REFERENCE_INSTANTS: i64 = 128;

const REFERENCE_RATES_HZ: [f64; 3] = [4000.0, 2000.0, 1000.0];

/// Samples of the reference, each shaded. No candidate has as many shaded ones.
const REFERENCE_SAMPLES: u32 = 100;

/// Times of the scene that are rendered, from its start to its end.
pub const PLACES: usize = 3;

/// Stream rendered at each, at least and at most: in steps of the least, which are whole blocks of adaptive time.
const LEAST_US: i64 = 16_000;

const MOST_US: i64 = 256_000;

/// How far half of the rendered tiles should move meanwhile: what samples miss shows as they move over the scene, so that with
/// less motion all settings seem good.
const MOTION_PX: f64 = 2.0;

/// Tiles, of all views together, that are rendered with the cheapest settings at each time.
const TILES: usize = 24;

/// The same with all others: so many that about [`WANTED`] events fire.
const LEAST_TILES: usize = 8;

const MOST_TILES: usize = 64;

/// With 4000 events that are independent of each other, an F1 of 0.98 is uncertain by 0.002.
const WANTED: usize = 4000;

/// Fewer events tell nothing: an F1 of 0.98 would be uncertain by 0.006 and more.
const LEAST: usize = 500;

/// Flow is measured over the time from one label to the next, so many of them per second.
const FLOW_HZ: f64 = 1000.0;

/// Within which two events count as the same: what `draft` and `default` are about, and what `exact` is.
const TOLERANCES_US: [i64; 2] = [1000, 100];

/// Between two streams that are compared as one. Where little moves a tolerance is ten times what it says, at most.
const APART_US: i64 = 20 * TOLERANCES_US[0];

/// Samples of a scene.
pub struct Pilot<'a> {
    gpu: &'a Gpu,
    scene: Arc<Scene>,
    cameras: Vec<CameraInfo>,
    places: Vec<Place>,
    reference_luminance: Option<f32>,
    /// Told before each place, returns whether to stop.
    stop: &'a dyn Fn() -> bool,
}

/// What is rendered from one time on.
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

/// How events agree with finer ones: tolerances are scaled by image speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// F1 within 1 ms.
    pub f1_1ms: f64,
    /// F1 within 100 us.
    pub f1_100us: f64,
    /// Median time error of events that have a partner within 1 ms, in microseconds; `None` where none has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_us: Option<f64>,
}

/// What fired in one view at one place, twice.
struct Streams<'a> {
    fired: &'a [Event],
    finer: &'a [Event],
    length_us: i64,
    camera: &'a CameraInfo,
    /// Per pixel: pixels per second.
    flow: &'a [f32],
}

/// How what fired agrees with what is finer, in all `streams` together; `None` where too little fired to tell.
///
/// They are scored as one stream, one after another in one picture, so far apart that no event finds a partner in another
/// stream: a median cannot be had from those of parts.
fn agreement(streams: &[Streams<'_>]) -> Result<Option<Agreement>, EngineError> {
    let (mut fired, mut finer, mut speed) = (Vec::new(), Vec::new(), Vec::new());
    let mut start_us = 0;
    for of in streams {
        let later = |event: &Event| {
            let mut event = *event;
            event.t += start_us;
            event
        };
        fired.extend(of.fired.iter().map(later));
        finer.extend(of.finer.iter().map(later));
        let pixel = |event: &Event| u32::from(event.y) * of.camera.width + u32::from(event.x);
        let speed_at = |event: &Event| of.flow.get(pixel(event) as usize).copied().unwrap_or_default();
        speed.extend(of.finer.iter().map(speed_at));
        start_us += of.length_us + APART_US;
    }
    let widest = streams.iter().map(|of| of.camera).max_by_key(|camera| camera.width);
    let Some(camera) = widest.filter(|_| finer.len() >= LEAST) else { return Ok(None) };
    let height = streams.iter().map(|of| of.camera.height).max().unwrap_or_default();
    let pixels: BTreeSet<_> = fired.iter().chain(&finer).map(|event| (event.y, event.x)).collect();
    let truth = Truth {
        camera: CameraInfo { height, ..camera.clone() },
        sensor: SensorConfig::default(),
        reference_luminance: 1.0,
        duration_us: start_us,
        pixels: pixels.into_iter().map(|(y, x)| [x, y]).collect(),
        events: finer,
        speed,
        event_region: Vec::new(),
        span_start: Vec::new(),
        spans: Vec::new(),
        provenance: String::new(),
    };
    let settings = ScoreSettings { tolerances_us: TOLERANCES_US.to_vec(), ..ScoreSettings::default() };
    let score = metric::score(&fired, &truth, &settings)
        .map_err(|e| EngineError::Device(format!("two streams cannot be compared: {e}")))?;
    let [wide, narrow] = TOLERANCES_US.map(|us| score.at(us).map(|of| &of.scaled));
    Ok(wide.zip(narrow).map(|(wide, narrow)| Agreement {
        f1_1ms: wide.f1,
        f1_100us: narrow.f1,
        median_us: wide.time_error.as_ref().map(|error| error.median_us),
    }))
}

/// Seconds from `start_s` to the end of the scene's motion; 1 where it has none.
pub fn length_s(scene: &Scene, start_s: f64) -> f64 {
    scene.duration_s.filter(|s| s.is_finite() && *s > start_s).map_or(1.0, |s| s - start_s)
}

impl<'a> Pilot<'a> {
    /// For what `config` renders of `scene`.
    ///
    /// # Errors
    /// Cameras that do not exist or cannot be used, a scene that the device refuses, or a stop.
    pub fn new(
        gpu: &'a Gpu,
        scene: &Arc<Scene>,
        config: &RunConfig,
        stop: &'a dyn Fn() -> bool,
    ) -> Result<Self, EngineError> {
        // Of the first environment.
        let scene = if scene.variants.len() > 1 {
            let mut first = (**scene).clone();
            first.variants.truncate(1);
            Arc::new(first)
        } else {
            Arc::clone(scene)
        };
        let (mut views, mut cameras) = view::views(&scene, config)?;
        views.truncate(VIEWS);
        cameras.truncate(VIEWS);
        let mut state = SceneState::default();
        scene.evaluate_variant(scene.variants.first(), config.start_us as f64 * 1e-6, &mut state);
        let layouts = SurfaceLayouts::new(&gpu.device);
        let gpu_scene =
            gpu.guarded(|| Ok(GpuScene::new(&gpu.device, &gpu.queue, &layouts, &scene, &state)))?;
        let length_us = (length_s(&scene, config.start_us as f64 * 1e-6) * 1e6) as i64;
        let place = |place: usize| {
            // What ends with the scene begins before its end, as long before as things are slow there.
            let speeds_at = |before_us: i64| {
                let room_us = (length_us - before_us).max(0);
                let start_us = config.start_us + room_us * place as i64 / (PLACES as i64 - 1);
                (start_us, speeds(&scene, &gpu_scene, &views, start_us))
            };
            let length_us = long_enough(&speeds_at(LEAST_US).1).min(length_us.max(LEAST_US));
            let (start_us, speeds) = speeds_at(length_us);
            Place { start_us, length_us, speeds, only: Vec::new(), flow: Vec::new() }
        };
        let places = (0..PLACES).map(place).collect();
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
            between: Interpolation::Line,
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
            simulator.restart(place.start_us, Vec::new(), false)?;
            let of = |view: ViewPacket| match view.labels.into_iter().next().map(|label| label.data) {
                Some(LabelData::F32(flow)) => flow.chunks_exact(2).map(speed).collect(),
                _ => Vec::new(),
            };
            place.flow = simulator.step(1)?.views.into_iter().map(of).collect();
        }
        Ok(())
    }

    /// What `config` renders, of the views that are rendered, with thresholds alone: what else a sensor does is the same for
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
            ..config.clone()
        }
    }

    /// Samples of `count` tiles at each place from now on.
    fn choose_tiles(&mut self, count: usize) {
        let each = count.div_ceil(self.cameras.len().max(1));
        for place in &mut self.places {
            place.only = place.speeds.iter().map(|of| spread(of, each)).collect();
        }
    }

    /// Samples of as many tiles as it takes for enough events, by what `fired`.
    pub fn adjust(&mut self, fired: &Fired) {
        let enough = TILES * WANTED / fired.count().max(1);
        self.choose_tiles(enough.clamp(LEAST_TILES, MOST_TILES));
    }

    /// Tiles that are rendered, at all places.
    pub fn tiles(&self) -> usize {
        self.places.iter().flat_map(|place| &place.only).flatten().filter(|only| **only).count()
    }

    /// What `config` fires.
    ///
    /// # Errors
    /// A device that fails, or a stop.
    pub fn fire(&mut self, config: &RunConfig) -> Result<Fired, EngineError> {
        let config = RunConfig { reference_luminance: self.reference_luminance, ..self.plain(config) };
        self.fire_tiles(config, false)
    }

    /// The rate of the reference: as fine as its instants allow.
    fn reference_rate_hz(&self) -> f64 {
        let longest_us = self.places.iter().map(|place| place.length_us).max().unwrap_or(LEAST_US);
        let fits = |rate_hz: &&f64| (**rate_hz * longest_us as f64 * 1e-6) as i64 <= REFERENCE_INSTANTS;
        REFERENCE_RATES_HZ.iter().find(fits).copied().unwrap_or(REFERENCE_RATES_HZ[2])
    }

    /// The reference, in words.
    pub fn reference_words(&self) -> String {
        format!("every instant at {} Hz with {REFERENCE_SAMPLES} whole samples", self.reference_rate_hz())
    }

    /// What the reference fires: every instant everywhere in the chosen tiles, with light straight between instants and each
    /// sample shaded.
    ///
    /// # Errors
    /// A device that fails, or a stop.
    pub fn fire_reference(&mut self, config: &RunConfig) -> Result<Fired, EngineError> {
        let shadows = if config.shadows == Some(Shadows::Maps) { Shadows::Maps } else { Shadows::Rays };
        let of = |shadows| RunConfig {
            method: Method::Native,
            rate_hz: self.reference_rate_hz(),
            // In force for which tiles are drawn; how often is not a matter of motion.
            adaptive_px: Some(f64::MIN_POSITIVE),
            between: Interpolation::Line,
            antialias: Antialias::Samples,
            samples: REFERENCE_SAMPLES,
            texture_taps: Some(4),
            shadows: Some(shadows),
            reference_luminance: self.reference_luminance,
            ..self.plain(config)
        };
        let (rays, maps) = (of(shadows), of(Shadows::Maps));
        match self.fire_tiles(rays, true) {
            // Casters that rays do not hold.
            Err(EngineError::Config(e)) if e.what == "shadows" => self.fire_tiles(maps, true),
            fired => fired,
        }
    }

    fn fire_tiles(&mut self, config: RunConfig, every_instant: bool) -> Result<Fired, EngineError> {
        let mut simulator = Simulator::new(self.gpu, Arc::clone(&self.scene), config)?;
        self.reference_luminance = simulator.config().reference_luminance;
        let mut fired = Vec::new();
        for place in &self.places {
            if (self.stop)() {
                return Err(EngineError::Stopped);
            }
            simulator.restart(place.start_us, place.only.clone(), every_instant)?;
            let views = simulator.step(place.length_us)?.views;
            let seen = views.into_iter().zip(&place.only).zip(&self.cameras).map(|((view, only), camera)| {
                let wanted = |event: &Event| only[tile_at(camera.width, event.x.into(), event.y.into())];
                view.events.into_iter().filter(wanted).collect()
            });
            fired.push(seen.collect());
        }
        Ok(Fired(fired))
    }

    /// How `fired` agrees with `finer`; `None` where too little fired to tell.
    ///
    /// # Errors
    /// Streams that are no streams of these cameras.
    pub fn agreement(&self, fired: &Fired, finer: &Fired) -> Result<Option<Agreement>, EngineError> {
        let mut streams = Vec::new();
        for ((place, fired), finer) in self.places.iter().zip(&fired.0).zip(&finer.0) {
            for (((fired, finer), flow), camera) in
                fired.iter().zip(finer).zip(&place.flow).zip(&self.cameras)
            {
                streams.push(Streams { fired, finer, length_us: place.length_us, camera, flow });
            }
        }
        agreement(&streams)
    }
}

/// How fast what each tile of the `views` may show moves at `start_us`: pixels per second, infinite where no bound is known.
fn speeds(scene: &Scene, gpu_scene: &GpuScene, views: &[View], start_us: i64) -> Vec<Vec<f64>> {
    let start_s = start_us as f64 * 1e-6;
    let request = FrameRequest {
        views,
        times_s: &[start_s, start_s + SPAN_S],
        shadows: None,
        occluders: None,
        record_ids: false,
        shadow_maps: false,
        watch: None,
        trail: true,
    };
    let mut data = FrameData::default();
    data.build(scene, gpu_scene, &request);
    let estimator = TileRateEstimator::new(scene, gpu_scene, 1.0, 1);
    let sky = scene.environment.as_ref().is_some_and(|e| e.visible);
    let of = |(v, view): (usize, &View)| {
        let motion = ViewMotion::new(&data, 2 * v..2 * v + 2, &view.lens, sky);
        estimator.needs(gpu_scene, &motion).into_iter().map(|need| need / SPAN_S).collect()
    };
    views.iter().enumerate().map(of).collect()
}

/// How long it takes half of the tiles that move to move by [`MOTION_PX`].
fn long_enough(speeds: &[Vec<f64>]) -> i64 {
    let mut moving: Vec<f64> = speeds.iter().flatten().copied().filter(|speed| *speed > 0.0).collect();
    moving.sort_by(f64::total_cmp);
    // Where the speed is not known it is infinite, and runs are short.
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
    use evis_core::Polarity;

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

    fn camera(width: u32, height: u32) -> CameraInfo {
        CameraInfo::uncalibrated("", (width, height))
    }

    /// `count` events at pixels of their own, 40 wide, `late_us` after 15 ms.
    fn events(count: u16, late_us: i64) -> Vec<Event> {
        (0..count).map(|k| Event::new(15_000 + late_us, k % 40, k / 40, Polarity::On)).collect()
    }

    /// What `fired` and `finer` of several views of 30 ms agree in, at so many pixels per second.
    fn compared<'a>(streams: &[(&'a [Event], &'a [Event])], speed: f32) -> Option<Agreement> {
        let cameras = [camera(40, 30), camera(50, 20)];
        let flow = vec![speed; 1200];
        let of = |(k, (fired, finer)): (usize, &(&'a [Event], &'a [Event]))| Streams {
            fired,
            finer,
            length_us: 30_000,
            camera: &cameras[k % 2],
            flow: &flow,
        };
        let streams: Vec<_> = streams.iter().enumerate().map(of).collect();
        agreement(&streams).unwrap()
    }

    #[test]
    fn few_events_tell_nothing() {
        let f1 = |fired: &[Event], finer: u16| compared(&[(fired, &events(finer, 0))], 0.0).map(|a| a.f1_1ms);
        assert_eq!(f1(&[], 0), None);
        assert_eq!(f1(&events(900, 0), 499), None);
        assert_eq!(f1(&events(500, 0), 500), Some(1.0));
        let mut tenth_elsewhere = events(500, 0);
        tenth_elsewhere[..50].iter_mut().for_each(|event| event.y += 15);
        assert_eq!(f1(&tenth_elsewhere, 500), Some(0.9));
        assert_eq!(compared(&[], 0.0), None);
    }

    #[test]
    fn streams_are_compared_as_one_without_partners_in_another() {
        let finer = events(600, 0);
        let (soon, late) = (events(600, 10), events(510, 400));
        let both = compared(&[(&soon, &finer), (&late, &finer[..510])], 0.0).unwrap();
        // Neither the mean of both medians nor that of the last.
        assert_eq!((both.f1_1ms, both.median_us), (1.0, Some(10.0)));
        assert!((both.f1_100us - 600.0 / 1110.0).abs() < 1e-12, "{both:?}");
        let alone = compared(&[(&late, &finer[..510])], 0.0).unwrap();
        assert_eq!((alone.f1_100us, alone.median_us), (0.0, Some(400.0)));
        // Where little moves a tolerance is ten times what it says; an end and the next start are farther apart.
        let slow = |late_us| compared(&[(&events(600, late_us), &finer)], 1.0).unwrap().f1_1ms;
        assert_eq!((slow(9_900), slow(10_100)), (1.0, 0.0));
        let (last, first) = (events(600, 14_999), events(600, -15_000));
        let apart = compared(&[(&last, &[]), (&[], &first)], 1.0).unwrap();
        assert_eq!((apart.f1_1ms, apart.median_us), (0.0, None));
    }
}
