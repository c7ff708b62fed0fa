//! `video`: frames that somebody else made go in, a recording comes out.

use std::path::PathBuf;
use std::time::Instant;

use evis_core::{SensorConfig, Transfer};
use evis_format::Format;
use evis_video::{
    Clock, FrameSource, SourceConfig, VideoConfig, VideoReport, VideoStream, clock_of, convert,
};

use crate::args::{VideoArgs, to_us};
use crate::convert::{export, format_of};
use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::outputs::{check_beside, check_free, check_output, check_parent};
use crate::progress::Progress;
use crate::trace::Trace;
use crate::{MakeUpsampler, flags, scene_info, sensor_source, text};

/// Converts and tells.
pub(crate) fn video(args: &VideoArgs, upsampler: &MakeUpsampler) -> anyhow::Result<i32> {
    let outputs = Outputs::of(&args.output)?;
    if let Some(report) = &args.report {
        let mut taken: Vec<_> = args.output.iter().map(|output| ("--output", output.as_path())).collect();
        taken.push(("the input", &args.input));
        check_beside("--report", report, args.force, &taken)?;
    }
    if let Some(trace) = &args.trace {
        let mut taken: Vec<_> = args.output.iter().map(|output| ("--output", output.as_path())).collect();
        taken.extend(args.report.as_deref().map(|report| ("--report", report)));
        taken.push(("the input", &args.input));
        check_beside("--trace", trace, args.force, &taken)?;
    }
    let trace = Trace::start(args.trace.as_deref())?;
    for output in &args.output {
        check_free(output, args.force)?;
    }
    if scene_info::is_scene(&args.input) {
        let input = args.input.display();
        return Err(bad_input(format!(
            "{input} is a scene, and no film; `run {input} -o OUT.h5` simulates it"
        )));
    }
    // Arrays of frames are `.npy` files as well.
    let format = if args.input.is_file() { evis_format::recognise(&args.input)? } else { None };
    if let Some(format) = format.filter(|format| *format != Format::Npy) {
        let input = args.input.display();
        return Err(bad_input(format!(
            "{input} holds events or labels ({}), and no film; `info {input}` describes it, `preview {input} -o X.mp4` \
             makes a film of a recording",
            format.description()
        )));
    }
    let defaults = VideoConfig::default();
    let mut config = VideoConfig {
        sensor: match (&args.sensor, &args.like) {
            (Some(name), _) => sensor_source::load("--sensor", name)?,
            (None, Some(name)) => SensorConfig::preset(name)?,
            (None, None) => defaults.sensor,
        },
        seed: args.seed.unwrap_or(defaults.seed),
        reference_luminance: args.reference_luminance.unwrap_or(defaults.reference_luminance),
        ..VideoConfig::default()
    };
    for assignment in &args.set {
        config.sensor.set(assignment).map_err(|error| flags::named(error.into()))?;
    }
    let clock = match (args.fps, &args.timestamps) {
        (Some(fps), _) => Clock::rate(fps)?,
        (None, Some(path)) => clock_of(path)?,
        (None, None) => Clock::Source,
    };
    let source = SourceConfig {
        clock,
        transfer: args.transfer.or(args.like.as_ref().map(|_| Transfer::Linear)),
        size: args.size,
        start_us: to_us(args.start.unwrap_or(0.0)),
        duration_us: args.duration.map(to_us),
        ..SourceConfig::new(&args.input)
    };
    let upsampler = args.upsample.as_ref().map(|network| upsampler(network.as_deref())).transpose()?;
    // From here on Ctrl-C leaves a whole file.
    let interrupt = Interrupt::listen();
    let stream = VideoStream::new(FrameSource::open(source)?, config)?;
    let stream = match upsampler {
        Some(upsampler) => stream.upsampled(upsampler),
        None => stream,
    };
    let progress =
        Progress::new(stream.source().duration_us().and_then(|us| u64::try_from(us).ok()).unwrap_or(0));
    let started = Instant::now();
    // A recording that nobody asked for is written over, should a killed process have left one.
    let force = args.force || outputs.is_temporary;
    let report = convert(stream, &outputs.recording, force, |at| {
        progress.stream(at.t_us, at.events, started.elapsed());
        !interrupt.asked()
    })?;
    drop(progress);
    let exported = outputs.export(args.force)?;
    for warning in &report.warnings {
        text::warn(warning);
    }
    if let Some(path) = &args.report {
        text::write_json(path, &report)?;
    }
    if let Some(trace) = trace {
        trace.finish()?;
    }
    if args.json {
        text::say_json(&report)?;
    } else {
        text::say(&summary(&report, outputs.is_temporary));
        exported.iter().for_each(|line| text::say(line));
    }
    Ok(if report.interrupted { EXIT_INTERRUPTED } else { 0 })
}

