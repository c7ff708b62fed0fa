//! `run`: a scene goes in, a recording comes out.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use evis_core::format::hdf5::{RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, LabelKind, SensorConfig, TriggerRule, WarpVariant};
use evis_render::config::EVIS_PAPER_LOG_EPS;
use evis_render::settings::SettingsFile;
use evis_render::{
    Antialias, DeviceSummary, Gpu, Method, Packet, PacketReport, RunConfig, SamplingRequest, Shadows,
    Simulator, StageTimes, scene_sensors,
};
use evis_scene::{AppliedMotion, Scene, SceneState};
use serde::Serialize;

use crate::args::{self, MethodArg, RunArgs};
use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::progress::Progress;
use crate::{scene_source, sensor_source, settings_source, text};

/// Packets are this long; the stream's bytes do not depend on it.
const PACKET_US: i64 = 10_000;

/// Seconds simulated where neither the user nor the scene says how many.
const DEFAULT_DURATION_S: f64 = 1.0;

/// A killed process loses at most what came since the last flush. By the clock: each one stores unfinished chunks anew, so
/// that flushing a fast run for each part of its stream would fill the disk.
const FLUSH_EVERY: Duration = Duration::from_millis(400);

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
        antialias: args.aa.map(Into::into),
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

pub(crate) fn to_us(seconds: f64) -> i64 {
    (seconds * 1.0e6).round() as i64
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

/// Refuses a report that would take another file's place: without `force` any, and always those that are `taken`.
pub(crate) fn check_report(path: &Path, force: bool, taken: &[(&str, &Path)]) -> anyhow::Result<()> {
    check_apart(path, "--report", taken)?;
    check_parent(path, "--report")?;
    check_unused(path, "--report", force)
}

/// Refuses a path that is one of those that are `taken`, under whatever name.
fn check_apart(path: &Path, flag: &str, taken: &[(&str, &Path)]) -> anyhow::Result<()> {
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        path.canonicalize().ok().or_else(|| Some(folder.canonicalize().ok()?.join(path.file_name()?)))
    };
    match taken.iter().find(|(_, other)| place(path).is_some_and(|at| place(other) == Some(at))) {
        Some((what, _)) => {
            Err(bad_input(format!("{flag} {}: that is {what}; choose another name", path.display())))
        }
        None => Ok(()),
    }
}

/// Refuses an output that could not be written, before any work.
pub(crate) fn check_output(path: &Path) -> anyhow::Result<()> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if !matches!(ending.as_deref(), Some("h5" | "hdf5")) {
        return Err(bad_input(format!(
            "--output {}: recordings are HDF5 files; end the name with .h5 or .hdf5",
            path.display()
        )));
    }
    check_parent(path, "--output")
}

/// Refuses a path whose folder does not exist or does not let us write.
pub(crate) fn check_parent(path: &Path, flag: &str) -> anyhow::Result<()> {
    if path.is_dir() {
        return Err(bad_input(format!("{flag} {}: this is a folder; give a file name", path.display())));
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(bad_input(format!(
            "{flag} {}: the folder {} does not exist; create it or choose another",
            path.display(),
            folder.display()
        )));
    }
    // Asking the system is the only true answer: permissions, quotas and read-only mounts all have a say.
    let existed = path.exists();
    let probe = OpenOptions::new().write(true).create(true).truncate(false).open(path);
    if let Err(error) = probe {
        return Err(bad_input(format!(
            "{flag} {}: cannot write there ({error}); choose another place or change its permissions",
            path.display()
        )));
    }
    if !existed {
        std::fs::remove_file(path).with_context(|| format!("cannot remove {}", path.display()))?;
    }
    Ok(())
}

pub(crate) fn check_free(path: &Path, force: bool) -> anyhow::Result<()> {
    check_unused(path, "--output", force)
}

fn check_unused(path: &Path, flag: &str, force: bool) -> anyhow::Result<()> {
    if path.exists() && !force {
        return Err(bad_input(format!(
            "{flag} {} exists already; --force overwrites it, or choose another name",
            path.display()
        )));
    }
    Ok(())
}

