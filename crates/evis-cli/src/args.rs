//! The command line as data. Every value that can be checked alone is checked here, so that the message
//! names the flag, the value, and what would work.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use evis_core::closed_form::convergence::Variant;
use evis_core::metric::MAX_TOLERANCE_US;
use evis_core::stats::Stimulus;
use evis_core::{LabelKind, Transfer, TriggerRule, Warp, WarpVariant};
use evis_render::{Antialias, Between, Quality, Shadows};
use evis_truth::{Lattice, PixelChoice};

use crate::camera_args::CameraArgs;

/// Longest stream and latest start in seconds: 31 days, the most that a recording holds.
const MAX_SECONDS: f64 = 2_678_400.0;

/// Largest width or height of a view in pixels.
const MAX_SIZE: u32 = 8192;

/// EVIS: moving 3D scenes in, labelled event streams out.
#[derive(Debug, Parser)]
#[command(
    name = "evis-rs",
    version,
    about = "Event-camera simulator: moving 3D scenes in, labelled (t, x, y, p) events out.",
    after_help = "Exit codes: 0 done; 2 bad input (arguments, files, no usable device, no space); \
                  1 failure; 130 interrupted, the file is finished and readable.",
    subcommand_required = true,
    arg_required_else_help = true
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,

    /// Memory that a file may take, such as 8G or 500M; unless given 4G, or half of the machine's memory where that is less
    #[arg(long, global = true, value_name = "SIZE", value_parser = memory_size)]
    pub(crate) memory_limit: Option<u64>,

    /// Let glTF files refer to files outside of their folder
    #[arg(long, global = true)]
    pub(crate) allow_outside: bool,
}

/// Bytes of `8G`, `500M` or `1000000`.
fn memory_size(text: &str) -> Result<u64, String> {
    let (number, unit) = text.split_at(text.trim_end_matches(char::is_alphabetic).len());
    let shift = match unit.to_ascii_lowercase().trim_end_matches('b').trim_end_matches('i') {
        "" => 0,
        "k" => 10,
        "m" => 20,
        "g" => 30,
        "t" => 40,
        _ => return Err(format!("'{unit}' is no unit; K, M, G and T work")),
    };
    let bytes = number.parse::<u64>().ok().and_then(|number| number.checked_mul(1 << shift));
    let least = evis_core::limits::LEAST_MEMORY_LIMIT;
    bytes
        .filter(|bytes| *bytes >= least)
        .ok_or_else(|| format!("give a size of 1M or more, such as 8G or {least}"))
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Simulate a scene and write its events, labels and poses to an HDF5 file.
    Run(Box<RunArgs>),
    /// Find the cheapest settings that are accurate enough on a scene, for `run --settings`.
    Tune(Box<TuneArgs>),
    /// Turn a film, a folder of pictures or an array of frames into events, and write them to an HDF5 file.
    Video(Box<VideoArgs>),
    /// Show a recording as a picture (PNG), an animation (GIF) or a film (MP4).
    Preview(PreviewArgs),
    /// Measure settings on a scene: draw speed against accuracy, and recommend one.
    Chart(Box<ChartArgs>),
    /// Compute what an ideal sensor fires in a scene, without the engine: exact, and slow.
    Truth(Box<TruthArgs>),
    /// Check that events converge to truth as theory says: on closed forms, or on a scene.
    Verify(Box<VerifyArgs>),
    /// Write a file of events in another format: Prophesee RAW and DAT, AEDAT, text, NumPy, HDF5, ROS 2 bags, DSEC.
    Convert(Box<crate::convert::ConvertArgs>),
    /// Tell what a recording or a file of events holds; repair a recording that was cut off.
    Info(InfoArgs),
    /// Score the events of a recording against truth: matches within a tolerance, time errors, regions.
    Score(ScoreArgs),
    /// Fit a sensor to a recording of a still scene, or to recordings of flickering light (--stimulus).
    Calibrate(CalibrateArgs),
    /// Set two recordings' statistics side by side, as a table and a figure.
    Compare(CompareArgs),
    /// List the built-in scenes.
    Scenes(ListArgs),
    /// List the devices that can run the engine.
    Devices(ListArgs),
}

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

/// `tune`.
#[derive(Debug, Args)]
pub(crate) struct TuneArgs {
    /// A built-in scene (see `scenes`), a .toml, .gltf or .glb file, or a still picture (.png, .jpg, .hdr, .exr, .tif).
    pub(crate) scene: String,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    /// The settings file to write.
    #[arg(short, long, value_name = "SETTINGS.toml")]
    pub(crate) output: PathBuf,

    /// F1 within 1 ms, beside much finer settings, that is enough.
    #[arg(long, value_name = "F1", default_value_t = 0.98, allow_hyphen_values = true)]
    pub(crate) target_f1: f64,

    /// Milliseconds of work per simulated second that are allowed; candidates are timed [default: no limit].
    #[arg(long, value_name = "MS", allow_hyphen_values = true)]
    pub(crate) budget: Option<f64>,

    /// A camera to render; repeat for several [default: all].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Vec<String>,

