//! `run`.

use std::path::PathBuf;

use clap::Args;
use evis_core::TriggerRule;
use evis_render::{Antialias, Compute, Method, Quality, Shadows};

use super::camera::{AnimationArgs, CameraArgs};
use super::choices::{labels, words};
use super::values::{
    imu_noise, margin_pixels, positive, positive_seconds, rate_hz, sample_count, seed, shadow_map, size,
    speed, start_seconds, step_count, texture_taps, threshold, window_ms,
};

/// `run`.
#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    /// A built-in scene, a .toml, .gltf or .glb file, or a still picture.
    ///
    /// `scenes` lists the built-in scenes. Pictures: .png, .jpg, .hdr, .exr, .tif.
    pub(crate) scene: String,

    #[command(flatten)]
    pub(crate) animation: AnimationArgs,

    #[command(flatten)]
    pub(crate) camera_motion: CameraArgs,

    /// A camera to render; repeat for several [default: all]
    #[arg(long, value_name = "NAME", help_heading = "Scene")]
    pub(crate) camera: Vec<String>,

    /// Pixels of every camera [default: the camera's own, else 640x480]
    ///
    /// A camera with an aspect but no size gets its aspect at 480 lines.
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) size: Option<(u32, u32)>,

    /// Seconds to simulate [default: what is left of the scene, else 1]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) duration: Option<f64>,

    /// Scene time in seconds at which the stream starts [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) start: Option<f64>,

    /// How fast everything in the scene moves and changes [default: 1]
    ///
    /// 0.25 is a quarter of the speed that the scene has.
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) speed: Option<f64>,

    /// The HDF5 file to write; refused if it exists
    ///
    /// Several environments give one file each: OUT_0000.h5, OUT_0001.h5, …
    #[arg(short, long, value_name = "OUT.h5", help_heading = "Output")]
    pub(crate) output: PathBuf,

    /// Overwrite existing output
    #[arg(long, help_heading = "Output")]
    pub(crate) force: bool,

    /// Write a report as JSON; refused if the file exists, unless --force is given
    ///
    /// Settings, device, counts, rates, milliseconds per stage, warnings.
    #[arg(long, value_name = "R.json", help_heading = "Output", hide_short_help = true)]
    pub(crate) report: Option<PathBuf>,

    /// Print the report as JSON on standard output instead of a summary
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(crate) json: bool,

    /// Write where the time goes as a trace, which ui.perfetto.dev opens
    ///
    /// A span per pass and step of the program, in Chrome's format; on devices with timestamps, when each pass ran there.
    #[arg(long, value_name = "T.json", help_heading = "Output", hide_short_help = true)]
    pub(crate) trace: Option<PathBuf>,

    /// Print device, method, views and milliseconds per stage too
    #[arg(long, short, help_heading = "Output", hide_short_help = true)]
    pub(crate) verbose: bool,

    /// Frames per second to write beside the events [default: none]
    ///
    /// A frame is mean linear light over an exposure.
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Output", hide_short_help = true)]
    pub(crate) frame_rate: Option<f64>,

    /// Exposure of those frames in milliseconds [default: 10, or the time between two]
    ///
    /// At most the time between two frames; rounded down to an even number of microseconds. The default is the time between two
    /// frames where that is shorter than 10 ms.
    #[arg(long, value_name = "MS", value_parser = window_ms, allow_hyphen_values = true, help_heading = "Output", hide_short_help = true)]
    pub(crate) exposure_ms: Option<f64>,

    /// Labels: depth,flow,instance,normal,hdr,... [default: none]
    ///
    /// flow means forward and backward, with their masks.
    #[arg(long, value_parser = labels(), value_delimiter = ',', value_name = "KINDS", help_heading = "Labels")]
    pub(crate) labels: Vec<String>,

    /// Label images and camera poses per second [default: 50]
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Labels")]
    pub(crate) label_rate: Option<f64>,

    /// Poses and velocities of objects and cameras per second [default: none]
    ///
    /// They go to the group `bodies`, up to the end of the stream; names, ids and boxes of objects are there in any case.
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Labels", hide_short_help = true)]
    pub(crate) pose_rate: Option<f64>,

    #[command(flatten)]
    pub(crate) imu: ImuArgs,

    /// Preset (see `sensors`) or TOML file [default: the scene's, or ideal]
    ///
    /// CAMERA=PRESET or CAMERA=FILE is for one camera; repeat it for another. The flags below override it.
    #[arg(long, value_name = "SENSOR", help_heading = "Sensor")]
    pub(crate) sensor: Vec<String>,

    /// A value of the sensor, such as noise.shot_hz=1; repeat for several
    ///
    /// docs/sensor-keys.md lists the keys. It stands over the preset, the file or the scene.
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Sensor")]
    pub(crate) set: Vec<String>,

    /// Rise of log intensity that fires an ON event [default: 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_on: Option<f32>,

    /// Fall of log intensity that fires an OFF event, a magnitude [default: 0.2]
    #[arg(long, value_name = "C", value_parser = threshold, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) threshold_off: Option<f32>,

    /// eps in ln(Y / Y_ref + eps) [default: 0.001; 0.00001 for evis-paper]
    #[arg(long, value_name = "E", value_parser = positive, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) log_eps: Option<f32>,

    /// Y_ref in ln(Y / Y_ref + eps) [default: from the first picture]
    ///
    /// The default brings the first camera's log-mean at the start to 0.18.
    #[arg(long, value_name = "Y", value_parser = positive, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) reference_luminance: Option<f32>,

    /// How a change of brightness becomes events [default: the sensor's]
    ///
    /// Without a sensor: crossing, or latch for evis-paper.
    #[arg(long, value_parser = words::<TriggerRule>(), value_name = "RULE", help_heading = "Sensor", hide_short_help = true)]
    pub(crate) trigger: Option<TriggerRule>,

    /// Seed of everything random [default: 0]
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, help_heading = "Sensor")]
    pub(crate) seed: Option<u64>,

    /// draft, standard, high or reference [default: standard]
    ///
    /// Fixed settings of sampling, the same for every scene. standard is in force unless sampling is set by hand.
    #[arg(long, value_parser = words::<Quality>(), value_name = "PRESET", help_heading = "Quality")]
    pub(crate) quality: Option<Quality>,

    /// Settings from `tune` or of a recording; options override them
    #[arg(long, value_name = "FILE", help_heading = "Quality")]
    pub(crate) settings: Option<PathBuf>,

    /// How instants are sampled [default: native]
    #[arg(long, value_parser = words::<Method>(), value_name = "METHOD", help_heading = "Quality", hide_short_help = true)]
    pub(crate) method: Option<Method>,

    /// Sampled instants per second, for --method native [default: 1000]
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) rate: Option<f64>,

    /// Pixels that anything may move between two samples [default: no limit]
    ///
    /// For --method native: each part of the picture is rendered only as often as it moves by so many pixels, and at --rate at
    /// most. For --method decoupled: the length of a pixel's intervals.
    #[arg(
        long,
        value_name = "PX",
        allow_hyphen_values = true,
        help_heading = "Quality",
        hide_short_help = true
    )]
    pub(crate) adaptive: Option<f64>,

    /// Samples per pixel and instant, 1 to 256 [default: 4]
    #[arg(long, value_name = "N", value_parser = sample_count, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) samples: Option<u32>,

    /// How a pixel's area is sampled [default: samples]
    ///
    /// edges takes --samples 4, 16, 36, 64, ...: they lie on a grid.
    #[arg(long, value_parser = words::<Antialias>(), value_name = "HOW", help_heading = "Quality", hide_short_help = true)]
    pub(crate) antialias: Option<Antialias>,

    /// Places at which a sample reads a texture, along each side, 1 to 16 [default: 2 to 4]
    ///
    /// At most so many, along each side of the sample's share of the pixel. The default is 2 up to 8 samples, 3 up to 15, then 4.
    #[arg(long, value_name = "N", value_parser = texture_taps, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) texture_taps: Option<u32>,

    /// Where decoupled sampling evaluates pixels [default: cpu]
    ///
    /// gpu: by compute passes; tiles that they cannot show and stages of sensors that take frames stay on the processor. Not
    /// measured on a graphics card yet.
    #[arg(long, value_parser = words::<Compute>(), value_name = "WHERE", help_heading = "Quality", hide_short_help = true)]
    pub(crate) compute: Option<Compute>,

    /// How shadows are found [default: the preset's; maps without one]
    #[arg(long, value_parser = words::<Shadows>(), value_name = "HOW", help_heading = "Quality", hide_short_help = true)]
    pub(crate) shadows: Option<Shadows>,

    /// Texels of a shadow map's edge, 64 to 16384 [default: by the picture's size]
    ///
    /// The default is about 12.8 times the picture's edge, 1024 to 8192; 2048 at most where a light that throws shadows moves.
    #[arg(long, value_name = "TEXELS", value_parser = shadow_map, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) shadow_map: Option<u32>,

    /// Share of the skipped tiles that are rendered once more to check [default: 0.005]
    ///
    /// Tiles that are skipped or sampled less often are compared with what they would have been. No event depends on it; 0 turns
    /// it off.
    #[arg(
        long,
        value_name = "SHARE",
        allow_hyphen_values = true,
        help_heading = "Quality",
        hide_short_help = true
    )]
    pub(crate) audit: Option<f64>,

    #[command(flatten)]
    pub(crate) splat: SplatArgs,

    /// Index or part of a name (see `devices`) [default: the fastest]
    #[arg(long, value_name = "DEVICE", help_heading = "Device")]
    pub(crate) device: Option<String>,
}

