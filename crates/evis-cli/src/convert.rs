//! `convert`: event files of one program for another; `info` of files that are no recordings of EVIS.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use evis_core::LabelKind;
use evis_core::format::hdf5::Recording;
use evis_format::{
    BagImport, ConvertOptions, DsecExport, EventReader, Extent, Format, FormatError, McapExport, ReadOptions,
    WriteOptions, measure, open, recognise,
};
use serde::Serialize;

use crate::args::ConvertArgs;
use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::progress::{Progress, WHOLE};
use crate::{text, undistort};

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
    /// What else a recording of EVIS holds, which the output has no place for.
    left_out: Vec<String>,
    interrupted: bool,
    /// How the input is damaged, where --until-damage ended there.
    damage: Option<String>,
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
    if is_whole(args) {
        match format {
            Format::Dsec | Format::Mcap => {
                // Of a recording of EVIS more than events is kept.
                if let Ok(recording) = Recording::open(&args.input) {
                    let export = if format == Format::Dsec { export_dsec } else { export_mcap };
                    return export(args, &recording);
                }
            }
            Format::Hdf5 if recognise(&args.input).is_ok_and(|input| input == Some(Format::Mcap)) => {
                return import_mcap(args);
            }
            _ => {}
        }
    }
    if let (Some(start), Some(end)) = (args.start, args.end)
        && end <= start
    {
        let seconds = |us: i64| us as f64 / 1.0e6;
        return Err(bad_input(format!(
            "--end is {}, which is not after --start {}; choose a later end",
            seconds(end),
            seconds(start)
        )));
    }
    let read = ReadOptions { camera: args.camera.clone(), size: args.size };
    let mut reader = open(&args.input, &read)?;
    let input_format = reader.info().format;
    let left_out =
        if args.events_only { Vec::new() } else { left_out(&args.input, reader.info().camera.as_deref()) };
    // What the file itself does not say takes a reading of its own.
    let needs_extent = reader.info().size.is_none() || (args.rebase && args.start.is_none());
    let extent = match needs_extent {
        true if args.until_damage => Some(measured(&mut *reader).0),
        true => Some(measure(&mut *reader)?),
        false => None,
    };
    if needs_extent {
        reader = open(&args.input, &read)?;
    }
    let reach = extent.map_or((1, 1), |extent| (extent.reach.0.max(1), extent.reach.1.max(1)));
    let size = reader.info().size.unwrap_or(reach);
    let first_us = extent.and_then(|extent| extent.range).map_or(0, |(first, _)| first);
    let map = if args.undistort {
        let lens = match &args.calibration {
            Some(file) => undistort::of_calibration(file, args.calibration_camera.as_deref(), size)?,
            None => undistort::of_recording(&args.input, reader.info().camera.as_deref())?,
        };
        Some(Arc::new(undistort::pixel_map(&lens, size)?))
    } else {
        None
    };
    let flips = |axis| args.flip.as_ref().is_some_and(|flip| flip.contains(axis));
    let options = ConvertOptions {
        start_us: args.start.unwrap_or(i64::MIN),
        end_us: args.end.unwrap_or(i64::MAX),
        undistort: map,
        crop: args.crop,
        flip_x: flips('x'),
        flip_y: flips('y'),
        events_only: args.events_only,
        shift_us: if args.rebase { args.start.unwrap_or(first_us).saturating_neg() } else { 0 },
        until_damage: args.until_damage,
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
    let progress = Progress::new(WHOLE);
    let converted = evis_format::convert(reader, writer, size, &options, |part| {
        if let Some(part) = part {
            progress.part("of the input", part);
        }
        !interrupt.asked()
    })?;
    drop(progress);
    if let Some(damage) = &converted.damage {
        text::complain(&format!("warning: {damage}"));
    }
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
        left_out,
        interrupted: interrupt.asked(),
        damage: converted.damage,
    };
    if args.json {
        text::say_json(&report)?;
    } else {
        let mut line =
            format!("{}  {format}, {width}x{height}, {} events", report.output, text::grouped(report.events));
        line += &others(&[
            (report.triggers, "triggers"),
            (report.frames, "frames"),
            (report.imu, "inertial samples"),
        ]);
        if !report.left_out.is_empty() {
            line += &format!("\nleft out: {}", report.left_out.join(", "));
        }
        text::say(&line);
    }
    Ok(if report.interrupted { EXIT_INTERRUPTED } else { 0 })
}

