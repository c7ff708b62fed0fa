//! `convert`: event files of one program for another; `info` of files that are no recordings of EVIS.

use std::path::PathBuf;

use clap::Args;
use evis_format::{
    ConvertOptions, EventReader, Extent, Format, FormatError, ReadOptions, WriteOptions, measure, open,
};
use serde::Serialize;

use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::text;

/// `convert`.
#[derive(Debug, Args)]
pub(crate) struct ConvertArgs {
    /// A file of events of any format that is read, or a folder in DSEC's layout; its content tells which.
    pub(crate) input: PathBuf,

    /// The file to write: .raw (EVT 3.0), .dat, .aedat4, .aedat, .txt, .zip, .npz, .npy, .h5, .mcap or .es.
    pub(crate) output: PathBuf,

    /// The format of the output, where its name does not tell: evt3, evt2, dat, aedat4, aedat2, text, text-zip, npz, npy,
    /// hdf5, mcap, es; dsec makes a folder of a recording of EVIS.
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub(crate) format: Option<Format>,

    /// The camera, where the input has several.
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,

    /// The sensor's size, where the input does not say [default: the smallest that holds all events].
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub(crate) size: Option<(u32, u32)>,

    /// Keep events from this second on.
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true)]
    pub(crate) start: Option<i64>,

    /// Keep events before this second.
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true)]
    pub(crate) end: Option<i64>,

    /// Count times from --start, or from the first event where there is none.
    #[arg(long)]
    pub(crate) rebase: bool,

    /// Keep a part of the sensor: its left column, top row, width and height in pixels.
    #[arg(long, value_name = "X,Y,W,H", value_parser = crop)]
    pub(crate) crop: Option<[u32; 4]>,

    /// Mirror the sensor, after the crop: x left and right, y top and bottom, xy both.
    #[arg(long, value_name = "x|y|xy", value_parser = ["x", "y", "xy"])]
    pub(crate) flip: Option<String>,

    /// Leave out triggers, frames and inertial samples.
    #[arg(long)]
    pub(crate) events_only: bool,

    /// Replace the output if it exists.
    #[arg(long)]
    pub(crate) force: bool,

    /// Print JSON.
    #[arg(long)]
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

#[derive(Serialize)]
struct Report {
    input: String,
    output: String,
    input_format: &'static str,
    format: &'static str,
    width: u32,
    height: u32,
    events: u64,
    triggers: u64,
    frames: u64,
    imu: u64,
    interrupted: bool,
}

/// Writes the input in another format.
pub(crate) fn convert(args: &ConvertArgs) -> anyhow::Result<i32> {
    let Some(format) = args.format.or_else(|| Format::of_ending(&args.output)) else {
        let output = args.output.display();
        return Err(bad_input(format!(
            "the name of {output} tells no format; add --format, such as --format evt3"
        )));
    };
    if same_file(args) {
        return Err(bad_input("the output is the input; choose another name"));
    }
    if format == Format::Dsec {
        return export_dsec(args);
    }
    let read = ReadOptions { camera: args.camera.clone(), size: args.size };
    let mut reader = open(&args.input, &read)?;
    let input_format = reader.info().format;
    // What the file itself does not say takes a reading of its own.
    let needs_extent = reader.info().size.is_none() || (args.rebase && args.start.is_none());
    let extent = if needs_extent { Some(measure(&mut *reader)?) } else { None };
    if needs_extent {
        reader = open(&args.input, &read)?;
    }
    let reach = extent.map_or((1, 1), |extent| (extent.reach.0.max(1), extent.reach.1.max(1)));
    let size = reader.info().size.unwrap_or(reach);
    let first_us = extent.and_then(|extent| extent.range).map_or(0, |(first, _)| first);
    let flips = |axis| args.flip.as_ref().is_some_and(|flip| flip.contains(axis));
    let options = ConvertOptions {
        start_us: args.start.unwrap_or(i64::MIN),
        end_us: args.end.unwrap_or(i64::MAX),
        crop: args.crop,
        flip_x: flips('x'),
        flip_y: flips('y'),
        events_only: args.events_only,
        shift_us: if args.rebase { args.start.unwrap_or(first_us).saturating_neg() } else { 0 },
    };
    if !options.fits(size) {
        let (width, height) = size;
        let crop = options.crop.unwrap_or_default().map(|number| number.to_string()).join(",");
        return Err(bad_input(format!("--crop {crop} does not lie within {width}x{height} pixels")));
    }
    let (width, height) = options.size(size);
    let write = WriteOptions { size: (width, height), overwrite: args.force };
    let writer = evis_format::create(&args.output, format, &write)?;
    let interrupt = Interrupt::listen();
    let converted = evis_format::convert(reader, writer, size, &options, |_| !interrupt.asked())?;
    let report = Report {
        input: args.input.display().to_string(),
        output: args.output.display().to_string(),
        input_format: input_format.name(),
        format: format.name(),
        width,
        height,
        events: converted.events,
        triggers: converted.triggers,
        frames: converted.frames,
        imu: converted.imu,
        interrupted: interrupt.asked(),
    };
    if args.json {
        text::say_json(&report)?;
    } else {
        let mut line =
            format!("{}  {format}, {width}x{height}, {} events", report.output, text::grouped(report.events));
        line += &others(report.triggers, report.frames, report.imu);
        text::say(&line);
    }
    Ok(if report.interrupted { EXIT_INTERRUPTED } else { 0 })
}

