//! `truth`.

use std::path::PathBuf;

use clap::Args;
use evis_core::TriggerRule;
use evis_truth::{Lattice, PixelChoice};

use super::camera::{AnimationArgs, CameraArgs};
use super::choices::words;
use super::values::{
    crop, positive, positive_seconds, rate_hz, seed, size, speed, start_seconds, threshold, truth_pixels,
};

/// `truth`.
#[derive(Debug, Args)]
pub(crate) struct TruthArgs {
    /// A built-in scene (see `scenes`), a .toml, .gltf or .glb file, or a still picture (.png, .jpg, .hdr, .exr, .tif).
    pub(crate) scene: String,

    #[command(flatten)]
    pub(crate) animation: AnimationArgs,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    /// The HDF5 file to write
    ///
    /// `score` reads it, and it opens as a recording.
    #[arg(short, long, value_name = "TRUTH.h5", help_heading = "Output")]
    pub(crate) output: PathBuf,

    /// The camera [default: the first]
    #[arg(long, value_name = "NAME", help_heading = "Scene")]
    pub(crate) camera: Option<String>,

    /// Seconds [default: 0.25]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) duration: Option<f64>,

    /// How fast everything in the scene moves and changes: 0.25 for a quarter of the speed that it has [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) start: Option<f64>,

    /// Pixels of the camera [default: the camera's own, else 640x480]
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) size: Option<(u32, u32)>,

    /// Pixels to make truth for, spread over the picture; `all` for all [default: 1000]
    #[arg(long, value_name = "N|all", value_parser = truth_pixels, allow_hyphen_values = true, help_heading = "Truth")]
    pub(crate) truth_pixels: Option<PixelChoice>,

    /// Make truth for a rectangle instead: first column, first row, columns, rows
    #[arg(long, value_name = "X,Y,W,H", value_parser = crop, allow_hyphen_values = true, conflicts_with = "truth_pixels", help_heading = "Truth")]
    pub(crate) crop: Option<PixelChoice>,

    /// The trigger on exact light at so many instants per second, not truth
    ///
    /// What an engine without any error of light would fire at this rate. Scored against truth, it tells what the rate alone costs.
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Truth", hide_short_help = true)]
    pub(crate) sampled: Option<f64>,

    /// With --sampled: when events fire [default: what the scene gives the camera, else crossing]
    #[arg(long, value_parser = words::<TriggerRule>(), value_name = "RULE", requires = "sampled", help_heading = "Sensor", hide_short_help = true)]
    pub(crate) trigger: Option<TriggerRule>,

    /// Which samples; truths of both, scored against each other, tell their own error [default: first]
    #[arg(long, value_parser = words::<Lattice>(), value_name = "WHICH", help_heading = "Truth", hide_short_help = true)]
    pub(crate) lattice: Option<Lattice>,

    /// Rise of log intensity that fires an ON event [default: what the scene gives the camera, else 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: what the scene gives the camera, else 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_off: Option<f32>,

    /// eps in ln(Y / Y_ref + eps) [default: what the scene gives the camera, else 0.001]
    #[arg(long, value_name = "E", value_parser = positive, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) log_eps: Option<f32>,

    /// Y_ref in ln(Y / Y_ref + eps) [default: brings the camera's log-mean at the start to 0.18]
    #[arg(long, value_name = "Y", value_parser = positive, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) reference_luminance: Option<f32>,

    /// Folder that keeps truths for the next time [default: the user's cache folder]
    #[arg(long, value_name = "DIR", help_heading = "Truth", hide_short_help = true)]
    pub(crate) cache: Option<PathBuf>,

    /// Overwrite existing output
    #[arg(long, help_heading = "Output")]
    pub(crate) force: bool,

    /// Seed of built-in scenes [default: 0]
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) seed: Option<u64>,
}