    /// Pixels of every camera [default: the camera's own, else 640x480, or its aspect at 480 lines].
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true)]
    pub(crate) size: Option<(u32, u32)>,

    /// How fast everything in the scene moves and changes [default: 1].
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Sensor whose thresholds count: a preset or a TOML file [default: what the scene gives each camera, else ideal].
    #[arg(long, value_name = "[CAMERA=]PRESET|FILE")]
    pub(crate) sensor: Vec<String>,

    /// Shadows by maps or by rays [default: whatever is accurate enough].
    #[arg(long, value_enum)]
    pub(crate) shadows: Option<ShadowsArg>,

    /// Device, by its index or a part of its name (see `devices`) [default: the fastest kind].
    #[arg(long, value_name = "DEVICE")]
    pub(crate) device: Option<String>,

    /// Replace the output if it exists.
    #[arg(long)]
    pub(crate) force: bool,
}

/// Presets of converters that take the stored values of a film for light.
const LIKE: [&str; 8] =
    ["v2e", "v2e-clean", "v2e-noisy", "esim", "openeb", "pix2nvs", "davis346", "davis240"];

/// `video`.
#[derive(Debug, Args)]
pub(crate) struct VideoArgs {
    /// A film that ffmpeg plays, a folder of PNG, EXR or TIFF pictures, or a .npy stack (T, H, W[, 3]).
    pub(crate) input: PathBuf,

    /// The HDF5 file to write.
    #[arg(short, long, value_name = "OUT.h5")]
    pub(crate) output: PathBuf,

    /// The sensor: a preset (ideal, evis, v2e, ...; see docs/sensor.md) or a TOML file [default: ideal].
    #[arg(long, value_name = "PRESET|FILE")]
    pub(crate) sensor: Option<String>,

    /// As another converter has it: its preset, and --transfer linear, since these tools take stored values for light, which
    /// gives fewer events (docs/video.md says how many).
    #[arg(long, value_name = "PRESET", value_parser = LIKE, conflicts_with_all = ["sensor", "transfer"])]
    pub(crate) like: Option<String>,

    /// Seed of everything random [default: 0].
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true)]
    pub(crate) seed: Option<u64>,

    /// Curve between stored values and light: srgb, rec709, gamma:G, linear [default: rec709 for films, else srgb; 32-bit
    /// floats are light already]. linear imitates v2e, vid2e and OpenEB; --like sets it with their preset.
    #[arg(long, value_name = "CURVE", value_parser = transfer)]
    pub(crate) transfer: Option<Transfer>,

    /// Frames per second, whatever the input says [default: a film's own times, a folder's timestamps.txt].
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, conflicts_with = "timestamps")]
    pub(crate) fps: Option<f64>,

    /// A text file of times, one per frame and line: seconds, or below a line `# unit: us` (s, ms, ns) that unit.
    #[arg(long, value_name = "FILE")]
    pub(crate) timestamps: Option<PathBuf>,

    /// Pixels of the sensor; frames are averaged to it in linear light [default: the frames' own].
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true)]
    pub(crate) size: Option<(u32, u32)>,

    /// Seconds after the first frame at which the stream starts [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Seconds to convert [default: all].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// Y_ref in ln(Y / Y_ref + eps); white of integer frames is 1 [default: 1].
    #[arg(long, value_name = "Y", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) reference_luminance: Option<f32>,

    /// Overwrite the output if it exists.
    #[arg(long)]
    pub(crate) force: bool,

    /// Write the report as JSON to this file too. Refused if it exists, unless --force is given.
    #[arg(long, value_name = "FILE")]
    pub(crate) report: Option<PathBuf>,

    /// Print the report as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `preview`.
#[derive(Debug, Args)]
pub(crate) struct PreviewArgs {
    /// The recording.
    pub(crate) input: PathBuf,

    /// Picture to write; its ending chooses the kind: .png, .gif or .mp4. An existing one is replaced.
    #[arg(short, long, value_name = "X.{png,gif,mp4}")]
    pub(crate) output: PathBuf,

    /// Camera to show [default: the first].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,

    /// PNG: show the window that ends at this time in seconds, instead of a contact sheet.
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true,
          conflicts_with_all = ["start", "duration"])]
    pub(crate) at: Option<f64>,

    /// Start in seconds of stream time [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Seconds of stream time to show [default: to the end].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// Milliseconds of events per picture [default: 20; in films the time between two frames, at least 10].
    #[arg(long, value_name = "MS", value_parser = window_ms, allow_hyphen_values = true)]
    pub(crate) window_ms: Option<f64>,

    /// Frames per second of a film [default: 30 for MP4, 20 for GIF].
    #[arg(long, value_name = "N", value_parser = fps, allow_hyphen_values = true)]
    pub(crate) fps: Option<f64>,

    /// Slow motion: a film lasts this many times as long as the stream [default: 1].
    #[arg(long, value_name = "FACTOR", value_parser = slow, allow_hyphen_values = true)]
    pub(crate) slow: Option<f64>,

    /// Size of the picture: 2, 3, … enlarges by whole pixels; 1/2, 1/3, … reduces [default: 1].
    #[arg(long, value_name = "N", value_parser = scale, default_value = "1", hide_default_value = true,
          allow_hyphen_values = true)]
    pub(crate) scale: Scale,

    /// Background of the event picture. light: ON orange, OFF dark blue; dark: ON yellow, OFF blue. ON is the
    /// brighter of the two also when printed grey.
    #[arg(long, value_enum, default_value = "light")]
    pub(crate) background: Background,
}

