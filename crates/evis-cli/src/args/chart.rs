//! `chart`.

use std::path::PathBuf;

use clap::Args;
use evis_truth::PixelChoice;

use super::camera::{AnimationArgs, CameraArgs};
use super::choices::ToleranceArg;
use super::values::{
    budget_ms, f1_share, positive, positive_seconds, rate_hz, render_ms, repetitions, sample_count, seed,
    size, speed, start_seconds, threshold, truth_pixels,
};

/// `chart`.
#[derive(Debug, Args)]
pub(crate) struct ChartArgs {
    /// Built-in scenes (see `scenes`), or .toml, .gltf or .glb files; a row of the picture each.
    #[arg(value_name = "SCENE", required_unless_present = "from")]
    pub(crate) scenes: Vec<String>,

    /// Picture to write, .png or .svg; repeat for several
    ///
    /// An existing one is replaced.
    #[arg(short, long, value_name = "X.{png,svg}", help_heading = "Output")]
    pub(crate) output: Vec<PathBuf>,

    /// Write what was measured as JSON, to draw it again with --from
    #[arg(long, value_name = "R.json", help_heading = "Output")]
    pub(crate) report: Option<PathBuf>,

    /// Print what was measured as JSON instead of recommendations
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(crate) json: bool,

    /// Draw what was measured before; repeat for several
    #[arg(long, value_name = "R.json", conflicts_with_all = ["scenes", "measuring", "CameraArgs", "AnimationArgs"], help_heading = "Output")]
    pub(crate) from: Vec<PathBuf>,

    /// Most milliseconds of work per simulated second [default: 1000]
    ///
    /// Recommends the most accurate setting within it. The default is real time.
    #[arg(long, value_name = "MS", value_parser = budget_ms, allow_hyphen_values = true, help_heading = "Recommendation")]
    pub(crate) budget: Option<f64>,

    /// Recommend the cheapest setting that reaches this F1 [default: 0.98]
    #[arg(long, value_name = "F", value_parser = f1_share, allow_hyphen_values = true, help_heading = "Recommendation")]
    pub(crate) target_f1: Option<f64>,

    /// Tolerance of F1; slow motion is given its scaled share [default: 1ms]
    #[arg(long, value_enum, value_name = "T", help_heading = "Recommendation", hide_short_help = true)]
    pub(crate) f1: Option<ToleranceArg>,

    /// Milliseconds charged for each rendered frame on top [default: 0]
    ///
    /// As a heavier renderer would cost.
    #[arg(long, value_name = "MS", value_parser = render_ms, allow_hyphen_values = true, help_heading = "Recommendation", hide_short_help = true)]
    pub(crate) render_ms: Option<f64>,

    #[command(flatten)]
    pub(crate) animation: AnimationArgs,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    #[command(flatten)]
    pub(crate) measuring: MeasuringArgs,
}

/// What `chart` measures, and how.
#[derive(Debug, Args)]
#[group(id = "measuring", multiple = true)]
pub(crate) struct MeasuringArgs {
    /// The camera [default: the first]
    #[arg(long, value_name = "NAME", help_heading = "Scene")]
    pub(crate) camera: Option<String>,

    /// Seconds to simulate [default: 0.25]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) duration: Option<f64>,

    /// How fast everything in the scene moves and changes: 0.25 for a quarter of the speed that it has [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) start: Option<f64>,

    /// Pixels of the camera; costs grow with them [default: 160x120]
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) size: Option<(u32, u32)>,

    /// Fewer settings, for a first look
    #[arg(long, help_heading = "Settings")]
    pub(crate) quick: bool,

    /// Sampled instants per second to measure [default: 125 to 4000]
    ///
    /// The default is 125,250,500,1000,2000,4000; 16 samples go up to 1000.
    #[arg(long, value_name = "HZ,…", value_parser = rate_hz, value_delimiter = ',', allow_hyphen_values = true, help_heading = "Settings", hide_short_help = true)]
    pub(crate) rates: Vec<f64>,

    /// Samples per pixel to measure [default: 1,4,16]
    #[arg(long, value_name = "N,…", value_parser = sample_count, value_delimiter = ',', allow_hyphen_values = true, help_heading = "Settings", hide_short_help = true)]
    pub(crate) samples: Vec<u32>,

    /// Rates at which the trigger also latches [default: 1000]
    #[arg(long, value_name = "HZ,…", value_parser = rate_hz, value_delimiter = ',', allow_hyphen_values = true, help_heading = "Settings", hide_short_help = true)]
    pub(crate) latch_rates: Vec<f64>,

    /// Leave out one shaded sample with the coverage of four
    #[arg(long, help_heading = "Settings", hide_short_help = true)]
    pub(crate) no_edges: bool,

    /// Leave out the settings that the EVIS paper publishes
    #[arg(long, help_heading = "Settings", hide_short_help = true)]
    pub(crate) no_published: bool,

    /// Leave out adaptive time and the presets
    #[arg(long, help_heading = "Settings", hide_short_help = true)]
    pub(crate) no_adaptive: bool,

    /// Leave out `splat`
    #[arg(long, help_heading = "Settings", hide_short_help = true)]
    pub(crate) no_splat: bool,

    /// Runs of each setting, in turn with the others; the fastest counts [default: 3]
    #[arg(long, value_name = "N", value_parser = repetitions, allow_hyphen_values = true, help_heading = "Settings", hide_short_help = true)]
    pub(crate) repetitions: Option<usize>,

    /// Pixels that truth is made for, spread over the picture; `all` for all [default: 1000]
    #[arg(long, value_name = "N|all", value_parser = truth_pixels, allow_hyphen_values = true, help_heading = "Truth")]
    pub(crate) truth_pixels: Option<PixelChoice>,

    /// Do not make truth once more, for a quarter of its pixels, to know its own error
    #[arg(long, help_heading = "Truth", hide_short_help = true)]
    pub(crate) no_floor: bool,

    /// Folder that keeps truths for the next time [default: the user's cache folder]
    #[arg(long, value_name = "DIR", help_heading = "Truth", hide_short_help = true)]
    pub(crate) cache: Option<PathBuf>,

    /// Rise of log intensity that fires an ON event [default: 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_off: Option<f32>,

    /// eps in ln(Y / Y_ref + eps) [default: 0.001]
    #[arg(long, value_name = "E", value_parser = positive, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) log_eps: Option<f32>,

    /// Device by index or by a part of its name (see `devices`) [default: the fastest]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "Device")]
    pub(crate) device: Option<String>,

    /// Seed of built-in scenes [default: 0]
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) seed: Option<u64>,
}
