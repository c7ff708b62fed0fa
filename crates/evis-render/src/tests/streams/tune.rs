//! Quality presets, and the search for settings.

use std::cell::RefCell;
use std::sync::Arc;

use evis_core::metric::{self, ScoreSettings};
use evis_core::truth::Truth;
use evis_core::{Event, SensorConfig};
use evis_scene::{Light, Scene};

use crate::config::{Antialias, Interpolation, Method, Quality, RunConfig, Shadows};
use crate::engine::simulator::Simulator;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::output::packet::Packet;
use crate::request::SamplingRequest;
use crate::tune::{Goal, Tuned, tune};
use crate::world::tiles::{tile_at, tile_count};

use super::built_in::scene;

const SIZE: (u32, u32) = (160, 120);

fn base() -> RunConfig {
    RunConfig { size: Some(SIZE), ..RunConfig::default() }
}

fn preset(gpu: &Gpu, scene: &Scene, quality: Quality, base: &RunConfig) -> (RunConfig, Vec<String>) {
    let mut config = base.clone();
    let request = SamplingRequest { quality: Some(quality), shadows: base.shadows, ..Default::default() };
    let notes = request.apply(Some(gpu), scene, &mut config).unwrap();
    (config, notes)
}

fn events(gpu: &Gpu, scene: &Arc<Scene>, config: RunConfig, until_us: i64) -> Vec<Event> {
    Simulator::new(gpu, scene.clone(), config).unwrap().step(until_us).unwrap().views.remove(0).events
}

