//! Cameras with distorted lenses: `native` against the oracle, which casts a ray through the lens for every sample.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::sync::Arc;

use evis_core::metric::{ScoreSettings, score};
use evis_core::{Event, Truth};
use evis_render::{Antialias, Gpu, RunConfig, Simulator};
use evis_scene::{Distortion, Lens, Scene};
use evis_truth::{PixelChoice, TruthSettings, truth};

const SIZE: (u32, u32) = (96, 72);

/// Length of the streams, microseconds: with `EVIS_LONG=1` (`make check-long`) more events decide.
fn duration_us() -> i64 {
    if std::env::var_os("EVIS_LONG").is_some_and(|value| value == "1") { 100_000 } else { 40_000 }
}

/// `spinner`, whose camera has these focal lengths and this distortion.
fn spinner(focal: f64, distortion: Option<Distortion>) -> Scene {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let (width, height) = SIZE;
    let [cx, cy] = [f64::from(width) / 2.0 + 1.3, f64::from(height) / 2.0 - 0.8];
    let camera = &mut scene.cameras[0];
    camera.lens = Lens::Intrinsics { fx: focal, fy: focal * 1.01, cx, cy };
    (camera.width, camera.height) = (Some(width), Some(height));
    let name = camera.name.clone();
    scene.distortions.extend(distortion.map(|of| (name, of)));
    scene.validate().unwrap();
    scene
}

fn truth_of(scene: &Scene) -> Truth {
    let pixels = PixelChoice::Count(500);
    let settings = TruthSettings { duration_us: duration_us(), pixels, ..TruthSettings::default() };
    truth(scene, &settings, &|_| true).unwrap()
}

fn events(gpu: &Gpu, scene: Scene, truth: &Truth, antialias: Antialias) -> Vec<Event> {
    let config = RunConfig {
        rate_hz: 2000.0,
        antialias,
        samples: 16,
        reference_luminance: Some(truth.reference_luminance as f32),
        ..RunConfig::default()
    };
    let mut simulator = Simulator::new(gpu, Arc::new(scene), config).unwrap();
    simulator.step(duration_us()).unwrap().views.remove(0).events
}

/// F1 within 1 ms, scaled by image speed as everywhere.
fn f1(events: &[Event], truth: &Truth) -> f64 {
    let settings = ScoreSettings { tolerances_us: vec![1000], ..ScoreSettings::default() };
    score(events, truth, &settings).unwrap().at(1000).unwrap().scaled.f1
}

#[test]
fn distorted_lenses_are_as_near_to_the_truth_as_a_pinhole() {
    let Some(gpu) = common::gpu() else { return };
    let radtan = Distortion::from_coefficients("radtan", &[-0.34, 0.12, 1.5e-3, -1e-3]).unwrap();
    let fisheye = Distortion::from_coefficients("fisheye", &[0.05, -0.02, 0.01, -0.002]).unwrap();
    let focal = 80.0;
    let pinhole = truth_of(&spinner(focal, None));
    assert!(pinhole.events.len() as i64 > duration_us() / 125, "{} events in truth", pinhole.events.len());
    for antialias in [Antialias::Edges, Antialias::Samples] {
        let plain = events(&gpu, spinner(focal, None), &pinhole, antialias);
        let expected = f1(&plain, &pinhole);
        for distortion in [radtan, fisheye] {
            let scene = spinner(focal, Some(distortion));
            let truth = truth_of(&scene);
            let found = f1(&events(&gpu, scene, &truth, antialias), &truth);
            eprintln!("{antialias:?}, {}: F1 (1 ms) {found:.4}, pinhole {expected:.4}", distortion.name());
            assert!(found > expected - 0.01, "{antialias:?} {distortion:?}: {found}, pinhole {expected}");
            let wrong = f1(&plain, &truth);
            assert!(wrong < expected - 0.1, "canary, events of a pinhole: {wrong}");
        }
    }
}
