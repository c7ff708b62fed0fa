//! `preview`.

use std::path::PathBuf;

use clap::Args;

use super::camera::AnimationArgs;
use super::choices::Background;
use super::values::{Scale, fps, positive_seconds, scale, size, slow, start_seconds, window_ms};

/// `preview`.
#[derive(Debug, Args)]
pub(crate) struct PreviewArgs {
    /// A recording, or a scene to render as one still picture: a built-in name, .glb, .gltf or .toml.
    pub(crate) input: PathBuf,

    /// Picture to write: .png, .gif or .mp4
    ///
    /// An existing one is replaced.
    #[arg(short, long, value_name = "X.{png,gif,mp4}", help_heading = "Output")]
    pub(crate) output: PathBuf,

    /// Camera to show [default: the first]
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    pub(crate) camera: Option<String>,

    /// What stands beside the events, where it was recorded: depth, flow, instance, semantic, normal, hdr, frame or none
    ///
    /// Depth is brighter the nearer it is; flow has the hue of its direction, red to the right; ids have a colour each.
    ///
    /// [default: HDR frames, else frames, where there are any]
    #[arg(long, value_name = "LABEL", value_parser = ["depth", "flow", "instance", "semantic", "normal", "hdr", "frame", "none"], hide_possible_values = true, help_heading = "Picture")]
    pub(crate) label: Option<String>,

    #[command(flatten)]
    pub(crate) animation: AnimationArgs,

    /// Of a scene: pixels [default: the camera's own, else 640x480]
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) size: Option<(u32, u32)>,

    /// PNG: the window that ends at this second, instead of a contact sheet; of a scene, its time
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, conflicts_with_all = ["start", "duration"], help_heading = "Input")]
    pub(crate) at: Option<f64>,

    /// Start in seconds of stream time [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) start: Option<f64>,

    /// Seconds of stream time to show [default: to the end]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) duration: Option<f64>,

    /// Milliseconds of events per picture [default: 20]
    ///
    /// In films the default is the time between two frames, at least 10.
    #[arg(long, value_name = "MS", value_parser = window_ms, allow_hyphen_values = true, help_heading = "Picture")]
    pub(crate) window_ms: Option<f64>,

    /// Frames per second of a film [default: 30 for MP4, 20 for GIF]
    #[arg(long, value_name = "N", value_parser = fps, allow_hyphen_values = true, help_heading = "Picture")]
    pub(crate) fps: Option<f64>,

    /// Slow motion: a film lasts so many times as long [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = slow, allow_hyphen_values = true, help_heading = "Picture")]
    pub(crate) slow: Option<f64>,

    /// 2, 3, … enlarges by whole pixels; 1/2, 1/3, … reduces [default: 1]
    #[arg(long, value_name = "N", value_parser = scale, default_value = "1", hide_default_value = true, allow_hyphen_values = true, help_heading = "Picture")]
    pub(crate) scale: Scale,

    /// Background of the event picture
    ///
    /// light: ON orange, OFF dark blue; dark: ON yellow, OFF blue. ON is the brighter of the two also when printed grey.
    #[arg(long, value_enum, default_value = "light", help_heading = "Picture")]
    pub(crate) background: Background,
}