#[test]
fn tiles_that_are_rendered_alone_fire_as_in_the_whole_picture() {
    let Some(gpu) = crate::tests::device() else { return };
    for (name, antialias, samples) in [("spinner", Antialias::Edges, 16), ("desk", Antialias::Samples, 2)] {
        let scene = scene(name);
        let config = RunConfig {
            size: Some(SIZE),
            rate_hz: 2000.0,
            adaptive_px: Some(0.5),
            between: Interpolation::Curve,
            antialias,
            samples,
            reference_luminance: Some(1.0),
            ..RunConfig::default()
        };
        let tile = |e: &Event| tile_at(SIZE.0, e.x.into(), e.y.into());
        let mut some_tiles = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
        let mut some = 0;
        // Whatever it rendered before.
        for (start_us, every) in [(40_000, 3), (0, 2), (123_000, 7), (40_000, 1)] {
            let only: Vec<bool> = (0..tile_count(SIZE)).map(|t| t % every == 0).collect();
            some_tiles.restart(start_us, vec![only.clone()], false).unwrap();
            let seen = some_tiles.step(20_000).unwrap();
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
fn presets_are_the_same_for_every_scene_but_for_what_it_does_not_allow() {
    let Some(gpu) = crate::tests::device() else { return };
    let (spinner, desk) = (scene("spinner"), scene("desk"));
    for quality in Quality::ALL {
        let (one, notes) = preset(&gpu, &spinner, quality, &base());
        let (other, _) = preset(&gpu, &desk, quality, &base());
        assert_eq!((&one, notes.len()), (&other, 0));
        assert_eq!(one.quality, Some(quality));
        let again = preset(&gpu, &spinner, quality, &RunConfig { size: Some((640, 480)), ..base() }).0;
        assert_eq!(RunConfig { size: Some(SIZE), ..again }, one, "whatever the size");
    }
    assert_eq!(preset(&gpu, &spinner, Quality::High, &base()).0.shadows, Some(Shadows::Rays));
    // What the user says of shadows stays; a crowd of things that move is too much for rays.
    let maps = RunConfig { shadows: Some(Shadows::Maps), ..base() };
    assert_eq!(preset(&gpu, &spinner, Quality::High, &maps).0.shadows, Some(Shadows::Maps));
    let is_moving = |node: &evis_scene::Node| !matches!(node.motion, evis_scene::Motion::Fixed(_));
    let mut crowd = (*spinner).clone();
    let moving = crowd.nodes.iter().position(|n| n.mesh.is_some() && is_moving(n)).unwrap();
    for _ in 0..64 {
        crowd.nodes.push(crowd.nodes[moving].clone());
    }
    let (crowd, notes) = preset(&gpu, &crowd, Quality::High, &base());
    assert_eq!(crowd.shadows, Some(Shadows::Maps));
    assert!(notes.iter().any(|note| note.contains("65 objects move")), "{notes:?}");
    // As many coverage samples as a picture of them has room for.
    let wide = RunConfig { size: Some((gpu.device.limits().max_texture_dimension_2d / 5, 8)), ..base() };
    let (wide, notes) = preset(&gpu, &spinner, Quality::Reference, &wide);
    assert!(wide.samples == 100 && notes.iter().any(|note| note.contains("100 samples")), "{notes:?}");
    // A sensor model on the host takes every instant.
    let diffusion = SensorConfig {
        trigger: evis_core::TriggerRule::Crossing,
        ..SensorConfig::preset("davis346").unwrap()
    };
    let mut host = RunConfig { sensor: diffusion, ..base() };
    let rendered = SamplingRequest {
        quality: Some(Quality::Standard),
        method: Some(Method::Native),
        ..SamplingRequest::default()
    };
    let notes = rendered.apply(Some(&gpu), &spinner, &mut host).unwrap();
    assert_eq!((host.adaptive_px, host.between), (None, Interpolation::Line));
    assert!(notes.iter().any(|note| note.contains("runs on the host")), "{notes:?}");
}

#[test]
fn a_preset_by_name_and_its_settings_by_hand_give_the_same_bytes() {
    let Some(gpu) = crate::tests::device() else { return };
    let spinner = scene("spinner");
    let (named, _) = preset(&gpu, &spinner, Quality::Draft, &base());
    let by_hand = RunConfig { quality: None, ..named.clone() };
    let expected = events(&gpu, &spinner, by_hand.clone(), 20_000);
    assert!(events(&gpu, &spinner, named, 20_000) == expected && expected.len() > 100);
    let other = RunConfig { adaptive_px: Some(0.7), ..by_hand };
    assert!(events(&gpu, &spinner, other, 20_000) != expected, "canary");
}

fn tuned(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig, goal: Goal) -> Tuned {
    tune(gpu, scene, config, goal, &|_, _| true).unwrap()
}

#[test]
fn the_cheapest_that_agrees_with_the_reference_is_taken() {
    let Some(gpu) = crate::tests::device() else { return };
    let spinner = scene("spinner");
    let found = tuned(&gpu, &spinner, &base(), Goal { target_f1: 0.9, budget_ms: None });
    let f1: Vec<f64> = found.tried.iter().map(|tried| tried.agreement.unwrap().f1_1ms).collect();
    let (last, others) = f1.split_last().unwrap();
    assert!(*last >= 0.9 && others.iter().all(|f1| (0.3..0.9).contains(f1)), "{:?}", found.tried);
    assert_eq!((found.taken, found.warning.as_ref()), (f1.len() - 1, None));
    // It holds where nothing was tried: at another time, in all tiles, beside whole samples at a fixed rate.
    let at = |config: RunConfig| RunConfig { start_us: 700_000, reference_luminance: Some(1.0), ..config };
    let native = RunConfig {
        method: Method::Native,
        rate_hz: 2000.0,
        samples: 64,
        antialias: Antialias::Samples,
        ..base()
    };
    let simulator = Simulator::new(&gpu, spinner.clone(), at(native.clone())).unwrap();
    let camera = simulator.cameras()[0].clone();
    let fired = events(&gpu, &spinner, at(native), 30_000);
    let truth = Truth::from_events(fired, camera, SensorConfig::default(), 1.0, 30_000);
    let score = |config: RunConfig| {
        let settings = ScoreSettings { tolerances_us: vec![1000], ..ScoreSettings::default() };
        let events = events(&gpu, &spinner, at(config), 30_000);
        metric::score(&events, &truth, &settings).unwrap().tolerances[0].plain.f1
    };
    let coarse = RunConfig {
        adaptive_px: Some(3.0),
        between: Interpolation::Curve,
        samples: 1,
        rate_hz: 4000.0,
        ..base()
    };
    let (own, coarse) = (score(found.config.clone()), score(coarse));
    // Unscaled tolerances are stricter where things are slow.
    assert!(own > 0.7 && own > coarse + 0.2, "{own} and, a canary, {coarse}");
}

#[test]
fn what_cannot_be_reached_is_said_and_a_stop_stops() {
    let Some(gpu) = crate::tests::device() else { return };
    let spinner = scene("spinner");
    let small = RunConfig { size: Some((64, 48)), ..base() };
    let cheap = tuned(&gpu, &spinner, &small, Goal { target_f1: 0.9, budget_ms: Some(1e-3) });
    assert_eq!(cheap.taken, 0);
    assert!(cheap.warning.unwrap().contains("0.001 ms"), "{:?}", cheap.tried);
    for goal in [
        Goal { target_f1: 1.5, budget_ms: None },
        Goal { target_f1: f64::NAN, budget_ms: None },
        Goal { target_f1: 0.9, budget_ms: Some(0.0) },
    ] {
        assert!(matches!(tune(&gpu, &spinner, &small, goal, &|_, _| true), Err(EngineError::Config(_))));
    }
    let steps = RefCell::new(Vec::new());
    let progress = |_: &str, part: f64| {
        steps.borrow_mut().push(part);
        steps.borrow().len() < 5
    };
    let goal = Goal { target_f1: 0.9, budget_ms: None };
    assert!(matches!(tune(&gpu, &spinner, &small, goal, &progress), Err(EngineError::Stopped)));
    let steps = steps.into_inner();
    assert!(steps.len() == 5 && steps.windows(2).all(|pair| pair[0] <= pair[1]), "{steps:?}");
    // Nothing fires, so nothing tells settings apart.
    let mut still = (*spinner).clone();
    for node in &mut still.nodes {
        node.motion = evis_scene::Motion::Fixed(glam::DMat4::IDENTITY);
    }
    let still = tuned(&gpu, &Arc::new(still), &small, goal);
    assert!(still.warning.unwrap().contains("too few events"));
    let (standard, _) = preset(&gpu, &spinner, Quality::Standard, &small);
    assert_eq!((still.config.method, still.config.adaptive_px), (standard.method, standard.adaptive_px));
}

#[test]
fn decoupled_sampling_is_tried_where_it_knows_the_scene() {
    let Some(gpu) = crate::tests::device() else { return };
    let spinner = scene("spinner");
    let small = RunConfig { size: Some((96, 72)), ..base() };
    let words = |found: &Tuned| found.tried.iter().map(|tried| tried.what.clone()).collect::<Vec<_>>();
    let goal = Goal { target_f1: 0.9999, budget_ms: None };
    let found = tuned(&gpu, &spinner, &small, goal);
    let all = words(&found);
    assert!(all.iter().filter(|what| what.starts_with("decoupled")).count() >= 2, "{all:?}");
    // Tiles are what events are taken from, whole ones and no others: as good as in the whole picture.
    let of = |what: &str| found.tried.iter().find(|t| t.what.starts_with(what)).unwrap().agreement.unwrap();
    assert!(of("decoupled, 0.5 px").f1_1ms > 0.97, "{:?}", found.tried);
    let mut crowded = (*spinner).clone();
    crowded.lights = vec![Light { casts_shadow: true, ..Light::directional("sun", 0.0) }; 9];
    let all = words(&tuned(&gpu, &Arc::new(crowded), &small, goal));
    assert!(all.len() > 2 && !all.iter().any(|what| what.starts_with("decoupled")), "{all:?}");
}
