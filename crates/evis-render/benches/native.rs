//! What `native` costs, as ratios to a bare raster of the same triangles, measured in turn in one run.
//!
//! `cargo bench --bench native` (or `make bench`) prints Markdown; `-- ratios`, `-- sensors`, `-- methods`, `-- overhead` and
//! `-- memory` choose sections, `-- sensors v2e evis` presets. `EVIS_BENCH_REPETITIONS` sets the repetitions.

mod bare;
mod support;

use std::process::Command;
use std::sync::Arc;

use bare::Bare;
use evis_core::{SensorConfig, Warp};
use evis_render::bench::{Stage, Stages};
use evis_render::scene::Scene;
use evis_render::{DenseKind, DenseOutput, Gpu, Method, Polarities, RunConfig, Simulator};
use support::measure::{Series, measure, peak_memory_mib};
use support::{Failure, scenes};

const SIZE: [u32; 2] = [640, 480];
const RATE_HZ: f64 = 1000.0;
/// Instants per measurement: one submission of either side.
const INSTANTS: u32 = bare::INSTANTS;
/// Asks a child process for its memory.
const MEMORY_ARGUMENT: &str = "--memory-of-seconds";

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().collect();
    if let Some(at) = args.iter().position(|a| a == MEMORY_ARGUMENT) {
        let seconds = args.get(at + 1).ok_or("seconds are missing")?.parse()?;
        println!("{}", memory_of_stream(seconds)?);
        return Ok(());
    }
    let repetitions = match std::env::var("EVIS_BENCH_REPETITIONS") {
        Ok(text) => text.parse()?,
        Err(_) => 12,
    };
    let (device, queue, driver) = open()?;
    // Names of sections may follow; cargo adds options of its own.
    let named: Vec<&String> = args.iter().skip(1).filter(|a| !a.starts_with('-')).collect();
    let wanted = |section: &str| named.is_empty() || named.iter().any(|n| *n == section);
    print_header(&driver, repetitions);
    if wanted("ratios") {
        let mut rows = Vec::new();
        for detail in scenes::DETAILS {
            let scene = Arc::new(scenes::build(detail)?);
            rows.push(compare(&device, &queue, &scene, repetitions)?);
        }
        print_rows(&rows);
        print_stages(&rows);
    }
    if wanted("sensors") {
        sensors(&device, &queue, repetitions, &named)?;
    }
    if wanted("methods") {
        methods(&device, &queue, repetitions)?;
    }
    if wanted("overhead") {
        overhead(&device, &queue)?;
    }
    if wanted("memory") {
        memory()?;
    }
    Ok(())
}

/// The device that `Gpu::open` takes, opened here so that both sides share it.
fn open() -> Result<(wgpu::Device, wgpu::Queue, String), Failure> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(descriptor);
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    adapters.sort_by_key(|a| match a.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Cpu => 3,
        wgpu::DeviceType::Other => 4,
    });
    let adapter = adapters.first().ok_or("no device was found")?;
    let info = adapter.get_info();
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        required_limits: adapter.limits(),
        memory_hints: wgpu::MemoryHints::Performance,
        ..Default::default()
    }))?;
    Ok((device, queue, format!("{} ({} {})", info.name, info.driver, info.driver_info)))
}

/// One scene's measurements, each of [`INSTANTS`] instants.
struct Row {
    triangles: usize,
    bare: Series,
    /// Up to each stage.
    stages: Vec<Series>,
    full: Series,
    events: u64,
    instants: u64,
}

fn config() -> RunConfig {
    RunConfig { size: Some(SIZE.into()), rate_hz: RATE_HZ, samples: 1, ..Default::default() }
}

/// Bare, every stage and the whole simulator, in turn, over the same instants.
fn compare(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    scene: &Arc<Scene>,
    repetitions: u32,
) -> Result<Row, Failure> {
    let gpu = Gpu::from_device(device.clone(), queue.clone());
    let mut bare = Bare::new(device, queue, scene, SIZE)?;
    let mut stages = Stages::new(&gpu, scene.clone(), config(), 1 << 21)?;
    if stages.instants_per_submission() != INSTANTS {
        return Err("the engine's submissions are not as long as the yardstick's".into());
    }
    let mut simulator = Simulator::new(&gpu, scene.clone(), config())?;
    let mut row = Row {
        triangles: scenes::triangle_count(scene),
        bare: Series::default(),
        stages: vec![Series::default(); Stage::ALL.len()],
        full: Series::default(),
        events: 0,
        instants: 0,
    };
    // The first instants set the references and warm everything up.
    simulator.step(1)?;
    for repetition in 0..=repetitions {
        let first = 1 + i64::from(repetition * INSTANTS);
        let last = first + i64::from(INSTANTS) - 1;
        let times_s: Vec<f64> = (first..=last).map(|i| i as f64 / RATE_HZ).collect();
        let warming = repetition == 0;
        let (sample, _) = measure(|| bare.render(scene, &times_s))?;
        if !warming {
            row.bare.push(sample);
        }
        for (series, stage) in row.stages.iter_mut().zip(Stage::ALL) {
            let start = if warming { 0 } else { first };
            let (sample, _) = measure(|| stages.run(start, INSTANTS, stage, stage == Stage::Readback))?;
            if !warming {
                series.push(sample);
            }
        }
        // To the last instant's own microsecond: its submission is the last that is needed.
        let until_us = last * (1e6 / RATE_HZ) as i64;
        let (sample, packet) = measure(|| simulator.step(until_us))?;
        if !warming {
            row.full.push(sample);
            row.events += packet.report.events;
            row.instants += packet.report.instants;
        }
    }
    Ok(row)
}

