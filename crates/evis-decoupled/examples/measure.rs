//! Events of a scene against the oracle's, and what they cost.
//!
//! `cargo run --release -p evis-decoupled --example measure -- SCENE WIDTHxHEIGHT SECONDS [PIXELS] [THRESHOLD] [BLOCK_US] [STEP_PX] [stages]`
//!
//! With `stages`, pixels are followed as those of sensors with more stages than thresholds are. Truth is made of PIXELS pixels and kept in the folder that `EVIS_TRUTH_CACHE` names, or read from `EVIS_TRUTH_FILE`. Cost is the CPU time of the
//! process while it simulates, all pixels, from /proc/self/stat.

mod clock;

use std::path::PathBuf;

use evis_core::SensorConfig;
use evis_core::metric::{ScoreSettings, score};
use evis_decoupled::{Settings, simulate};
use evis_scene::camera_motion::{CameraMotionSettings, moved};
use evis_truth::{PixelChoice, TruthSettings, cached, truth};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let usage =
        "usage: measure SCENE WIDTHxHEIGHT SECONDS [PIXELS] [THRESHOLD] [BLOCK_US] [STEP_PX] [stages]";
    let name = args.next().ok_or(usage)?;
    let size = args.next().ok_or(usage)?;
    let (w, h) = size.split_once('x').ok_or(usage)?;
    let size = Some((w.parse()?, h.parse()?));
    let duration_us = (args.next().ok_or(usage)?.parse::<f64>()? * 1e6).round() as i64;
    let pixels: usize = args.next().map_or(Ok(1000), |v| v.parse())?;
    let threshold: f32 = args.next().map_or(Ok(0.2), |v| v.parse())?;
    let block_us = args.next().map_or(Ok(Settings::default().block_us), |v| v.parse())?;
    let step_px = args.next().map_or(Ok(Settings::default().step_px), |v| v.parse())?;
    let sensor = SensorConfig { threshold_on: threshold, threshold_off: threshold, ..Default::default() };
    let scene = std::sync::Arc::new(evis_scene::source::load(&name, 0)?);
    // A model that rests gets the camera that orbits it elsewhere, too.
    let motion = CameraMotionSettings { size, ..CameraMotionSettings::default() };
    let scene = moved(&scene, &motion)?;

    let truth_settings = TruthSettings {
        sensor: sensor.clone(),
        size,
        duration_us,
        pixels: PixelChoice::Count(pixels),
        ..Default::default()
    };
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let truth = match (folder("EVIS_TRUTH_FILE"), folder("EVIS_TRUTH_CACHE")) {
        (Some(file), _) => evis_core::Truth::read(&file)?,
        (None, Some(folder)) => cached(&folder, &scene, &truth_settings, &|_| true)?,
        (None, None) => truth(&scene, &truth_settings, &|_| true)?,
    };

    // The same sensor, as one with more stages is followed: a refractory period shorter than any interval.
    let mut sensor = sensor;
    sensor.refractory.period_us = u32::from(args.next().is_some_and(|word| word == "stages"));
    let settings = Settings { sensor, size, duration_us, block_us, step_px, ..Default::default() };
    let before = clock::cpu_seconds();
    let out = simulate(&scene, &settings)?;
    let cpu = clock::cpu_seconds() - before;
    let seconds = duration_us as f64 * 1e-6;
    let r = &out.report;
    let wall = r.lists_s + r.light_s + r.pixels_s;
    let share = |s: f64| cpu / seconds * s / wall;
    println!("{name} {w}x{h}, {seconds} s: {} events", out.events.len());
    println!(
        "Y_ref {:.5} here, {:.5} in the truth ({:+.2} %)",
        out.reference_luminance,
        truth.reference_luminance,
        100.0 * (out.reference_luminance / truth.reference_luminance - 1.0)
    );
    println!(
        "core-seconds per simulated second: {:.2} = lists {:.2} + light {:.2} + pixels {:.2} (coverage {:.2}, shading {:.2}, rest {:.2})",
        cpu / seconds,
        share(r.lists_s),
        share(r.light_s),
        share(r.pixels_s),
        share(r.coverage_s),
        share(r.shading_s),
        share(r.pixels_s - r.coverage_s - r.shading_s),
    );
    println!(
        "{:.1} evaluations per event, {:.0} per pixel and second, {:.0} ns each; {:.2} facets per pixel; {:.1} % of evaluations see one",
        r.evaluations as f64 / out.events.len().max(1) as f64,
        r.evaluations as f64 / f64::from(size.map_or(1, |(w, h): (u32, u32)| w * h)) / seconds,
        1e9 * cpu * r.pixels_s / wall / r.evaluations.max(1) as f64,
        r.entries as f64 / r.pixel_blocks.max(1) as f64,
        100.0 * r.plain as f64 / r.evaluations.max(1) as f64,
    );
    println!(
        "{:.1} % of pixels' blocks are quiet by bounds",
        100.0 * r.quiet as f64 / r.pixel_blocks.max(1) as f64
    );
    println!("places shaded before evaluations, per second: {:.0}", r.places as f64 / seconds);
    let score = score(&out.events, &truth, &ScoreSettings::default())?;
    println!("{score}");
    if let Some(at) = score.at(1000) {
        if let Some(part) = at.scaled.time_error.as_ref().and_then(|e| e.median_per_interval) {
            println!("median time error over the time between a pixel's events: {:.2} %", 100.0 * part);
        }
        for r in &at.scaled.regions {
            println!(
                "{:>12}: truth {:5}, events {:5}, matched {:5}: missed {:4}, extra {:4}, F1 {:.4}",
                r.region.name(),
                r.truth_events,
                r.events,
                r.matched,
                r.truth_events - r.matched,
                r.events - r.matched,
                r.f1
            );
        }
    }
    Ok(())
}