/// Writes the events of the recording `input` in the format that the name of `output` says. Returns a line about it.
pub(crate) fn export(input: &Path, output: &Path, overwrite: bool) -> anyhow::Result<String> {
    let format = format_of(output)?;
    let reader = open(input, &ReadOptions::default())?;
    let size = reader.info().size.unwrap_or((1, 1));
    let writer = evis_format::create(output, format, &WriteOptions { size, overwrite })?;
    let options = ConvertOptions { events_only: true, ..ConvertOptions::default() };
    let converted = evis_format::convert(reader, writer, size, &options, |_| true)?;
    Ok(format!("{}  {format}, {} events", output.display(), text::grouped(converted.events)))
}

/// The format that the name of `path` says.
pub(crate) fn format_of(path: &Path) -> anyhow::Result<Format> {
    Format::of_ending(path).ok_or_else(|| {
        bad_input(format!(
            "--output {}: its name tells no format; end it with .h5, .raw, .dat, .aedat4, .txt, .npz, .npy, .mcap or .es",
            path.display()
        ))
    })
}

/// What the recording of EVIS `input` holds beside the events of `camera`; nothing of files of other programs.
fn left_out(input: &Path, camera: Option<&str>) -> Vec<String> {
    let Ok(recording) = Recording::open(input) else { return Vec::new() };
    let Ok(index) = recording.find_camera(camera) else { return Vec::new() };
    let images = recording.label_kinds(index).unwrap_or_default().iter().map(|&kind| {
        let count = recording.label_times(index, kind).map_or(0, |times| times.len());
        (count as u64, format!("images of {}", kind.name()))
    });
    let units = recording.imus().unwrap_or_default();
    let samples: usize = units.iter().filter_map(|name| recording.imu(name).ok()).map(|all| all.len()).sum();
    let poses = recording.poses(index).map_or(0, |poses| poses.len());
    let states = recording.states().map_or(0, |states| states.len());
    let bodies = recording.body_infos().map_or(0, |bodies| bodies.len());
    let counted = [
        (poses as u64, "poses".to_owned()),
        (samples as u64, "inertial samples".to_owned()),
        (bodies as u64, "bodies".to_owned()),
        (states as u64, "states".to_owned()),
    ];
    let mut named = vec!["the lens".to_owned()];
    let there = images.chain(counted).filter(|(count, _)| *count > 0);
    named.extend(there.map(|(count, name)| format!("{} {name}", text::grouped(count))));
    if recording.header().labels.contains(&LabelKind::Cause) {
        named.push("the causes of events".to_owned());
    }
    named.push("the settings".to_owned());
    named
}

/// `, 3 triggers, 2 frames`, of what there is.
fn others(counted: &[(u64, &str)]) -> String {
    let there = counted.iter().filter(|(count, _)| *count > 0);
    there.map(|(count, name)| format!(", {} {name}", text::grouped(*count))).collect()
}

fn same_file(args: &ConvertArgs) -> bool {
    let place = |path: &PathBuf| std::fs::canonicalize(path).ok();
    place(&args.input).is_some_and(|input| place(&args.output) == Some(input))
}

/// Whether all of the input is asked for, as it is.
fn is_whole(args: &ConvertArgs) -> bool {
    let part = args.start.is_some() || args.end.is_some() || args.crop.is_some() || args.flip.is_some();
    let changed = part || args.rebase || args.undistort || args.events_only;
    !(changed || args.until_damage || args.camera.is_some())
}

