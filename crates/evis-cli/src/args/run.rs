//! `run`.

use std::path::PathBuf;

use clap::Args;
use evis_core::{Warp, WarpVariant};

use super::camera::CameraArgs;
use super::choices::{AntialiasArg, BetweenArg, LabelArg, MethodArg, QualityArg, ShadowsArg, TriggerArg};
use super::values::{
    margin_pixels, positive, positive_seconds, rate_hz, sample_count, seed, shadow_map, size, speed,
    start_seconds, step_count, texture_taps, threshold, window_ms,
};

/// `run`.
#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    /// A built-in scene (see `scenes`), a .toml, .gltf or .glb file, or a still picture (.png, .jpg, .hdr, .exr, .tif).
    pub(crate) scene: String,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    /// The HDF5 file to write. Several environments give one file each: OUT_0000.h5, OUT_0001.h5, …
    #[arg(short, long, value_name = "OUT.h5")]
    pub(crate) output: PathBuf,

    /// A camera to render; repeat for several [default: all].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Vec<String>,

    /// Seconds to simulate [default: what is left of the scene's own duration, else 1].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// How fast everything in the scene moves and changes: 0.25 for a quarter of the speed that it has [default: 1].
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Pixels of every camera [default: the camera's own, else 640x480, or its aspect at 480 lines].
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true)]
    pub(crate) size: Option<(u32, u32)>,

    /// Fixed settings, the same for every scene [default: standard, unless sampling is set by hand].
    #[arg(long, value_enum)]
    pub(crate) quality: Option<QualityArg>,

    /// Settings from `tune`, or those of a recording (.h5); flags override them.
    #[arg(long, value_name = "FILE")]
    pub(crate) settings: Option<PathBuf>,

    /// Share of the tiles that are skipped or sampled less often which are rendered once more and compared; no event depends
    /// on it, 0 turns it off [default: 0.005].
    #[arg(long, value_name = "SHARE", allow_hyphen_values = true)]
    pub(crate) audit: Option<f64>,

    /// Sampled instants per second, for --method native [default: 1000].
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true)]
    pub(crate) rate: Option<f64>,

    /// Render each part of the picture only as often as it moves by so many pixels, and at --rate at most, for --method
    /// native [default: the whole picture at --rate].
    #[arg(long, value_name = "PX", allow_hyphen_values = true)]
    pub(crate) adaptive: Option<f64>,

    /// With --adaptive: how log light runs between two samples, for a sensor of thresholds alone [default: line].
    #[arg(long, value_enum)]
    pub(crate) between: Option<BetweenArg>,

    /// Samples per pixel and instant, 1 to 256 [default: 4].
    #[arg(long, value_name = "N", value_parser = sample_count, allow_hyphen_values = true)]
    pub(crate) samples: Option<u32>,

    /// How instants are sampled [default: native].
    #[arg(long, value_enum)]
    pub(crate) method: Option<MethodArg>,

    #[command(flatten)]
    pub(crate) splat: SplatArgs,

    /// Sensor: a preset (ideal, evis, v2e, v2e-noisy, esim, openeb, dvxplorer-like, …) or a TOML file; CAMERA=… for one
    /// camera, again for another. The flags below override it [default: what the scene gives each camera, else ideal].
    #[arg(long, value_name = "[CAMERA=]PRESET|FILE")]
    pub(crate) sensor: Vec<String>,

    /// How a change of brightness becomes events [default: the sensor's; crossing, or latch for evis-paper].
    #[arg(long, value_enum)]
    pub(crate) trigger: Option<TriggerArg>,

    /// Rise of log intensity that fires an ON event [default: 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_off: Option<f32>,

    /// eps in ln(Y / Y_ref + eps) [default: 0.001; 0.00001 for evis-paper].
    #[arg(long, value_name = "E", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) log_eps: Option<f32>,

    /// Labels to write, separated by commas; flow means forward and backward with their masks [default: none].
    #[arg(long, value_enum, value_delimiter = ',', value_name = "KINDS")]
    pub(crate) labels: Vec<LabelArg>,

    /// Label images per second; camera poses are written at the same rate [default: 50].
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true)]
    pub(crate) label_rate: Option<f64>,

    /// Frames per second to write beside the events: mean linear light over an exposure [default: none].
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true)]
    pub(crate) frame_rate: Option<f64>,

    /// Exposure of those frames in milliseconds, at most the time between two; rounded down to an even number of microseconds
    /// [default: 10, or the time between two where that is shorter].
    #[arg(long, value_name = "MS", value_parser = window_ms, allow_hyphen_values = true)]
    pub(crate) exposure_ms: Option<f64>,

    /// Y_ref in ln(Y / Y_ref + eps) [default: brings the first camera's log-mean at the start to 0.18].
    #[arg(long, value_name = "Y", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) reference_luminance: Option<f32>,

    /// samples: visibility and shading at every sample; edges: visibility at every sample, shading at one in four, on a grid
    /// (--samples 4, 16, 36, 64, ...) [default: samples].
    #[arg(long, value_enum)]
    pub(crate) aa: Option<AntialiasArg>,

    /// maps: by shadow maps, soft by a texel; rays: along borders by rays, as sharp as the casters, up to twice the work
    /// [default: the preset's; maps without one].
    #[arg(long, value_enum)]
    pub(crate) shadows: Option<ShadowsArg>,

    /// Texels of a shadow map's edge [default: about 12.8 times the picture's, 1024 to 8192; 2048 at most where a light that throws
    /// shadows moves].
    #[arg(long, value_name = "TEXELS", value_parser = shadow_map, allow_hyphen_values = true)]
    pub(crate) shadow_map: Option<u32>,

    /// Places at which a sample reads a texture, at most, along each side of its share of the pixel
    /// [default: 2 up to 8 samples, 3 up to 15, then 4].
    #[arg(long, value_name = "N", value_parser = texture_taps, allow_hyphen_values = true)]
    pub(crate) texture_taps: Option<u32>,

    /// Device by index or by a part of its name (see `devices`) [default: the fastest kind].
    #[arg(long, value_name = "NAME|INDEX")]
    pub(crate) device: Option<String>,

    /// Overwrite existing output.
    #[arg(long)]
    pub(crate) force: bool,

    /// Seed of everything random [default: 0].
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true)]
    pub(crate) seed: Option<u64>,

    /// Write a report as JSON: settings, device, counts, rates, milliseconds per stage, warnings. Refused if the file exists,
    /// unless --force is given.
    #[arg(long, value_name = "R.json")]
    pub(crate) report: Option<PathBuf>,

    /// Print the report as JSON on standard output instead of a summary.
    #[arg(long)]
    pub(crate) json: bool,
}

