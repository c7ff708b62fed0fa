//! Floor 3: what `auto` tries before it runs.

use std::cell::RefCell;
use std::sync::Arc;

use evis_core::metric::{self, ScoreSettings};
use evis_core::truth::Truth;
use evis_core::{Event, LabelKind, SensorConfig};
use evis_scene::Scene;

use crate::auto::{self, LADDER, Target};
use crate::config::{Antialias, Between, Method, RunConfig};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::pace::{TILE, tiles_along};
use crate::packet::Packet;
use crate::plan::Settings;
use crate::search::{self, Tried};
use crate::simulator::Simulator;

use super::adaptive_streams::scene;

const SIZE: (u32, u32) = (320, 240);

fn asks(target: Target) -> RunConfig {
    RunConfig { method: Method::Auto(target), size: Some(SIZE), ..RunConfig::default() }
}

fn settled(gpu: &Gpu, scene: &Arc<Scene>, mut config: RunConfig) -> RunConfig {
    let Method::Auto(target) = config.method else { panic!("{:?}", config.method) };
    auto::choose(gpu, scene, target, &mut config, &|_, _| true).unwrap();
    config
}

fn why(config: &RunConfig) -> String {
    config.chosen.as_ref().unwrap().why.clone()
}

fn events(gpu: &Gpu, scene: &Arc<Scene>, config: RunConfig, until_us: i64) -> Vec<Event> {
    Simulator::new(gpu, scene.clone(), config).unwrap().step(until_us).unwrap().views.remove(0).events
}

#[test]
fn tiles_that_are_looked_at_alone_fire_as_in_the_whole_picture() {
    let Some(gpu) = super::device() else { return };
    for (name, antialias, samples) in [("spinner", Antialias::Edges, 16), ("desk", Antialias::Samples, 2)] {
        let scene = scene(name);
        let config = RunConfig {
            size: Some(SIZE),
            rate_hz: 2000.0,
            adaptive_px: Some(0.5),
            between: Between::Curve,
            antialias,
            samples,
            reference_luminance: Some(1.0),
            ..RunConfig::default()
        };
        let columns = tiles_along(SIZE.0);
        let tile = |e: &Event| (u32::from(e.y) / TILE * columns + u32::from(e.x) / TILE) as usize;
        let mut looks = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
        let mut some = 0;
        // Wherever it was before, and whatever it looked at.
        for (start_us, every) in [(40_000, 3), (0, 2), (123_000, 7), (40_000, 1)] {
            let only: Vec<bool> = (0..columns * tiles_along(SIZE.1)).map(|t| t % every == 0).collect();
            looks.begin_again(start_us, vec![only.clone()]).unwrap();
            let seen = looks.step(20_000).unwrap();
            let config = RunConfig { start_us, ..config.clone() };
            let whole = Simulator::new(&gpu, scene.clone(), config).unwrap().step(20_000).unwrap();
            let drawn = seen.report.drawn_pixels as f64 / whole.report.drawn_pixels as f64;
            assert!(if every == 1 { drawn == 1.0 } else { drawn < 0.8 }, "{name}, one in {every}: {drawn}");
            let fired = |packet: Packet| {
                let events = packet.views.into_iter().flat_map(|view| view.events);
                events.filter(|e| only[tile(e)]).collect::<Vec<_>>()
            };
            let (seen, whole) = (fired(seen), fired(whole));
            assert!(seen == whole, "{name} from {start_us}: {} events of {}", seen.len(), whole.len());
            some += seen.len();
        }
        assert!(some > 500, "{name}: {some}");
    }
}

