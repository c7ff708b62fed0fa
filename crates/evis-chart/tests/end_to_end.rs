//! A whole chart of a built-in scene, tiny; it needs a device.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use evis_chart::{
    ChartError, ChartResult, ChartSettings, Criteria, Goal, Ladder, Measure, Stage, chart, draw,
};
use evis_core::SensorConfig;
use evis_scene::builtin;
use evis_truth::PixelChoice;

use common::gpu;

fn tiny() -> ChartSettings {
    ChartSettings {
        ladder: Ladder {
            rates_hz: vec![100.0, 1000.0],
            samples: vec![4],
            edges: false,
            latch_hz: vec![],
            most_samples_hz: None,
            published: true,
            adaptive_px: vec![1.0],
            presets: vec![evis_render::Quality::Draft],
            decoupled: false,
            splat: vec![],
            splat_triggers: false,
        },
        repetitions: 2,
        // So small a picture moves little: only a keen sensor sees it.
        sensor: SensorConfig { threshold_on: 0.05, threshold_off: 0.05, ..SensorConfig::default() },
        size: Some((32, 24)),
        duration_us: 20_000,
        pixels: PixelChoice::Count(120),
        ..ChartSettings::default()
    }
}

#[test]
fn a_scene_becomes_a_chart() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    let stages = [const { AtomicU32::new(0) }; 3];
    let told = |stage: Stage, part: f64| {
        assert!((0.0..=1.0).contains(&part), "{part}");
        stages[stage as usize].fetch_add(1, Ordering::Relaxed);
        true
    };
    let made = chart(&gpu, "spinner", &scene, &tiny(), &told).unwrap();
    assert!(stages.iter().all(|n| n.load(Ordering::Relaxed) > 0), "every stage tells of itself");

    assert_eq!((made.width, made.height, made.points.len()), (32, 24, 9));
    assert!(made.not_measured.is_empty());
    assert!(made.truth.events > 0 && made.truth.floor.is_some());
    for point in &made.points {
        assert_eq!(point.wall_ms_per_s.len(), 2);
        assert!(point.wall_ms_per_s.iter().all(|ms| *ms > 0.0) && point.setup_ms > 0.0);
        assert!(point.events > 0 && point.score.events > 0);
        assert_eq!(point.score.truth_events, made.truth.events as u64);
    }
    let latch = made.points.iter().find(|p| p.setting.published.is_some()).unwrap();
    let crossing = made.points.iter().find(|p| p.setting.rate_hz == 1000.0 && p.hash != latch.hash);
    assert!(crossing.is_some(), "canary: another trigger gives other events");
    // Truth agrees with itself better than any run does.
    let measure = Measure::F1 { tolerance_us: 1000 };
    let floor = made.truth.floor.as_ref().map(|s| measure.of(s)).unwrap();
    assert!(made.points.iter().all(|p| measure.of(&p.score) >= floor), "{floor}");

    let again =
        chart(&gpu, "spinner", &scene, &ChartSettings { floor: false, ..tiny() }, &|_, _| true).unwrap();
    for (a, b) in made.points.iter().zip(&again.points) {
        assert_eq!((&a.hash, &a.score), (&b.hash, &b.score), "the same settings give the same scores");
    }

    made.recommend(Goal::Budget(1.0e9), Criteria::default()).unwrap();
    let result = ChartResult::new(vec![made]);
    let back = ChartResult::from_json(&result.to_json().unwrap(), Path::new("r.json")).unwrap();
    assert!(draw::svg(&back, Criteria::default()).unwrap().contains("paper 1000 Hz"));
}

#[test]
fn a_chart_stops_when_asked_to() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    let settings = ChartSettings { floor: false, ..tiny() };
    for last in [Stage::Truth, Stage::Runs] {
        let error = chart(&gpu, "spinner", &scene, &settings, &|stage, _| stage != last).unwrap_err();
        assert!(matches!(error, ChartError::Stopped), "{error}");
    }
}

#[test]
fn what_cannot_be_charted_is_told() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    let told = |settings: &ChartSettings| {
        chart(&gpu, "spinner", &scene, settings, &|_, _| true).unwrap_err().to_string()
    };
    let lost = told(&ChartSettings { camera: Some("nobody".into()), ..tiny() });
    assert!(lost.contains("nobody"), "{lost}");
    // Thresholds that nothing crosses: nothing is simulated against a truth without events.
    let mut silent = ChartSettings { floor: false, ..tiny() };
    silent.sensor.threshold_on = 50.0;
    silent.sensor.threshold_off = 50.0;
    let lost = told(&silent);
    assert!(lost.contains("none of the 120 pixels that truth was made for fires"), "{lost}");
}