/// `chart`.
#[derive(Debug, Args)]
pub(crate) struct ChartArgs {
    /// Built-in scenes (see `scenes`), or .toml, .gltf or .glb files; a row of the picture each.
    #[arg(value_name = "SCENE", required_unless_present = "from")]
    pub(crate) scenes: Vec<String>,

    /// Picture to write, .png or .svg; repeat for several. An existing one is replaced.
    #[arg(short, long, value_name = "X.{png,svg}")]
    pub(crate) output: Vec<PathBuf>,

    /// Write what was measured as JSON, to draw it again with --from.
    #[arg(long, value_name = "R.json")]
    pub(crate) json: Option<PathBuf>,

    /// Draw what was measured before, instead of measuring; repeat for several.
    #[arg(long, value_name = "R.json", conflicts_with_all = ["scenes", "measuring", "CameraArgs"])]
    pub(crate) from: Vec<PathBuf>,

    /// Recommend the most accurate setting within this many milliseconds of work per simulated second
    /// [default: 1000, real time].
    #[arg(long, value_name = "MS", value_parser = budget_ms, allow_hyphen_values = true)]
    pub(crate) budget: Option<f64>,

    /// Recommend the cheapest setting that reaches this F1 [default: 0.98].
    #[arg(long, value_name = "F", value_parser = f1_share, allow_hyphen_values = true)]
    pub(crate) target_f1: Option<f64>,

    /// Tolerance of F1; slow motion is given its scaled share [default: 1ms].
    #[arg(long, value_enum, value_name = "T")]
    pub(crate) f1: Option<ToleranceArg>,

    /// Charge each rendered frame so many milliseconds on top, as a heavier renderer would cost [default: 0].
    #[arg(long, value_name = "MS", value_parser = render_ms, allow_hyphen_values = true)]
    pub(crate) render_ms: Option<f64>,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    #[command(flatten)]
    pub(crate) measuring: MeasuringArgs,
}

/// What `chart` measures, and how.
#[derive(Debug, Args)]
#[group(id = "measuring", multiple = true)]
pub(crate) struct MeasuringArgs {
    /// The camera [default: the first].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,

    /// Seconds to simulate [default: 0.25].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// How fast everything in the scene moves and changes: 0.25 for a quarter of the speed that it has [default: 1].
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Pixels of the camera; costs grow with them [default: 160x120].
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true)]
    pub(crate) size: Option<(u32, u32)>,

    /// Fewer settings, for a first look.
    #[arg(long)]
    pub(crate) quick: bool,

    /// Sampled instants per second to measure [default: 125,250,500,1000,2000,4000; 16 samples up to 1000].
    #[arg(long, value_name = "HZ,…", value_parser = rate_hz, value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) rates: Vec<f64>,

    /// Samples per pixel to measure [default: 1,4,16].
    #[arg(long, value_name = "N,…", value_parser = sample_count, value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) samples: Vec<u32>,

    /// Rates at which the trigger also latches [default: 1000].
    #[arg(long, value_name = "HZ,…", value_parser = rate_hz, value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) latch_rates: Vec<f64>,

    /// Leave out one shaded sample with the coverage of four.
    #[arg(long)]
    pub(crate) no_edges: bool,

    /// Leave out the settings that the EVIS paper publishes.
    #[arg(long)]
    pub(crate) no_published: bool,

    /// Leave out adaptive time and the presets.
    #[arg(long)]
    pub(crate) no_adaptive: bool,

    /// Leave out `splat`.
    #[arg(long)]
    pub(crate) no_splat: bool,

    /// Runs of each setting, in turn with the others; the fastest counts [default: 3].
    #[arg(long, value_name = "N", value_parser = repetitions, allow_hyphen_values = true)]
    pub(crate) repetitions: Option<usize>,

    /// Pixels that truth is made for, spread over the picture; `all` for all [default: 1000].
    #[arg(long, value_name = "N|all", value_parser = truth_pixels, allow_hyphen_values = true)]
    pub(crate) truth_pixels: Option<PixelChoice>,

    /// Do not make truth once more, for a quarter of its pixels, to know its own error.
    #[arg(long)]
    pub(crate) no_floor: bool,

    /// Folder that keeps truths for the next time [default: the user's cache folder].
    #[arg(long, value_name = "DIR")]
    pub(crate) cache: Option<PathBuf>,

    /// Rise of log intensity that fires an ON event [default: 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_off: Option<f32>,

    /// eps in ln(Y / Y_ref + eps) [default: 0.001].
    #[arg(long, value_name = "E", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) log_eps: Option<f32>,

    /// Device by index or by a part of its name (see `devices`) [default: the fastest kind].
    #[arg(long, value_name = "NAME|INDEX")]
    pub(crate) device: Option<String>,

    /// Seed of built-in scenes [default: 0].
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true)]
    pub(crate) seed: Option<u64>,
}

