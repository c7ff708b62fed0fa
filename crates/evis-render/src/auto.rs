//! `auto`: settings from a target, the scene and its poses. It reads no truth, no clock, no packet and no neighbour, so a
//! stream's bytes are a function of what the user asks for; and what it chooses is written into the run's settings, which
//! give the same bytes when they are asked for by themselves.

use evis_scene::Scene;
use serde::{Deserialize, Serialize};

use crate::config::{Antialias, Between, Method, RunConfig, Shadows};
use crate::frame::{FrameData, FrameRequest};
use crate::gpu_scene::GpuScene;
use crate::host_walk;
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

    /// What it takes.
    const fn rung(self) -> Rung {
        match self {
            Self::Draft => DRAFT,
            Self::Default => DEFAULT,
            Self::Exact => LADDER[0],
        }
    }
}

/// Settings that `auto` may choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rung {
    /// How instants are sampled.
    pub method: Method,
    /// Pixels that anything may move between two samples of it.
    pub step_px: f64,
    /// Where that needs more than 4000 Hz: the finest rate.
    pub finest_hz: f64,
    /// What a sample is.
    pub antialias: Antialias,
    /// Samples per pixel.
    pub samples: u32,
    /// Places at which each reads a texture, along each side.
    pub texture_taps: u32,
    /// Whether shadows are told by rays, where the user leaves that open and the scene allows it.
    pub rays: bool,
    /// What it reached on the built-in scenes, 640x480 where nothing else is said.
    pub expects: &'static str,
}

/// Everything that `auto` chooses from, the most accurate first: with a budget, the first that fits.
///
/// Measured on the built-in scenes; see docs/accuracy.md.
pub const LADDER: &[Rung] = &[
    Rung { finest_hz: 8000.0, ..rays(0.15, 256, "F1 (1 ms) above 0.98") },
    DEFAULT,
    rays(0.3, 144, "F1 (1 ms) 0.97 to 0.99"),
    rays(0.4, 100, "F1 (1 ms) 0.96 to 0.99"),
    edges(0.4, 64, 4, "F1 (1 ms) 0.94 to 0.99"),
    edges(0.4, 36, 4, "F1 (1 ms) 0.93 to 0.99"),
    DRAFT,
    edges(0.5, 16, 2, "F1 (1 ms) 0.80 to 0.91 at 320x240"),
    edges(1.0, 16, 2, "F1 (1 ms) 0.71 to 0.86 at 320x240"),
    edges(1.0, 4, 2, "F1 (1 ms) 0.58 to 0.78 at 320x240"),
    single(1.0, "F1 (1 ms) 0.46 to 0.76 at 320x240"),
    single(2.0, "F1 (1 ms) 0.43 to 0.64 at 320x240"),
];
const DEFAULT: Rung = rays(0.2, 144, "F1 (1 ms) 0.98 to 0.99");
const DRAFT: Rung = edges(0.5, 16, 4, "F1 (1 ms) 0.88 to 0.98");

/// With shadows as sharp as what throws them.
const fn rays(step_px: f64, samples: u32, expects: &'static str) -> Rung {
    Rung { rays: true, ..edges(step_px, samples, 4, expects) }
}

/// Many samples of outlines, one in four of them shaded.
const fn edges(step_px: f64, samples: u32, texture_taps: u32, expects: &'static str) -> Rung {
    Rung {
        method: Method::Native,
        step_px,
        finest_hz: 4000.0,
        antialias: Antialias::Edges,
        samples,
        texture_taps,
        rays: false,
        expects,
    }
}

const fn single(step_px: f64, expects: &'static str) -> Rung {
    Rung { antialias: Antialias::Samples, ..edges(step_px, 1, 2, expects) }
}

/// What was chosen, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chosen {
    /// What was asked for, if it was a target.
    pub target: Option<Target>,
    /// What was asked for, if it was a budget: milliseconds of work per simulated second.
    pub budget_ms: Option<f64>,
    /// In one line.
    pub why: String,
    /// What the settings reached on the built-in scenes: a goal, not a promise.
    pub expects: String,
    /// Whether what was asked for could not be had.
    pub warning: Option<String>,
}

impl Chosen {
    /// What was asked for, in words.
    pub fn asked(&self) -> String {
        match (self.target, self.budget_ms) {
            (Some(target), _) => target.name().into(),
            (None, Some(ms)) => format!("a budget of {ms} ms per simulated second"),
            (None, None) => "nothing".into(),
        }
    }
}