/// `OUT.h5`, or `OUT_0000.h5`, … where there are several environments.
fn output_paths(output: &Path, environments: usize) -> Vec<PathBuf> {
    if environments == 1 {
        return vec![output.to_path_buf()];
    }
    let part = |p: Option<&std::ffi::OsStr>| p.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let (stem, ending) = (part(output.file_stem()), part(output.extension()));
    (0..environments).map(|k| output.with_file_name(format!("{stem}_{k:04}.{ending}"))).collect()
}

/// Everything that made the stream what it is; stored in the file as TOML.
#[derive(Clone, Debug, Serialize)]
struct Settings {
    evis: &'static str,
    scene: String,
    speed: f64,
    environments: usize,
    duration_s: f64,
    packet_us: i64,
    /// How cameras were moved that the scene leaves at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_motion: Option<AppliedMotion>,
    run: RunConfig,
}

/// One per environment.
fn headers(settings: &Settings, cameras: &[CameraInfo]) -> anyhow::Result<Vec<RecordingHeader>> {
    let config_toml = toml::to_string(settings).context("the settings cannot be stored")?;
    let method = settings.run.method.name().to_owned();
    let header = |environment| RecordingHeader {
        cameras: cameras.to_vec(),
        seed: settings.run.seed,
        method: method.clone(),
        environment,
        config_toml: config_toml.clone(),
        duration_us: Some(to_us(settings.duration_s)),
        t_offset_us: 0,
        labels: settings.run.carried(),
    };
    Ok((0..settings.environments).filter_map(|e| u32::try_from(e).ok()).map(header).collect())
}

/// Warnings: to the user at once, and to the report.
#[derive(Default)]
struct Warnings(Vec<String>);

impl Warnings {
    fn add(&mut self, warning: String) {
        if !self.0.contains(&warning) {
            text::complain(&format!("warning: {warning}"));
            self.0.push(warning);
        }
    }
}

/// The stream on its way into the files.
struct Job {
    /// One per environment, as are `outputs` and `writers`.
    headers: Vec<RecordingHeader>,
    tally: Tally,
    outputs: Vec<PathBuf>,
    overwrite: bool,
    /// Made when the first packet is there: a run that fails at the start leaves no file.
    writers: Vec<RecordingWriter>,
    flushed: Instant,
}

impl Job {
    /// Streams `duration_us` into the files; tells whether it was interrupted.
    fn stream(&mut self, simulator: Simulator, duration_us: i64) -> anyhow::Result<bool> {
        let interrupt = Interrupt::listen();
        let progress = Progress::new(u64::try_from(duration_us).unwrap_or(0));
        let started = Instant::now();
        for packet in simulator.stream(duration_us, PACKET_US)? {
            let packet = packet?;
            let writing = Instant::now();
            self.write(&packet)?;
            self.tally.add(&packet, writing.elapsed());
            progress.stream(packet.end_us, self.tally.report.events, started.elapsed());
            if interrupt.asked() {
                break;
            }
        }
        Ok(interrupt.asked() && self.tally.end_us < duration_us)
    }

    /// Closes the files with `report_json` in them.
    fn finish(&mut self, report_json: &str) -> anyhow::Result<()> {
        let writing = Instant::now();
        self.create_writers()?;
        for writer in self.writers.drain(..) {
            writer.finish(report_json)?;
        }
        self.tally.write += writing.elapsed();
        Ok(())
    }

    fn create_writers(&mut self) -> anyhow::Result<()> {
        for (path, header) in self.outputs.iter().zip(&self.headers).skip(self.writers.len()) {
            self.writers.push(RecordingWriter::create(path, header, self.overwrite)?);
        }
        Ok(())
    }

    fn write(&mut self, packet: &Packet) -> anyhow::Result<()> {
        self.create_writers()?;
        for view in &packet.views {
            let writer = self
                .writers
                .get_mut(view.environment)
                .with_context(|| format!("the engine sent environment {}, one too many", view.environment))?;
            writer.write_caused_events(view.camera, &view.events, &view.causes)?;
            for label in &view.labels {
                writer.write_label(view.camera, label)?;
            }
            for pose in &view.poses {
                writer.write_pose(view.camera, pose)?;
            }
        }
        if self.flushed.elapsed() >= FLUSH_EVERY {
            for writer in &mut self.writers {
                writer.flush()?;
            }
            self.flushed = Instant::now();
        }
        Ok(())
    }

