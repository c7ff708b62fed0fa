//! `verify`.

use std::path::PathBuf;

use clap::Args;
use evis_core::closed_form::convergence::Variant;
use evis_render::{Compute, Shadows};
use evis_truth::PixelChoice;

use super::camera::{AnimationArgs, CameraArgs};
use super::choices::words;
use super::values::{
    positive_seconds, rate_hz, sample_count, seed, size, start_seconds, threshold, truth_pixels,
};

/// `verify`.
#[derive(Debug, Args)]
pub(crate) struct VerifyArgs {
    #[command(flatten)]
    pub(crate) what: VerifyWhat,

    /// With --failures: methods to measure [default: all; docs/failures.md lists them]
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', requires = "failures", conflicts_with_all = ["scene", "light"], help_heading = "Failures", hide_short_help = true)]
    pub(crate) methods: Vec<String>,

    /// With --failures: failures to measure [default: all; docs/failures.md lists them]
    #[arg(long, value_name = "ID,…", value_delimiter = ',', requires = "failures", conflicts_with_all = ["scene", "light"], help_heading = "Failures", hide_short_help = true)]
    pub(crate) only: Vec<String>,

    /// With --failures: where decoupled sampling evaluates pixels [default: cpu]
    #[arg(long, value_parser = words::<Compute>(), value_name = "WHERE", requires = "failures", conflicts_with_all = ["scene", "light"], help_heading = "Failures", hide_short_help = true)]
    pub(crate) compute: Option<Compute>,

    /// With --light: scene time in seconds [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, requires = "light", conflicts_with_all = ["scene", "failures"], allow_hyphen_values = true, help_heading = "Light")]
    pub(crate) at: Option<f64>,

    /// With --light: how shadows are computed [default: maps]
    #[arg(long, value_parser = words::<Shadows>(), value_name = "HOW", requires = "light", conflicts_with_all = ["scene", "failures"], help_heading = "Light", hide_short_help = true)]
    pub(crate) shadows: Option<Shadows>,

    /// Print the report as JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,

    /// Picture to write, .png or .svg; repeat for several
    ///
    /// An existing one is replaced.
    #[arg(short, long, value_name = "X.{png,svg}", help_heading = "Output")]
    pub(crate) output: Vec<PathBuf>,

    #[command(flatten)]
    pub(crate) animation: AnimationArgs,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    #[command(flatten)]
    pub(crate) common: VerifyCommonArgs,

    #[command(flatten)]
    pub(crate) measuring: VerifySceneArgs,
}

// clap does not ask for what conflicts with something given: what requires one of these conflicts with the others, too.

/// What `verify` checks; the triggers on closed forms where nothing is named.
#[derive(Debug, Args)]
#[group(id = "measured", multiple = false)]
pub(crate) struct VerifyWhat {
    /// The engine's events on a scene, against the converged oracle
    ///
    /// A built-in scene, a .toml, .gltf or .glb file. Without --scene, --light or --failures the trigger is checked on closed forms.
    #[arg(long, help_heading = "What")]
    pub(crate) scene: Option<String>,

    /// Every method on small scenes that are known to break methods
    ///
    /// Keyframe bursts, disocclusion, rotation, thin and fast objects, shadows, camera cuts, … Ends with 1 where something that is
    /// claimed does not hold.
    #[arg(long, help_heading = "What")]
    pub(crate) failures: bool,

    /// The engine's light at one instant (--at), pixel by pixel, against the oracle's
    ///
    /// By region, by object, and the worst pixels; with -o a picture of the differences.
    #[arg(long, value_name = "SCENE", help_heading = "What")]
    pub(crate) light: Option<String>,
}

/// What `verify` asks of more than closed forms.
#[derive(Debug, Args)]
#[group(id = "measuring", multiple = true, requires = "measured")]
pub(crate) struct VerifyCommonArgs {
    /// Pixels of the camera [default: 160x120]
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, conflicts_with = "failures", help_heading = "Scene")]
    pub(crate) size: Option<(u32, u32)>,

    /// Samples per pixel [default: 1,4,16,64; with --light 16]
    #[arg(long, value_name = "N,…", value_parser = sample_count, value_delimiter = ',', allow_hyphen_values = true, conflicts_with = "failures", help_heading = "Quality", hide_short_help = true)]
    pub(crate) samples: Vec<u32>,

    /// The camera [default: the first]
    #[arg(long, value_name = "NAME", conflicts_with = "failures", help_heading = "Scene")]
    pub(crate) camera: Option<String>,

    /// Folder that keeps truths for the next time [default: the user's cache folder]
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with = "light",
        help_heading = "Truth",
        hide_short_help = true
    )]
    pub(crate) cache: Option<PathBuf>,

    /// Device by index or by a part of its name (see `devices`) [default: the fastest]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "Device")]
    pub(crate) device: Option<String>,

    /// Seed of built-in scenes [default: 0]
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, conflicts_with = "failures", help_heading = "Scene", hide_short_help = true)]
    pub(crate) seed: Option<u64>,
}

/// How `verify --scene` measures.
#[derive(Debug, Args)]
#[group(id = "verifying", multiple = true, requires = "scene", conflicts_with_all = ["failures", "light"])]
pub(crate) struct VerifySceneArgs {
    /// Seconds to simulate [default: 0.1]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) duration: Option<f64>,

    /// Pixels that truth is made for, spread over the picture; `all` for all [default: 400]
    #[arg(long, value_name = "N|all", value_parser = truth_pixels, allow_hyphen_values = true, help_heading = "Truth")]
    pub(crate) truth_pixels: Option<PixelChoice>,

    /// Sampled instants per second [default: 250,500,1000,2000,4000]
    #[arg(long, value_name = "HZ,…", value_parser = rate_hz, value_delimiter = ',', allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) rates: Vec<f64>,

    /// Triggers; the first is measured with every number of samples, the others with the largest
    /// [default: crossing,latch].
    #[arg(
        long,
        value_parser = words::<Variant>(),
        value_name = "T,…",
        value_delimiter = ',',
        help_heading = "Sensor",
        hide_short_help = true
    )]
    pub(crate) triggers: Vec<Variant>,

    /// Rise of log intensity that fires an ON event [default: 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_off: Option<f32>,
}