fn print_header(driver: &str, repetitions: u32) {
    let output = |program: &str, args: &[&str]| {
        let out = Command::new(program).args(args).output().ok();
        out.map_or_else(String::new, |o| String::from_utf8_lossy(&o.stdout).trim().to_owned())
    };
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpu.lines().find_map(|l| l.strip_prefix("model name")).unwrap_or("unknown");
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    println!("# `native`, 640x480, 1 sample, textured diffuse material, one directional light\n");
    println!("- date: {}", output("date", &["-u", "+%Y-%m-%d"]));
    println!("- commit: {}", output("git", &["describe", "--always", "--dirty"]));
    println!("- CPU: {}, {cores} cores", cpu.trim_start_matches([' ', '\t', ':']));
    println!("- driver: {driver}");
    println!(
        "- {repetitions} repetitions of {INSTANTS} instants each, bare raster and engine in turn; least value of each \
         clock. \"CPU\" is time on all cores by the scheduler: other work on the machine moves it less than \"wall\".\n"
    );
}

fn nanoseconds_per_pixel(seconds: f64) -> f64 {
    seconds * 1e9 / f64::from(SIZE[0] * SIZE[1] * INSTANTS)
}

fn print_rows(rows: &[Row]) {
    println!("## Ratios to the bare raster\n");
    println!(
        "| triangles | clock | bare ns/px | raster ns/px | ratio | target | events in memory ns/px | ratio | target | \
         events/px/instant |"
    );
    println!("|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|");
    for row in rows {
        let raster = &row.stages[Stage::Raster as usize];
        let whole_target = if row.triangles > 30_000 { 1.5 } else { 2.2 };
        let per_pixel = row.events as f64 / (row.instants as f64 * f64::from(SIZE[0] * SIZE[1]));
        for (clock, read) in
            [("CPU", Series::cpu as fn(&Series) -> f64), ("wall", Series::wall as fn(&Series) -> f64)]
        {
            let [bare, ours, whole] = [&row.bare, raster, &row.full].map(read);
            println!(
                "| {} | {clock} | {:.1} | {:.1} | {:.2} | 1.2 | {:.1} | {:.2} | {whole_target} | {per_pixel:.4} |",
                row.triangles,
                nanoseconds_per_pixel(bare),
                nanoseconds_per_pixel(ours),
                ours / bare,
                nanoseconds_per_pixel(whole),
                whole / bare,
            );
        }
    }
    println!("\nSpread (least / median / largest), ns/px:\n");
    println!("| triangles | clock | bare | raster | events in memory |\n|--:|---|--:|--:|--:|");
    for row in rows {
        let raster = &row.stages[Stage::Raster as usize];
        for wall in [false, true] {
            let cell = |series: &Series| {
                let values = series.spread(|s| if wall { s.wall_s } else { s.cpu_s });
                let [a, b, c] = values.map(nanoseconds_per_pixel);
                format!("{a:.1} / {b:.1} / {c:.1}")
            };
            let clock = if wall { "wall" } else { "CPU" };
            let cells = [&row.bare, raster, &row.full].map(cell).join(" | ");
            println!("| {} | {clock} | {cells} |", row.triangles);
        }
    }
}

fn print_stages(rows: &[Row]) {
    println!("\n## Stages, ns/px of CPU time, by difference\n");
    println!(
        "| triangles | prepare | raster | count | prefix, scan | emit | copy | unpack, and what the ring saves | whole |"
    );
    println!("|--:|--:|--:|--:|--:|--:|--:|--:|--:|");
    for row in rows {
        let mut last = 0.0;
        let ends = row.stages.iter().chain([&row.full]);
        let cells: Vec<String> = ends
            .map(|s| {
                let now = nanoseconds_per_pixel(s.cpu());
                let cell = format!("{:.2}", now - last);
                last = now;
                cell
            })
            .collect();
        println!("| {} | {} | {last:.1} |", row.triangles, cells.join(" | "));
    }
}

