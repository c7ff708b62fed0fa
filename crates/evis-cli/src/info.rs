//! `info`: what a recording holds; `--repair` makes one that was cut off readable for every reader.

use std::path::Path;

use evis_core::format::FormatError;
use evis_core::format::hdf5::{self, Recording, RepairReport, stored_sensor};
use evis_core::sensor::PRESETS;
use evis_core::{CameraInfo, ImuSample, SensorConfig};
use serde::Serialize;

use crate::args::InfoArgs;
use crate::failure::bad_input;
use crate::scene_info::{self, ClassLine};
use crate::{convert, extent, text};

#[derive(Serialize)]
struct Info {
    file: String,
    /// Closed in good order; a file that was cut off is not.
    complete: bool,
    /// Closed in good order before the stream was as long as asked, by Ctrl-C.
    interrupted: bool,
    /// The length that was asked for; none where the settings do not tell.
    asked_s: Option<f64>,
    repaired: Option<Repaired>,
    seed: u64,
    method: String,
    environment: u32,
    duration_s: f64,
    events: u64,
    on: u64,
    off: u64,
    cameras: Vec<CameraLine>,
    /// Inertial measurement units.
    imus: Vec<ImuLine>,
    /// What a host said of its own state.
    states: Vec<StateLine>,
    /// Semantic classes that have a name.
    classes: Vec<ClassLine>,
    /// The settings as they are stored.
    settings_toml: String,
}

/// What `--repair` did.
#[derive(Serialize)]
struct Repaired {
    /// The mark that a killed writer leaves is gone.
    reopened: bool,
    /// The file ended before its content did.
    cut_short: bool,
    events_saved: u64,
    /// Events that the file promised.
    events_promised: u64,
    /// Of events, labels, poses, inertial samples and states.
    rows_dropped: u64,
    millis_rebuilt: u64,
    report_dropped: bool,
    /// Rows that could not be read.
    holes: Vec<String>,
    nothing_to_do: bool,
}

impl Repaired {
    fn of(report: &RepairReport) -> Self {
        let saved: u64 = report.events.iter().map(|(_, events)| events).sum();
        Self {
            reopened: report.reopened,
            cut_short: report.cut_short,
            events_saved: saved,
            events_promised: saved + report.events_dropped,
            rows_dropped: report.rows_dropped,
            millis_rebuilt: report.millis_rebuilt,
            report_dropped: report.report_dropped,
            holes: report.holes.iter().map(ToString::to_string).collect(),
            nothing_to_do: report.nothing_to_do(),
        }
    }

    /// `cut off, and repaired: 12 of 20 events could be saved; ...`.
    fn in_words(&self) -> String {
        let why = if self.cut_short || self.reopened { "cut off" } else { "damaged" };
        let mut text = format!(
            "{why}, and repaired: {} of {} events could be saved",
            text::grouped(self.events_saved),
            text::grouped(self.events_promised)
        );
        let others = self.rows_dropped - (self.events_promised - self.events_saved);
        if others > 0 {
            text += &format!(
                "; {} rows of labels, poses, inertial samples and states were dropped",
                text::grouped(others)
            );
        }
        if self.millis_rebuilt > 0 {
            text += "; ms_to_idx was mended";
        }
        if self.report_dropped {
            text += "; the run's report is lost";
        }
        for hole in &self.holes {
            text += &format!("; {hole} are gone");
        }
        text + "; every reader opens it, and it does not count as complete"
    }
}

#[derive(Serialize)]
struct CameraLine {
    name: String,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    events: u64,
    on: u64,
    off: u64,
    on_percent: f64,
    events_per_second: f64,
    events_per_pixel_and_second: f64,
    poses: usize,
    labels: Vec<LabelLine>,
    /// A preset, or its thresholds; none where the settings do not tell.
    sensor: Option<String>,
}

/// A state of a host.
#[derive(Serialize)]
struct StateLine {
    name: String,
    rows: usize,
    /// Names of its values.
    values: Vec<String>,
}

#[derive(Serialize)]
struct ImuLine {
    name: String,
    samples: usize,
    first_s: Option<f64>,
    last_s: Option<f64>,
}

#[derive(Serialize)]
struct LabelLine {
    kind: &'static str,
    frames: usize,
    first_s: Option<f64>,
    last_s: Option<f64>,
}

