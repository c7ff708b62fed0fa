//! From a scene and settings to a truth.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use evis_core::{CameraInfo, Event, SensorConfig, Truth};
use evis_scene::{PixelLens, Scene, SceneError};
use rayon::prelude::*;
use serde::Serialize;

use crate::audit::Audit;
use crate::clock::{Clock, Moment};
use crate::lattice::Lattice;
use crate::rays::{Beam, Textures};
use crate::schedule::{self, Schedule};
use crate::settings::{TruthError, TruthSettings};
use crate::signal::Sampler;
use crate::walk::{PixelTruth, Rules, sample, walk};

/// For the log-mean, squares of so many pixels share a beam.
const REFERENCE_BLOCK: usize = 4;
/// Of so many pixels the log-mean is known from many points each; of larger pictures, from one pixel of each block.
const REFERENCE_PIXELS: usize = 19_200;

/// Where a truth comes from; stored with it.
#[derive(Serialize)]
struct Provenance<'a> {
    evis: &'static str,
    scene: &'a str,
    settings: &'a TruthSettings,
    /// The shortest between two samples.
    step_us: i64,
    /// What is sampled has no steps to audit: between its instants it knows nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    audit: Option<Audit>,
    readings: u64,
    skipped_pixels: u64,
    seconds: f64,
}

/// What `scene` makes an ideal sensor fire, in the first of its environments; where a host moves, shows, paints or lights things
/// ([`Scene::leave_to_host`]), as it said. `progress` is told the part that is done, from several threads, and stops
/// the work by returning false.
///
/// # Errors
/// A setting that cannot be used, a camera that does not exist or has no lens, rigid bodies that were not simulated, a stretch
/// of time of which a host has not said everything or no longer has, or a stop.
pub fn truth(
    scene: &Scene,
    settings: &TruthSettings,
    progress: &(dyn Fn(f64) -> bool + Sync),
) -> Result<Truth, TruthError> {
    settings.check()?;
    scene.check_simulated()?;
    check_host(scene, settings)?;
    let started = std::time::Instant::now();
    let camera = match &settings.camera {
        Some(name) => scene.camera(name)?,
        None if scene.cameras.is_empty() => {
            return Err(SceneError::Rule("it has no camera; add one".into()).into());
        }
        None => 0,
    };
    let textures = Textures::new(scene);
    let mut clock = Clock::new(scene, &textures, camera, settings)?;
    let lens = clock.pinhole().lens;
    let pixels = settings.pixels(lens.width, lens.height)?;

    let instants = settings.instants()?;
    let given = instants.as_ref().map_or(settings.step_us, |instants| instants.get(1).copied());
    let shortest = given.map_or_else(|| schedule::shortest(&clock, settings.duration_us), |s| (s, 0.0));
    match &instants {
        Some(instants) => clock.share(instants.iter().copied()),
        None => {
            let mut shared: Vec<i64> =
                (0..=settings.duration_us / shortest.0).map(|k| k * shortest.0).collect();
            shared.extend(schedule::break_samples(&clock, settings.duration_us));
            shared.sort_unstable();
            shared.dedup();
            clock.share(shared.into_iter());
        }
    }
    let schedule = match given {
        Some(step_us) => Schedule::even(&clock, step_us, settings.duration_us),
        None => Schedule::local(&clock, shortest, settings.duration_us),
    };
    let info = &scene.cameras[camera];
    let sensor = SensorConfig {
        threshold_on: info.threshold_on.unwrap_or(settings.sensor.threshold_on),
        threshold_off: info.threshold_off.unwrap_or(settings.sensor.threshold_off),
        ..settings.sensor.clone()
    };
    evis_core::Sensor::new(sensor.clone())?;
    let reference_luminance =
        settings.reference_luminance.map_or_else(|| reference(&clock.at(0.0)), f64::from);
    let rules = Rules {
        sensor,
        reference_luminance,
        audit_share: settings.audit_share,
        duration_us: settings.duration_us,
        time_error_us: settings.time_error_us,
    };

    let sampler = Sampler::new(settings.lattice);
    let still = Stillness::new(&clock, settings.duration_us);
    let (stopped, done, skipped) = (AtomicBool::new(false), AtomicU64::new(0), AtomicU64::new(0));
    let walked: Vec<PixelTruth> = pixels
        .par_iter()
        .with_max_len(1)
        .map(|&[x, y]| {
            if stopped.load(Ordering::Relaxed) {
                return PixelTruth::default();
            }
            let walked = if still.as_ref().is_some_and(|s| s.holds(&sampler, x, y)) {
                skipped.fetch_add(1, Ordering::Relaxed);
                PixelTruth::still()
            } else if let Some(instants) = &instants {
                sample(&clock, &sampler, &rules, instants, x, y)
            } else {
                walk(&clock, &sampler, &rules, &schedule.times(x, y), x, y)
            };
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            if !progress(done as f64 / pixels.len() as f64) {
                stopped.store(true, Ordering::Relaxed);
            }
            walked
        })
        .collect();
    if stopped.into_inner() {
        return Err(TruthError::Stopped);
    }
    let events = walked.iter().map(|w| w.events.len() as u64).sum();
    let audit = instants.is_none().then(|| Audit::new(walked.iter().map(|w| w.audit).sum(), events));
    let provenance = Provenance {
        evis: env!("CARGO_PKG_VERSION"),
        scene: &scene.name,
        settings,
        step_us: shortest.0,
        audit,
        readings: walked.iter().map(|w| w.readings).sum(),
        skipped_pixels: skipped.into_inner(),
        seconds: started.elapsed().as_secs_f64(),
    };
    let provenance = serde_json::to_string(&provenance).unwrap_or_default();
    Ok(assemble(camera_info(scene, &info.name, &lens), rules, pixels, &walked, provenance))
}

