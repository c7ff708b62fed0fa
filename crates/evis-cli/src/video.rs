//! `video`: frames that somebody else made go in, a recording comes out.

use std::time::Instant;

use anyhow::Context;
use evis_core::{SensorConfig, Transfer};
use evis_video::{
    Clock, FrameSource, SourceConfig, VideoConfig, VideoReport, VideoStream, clock_of, convert,
};

use crate::args::{VideoArgs, to_us};
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::outputs::{check_free, check_output, check_report};
use crate::progress::Progress;
use crate::{sensor_source, text};

/// Converts and tells.
pub(crate) fn video(args: &VideoArgs) -> anyhow::Result<i32> {
    check_output(&args.output)?;
    if let Some(report) = &args.report {
        check_report(report, args.force, &[("--output", &args.output), ("the input", &args.input)])?;
    }
    check_free(&args.output, args.force)?;
    let defaults = VideoConfig::default();
    let config = VideoConfig {
        sensor: match (&args.sensor, &args.like) {
            (Some(name), _) => sensor_source::load("--sensor", name)?,
            (None, Some(name)) => SensorConfig::preset(name)?,
            (None, None) => defaults.sensor,
        },
        seed: args.seed.unwrap_or(defaults.seed),
        reference_luminance: args.reference_luminance.unwrap_or(defaults.reference_luminance),
        ..VideoConfig::default()
    };
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
    // From here on Ctrl-C leaves a whole file.
    let interrupt = Interrupt::listen();
    let stream = VideoStream::new(FrameSource::open(source)?, config)?;
    let progress =
        Progress::new(stream.source().duration_us().and_then(|us| u64::try_from(us).ok()).unwrap_or(0));
    let started = Instant::now();
    let report = convert(stream, &args.output, args.force, |at| {
        progress.stream(at.t_us, at.events, started.elapsed());
        !interrupt.asked()
    })?;
    drop(progress);
    for warning in &report.warnings {
        text::complain(&format!("warning: {warning}"));
    }
    if let Some(path) = &args.report {
        let json = serde_json::to_string_pretty(&report)?;
        evis_core::limits::write_whole(path, (json + "\n").as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        text::say_json(&report)?;
    } else {
        text::say(&summary(&report));
    }
    Ok(if report.interrupted { EXIT_INTERRUPTED } else { 0 })
}

/// The report for people.
fn summary(report: &VideoReport) -> String {
    let VideoReport { width, height, frames, stream_s, wall_s, events, .. } = report;
    let per = |seconds: f64| text::short(if seconds > 0.0 { *events as f64 / seconds } else { 0.0 });
    let stopped = if report.interrupted { " (interrupted; the file is complete up to here)" } else { "" };
    let mut lines = vec![
        format!("{}  ({width}x{height})", report.output.display()),
        format!("frames             {}, {}, curve {}", text::grouped(*frames), report.kind, report.transfer),
        format!("stream             {stream_s} s{stopped}"),
        format!(
            "events             {}  ({:.1} % ON)",
            text::grouped(*events),
            text::percent(report.on, *events)
        ),
        format!("events per second  {} of work, {} of stream", per(*wall_s), per(*stream_s)),
        format!("real-time factor   {:.4}  ({wall_s:.1} s of work)", stream_s / wall_s.max(1.0e-9)),
    ];
    for (what, count) in [
        ("unknown pixels", report.unknown),
        ("clamped pixels", report.clamped),
        ("refractory", report.suppressed),
        ("dropped", report.dropped),
    ] {
        if count > 0 {
            lines.push(format!("{what:<18} {}", text::grouped(count)));
        }
    }
    lines.join("\n")
}