/// Times of the scene at which speeds are looked at.
const LOOKS: usize = 12;
/// Seconds over which a speed is taken.
const SPAN_S: f64 = 0.000_5;
/// Views whose speeds are looked at.
const VIEWS: usize = 4;
/// Bytes that a picture of coverage samples may take, 8 for each: 1920x1080 pixels have 100 of them then.
const COVERAGE_BYTES: u64 = 2 << 30;
/// Finest rates that are chosen from. What is slow costs no more at a finer one, and what no pose tells (a cut of the camera)
/// is then told to a millisecond; above 4 kHz blocks are so short that what is slow does cost more.
const RATES_HZ: [f64; 3] = [1000.0, 2000.0, 4000.0];

/// Settles `config`, which asks for `target`.
pub fn choose(
    target: Target,
    scene: &Scene,
    gpu_scene: &GpuScene,
    views: &[View],
    texture_edge: u32,
    config: &mut RunConfig,
) {
    let rung = target.rung();
    let why = settle(&rung, scene, gpu_scene, views, texture_edge, config);
    config.chosen = Some(Chosen {
        target: Some(target),
        budget_ms: None,
        why,
        expects: rung.expects.into(),
        warning: None,
    });
}

/// Gives `config` the settings of `rung`, with fewer samples of outlines where a picture of them is larger than
/// `texture_edge`, the device's largest texture; says why its rate.
pub fn settle(
    rung: &Rung,
    scene: &Scene,
    gpu_scene: &GpuScene,
    views: &[View],
    texture_edge: u32,
    config: &mut RunConfig,
) -> String {
    let step_px = rung.step_px;
    let (needed_hz, fastest_px_s) = needed_rate(scene, gpu_scene, views, config, step_px);
    let rate_hz = RATES_HZ.into_iter().find(|rate| *rate >= needed_hz).unwrap_or(rung.finest_hz);
    // What the user asks for stays.
    let wants_rays = rung.rays && config.shadows.is_none();
    let by_maps = if wants_rays { occluders::out_of_reach(scene, gpu_scene) } else { None };
    let rays = wants_rays && by_maps.is_none();
    config.shadows.get_or_insert(if rays { Shadows::Rays } else { Shadows::Maps });
    config.method = rung.method;
    config.antialias = rung.antialias;
    config.rate_hz = rate_hz;
    (config.adaptive_px, config.between) = (Some(step_px), Between::Curve);
    config.samples = rung.samples;
    let grid = largest_grid(views, texture_edge);
    if config.coverage_grid() > grid {
        config.samples = 4 * grid * grid;
    }
    config.texture_taps = Some(rung.texture_taps);
    let reach = if needed_hz <= rate_hz {
        String::new()
    } else if needed_hz.is_infinite() {
        ", more for what passes the camera".into()
    } else {
        format!(", {:.2} px for the fastest", step_px * needed_hz / rate_hz)
    };
    let fastest =
        if fastest_px_s.is_finite() { format!("{fastest_px_s:.0}") } else { "any number of".into() };
    let mut why = format!(
        "tiles move up to {fastest} px/s, so they are rendered up to {rate_hz:.0} times a second: every {step_px} \
         px{reach}"
    );
    if config.samples < rung.samples {
        why += &format!("; {} samples, since larger pictures of them do not fit", config.samples);
    }
    if let Some(reason) = by_maps {
        why += &format!("; shadows by maps, not rays ({reason})");
    }
    host_walk::settle(views, config, &mut why);
    why
}

/// The finest grid of [`Antialias::Edges`] whose pictures fit.
fn largest_grid(views: &[View], texture_edge: u32) -> u32 {
    let fits = |view: &View| {
        let (width, height) = (view.lens.width, view.lens.height);
        let by_bytes = COVERAGE_BYTES / (4 * 8 * u64::from(width) * u64::from(height)).max(1);
        (texture_edge / width.max(height)).min(by_bytes.isqrt() as u32)
    };
    views.iter().map(fits).min().unwrap_or(1).max(1)
}

/// Seconds from `start_s` to the end of the scene's motion; 1 where it has none.
pub fn length_s(scene: &Scene, start_s: f64) -> f64 {
    scene.duration_s.filter(|s| s.is_finite() && *s > start_s).map_or(1.0, |s| s - start_s)
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
    let length_s = length_s(scene, start_s);
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
