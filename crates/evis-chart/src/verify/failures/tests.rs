//! Reports and limits without a device; the suite itself runs in `tests/failures.rs`.

use std::path::Path;

use evis_scene::SceneState;

use super::shots::{CUT_US, ShotId};
use super::*;
use crate::plot::canvas;
use crate::verify::Report;

fn cell(failure: &str, method: &str, number: f64, f1: f64) -> Cell {
    Cell {
        failure: failure.into(),
        method: method.into(),
        number: Some(number),
        interval: None,
        details: vec![Detail { name: "something else".into(), value: Some(0.25) }],
        f1: Some(f1),
        median_us: Some(12.5),
        truth_events: 1000,
        events: 990,
        at_still: 0,
        still_pixels: 70,
        outside: 0,
        unknown: 3,
        limit: limit(failure, method),
        faults: vec![],
    }
}

/// Two rows, two columns, made up.
fn report() -> FailureReport {
    let notes = failures().into_iter().filter(|f| ["rotation", "cut"].contains(&f.id.as_str()));
    let mut cells = vec![
        cell("rotation", "native", 0.001, 0.99),
        cell("rotation", "evis-paper", 0.35, 0.4),
        cell("cut", "native", 3.0, 0.99),
        cell("cut", "evis-paper", 0.0, 0.2),
    ];
    for cell in &mut cells {
        cell.faults = cell.limit.as_ref().map_or_else(Vec::new, |limit| limit.faults(cell, None));
    }
    FailureReport {
        evis_verify: VERSION,
        report: REPORT.into(),
        evis: "0.1.0".into(),
        measured: "2025-01-31".into(),
        device: DeviceNote { name: "A device".into(), driver: "driver 1.2".into(), cores: 2 },
        compute: Compute::Gpu,
        methods: ["native", "evis-paper"].map(|name| NamedMethod::named(name).unwrap()).to_vec(),
        failures: notes.collect(),
        cells,
    }
}

#[test]
fn reports_are_told_drawn_and_read_back() {
    let report = report();
    assert!(!report.passed(), "three events at a cut are more than is claimed");
    let table = report.to_string();
    for said in [
        "0.001 ok",
        "3.00 FAIL",
        "0.35     ",
        "1 of 2 claims hold",
        "camera cut",
        "≤ 0 is claimed",
        "something else",
        "decoupled sampling: by compute passes",
    ] {
        assert!(table.contains(said), "the table lacks '{said}':\n{table}");
    }
    let svg = canvas::svg(&draw::figure(&report).unwrap()).unwrap();
    for said in ["rotation bends linear motion", "evis-paper", "the claim holds", "0.990", "it does not"] {
        assert!(svg.contains(said), "the picture lacks '{said}'");
    }
    if let Some(folder) = std::env::var_os("EVIS_LOOK") {
        report.save(&Path::new(&folder).join("failures.png")).unwrap();
    }
    let text = report.to_json().unwrap();
    let path = Path::new("r.json");
    assert_eq!(FailureReport::from_json(&text, path).unwrap(), report);
    assert!(matches!(Report::from_json(&text, path).unwrap(), Report::Failures(_)));
    let told = FailureReport::from_json(&text.replacen("\"failures\"", "\"scene\"", 1), path).unwrap_err();
    assert!(told.to_string().contains("one of failures is needed"), "{told}");
    let mut kept = report.clone();
    kept.cells[2] = cell("cut", "native", 0.0, 0.99);
    assert!(kept.passed());
    let none = FailureReport { cells: vec![], ..report };
    assert!(!none.passed() && draw::figure(&none).is_err());
}

#[test]
fn limits_are_of_failures_and_methods_that_exist_and_each_can_be_broken() {
    let native = |f1| Some(f1);
    for failure in failures() {
        let limit = limit(&failure.id, "native").unwrap_or_else(|| panic!("no limit for {}", failure.id));
        assert!(!limit.reason.is_empty());
        // What keeps it, and what each part of it refuses.
        let good = match limit.bound {
            Bound::AtMost(x) | Bound::AtLeast(x) | Bound::Between(x, _) | Bound::Holds { value: x, .. } => x,
            Bound::Any => 1.0,
        };
        let mut kept = cell(&failure.id, "native", good, 1.0);
        kept.interval = Some([good * 0.95, good * 1.05]);
        assert_eq!(limit.faults(&kept, None), Vec::<String>::new(), "{failure:?}");
        for wrong in [
            Cell { f1: Some(0.1), ..kept.clone() },
            Cell { f1: None, ..kept.clone() },
            Cell { at_still: limit.most_at_still + 1, ..kept.clone() },
            Cell { outside: 1, ..kept.clone() },
            Cell { number: None, ..kept.clone() },
            Cell { number: Some(f64::NAN), ..kept.clone() },
        ] {
            assert!(!limit.faults(&wrong, None).is_empty(), "{failure:?}: {wrong:?}");
        }
        let near = Limit { below_native: Some(0.02), least_f1: None, ..limit };
        let behind = Cell { f1: Some(0.99), ..kept };
        assert_eq!(near.faults(&behind, native(1.0)), Vec::<String>::new());
        assert_eq!(near.faults(&Cell { f1: Some(0.97), ..behind }, native(1.0)).len(), 1);
    }
    assert!(limit("cut", "no-aa").is_none());
    assert_eq!(limit("cut", "high").unwrap().below_native, Some(0.02), "what the next method must do");
}

#[test]
fn intervals_must_hold_their_value_and_say_something() {
    let held = |interval| {
        let mut told = cell("keyframe-burst", "native", 1.0, 1.0);
        told.interval = interval;
        limit("keyframe-burst", "native").unwrap().faults(&told, None).is_empty()
    };
    assert!(held(Some([0.9, 1.1])));
    assert!(!held(Some([1.01, 1.1])) && !held(Some([0.8, 0.99])), "1 lies outside");
    assert!(!held(Some([0.1, 10.0])) && !held(None), "nothing is known");
}

#[test]
fn what_does_not_exist_is_told() {
    let told = |settings: FailureSettings| settings.check().unwrap_err().to_string();
    let good = FailureSettings::default();
    good.check().unwrap();
    assert!(
        told(FailureSettings { failures: vec!["cuts".into()], ..good.clone() }).contains("cracks, borders")
    );
    assert!(told(FailureSettings { methods: vec![], ..good.clone() }).contains("at least one"));
    let twice = vec![good.methods[0].clone(), good.methods[0].clone()];
    assert!(told(FailureSettings { methods: twice, ..good }).contains("native"));
}

#[test]
fn every_shot_can_be_built_and_ids_are_unique() {
    let mut ids: Vec<String> = failures().into_iter().map(|f| f.id).collect();
    for case in cases::CASES {
        for id in case.shots {
            let shot = id.build().unwrap_or_else(|e| panic!("{id:?}: {e}"));
            assert!(shot.duration_us >= 50_000 && shot.scene.cameras.len() == 1, "{id:?}");
        }
    }
    let all = ids.len();
    ids.sort();
    ids.dedup();
    assert_eq!((ids.len(), all), (all, 24));
    // The cut takes a microsecond.
    let scene = ShotId::Cut.build().unwrap().scene;
    let at = |t_us: i64| {
        let mut state = SceneState::default();
        scene.evaluate(t_us as f64 * 1e-6, &mut state);
        scene.world_from_camera(0, &state).unwrap().w_axis.x
    };
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
    assert!(
        near(at(CUT_US - 2), 0.0) && at(CUT_US) > 0.05 && near(at(CUT_US), at(100_000)),
        "{}",
        at(CUT_US)
    );
}
