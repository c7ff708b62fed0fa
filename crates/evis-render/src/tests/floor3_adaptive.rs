//! Floor 3: sampling each tile at its own pace gives what sampling everything at that pace gives.

use std::sync::Arc;

use evis_core::{Event, SensorConfig};
use evis_scene::Scene;

use crate::auto::{self, NEAR_NATIVE, Target};
use crate::config::{Antialias, Between, Method, RunConfig, Shadows};
use crate::simulator::Simulator;

use super::adaptive_streams::{
    assert_neighbours_change_no_byte, assert_packets_and_reruns_change_no_byte, deliver, engine, force, run,
    scene,
};

fn config(adaptive_px: Option<f64>, rate_hz: f64) -> RunConfig {
    RunConfig {
        size: Some((100, 76)),
        rate_hz,
        adaptive_px,
        samples: 2,
        reference_luminance: Some(1.0),
        ..Default::default()
    }
}

#[test]
fn at_one_pace_everywhere_it_is_native_at_that_rate() {
    let Some(gpu) = super::device() else { return };
    let noisy = SensorConfig::preset("evis").unwrap();
    let shared = SensorConfig::preset("v2e-noisy").unwrap();
    let (whole, edges) = ((Antialias::Samples, 2), (Antialias::Edges, 16));
    for (name, sensor, (antialias, samples)) in [
        ("spinner", SensorConfig::default(), whole),
        ("spinner", noisy, whole),
        ("desk", shared, whole),
        ("spinner", SensorConfig::default(), edges),
    ] {
        let scene = scene(name);
        for pace in [0, 2, 4] {
            let with = |base| RunConfig { sensor: sensor.clone(), antialias, samples, ..base };
            let plain = with(config(None, 1000.0 / f64::from(1 << pace)));
            let paced = with(config(Some(1.0), 1000.0));
            let all = run(&gpu, &scene, &plain, 8_000);
            let mut engine = engine(&gpu, &scene, &paced);
            force(&mut engine, pace);
            let drawn = deliver(engine, 8_000);
            let (count, expected) = (drawn.events[0].len(), all.events[0].len());
            assert!(expected > 100, "{name}");
            assert!(drawn.events == all.events, "{name} {pace}: {count} and {expected}");
            if name == "spinner" {
                // Blocks end at 64 ms, which native samples too.
                assert_eq!(drawn.drawn_pixels, all.drawn_pixels, "{name} {pace}");
            }
        }
    }
}

#[test]
fn the_finest_pace_everywhere_changes_nothing_and_what_is_still_is_left_out() {
    let Some(gpu) = super::device() else { return };
    for name in ["spinner", "desk"] {
        let scene = scene(name);
        let native = run(&gpu, &scene, &config(None, 1000.0), 16_000);
        // So small a step is never kept: whatever moves is sampled at every instant.
        let finest = run(&gpu, &scene, &config(Some(1e-9), 1000.0), 16_000);
        assert!(finest.events == native.events, "{name}");
        let (drawn, all) = (finest.drawn_pixels, native.drawn_pixels);
        // Whole tiles instead of rectangles, and half of the picture at most where only a toy moves.
        let most = if name == "desk" { 65 * 100 * 76 / 2 } else { all };
        assert!(drawn <= most, "{name}: {drawn} of {most}, native {all}");
    }
}

#[test]
fn packets_reruns_and_neighbours_change_no_byte() {
    let Some(gpu) = super::device() else { return };
    for name in ["spinner", "desk"] {
        let alone = scene(name);
        let config = config(Some(0.3), 2000.0);
        let ran = run(&gpu, &alone, &config, 64_000);
        let (drawn, expected) = (ran.drawn_pixels, ran.events);
        let native = RunConfig { adaptive_px: None, ..config.clone() };
        let all = run(&gpu, &alone, &native, 64_000).drawn_pixels;
        assert!(drawn < all / 2, "{name}: {drawn} of {all} pixels");
        assert_packets_and_reruns_change_no_byte(&gpu, &alone, &config, &expected);
        assert_neighbours_change_no_byte(&gpu, &alone, &config, &expected[0]);

        let curves = RunConfig { between: Between::Curve, ..config };
        let bent = run(&gpu, &alone, &curves, 64_000).events;
        assert!(bent != expected, "{name}: canary");
        assert_packets_and_reruns_change_no_byte(&gpu, &alone, &curves, &bent);
        assert_neighbours_change_no_byte(&gpu, &alone, &curves, &bent[0]);
    }
}