    /// After an error: files that hold nothing are removed, the others closed as incomplete.
    fn give_up(&mut self, error: anyhow::Error) -> anyhow::Error {
        let created: Vec<_> = self.outputs.iter().take(self.writers.len()).collect();
        // A writer that goes stores what it holds, as far as it still can.
        self.writers.clear();
        if self.tally.packets == 0 {
            for path in created {
                // The first error is the one to tell.
                let _ = std::fs::remove_file(path);
            }
            return error;
        }
        let kept: Vec<_> = created.iter().map(|path| path.display().to_string()).collect();
        if kept.is_empty() {
            return error;
        }
        let until = text::seconds(self.tally.end_us);
        error.context(format!("{} ended before its time, at about {until}", kept.join(", ")))
    }
}

/// Counts of a view.
#[derive(Clone, Debug, Serialize)]
struct ViewTally {
    environment: usize,
    camera: String,
    width: u32,
    height: u32,
    events: u64,
    on: u64,
    off: u64,
    labels: u64,
}

impl ViewTally {
    fn pixels(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height)
    }
}

/// Counts and times of the run so far.
struct Tally {
    views: Vec<ViewTally>,
    cameras: usize,
    report: PacketReport,
    packets: u64,
    /// Frames beside the events, of all views.
    frames: u64,
    end_us: i64,
    write: Duration,
}

impl Tally {
    fn new(environments: usize, cameras: &[CameraInfo]) -> Self {
        let of = |environment, c: &CameraInfo| ViewTally {
            environment,
            camera: c.name.clone(),
            width: c.width,
            height: c.height,
            events: 0,
            on: 0,
            off: 0,
            labels: 0,
        };
        Self {
            views: (0..environments).flat_map(|e| cameras.iter().map(move |c| of(e, c))).collect(),
            cameras: cameras.len(),
            report: PacketReport::default(),
            packets: 0,
            frames: 0,
            end_us: 0,
            write: Duration::ZERO,
        }
    }

    fn add(&mut self, packet: &Packet, write: Duration) {
        for view in &packet.views {
            if let Some(tally) = self.views.get_mut(view.environment * self.cameras + view.camera) {
                let on = view.events.iter().filter(|e| e.p == 1).count() as u64;
                tally.events += view.events.len() as u64;
                tally.on += on;
                tally.off += view.events.len() as u64 - on;
                tally.labels += view.labels.len() as u64;
                let frames = view.labels.iter().filter(|label| label.kind == LabelKind::Frame);
                self.frames += frames.count() as u64;
            }
        }
        let (sum, new) = (&mut self.report, &packet.report);
        sum.events += new.events;
        sum.dropped += new.dropped;
        sum.suppressed += new.suppressed;
        sum.clamped += new.clamped;
        sum.instants += new.instants;
        sum.reruns += new.reruns;
        sum.audited += new.audited;
        sum.audited_with_others += new.audited_with_others;
        sum.changed += new.changed;
        sum.findings.extend_from_slice(&new.findings);
        sum.drawn_pixels += new.drawn_pixels;
        sum.keyframes += new.keyframes;
        sum.unknown += new.unknown;
        add_times(&mut sum.times, &new.times);
        self.packets += 1;
        self.end_us = packet.end_us;
        self.write += write;
    }
}

fn add_times(sum: &mut StageTimes, new: &StageTimes) {
    sum.host_ms += new.host_ms;
    sum.device_wait_ms += new.device_wait_ms;
    sum.pack_ms += new.pack_ms;
    sum.total_ms += new.total_ms;
}

/// Milliseconds of work per stage, summed over the run.
#[derive(Debug, Serialize)]
struct Milliseconds {
    setup: f64,
    host: f64,
    device_wait: f64,
    pack: f64,
    packets: f64,
    write: f64,
}