/// Inertial measurement units.
#[derive(Debug, Args)]
pub(crate) struct ImuArgs {
    /// An inertial measurement unit on this camera or node; repeat for several [default: none]
    ///
    /// Specific force and angular rate go to the group `imus`, in the axes of its node, which has x right, y up and z back for a
    /// camera.
    #[arg(long, value_name = "NAME", help_heading = "Labels", hide_short_help = true)]
    pub(crate) imu: Vec<String>,

    /// Samples per second of those units [default: 200]
    #[arg(long, value_name = "HZ", requires = "imu", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Labels", hide_short_help = true)]
    pub(crate) imu_rate: Option<f64>,

    /// Noise of those units, such as gyroscope_noise_density=1.7e-4; repeat for several [default: none]
    ///
    /// Names and units are those of Kalibr's imu.yaml: accelerometer_noise_density (m/s^2/sqrt(Hz)), accelerometer_random_walk
    /// (m/s^3/sqrt(Hz)), gyroscope_noise_density (rad/s/sqrt(Hz)), gyroscope_random_walk (rad/s^2/sqrt(Hz)). The seed is --seed.
    #[arg(long, value_name = "KEY=VALUE", requires = "imu", value_parser = imu_noise, help_heading = "Labels", hide_short_help = true)]
    pub(crate) imu_noise: Vec<(usize, f64)>,
}

/// Options of methods with keyframes; the defaults named are those of `splat`.
#[derive(Debug, Args)]
pub(crate) struct SplatArgs {
    /// With --method splat or evis-paper: keyframes per second [default: 125]
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) keyframe_rate: Option<f64>,

    /// With --method splat or evis-paper: instants per gap, 1 to 1000 [default: 8]
    #[arg(long, value_name = "N", value_parser = step_count, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) steps: Option<u32>,

    /// With --method splat or evis-paper: pixels beyond each border, 0 to 512 [default: 32]
    #[arg(long, value_name = "PX", value_parser = margin_pixels, allow_hyphen_values = true, help_heading = "Quality", hide_short_help = true)]
    pub(crate) margin: Option<u32>,
}