/// `truth`.
#[derive(Debug, Args)]
pub(crate) struct TruthArgs {
    /// A built-in scene (see `scenes`), a .toml, .gltf or .glb file, or a still picture (.png, .jpg, .hdr, .exr, .tif).
    pub(crate) scene: String,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    /// The HDF5 file to write; `score` reads it, and it opens as a recording.
    #[arg(short, long, value_name = "TRUTH.h5")]
    pub(crate) output: PathBuf,

    /// The camera [default: the first].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,

    /// Seconds [default: 0.25].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// How fast everything in the scene moves and changes: 0.25 for a quarter of the speed that it has [default: 1].
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true)]
    pub(crate) speed: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Pixels of the camera [default: the camera's own, else 640x480, or its aspect at 480 lines].
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true)]
    pub(crate) size: Option<(u32, u32)>,

    /// Pixels to make truth for, spread over the picture; `all` for all [default: 1000].
    #[arg(long, value_name = "N|all", value_parser = truth_pixels, allow_hyphen_values = true)]
    pub(crate) pixels: Option<PixelChoice>,

    /// Make truth for a rectangle instead: first column, first row, columns, rows.
    #[arg(long, value_name = "X,Y,W,H", value_parser = crop, allow_hyphen_values = true, conflicts_with = "pixels")]
    pub(crate) crop: Option<PixelChoice>,

    /// Not truth, but what an engine without any error of light would fire at this rate: the trigger on exact light at so
    /// many instants per second. Scored against truth, it tells what the rate alone costs.
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true)]
    pub(crate) sampled: Option<f64>,

    /// With --sampled: when events fire [default: what the scene gives the camera, else crossing].
    #[arg(long, value_enum, requires = "sampled")]
    pub(crate) trigger: Option<TriggerArg>,

    /// Which samples; truths of both, scored against each other, tell their own error [default: first].
    #[arg(long, value_enum)]
    pub(crate) lattice: Option<LatticeArg>,

    /// Rise of log intensity that fires an ON event [default: what the scene gives the camera, else 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: what the scene gives the camera, else 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_off: Option<f32>,

    /// eps in ln(Y / Y_ref + eps) [default: what the scene gives the camera, else 0.001].
    #[arg(long, value_name = "E", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) log_eps: Option<f32>,

    /// Y_ref in ln(Y / Y_ref + eps) [default: brings the camera's log-mean at the start to 0.18].
    #[arg(long, value_name = "Y", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) reference_luminance: Option<f32>,

    /// Folder that keeps truths for the next time [default: the user's cache folder].
    #[arg(long, value_name = "DIR")]
    pub(crate) cache: Option<PathBuf>,

    /// Overwrite existing output.
    #[arg(long)]
    pub(crate) force: bool,

    /// Seed of built-in scenes [default: 0].
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true)]
    pub(crate) seed: Option<u64>,
}

/// `verify`.
#[derive(Debug, Args)]
pub(crate) struct VerifyArgs {
    #[command(flatten)]
    pub(crate) what: VerifyWhat,

    /// With --failures: methods to measure [default: all; docs/failures.md lists them].
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', requires = "failures", conflicts_with_all = ["scene", "light"])]
    pub(crate) methods: Vec<String>,

    /// With --failures: failures to measure [default: all; docs/failures.md lists them].
    #[arg(long, value_name = "ID,…", value_delimiter = ',', requires = "failures", conflicts_with_all = ["scene", "light"])]
    pub(crate) only: Vec<String>,

    /// With --light: scene time in milliseconds [default: 0].
    #[arg(long, value_name = "MS", value_parser = start_ms, requires = "light", conflicts_with_all = ["scene", "failures"], allow_hyphen_values = true)]
    pub(crate) at: Option<f64>,

    /// With --light: how shadows are told from light [default: maps].
    #[arg(long, value_enum, requires = "light", conflicts_with_all = ["scene", "failures"])]
    pub(crate) shadows: Option<ShadowsArg>,

    /// Print the report as JSON.
    #[arg(long)]
    pub(crate) json: bool,

    /// Picture to write, .png or .svg; repeat for several. An existing one is replaced.
    #[arg(short, long, value_name = "X.{png,svg}")]
    pub(crate) output: Vec<PathBuf>,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    #[command(flatten)]
    pub(crate) common: VerifyCommonArgs,

    #[command(flatten)]
    pub(crate) measuring: VerifySceneArgs,
}

// clap does not ask for what conflicts with something given: what requires one of these conflicts with the others, too.

/// What `verify` looks at; the triggers on closed forms where nothing is named.
#[derive(Debug, Args)]
#[group(id = "measured", multiple = false)]
pub(crate) struct VerifyWhat {
    /// Measure the engine on a scene (built-in, .toml, .gltf or .glb) against the converged oracle, instead of the
    /// trigger on closed forms.
    #[arg(long)]
    pub(crate) scene: Option<String>,