/// Refuses a stretch of which a host has not said everything, or no longer has.
fn check_host(scene: &Scene, settings: &TruthSettings) -> Result<(), SceneError> {
    let Some(host) = &scene.host_poses else { return Ok(()) };
    let (start_us, end_us) = (settings.start_us, settings.start_us + settings.duration_us);
    let (from_us, until_us) = (host.known_from_us(), host.known_until_us());
    if end_us > until_us {
        return Err(SceneError::Rule(format!(
            "a host has said where things are until {until_us} us of scene time, and the truth ends at {end_us} us; say more \
             first, or choose a shorter duration"
        )));
    }
    if start_us < from_us {
        return Err(SceneError::Rule(format!(
            "a host's poses before {from_us} us of scene time were forgotten, and the truth begins at {start_us} us; make it of a \
             scene that no simulator steps"
        )));
    }
    Ok(())
}

fn camera_info(scene: &Scene, name: &str, lens: &PixelLens) -> CameraInfo {
    if lens.is_parallel() {
        // It has no intrinsics.
        return CameraInfo::uncalibrated(name, (lens.width, lens.height));
    }
    let distortion = scene.distortions.get(name).map(|own| (own.name(), own.coefficients()));
    CameraInfo::new(name, (lens.width, lens.height), lens.focal, lens.center, distortion)
}

/// Sorts what the pixels fired into one stream.
fn assemble(
    camera: CameraInfo,
    rules: Rules,
    pixels: Vec<[u16; 2]>,
    walked: &[PixelTruth],
    provenance: String,
) -> Truth {
    let mut all: Vec<(Event, f32, evis_core::Region)> = Vec::new();
    let (mut span_start, mut spans) = (vec![0], Vec::new());
    for (&[x, y], walked) in pixels.iter().zip(walked) {
        all.extend(walked.events.iter().map(|fired| {
            (Event::new(fired.t_us.floor() as i64, x, y, fired.polarity), fired.speed, fired.region)
        }));
        spans.extend_from_slice(&walked.spans);
        span_start.push(spans.len() as u32);
    }
    // Stable: events of one pixel at one microsecond keep their firing order.
    all.sort_by_key(|(event, ..)| event.order());
    Truth {
        camera,
        sensor: rules.sensor,
        reference_luminance: rules.reference_luminance,
        duration_us: rules.duration_us,
        pixels,
        events: all.iter().map(|a| a.0).collect(),
        speed: all.iter().map(|a| a.1).collect(),
        event_region: all.iter().map(|a| a.2).collect(),
        span_start,
        spans,
        provenance,
    }
}