#[test]
fn the_cheapest_that_agrees_with_the_finest_is_taken() {
    let Some(gpu) = super::device() else { return };
    let spinner = scene("spinner");
    let chosen = settled(&gpu, &spinner, asks(Target::Default));
    let told = why(&chosen);
    // All that were tried are told, and the last alone has what is asked for.
    let f1: Vec<f64> = told.split(" (").filter_map(|part| part.rsplit(' ').next()?.parse().ok()).collect();
    let (last, others) = f1.split_last().unwrap();
    assert!(told.contains("0.98 is asked for") && *last >= 0.98, "{told}");
    assert!(!others.is_empty() && others.iter().all(|f1| (0.5..0.98).contains(f1)), "{told}");
    assert!(told.contains(&format!("{} px", chosen.adaptive_px.unwrap())), "{told}");
    assert!(chosen.chosen.as_ref().unwrap().expects.contains(&format!("{last:.3}")), "{:?}", chosen.chosen);
    // It holds where nothing was tried: other times, all tiles.
    let start_us = 700_000;
    let fired = |config: RunConfig| events(&gpu, &spinner, RunConfig { start_us, ..config }, 30_000);
    let finest = settled(&gpu, &spinner, asks(Target::Finest));
    let simulator = Simulator::new(&gpu, spinner.clone(), finest.clone()).unwrap();
    let truth = Truth::from_events(
        fired(finest),
        simulator.cameras()[0].clone(),
        SensorConfig::default(),
        1.0,
        30_000,
    );
    let score = |events: &[Event]| {
        let settings = ScoreSettings { tolerances_us: vec![1000], ..ScoreSettings::default() };
        metric::score(events, &truth, &settings).unwrap().tolerances[0].plain.f1
    };
    let by_hand = RunConfig { chosen: None, ..chosen.clone() };
    let (own, cheap) =
        (score(&fired(by_hand)), score(&fired(settled(&gpu, &spinner, asks(Target::Preview)))));
    assert!(own > 0.965 && own > cheap + 0.02, "{own} and, a canary, {cheap}");

    // A draft asks for less, and neither labels nor frames nor what sensors do beyond thresholds are looked at.
    let draft = settled(&gpu, &spinner, asks(Target::Draft));
    let place = |config: &RunConfig| {
        LADDER.iter().position(|r| Some(r.step_px) == config.adaptive_px && r.samples == config.samples)
    };
    assert!(place(&draft) > place(&chosen), "{} and {}", why(&draft), told);
    let more = RunConfig {
        labels: vec![LabelKind::Depth],
        frame_rate_hz: Some(30.0),
        sensor: SensorConfig::preset("davis346").unwrap(),
        ..asks(Target::Draft)
    };
    let same_thresholds = RunConfig {
        sensor: SensorConfig {
            threshold_on: more.sensor.threshold_on,
            threshold_off: more.sensor.threshold_off,
            log_eps: more.sensor.log_eps,
            ..SensorConfig::default()
        },
        ..asks(Target::Draft)
    };
    let until = |config: RunConfig| {
        why(&settled(&gpu, &spinner, config)).split("tiles move").next().unwrap().to_owned()
    };
    assert_eq!(until(more), until(same_thresholds));
}

