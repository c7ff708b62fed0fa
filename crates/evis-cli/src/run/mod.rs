//! `run`: a scene goes in, a recording comes out.

mod job;
mod report;
mod settings;
mod tally;

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use evis_core::Word;
use evis_render::{
    DeviceSummary, Gpu, Method, PacketReport, RunRequest, SamplingRequest, Simulator, implausible,
};
use evis_scene::Scene;
use evis_scene::source::Opening;

use crate::args::{RunArgs, to_us};
use crate::failure::bad_input;
use crate::interrupt::EXIT_INTERRUPTED;
use crate::outputs::{check_beside, check_free, check_output, output_paths};
use crate::trace::Trace;
use crate::warnings::Warnings;
use crate::{flags, scene_source, sensor_source, text};

use job::{Job, Moving, before_line};
use report::Report;
use settings::{ImuSettings, PACKET_US, Settings, headers};
use tally::Tally;

/// Seconds simulated where neither the user nor the scene says how many.
const DEFAULT_DURATION_S: f64 = 1.0;

/// Simulates and writes.
pub(crate) fn run(args: &RunArgs) -> anyhow::Result<i32> {
    let started = Instant::now();
    let mut warnings = Warnings::default();

    // Everything that can be refused is refused before a file is touched: the cheap checks first.
    check_output(&args.output)?;
    let mut taken = vec![("--output", args.output.as_path()), ("the scene", Path::new(&args.scene))];
    taken.extend(args.settings.as_deref().map(|settings| ("--settings", settings)));
    if let Some(report) = &args.report {
        check_beside("--report", report, args.force, &taken)?;
        taken.push(("--report", report));
    }
    if let Some(trace) = &args.trace {
        check_beside("--trace", trace, args.force, &taken)?;
    }
    let trace = Trace::start(args.trace.as_deref())?;
    let imus = ImuSettings::asked(&args.imu)?;
    let mut settled = request(args)?.settle().map_err(flags::named)?;
    let recorded = settled.recorded(&args.scene);
    if let (Some(file), Some(words)) = (&args.settings, recorded.in_words()) {
        text::complain(&format!("settings of {}: {words}, unless options say otherwise", file.display()));
    }
    let opening = Opening {
        seed: settled.config().seed,
        animation: args.animation.animation.clone().or(recorded.animation),
        speed: args.speed.or(recorded.speed),
        camera_motion: settled.camera_motion(&args.scene)?,
    };
    let scene = tracing::trace_span!("load scene").in_scope(|| scene_source::open(&args.scene, &opening))?;
    settled.take_sensors(&scene).map_err(flags::named)?;
    let environments = scene.variants.len().max(1);
    let outputs = output_paths(&args.output, environments);
    for output in &outputs {
        check_free(output, args.force)?;
    }
    let config = settled.config();
    for sensor in config.sensors.values().chain([&config.sensor]) {
        sensor.warnings().into_iter().for_each(|warning| warnings.add(warning));
    }
    for warning in scene.warnings.iter().chain(&scene_source::at_rest(&scene, &config.cameras)) {
        warnings.add(warning.clone());
    }
    let moved = scene.camera_motion.clone();
    let asked_s = args.duration.or(recorded.duration_s);
    let duration_us = duration_us(asked_s, config.start_us as f64 / 1e6, &scene, &mut warnings);

    let gpu = tracing::trace_span!("open device").in_scope(|| Gpu::open_any(args.device.as_deref()));
    let gpu = gpu.map_err(|e| bad_input(e.to_string()))?;
    let device = gpu.as_ref().map_or_else(DeviceSummary::none, |gpu| gpu.summary().clone());
    let scene = Arc::new(scene);
    let (config, notes) = tracing::trace_span!("configure")
        .in_scope(|| settled.configure(gpu.as_ref(), &scene))
        .map_err(flags::named)?;
    for note in notes {
        text::complain(&format!("quality: {note}"));
    }
    for warning in implausible(&scene, &config, duration_us) {
        warnings.add(warning);
    }
    // Decoupled sampling soon knows how long it takes: its line waits for that.
    if config.method != Method::Decoupled {
        text::complain(&before_line(&config, duration_us, None));
    }
    let simulator = Simulator::new(gpu.as_ref(), Arc::clone(&scene), config)?;
    let settings = Settings {
        evis: env!("CARGO_PKG_VERSION"),
        scene: args.scene.clone(),
        speed: scene.speed.unwrap_or(1.0),
        animation: scene.animation.clone(),
        environments,
        duration_s: duration_us as f64 / 1.0e6,
        packet_us: PACKET_US,
        camera_motion: moved,
        imus,
        run: simulator.config().clone(),
    };
    let mut job = Job {
        moving: Moving::new(scene, &simulator, args.pose_rate, &settings.imus)?,
        headers: headers(&settings, |environment| simulator.cameras_of(environment))?,
        tally: Tally::new(environments, simulator.cameras()),
        outputs,
        overwrite: args.force,
        writers: Vec::new(),
        flushed: Instant::now(),
    };
    let setup = started.elapsed();

    let streaming = Instant::now();
    let streamed = job.stream(simulator, duration_us);
    if matches!(streamed, Ok(false)) && job.tally.report.events == 0 {
        warnings.add(format!(
            "no event was fired in {}: nowhere did light change by a threshold; see with --frame-rate 10 what the cameras see, \
             lower --threshold-on and --threshold-off, or raise --camera-speed",
            text::seconds(job.tally.end_us)
        ));
    }
    let clamped = job.tally.report.clamped;
    if clamped > 0 {
        warnings.add(format!(
            "{clamped} pixel intervals hit the limit of events and were clamped; raise --rate or the thresholds"
        ));
    }
    for warning in clipped_warning(&job.tally.report).into_iter().chain(audit_warnings(&job.tally.report)) {
        warnings.add(warning);
    }
    let report = |job: &Job, interrupted| {
        Report::new(&settings, &device, job, &warnings, setup, streaming.elapsed(), interrupted)
    };
    let finished = streamed.and_then(|interrupted| {
        let json = serde_json::to_string_pretty(&report(&job, interrupted))?;
        job.finish(&json)?;
        // Once more: now the time that finishing took is in it.
        Ok(report(&job, interrupted))
    });
    let report = finished.map_err(|error| job.give_up(error))?;

    if let Some(path) = &args.report {
        text::write_json(path, &report)?;
    }
    if let Some(trace) = trace {
        trace.finish()?;
    }
    if args.json {
        text::say_json(&report)?
    } else {
        text::say(&report.summary());
        if args.verbose {
            text::say(&report.details());
        }
    }
    Ok(if report.interrupted { EXIT_INTERRUPTED } else { 0 })
}

