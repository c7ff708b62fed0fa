//! `auto`: settings from a target, the scene and its poses. It reads no truth, no clock and no packet, and no more than the
//! first few views, so a stream's bytes are a function of what the user asks for; and what it chose is written into the
//! run's settings, which give the same bytes when they are asked for by themselves.

use std::sync::Arc;

use evis_core::CameraInfo;
use evis_scene::{Scene, SceneState};
use serde::{Deserialize, Serialize};

use crate::config::{Antialias, Between, Method, RunConfig, Shadows};
use crate::error::EngineError;
use crate::frame::{FrameData, FrameRequest};
use crate::gpu::Gpu;
use crate::gpu_scene::GpuScene;
use crate::host_walk;
use crate::occluders;
use crate::pace::{Pacer, Passing};
use crate::pass::raster::SurfaceLayouts;
use crate::plan::Told;
use crate::search::{Found, Looked, Search, Wanted};
use crate::view::{self, View};

/// How near to the truth events should be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Target {
    /// Cheap, and nothing is promised: settings that are the same for every scene.
    Preview,
    /// F1 (1 ms) of 0.95.
    Draft,
    /// F1 (1 ms) of 0.98.
    #[default]
    Default,
    /// As near as `native` at 2000 Hz with 16 whole samples, within 100 us and in time.
    Exact,
    /// As near as sampling comes within reason: settings that are the same for every scene.
    Finest,
}

impl Target {
    /// All, the cheapest first.
    pub const ALL: [Self; 5] = [Self::Preview, Self::Draft, Self::Default, Self::Exact, Self::Finest];