    /// Measure every method on small scenes that are known to break methods: keyframe bursts, disocclusion, rotation,
    /// thin and fast objects, shadows, camera cuts, … Ends with 1 where something that is claimed does not hold.
    #[arg(long)]
    pub(crate) failures: bool,

    /// Compare the engine's light on a scene with the oracle's at one instant (--at), pixel by pixel: by region, by object,
    /// and the worst pixels; with -o a picture of the differences.
    #[arg(long, value_name = "SCENE")]
    pub(crate) light: Option<String>,
}

/// What `verify` asks of more than closed forms.
#[derive(Debug, Args)]
#[group(id = "measuring", multiple = true, requires = "measured")]
pub(crate) struct VerifyCommonArgs {
    /// Pixels of the camera [default: 160x120].
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, conflicts_with = "failures")]
    pub(crate) size: Option<(u32, u32)>,

    /// Samples per pixel [default: 1,4,16,64; with --light 16].
    #[arg(long, value_name = "N,…", value_parser = sample_count, value_delimiter = ',', allow_hyphen_values = true, conflicts_with = "failures")]
    pub(crate) samples: Vec<u32>,

    /// The camera [default: the first].
    #[arg(long, value_name = "NAME", conflicts_with = "failures")]
    pub(crate) camera: Option<String>,

    /// Folder that keeps truths for the next time [default: the user's cache folder].
    #[arg(long, value_name = "DIR", conflicts_with = "light")]
    pub(crate) cache: Option<PathBuf>,

    /// Device by index or by a part of its name (see `devices`) [default: the fastest kind].
    #[arg(long, value_name = "NAME|INDEX")]
    pub(crate) device: Option<String>,

    /// Seed of built-in scenes [default: 0].
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, conflicts_with = "failures")]
    pub(crate) seed: Option<u64>,
}

/// How `verify --scene` measures.
#[derive(Debug, Args)]
#[group(id = "verifying", multiple = true, requires = "scene", conflicts_with_all = ["failures", "light"])]
pub(crate) struct VerifySceneArgs {
    /// Milliseconds to simulate [default: 100].
    #[arg(long, value_name = "MS", value_parser = duration_ms, allow_hyphen_values = true)]
    pub(crate) duration_ms: Option<f64>,

    /// Pixels that truth is made for, spread over the picture; `all` for all [default: 400].
    #[arg(long, value_name = "N|all", value_parser = truth_pixels, allow_hyphen_values = true)]
    pub(crate) pixels: Option<PixelChoice>,

    /// Sampled instants per second [default: 250,500,1000,2000,4000].
    #[arg(long, value_name = "HZ,…", value_parser = rate_hz, value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) rates: Vec<f64>,

    /// Triggers; the first is measured with every number of samples, the others with the largest
    /// [default: crossing,light,latch].
    #[arg(long, value_enum, value_name = "T,…", value_delimiter = ',')]
    pub(crate) triggers: Vec<VariantArg>,

    /// Rise of log intensity that fires an ON event [default: 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: 0.2].
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true)]
    pub(crate) threshold_off: Option<f32>,
}

/// `info`.
#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// A recording, or a file of events of any format that is read.
    pub(crate) input: PathBuf,
    /// The camera, of a file of another program that has several.
    #[arg(long, value_name = "NAME", conflicts_with = "repair")]
    pub(crate) camera: Option<String>,
    /// Make a file that was cut off readable for every reader, keeping what it holds.
    #[arg(long)]
    pub(crate) repair: bool,
    /// Read everything that the file holds, and name what is damaged.
    #[arg(long, conflicts_with = "repair")]
    pub(crate) check: bool,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `score`.
#[derive(Debug, Args)]
pub(crate) struct ScoreArgs {
    /// The recording to score.
    pub(crate) events: PathBuf,
    /// A truth file, or a recording that is taken as truth.
    #[arg(long, value_name = "TRUTH.h5")]
    pub(crate) truth: PathBuf,
    /// Camera to score [default: the only one, or the truth's].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,
    /// Tolerance of a match in microseconds, 1 to 1000000; several separated by commas [default: 1000,300,100].
    #[arg(long, value_name = "US", value_delimiter = ',', value_parser = tolerance_us, allow_hyphen_values = true)]
    pub(crate) tolerance_us: Vec<i64>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `calibrate`.
#[derive(Debug, Args)]
pub(crate) struct CalibrateArgs {
    /// A recording (.h5, .npz, .npy) of a still scene; or several of flickering light, one per --stimulus.
    #[arg(required = true)]
    pub(crate) recordings: Vec<PathBuf>,

    /// Light of the recording was mean (1 + CONTRAST sin(2 pi HZ t)) on all pixels; once per recording.
    #[arg(long, value_name = "HZ,CONTRAST", value_parser = stimulus)]
    pub(crate) stimulus: Vec<Stimulus>,

    /// The TOML file to write the sensor to.
    #[arg(short, long, value_name = "SENSOR.toml")]
    pub(crate) output: Option<PathBuf>,

    /// The sensor that has what the recording does not tell: a preset or a TOML file [default: ideal].
    #[arg(long, value_name = "PRESET|FILE")]
    pub(crate) base: Option<String>,

    /// The camera [default: the only one].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,

