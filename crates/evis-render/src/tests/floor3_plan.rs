//! Plans, whole runs: what was timed or looked at once is run again without either.

use std::path::Path;
use std::sync::Arc;

use evis_core::{LabelKind, SensorConfig, TriggerRule};
use evis_scene::Scene;

use crate::auto::Target;
use crate::config::{Method, RunConfig};
use crate::error::EngineError;
use crate::plan::{self, Goal, Plan};
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
    plan::settle(&gpu, &scene, &mut first, Some(Goal::Budget(1e-3)), Some(&path), &told).unwrap();
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
        let budget = budget.map(Goal::Budget);
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
    for goal in [Some(Goal::Budget(50.0)), None] {
        let stopped = plan::settle(&gpu, &scene, &mut config(), goal, Some(&path), &|_, _| false);
        assert!(matches!(stopped, Err(EngineError::Stopped)) && !path.exists());
    }
}

#[test]
fn a_plan_for_a_target_runs_again_to_the_same_bytes_without_looking() {
    let Some(gpu) = super::device() else { return };
    let scene: Arc<Scene> = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    let path = std::env::temp_dir().join(format!("evis-floor3-target-{}.toml", std::process::id()));
    let asks = |target: Target| RunConfig {
        method: Method::Auto(target),
        size: Some((96, 72)),
        ..RunConfig::default()
    };
    let settle = |mut config: RunConfig, goal: Option<Goal>, path: Option<&Path>, told: &plan::Told<'_>| {
        plan::settle(&gpu, &scene, &mut config, goal, path, told).map(|()| config).map_err(|e| e.to_string())
    };
    let looks = std::cell::Cell::new(0);
    let told = |_: &str, _: f64| {
        looks.set(looks.get() + 1);
        true
    };
    let no_look = |_: &str, _: f64| panic!("a plan looks at nothing");
    let draft = Some(Goal::Target(Target::Draft));
    let first = settle(asks(Target::Draft), draft, Some(&path), &told).unwrap();
    assert!(looks.get() > 0);
    let plan = Plan::read(&path).unwrap();
    assert_eq!((plan.goal(), plan.looked.is_some()), (draft, true));
    assert_eq!(first, settle(asks(Target::Draft), draft, None, &told).unwrap(), "as without a file");
    // Also where labels, frames and the rest of the sensor differ, and whatever target a method without one names.
    let again = settle(asks(Target::Draft), draft, Some(&path), &no_look).unwrap();
    assert_eq!(again, first);
    assert_eq!(settle(asks(Target::Default), None, Some(&path), &no_look).unwrap(), first);
    let carries = RunConfig {
        labels: vec![LabelKind::Depth],
        frame_rate_hz: Some(40.0),
        sensor: SensorConfig { trigger: TriggerRule::Latch, ..SensorConfig::default() },
        ..asks(Target::Draft)
    };
    let settled = settle(carries, draft, Some(&path), &no_look).unwrap();
    assert_eq!((settled.samples, settled.chosen), (first.samples, first.chosen.clone()));
    let events = |config: RunConfig| {
        let mut simulator = Simulator::new(&gpu, scene.clone(), config).unwrap();
        simulator.step(40_000).unwrap().views.remove(0).events
    };
    let expected = events(first);
    assert!(expected.len() > 100 && events(again) == expected);
    let finer = settle(asks(Target::Finest), None, None, &no_look).unwrap();
    assert_ne!(events(finer), expected, "canary: other settings");

    let refused = |config: RunConfig, goal: Option<Goal>, sides: [&str; 2]| {
        let text = settle(config, goal, Some(&path), &no_look).unwrap_err();
        assert!(sides.iter().all(|side| text.contains(side)), "{sides:?}: {text}");
    };
    let thresholds = |sensor: SensorConfig| RunConfig { sensor, ..asks(Target::Draft) };
    let higher = thresholds(SensorConfig { threshold_on: 0.3, ..SensorConfig::default() });
    refused(higher, draft, ["0.2 ON, 0.2 OFF", "0.3 ON, 0.2 OFF"]);
    let darker = thresholds(SensorConfig { log_eps: 0.01, ..SensorConfig::default() });
    refused(darker, None, ["log_eps 0.001", "log_eps 0.01"]);
    let lit = RunConfig { reference_luminance: Some(0.5), ..asks(Target::Draft) };
    refused(lit, None, ["luminance of what is measured", "for 0.5"]);
    refused(RunConfig { size: Some((64, 48)), ..asks(Target::Draft) }, draft, ["96x72", "64x48"]);
    refused(asks(Target::Exact), Some(Goal::Target(Target::Exact)), ["the target draft", "the target exact"]);
    refused(asks(Target::Default), Some(Goal::Budget(70.0)), ["the target draft", "a budget of 70 ms"]);

    // Without a goal and a file it is for the method's own target; that of some looks at nothing.
    std::fs::remove_file(&path).unwrap();
    let preview = settle(asks(Target::Preview), None, Some(&path), &no_look).unwrap();
    let plan = Plan::read(&path).unwrap();
    assert_eq!((plan.goal(), plan.looked), (Some(Goal::Target(Target::Preview)), None));
    assert_eq!(settle(asks(Target::Default), None, Some(&path), &no_look).unwrap(), preview);
    std::fs::remove_file(&path).unwrap();
}