/// What `--report` and `--json` tell.
#[derive(Debug, Serialize)]
struct Report {
    outputs: Vec<PathBuf>,
    interrupted: bool,
    device: DeviceSummary,
    settings: Settings,
    stream_s: f64,
    wall_s: f64,
    /// Stream seconds per second of work.
    real_time_factor: f64,
    events: u64,
    on: u64,
    off: u64,
    /// Per second of work.
    events_per_second: f64,
    /// Per second of stream time.
    events_per_stream_second: f64,
    /// Lost to the readout's rate limit.
    dropped: u64,
    /// Lost to refractory periods.
    suppressed: u64,
    clamped: u64,
    /// How instants were sampled.
    method: &'static str,
    instants: u64,
    /// Pixels drawn, all views and instants, each by all of its samples.
    drawn_pixels: u64,
    keyframes: u64,
    /// Pixels and instants that the method could not know.
    unknown: u64,
    reruns: u64,
    /// Tiles that were skipped or sampled less often, and were rendered once more to compare.
    audited: u64,
    /// Of those: tiles that were compared by samples at other places than those of the stream.
    audited_with_others: u64,
    /// Of the audited ones: tiles in which light had changed by more than half a threshold.
    changed: u64,
    packets: u64,
    /// Beside the events, of all views.
    frames: u64,
    milliseconds: Milliseconds,
    views: Vec<ViewTally>,
    warnings: Vec<String>,
}

impl Report {
    fn new(
        settings: &Settings,
        device: &DeviceSummary,
        job: &Job,
        warnings: &Warnings,
        setup: Duration,
        wall: Duration,
        interrupted: bool,
    ) -> Self {
        let tally = &job.tally;
        let wall_s = wall.as_secs_f64();
        let stream_s = tally.end_us as f64 / 1.0e6;
        let (on, off) = tally.views.iter().fold((0, 0), |(on, off), v| (on + v.on, off + v.off));
        let per = |n: u64, s: f64| if s > 0.0 { n as f64 / s } else { 0.0 };
        let times = tally.report.times;
        Self {
            outputs: job.outputs.clone(),
            interrupted,
            device: device.clone(),
            settings: settings.clone(),
            stream_s,
            wall_s,
            real_time_factor: if wall_s > 0.0 { stream_s / wall_s } else { 0.0 },
            events: on + off,
            on,
            off,
            events_per_second: per(on + off, wall_s),
            events_per_stream_second: per(on + off, stream_s),
            dropped: tally.report.dropped,
            suppressed: tally.report.suppressed,
            clamped: tally.report.clamped,
            method: settings.run.method.name(),
            instants: tally.report.instants,
            drawn_pixels: tally.report.drawn_pixels,
            keyframes: tally.report.keyframes,
            unknown: tally.report.unknown,
            reruns: tally.report.reruns,
            audited: tally.report.audited,
            audited_with_others: tally.report.audited_with_others,
            changed: tally.report.changed,
            packets: tally.packets,
            frames: tally.frames,
            milliseconds: Milliseconds {
                setup: setup.as_secs_f64() * 1.0e3,
                host: times.host_ms,
                device_wait: times.device_wait_ms,
                pack: times.pack_ms,
                packets: times.total_ms,
                write: tally.write.as_secs_f64() * 1.0e3,
            },
            views: tally.views.clone(),
            warnings: warnings.0.clone(),
        }
    }

    /// `native, 4 samples, 1000 instants`, of a run that drew `drawn` pictures' pixels.
    fn rendered_line(&self, run: &RunConfig, drawn: f64) -> String {
        let shaded = if run.antialias == Antialias::Edges { ", 1 in 4 shaded" } else { "" };
        let rays = if run.shadows == Some(Shadows::Rays) { ", shadows by rays" } else { "" };
        let mut line = format!("{}, {} samples{shaded}{rays}, ", self.method, run.samples);
        if let Some(px) = run.adaptive_px {
            let hz = if self.stream_s > 0.0 { drawn / self.stream_s } else { 0.0 };
            let curves = if run.takes_curves() { ", curves between them" } else { "" };
            line += &format!(
                "every {px} px at up to {} Hz{curves}, {hz:.0} pictures' pixels per second, ",
                run.rate_hz
            );
        }
        line + &format!("{} instants", text::grouped(self.instants))
    }

