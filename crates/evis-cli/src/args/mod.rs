//! The command line as data: what can be checked alone is checked here.

mod camera;
mod chart;
mod choices;
mod convert;
pub(crate) mod help;
mod preview;
mod recording;
mod run;
mod truth;
mod tune;
mod values;
mod verify;
mod video;

use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;

pub(crate) use chart::{ChartArgs, MeasuringArgs};
pub(crate) use choices::Background;
pub(crate) use convert::ConvertArgs;
pub(crate) use preview::PreviewArgs;
pub(crate) use recording::{CalibrateArgs, CompareArgs, InfoArgs, ScoreArgs};
pub(crate) use run::{ImuArgs, RunArgs};
pub(crate) use truth::TruthArgs;
pub(crate) use tune::TuneArgs;
pub(crate) use values::{Scale, to_us};
pub(crate) use verify::VerifyArgs;
pub(crate) use video::{FromV2eArgs, VideoArgs};

/// EVIS: moving 3D scenes in, labelled event streams out.
#[derive(Debug, Parser)]
#[command(
    name = "evis-rs",
    version = env!("EVIS_VERSION"),
    about = "Event-camera simulator: moving 3D scenes in, labelled (t, x, y, p) events out.",
    after_help = "Exit codes: 0 done; 2 bad input (arguments, files, no usable device, no space); \
                  1 failure; 130 interrupted, the file is finished and readable.",
    subcommand_required = true,
    arg_required_else_help = true
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,

    /// Memory that a file may take, such as 8G or 500M [default: 4G]
    ///
    /// Half of the machine's memory where that is less than 4G.
    #[arg(long, global = true, value_name = "SIZE", value_parser = memory_size, help_heading = "Limits", hide_short_help = true)]
    pub(crate) memory_limit: Option<u64>,

    /// Let glTF files refer to files outside of their folder
    #[arg(long, global = true, help_heading = "Limits", hide_short_help = true)]
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
    /// Turn a film, a folder of pictures or an array of frames into a file of events.
    Video(Box<VideoArgs>),
    /// Print the command of `video` that does what a command line of v2e does.
    #[command(name = "from-v2e")]
    FromV2e(FromV2eArgs),
    /// Show a recording as a picture, a GIF or a film (MP4), or a scene as a picture.
    Preview(PreviewArgs),
    /// Measure settings on a scene: draw speed against accuracy, and recommend one.
    Chart(Box<ChartArgs>),
    /// Compute what an ideal sensor fires in a scene, without the engine: exact, and slow.
    Truth(Box<TruthArgs>),
    /// Check that events converge to truth as theory says: on closed forms, or on a scene.
    Verify(Box<VerifyArgs>),
    /// Write a file of events in another format.
    ///
    /// Prophesee RAW and DAT, AEDAT, text, NumPy, HDF5, ROS 2 bags, DSEC.
    Convert(Box<ConvertArgs>),
    /// Show what a recording, a file of events or a scene holds.
    ///
    /// Also checks recordings, and repairs those that were cut off.
    Info(InfoArgs),
    /// Score the events of a recording against truth.
    ///
    /// Matches within a tolerance, time errors, regions.
    Score(ScoreArgs),
    /// Fit a sensor to a recording of a still scene, or to recordings of flickering light.
    Calibrate(CalibrateArgs),
    /// Set two recordings' statistics side by side, as a table and a figure.
    Compare(CompareArgs),
    /// List the built-in scenes.
    Scenes(ListArgs),
    /// List the sensor presets: name, source, what each models.
    Sensors(ListArgs),
    /// List the devices that can run the engine.
    Devices(ListArgs),
    /// Print a script that completes commands and options in a shell.
    Completions(CompletionsArgs),
}

/// `completions`.
#[derive(Debug, Args)]
pub(crate) struct CompletionsArgs {
    /// The shell: bash, zsh, fish, …
    pub(crate) shell: Shell,
}

/// `scenes`, `sensors`, `devices`.
#[derive(Debug, Args)]
pub(crate) struct ListArgs {
    /// Print JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        help::command("evis-rs").debug_assert();
    }
}
