//! What `splat` costs per pixel and step, beside a bare sketch of the same warp, measured in turn in one run.
//!
//! `cargo bench --bench splat` prints Markdown. `EVIS_BENCH_REPETITIONS` sets the repetitions.

mod bare_splat;
#[expect(dead_code, reason = "shared with the other benchmark")]
mod support;

use std::sync::Arc;

use bare_splat::BareSplat;
use evis_core::{Warp, WarpVariant};
use evis_render::bench::{Stage, Stages};
use evis_render::{Gpu, Method, RunConfig};
use support::measure::{Series, measure};
use support::{Failure, scenes};

const SIZE: [u32; 2] = [640, 480];
/// Instants of a gap, all in one submission; the last one is the keyframe and costs no warp.
const STEPS: u32 = 32;
/// A few pixels of motion per gap.
const KEYFRAME_HZ: f64 = 31.25;

fn main() -> Result<(), Failure> {
    let repetitions = match std::env::var("EVIS_BENCH_REPETITIONS") {
        Ok(text) => text.parse()?,
        Err(_) => 5,
    };
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let adapter = adapters.first().ok_or("no device was found")?;
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        required_limits: adapter.limits(),
        memory_hints: wgpu::MemoryHints::Performance,
        ..Default::default()
    }))?;
    let gpu = Gpu::from_device(device.clone(), queue.clone());
    let scene = Arc::new(scenes::build(scenes::DETAILS[0])?);

    let splat = Warp { margin: Some(0), ..Warp::default().at(KEYFRAME_HZ, STEPS) };
    let paper = Warp { variant: WarpVariant::EvisPaper, ..splat };
    let settings = [("evis-paper", paper), ("splat", splat)];
    let mut bare = BareSplat::new(&device, &queue, SIZE);
    let mut engines = Vec::new();
    for (name, warp) in settings {
        let config = RunConfig {
            size: Some(SIZE.into()),
            samples: 1,
            method: Method::Splat(warp),
            reference_luminance: Some(0.5),
            ..RunConfig::default()
        };
        let mut stages = Stages::new(&gpu, scene.clone(), config, 1 << 10)?;
        if stages.instants_per_submission() != STEPS {
            return Err("a submission is not a gap".into());
        }
        engines.push((name, stages, Series::default()));
    }
    let mut sketch = Series::default();
    for repetition in 0..=repetitions {
        // Both warm up once. A step is a warped instant: the keyframe of each gap is another's work, and small.
        let (sample, ()) = measure(|| bare.run(STEPS - 1))?;
        if repetition > 0 {
            sketch.push(sample);
        }
        for (_, stages, series) in &mut engines {
            let first = 1 + i64::from(repetition * STEPS);
            let (sample, _) = measure(|| stages.run(first, STEPS, Stage::Raster, false))?;
            if repetition > 0 {
                series.push(sample);
            }
        }
    }
    println!("# `splat`, 640x480, 31 instants between two keyframes, one of which is drawn\n");
    println!("- driver: {}", adapter.get_info().driver_info);
    println!("- {repetitions} repetitions in turn; least value of each clock\n");
    println!("| what | CPU ns per pixel and step | ratio | wall | ratio |\n|---|--:|--:|--:|--:|");
    let per_step = |seconds: f64| seconds * 1e9 / f64::from(SIZE[0] * SIZE[1] * (STEPS - 1));
    let row = |name: &str, series: &Series| {
        let (cpu, wall) = (series.cpu(), series.wall());
        println!(
            "| {name} | {:.0} | {:.2} | {:.0} | {:.2} |",
            per_step(cpu),
            cpu / sketch.cpu(),
            per_step(wall),
            wall / sketch.wall()
        );
    };
    row("bare sketch: two softmax splats and a choice, 32-bit sums", &sketch);
    for (name, _, series) in &engines {
        row(name, series);
    }
    Ok(())
}