    /// Seconds after the recording's start from which it is used [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Seconds to use [default: all].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// Seed of the simulations that a fit is corrected by [default: 0].
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true)]
    pub(crate) seed: Option<u64>,

    /// Overwrite the output if it exists.
    #[arg(long)]
    pub(crate) force: bool,

    /// Print the result as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `compare`.
#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// A recording (.h5, .npz, .npy).
    pub(crate) a: PathBuf,

    /// Another one.
    pub(crate) b: PathBuf,

    /// Draw the figure to this file, .png or .svg.
    #[arg(short, long, value_name = "FIGURE")]
    pub(crate) output: Option<PathBuf>,

    /// The camera of both [default: the only one].
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,

    /// Seconds after each recording's start from which it is used [default: 0].
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<f64>,

    /// Seconds of each to use; figures that depend on length are compared best over the same [default: all].
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true)]
    pub(crate) duration: Option<f64>,

    /// Print the statistics as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// `scenes`, `devices`.
#[derive(Debug, Args)]
pub(crate) struct ListArgs {
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodArg {
    /// Instants are rendered.
    Native,
    /// Surfaces are followed in continuous time, on the CPU; each pixel is evaluated at its own times.
    Decoupled,
    /// Keyframes are rendered; what lies between is splatted from both.
    Splat,
    /// As the EVIS paper publishes it: linear motion, colours, latch, black holes.
    EvisPaper,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum QualityArg {
    /// A sample per pixel of motion, 16 coverage samples.
    Draft,
    /// A sample per half pixel of motion, 16 coverage samples.
    Standard,
    /// A sample per 0.3 pixels of motion, 144 coverage samples, shadow rays where the scene allows them.
    High,
    /// A sample per 0.15 pixels of motion, 256 coverage samples, shadow rays where the scene allows them.
    Reference,
}

impl From<QualityArg> for Quality {
    fn from(quality: QualityArg) -> Self {
        match quality {
            QualityArg::Draft => Self::Draft,
            QualityArg::Standard => Self::Standard,
            QualityArg::High => Self::High,
            QualityArg::Reference => Self::Reference,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum TriggerArg {
    /// Every threshold crossing, at its own time.
    Crossing,
    /// At most one event per pixel and sample, at the sample's time.
    Latch,
    /// Every crossing between two samples, counted from the first of them.
    Difference,
}

impl From<TriggerArg> for TriggerRule {
    fn from(arg: TriggerArg) -> Self {
        match arg {
            TriggerArg::Crossing => Self::Crossing,
            TriggerArg::Latch => Self::Latch,
            TriggerArg::Difference => Self::Difference,
        }
    }
}

/// Triggers that `verify` knows.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum VariantArg {
    /// Every crossing, by linear interpolation of log luminance.
    Crossing,
    /// At most one event per pixel and sample, at the sample's time.
    Latch,
}

impl From<VariantArg> for Variant {
    fn from(arg: VariantArg) -> Self {
        match arg {
            VariantArg::Crossing => Self::Crossing,
            VariantArg::Latch => Self::Latch,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum AntialiasArg {
    /// Visibility and shading at every sample.
    Samples,
    /// Visibility at every sample, shading at one in four.
    Edges,
}

impl From<AntialiasArg> for Antialias {
    fn from(arg: AntialiasArg) -> Self {
        match arg {
            AntialiasArg::Samples => Self::Samples,
            AntialiasArg::Edges => Self::Edges,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum BetweenArg {
    /// Straight.
    Line,
    /// Along a cubic that also goes by the sample before and the one after.
    Curve,
}

impl From<BetweenArg> for Between {
    fn from(arg: BetweenArg) -> Self {
        match arg {
            BetweenArg::Line => Self::Line,
            BetweenArg::Curve => Self::Curve,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ShadowsArg {
    /// By maps fitted to the world.
    Maps,
    /// By rays along their borders.
    Rays,
}

impl From<ShadowsArg> for Shadows {
    fn from(arg: ShadowsArg) -> Self {
        match arg {
            ShadowsArg::Maps => Self::Maps,
            ShadowsArg::Rays => Self::Rays,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum LatticeArg {
    /// One family of samples.
    First,
    /// Another one, independent of it.
    Second,
}

impl From<LatticeArg> for Lattice {
    fn from(arg: LatticeArg) -> Self {
        match arg {
            LatticeArg::First => Self::First,
            LatticeArg::Second => Self::Second,
        }
    }
}

/// Tolerances that scores are made for.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ToleranceArg {
    /// 0.1 ms, or 0.01 px of motion.
    #[value(name = "100us")]
    Us100,
    /// 0.3 ms, or 0.03 px of motion.
    #[value(name = "300us")]
    Us300,
    /// 1 ms, or 0.1 px of motion.
    #[value(name = "1ms")]
    Ms1,
}

impl ToleranceArg {
    /// In microseconds.
    pub(crate) const fn micros(self) -> i64 {
        match self {
            Self::Us100 => 100,
            Self::Us300 => 300,
            Self::Ms1 => 1000,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LabelArg {
    /// Planar depth in metres.
    Depth,
    /// Optical flow, forward and backward, with masks.
    Flow,
    /// Instance ids.
    Instance,
    /// Semantic ids.
    Semantic,
    /// Surface normals in world axes.
    Normal,
    /// Linear RGB frames.
    Hdr,
    /// Why each event fired: signal, leak, shot noise or hot pixel; a column beside the events.
    Cause,
}

impl LabelArg {
    /// The label images that this word stands for.
    pub(crate) const fn kinds(self) -> &'static [LabelKind] {
        match self {
            Self::Depth => &[LabelKind::Depth],
            Self::Flow => &[
                LabelKind::FlowForward,
                LabelKind::FlowForwardValid,
                LabelKind::FlowBackward,
                LabelKind::FlowBackwardValid,
            ],
            Self::Instance => &[LabelKind::Instance],
            Self::Semantic => &[LabelKind::Semantic],
            Self::Normal => &[LabelKind::Normal],
            Self::Hdr => &[LabelKind::Hdr],
            Self::Cause => &[LabelKind::Cause],
        }
    }
}

/// Kinds of `labels` in file order, each once.
pub(crate) fn label_kinds(labels: &[LabelArg]) -> Vec<LabelKind> {
    let all = LabelKind::ALL.into_iter().chain([LabelKind::Cause]);
    all.filter(|kind| labels.iter().any(|l| l.kinds().contains(kind))).collect()
}

/// Background of the event picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Background {
    /// White; for paper.
    Light,
    /// Near black; for screens and slides.
    Dark,
}

/// Whole-number enlargement or reduction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    Up(u32),
    Down(u32),
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|v| v.is_finite())
}

/// A number that `fits`; the message completes "invalid value 'X' for '--flag <V>': ".
fn checked(text: &str, remedy: &str, fits: impl Fn(f64) -> bool) -> Result<f64, String> {
    number(text).filter(|v| fits(*v)).ok_or_else(|| format!("it must be {remedy}"))
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    checked(text, "a number of seconds above 0 (at least 0.000001, at most 2678400), such as 0.5", |v| {
        (1.0e-6..=MAX_SECONDS).contains(&v)
    })
}

fn start_seconds(text: &str) -> Result<f64, String> {
    checked(text, "a number of seconds from 0 to 2678400, such as 0.5", |v| (0.0..=MAX_SECONDS).contains(&v))
}

fn speed(text: &str) -> Result<f64, String> {
    checked(text, "a factor from 0.000001 to 1000000, such as 0.25", |v| (1e-6..=1e6).contains(&v))
}

fn rate_hz(text: &str) -> Result<f64, String> {
    checked(text, "a number of Hz above 0 and at most 1000000, such as 1000", |v| v > 0.0 && v <= 1.0e6)
}

fn threshold(text: &str) -> Result<f32, String> {
    checked(text, "a number of log units, at least 0.001 and at most 100, such as 0.2", |v| {
        // Compared as f32: that is what the sensor sees.
        (1.0e-3_f32..=100.0).contains(&(v as f32))
    })
    .map(|v| v as f32)
}

fn positive(text: &str) -> Result<f32, String> {
    checked(text, "a finite number above 0, such as 0.001", |v| (v as f32).is_finite() && v as f32 > 0.0)
        .map(|v| v as f32)
}

fn window_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds from 0.001 to 1000000, such as 20", |v| {
        (1.0e-3..=1.0e6).contains(&v)
    })
}

fn start_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds from 0 to 2678400000, such as 40", |v| {
        (0.0..=MAX_SECONDS * 1.0e3).contains(&v)
    })
}

fn duration_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds from 0.001 to 1000000, such as 100", |v| {
        (1.0e-3..=1.0e6).contains(&v)
    })
}

fn fps(text: &str) -> Result<f64, String> {
    checked(text, "a number of frames per second from 0.1 to 1000, such as 30", |v| {
        (0.1..=1000.0).contains(&v)
    })
}

fn slow(text: &str) -> Result<f64, String> {
    checked(text, "a factor from 0.001 to 100000, such as 4", |v| (1.0e-3..=1.0e5).contains(&v))
}

fn budget_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds above 0, such as 1000", |v| v > 0.0)
}

fn render_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds from 0 to 1000000, such as 10", |v| (0.0..=1.0e6).contains(&v))
}

fn f1_share(text: &str) -> Result<f64, String> {
    checked(text, "above 0 and at most 1, such as 0.98", |v| v > 0.0 && v <= 1.0)
}

fn repetitions(text: &str) -> Result<usize, String> {
    text.trim()
        .parse::<usize>()
        .ok()
        .filter(|n| (1..=1000).contains(n))
        .ok_or_else(|| "it must be a whole number from 1 to 1000, such as 3".into())
}

fn truth_pixels(text: &str) -> Result<PixelChoice, String> {
    let count = || text.trim().parse::<usize>().ok().filter(|n| *n >= 1).map(PixelChoice::Count);
    if text.trim() == "all" { Some(PixelChoice::All) } else { count() }
        .ok_or_else(|| "it must be a whole number above 0, such as 1000, or the word all".into())
}

fn crop(text: &str) -> Result<PixelChoice, String> {
    let numbers: Option<Vec<u32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, width, height]) if width > 0 && height > 0 => {
            Ok(PixelChoice::Crop { x, y, width, height })
        }
        _ => Err(
            "it must be four whole numbers, first column, first row, columns and rows, such as 40,30,80,60"
                .into(),
        ),
    }
}