/// What sensors cost beyond the raster, in turn over the same instants of one scene.
fn sensors(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    repetitions: u32,
    named: &[&String],
) -> Result<(), Failure> {
    const NAMES: [&str; 7] = ["ideal", "evis", "v2e-clean", "v2e-noisy", "v2e", "openeb", "gen4-like"];
    /// As in `Stage`: what each column is the cost of, and what went before it.
    const COLUMNS: [(Stage, Stage); 3] =
        [(Stage::Raster, Stage::Count), (Stage::Count, Stage::Prefix), (Stage::Prefix, Stage::Emit)];
    let gpu = Gpu::from_device(device.clone(), queue.clone());
    let scene = Arc::new(scenes::build(scenes::DETAILS[0])?);
    let mut all = Vec::new();
    let chosen = NAMES.iter().filter(|name| named.iter().any(|n| n == *name));
    let names = if chosen.clone().count() == 0 { NAMES.to_vec() } else { chosen.copied().collect() };
    let window = |kind| DenseOutput { kind, window_us: 32_000 };
    let grid = DenseKind::VoxelGrid { bins: 5, polarities: Polarities::Signed, normalize: false };
    let made =
        [("", None), (", counts", Some(window(DenseKind::Counts))), (", voxel grid", Some(window(grid)))];
    // Arrays in the place of events, of the first sensors alone.
    let made = |name: &str| if ["ideal", "v2e-noisy"].contains(&name) { &made[..] } else { &made[..1] };
    for (name, (array, dense)) in
        names.into_iter().flat_map(|name| made(name).iter().map(move |made| (name, made)))
    {
        let config = RunConfig { sensor: SensorConfig::preset(name)?, dense: *dense, ..config() };
        let mut stages = Stages::new(&gpu, scene.clone(), config, 1 << 21)?;
        // The first instant sets the references.
        stages.run(0, 1, Stage::Readback, true)?;
        all.push((format!("{name}{array}"), stages, vec![Series::default(); Stage::ALL.len()]));
    }
    for repetition in 0..=repetitions {
        let first = 1 + i64::from(repetition * INSTANTS);
        for (_, stages, series) in &mut all {
            for (series, stage) in series.iter_mut().zip(Stage::ALL) {
                let (sample, _) = measure(|| stages.run(first, INSTANTS, stage, stage == Stage::Readback))?;
                if repetition > 0 {
                    series.push(sample);
                }
            }
        }
    }
    println!(
        "\n## Sensors: ns per pixel and instant of CPU time beyond the raster, {INSTANTS} instants per submission\n"
    );
    println!("| sensor | count | prefix, scan | emit | all |\n|---|--:|--:|--:|--:|");
    for (name, _, series) in &all {
        let cpu = |stage: Stage| nanoseconds_per_pixel(series[stage as usize].cpu());
        let cells: Vec<String> =
            COLUMNS.iter().map(|(before, stage)| format!("{:.1}", cpu(*stage) - cpu(*before))).collect();
        println!("| {name} | {} | {:.1} |", cells.join(" | "), cpu(Stage::Emit) - cpu(Stage::Raster));
    }
    Ok(())
}

/// What each method costs, in turn over the same time of one scene: whole streams, poses to events in host memory.
fn methods(device: &wgpu::Device, queue: &wgpu::Queue, repetitions: u32) -> Result<(), Failure> {
    /// Four blocks of adaptive time, eight keyframes.
    const SPAN_US: i64 = 64_000;
    const ADAPTIVE_PX: Option<f64> = Some(0.5);
    let native = RunConfig { samples: 4, ..config() };
    let adaptive = RunConfig { adaptive_px: ADAPTIVE_PX, ..native.clone() };
    let splat = |warp: Warp| RunConfig { method: Method::Splat(warp), samples: 1, ..config() };
    let all = [
        ("native, 1000 Hz, 1 sample", config()),
        ("native, 1000 Hz, 4 samples", native),
        ("native, 0.5 px, 4 samples", adaptive),
        ("splat, 125 x 8", splat(Warp::default())),
        ("evis-paper, 125 x 8", splat(Warp::evis_paper(8))),
        ("evis-paper, 30 x 8", splat(Warp::evis_paper(8).at(30.0, 8))),
    ];
    println!(
        "\n## Methods: CPU ns per pixel and millisecond of stream (640x480), pixels drawn for it (each by all its samples)\n"
    );
    println!("| method | `spinner` | drawn | `desk` | drawn |\n|---|--:|--:|--:|--:|");
    let mut columns = Vec::new();
    for name in ["spinner", "desk"] {
        let gpu = Gpu::from_device(device.clone(), queue.clone());
        let scene = Arc::new(evis_render::scene::builtin::load(name, 0)?);
        let mut rows = Vec::new();
        for (_, config) in &all {
            let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone())?;
            simulator.step(SPAN_US)?;
            rows.push((simulator, Series::default(), 0));
        }
        for repetition in 0..i64::from(repetitions.min(4)) {
            for (simulator, series, drawn) in &mut rows {
                let (sample, packet) = measure(|| simulator.step((repetition + 2) * SPAN_US))?;
                series.push(sample);
                *drawn += packet.report.drawn_pixels;
            }
        }
        columns.push(rows);
    }
    let pixels = f64::from(SIZE[0]) * f64::from(SIZE[1]) * SPAN_US as f64 * 1e-3;
    for (i, (name, _)) in all.iter().enumerate() {
        let cells = columns.iter().map(|rows| {
            let (_, series, drawn) = &rows[i];
            let drawn = *drawn as f64 / pixels / f64::from(repetitions.min(4));
            format!("{:.0} | {drawn:.2}", series.cpu() * 1e9 / pixels)
        });
        println!("| {name} | {} |", cells.collect::<Vec<_>>().join(" | "));
    }
    Ok(())
}

