//! Made-up measurements for tests: no device, no truth, the shape of real ones.

use evis_core::metric::{DEFAULT_TOLERANCES_US, MatchScore, Score, TimeError, ToleranceScore};
use evis_core::{SensorConfig, TriggerRule};
use evis_render::Antialias;

use crate::ladder::{Ladder, Setting};
use crate::result::{DeviceNote, NotMeasured, Point, SceneChart, TruthNote};

/// A score with this F1 at 1 ms and this voxel error.
pub(crate) fn score(f1: f64, voxel_l1: f64) -> Score {
    let at = |tolerance_us: i64, f1: f64| {
        let matched = MatchScore {
            matched: 900,
            missed: 100,
            spurious: 100,
            precision: f1,
            recall: f1,
            f1,
            chance_f1: 0.05,
            missed_per_pixel_s: 1.0,
            spurious_per_pixel_s: 1.0,
            time_error: Some(TimeError {
                median_us: 100.0,
                p95_us: 500.0,
                rms_us: 200.0,
                bias_us: 10.0,
                median_per_interval: None,
            }),
            regions: vec![],
        };
        ToleranceScore { tolerance_us, plain: matched.clone(), scaled: matched }
    };
    Score {
        duration_us: 250_000,
        pixels: 19_200,
        truth_events: 1000,
        events: 1000,
        ignored_unknown_pixel: 0,
        ignored_outside_interval: 0,
        count_ratio: 1.0,
        tolerances: DEFAULT_TOLERANCES_US
            .iter()
            .map(|&us| at(us, f1.powf((1000.0 / us as f64).sqrt())))
            .collect(),
        fired_pixels: 500,
        exact_sequence: 0.9,
        exact_sequence_fired: 0.8,
        voxel_l1: Some(voxel_l1),
        integrated_log_rms: Some(0.1),
        chance_shift_us: [50_000, 200_000],
        cut_clusters: 0,
    }
}

/// Errors that fall with the rate and the samples, and costs that rise with both.
fn point(setting: &Setting, scene: f64) -> Point {
    let work = match setting.antialias {
        Antialias::Samples => f64::from(setting.samples),
        Antialias::Edges => 2.2,
    };
    let base = setting.rate_hz * (0.18 + 0.13 * work) * scene;
    let floor = 0.05 / work.powf(1.3);
    let error = match setting.trigger {
        TriggerRule::Crossing | TriggerRule::Difference => floor + 0.9 * (60.0 / setting.rate_hz).powf(1.1),
        TriggerRule::Latch => 0.4 + floor,
    } / scene.sqrt();
    let noise = 1.0 + 0.03 * (setting.rate_hz * 0.37 + work).sin().abs();
    Point {
        setting: setting.clone(),
        setup_ms: 300.0,
        wall_ms_per_s: vec![base, base * noise, base * (1.0 + (noise - 1.0) * 4.0)],
        events: 120_000,
        clamped: 0,
        hash: "0123456789abcdef".into(),
        score: score(1.0 - error.min(0.9), (error * 0.8).min(0.9)),
    }
}

/// The default ladder on a scene that never was.
pub(crate) fn scene_chart(name: &str) -> SceneChart {
    let all = Ladder::default().settings().unwrap_or_default();
    let weight = 1.0 + name.len() as f64 / 10.0;
    // As if this engine lacked a method.
    let (lack, have): (Vec<_>, Vec<_>) =
        all.into_iter().partition(|s| s.method == "evis-paper" && s.published.is_some());
    SceneChart {
        scene: name.into(),
        run_as: None,
        camera: "camera".into(),
        of_cameras: 1,
        width: 160,
        height: 120,
        start_us: 0,
        duration_us: 250_000,
        sensor: SensorConfig::default(),
        reference_luminance: 0.5,
        evis: "0.1.0".into(),
        measured: "2025-01-31".into(),
        device: DeviceNote { name: "A device".into(), driver: "driver 1.2".into(), cores: 2 },
        repetitions: 3,
        truth: TruthNote {
            pixels: 19_200,
            events: 100_000,
            firing: 15_000,
            floor: Some(score(0.998, 0.003)),
            provenance: serde_json::Value::Null,
        },
        points: have.iter().map(|s| point(s, weight)).collect(),
        not_measured: lack
            .into_iter()
            .map(|setting| NotMeasured {
                reason: format!("method {} does not exist in this version", setting.method),
                setting,
            })
            .collect(),
    }
}