#[test]
fn a_coarser_pace_keeps_close_to_the_finest() {
    let Some(gpu) = super::device() else { return };
    for name in ["spinner", "desk", "street"] {
        let scene = scene(name);
        let [fine, paced, coarse] = [None, Some(0.2), Some(3.0)]
            .map(|px| run(&gpu, &scene, &config(px, 2000.0), 16_000).events.remove(0));
        // Events of a pixel and polarity that have a partner within 1 ms.
        let found = |events: &[Event]| {
            let mut left: std::collections::HashMap<_, Vec<i64>> = Default::default();
            for e in events {
                left.entry((e.x, e.y, e.p)).or_default().push(e.t);
            }
            let near = |e: &&Event| {
                left.get(&(e.x, e.y, e.p)).is_some_and(|times| times.iter().any(|t| (t - e.t).abs() <= 1_000))
            };
            fine.iter().filter(near).count() as f64 / fine.len() as f64
        };
        let (close, far) = (found(&paced), found(&coarse));
        assert!(close > 0.9 && far < close - 0.05, "{name}: {close:.3}, canary {far:.3}");
    }
}

#[test]
fn auto_chooses_by_speed_and_its_settings_by_hand_give_its_bytes() {
    let Some(gpu) = super::device() else { return };
    let settled = |scene: &Arc<Scene>, mut config: RunConfig| {
        let Method::Auto(target) = config.method else { panic!("{:?}", config.method) };
        auto::choose(&gpu, scene, target, &mut config, &|_, _| panic!("nothing is tried")).unwrap();
        config
    };
    let chosen = |scene: &Arc<Scene>, target: Target, size: (u32, u32)| {
        let auto = RunConfig { method: Method::Auto(target), size: Some(size), ..config(None, 1000.0) };
        settled(scene, auto)
    };
    let is_moving = |node: &evis_scene::Node| !matches!(node.motion, evis_scene::Motion::Fixed(_));
    let spinner = scene("spinner");
    let small = chosen(&spinner, Target::Preview, (100, 76));
    let large = chosen(&spinner, Target::Preview, (2000, 1520));
    assert_eq!(small.rate_hz, 1000.0, "{:?}", small.chosen);
    // No faster than a rung allows, whatever it would take.
    let asks = RunConfig { size: Some((2000, 1520)), ..config(None, 1000.0) };
    let site = auto::Site::new(&gpu, &spinner, &asks).unwrap();
    let rates = NEAR_NATIVE.iter().map(|rung| site.settled(rung, &asks).0.rate_hz);
    let (whole, others): (Vec<_>, Vec<_>) =
        NEAR_NATIVE.iter().zip(rates).partition(|(rung, _)| rung.antialias == Antialias::Samples);
    assert!(whole.iter().all(|(rung, hz)| (rung.finest_hz, *hz) == (2000.0, 2000.0)), "{whole:?}");
    assert!(!whole.is_empty() && others.iter().any(|(_, hz)| *hz == 4000.0), "{others:?}");
    assert!(large.rate_hz > small.rate_hz, "{:?}", large.chosen);
    assert_eq!(chosen(&spinner, Target::Finest, (100, 76)).shadows, Some(Shadows::Rays));
    // What the user says of shadows stays; a crowd of things that move is too much for rays.
    let maps = RunConfig {
        method: Method::Auto(Target::Finest),
        shadows: Some(Shadows::Maps),
        size: Some((100, 76)),
        ..config(None, 1000.0)
    };
    assert_eq!(settled(&spinner, maps).shadows, Some(Shadows::Maps));
    let mut crowd = (*spinner).clone();
    let moving = crowd.nodes.iter().position(|n| n.mesh.is_some() && is_moving(n)).unwrap();
    for _ in 0..64 {
        crowd.nodes.push(crowd.nodes[moving].clone());
    }
    let crowd = chosen(&Arc::new(crowd), Target::Finest, (100, 76));
    assert_eq!(crowd.shadows, Some(Shadows::Maps));
    assert!(crowd.chosen.unwrap().why.contains("65 things move"));
    // As many samples of outlines as a picture of them has room for.
    let wide = chosen(&spinner, Target::Finest, (gpu.device.limits().max_texture_dimension_2d / 5, 8));
    let why = wide.chosen.unwrap().why;
    assert!(wide.samples == 100 && why.contains("100 samples"), "{} samples: {why}", wide.samples);
    let settings = |config: &RunConfig| RunConfig { chosen: None, ..config.clone() };
    let expected = run(&gpu, &spinner, &settings(&small), 16_000).events;
    let auto = RunConfig { method: Method::Auto(Target::Preview), ..config(None, 1000.0) };
    let events =
        Simulator::new(&gpu, spinner.clone(), auto).unwrap().step(64_000).unwrap().views.remove(0).events;
    assert!(events == expected[0] && events.len() > 100);
    // What does not move needs no more than the least rate.
    let mut still = (*spinner).clone();
    for node in &mut still.nodes {
        node.motion = evis_scene::Motion::Fixed(glam::DMat4::IDENTITY);
    }
    assert_eq!(chosen(&Arc::new(still), Target::Finest, (100, 76)).rate_hz, 1000.0);
}