/// Describes a recording.
pub(crate) fn info(args: &InfoArgs) -> anyhow::Result<i32> {
    if !args.repair && !args.check && scene_info::is_scene(&args.input) {
        if let Some(camera) = &args.camera {
            return Err(bad_input(format!(
                "--camera is '{camera}', but {} is a scene; leave it out: all cameras are listed",
                args.input.display()
            )));
        }
        return scene_info::info(&args.input, args.animation.animation.as_deref(), args.json);
    }
    if let Some(animation) = &args.animation.animation {
        return Err(bad_input(format!(
            "--animation is '{animation}', but {} is no scene; leave it out",
            args.input.display()
        )));
    }
    // Recordings of EVIS have more to tell; a damaged one is explained by their own reader.
    let other = match evis_format::recognise(&args.input)? {
        Some(evis_format::Format::Hdf5) | None => false,
        Some(_) => true,
    };
    if !args.repair
        && !args.check
        && (other || (Recording::open(&args.input).is_err() && convert::reads(&args.input)))
    {
        return convert::info(&args.input, args.camera.as_deref(), args.json);
    }
    if args.check {
        check(&args.input)?;
    }
    let repaired = if args.repair { Some(Repaired::of(&hdf5::repair(&args.input)?)) } else { None };
    let recording = Recording::open(&args.input)?;
    let header = recording.header();
    let duration_s = extent::end_us(&recording)? as f64 / 1.0e6;
    let only = args.camera.as_deref().map(|name| recording.find_camera(Some(name))).transpose()?;
    let mut cameras = Vec::new();
    for (index, camera) in header.cameras.iter().enumerate() {
        if only.is_some_and(|only| only != index) {
            continue;
        }
        cameras.push(camera_line(&recording, index, camera, duration_s)?);
    }
    let mut imus = Vec::new();
    for name in recording.imus()? {
        let samples = recording.imu(&name)?;
        let s = |sample: &ImuSample| sample.t_us as f64 / 1.0e6;
        let (first_s, last_s) = (samples.first().map(s), samples.last().map(s));
        imus.push(ImuLine { name, samples: samples.len(), first_s, last_s });
    }
    let mut states = Vec::new();
    for name in recording.states()? {
        let state = recording.state(&name)?;
        states.push(StateLine { name, rows: state.t_us.len(), values: state.names });
    }
    let info = Info {
        file: args.input.display().to_string(),
        complete: recording.is_complete()?,
        interrupted: was_interrupted(&recording)?,
        asked_s: asked_s(&header.config_toml),
        repaired,
        seed: header.seed,
        method: header.method.clone(),
        environment: header.environment,
        duration_s,
        events: cameras.iter().map(|c| c.events).sum(),
        on: cameras.iter().map(|c| c.on).sum(),
        off: cameras.iter().map(|c| c.off).sum(),
        cameras,
        imus,
        states,
        classes: ClassLine::of(&recording.body_infos()?),
        settings_toml: header.config_toml.clone(),
    };
    if args.json {
        text::say_json(&info)?
    } else {
        text::say(&describe(&info))
    }
    Ok(0)
}

/// Reads everything, and names what is damaged.
fn check(path: &Path) -> anyhow::Result<()> {
    let report = hdf5::check(path)?;
    let mut damage: Vec<String> = report.holes.iter().map(|hole| format!("{hole} cannot be read")).collect();
    if report.cut_short {
        damage.push("it ends before its content does".into());
    }
    if report.reopened {
        damage.push("it is being written, or its writer was killed".into());
    }
    if report.rows_dropped > 0 {
        let (events, rows) = (text::grouped(report.events_dropped), text::grouped(report.rows_dropped));
        damage.push(format!("{rows} rows are missing, {events} of them events"));
    }
    if report.millis_rebuilt > 0 {
        damage.push(format!("{} entries of ms_to_idx do not fit", text::grouped(report.millis_rebuilt)));
    }
    if report.report_dropped {
        damage.push("the run's report is missing".into());
    }
    if damage.is_empty() {
        return Ok(());
    }
    let remedy = "keep the rest with info --repair, or copy it again from its source";
    Err(FormatError::corrupt(path, damage.join("; "), remedy).into())
}

/// Whether the writer's report says so.
fn was_interrupted(recording: &Recording) -> anyhow::Result<bool> {
    let report = recording.report()?.and_then(|json| serde_json::from_str::<serde_json::Value>(&json).ok());
    Ok(report.and_then(|report| report.get("interrupted")?.as_bool()).unwrap_or(false))
}

/// `duration_s` of the settings.
fn asked_s(config_toml: &str) -> Option<f64> {
    config_toml.parse::<toml::Table>().ok()?.get("duration_s")?.as_float()
}

fn camera_line(
    recording: &Recording,
    index: usize,
    camera: &CameraInfo,
    duration_s: f64,
) -> anyhow::Result<CameraLine> {
    let promised = recording.event_count(index)?;
    let (mut events, mut on) = (0, 0);
    extent::for_each_piece(recording, index, |piece| {
        events += piece.len() as u64;
        on += piece.iter().filter(|e| e.p == 1).count() as u64;
    })?;
    if events < promised {
        let camera = &camera.name;
        return Err(FormatError::corrupt(
            recording.path(),
            format!("{camera}/ms_to_idx leads to {events} of {promised} events only"),
            "copy it again from its source, or record it again",
        )
        .into());
    }
    let mut labels = Vec::new();
    for kind in recording.label_kinds(index)? {
        let times = recording.label_times(index, *kind)?;
        let s = |t: &i64| *t as f64 / 1.0e6;
        labels.push(LabelLine {
            kind: kind.name(),
            frames: times.len(),
            first_s: times.first().map(s),
            last_s: times.last().map(s),
        });
    }
    let rate = if duration_s > 0.0 { events as f64 / duration_s } else { 0.0 };
    let (sensor, _) = stored_sensor(&recording.header().config_toml, &camera.name);
    Ok(CameraLine {
        sensor: in_words(&sensor),
        events,
        on,
        off: events - on,
        on_percent: text::percent(on, events),
        events_per_second: rate,
        events_per_pixel_and_second: rate / (f64::from(camera.width) * f64::from(camera.height)).max(1.0),
        poses: recording.poses(index)?.len(),
        labels,
        name: camera.name.clone(),
        width: camera.width,
        height: camera.height,
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
    })
}

