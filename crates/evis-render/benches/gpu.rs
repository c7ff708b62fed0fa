//! What methods cost with many cameras: the table of `make bench-gpu`, in Markdown and JSON.
//!
//! `make bench-gpu` takes the fastest adapter, `EVIS_DEVICE` chooses another. On a software driver it measures small
//! pictures and few cameras, and says so; `-- small` and `-- full` choose. `-- out=FOLDER` is where the tables go.

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Instant;

use evis_core::{TriggerRule, Warp};
use evis_render::gpu::work::Counts;
use evis_render::scene::{Scene, Variant};
use evis_render::{Antialias, Compute, DeviceSummary, Gpu, Interpolation, Method, RunConfig, Simulator};
use serde::Serialize;

/// Whatever ends a measurement.
type Failure = Box<dyn std::error::Error>;

/// Stream that is simulated before anything is measured: pipelines are compiled, and buffers have grown.
const WARM_UP_US: i64 = 64_000;
/// Stream between two looks at the clock.
const STEP_US: i64 = 64_000;
/// A measurement goes on for so many seconds, or so many steps.
const ENOUGH_S: f64 = 1.0;
const MOST_STEPS: i64 = 8;
/// The built-in scene that is simulated; environments differ by where in it they begin.
const SCENE: &str = "desk";

/// Cameras at a size, an environment each.
type Load = (usize, (u32, u32));
const FULL: [Load; 4] = [(1, (640, 480)), (16, (640, 480)), (64, (640, 480)), (256, (64, 64))];
const SMALL: [Load; 3] = [(1, (160, 120)), (4, (160, 120)), (16, (64, 64))];

/// A row of the table.
#[derive(Serialize)]
struct Row {
    method: String,
    cameras: usize,
    width: u32,
    height: u32,
    /// Seconds of stream that were measured.
    stream_s: f64,
    wall_s: f64,
    /// Wall milliseconds per instant and camera.
    ms_per_frame: f64,
    /// Seconds of stream, of all cameras at once, per second of wall clock.
    real_time: f64,
    events: u64,
    /// Per millisecond of stream, of all cameras together.
    submissions_per_ms: f64,
    passes_per_ms: f64,
    dispatches_per_ms: f64,
    /// Bytes of luminance that are drawn, per pixel and second of stream: 4 for every pixel and sample of it.
    luminance_bytes: f64,
    /// Bytes of events that are read back, per pixel and second of stream: 8 for each.
    event_bytes: f64,
}

#[derive(Serialize)]
struct Table {
    device: DeviceSummary,
    small: bool,
    scene: &'static str,
    rows: Vec<Row>,
    /// Settings that did not fit the device.
    not_measured: Vec<String>,
}

/// A method by name, instants per second that it fires at, and layers per pixel that it draws.
struct Setting {
    name: &'static str,
    config: RunConfig,
    frames_hz: f64,
    samples: u32,
}

/// The settings that the EVIS paper publishes, then `native` in adaptive time.
fn settings(size: (u32, u32)) -> Vec<Setting> {
    let base = RunConfig {
        size: Some(size),
        rate_hz: 1000.0,
        reference_luminance: Some(0.5),
        audit: 0.0,
        ..RunConfig::default()
    };
    // How many samples the paper's renderer takes is not stated; 4 stand for it, as in `make chart`.
    let mut paper = RunConfig { samples: 4, ..base.clone() };
    paper.sensor.trigger = TriggerRule::Latch;
    let warp = |name, keyframe_hz: f64, steps: u32| Setting {
        name,
        config: RunConfig {
            method: Method::Splat(Warp::evis_paper(steps).at(keyframe_hz, steps)),
            ..paper.clone()
        },
        frames_hz: keyframe_hz * f64::from(steps),
        samples: 4,
    };
    let adaptive = RunConfig {
        adaptive_px: Some(0.5),
        between: Interpolation::Curve,
        antialias: Antialias::Edges,
        samples: 16,
        ..base.clone()
    };
    let decoupled = |compute| RunConfig { method: Method::Decoupled, compute, ..base.clone() };
    // Each pixel at its own times: no frames, and no luminance is drawn.
    let continuous =
        |name, compute| Setting { name, config: decoupled(compute), frames_hz: 1000.0, samples: 0 };
    vec![
        Setting { name: "paper: 1000 Hz rendered", config: paper.clone(), frames_hz: 1000.0, samples: 4 },
        warp("paper: 250×4", 250.0, 4),
        warp("paper: 125×8", 125.0, 8),
        warp("paper: 40×8", 40.0, 8),
        warp("paper: 30×8", 30.0, 8),
        Setting {
            name: "native, 0.5 px, 16 coverage samples",
            config: adaptive,
            frames_hz: 1000.0,
            samples: 16,
        },
        continuous("decoupled, on the processor", Compute::Cpu),
        continuous("decoupled, by compute passes", Compute::Gpu),
    ]
}

/// `scene` in `count` environments, which begin at other times.
fn environments(scene: &Scene, count: usize) -> Arc<Scene> {
    let variants = (0..count)
        .map(|n| Variant { time_offset_s: 1.5 * n as f64 / count as f64, ..Variant::default() })
        .collect();
    let mut scene = scene.clone();
    scene.cameras.truncate(1);
    Arc::new(Scene { variants, ..scene })
}

