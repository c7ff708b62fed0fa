//! Budgets and plans, whole runs: what was timed once is run again without a clock.

use std::sync::Arc;

use evis_scene::Scene;

use crate::auto::Target;
use crate::config::{Method, RunConfig};
use crate::error::EngineError;
use crate::plan::{self, Plan};
use crate::simulator::Simulator;

fn config() -> RunConfig {
    RunConfig { method: Method::Auto(Target::Default), size: Some((48, 36)), ..RunConfig::default() }
}

#[test]
fn a_plan_runs_again_to_the_same_bytes_without_timing_anything() {
    let Some(gpu) = super::device() else { return };
    let scene: Arc<Scene> = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    let path = std::env::temp_dir().join(format!("evis-floor3-{}.toml", std::process::id()));
    let events = |config: RunConfig| {
        let mut simulator = Simulator::new(&gpu, scene.clone(), config).unwrap();
        simulator.step(40_000).unwrap().views.remove(0).events
    };
    let timed = std::cell::Cell::new(0);
    let told = |what: &str, part: f64| {
        assert!(what.contains("sample") && (0.0..1.0).contains(&part), "{what} {part}");
        timed.set(timed.get() + 1);
        true
    };
    // Below what any settings take, so that the fewest are timed.
    let mut first = config();
    plan::settle(&gpu, &scene, &mut first, Some(1e-3), Some(&path), &told).unwrap();
    assert_eq!(timed.get(), 2 * 6, "two settings, a warm-up and a stretch at three places each");
    let chosen = first.chosen.clone().unwrap();
    assert!(chosen.warning.is_some_and(|told| told.contains("0.001 ms")));
    assert!(chosen.why.contains("ms per simulated second") && chosen.why.contains("px/s"), "{}", chosen.why);
    assert_eq!(Plan::read(&path).unwrap().measured.len(), 2);

    let no_clock = |_: &str, _: f64| panic!("a plan is not timed");
    let mut again = config();
    plan::settle(&gpu, &scene, &mut again, None, Some(&path), &no_clock).unwrap();
    assert_eq!(again, first);
    let expected = events(first);
    assert!(expected.len() > 50 && events(again) == expected);
    let by_target = RunConfig { method: Method::Auto(Target::Preview), ..config() };
    assert_ne!(events(by_target), expected, "canary: other settings");

    let refused = |config: RunConfig, scene: &Arc<Scene>, budget: Option<f64>| {
        let mut config = config;
        plan::settle(&gpu, scene, &mut config, budget, Some(&path), &no_clock).unwrap_err().to_string()
    };
    let text = refused(RunConfig { size: Some((64, 48)), ..config() }, &scene, None);
    assert!(text.contains("48x36") && text.contains("64x48"), "{text}");
    let desk = Arc::new(evis_scene::builtin::load("desk", 0).unwrap());
    let text = refused(config(), &desk, None);
    assert!(text.contains("spinner") && text.contains("desk"), "{text}");
    let mut brighter = (*scene).clone();
    brighter.ambient[0] += 0.01;
    assert!(refused(config(), &Arc::new(brighter), None).contains("content"));
    let text = refused(config(), &scene, Some(70.0));
    assert!(text.contains("0.001") && text.contains("70"), "{text}");
    assert!(refused(config(), &scene, Some(f64::NAN)).contains("budget is NaN"));
    assert!(refused(RunConfig { method: Method::Native, ..config() }, &scene, None).contains("native"));

    std::fs::remove_file(&path).unwrap();
    assert!(refused(config(), &scene, None).contains("no such file"));
    let stopped = plan::settle(&gpu, &scene, &mut config(), Some(50.0), Some(&path), &|_, _| false);
    assert!(matches!(stopped, Err(EngineError::Stopped)) && !path.exists());
}
