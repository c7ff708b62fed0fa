//! `run`: a scene goes in, a recording comes out.

mod job;
mod report;
mod settings;
mod tally;

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use evis_core::{SensorConfig, TriggerRule, WarpVariant};
use evis_render::config::EVIS_PAPER_LOG_EPS;
use evis_render::settings::SettingsFile;
use evis_render::{
    DeviceSummary, Gpu, Method, PacketReport, RunConfig, SamplingRequest, Simulator, scene_sensors,
};
use evis_scene::{Scene, SceneState};

use crate::args::{self, MethodArg, RunArgs, to_us};
use crate::failure::bad_input;
use crate::interrupt::EXIT_INTERRUPTED;
use crate::outputs::{check_free, check_output, check_report, output_paths};
use crate::warnings::Warnings;
use crate::{scene_source, sensor_source, settings_source, text};

use job::Job;
use report::Report;
use settings::{PACKET_US, Settings, headers};
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
        check_report(report, args.force, &taken)?;
    }
    let asked = sensor_source::asked(&args.sensor)?;
    let settings = args.settings.as_deref().map(settings_source::load).transpose()?;
    // A recording's settings hold every camera's sensor.
    let for_all = asked.all.is_some() || settings.as_ref().is_some_and(|file| file.gives("sensor"));
    let (mut config, sampling) = config(args, settings, asked)?;
    config.check()?;
    sampling.check()?;
    let camera_motion = args.camera_motion.settings(config.size, config.cameras.first());
    let scene = scene_source::open(&args.scene, config.seed, args.speed, camera_motion)?;
    for name in config.cameras.iter().chain(config.sensors.keys()) {
        scene.camera(name)?;
    }
    if !for_all {
        for (camera, mut sensor) in scene_sensors(&scene, &config.cameras)? {
            adjust(args, &mut sensor);
            config.sensors.entry(camera).or_insert(sensor);
        }
        config.check()?;
    }
    let environments = scene.variants.len().max(1);
    let outputs = output_paths(&args.output, environments);
    for output in &outputs {
        check_free(output, args.force)?;
    }
    for sensor in config.sensors.values().chain([&config.sensor]) {
        sensor.warnings().into_iter().for_each(|warning| warnings.add(warning));
    }
    for warning in scene.warnings.iter().chain(&scene_source::at_rest(&scene, &config.cameras)) {
        warnings.add(warning.clone());
    }
    let moved = scene.camera_motion.clone();
    let duration_us = duration_us(args, &scene, &mut warnings);

    let gpu = Gpu::open_any(args.device.as_deref()).map_err(|e| bad_input(e.to_string()))?;
    let device = gpu.as_ref().map_or_else(DeviceSummary::none, |gpu| gpu.summary().clone());
    let scene = Arc::new(scene);
    for note in sampling.apply(gpu.as_ref(), &scene, &mut config)? {
        text::complain(&format!("quality: {note}"));
    }
    let simulator = Simulator::new(gpu.as_ref(), scene, config)?;
    let settings = Settings {
        evis: env!("CARGO_PKG_VERSION"),
        scene: args.scene.clone(),
        speed: args.speed.unwrap_or(1.0),
        environments,
        duration_s: duration_us as f64 / 1.0e6,
        packet_us: PACKET_US,
        camera_motion: moved,
        run: simulator.config().clone(),
    };
    let mut job = Job {
        headers: headers(&settings, simulator.cameras())?,
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
    for warning in audit_warnings(&job.tally.report) {
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
        let json = serde_json::to_string_pretty(&report)?;
        evis_core::limits::write_whole(path, (json + "\n").as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        text::say_json(&report)?
    } else {
        text::say(&report.summary())
    }
    Ok(if report.interrupted { EXIT_INTERRUPTED } else { 0 })
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

/// Single settings of the sensor, over what preset, file or scene say.
fn adjust(args: &RunArgs, sensor: &mut SensorConfig) {
    let set = |to: &mut f32, from: Option<f32>| *to = from.unwrap_or(*to);
    set(&mut sensor.threshold_on, args.threshold_on);
    set(&mut sensor.threshold_off, args.threshold_off);
    set(&mut sensor.log_eps, args.log_eps);
    if let Some(trigger) = args.trigger {
        sensor.trigger = trigger.into();
    }
}

/// The run's settings, flags over a settings file's or defaults, and what is asked of sampling.
fn config(
    args: &RunArgs,
    settings: Option<SettingsFile>,
    asked: sensor_source::Asked,
) -> anyhow::Result<(RunConfig, SamplingRequest)> {
    let mut config = settings.map_or_else(RunConfig::default, SettingsFile::into_config);
    let method = method(args)?;
    config.sensors.extend(asked.of);
    if let Some(sensor) = asked.all {
        config.sensor = sensor;
    } else if args.method == Some(MethodArg::EvisPaper) {
        config.sensor.trigger = TriggerRule::Latch;
        config.sensor.log_eps = EVIS_PAPER_LOG_EPS;
    }
    for sensor in config.sensors.values_mut().chain([&mut config.sensor]) {
        adjust(args, sensor);
    }
    let sampling = SamplingRequest {
        quality: args.quality.map(Into::into),
        from_settings: args.settings.is_some(),
        method,
        rate_hz: args.rate,
        adaptive_px: args.adaptive,
        between: args.between.map(Into::into),
        samples: args.samples,
        antialias: args.antialias.map(Into::into),
        texture_taps: args.texture_taps,
        shadows: args.shadows.map(Into::into),
    };
    config.shadow_map = args.shadow_map.or(config.shadow_map);
    if !args.camera.is_empty() {
        config.cameras.clone_from(&args.camera);
    }
    config.size = args.size.or(config.size);
    config.start_us = args.start.map_or(config.start_us, to_us);
    config.seed = args.seed.unwrap_or(config.seed);
    if !args.labels.is_empty() {
        config.labels = args::label_kinds(&args.labels);
    }
    config.label_rate_hz = args.label_rate.unwrap_or(config.label_rate_hz);
    config.reference_luminance = args.reference_luminance.or(config.reference_luminance);
    config.frame_rate_hz = args.frame_rate.or(config.frame_rate_hz);
    config.audit = args.audit.unwrap_or(config.audit);
    if let Some(exposure_ms) = args.exposure_ms {
        if args.frame_rate.is_none() {
            return Err(bad_input(format!(
                "--exposure-ms {exposure_ms} exposes no frame; add --frame-rate HZ"
            )));
        }
        // Even, so that the middle is a whole microsecond; never longer than was asked for, but for rounding.
        config.exposure_us = (exposure_ms * 500.0 + 1e-6).floor() as i64 * 2;
        if config.exposure_us < 2 {
            return Err(bad_input(format!("--exposure-ms {exposure_ms}: the shortest exposure is 0.002 ms")));
        }
    } else if args.frame_rate.is_some() {
        config.exposure_us = RunConfig::usual_exposure_us(args.frame_rate);
    }
    if args.between.is_some() && args.adaptive.is_none() && args.quality.is_none() && args.settings.is_none()
    {
        return Err(bad_input(
            "--between: tiles are sampled at rates of their own only with --adaptive PX; add it",
        ));
    }
    Ok((config, sampling))
}

/// The method with its flags, if one is given; flags of another method are refused, they would be ignored.
fn method(args: &RunArgs) -> anyhow::Result<Option<Method>> {
    let variant = match args.method {
        None | Some(MethodArg::Native | MethodArg::Decoupled) if let Some(flag) = args.splat.given() => {
            return Err(bad_input(format!(
                "{flag} needs keyframes; add --method splat or --method evis-paper"
            )));
        }
        None => return Ok(None),
        Some(MethodArg::Native) => return Ok(Some(Method::Native)),
        Some(MethodArg::Decoupled) => return Ok(Some(Method::Decoupled)),
        Some(MethodArg::Splat) => WarpVariant::Splat,
        Some(MethodArg::EvisPaper) => WarpVariant::EvisPaper,
    };
    if let Some(rate) = args.rate {
        return Err(bad_input(format!(
            "--rate {rate}: a method with keyframes has --keyframe-rate times --steps instants per second; give those"
        )));
    }
    Ok(Some(Method::Splat(args.splat.warp(variant))))
}

/// How long to stream; says where the number comes from, and where the scene's motion ends before it.
fn duration_us(args: &RunArgs, scene: &Scene, warnings: &mut Warnings) -> i64 {
    let start_s = args.start.unwrap_or(0.0);
    let own_s = scene.duration_s.filter(|s| s.is_finite() && *s > 0.0);
    let left_s = own_s.map(|s| s - start_s).filter(|s| *s >= 1.0e-6);
    let duration_s = args.duration.unwrap_or_else(|| {
        let (duration_s, origin) = match left_s {
            Some(left_s) => (left_s, "the scene's own; --duration changes it"),
            None => (DEFAULT_DURATION_S, "the default; --duration changes it"),
        };
        text::complain(&format!("duration: {duration_s} s ({origin})"));
        duration_s
    });
    // Environments may run ahead of the scene's clock.
    let ahead_s =
        scene.variants.iter().map(|v| v.time_offset_s).fold(0.0, f64::max) / args.speed.unwrap_or(1.0);
    let until_s = start_s + duration_s + ahead_s;
    if let Some(own_s) = own_s
        && until_s > own_s + 1.0e-6
        && rests_after(scene, own_s)
    {
        warnings.add(format!(
            "the scene's motion ends at {own_s} s and the stream at {until_s} s of the scene's time; after its end \
             everything rests where it was"
        ));
    }
    to_us(duration_s).max(1)
}

/// Whether nothing changes any more from `end_s` on, as far as some times say; motion by formulas goes on.
fn rests_after(scene: &Scene, end_s: f64) -> bool {
    let at = |time_s: f64| {
        let mut state = SceneState::default();
        scene.evaluate(time_s, &mut state);
        state
    };
    let end = at(end_s);
    // No multiples of each other: what comes back is seen elsewhere at one of them.
    [0.013, 0.37, 1.0, 2.9].iter().all(|later| at(end_s + later) == end)
}