    /// `native, 1000 instants`, `splat 30 Hz ×8, 31 keyframes, 241 instants, 17 pixels unknown`.
    fn method_line(&self) -> String {
        let instants = text::grouped(self.instants);
        match self.settings.run.method.keyframes() {
            None => {
                let run = &self.settings.run;
                let drawn =
                    self.drawn_pixels as f64 / self.views.iter().map(ViewTally::pixels).sum::<f64>().max(1.0);
                let mut line = if run.method == Method::Decoupled {
                    format!("{}, {drawn:.0} evaluations of a pixel, each at its own times", self.method)
                } else {
                    self.rendered_line(run, drawn)
                };
                if let Some(quality) = run.quality {
                    line += &format!(
                        "\n                   quality {}: {}",
                        quality.name(),
                        quality.measured(&run.method)
                    );
                }
                line
            }
            Some((keyframe_hz, steps)) => format!(
                "{} {keyframe_hz} Hz ×{steps}, {} keyframes, {instants} instants, {} pixels unknown",
                self.method,
                text::grouped(self.keyframes),
                text::grouped(self.unknown)
            ),
        }
    }

    /// The same for people.
    fn summary(&self) -> String {
        let mut lines = Vec::new();
        for (environment, output) in self.outputs.iter().enumerate() {
            let of = self.views.iter().filter(|v| v.environment == environment);
            let cameras: Vec<_> = of
                .map(|v| format!("{} {}x{}: {} events", v.camera, v.width, v.height, text::grouped(v.events)))
                .collect();
            lines.push(format!("{}  ({})", output.display(), cameras.join(", ")));
        }
        let stopped = if self.interrupted { " (interrupted; the file is complete up to here)" } else { "" };
        lines.push(format!("device             {}", self.device.name));
        lines.push(format!("method             {}", self.method_line()));
        lines.push(format!("stream             {} s{stopped}", self.stream_s));
        lines.push(format!(
            "events             {}  ({:.1} % ON)",
            text::grouped(self.events),
            text::percent(self.on, self.events)
        ));
        if let Some(rate_hz) = self.settings.run.frame_rate_hz {
            lines.push(format!(
                "frames             {}, each {} ms at {rate_hz} Hz",
                text::grouped(self.frames),
                self.settings.run.exposure_us as f64 * 1e-3
            ));
        }
        lines.push(format!(
            "events per second  {} of work, {} of stream",
            text::short(self.events_per_second),
            text::short(self.events_per_stream_second)
        ));
        lines
            .push(format!("real-time factor   {:.4}  ({:.1} s of work)", self.real_time_factor, self.wall_s));
        let ms = &self.milliseconds;
        lines.push(format!(
            "milliseconds       setup {:.0}, host {:.0}, device wait {:.0}, pack {:.0}, write {:.0}",
            ms.setup, ms.host, ms.device_wait, ms.pack, ms.write
        ));
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_environments_get_numbered_files() {
        let paths = output_paths(Path::new("out/a.b.h5"), 2);
        assert_eq!(paths, [PathBuf::from("out/a.b_0000.h5"), PathBuf::from("out/a.b_0001.h5")]);
        assert_eq!(output_paths(Path::new("x.h5"), 1), [PathBuf::from("x.h5")]);
    }

    #[test]
    fn all_settings_can_be_stored_and_read_back() {
        let mut config =
            RunConfig { size: Some((64, 48)), reference_luminance: Some(0.5), ..RunConfig::default() };
        config.cameras.push("left".into());
        config.labels.extend(evis_core::LabelKind::ALL);
        let settings = Settings {
            evis: "0",
            scene: "spinner".into(),
            speed: 1.0,
            environments: 1,
            duration_s: 0.5,
            packet_us: PACKET_US,
            camera_motion: None,
            run: config.clone(),
        };
        let stored: toml::Table = headers(&settings, &[]).unwrap()[0].config_toml.parse().unwrap();
        let run: RunConfig = stored["run"].clone().try_into().unwrap();
        assert_eq!(run, config);
        assert_ne!(run, RunConfig::default(), "canary: the comparison must see a difference");
    }
}
