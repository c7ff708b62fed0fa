//! A shot's truth, and a method's run of it.

use std::path::Path;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use evis_core::metric::Score;
use evis_core::{EmulatorConfig, Event, EventEmulator, Frames, SensorConfig, Truth};
use evis_render::{Compute, Gpu, Method, RunConfig, Simulator};
use evis_scene::Scene;
use evis_truth::rays::Textures;
use evis_truth::{Lattice, TruthError, TruthSettings};
use rayon::prelude::*;

use super::detect;
use super::methods::NamedMethod;
use super::shots::{Shot, ShotId};
use super::still::still;
use crate::error::ChartError;
use crate::verify::eye::Eye;

/// Packets are as long as those of `evis run`.
const PACKET_US: i64 = 10_000;

/// How often a run looks whether it should stop.
const LOOK: Duration = Duration::from_millis(50);

/// Error of an event's time that truth aims at: a twelfth of the tolerance that is scored.
const TIME_ERROR_US: f64 = 80.0;

/// Time between two frames of light for an emulator that stands for truth: in it an edge moves by a twentieth of a pixel.
const FRAME_US: usize = 500;

/// A shot, and what is true in it.
pub(super) struct Known {
    pub shot: Shot,
    pub scene: Arc<Scene>,
    pub truth: Truth,
    /// Per pixel of the truth: whether its light never changes.
    pub still: Vec<bool>,
}

impl Known {
    /// Makes truth of `id`, or takes it from the folder `cache`.
    pub(super) fn new(
        id: ShotId,
        cache: Option<&Path>,
        progress: &(dyn Fn(f64) -> bool + Sync),
    ) -> Result<Self, ChartError> {
        if !progress(0.0) {
            return Err(ChartError::Stopped);
        }
        let shot = id.build()?;
        let ideal = SensorConfig {
            threshold_on: shot.sensor.threshold_on,
            threshold_off: shot.sensor.threshold_off,
            log_eps: shot.sensor.log_eps,
            ..SensorConfig::default()
        };
        let ask = TruthSettings {
            sensor: ideal,
            duration_us: shot.duration_us,
            pixels: shot.pixels,
            reference_luminance: Some(shot.reference_luminance),
            time_error_us: Some(TIME_ERROR_US),
            audit_share: 0.0,
            ..TruthSettings::default()
        };
        let made = match cache {
            Some(folder) => evis_truth::cached(folder, &shot.scene, &ask, progress),
            None => evis_truth::truth(&shot.scene, &ask, progress),
        };
        let mut truth = made.map_err(|error| match error {
            TruthError::Config(error) => error.into(),
            TruthError::Scene(error) => error.into(),
            TruthError::Stopped => ChartError::Stopped,
            other => ChartError::Truth(other.to_string()),
        })?;
        let still = still(&shot.scene, &truth)?;
        if !shot.sensor.is_ideal() {
            truth = through_emulator(&shot, truth)?;
        }
        Ok(Self { scene: Arc::new(shot.scene.clone()), shot, truth, still })
    }
}

/// Truth of a sensor with more than thresholds: the emulator, fed with the oracle's light often. Regions and speeds stay
/// unknown.
fn through_emulator(shot: &Shot, truth: Truth) -> Result<Truth, ChartError> {
    let width = u32::try_from(truth.pixels.len()).map_err(|e| ChartError::Truth(e.to_string()))?;
    let config = EmulatorConfig {
        width,
        height: 1,
        sensor: shot.sensor.clone(),
        reference_luminance: shot.reference_luminance,
        ..EmulatorConfig::default()
    };
    let mut emulator = EventEmulator::new(config)?;
    let textures = Textures::new(&shot.scene);
    let offsets = Lattice::First.offsets(0);
    let mut events = Vec::new();
    for t_us in (0..=shot.duration_us).step_by(FRAME_US) {
        let eye = Eye::new(&shot.scene, &textures, &truth.camera, t_us as f64)?;
        let mean = |pixel: &[u16; 2]| {
            (offsets.iter().map(|o| eye.luminance(*pixel, *o)).sum::<f64>() / offsets.len() as f64) as f32
        };
        let light: Vec<f32> = truth.pixels.par_iter().map(mean).collect();
        events.extend(emulator.push(&Frames::linear(&light), t_us)?.into_iter().flatten());
    }
    // The emulator's one row is the truth's list of pixels.
    let placed = |mut event: Event| {
        [event.x, event.y] = *truth.pixels.get(usize::from(event.x))?;
        Some(event)
    };
    let mut events: Vec<Event> = events.into_iter().filter_map(placed).collect();
    events.retain(|e| e.t < truth.duration_us);
    events.sort_by_key(Event::order);
    Ok(Truth { events, speed: Vec::new(), event_region: Vec::new(), ..truth })
}

