//! `auto`: settings from a target, the scene and its poses. It reads no truth, no clock, no packet and no neighbour, so a
//! stream's bytes are a function of what the user asks for; and what it chooses is written into the run's settings, which
//! give the same bytes when they are asked for by themselves.

use evis_scene::Scene;
use serde::{Deserialize, Serialize};

use crate::config::{Antialias, Method, RunConfig, Shadows};
use crate::frame::{FrameData, FrameRequest};
use crate::gpu_scene::GpuScene;
use crate::occluders;
use crate::pace::{Pacer, Passing};
use crate::view::View;

/// How near to the truth events should be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Target {
    /// Cheap.
    Draft,
    /// A compromise.
    #[default]
    Default,
    /// As near as sampling comes within reason.
    Exact,
}

impl Target {
    /// As users write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Default => "default",
            Self::Exact => "exact",
        }
    }

    /// Pixels that anything may move between two samples of it, samples per pixel, places at which each reads a texture.
    ///
    /// Measured on the built-in scenes; see docs/accuracy.md.
    const fn settings(self) -> (f64, u32, u32) {
        match self {
            Self::Draft => (0.5, 4, 4),
            Self::Default => (0.3, 16, 4),
            Self::Exact => (0.15, 64, 4),
        }
    }

    /// What the same settings reached on the built-in scenes.
    const fn expected(self) -> &'static str {
        match self {
            Self::Draft => "F1 (1 ms) 0.82 to 0.97",
            Self::Default => "F1 (1 ms) 0.91 to 0.99",
            Self::Exact => "F1 (1 ms) above 0.99 (two of the four scenes; the others were not measured)",
        }
    }
}

/// What was chosen, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chosen {
    /// What was asked for.
    pub target: Target,
    /// In one line.
    pub why: String,
    /// What the settings reached on the built-in scenes: a goal, not a promise.
    pub expects: String,
}

/// Times of the scene at which speeds are looked at.
const LOOKS: usize = 12;
/// Seconds over which a speed is taken.
const SPAN_S: f64 = 0.000_5;
/// Views whose speeds are looked at.
const VIEWS: usize = 4;
/// Finest rates that are chosen from. What is slow costs no more at a finer one, and what no pose tells (a cut of the camera)
/// is then told to a millisecond; above 4 kHz blocks are so short that what is slow does cost more.
const RATES_HZ: [f64; 3] = [1000.0, 2000.0, 4000.0];
/// The finest rate of [`Target::Exact`].
const EXACT_HZ: f64 = 8000.0;

/// Settles `config`, which asks for `target`.
pub fn choose(target: Target, scene: &Scene, gpu_scene: &GpuScene, views: &[View], config: &mut RunConfig) {
    let (step_px, samples, taps) = target.settings();
    let (needed_hz, fastest_px_s) = needed_rate(scene, gpu_scene, views, config, step_px);
    let finest = if target == Target::Exact { EXACT_HZ } else { RATES_HZ[RATES_HZ.len() - 1] };
    let rate_hz = RATES_HZ.into_iter().find(|rate| *rate >= needed_hz).unwrap_or(finest);
    if target == Target::Exact && gpu_scene.objects.iter().all(|o| occluders::hinders(scene, o).is_none()) {
        config.shadows = Shadows::Rays;
    }
    config.method = Method::Native;
    config.antialias = Antialias::Samples;
    config.rate_hz = rate_hz;
    config.adaptive_px = Some(step_px);
    config.samples = samples;
    config.texture_taps = Some(taps);
    let reach = if needed_hz <= rate_hz {
        String::new()
    } else if needed_hz.is_infinite() {
        ", more for what passes the camera".into()
    } else {
        format!(", {:.2} px for the fastest", step_px * needed_hz / rate_hz)
    };
    let fastest =
        if fastest_px_s.is_finite() { format!("{fastest_px_s:.0}") } else { "any number of".into() };
    config.chosen = Some(Chosen {
        target,
        why: format!(
            "tiles move up to {fastest} px/s, so they are rendered up to {rate_hz:.0} times a second: every \
             {step_px} px{reach}"
        ),
        expects: target.expected().into(),
    });
}

/// The rate at which all tiles are sampled often enough, and how fast the fastest of them moves.
fn needed_rate(
    scene: &Scene,
    gpu_scene: &GpuScene,
    views: &[View],
    config: &RunConfig,
    step_px: f64,
) -> (f64, f64) {
    let views = &views[..views.len().min(VIEWS)];
    let start_s = config.start_us as f64 * 1e-6;
    let length_s = scene.duration_s.filter(|s| s.is_finite() && *s > start_s).map_or(1.0, |s| s - start_s);
    let times_s: Vec<f64> = (0..LOOKS)
        .flat_map(|i| {
            let at = start_s + length_s * i as f64 / LOOKS as f64;
            [at, at + SPAN_S]
        })
        .collect();
    let request = FrameRequest {
        views,
        times_s: &times_s,
        shadows: None,
        occluders: None,
        record_ids: false,
        shadow_maps: false,
        watch: None,
        trail: true,
    };
    let mut data = FrameData::default();
    data.build(scene, gpu_scene, &request);
    let pacer = Pacer::new(scene, gpu_scene, 1.0, 1);
    let sky = scene.environment.as_ref().is_some_and(|e| e.visible);
    let mut most: Option<f64> = None;
    for (v, view) in views.iter().enumerate() {
        for look in 0..LOOKS {
            let frames = v * times_s.len() + 2 * look..v * times_s.len() + 2 * look + 2;
            let passing = Passing::new(&data, frames, &view.lens, sky);
            let needs = pacer.needs(gpu_scene, &passing);
            // What deforms or is lit by moving lights has no speed that poses tell.
            if needs.iter().any(|need| need.is_finite()) {
                let fastest = needs.into_iter().fold(0.0, f64::max) / SPAN_S;
                most = Some(most.map_or(fastest, |other| other.max(fastest)));
            }
        }
    }
    // Where none is told, the middle of the rates.
    most.map_or((RATES_HZ[1], 0.0), |most| (most / step_px, most))
}
