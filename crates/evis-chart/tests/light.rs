//! Light against the oracle on a built-in scene, tiny; it needs a device.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use evis_chart::verify::{LightReport, LightSettings, Report, verify_light};
use evis_chart::{ChartError, Stage};
use evis_core::Region;
use evis_scene::builtin;

use common::gpu;

#[test]
fn more_samples_bring_light_nearer_to_the_oracles() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    let tiny = LightSettings { size: Some((32, 24)), at_us: 10_000, worst: 3, ..LightSettings::default() };
    let seen = |samples| {
        verify_light(&gpu, "spinner", &scene, &LightSettings { samples, ..tiny.clone() }, &|_, _| true)
            .unwrap()
    };
    let (fine, coarse) = (seen(64), seen(1));
    println!("{fine}");
    assert!(fine.all.median < 0.01, "{:?}", fine.all);
    assert!(coarse.all.median > 2.0 * fine.all.median, "canary: {:?} {:?}", coarse.all, fine.all);
    // Every pixel counts once, and the worst is the worst.
    assert_eq!((fine.all.pixels, fine.difference.len()), (32 * 24, 32 * 24));
    assert_eq!(fine.regions.iter().map(|r| r.error.pixels).sum::<u64>(), fine.all.pixels);
    let interior = fine.regions.iter().find(|r| r.name == Region::Interior.name()).unwrap();
    assert_eq!(fine.objects.iter().map(|o| o.error.pixels).sum::<u64>(), interior.error.pixels);
    assert!(fine.objects.iter().any(|o| o.name.starts_with("square")), "{:?}", fine.objects);
    let [worst, ..] = fine.worst.as_slice() else { panic!("no worst pixel") };
    assert_eq!((fine.worst.len(), worst.difference.abs()), (3, fine.all.worst));
    let own = f64::from(fine.difference[(worst.y * 32 + worst.x) as usize]);
    assert!((own - worst.difference).abs() < 1e-6);
    let log = |y: f64| (y / fine.reference_luminance + fine.log_eps).ln();
    assert!((log(worst.engine) - log(worst.oracle) - worst.difference).abs() < 1e-9);
    // The same scene later is another picture: the oracle looks at the instant that it is told.
    let later = LightSettings { at_us: 40_000, samples: 64, ..tiny.clone() };
    let later = verify_light(&gpu, "spinner", &scene, &later, &|_, _| true).unwrap();
    assert!(later.all.median < 0.01 && later.difference != fine.difference, "{:?}", later.all);

    let text = fine.to_json().unwrap();
    let path = Path::new("r.json");
    let back = LightReport::from_json(&text, path).unwrap();
    assert_eq!((back.to_string(), back.difference.len()), (fine.to_string(), fine.difference.len()));
    assert!(matches!(Report::from_json(&text, path).unwrap(), Report::Light(_)));
    assert!(LightReport::from_json(&text.replacen("\"light\"", "\"scene\"", 1), path).is_err());
}

#[test]
fn what_cannot_be_compared_is_told() {
    let Some(gpu) = gpu() else { return };
    let scene = builtin::load("spinner", 0).unwrap();
    let tiny = LightSettings { size: Some((32, 24)), ..LightSettings::default() };
    let told = |settings: LightSettings| {
        verify_light(&gpu, "spinner", &scene, &settings, &|_, _| true).unwrap_err().to_string()
    };
    assert!(told(LightSettings { at_us: -1, ..tiny.clone() }).contains("at is -0.001"));
    assert!(told(LightSettings { samples: 0, ..tiny.clone() }).contains("samples is 0"));
    assert!(told(LightSettings { camera: Some("nobody".into()), ..tiny.clone() }).contains("nobody"));
    for last in [Stage::Truth, Stage::Runs] {
        let error = verify_light(&gpu, "spinner", &scene, &tiny, &|stage, _| stage != last).unwrap_err();
        assert!(matches!(error, ChartError::Stopped), "{error}");
    }
}