#[test]
fn exact_is_the_cheapest_that_is_as_near_as_native() {
    let Some(gpu) = super::device() else { return };
    // As fast as that 0.4 pixels pass in two of the instants of `native`: as at 640x480.
    let spinner = Arc::new((*scene("spinner")).clone().at_speed(4.0).unwrap());
    let size = Some((128, 96));
    let mut chosen = RunConfig { size, ..asks(Target::Exact) };
    let looked = auto::choose(&gpu, &spinner, Target::Exact, &mut chosen, &|_, _| true).unwrap().1.unwrap();
    let told = why(&chosen);
    let native = looked.native.unwrap();
    let is_as_near = |tried: &Tried| {
        let own = &tried.agreement;
        // Outlines see what the finest settings see, and whole samples do not.
        let more = if tried.as_finest { 0.05 } else { -0.008 };
        own.f1_100us >= (native.f1_100us + more).min(0.99)
            && own.median_us.unwrap() <= 1.05 * native.median_us.unwrap()
    };
    let (last, others) = looked.tried.split_last().unwrap();
    assert!(is_as_near(last), "{looked:?}");
    assert!(!others.is_empty() && others.iter().all(|tried| !is_as_near(tried)), "{looked:?}");
    assert_eq!(last.what, Settings::of(&chosen).in_words());
    let (f1, median_us) = (native.f1_100us, native.median_us.unwrap());
    assert!(
        told.contains(&format!("16 whole samples has ({f1:.3}, {median_us:.1} us) is asked for")),
        "{told}"
    );
    for Tried { agreement, .. } in &looked.tried {
        let figures = format!("{:.3}, {:.1} us", agreement.f1_100us, agreement.median_us.unwrap());
        assert!(told.contains(&figures), "{figures}: {told}");
    }
    let expects = &chosen.chosen.as_ref().unwrap().expects;
    assert!(expects.contains(&format!("F1 (100 us) {:.3}", last.agreement.f1_100us)), "{expects}");
    // The goal holds where nothing was tried: other times, all tiles.
    let start_us = 200_000;
    let fired =
        |config: RunConfig| events(&gpu, &spinner, RunConfig { start_us, chosen: None, ..config }, 40_000);
    let finest = settled(&gpu, &spinner, RunConfig { size, ..asks(Target::Finest) });
    let simulator = Simulator::new(&gpu, spinner.clone(), finest.clone()).unwrap();
    let camera = simulator.cameras()[0].clone();
    let truth = Truth::from_events(fired(finest), camera, SensorConfig::default(), 1.0, 40_000);
    let score = |config: RunConfig| {
        let score = metric::score(&fired(config), &truth, &ScoreSettings::default()).unwrap();
        let median_us = score.at(1000).unwrap().plain.time_error.clone().unwrap().median_us;
        (score.at(100).unwrap().plain.f1, median_us)
    };
    let native =
        score(RunConfig { adaptive_px: None, ..search::native(&RunConfig { size, ..asks(Target::Exact) }) });
    let own = score(chosen.clone());
    let cheap = score(settled(&gpu, &spinner, RunConfig { size, ..asks(Target::Preview) }));
    let meets = |(f1, median_us): (f64, f64)| f1 >= native.0 - 0.01 && median_us <= 1.1 * native.1;
    assert!(meets(own) && !meets(cheap), "{own:?} and {native:?}, a canary {cheap:?}");
}

#[test]
fn where_nothing_is_as_near_as_native_the_finest_settings_are_taken() {
    let Some(gpu) = super::device() else { return };
    let spinner = scene("spinner");
    // Things are so small here that few samples see other events than many do.
    let mut chosen = RunConfig { size: Some((96, 72)), ..asks(Target::Exact) };
    let looked = auto::choose(&gpu, &spinner, Target::Exact, &mut chosen, &|_, _| true).unwrap().1.unwrap();
    assert_eq!((chosen.samples, chosen.adaptive_px), (256, Some(0.15)), "{}", why(&chosen));
    assert_eq!(looked.finest, Settings::of(&chosen).in_words());
    assert!(
        looked.tried.len() > 3 && why(&chosen).contains("so the finest settings are taken"),
        "{looked:?}"
    );
}