/// `Y_ref` that brings the log-mean of what is lit to 0.18, from all pixels at `moment`.
fn reference(moment: &Moment) -> f64 {
    let camera = &moment.camera;
    let [width, height] = [camera.pinhole.lens.width, camera.pinhole.lens.height].map(|edge| edge as usize);
    // Few points for every pixel. Where light varies within a pixel at random, the logarithm of their mean lies below that
    // of the whole area's by half of its relative variance: some of the pixels are asked with many, too.
    let few: Vec<[f64; 2]> = (0..13)
        .map(|i| [(f64::from(i) + 0.5) / 13.0 - 0.5, f64::from((8 * i + 6) % 13) / 13.0 - 6.0 / 13.0])
        .collect();
    let many = Lattice::First.offsets(0);
    let block = REFERENCE_BLOCK * REFERENCE_BLOCK;
    // How far apart, in a block, those pixels are.
    let apart = (width * height).div_ceil(REFERENCE_PIXELS).clamp(1, block);
    let blocks = [width, height].map(|size| size.div_ceil(REFERENCE_BLOCK));
    let (sum, lit, lift, asked) = (0..blocks[0] * blocks[1])
        .into_par_iter()
        .map(|i| {
            let corner = [i % blocks[0], i / blocks[0]].map(|k| k * REFERENCE_BLOCK);
            let end = [width, height].map(|size| size as f64);
            let low = corner.map(|v| v as f64);
            let high = [0, 1].map(|k| (low[k] + REFERENCE_BLOCK as f64).min(end[k]));
            let beam = Beam::new(&moment.caster, camera, low, high);
            let log = |pixel: [f64; 2], points: &[[f64; 2]]| {
                let light = |[u, v]: &[f64; 2]| beam.look([pixel[0] + 0.5 + u, pixel[1] + 0.5 + v]).0;
                let mean = points.iter().map(light).sum::<f64>() / points.len() as f64;
                (mean > 0.0 && mean.is_finite()).then(|| mean.ln())
            };
            let side = REFERENCE_BLOCK;
            // In no step with the blocks' own rows and columns.
            let chosen = (i * 7 + i / blocks[0] * 5) % block;
            let (mut sum, mut lit, mut lift, mut asked) = (0.0, 0_u64, 0.0, 0_u64);
            for k in 0..block {
                let pixel = [low[0] + (k % side) as f64, low[1] + (k / side) as f64];
                if pixel[0] >= end[0] || pixel[1] >= end[1] {
                    continue;
                }
                let Some(rough) = log(pixel, &few) else { continue };
                (sum, lit) = (sum + rough, lit + 1);
                if (k + chosen).is_multiple_of(apart)
                    && let Some(fine) = log(pixel, &many)
                {
                    (lift, asked) = (lift + fine - rough, asked + 1);
                }
            }
            (sum, lit, lift, asked)
        })
        .collect::<Vec<_>>()
        .into_iter()
        .fold((0.0, 0, 0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1, a.2 + b.2, a.3 + b.3));
    if lit == 0 {
        return 1.0;
    }
    let reference = (sum / lit as f64 + lift / asked.max(1) as f64).exp() / 0.18;
    if reference.is_finite() && reference > 0.0 { reference } else { 1.0 }
}

/// Where a camera rests, most pixels of most scenes never change. A pixel is still where no ray of its lattice, nor any
/// from there to a lamp, passes a box through which something moves.
struct Stillness<'a> {
    now: std::sync::Arc<Moment<'a>>,
    boxes: Vec<(glam::DVec3, glam::DVec3)>,
}

impl<'a> Stillness<'a> {
    /// Instants at which moving boxes are looked up, and by which part of their size they are grown for what lies
    /// between.
    const INSTANTS: usize = 128;
    const MARGIN: f64 = 0.1;

    /// `None` where the whole picture may change.
    fn new(clock: &Clock<'a>, duration_us: i64) -> Option<Self> {
        if !clock.only_objects_change() {
            return None;
        }
        let mut boxes: Vec<(glam::DVec3, glam::DVec3)> = Vec::new();
        let even = (0..=Self::INSTANTS).map(|k| duration_us as f64 * k as f64 / Self::INSTANTS as f64);
        // What is shown for a short while.
        let shown = schedule::break_samples(clock, duration_us);
        for t_us in even.chain(shown.into_iter().map(|t_us| t_us as f64)) {
            let moment = clock.at(t_us);
            for (i, (low, high)) in moment.moving_boxes(Self::MARGIN).into_iter().enumerate() {
                match boxes.get_mut(i) {
                    Some(known) => *known = (known.0.min(low), known.1.max(high)),
                    None => boxes.push((low, high)),
                }
            }
        }
        Some(Self { now: clock.at(0.0), boxes })
    }

    fn holds(&self, sampler: &Sampler, x: u16, y: u16) -> bool {
        let now = &self.now;
        sampler.points().iter().all(|o| {
            // A hair beyond the pixel, so that no sample of another lattice sees more.
            let at = crate::signal::at(x, y, o.map(|v| v * 1.1));
            !now.caster.passes(&now.camera, at, &self.boxes)
        })
    }
}