fn sample_count(text: &str) -> Result<u32, String> {
    text.trim()
        .parse::<u32>()
        .ok()
        .filter(|n| (1..=256).contains(n))
        .ok_or_else(|| "it must be a whole number from 1 to 256, such as 4".into())
}

fn whole(text: &str, low: u32, high: u32, example: u32) -> Result<u32, String> {
    text.trim()
        .parse::<u32>()
        .ok()
        .filter(|n| (low..=high).contains(n))
        .ok_or_else(|| format!("it must be a whole number from {low} to {high}, such as {example}"))
}

fn texture_taps(text: &str) -> Result<u32, String> {
    whole(text, 1, 16, 4)
}

fn shadow_map(text: &str) -> Result<u32, String> {
    whole(text, 64, 16_384, 2048)
}

fn step_count(text: &str) -> Result<u32, String> {
    whole(text, 1, 1000, 8)
}

fn margin_pixels(text: &str) -> Result<u32, String> {
    whole(text, 0, 512, 32)
}

/// Up to `i64::MAX`: the settings are stored as TOML, whose integers are signed.
fn seed(text: &str) -> Result<u64, String> {
    text.trim()
        .parse::<u64>()
        .ok()
        .filter(|n| i64::try_from(*n).is_ok())
        .ok_or_else(|| "it must be a whole number from 0 to 9223372036854775807".into())
}