/// Does what converts a whole recording, with a bar; `None` where Ctrl-C ended it.
fn watched<T>(
    args: &ConvertArgs,
    work: impl FnOnce(&mut dyn FnMut(f64) -> bool) -> Result<Option<T>, FormatError>,
) -> anyhow::Result<Option<T>> {
    let interrupt = Interrupt::listen();
    let progress = Progress::new(WHOLE);
    let done = work(&mut |part| {
        progress.part("of the input", part);
        !interrupt.asked()
    })?;
    drop(progress);
    if done.is_none() {
        text::complain(&format!("interrupted: {} was not written", args.output.display()));
    }
    Ok(done)
}

fn import_mcap(args: &ConvertArgs) -> anyhow::Result<i32> {
    let import =
        watched(args, |proceed| evis_format::import_mcap(&args.input, &args.output, args.force, proceed))?;
    let Some(BagImport { cameras, events, images, poses, imu, left_out }) = import else {
        return Ok(EXIT_INTERRUPTED);
    };
    if args.json {
        text::say_json(&serde_json::json!({
            "input": args.input.display().to_string(), "output": args.output.display().to_string(),
            "format": Format::Hdf5.name(), "cameras": cameras, "events": events, "images": images, "poses": poses,
            "imu": imu, "left_out": left_out,
        }))?;
        return Ok(0);
    }
    let mut lines = vec![format!(
        "{}  {}, {}, {} events{}",
        args.output.display(),
        Format::Hdf5,
        cameras.join(", "),
        text::grouped(events),
        others(&[(images, "images"), (poses, "poses"), (imu, "inertial samples")])
    )];
    lines.extend(left_out.iter().map(|what| format!("left out: {what}")));
    text::say(&lines.join("\n"));
    Ok(0)
}

fn export_mcap(args: &ConvertArgs, recording: &Recording) -> anyhow::Result<i32> {
    let export =
        watched(args, |proceed| evis_format::export_mcap(recording, &args.output, args.force, proceed))?;
    let Some(export) = export else { return Ok(EXIT_INTERRUPTED) };
    if args.json {
        let McapExport { cameras, events, images, poses, imu } = export;
        text::say_json(&serde_json::json!({
            "input": args.input.display().to_string(), "output": args.output.display().to_string(),
            "format": Format::Mcap.name(), "cameras": cameras, "events": events, "images": images, "poses": poses,
            "imu": imu,
        }))?;
        return Ok(0);
    }
    text::say(&format!(
        "{}  {}, {}, {} events{}",
        args.output.display(),
        Format::Mcap,
        export.cameras.join(", "),
        text::grouped(export.events),
        others(&[(export.images, "images"), (export.poses, "poses"), (export.imu, "inertial samples")])
    ));
    Ok(0)
}

fn export_dsec(args: &ConvertArgs, recording: &Recording) -> anyhow::Result<i32> {
    let export =
        watched(args, |proceed| evis_format::export_dsec(recording, &args.output, args.force, proceed))?;
    let Some(export) = export else { return Ok(EXIT_INTERRUPTED) };
    if args.json {
        let DsecExport { cameras, events, flows, disparities, notes } = export;
        text::say_json(&serde_json::json!({
            "input": args.input.display().to_string(), "output": args.output.display().to_string(),
            "format": Format::Dsec.name(), "cameras": cameras, "events": events, "flows": flows,
            "disparities": disparities, "notes": notes,
        }))?;
        return Ok(0);
    }
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
pub(crate) fn reads(path: &Path) -> bool {
    // A file of several cameras is read once one is chosen.
    match open(path, &ReadOptions::default()) {
        Ok(_) => true,
        Err(FormatError::Invalid { .. }) => true,
        Err(_) => false,
    }
}

/// Describes a file of another program.
pub(crate) fn info(path: &Path, camera: Option<&str>, json: bool) -> anyhow::Result<i32> {
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
    fn what_a_file_has_beside_events_is_counted() {
        assert_eq!(others(&[(2, "triggers"), (0, "frames"), (1, "poses")]), ", 2 triggers, 1 poses");
        assert_eq!(others(&[(0, "frames")]), "");
    }
}