/// `, 3 triggers, 2 frames`, of what there is.
fn others(triggers: u64, frames: u64, imu: u64) -> String {
    [(triggers, "triggers"), (frames, "frames"), (imu, "inertial samples")]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, name)| format!(", {} {name}", text::grouped(count)))
        .collect()
}

fn same_file(args: &ConvertArgs) -> bool {
    let place = |path: &PathBuf| std::fs::canonicalize(path).ok();
    place(&args.input).is_some_and(|input| place(&args.output) == Some(input))
}

fn export_dsec(args: &ConvertArgs) -> anyhow::Result<i32> {
    let part = args.start.is_some() || args.end.is_some() || args.crop.is_some() || args.flip.is_some();
    if part || args.rebase || args.camera.is_some() {
        return Err(bad_input(
            "--format dsec writes the whole recording; leave --start, --end, --rebase, --crop, --flip and --camera out",
        ));
    }
    let export = evis_format::export_dsec(&args.input, &args.output, args.force)?;
    let cameras: Vec<String> = export.cameras.iter().map(|(own, eye)| format!("{own} as {eye}")).collect();
    let mut lines = vec![format!(
        "{}  DSEC folder, {}, {} events, {} flow images, {} disparity images",
        args.output.display(),
        cameras.join(", "),
        text::grouped(export.events),
        export.flows,
        export.disparities
    )];
    lines.extend(export.notes);
    text::say(&lines.join("\n"));
    Ok(0)
}

#[derive(Serialize)]
struct FileInfo {
    file: String,
    format: &'static str,
    description: &'static str,
    camera: Option<String>,
    cameras: Vec<String>,
    width: Option<u32>,
    height: Option<u32>,
    t_offset_us: i64,
    first_us: Option<i64>,
    last_us: Option<i64>,
    events: u64,
    on: u64,
    triggers: u64,
    frames: u64,
    imu: u64,
    properties: Vec<(String, String)>,
    /// Where the file is damaged, and how; the counts hold up to there.
    damage: Option<String>,
}

/// Whether a file of HDF5 has a layout of another program.
pub(crate) fn reads(path: &std::path::Path) -> bool {
    // A file of several cameras is read once one is chosen.
    match open(path, &ReadOptions::default()) {
        Ok(_) => true,
        Err(FormatError::Invalid { .. }) => true,
        Err(_) => false,
    }
}

/// Describes a file of another program.
pub(crate) fn info(path: &std::path::Path, camera: Option<&str>, json: bool) -> anyhow::Result<i32> {
    let read = ReadOptions { camera: camera.map(str::to_owned), size: None };
    let mut reader = open(path, &read)?;
    let (extent, damage) = measured(&mut *reader);
    let info = reader.info();
    let file = FileInfo {
        file: path.display().to_string(),
        format: info.format.name(),
        description: info.format.description(),
        camera: info.camera.clone(),
        cameras: info.cameras.clone(),
        width: info.size.map(|size| size.0),
        height: info.size.map(|size| size.1),
        t_offset_us: info.t_offset_us,
        first_us: extent.range.map(|range| range.0),
        last_us: extent.range.map(|range| range.1),
        events: extent.events,
        on: extent.on,
        triggers: extent.triggers,
        frames: extent.frames,
        imu: extent.imu,
        properties: info.properties.clone(),
        damage: damage.as_ref().map(ToString::to_string),
    };
    if json {
        text::say_json(&file)?;
    } else {
        text::say(&describe(&file, &extent));
    }
    damage.map_or(Ok(0), |error| Err(error.into()))
}

/// Counts up to the end, or up to where the file is damaged.
fn measured(reader: &mut dyn EventReader) -> (Extent, Option<FormatError>) {
    let mut extent = Extent::default();
    let mut packet = evis_format::Packet::default();
    loop {
        match reader.read_packet(&mut packet) {
            Ok(true) => extent.add(&packet),
            Ok(false) => return (extent, None),
            Err(error) => return (extent, Some(error)),
        }
    }
}

fn describe(file: &FileInfo, extent: &Extent) -> String {
    let mut lines = vec![format!("{}  {}", file.file, file.description)];
    let size = match (file.width, file.height) {
        (Some(width), Some(height)) => format!("{width}x{height}"),
        _ => format!("not given; the events need {}x{}", extent.reach.0, extent.reach.1),
    };
    lines.push(format!("size      {size}"));
    if let (Some(first), Some(last)) = (file.first_us, file.last_us) {
        lines.push(format!("time      {} to {}", text::seconds(first), text::seconds(last)));
    }
    if file.t_offset_us != 0 {
        lines.push(format!("offset    {} us", file.t_offset_us));
    }
    let on = text::percent(file.on, file.events);
    lines.push(format!("events    {}  ({on:.1} % ON)", text::grouped(file.events)));
    for (count, name) in [(file.triggers, "triggers"), (file.frames, "frames"), (file.imu, "imu")] {
        if count > 0 {
            lines.push(format!("{name:<10}{}", text::grouped(count)));
        }
    }
    if !file.cameras.is_empty() {
        lines.push(format!("cameras   {}", file.cameras.join(", ")));
    }
    lines.extend(file.properties.iter().map(|(key, value)| format!("  {key} = {value}")));
    lines.join("\n")
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
        assert_eq!(others(2, 0, 1), ", 2 triggers, 1 inertial samples");
    }
}