/// Light that was clipped: the camera that saw the brightest, and how many others there are.
fn clipped_warning(report: &PacketReport) -> Option<String> {
    let worst = report.clipped_light.iter().max_by(|a, b| a.luminance.total_cmp(&b.luminance))?;
    let others = report.clipped_light.len() - 1;
    let rest = if others > 0 { format!(" ({others} more cameras saw such light)") } else { String::new() };
    Some(worst.warning() + &rest)
}

/// What audits found: the first skipped tiles that changed, each by itself, and the worst of those that were sampled too
/// seldom.
fn audit_warnings(report: &PacketReport) -> Vec<String> {
    const MOST: usize = 3;
    let (skipped, seldom): (Vec<_>, Vec<_>) = report.findings.iter().partition(|finding| finding.skipped);
    let mut warnings: Vec<String> = skipped.iter().take(MOST).map(|finding| finding.warning()).collect();
    if skipped.len() > MOST {
        warnings.push(format!("{} more skipped tiles changed", skipped.len() - MOST));
    }
    if let Some(worst) = seldom.iter().max_by(|a, b| a.change.total_cmp(&b.change)) {
        warnings.push(format!(
            "{} of {} audited tiles changed between their samples by more than half a threshold; the worst: {}",
            seldom.len(),
            report.audited,
            worst.warning()
        ));
    }
    warnings
}