/// What `--method splat` and `evis-paper` are told; the defaults named are those of `splat`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Options of --method splat and evis-paper")]
pub(crate) struct SplatArgs {
    /// Keyframes rendered per second [default: 125].
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true)]
    pub(crate) keyframe_rate: Option<f64>,

    /// Instants per gap between keyframes, 1 to 1000 [default: 8].
    #[arg(long, value_name = "N", value_parser = step_count, allow_hyphen_values = true)]
    pub(crate) steps: Option<u32>,

    /// Pixels that keyframes show beyond each border, 0 to 512 [default: 32].
    #[arg(long, value_name = "PX", value_parser = margin_pixels, allow_hyphen_values = true)]
    pub(crate) margin: Option<u32>,
}

impl SplatArgs {
    /// `variant` with what was given.
    pub(crate) fn warp(&self, variant: WarpVariant) -> Warp {
        let Self { keyframe_rate, steps, margin } = *self;
        Warp { variant, keyframe_hz: keyframe_rate, steps, margin, ..Warp::default() }
    }

    /// The first flag that was given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        [
            (self.keyframe_rate.is_some(), "--keyframe-rate"),
            (self.steps.is_some(), "--steps"),
            (self.margin.is_some(), "--margin"),
        ]
        .into_iter()
        .find_map(|(given, flag)| given.then_some(flag))
    }
}