fn tolerance_us(text: &str) -> Result<i64, String> {
    text.trim()
        .parse::<i64>()
        .ok()
        .filter(|us| (1..=MAX_TOLERANCE_US).contains(us))
        .ok_or_else(|| format!("it must be a whole number from 1 to {MAX_TOLERANCE_US}, such as 1000"))
}

fn stimulus(text: &str) -> Result<Stimulus, String> {
    let numbers = text.split_once(',').and_then(|(hz, contrast)| Some((number(hz)?, number(contrast)?)));
    let (hz, contrast) = numbers.ok_or("it must be HZ,CONTRAST, such as 10,0.5")?;
    Stimulus::new(hz, contrast).map_err(|error| error.to_string())
}

fn transfer(text: &str) -> Result<Transfer, String> {
    evis_video::transfer(text.trim()).map_err(|error| format!("it must be {}", error.remedy))
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let side = |s: &str| s.trim().parse::<u32>().ok().filter(|n| (1..=MAX_SIZE).contains(n));
    text.split_once(['x', 'X', '×'])
        .and_then(|(width, height)| Some((side(width)?, side(height)?)))
        .ok_or_else(|| {
            format!("it must be WIDTHxHEIGHT in pixels, each from 1 to {MAX_SIZE}, such as 640x480")
        })
}

fn scale(text: &str) -> Result<Scale, String> {
    let factor = |s: &str| s.trim().parse::<u32>().ok().filter(|n| (1..=16).contains(n));
    match text.split_once('/') {
        Some((one, n)) if one.trim() == "1" => factor(n).map(Scale::Down),
        Some(_) => None,
        None if text.trim() == "0.5" => Some(Scale::Down(2)),
        None if text.trim() == "0.25" => Some(Scale::Down(4)),
        None => factor(text).map(Scale::Up),
    }
    .ok_or_else(|| "it must be a whole number from 1 to 16, or 1/2 to 1/16".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn values_are_checked_at_the_door() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        for bad in ["640", "0x480", "640x0", "640x-1", "9000x9", "axb", "640x480x3", ""] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert_eq!(positive_seconds("0.25"), Ok(0.25));
        for bad in ["0", "-1", "nan", "inf", "1e99", "1s", "1e-9"] {
            assert!(positive_seconds(bad).is_err(), "{bad}");
        }
        assert_eq!(threshold("0.001"), Ok(0.001));
        for bad in ["0", "-0.2", "nan", "1e-9"] {
            assert!(threshold(bad).is_err(), "{bad}");
        }
        assert!(seed("18446744073709551615").is_err() && seed("-1").is_err() && seed("7") == Ok(7));
        assert_eq!(
            (scale("2"), scale("1/4"), scale("0.5")),
            (Ok(Scale::Up(2)), Ok(Scale::Down(4)), Ok(Scale::Down(2)))
        );
        assert!(scale("0").is_err() && scale("2/3").is_err() && scale("1/0").is_err());
    }

    #[test]
    fn flow_means_both_directions_and_their_masks() {
        assert_eq!(label_kinds(&[]), []);
        assert_eq!(
            label_kinds(&[LabelArg::Hdr, LabelArg::Flow, LabelArg::Hdr]),
            [
                LabelKind::FlowForward,
                LabelKind::FlowForwardValid,
                LabelKind::FlowBackward,
                LabelKind::FlowBackwardValid,
                LabelKind::Hdr
            ]
        );
    }
}