/// What a method made of a shot.
#[derive(Default)]
pub(super) struct Run {
    pub events: Vec<Event>,
    /// Instants that were sampled.
    pub instants: u64,
    /// Keyframes that were drawn.
    pub keyframes: u64,
    /// Pixels and instants that were not known.
    pub unknown: u64,
    /// Events outside their packet's interval, or outside the picture.
    pub outside: u64,
    /// Samples that were drawn, margins of keyframes included, and pixels that were interpolated.
    pub drawn: f64,
    /// At all pixels of the truth; `None` where it is silent.
    pub score: Option<Score>,
}

impl Run {
    /// Runs `method` on what is `known`; pixels of decoupled sampling where `compute` says.
    pub(super) fn new(
        gpu: &Gpu,
        known: &Known,
        (method, compute): (&NamedMethod, Compute),
        progress: &dyn Fn(f64) -> bool,
    ) -> Result<Self, ChartError> {
        let shot = &known.shot;
        let method = shot.keyframe_hz.map_or_else(|| method.clone(), |hz| method.with_keyframes(hz));
        let base = RunConfig {
            sensor: shot.sensor.clone(),
            reference_luminance: Some(shot.reference_luminance),
            shadows: shot.shadows,
            ..RunConfig::default()
        };
        let Some(mut config) = method.setting.run_config(&base) else {
            return Err(ChartError::Unreachable(format!(
                "method {} does not exist in this version",
                method.setting.method
            )));
        };
        evis_render::quality::settle(gpu, &known.scene, &mut config)?;
        if config.method == Method::Decoupled {
            config.compute = compute;
        }
        let simulator = Simulator::new(gpu, Arc::clone(&known.scene), config)?;
        let samples = simulator.config().samples;
        let mut drawn_pixels = 0;
        let mut run = Self::default();
        let mut stream = simulator.stream(shot.duration_us, PACKET_US)?;
        let mut part = 0.0;
        loop {
            if !progress(part) {
                return Err(ChartError::Stopped);
            }
            let packet = match stream.poll_next(LOOK) {
                Poll::Pending => continue,
                Poll::Ready(None) => break,
                Poll::Ready(Some(packet)) => packet?,
            };
            run.instants += packet.report.instants;
            run.keyframes += packet.report.keyframes;
            drawn_pixels += packet.report.drawn_pixels;
            run.unknown += packet.report.unknown;
            let [width, height] = [known.truth.camera.width, known.truth.camera.height];
            for event in packet.views.into_iter().take(1).flat_map(|view| view.events) {
                let inside = (packet.start_us..packet.end_us).contains(&event.t)
                    && u32::from(event.x) < width
                    && u32::from(event.y) < height
                    && matches!(event.p, 0 | 1);
                run.outside += u64::from(!inside);
                run.events.extend(inside.then_some(event));
            }
            part = packet.end_us as f64 / shot.duration_us as f64;
        }
        let [width, height] = [known.truth.camera.width, known.truth.camera.height].map(f64::from);
        run.drawn = drawn(&method, &run, drawn_pixels, samples, width * height);
        run.score = detect::scored(&run.events, &known.truth)?;
        Ok(run)
    }
}

/// Samples that were drawn, as the report counts their pixels, and instants that were interpolated pixel by pixel.
fn drawn(method: &NamedMethod, run: &Run, drawn_pixels: u64, samples: u32, pixels: f64) -> f64 {
    let interpolated = if method.setting.splat.is_some() { run.instants as f64 * pixels } else { 0.0 };
    drawn_pixels as f64 * f64::from(samples) + interpolated
}

/// A shot and a run of it.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub known: &'a Known,
    pub run: &'a Run,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_drawn_is_what_the_report_counts() {
        let run = Run { instants: 100, ..Run::default() };
        let told = |name, drawn_pixels| {
            drawn(&NamedMethod::named(name).unwrap(), &run, drawn_pixels, 16, 64.0 * 48.0)
        };
        assert_eq!(told("native", 100 * 64 * 48), 100.0 * 16.0 * 64.0 * 48.0);
        let keyframes = 13 * 128 * 112;
        assert_eq!(told("splat", keyframes), 100.0 * 64.0 * 48.0 + 16.0 * keyframes as f64);
    }
}