/// Simulates `setting` for `scene`, and measures.
fn run(gpu: &Gpu, scene: Arc<Scene>, setting: &Setting) -> Result<Row, Failure> {
    let cameras = scene.variants.len();
    let (width, height) = setting.config.size.ok_or("every setting has a size")?;
    let mut simulator = Simulator::new(gpu, scene, setting.config.clone())?;
    simulator.step(WARM_UP_US)?;
    let before = gpu.counts();
    let (mut wall_s, mut steps, mut events, mut drawn) = (0.0, 0, 0, 0);
    while wall_s < ENOUGH_S && steps < MOST_STEPS {
        steps += 1;
        let started = Instant::now();
        let packet = simulator.step(WARM_UP_US + steps * STEP_US)?;
        wall_s += started.elapsed().as_secs_f64();
        events += packet.report.events;
        drawn += packet.report.drawn_pixels;
    }
    let now = gpu.counts();
    let stream_s = (steps * STEP_US) as f64 * 1e-6;
    let per_ms = |count: fn(&Counts) -> u64| (count(&now) - count(&before)) as f64 / (stream_s * 1e3);
    let pixels = f64::from(width) * f64::from(height) * cameras as f64;
    Ok(Row {
        method: setting.name.to_owned(),
        cameras,
        width,
        height,
        stream_s,
        wall_s,
        ms_per_frame: wall_s * 1e3 / (stream_s * setting.frames_hz * cameras as f64),
        real_time: stream_s / wall_s,
        events,
        submissions_per_ms: per_ms(|counts| counts.submissions),
        passes_per_ms: per_ms(|counts| counts.passes),
        dispatches_per_ms: per_ms(|counts| counts.dispatches),
        luminance_bytes: drawn as f64 * f64::from(4 * setting.samples) / (pixels * stream_s),
        event_bytes: events as f64 * 8.0 / (pixels * stream_s),
    })
}

fn markdown(table: &Table) -> String {
    let DeviceSummary { name, backend, kind, driver, .. } = &table.device;
    let mut out = format!(
        "# Cost on {name}\n\n{name} ({kind}, {backend}, {driver}). Scene `{}`, one environment per camera, {WARM_UP_US} µs of \
         stream before the measurement.\n",
        table.scene
    );
    if table.small {
        out += "\nA software driver, so pictures are small and cameras few: no figure of a GPU.\n";
    }
    out += "\nA frame is an instant of a camera; of decoupled sampling, which has none, a millisecond. Real time: seconds of stream, of all cameras at once, per second. Per \
            millisecond of stream and for all cameras together: submissions, passes, dispatches. Per pixel and second of \
            stream: bytes of luminance drawn (4 per pixel and sample), bytes of events read back (8 per event).\n\n\
            | method | cameras | ms per frame | real time | submissions | passes | dispatches | luminance, B | events, B |\n\
            |---|---|--:|--:|--:|--:|--:|--:|--:|\n";
    for row in &table.rows {
        let _ = writeln!(
            out,
            "| {} | {} × {}×{} | {:.3} | {:.3} | {:.3} | {:.2} | {:.2} | {:.0} | {:.1} |",
            row.method,
            row.cameras,
            row.width,
            row.height,
            row.ms_per_frame,
            row.real_time,
            row.submissions_per_ms,
            row.passes_per_ms,
            row.dispatches_per_ms,
            row.luminance_bytes,
            row.event_bytes
        );
    }
    if !table.not_measured.is_empty() {
        out += "\nNot measured:\n\n";
    }
    for line in &table.not_measured {
        let _ = writeln!(out, "- {line}");
    }
    out
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let gpu = Gpu::open(std::env::var("EVIS_DEVICE").ok().as_deref())?;
    let device = gpu.summary().clone();
    let small = match args.iter().find(|arg| ["small", "full"].contains(&arg.as_str())) {
        Some(word) => word == "small",
        None => device.kind == "cpu",
    };
    let folder = args.iter().find_map(|arg| arg.strip_prefix("out=")).unwrap_or("out");
    let scene = evis_render::scene::builtin::load(SCENE, 0)?;
    let loads: &[Load] = if small { &SMALL } else { &FULL };
    let mut table = Table { device, small, scene: SCENE, rows: Vec::new(), not_measured: Vec::new() };
    for (cameras, size) in loads {
        for setting in settings(*size) {
            eprintln!("{} with {cameras} cameras of {}x{}", setting.name, size.0, size.1);
            match run(&gpu, environments(&scene, *cameras), &setting) {
                Ok(row) => table.rows.push(row),
                Err(error) => {
                    table.not_measured.push(format!("{} with {cameras} cameras: {error}", setting.name))
                }
            }
        }
    }
    if table.rows.is_empty() {
        return Err(format!("nothing could be measured: {}", table.not_measured.join("; ")).into());
    }
    let text = markdown(&table);
    print!("{text}");
    std::fs::create_dir_all(folder)?;
    let path = |ending: &str| std::path::Path::new(folder).join(format!("bench-gpu.{ending}"));
    std::fs::write(path("md"), text)?;
    std::fs::write(path("json"), serde_json::to_string_pretty(&table)? + "\n")?;
    eprintln!("wrote {} and {}", path("md").display(), path("json").display());
    Ok(())
}
