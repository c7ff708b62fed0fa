//! The failure suite, held to what is claimed; it needs a device. Truths are kept between runs of these tests.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use evis_chart::verify::failures::{
    Cell, FailureReport, FailureSettings, Limit, NamedMethod, limit, verify_failures,
};
use evis_chart::{ChartError, Stage};
use evis_render::Compute;

use common::gpu;

/// Runs `failures` with `methods`.
fn suite(methods: &[&str], failures: &[&str]) -> Option<FailureReport> {
    suite_on(Compute::Cpu, methods, failures).map(|(report, _)| report)
}

/// The same, with pixels of decoupled sampling evaluated where `compute` says; and how many dispatches the device had.
fn suite_on(compute: Compute, methods: &[&str], failures: &[&str]) -> Option<(FailureReport, u64)> {
    let gpu = gpu()?;
    let settings = FailureSettings {
        methods: methods.iter().map(|name| NamedMethod::named(name).unwrap()).collect(),
        failures: failures.iter().map(|id| (*id).into()).collect(),
        cache: Some(Path::new(env!("CARGO_TARGET_TMPDIR")).join("failure-truths")),
        compute,
    };
    let report = verify_failures(&gpu, &settings, &|_, _| true).unwrap();
    println!("{report}");
    assert!(report.passed(), "{report}");
    assert_eq!(report.cells.len(), methods.len() * failures.len());
    for cell in &report.cells {
        assert!(cell.events > 0 && cell.truth_events > 100, "a test that sees nothing: {cell:?}");
    }
    Some((report, gpu.counts().dispatches))
}

/// Canary: what is claimed of `native`'s number does not hold for `method`, whose events have the failure.
fn breaks(report: &FailureReport, failure: &str, method: &str) {
    let of_native = limit(failure, "native").unwrap();
    let number_only = Limit { least_f1: None, most_at_still: u64::MAX, ..of_native };
    let cell: &Cell = report.cell(failure, method).unwrap();
    assert!(!number_only.faults(cell, None).is_empty(), "{method} has the failure: {cell:?}");
}

/// Methods whose stream has it, and others do not.
fn told(methods: &[&str], failures: &[&str]) {
    let Some(report) = suite(&["native", "splat", methods[0]], failures) else { return };
    for failure in failures {
        breaks(&report, failure, methods[0]);
    }
}

#[test]
fn what_moves_on_its_own_is_told_from_what_does_not() {
    told(&["evis-paper"], &["keyframe-burst", "highlights", "shadows", "lights"]);
}

const OF_HIGH: [&str; 12] = [
    "keyframe-burst",
    "disocclusion",
    "thin-fast",
    "edge-ramp",
    "highlights",
    "shadows",
    "lights",
    "cones",
    "sky",
    "depth",
    "cut",
    "refractory",
];

#[test]
fn passes_on_the_device_keep_what_the_processor_does() {
    // Of these some light once had more events on a device.
    let failures: Vec<&str> =
        OF_HIGH.into_iter().chain(["rotation", "borders", "dark", "low-threshold"]).collect();
    let Some((report, dispatches)) = suite_on(Compute::Gpu, &["high"], &failures) else { return };
    let (own, own_dispatches) = suite_on(Compute::Cpu, &["high"], &failures).unwrap();
    for failure in failures {
        let [cell, own] = [&report, &own].map(|report| report.cell(failure, "high").unwrap());
        let apart = cell.events.abs_diff(own.events);
        assert!(
            200 * apart <= own.events,
            "{failure}: {} events, {} on the processor",
            cell.events,
            own.events
        );
        let [f1, own_f1] = [cell, own].map(|cell| cell.f1.unwrap());
        assert!((f1 - own_f1).abs() < 0.005, "{failure}: F1 {f1}, {own_f1} on the processor");
    }
    assert!(dispatches > own_dispatches + 1000, "{dispatches} dispatches, {own_dispatches} on the processor");
}

#[test]
fn the_high_preset_keeps_near_native() {
    let Some(report) = suite(&["native", "high"], &OF_HIGH) else { return };
    // Canary: native's own claim of its distance to itself does not hold for a stream that misses the ball.
    let promise = limit("thin-fast", "high").unwrap();
    let missed = Cell { f1: Some(0.65), ..report.cell("thin-fast", "high").unwrap().clone() };
    let native = report.cell("thin-fast", "native").unwrap().f1;
    assert!(
        !promise.faults(&missed, native).is_empty(),
        "0.65 is what a rate that leaves fast tiles out reached"
    );
}

#[test]
fn what_comes_into_view_is_told() {
    told(&["evis-paper"], &["disocclusion", "thin-fast", "borders", "near", "depth"]);
}

#[test]
fn sensors_and_light_far_from_the_usual_are_told() {
    told(&["evis-paper"], &["dark", "bright", "low-threshold", "high-threshold"]);
}

#[test]
fn edges_and_texture_are_told() {
    told(&["evis-paper"], &["fringe-ghosts", "breathing"]);
    told(&["no-aa"], &["edge-ramp"]);
    told(&["evis-paper"], &["keyframe-burst-30"]);
}

#[test]
fn rotation_bends_linear_motion_and_not_exact_motion() {
    let Some(report) = suite(&["native", "splat", "evis-paper"], &["rotation"]) else { return };
    breaks(&report, "rotation", "evis-paper");
    let cell = |method| report.cell("rotation", method).unwrap();
    let detail = |method, name| {
        let found = cell(method).details.iter().find(|d| d.name == name);
        found.and_then(|d| d.value).unwrap()
    };
    assert!(detail("splat", "power of the angle") < 1.4, "exact motion");
    assert!(cell("evis-paper").number.unwrap() > 4.0 * cell("splat").number.unwrap());
}

#[test]
fn nothing_fires_where_nothing_changes() {
    // No method has these today; `verify::failures::detect` shows that its counts see them.
    let Some(report) = suite(&["native", "splat"], &["cracks", "global-step", "cut", "refractory"]) else {
        return;
    };
    for failure in ["cracks", "cut", "refractory"] {
        assert!(report.cells.iter().all(|c| c.failure != failure || c.number == Some(0.0)));
        assert!(report.cell(failure, "native").unwrap().still_pixels > 20, "{failure}");
    }
}

#[test]
fn the_suite_stops_when_asked_to() {
    let Some(gpu) = gpu() else { return };
    let settings = FailureSettings {
        failures: vec!["borders".into()],
        methods: vec![NamedMethod::named("native").unwrap()],
        cache: Some(Path::new(env!("CARGO_TARGET_TMPDIR")).join("failure-truths")),
        compute: Compute::Cpu,
    };
    for last in [Stage::Truth, Stage::Runs] {
        let error = verify_failures(&gpu, &settings, &|stage, _| stage != last).unwrap_err();
        assert!(matches!(error, ChartError::Stopped), "{error}");
    }
}