/// What the arguments ask for.
fn request(args: &RunArgs) -> anyhow::Result<RunRequest> {
    let asked = sensor_source::asked(&args.sensor)?;
    let single = [
        ("threshold_on", args.threshold_on.map(|value| value.to_string())),
        ("threshold_off", args.threshold_off.map(|value| value.to_string())),
        ("log_eps", args.log_eps.map(|value| value.to_string())),
        ("trigger", args.trigger.map(|trigger| trigger.word().to_owned())),
    ];
    let single = single.into_iter().filter_map(|(key, value)| Some(format!("{key}={}", value?)));
    Ok(RunRequest {
        dense: None,
        settings: args.settings.clone(),
        sensor: asked.all,
        sensors: asked.of,
        set: args.set.iter().cloned().chain(single).collect(),
        sampling: SamplingRequest {
            quality: args.quality,
            from_settings: args.settings.is_some(),
            method: args.method,
            rate_hz: args.rate,
            adaptive_px: args.adaptive,
            samples: args.samples,
            antialias: args.antialias,
            texture_taps: args.texture_taps,
            shadows: args.shadows,
            compute: args.compute,
        },
        keyframe_hz: args.splat.keyframe_rate,
        steps: args.splat.steps,
        margin: args.splat.margin,
        shadow_map: args.shadow_map,
        audit: args.audit,
        cameras: args.camera.clone(),
        size: args.size,
        start_us: args.start.map(to_us),
        seed: args.seed,
        labels: args.labels.clone(),
        label_rate_hz: args.label_rate,
        frame_rate_hz: args.frame_rate,
        // Even, so that the middle is a whole microsecond; never longer than was asked for, but for rounding.
        exposure_us: args.exposure_ms.map(|ms| (ms * 500.0 + 1e-6).floor() as i64 * 2),
        camera_motion: args.camera_motion.camera_motion.clone(),
        camera_speed: args.camera_motion.camera_speed,
        reference_luminance: args.reference_luminance,
        poses: Vec::new(),
        materials: Vec::new(),
        lights: Vec::new(),
        pose_step_us: None,
    })
}

/// How long to stream from `start_s` of the scene's time; says where the number comes from unless it was asked for, and where
/// the scene's motion ends before it.
fn duration_us(asked_s: Option<f64>, start_s: f64, scene: &Scene, warnings: &mut Warnings) -> i64 {
    let own_s = scene_source::own_duration_s(scene);
    let left_s = own_s.map(|s| s - start_s).filter(|s| *s >= 1.0e-6);
    let duration_s = asked_s.unwrap_or_else(|| {
        let (duration_s, origin) = match left_s {
            Some(left_s) => (left_s, "the scene's own; --duration changes it"),
            None => (DEFAULT_DURATION_S, "the default; --duration changes it"),
        };
        // Rounded: animations have times in f32.
        text::complain(&format!("duration: {} ({origin})", text::seconds(to_us(duration_s))));
        duration_s
    });
    // Environments may run ahead of the scene's clock.
    let ahead_s =
        scene.variants.iter().map(|v| v.time_offset_s).fold(0.0, f64::max) / scene.speed.unwrap_or(1.0);
    let until_s = start_s + duration_s + ahead_s;
    if let Some(own_s) = scene_source::rests_before(scene, until_s) {
        warnings.add(format!(
            "the scene's motion ends at {own_s} s and the stream at {until_s} s of the scene's time; after its end \
             everything rests where it was"
        ));
    }
    to_us(duration_s).max(1)
}