/// The files to write.
struct Outputs {
    /// The first HDF5 file, or one that goes when the others are written.
    recording: PathBuf,
    is_temporary: bool,
    others: Vec<PathBuf>,
}

impl Outputs {
    /// Refuses what cannot be written.
    fn of(outputs: &[PathBuf]) -> anyhow::Result<Self> {
        let mut recording = None;
        let mut others = Vec::new();
        for output in outputs {
            if outputs.iter().filter(|other| *other == output).count() > 1 {
                return Err(bad_input(format!(
                    "--output {} is given twice; leave one out",
                    output.display()
                )));
            }
            match format_of(output)? {
                Format::Hdf5 if recording.is_some() => {
                    let output = output.display();
                    return Err(bad_input(format!(
                        "--output {output}: there is a recording already; leave one out"
                    )));
                }
                Format::Hdf5 => {
                    check_output(output)?;
                    recording = Some(output.clone());
                }
                _ => {
                    check_parent(output, "--output")?;
                    others.push(output.clone());
                }
            }
        }
        let is_temporary = recording.is_none();
        let beside = || {
            let name =
                others.first().and_then(|other| other.file_name()).unwrap_or_default().to_string_lossy();
            let first = others.first().map_or_else(PathBuf::new, Clone::clone);
            first.with_file_name(format!(".{name}.{}.h5", std::process::id()))
        };
        Ok(Self { recording: recording.unwrap_or_else(beside), is_temporary, others })
    }

    /// Writes the other formats. Returns a line about each.
    fn export(&self, force: bool) -> anyhow::Result<Vec<String>> {
        self.others.iter().map(|other| export(&self.recording, other, force)).collect()
    }
}

impl Drop for Outputs {
    fn drop(&mut self) {
        if self.is_temporary {
            // Where nothing was written there is nothing to remove.
            let _ = std::fs::remove_file(&self.recording);
        }
    }
}

/// The report for people: four lines, and what went amiss.
fn summary(report: &VideoReport, is_temporary: bool) -> String {
    let VideoReport { width, height, frames, stream_s, wall_s, events, .. } = report;
    let per = |seconds: f64| text::short(if seconds > 0.0 { *events as f64 / seconds } else { 0.0 });
    let stopped = if report.interrupted { " (interrupted; the file is complete up to here)" } else { "" };
    let between = match report.between {
        0 => String::new(),
        count => format!(" and {} between them", text::grouped(count)),
    };
    let file = if is_temporary { "no recording".into() } else { report.output.display().to_string() };
    let mut lines = vec![
        format!("file     {file}  ({width}x{height})"),
        format!(
            "events   {}, {}/s of stream, {:.1} % ON",
            text::grouped(*events),
            per(*stream_s),
            text::percent(report.on, *events)
        ),
        format!(
            "time     {stream_s} s of stream{stopped} in {} s, {} × real time",
            text::measured(*wall_s),
            text::significant(stream_s / wall_s.max(1.0e-9))
        ),
        format!("frames   {}{between}, {}, curve {}", text::grouped(*frames), report.kind, report.transfer),
    ];
    for (what, count) in [
        ("unknown pixels", report.unknown),
        ("clamped pixels", report.clamped),
        ("lost to the refractory period", report.suppressed),
        ("dropped by the readout", report.dropped),
    ] {
        if count > 0 {
            lines.push(format!("         {} {what}", text::grouped(count)));
        }
    }
    lines.join("\n")
}
