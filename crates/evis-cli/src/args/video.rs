//! `video`.

use std::path::PathBuf;

use clap::Args;
use evis_core::Transfer;

use super::values::{positive, positive_seconds, rate_hz, seed, size, start_seconds, transfer};

/// Presets of converters that take the stored values of a film for light.
const LIKE: [&str; 9] =
    ["v2e", "v2e-clean", "v2e-noisy", "esim", "openeb", "pix2nvs", "carla", "davis346", "davis240"];

/// The path of a network. What stands behind the option by mistake is the input.
fn network(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(ending) if ending.eq_ignore_ascii_case("onnx") => Ok(path),
        _ => Err("it must be a network, .onnx; without one, put --upsample behind the input".into()),
    }
}

/// `video`.
#[derive(Debug, Args)]
pub(crate) struct VideoArgs {
    /// A film that ffmpeg plays, a folder of PNG, EXR or TIFF pictures, or a .npy stack (T, H, W[, 3]).
    pub(crate) input: PathBuf,

    /// File to write, .h5 for a recording; repeat for other formats; refused if it exists
    ///
    /// .raw (EVT 3.0), .dat, .aedat4, .aedat, .txt, .zip, .npz, .npy, .mcap and .es hold the events of the recording.
    #[arg(short, long, value_name = "OUT", required = true, help_heading = "Output")]
    pub(crate) output: Vec<PathBuf>,

    /// A preset (`sensors` lists them) or a TOML file [default: ideal]
    #[arg(long, value_name = "PRESET|FILE", help_heading = "Sensor")]
    pub(crate) sensor: Option<String>,

    /// As another converter has it: its preset, and --transfer linear
    ///
    /// These tools take stored values for light, which gives fewer events (docs/video.md says how many).
    #[arg(long, value_name = "PRESET", value_parser = LIKE, conflicts_with_all = ["sensor", "transfer"], help_heading = "Sensor")]
    pub(crate) like: Option<String>,

    /// A value of the sensor, such as noise.shot_hz=1; repeat for several
    ///
    /// docs/sensor-keys.md lists the keys. It stands over the preset or the file.
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Sensor")]
    pub(crate) set: Vec<String>,

    /// Seed of everything random [default: 0]
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, help_heading = "Sensor")]
    pub(crate) seed: Option<u64>,

    /// Curve from stored values to light: srgb, rec709, gamma:G, linear
    ///
    /// linear imitates v2e, vid2e and OpenEB; --like sets it with their preset.
    /// [default: rec709 for films, else srgb; 32-bit floats are light already]
    #[arg(long, value_name = "CURVE", value_parser = transfer, help_heading = "Input")]
    pub(crate) transfer: Option<Transfer>,

    /// Frames per second, whatever the input says [default: its own times]
    ///
    /// A film has times of its own, a folder has them in its timestamps.txt.
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true, conflicts_with = "timestamps", help_heading = "Input")]
    pub(crate) fps: Option<f64>,

    /// A text file of times, one per frame and line, in seconds
    ///
    /// Below a line `# unit: us` (s, ms, ns) that unit.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub(crate) timestamps: Option<PathBuf>,

    /// Pixels of the sensor [default: the frames' own]
    ///
    /// Frames are averaged to it in linear light.
    #[arg(long, value_name = "WxH", value_parser = size, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) size: Option<(u32, u32)>,

    /// Seconds after the first frame to start at [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) start: Option<f64>,

    /// Seconds to convert [default: all]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) duration: Option<f64>,

    /// Put frames between frames, by optical flow or by a network (.onnx)
    ///
    /// As many as it takes until nearly nothing moves by more than a pixel per frame. The network takes two frames, and a time
    /// between 0 and 1 or none, and gives the frame between (docs/video.md). Needs the Python package.
    #[arg(long, value_name = "MODEL.onnx", num_args = 0..=1, value_parser = network, help_heading = "Input")]
    pub(crate) upsample: Option<Option<PathBuf>>,

    /// Y_ref in ln(Y / Y_ref + eps); white of integer frames is 1 [default: 1]
    #[arg(long, value_name = "Y", value_parser = positive, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) reference_luminance: Option<f32>,

    /// Overwrite the output if it exists
    #[arg(long, help_heading = "Output")]
    pub(crate) force: bool,

    /// Write the report as JSON to this file too. Refused if it exists, unless --force is given
    #[arg(long, value_name = "FILE", help_heading = "Output", hide_short_help = true)]
    pub(crate) report: Option<PathBuf>,

    /// Print the report as JSON
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(crate) json: bool,

    /// Write where the time goes as a trace, which ui.perfetto.dev opens
    #[arg(long, value_name = "T.json", help_heading = "Output", hide_short_help = true)]
    pub(crate) trace: Option<PathBuf>,
}

/// `from-v2e`.
#[derive(Debug, Args)]
pub(crate) struct FromV2eArgs {
    /// v2e's own command line, behind --
    #[arg(last = true, required = true, num_args = 1.., allow_hyphen_values = true)]
    pub(crate) line: Vec<String>,
}
