//! The engine verified on a built-in scene, tiny; it needs a device.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use evis_chart::verify::{Reference, Report, SceneReport, SceneSettings, Swept, TOLERANCES_US, verify_scene};
use evis_chart::{ChartError, Stage};
use evis_core::SensorConfig;
use evis_core::closed_form::convergence::Variant;
use evis_core::metric::ToleranceScore;
use evis_scene::builtin;
use evis_truth::PixelChoice;

use common::gpu;

fn tiny() -> SceneSettings {
    SceneSettings {
        rates_hz: vec![250.0, 500.0, 1000.0, 2000.0],
        samples: vec![4, 64],
        triggers: vec![Variant::Crossing, Variant::Latch],
        // So small a picture moves little: only a keen sensor sees it.
        sensor: SensorConfig { threshold_on: 0.05, threshold_off: 0.05, ..SensorConfig::default() },
        size: Some((32, 24)),
        duration_us: 20_000,
        pixels: PixelChoice::Count(120),
        ..SceneSettings::default()
    }
}

#[test]
fn the_engine_converges_on_a_scene() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    let report = verify_scene(&gpu, "spinner", &scene, &tiny(), &|_, _| true).unwrap();
    println!("{report}");
    let chart = &report.chart;
    assert_eq!((chart.width, chart.height, chart.points.len()), (32, 24, 3 * 4));
    let f1 = |i: usize| {
        let score = &chart.points[i].score;
        assert_eq!(score.tolerances.len(), TOLERANCES_US.len());
        score.at(1000).unwrap().scaled.f1
    };
    // Four samples, 64 samples, latch with 64: each from 250 to 2000 Hz.
    let floor = chart.truth.floor.as_ref().unwrap().at(1000).unwrap();
    assert!(floor.scaled.f1 > 0.9);
    // On so few events F1 is coarse: with 64 samples the engine's is as good. Times tell.
    let median = |tolerance: &ToleranceScore| tolerance.scaled.time_error.as_ref().unwrap().median_us;
    let own = median(floor);
    let engine = |i: usize| median(chart.points[i].score.at(1000).unwrap());
    assert!((0..12).all(|i| engine(i) > 2.0 * own), "{own} us");
    assert!(f1(7) > f1(3) + 0.1, "more samples: {} {}", f1(7), f1(3));
    assert!(f1(4) > f1(8) + 0.1, "a crossing, not a latch: {} {}", f1(4), f1(8));
    let find = |trigger, over, against| {
        let fits = &report.fits;
        fits.iter().find(|f| f.trigger == trigger && f.over == over && f.against == against).unwrap()
    };
    // So few events are too rough for an order: the rate's own error falls fast, and a latch's is another size.
    let own = |trigger| {
        let fit = find(trigger, Swept::Rate { samples: 64 }, Reference::Finest);
        fit.median_us.iter().map(|(_, us)| us.unwrap()).collect::<Vec<_>>()
    };
    let (log, latch) = (own(Variant::Crossing), own(Variant::Latch));
    assert!(log.len() == 3 && log[0] > 4.0 * log[2] && latch[0] > 5.0 * log[0], "{log:?} {latch:?}");
    let by_samples = Swept::Samples { rate_hz: 2000.0 };
    let errors = &find(Variant::Crossing, by_samples, Reference::Truth).median_us;
    assert_eq!(errors.iter().map(|e| e.0).collect::<Vec<_>>(), [4.0, 64.0]);

    let text = report.to_json().unwrap();
    let back = SceneReport::from_json(&text, Path::new("r.json")).unwrap();
    assert_eq!((back.fits.len(), &back.chart.points[3].hash), (report.fits.len(), &chart.points[3].hash));
    assert!(matches!(Report::from_json(&text, Path::new("r.json")).unwrap(), Report::Scene(_)));
    let table = back.to_string();
    assert_eq!(table, report.to_string());
    for said in ["oracle's own error", "crossing", "2000 Hz    64", "interior", "over the samples"] {
        assert!(table.contains(said), "the table lacks '{said}':\n{table}");
    }
}

#[test]
fn a_verification_stops_when_asked_to_and_tells_what_is_wrong() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    for last in [Stage::Truth, Stage::Runs] {
        let going = |stage, _| stage != last;
        let error = verify_scene(&gpu, "spinner", &scene, &tiny(), &going).unwrap_err();
        assert!(matches!(error, ChartError::Stopped), "{error}");
    }
    let told = |settings: &SceneSettings| {
        verify_scene(&gpu, "spinner", &scene, settings, &|_, _| true).unwrap_err().to_string()
    };
    assert!(told(&SceneSettings { duration_us: 0, ..tiny() }).contains("duration is 0"));
    assert!(told(&SceneSettings { samples: vec![0], ..tiny() }).contains("samples is 0"));
    assert!(told(&SceneSettings { camera: Some("nobody".into()), ..tiny() }).contains("nobody"));
}
