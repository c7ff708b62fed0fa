//! Commands on recordings: `info`, `score`, `calibrate`, `compare`.

use std::path::PathBuf;

use clap::Args;
use evis_core::stats::Stimulus;

use super::camera::AnimationArgs;
use super::values::{positive_seconds, seed, start_seconds, stimulus, tolerance_us};

/// `info`.
#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// A recording, a file of events of any format that is read, or a scene: a built-in name, .glb, .gltf or .toml.
    pub(crate) input: PathBuf,
    #[command(flatten)]
    pub(crate) animation: AnimationArgs,
    /// The camera, where the file has several [default: all, of a recording]
    #[arg(long, value_name = "NAME", conflicts_with = "repair", help_heading = "Input")]
    pub(crate) camera: Option<String>,
    /// Make a file that was cut off readable for every reader, keeping what it holds
    #[arg(long, help_heading = "Input")]
    pub(crate) repair: bool,
    /// Read everything that the file holds, and name what is damaged
    #[arg(long, conflicts_with = "repair", help_heading = "Input")]
    pub(crate) check: bool,
    /// Print JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}

/// `score`.
#[derive(Debug, Args)]
pub(crate) struct ScoreArgs {
    /// The recording to score.
    pub(crate) events: PathBuf,
    /// A truth file, or a recording that is taken as truth
    #[arg(long, value_name = "TRUTH.h5", help_heading = "Input")]
    pub(crate) truth: PathBuf,
    /// Camera to score [default: the only one, or the truth's]
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    pub(crate) camera: Option<String>,
    /// Tolerances of a match in microseconds, 1 to 1000000 [default: 1000,300,100]
    #[arg(long, value_name = "US", value_delimiter = ',', value_parser = tolerance_us, allow_hyphen_values = true, help_heading = "Score")]
    pub(crate) tolerance_us: Vec<i64>,
    /// Print JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}

/// `calibrate`.
#[derive(Debug, Args)]
pub(crate) struct CalibrateArgs {
    /// A recording (.h5, .npz, .npy) of a still scene; or several of flickering light, one per --stimulus.
    #[arg(required = true)]
    pub(crate) recordings: Vec<PathBuf>,

    /// Light of the recording was mean (1 + CONTRAST sin(2 pi HZ t)); once per recording
    #[arg(long, value_name = "HZ,CONTRAST", value_parser = stimulus, help_heading = "Input")]
    pub(crate) stimulus: Vec<Stimulus>,

    /// The TOML file to write the sensor to
    #[arg(short, long, value_name = "SENSOR.toml", help_heading = "Output")]
    pub(crate) output: Option<PathBuf>,

    /// The sensor that has what the recording does not tell [default: ideal]
    ///
    /// A preset or a TOML file.
    #[arg(long, value_name = "PRESET|FILE", help_heading = "Sensor")]
    pub(crate) base: Option<String>,

    /// The camera [default: the only one]
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    pub(crate) camera: Option<String>,

    /// Seconds after the recording's start from which it is used [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) start: Option<f64>,

    /// Seconds to use [default: all]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) duration: Option<f64>,

    /// Seed of the simulations that a fit is corrected by [default: 0]
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true, help_heading = "Sensor", hide_short_help = true)]
    pub(crate) seed: Option<u64>,

    /// Overwrite the output if it exists
    #[arg(long, help_heading = "Output")]
    pub(crate) force: bool,

    /// Print the result as JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}

/// `compare`.
#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// A recording (.h5, .npz, .npy).
    pub(crate) a: PathBuf,

    /// Another one.
    pub(crate) b: PathBuf,

    /// Draw the figure to this file, .png or .svg
    #[arg(short, long, value_name = "FIGURE", help_heading = "Output")]
    pub(crate) output: Option<PathBuf>,

    /// The camera of both [default: the only one]
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    pub(crate) camera: Option<String>,

    /// Seconds after each recording's start from which it is used [default: 0]
    #[arg(long, value_name = "S", value_parser = start_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) start: Option<f64>,

    /// Seconds of each to use; figures that depend on length are compared best over the same [default: all]
    #[arg(long, value_name = "S", value_parser = positive_seconds, allow_hyphen_values = true, help_heading = "Input")]
    pub(crate) duration: Option<f64>,

    /// Print the statistics as JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}
