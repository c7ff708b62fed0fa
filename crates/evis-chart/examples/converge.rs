//! `native` against truth: `converge SCENE WxH MILLISECONDS PIXELS rate:samples[:trigger]...`.

use std::sync::Arc;

use evis_core::TriggerRule;
use evis_core::metric::{ScoreSettings, score};
use evis_render::{Gpu, RunConfig, Simulator};
use evis_truth::{Lattice, PixelChoice, TruthSettings, truth};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let scene = evis_scene::source::load(&args[0], 0).expect("a scene");
    let (w, h) = args[1].split_once('x').expect("WxH");
    let size = Some((w.parse().expect("W"), h.parse().expect("H")));
    let duration_us = args[2].parse::<i64>().expect("ms") * 1000;
    let mut settings = TruthSettings {
        size,
        duration_us,
        pixels: PixelChoice::Count(args[3].parse().expect("pixels")),
        ..Default::default()
    };
    let started = std::time::Instant::now();
    let known = truth(&scene, &settings, &|_| true).expect("a truth");
    println!(
        "{} px, {} events, {:.0} s, Y_ref {:.6} {}",
        known.pixels.len(),
        known.events.len(),
        started.elapsed().as_secs_f64(),
        known.reference_luminance,
        known.provenance
    );
    let show = |name: &str, events: &[evis_core::Event]| {
        let got = score(events, &known, &ScoreSettings::default()).expect("a score");
        print!("{name:>14}");
        for t in [1000, 300, 100] {
            let at = got.at(t).expect("tolerance");
            print!("  {t}: {:.4} / {:.4}", at.plain.f1, at.scaled.f1);
        }
        let at = &got.at(1000).expect("tolerance").scaled;
        if let Some(e) = &at.time_error {
            print!(
                "  med {:.1} p95 {:.0} rms {:.0} bias {:.1} us",
                e.median_us, e.p95_us, e.rms_us, e.bias_us
            );
        }
        println!("  count {:.4} voxel {:.4}", got.count_ratio, got.voxel_l1.unwrap_or(f64::NAN));
        for r in &at.regions {
            print!(
                "      {} {} events F1 {:.4} (P {:.3} R {:.3})",
                r.region.name(),
                r.truth_events,
                r.f1,
                r.precision,
                r.recall
            );
        }
        println!();
    };
    settings.lattice = Lattice::Second;
    settings.reference_luminance = Some(known.reference_luminance as f32);
    for arg in &args[4..] {
        if arg == "second" {
            let second = truth(&scene, &settings, &|_| true).expect("a truth");
            show("second lattice", &second.events);
            continue;
        }
        let parts: Vec<&str> = arg.split(':').collect();
        let mut config = RunConfig { size, ..Default::default() };
        config.rate_hz = parts[0].parse().expect("rate");
        config.samples = parts[1].parse().expect("samples");
        if parts.get(2) == Some(&"latch") {
            config.sensor.trigger = TriggerRule::Latch;
        }
        let gpu = Gpu::open(None).expect("a device");
        let mut simulator = Simulator::new(&gpu, Arc::new(scene.clone()), config).expect("a simulator");
        let packet = simulator.step(duration_us).expect("a packet");
        show(arg, &packet.views[0].events);
        println!("    Y_ref {:?}", simulator.config().reference_luminance);
    }
}
