//! Reports of closed forms; those of scenes need a device and live in `tests/`.

use std::path::Path;

use evis_core::closed_form::convergence::Variant;

use super::forms::{FormCheck, FormsReport, Theory, verify_forms};
use super::{draw, scene};
use crate::made_up;
use crate::plot::canvas;

/// The same but for the last digits of decimals.
fn alike(a: &serde_json::Value, b: &serde_json::Value) -> bool {
    use serde_json::Value::{Array, Number, Object};
    match (a, b) {
        (Number(a), Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            (a - b).abs() <= 1e-12 * a.abs()
        }
        (Array(a), Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| alike(a, b)),
        (Object(a), Object(b)) => {
            a.len() == b.len() && a.iter().all(|(k, v)| b.get(k).is_some_and(|w| alike(v, w)))
        }
        _ => a == b,
    }
}

fn value(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn the_triggers_converge_as_theory_says_and_a_wrong_order_fails() {
    let report = verify_forms().unwrap();
    assert!(report.passed(), "{report}");
    assert_eq!(report.checks.len(), 18);
    let table = report.to_string();
    assert!(table.ends_with("18 of 18 rows PASS") && !table.contains("FAIL"), "{table}");

    // Canaries: every row fails with another theory than its own.
    for check in &report.checks {
        let wrong = match check.theory {
            Theory::Order { order, within } => Theory::Order { order: order + 1.0, within },
            Theory::Exact => Theory::Order { order: 2.0, within: 0.25 },
        };
        let wrong = FormCheck::new(check.class, wrong, check.measured.clone());
        assert!(!wrong.passed(), "{wrong:?}");
        if check.measured.variant == Variant::Latch {
            let exact = FormCheck::new(check.class, Theory::Exact, check.measured.clone());
            assert!(!exact.passed(), "{exact:?}");
        } else {
            let mut lost = check.measured.clone();
            lost.rows.last_mut().unwrap().matched -= 1;
            let lost = FormCheck::new(check.class, check.theory, lost);
            assert!(lost.fault.as_ref().is_some_and(|f| f.contains("all are expected")), "{lost:?}");
        }
    }
    let mut failing = report.clone();
    let first = failing.checks[0].clone();
    failing.checks[0] =
        FormCheck::new(first.class, Theory::Order { order: 2.0, within: 0.25 }, first.measured);
    assert!(!failing.passed());
    let table = failing.to_string();
    assert!(table.contains("FAIL: order 1.0") && table.ends_with("17 of 18 rows PASS"), "{table}");

    // JSON.
    let text = report.to_json().unwrap();
    let path = Path::new("r.json");
    let back = FormsReport::from_json(&text, path).unwrap();
    assert!(alike(&value(&back.to_json().unwrap()), &value(&text)));
    assert!(!alike(&value(&failing.to_json().unwrap()), &value(&text)), "canary");
    let told = |text: &str| FormsReport::from_json(text, path).unwrap_err().to_string();
    assert!(told("x").contains("no JSON"));
    assert!(told("{}").contains("no report of this version"), "{}", told("{}"));
    assert!(told(&text.replacen("closed_forms", "scene", 1)).contains("a report of scene"));

    // The picture.
    let svg = canvas::svg(&draw::forms(&report).unwrap()).unwrap();
    if let Some(folder) = std::env::var_os("EVIS_LOOK") {
        report.save(&Path::new(&folder).join("verify.png")).unwrap();
    }
    for said in ["edges", "jumps", "edge at 20 degrees", "crossing", "order 2", "rounding", "18 of 18"] {
        assert!(svg.contains(said), "the picture lacks '{said}'");
    }
    let none = FormsReport { checks: vec![], ..report };
    assert!(!none.passed() && draw::forms(&none).is_err());
}

#[test]
fn scene_settings_take_all_samples_with_the_first_trigger_only() {
    let settings = scene::SceneSettings { samples: vec![16, 4, 4], ..Default::default() };
    let all = settings.settings().unwrap();
    assert_eq!(all.len(), 5 * 2 + 5);
    let latch = all.iter().filter(|s| scene::variant(s) == Variant::Latch);
    assert!(latch.clone().count() == 5 && latch.clone().all(|s| s.samples == 16));
    let told = |s: scene::SceneSettings| s.settings().unwrap_err().to_string();
    assert!(told(scene::SceneSettings { triggers: vec![], ..settings.clone() }).contains("triggers"));
    assert!(told(scene::SceneSettings { rates_hz: vec![0.0], ..settings }).contains("rates is 0"));
    // A picture of made-up measurements.
    let chart = made_up::scene_chart("spinner");
    let report =
        scene::SceneReport { evis_verify: super::VERSION, report: "scene".into(), chart, fits: vec![] };
    if let Some(folder) = std::env::var_os("EVIS_LOOK") {
        report.save(&Path::new(&folder).join("verify-scene.png")).unwrap();
    }
    let svg = canvas::svg(&draw::scene(&report).unwrap()).unwrap();
    assert!(svg.contains("crossing, 16 samples") && svg.contains("the oracle&apos;s own error"), "{svg}");
}