/// Milliseconds per instant where there is next to nothing to draw, and where nothing is drawn at all.
fn overhead(device: &wgpu::Device, queue: &wgpu::Queue) -> Result<(), Failure> {
    const SPAN: u32 = 8 * INSTANTS;
    let few = scenes::Detail { grid: [2, 2], ..scenes::DETAILS[0] };
    let scene = Arc::new(scenes::build(few)?);
    let config = RunConfig { size: Some((64, 64)), ..config() };
    let mut bare = Bare::new(device, queue, &scene, [64, 64])?;
    let device = Gpu::from_device(device.clone(), queue.clone());
    let mut all = [Gpu::noop()?, device]
        .map(|gpu| Simulator::new(&gpu, scene.clone(), config.clone()).map(|s| (s, Series::default())));
    let mut plain = Series::default();
    for repetition in 0..20 {
        let first = repetition * SPAN + 1;
        for simulation in &mut all {
            let (simulator, series) = simulation.as_mut().map_err(|e| e.to_string())?;
            let until_us = i64::from(first + SPAN - 1) * (1e6 / RATE_HZ) as i64;
            let (sample, _) = measure(|| simulator.step(until_us))?;
            series.push(sample);
        }
        let times_s: Vec<f64> = (first..first + SPAN).map(|i| f64::from(i) / RATE_HZ).collect();
        let submissions =
            || times_s.chunks(INSTANTS as usize).try_for_each(|t| bare.render(&scene, t).map(drop));
        plain.push(measure(submissions)?.0);
    }
    println!(
        "\n## Overhead: 64x64, 1 sample, {} triangles, ms per sampled instant (target: host and submission below \
         0.3)\n",
        scenes::triangle_count(&scene)
    );
    println!("| what | wall | CPU |\n|---|--:|--:|");
    let [host, whole] = all.map(|s| s.map(|(_, series)| series).unwrap_or_default());
    for (what, series) in [
        ("engine on wgpu's `noop` device: poses, uploads, recording, submission, unpacking", host),
        ("engine on this device: the same, the driver, pixels, triggers", whole),
        ("bare raster on this device", plain),
    ] {
        let per_instant = |s: f64| s * 1e3 / f64::from(SPAN);
        // The scheduler counts in ticks of some milliseconds: too coarse for the first row.
        let cpu = per_instant(series.cpu());
        let cpu = if cpu < 0.05 { "-".to_owned() } else { format!("{cpu:.3}") };
        println!("| {what} | {:.3} | {cpu} |", per_instant(series.wall()));
    }
    Ok(())
}

/// Peak memory after streams of different length, each in a process of its own.
fn memory() -> Result<(), Failure> {
    println!("\n## Peak memory of a 128x96 stream, MiB (target: does not grow)\n");
    println!("| 1 s | 4 s |\n|--:|--:|");
    let mut cells = Vec::new();
    for seconds in ["1", "4"] {
        let out = Command::new(std::env::current_exe()?).args([MEMORY_ARGUMENT, seconds]).output()?;
        if !out.status.success() {
            return Err(String::from_utf8_lossy(&out.stderr).into_owned().into());
        }
        cells.push(format!("{:.1}", String::from_utf8(out.stdout)?.trim().parse::<f64>()?));
    }
    println!("| {} |", cells.join(" | "));
    Ok(())
}

fn memory_of_stream(seconds: i64) -> Result<f64, Failure> {
    let gpu = Gpu::open(None)?;
    let scene = Arc::new(scenes::build(scenes::DETAILS[0])?);
    let simulator = Simulator::new(&gpu, scene, RunConfig { size: Some((128, 96)), ..config() })?;
    for packet in simulator.stream(seconds * 1_000_000, 10_000)? {
        packet?;
    }
    Ok(peak_memory_mib())
}
