//! `convert`.

use std::path::PathBuf;

use clap::Args;
use evis_format::Format;

/// `convert`.
#[derive(Debug, Args)]
pub(crate) struct ConvertArgs {
    /// A file of events of any format that is read, or a folder in DSEC's layout; its content tells which.
    pub(crate) input: PathBuf,

    /// The file to write: .raw (EVT 3.0), .dat, .aedat4, .aedat, .txt, .zip, .npz, .npy, .h5, .mcap or .es.
    pub(crate) output: PathBuf,

    /// The format of the output, where its name does not tell
    ///
    /// evt3, evt2, dat, aedat4, aedat2, text, text-zip, npz, npy, hdf5, mcap, es, dsec (a folder). Of a whole recording of EVIS, mcap
    /// and dsec hold labels and calibration too; of a part of it, as of other files, events alone.
    #[arg(long, value_name = "FORMAT", value_parser = format, help_heading = "Output")]
    pub(crate) format: Option<Format>,

    /// The camera, where the input has several
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    pub(crate) camera: Option<String>,

    /// Of a damaged input, write what comes before the damage
    #[arg(long, help_heading = "Input")]
    pub(crate) until_damage: bool,

    /// The sensor's size, where the input does not say
    ///
    /// [default: the smallest that holds all events]
    #[arg(long, value_name = "WxH", value_parser = size, help_heading = "Input")]
    pub(crate) size: Option<(u32, u32)>,

    /// Keep events from this second on
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true, help_heading = "Events")]
    pub(crate) start: Option<i64>,

    /// Keep events before this second
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true, help_heading = "Events")]
    pub(crate) end: Option<i64>,

    /// Count times from --start, or from the first event where there is none
    #[arg(long, help_heading = "Events")]
    pub(crate) rebase: bool,

    /// Move events and frames to where a lens without distortion shows them
    ///
    /// Before the crop. The picture keeps its size, focal lengths and principal point; what leaves it is lost. The lens is that of a
    /// recording of EVIS, or of --calibration.
    #[arg(long, help_heading = "Events")]
    pub(crate) undistort: bool,

    /// The lens for --undistort: Kalibr's camchain.yaml or DSEC's cam_to_cam.yaml
    #[arg(
        long,
        value_name = "FILE",
        requires = "undistort",
        help_heading = "Events",
        hide_short_help = true
    )]
    pub(crate) calibration: Option<PathBuf>,

    /// The camera in --calibration, where it has several
    #[arg(
        long,
        value_name = "NAME",
        requires = "calibration",
        help_heading = "Events",
        hide_short_help = true
    )]
    pub(crate) calibration_camera: Option<String>,

    /// Keep a part of the sensor: left column, top row, width, height
    #[arg(long, value_name = "X,Y,W,H", value_parser = crop, help_heading = "Events")]
    pub(crate) crop: Option<[u32; 4]>,

    /// Mirror the sensor, after the crop: x left and right, y top and bottom, xy both
    #[arg(long, value_name = "x|y|xy", value_parser = ["x", "y", "xy"], help_heading = "Events")]
    pub(crate) flip: Option<String>,

    /// Leave out triggers, frames, inertial samples and labels
    #[arg(long, help_heading = "Events")]
    pub(crate) events_only: bool,

    /// Replace the output if it exists
    #[arg(long, help_heading = "Output")]
    pub(crate) force: bool,

    /// Print JSON
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}

fn format(name: &str) -> Result<Format, String> {
    let names: Vec<_> = Format::ALL.iter().map(|format| format.name()).collect();
    Format::of_name(name).ok_or_else(|| format!("it must be one of {}", names.join(", ")))
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let side = |side: &str| side.parse::<u32>().ok().filter(|side| (1..=1 << 16).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| side(width).zip(side(height)));
    sides.ok_or_else(|| "it must be width x height in pixels, such as 1280x720".into())
}

/// Seconds as microseconds.
fn seconds(text: &str) -> Result<i64, String> {
    let seconds: Option<f64> = text.parse().ok().filter(|s: &f64| s.abs() < 9.0e12);
    seconds.map(|s| (s * 1.0e6).round() as i64).ok_or_else(|| "it must be a number of seconds".into())
}

fn crop(text: &str) -> Result<[u32; 4], String> {
    let numbers: Vec<u32> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    match numbers.as_slice() {
        &[x, y, width, height] if width > 0 && height > 0 && text.split(',').count() == 4 => {
            Ok([x, y, width, height])
        }
        _ => Err("it must be four whole numbers, such as 100,50,640,480".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_numbers_or_say_what_works() {
        assert_eq!(crop("1, 2,3,4"), Ok([1, 2, 3, 4]));
        assert_eq!((size("640x480"), seconds("-1.5")), (Ok((640, 480)), Ok(-1_500_000)));
        assert_eq!(format("evt3"), Ok(Format::Evt3));
        for wrong in [crop("1,2,3").err(), crop("1,2,0,4").err(), size("640").err(), seconds("x").err()] {
            assert!(wrong.is_some_and(|error| error.starts_with("it must be")));
        }
        assert!(format("evt9").is_err_and(|error| error.contains("aedat4")));
    }
}