#[test]
fn native_is_looked_at_as_it_runs_at_a_fixed_rate() {
    let Some(gpu) = super::device() else { return };
    // A light alone changes, and more slowly than that its usual step asks for every instant.
    let mut flickering = (*scene("desk")).clone();
    for node in &mut flickering.nodes {
        if !matches!(node.motion, evis_scene::Motion::Fixed(_)) {
            node.motion = evis_scene::Motion::Fixed(glam::DMat4::IDENTITY);
        }
    }
    flickering.lights[0].waveform = Some(evis_scene::motion::Waveform {
        shape: evis_scene::motion::WaveShape::Sine,
        frequency_hz: 2.0,
        phase: 0.0,
        low: 0.1,
        high: 1.0,
    });
    let sensor = SensorConfig { threshold_on: 0.05, threshold_off: 0.05, ..SensorConfig::default() };
    let asked = RunConfig { sensor, size: Some((64, 48)), ..asks(Target::Exact) };
    let looks = search::native(&asked);
    let fixed = RunConfig { adaptive_px: None, ..looks.clone() };
    assert_eq!((fixed.rate_hz, fixed.samples, fixed.antialias), (2000.0, 16, Antialias::Samples));
    let spinner = scene("spinner");
    for scene in [spinner.clone(), Arc::new(flickering)] {
        let expected = events(&gpu, &scene, fixed.clone(), 16_000);
        let some = expected.len();
        let same = events(&gpu, &scene, looks.clone(), 16_000) == expected;
        assert!(some > 100 && same, "{}: {some} events", scene.name);
        let coarser = RunConfig { adaptive_px: Some(0.1), ..looks.clone() };
        assert!(events(&gpu, &scene, coarser, 16_000) != expected, "canary: {}", scene.name);
    }
    // Only what is looked at is drawn.
    let drawn = |only: Vec<Vec<bool>>| {
        let mut simulator = Simulator::new(&gpu, spinner.clone(), looks.clone()).unwrap();
        simulator.begin_again(0, only).unwrap();
        simulator.step(16_000).unwrap().report.drawn_pixels
    };
    let one = drawn(vec![(0..12).map(|tile| tile == 5).collect()]);
    assert!((1..drawn(Vec::new()) / 3).contains(&one), "{one} pixels");
}

#[test]
fn where_little_fires_settings_are_the_usual_ones_and_a_stop_is_one() {
    let Some(gpu) = super::device() else { return };
    let spinner = scene("spinner");
    let mut still = (*spinner).clone();
    for node in &mut still.nodes {
        node.motion = evis_scene::Motion::Fixed(glam::DMat4::IDENTITY);
    }
    let still = Arc::new(still);
    for (target, samples) in [(Target::Default, 144), (Target::Exact, 144), (Target::Draft, 16)] {
        let config = settled(&gpu, &still, asks(target));
        assert!(why(&config).contains("too little fires"), "{}", why(&config));
        assert_eq!(config.samples, samples);
        assert!(events(&gpu, &still, config, 20_000).is_empty());
    }
    let tried = RefCell::new(Vec::new());
    let stop_at = |most: usize| {
        let mut config = asks(Target::Default);
        let told = |what: &str, part: f64| {
            assert!(what.contains("px") && (0.0..1.0).contains(&part), "{what} {part}");
            tried.borrow_mut().push(what.to_owned());
            tried.borrow().len() < most
        };
        (auto::choose(&gpu, &spinner, Target::Default, &mut config, &told), config)
    };
    let (stopped, config) = stop_at(5);
    assert!(matches!(stopped, Err(EngineError::Stopped)) && tried.borrow().len() == 5);
    assert_eq!(config, asks(Target::Default), "as it was");
}

#[test]
fn batches_are_tried_in_their_first_environment() {
    let Some(gpu) = super::device() else { return };
    let spinner = scene("spinner");
    let mut many = (*spinner).clone();
    many.variants = vec![evis_scene::Variant::default(); 3];
    let (one, many) =
        (settled(&gpu, &spinner, asks(Target::Draft)), settled(&gpu, &Arc::new(many), asks(Target::Draft)));
    assert_eq!(one, many);
}

#[test]
fn a_scene_that_the_device_refuses_is_an_error() {
    let Some(gpu) = super::device() else { return };
    let mut vast = (*scene("spinner")).clone();
    let edge = gpu.device.limits().max_texture_dimension_2d + 1;
    let image = vast.images.first_mut().unwrap();
    (image.width, image.height) = (edge, 1);
    image.texels.resize(edge as usize, image.texels[0]);
    let vast = Arc::new(vast);
    for target in Target::ALL {
        let refused = Simulator::new(&gpu, vast.clone(), asks(target)).err().unwrap().to_string();
        assert!(refused.contains("the device refused this scene"), "{}: {refused}", target.name());
    }
}