    /// As users write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Preview => "preview",
            Self::Draft => "draft",
            Self::Default => "default",
            Self::Exact => "exact",
            Self::Finest => "finest",
        }
    }

    /// What settings must have beside the finest ones; `None` where they are the same for every scene.
    pub(crate) const fn wanted(self) -> Option<Wanted> {
        match self {
            Self::Preview | Self::Finest => None,
            Self::Draft => Some(Wanted::F1(0.95)),
            Self::Default => Some(Wanted::F1(0.98)),
            Self::Exact => Some(Wanted::AsNative),
        }
    }

    /// What is looked for on the scene itself.
    fn search(self) -> Option<Search> {
        let wanted = self.wanted()?;
        // Of the ladder, what lies from `cheapest` up to what is cheaper than `finest`.
        let between = |cheapest: Rung, finest: Rung| {
            let place = |rung: Rung| LADDER.iter().position(|other| *other == rung);
            let candidates = LADDER[place(finest)? + 1..=place(cheapest)?].iter().rev().copied().collect();
            Some(Search { wanted, candidates, finest })
        };
        match self {
            Self::Preview | Self::Finest => None,
            Self::Draft => between(COARSE, DEFAULT),
            Self::Default => between(PREVIEW, FINEST),
            Self::Exact => Some(Search { wanted, candidates: NEAR_NATIVE.to_vec(), finest: FINEST }),
        }
    }

    /// What it takes where nothing is looked for, or what was looked at tells nothing.
    const fn rung(self) -> Rung {
        match self {
            Self::Preview | Self::Draft => PREVIEW,
            Self::Default | Self::Exact => DEFAULT,
            Self::Finest => FINEST,
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
    /// The finest rate: where that needs more than 4000 Hz it is this one.
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
    FINEST,
    DEFAULT,
    rays(0.3, 144, "F1 (1 ms) 0.97 to 0.99 on the built-in scenes at 640x480"),
    rays(0.4, 100, "F1 (1 ms) 0.96 to 0.99 on the built-in scenes at 640x480"),
    edges(0.4, 64, 4, "F1 (1 ms) 0.94 to 0.99 on the built-in scenes at 640x480"),
    edges(0.4, 36, 4, "F1 (1 ms) 0.93 to 0.99 on the built-in scenes at 640x480"),
    PREVIEW,
    edges(0.5, 16, 2, "F1 (1 ms) 0.80 to 0.91 on the built-in scenes at 320x240"),
    COARSE,
    edges(1.0, 4, 2, "F1 (1 ms) 0.58 to 0.78 on the built-in scenes at 320x240"),
    single(1.0, "F1 (1 ms) 0.46 to 0.76 on the built-in scenes at 320x240"),
    single(2.0, "F1 (1 ms) 0.43 to 0.64 on the built-in scenes at 320x240"),
];
/// What `exact` tries, the cheapest first. What they reach is told by what was found, since none is taken without that.
pub(crate) const NEAR_NATIVE: &[Rung] = &[
    edges(0.4, 64, 4, ""),
    whole(0.3, 16, 2000.0, ""),
    Rung { finest_hz: 2000.0, ..edges(0.4, 100, 4, "") },
    rays(0.4, 100, ""),
    rays(0.3, 144, ""),
    DEFAULT,
];
const FINEST: Rung =
    Rung { finest_hz: 8000.0, ..rays(0.15, 256, "F1 (1 ms) above 0.98 on the built-in scenes at 640x480") };
const DEFAULT: Rung = rays(0.2, 144, "F1 (1 ms) 0.98 to 0.99 on the built-in scenes at 640x480");
const PREVIEW: Rung =
    edges(0.5, 16, 4, "F1 (1 ms) 0.88 to 0.98 on the built-in scenes at 640x480 (0.83 to 0.91 at 320x240)");
const COARSE: Rung = edges(1.0, 16, 2, "F1 (1 ms) 0.71 to 0.86 on the built-in scenes at 320x240");

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

/// Each sample is shaded.
const fn whole(step_px: f64, samples: u32, finest_hz: f64, expects: &'static str) -> Rung {
    Rung { antialias: Antialias::Samples, finest_hz, ..edges(step_px, samples, 4, expects) }
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
pub(crate) const VIEWS: usize = 4;
/// Bytes that a picture of coverage samples may take, 8 for each: 1920x1080 pixels have 100 of them then.
const COVERAGE_BYTES: u64 = 2 << 30;
/// Finest rates that are chosen from. What is slow costs no more at a finer one, and what no pose tells (a cut of the camera)
/// is then told to a millisecond; above 4 kHz blocks are so short that what is slow does cost more.
const RATES_HZ: [f64; 3] = [1000.0, 2000.0, 4000.0];

/// What settings are chosen for.
pub(crate) struct Site<'a> {
    scene: &'a Scene,
    gpu_scene: GpuScene,
    /// All views.
    pub views: Vec<View>,
    /// Their cameras.
    pub cameras: Vec<CameraInfo>,
    texture_edge: u32,
    /// How fast what moves fastest does, over the scene; `None` where poses do not tell.
    fastest_px_s: Option<f64>,
}

impl<'a> Site<'a> {
    /// What `config` asks for of `scene`.
    ///
    /// # Errors
    /// Cameras that do not exist or cannot be used, a scene that the device refuses.
    pub fn new(gpu: &Gpu, scene: &'a Scene, config: &RunConfig) -> Result<Self, EngineError> {
        let (views, cameras) = view::views(scene, config)?;
        let mut state = SceneState::default();
        scene.evaluate_variant(scene.variants.first(), config.start_us as f64 * 1e-6, &mut state);
        let layouts = SurfaceLayouts::new(&gpu.device);
        let gpu_scene =
            gpu.guarded(|| Ok(GpuScene::new(&gpu.device, &gpu.queue, &layouts, scene, &state)))?;
        let texture_edge = gpu.device.limits().max_texture_dimension_2d;
        let fastest_px_s = fastest(scene, &gpu_scene, &views, config);
        Ok(Self { scene, gpu_scene, views, cameras, texture_edge, fastest_px_s })
    }

    /// `config` with the settings of `rung`, and why its rate.
    pub fn settled(&self, rung: &Rung, config: &RunConfig) -> (RunConfig, String) {
        let (mut config, mut why) = self.settled_for_thresholds(rung, config);
        host_walk::settle(&self.views, &mut config, &mut why);
        (config, why)
    }

    /// `config` with the settings of `rung` for sensors of thresholds alone, with fewer samples of outlines where a picture of
    /// them is larger than the device's largest texture; and why its rate.
    pub fn settled_for_thresholds(&self, rung: &Rung, config: &RunConfig) -> (RunConfig, String) {
        let mut config = config.clone();
        let step_px = rung.step_px;
        // Where no speed is told, the middle of the rates.
        let needed_hz = self.fastest_px_s.map_or(RATES_HZ[1], |fastest| fastest / step_px);
        let fastest_px_s = self.fastest_px_s.unwrap_or(0.0);
        let rate_hz = RATES_HZ.into_iter().find(|rate| *rate >= needed_hz).unwrap_or(rung.finest_hz);
        let rate_hz = rate_hz.min(rung.finest_hz);
        // What the user asks for stays.
        let wants_rays = rung.rays && config.shadows.is_none();
        let by_maps = if wants_rays { occluders::out_of_reach(self.scene, &self.gpu_scene) } else { None };
        let rays = wants_rays && by_maps.is_none();
        config.shadows.get_or_insert(if rays { Shadows::Rays } else { Shadows::Maps });
        config.method = rung.method;
        config.antialias = rung.antialias;
        config.rate_hz = rate_hz;
        (config.adaptive_px, config.between) = (Some(step_px), Between::Curve);
        config.samples = rung.samples;
        let grid = largest_grid(&self.views, self.texture_edge);
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
        (config, why)
    }

    /// How fast what each tile may show moves at `start_us`, of the first `count` views: pixels per second.
    pub fn speeds(&self, start_us: i64, count: usize) -> Vec<Vec<f64>> {
        let start_s = start_us as f64 * 1e-6;
        let needs = needs(self.scene, &self.gpu_scene, &self.views[..count], &[start_s]);
        needs.into_iter().map(|of| of.into_iter().map(|need| need / SPAN_S).collect()).collect()
    }
}

/// Settles `config`, which asks for `target`: by settings that are the same for every scene, or by what a
/// [pilot](crate::pilot::Pilot) finds on this one. Returns what was chosen, and what was looked at: `None` where
/// nothing was, or it told nothing.
///
/// # Errors
/// A setting that cannot be used, a device that fails, or a stop.
pub fn choose(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    target: Target,
    config: &mut RunConfig,
    told: &Told<'_>,
) -> Result<(Chosen, Option<Looked>), EngineError> {
    let site = Site::new(gpu, scene, config)?;
    let search = target.search();
    let found = match &search {
        Some(search) => search.run(gpu, scene, config, &site, told)?,
        None => None,
    };
    let Found { rung, why, expects, looked } = found.unwrap_or_else(|| {
        let nothing_told =
            "too little fires in the tiles that were looked at to tell settings apart, so they are the usual ones; ";
        Found {
            rung: target.rung(),
            why: search.map_or_else(String::new, |_| nothing_told.into()),
            expects: target.rung().expects.into(),
            looked: None,
        }
    });
    let (settled, rate_why) = site.settled(&rung, config);
    *config = settled;
    let chosen =
        Chosen { target: Some(target), budget_ms: None, why: why + &rate_why, expects, warning: None };
    config.chosen = Some(chosen.clone());
    Ok((chosen, looked))
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

/// How fast the fastest of all tiles moves, in pixels per second; `None` where poses do not tell.
fn fastest(scene: &Scene, gpu_scene: &GpuScene, views: &[View], config: &RunConfig) -> Option<f64> {
    let views = &views[..views.len().min(VIEWS)];
    let start_s = config.start_us as f64 * 1e-6;
    let length_s = length_s(scene, start_s);
    let times_s: Vec<f64> = (0..LOOKS).map(|i| start_s + length_s * i as f64 / LOOKS as f64).collect();
    let mut most: Option<f64> = None;
    for of in needs(scene, gpu_scene, views, &times_s) {
        // What deforms or is lit by moving lights has no speed that poses tell.
        if of.iter().any(|need| need.is_finite()) {
            let fastest = of.into_iter().fold(0.0, f64::max) / SPAN_S;
            most = Some(most.map_or(fastest, |other| other.max(fastest)));
        }
    }
    most
}

/// How far what each tile may show moves within [`SPAN_S`] from each of `times_s` on, in pixels: of each view one after the
/// other, by time.
fn needs(scene: &Scene, gpu_scene: &GpuScene, views: &[View], times_s: &[f64]) -> Vec<Vec<f64>> {
    let moments: Vec<f64> = times_s.iter().flat_map(|at| [*at, at + SPAN_S]).collect();
    let request = FrameRequest {
        views,
        times_s: &moments,
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
    let mut needs = Vec::new();
    for (v, view) in views.iter().enumerate() {
        for look in 0..times_s.len() {
            let frames = v * moments.len() + 2 * look..v * moments.len() + 2 * look + 2;
            needs.push(pacer.needs(gpu_scene, &Passing::new(&data, frames, &view.lens, sky)));
        }
    }
    needs
}