/// `davis346`, or `of its own, thresholds 0.25 and 0.2`.
fn in_words(sensor: &SensorConfig) -> Option<String> {
    let is = |name: &str| SensorConfig::preset(name).is_ok_and(|preset| preset == *sensor);
    let preset = PRESETS.iter().find(|preset| is(preset.name)).map(|preset| preset.name.to_owned());
    let SensorConfig { threshold_on: on, threshold_off: off, .. } = *sensor;
    preset.or_else(|| on.is_finite().then(|| format!("of its own, thresholds {on} and {off}")))
}

fn describe(info: &Info) -> String {
    let state = match (info.complete, &info.repaired) {
        (_, Some(repaired)) if !repaired.nothing_to_do => repaired.in_words(),
        (true, _) if info.interrupted => {
            let asked = info.asked_s.map_or_else(String::new, |s| format!(" of the {s} s asked for"));
            format!("interrupted (Ctrl-C) after {} s{asked}; complete up to there", info.duration_s)
        }
        (true, _) => "complete".into(),
        (false, Some(_)) => "not complete, and nothing to repair: every reader opens it".into(),
        (false, None) => {
            "not complete: being written, or cut off; `info --repair` then lets every reader open it".into()
        }
    };
    let mut lines = vec![format!(
        "{}  {state}\nduration  {} s\nevents    {}  ({:.1} % ON)\nseed      {}",
        info.file,
        info.duration_s,
        text::grouped(info.events),
        text::percent(info.on, info.events),
        info.seed
    )];
    for c in &info.cameras {
        lines.push(format!(
            "camera {}  {}x{}, fx {:.3}, fy {:.3}, cx {:.3}, cy {:.3}\n  events  {} ON, {} OFF ({:.1} % ON)\n  rate    \
             {} events/s, {:.2} per pixel and second\n  poses   {}",
            c.name,
            c.width,
            c.height,
            c.fx,
            c.fy,
            c.cx,
            c.cy,
            text::grouped(c.on),
            text::grouped(c.off),
            c.on_percent,
            text::short(c.events_per_second),
            c.events_per_pixel_and_second,
            c.poses,
        ));
        if let Some(sensor) = &c.sensor {
            lines.push(format!("  sensor  {sensor}"));
        }
        for l in &c.labels {
            lines.push(format!(
                "  label   {}: {} frames from {} s to {} s",
                l.kind,
                l.frames,
                l.first_s.unwrap_or_default(),
                l.last_s.unwrap_or_default(),
            ));
        }
    }
    for imu in &info.imus {
        lines.push(format!(
            "imu {}  {} samples from {} s to {} s",
            imu.name,
            text::grouped(imu.samples as u64),
            imu.first_s.unwrap_or_default(),
            imu.last_s.unwrap_or_default(),
        ));
    }
    for state in &info.states {
        let (rows, values) = (text::grouped(state.rows as u64), state.values.join(", "));
        lines.push(format!("state {}  {rows} rows of {values}", state.name));
    }
    lines.extend(ClassLine::in_words(&info.classes).map(|classes| format!("classes  {classes}")));
    lines.push("settings".into());
    lines.extend(info.settings_toml.lines().map(|line| format!("  {line}")));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repair_is_told_with_what_it_saved_and_what_not() {
        let report = RepairReport {
            cut_short: true,
            events: vec![("a".into(), 10), ("b".into(), 2)],
            events_dropped: 5,
            rows_dropped: 8,
            report_dropped: true,
            ..Default::default()
        };
        let told = Repaired::of(&report).in_words();
        for words in [
            "cut off",
            "12 of 17 events",
            "3 rows of labels, poses, inertial samples and states were dropped",
            "report is lost",
            "not count",
        ] {
            assert!(told.contains(words), "{told} lacks '{words}'");
        }
        let told = Repaired::of(&RepairReport { millis_rebuilt: 3, ..Default::default() }).in_words();
        assert!(
            told.starts_with("damaged") && told.contains("ms_to_idx") && !told.contains("lost"),
            "{told}"
        );
    }

    #[test]
    fn the_length_asked_for_is_that_of_the_settings() {
        assert_eq!(asked_s("duration_s = 3.0\n[run]\nseed = 1\n"), Some(3.0));
        assert_eq!(asked_s("[run]\nduration_s = 3.0\n"), None);
        assert_eq!(asked_s("not toml"), None);
    }
}
