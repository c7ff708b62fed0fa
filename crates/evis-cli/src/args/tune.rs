//! `tune`.

use std::path::PathBuf;

use clap::Args;
use evis_render::Shadows;

use super::camera::{AnimationArgs, CameraArgs};
use super::choices::words;
use super::values::{size, speed, start_seconds};

/// `tune`.
#[derive(Debug, Args)]
pub(crate) struct TuneArgs {
    /// A built-in scene (see `scenes`), a .toml, .gltf or .glb file, or a still picture (.png, .jpg, .hdr, .exr, .tif).
    pub(crate) scene: String,

    #[command(flatten)]
    pub(crate) animation: AnimationArgs,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    /// The settings file to write
    #[arg(short, long, value_name = "SETTINGS.toml", help_heading = "Output")]
    pub(crate) output: PathBuf,

    /// F1 within 1 ms, beside much finer settings, that is enough
    #[arg(
        long,
        value_name = "F1",
        default_value_t = 0.98,
        allow_hyphen_values = true,
        help_heading = "Quality"
    )]
    pub(crate) target_f1: f64,

    /// Milliseconds of work per simulated second that are allowed [default: no limit]
    ///
    /// Candidates are timed.
    #[arg(long, value_name = "MS", allow_hyphen_values = true, help_heading = "Quality")]
    pub(crate) budget: Option<f64>,

    /// A camera to render; repeat for several [default: all]
    #[arg(long, value_name = "NAME", help_heading = "Scene")]
    pub(crate) camera: Vec<String>,

    /// Pixels of every camera [default: the camera's own, else 640x480]
    ///
    /// A camera with an aspect but no size gets its aspect at 480 lines.
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) size: Option<(u32, u32)>,

    /// How fast everything in the scene moves and changes [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) start: Option<f64>,

    /// Sensor whose thresholds count [default: the scene's, else ideal]
    ///
    /// A preset or a TOML file; CAMERA=PRESET or CAMERA=FILE is for one camera.
    #[arg(long, value_name = "[CAMERA=]PRESET|FILE", help_heading = "Sensor")]
    pub(crate) sensor: Vec<String>,

    /// Shadows by maps or by rays [default: whatever is accurate enough]
    #[arg(long, value_parser = words::<Shadows>(), help_heading = "Quality", hide_short_help = true)]
    pub(crate) shadows: Option<Shadows>,

    /// Device by index or by a part of its name (see `devices`) [default: the fastest]
    #[arg(long, value_name = "DEVICE", help_heading = "Device")]
    pub(crate) device: Option<String>,

    /// Replace the output if it exists
    #[arg(long, help_heading = "Output")]
    pub(crate) force: bool,
}
