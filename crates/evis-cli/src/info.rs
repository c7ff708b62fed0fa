//! `info`: what a recording holds; `--repair` makes one that was cut off readable for every reader.

use evis_core::LabelKind;
use evis_core::format::hdf5::{self, Recording};
use serde::Serialize;

use crate::args::InfoArgs;
use crate::text;

/// Events are counted in slices of this length, so that memory does not grow with the recording.
const SLICE_US: i64 = 1_000_000;

#[derive(Serialize)]
struct Info {
    file: String,
    /// Closed in good order; a file that was cut off is not.
    complete: bool,
    repaired: bool,
    seed: u64,
    duration_s: f64,
    events: u64,
    on: u64,
    off: u64,
    cameras: Vec<CameraLine>,
    /// The settings as they are stored.
    settings_toml: String,
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
    duration_s: f64,
    events: u64,
    on: u64,
    off: u64,
    on_percent: f64,
    events_per_second: f64,
    events_per_pixel_and_second: f64,
    poses: usize,
    labels: Vec<LabelLine>,
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
    let repaired = if args.repair { hdf5::repair(&args.input)? } else { false };
    let mut recording = Recording::open(&args.input)?;
    let mut cameras = Vec::new();
    for index in 0..recording.cameras().len() {
        cameras.push(camera_line(&mut recording, index)?);
    }
    let info = Info {
        file: args.input.display().to_string(),
        complete: recording.is_complete(),
        repaired,
        seed: recording.seed(),
        duration_s: cameras.iter().map(|c| c.duration_s).fold(0.0, f64::max),
        events: cameras.iter().map(|c| c.events).sum(),
        on: cameras.iter().map(|c| c.on).sum(),
        off: cameras.iter().map(|c| c.off).sum(),
        cameras,
        settings_toml: recording.config_toml().to_owned(),
    };
    if args.json {
        text::say_json(&info)?
    } else {
        text::say(&describe(&info))
    }
    Ok(0)
}

fn camera_line(recording: &mut Recording, index: usize) -> anyhow::Result<CameraLine> {
    let camera =
        recording.cameras().get(index).cloned().ok_or_else(|| anyhow::anyhow!("no camera {index}"))?;
    let end_us = recording.end_us(index)?;
    let (mut events, mut on) = (0, 0);
    let mut from_us = 0;
    while from_us < end_us {
        let until_us = from_us.saturating_add(SLICE_US);
        let slice = recording.events(index, from_us, until_us)?;
        events += slice.len() as u64;
        on += slice.iter().filter(|e| e.p == 1).count() as u64;
        from_us = until_us;
    }
    let mut labels = Vec::new();
    for kind in LabelKind::ALL {
        let times = recording.label_times(index, kind)?;
        if !times.is_empty() {
            let s = |t: &i64| *t as f64 * 1.0e-6;
            labels.push(LabelLine {
                kind: kind.name(),
                frames: times.len(),
                first_s: times.first().map(s),
                last_s: times.last().map(s),
            });
        }
    }
    let duration_s = end_us as f64 * 1.0e-6;
    let rate = if end_us > 0 { events as f64 / duration_s } else { 0.0 };
    Ok(CameraLine {
        duration_s,
        events,
        on,
        off: events - on,
        on_percent: text::percent(on, events),
        events_per_second: rate,
        events_per_pixel_and_second: rate / (f64::from(camera.width) * f64::from(camera.height)).max(1.0),
        poses: recording.poses(index)?.len(),
        labels,
        name: camera.name,
        width: camera.width,
        height: camera.height,
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
    })
}

fn describe(info: &Info) -> String {
    let state = match (info.complete, info.repaired) {
        (_, true) => "repaired: it was cut off, and reads plainly now",
        (true, false) => "complete",
        (false, false) => {
            "cut off: it holds what was flushed; `info --repair` makes it readable for every reader"
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
        for l in &c.labels {
            lines.push(format!(
                "  label   {}: {} frames from {} s to {} s",
                l.kind,
                l.frames,
                l.first_s.unwrap_or_default(),
                l.last_s.unwrap_or_default()
            ));
        }
    }
    lines.push("settings".into());
    lines.extend(info.settings_toml.lines().map(|line| format!("  {line}")));
    lines.join("\n")
}
