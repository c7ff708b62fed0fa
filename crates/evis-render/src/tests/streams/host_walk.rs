//! Sensors that the host walks: the emulator's events on the engine's light, whatever else is rendered.

use std::sync::Arc;

use evis_core::emulator::parts::{Cause, emulator};
use evis_core::sensor::{Exposure, Noise, Photoreceptor, Readout, SensorConfig};
use evis_core::{EmulatorConfig, Event, EventEmulator, Frames, LabelKind};
use evis_scene::Scene;

use super::gather::{batch, events};
use crate::config::{Antialias, RunConfig};
use crate::engine::simulator::Simulator;
use crate::gpu::Gpu;
use crate::world::view;

fn config() -> RunConfig {
    let davis = SensorConfig::preset("davis346").unwrap();
    let readout = Readout { latency_us: 90.0, jitter_us: 30.0, rate_limit_hz: 3e5, ..Readout::default() };
    let mut sensor = SensorConfig { readout, ..davis };
    sensor.refractory.period_us = 300;
    RunConfig {
        sensor,
        size: Some((72, 54)),
        rate_hz: 500.0,
        samples: 2,
        seed: 11,
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

/// Noise of the photoreceptor beside shot noise.
fn noisy() -> RunConfig {
    let photoreceptor = Photoreceptor { cutoff_hz: 150.0, order: 2, noise: 0.08, ..Photoreceptor::default() };
    let noise = Noise { shot_hz: 20.0, ..Noise::default() };
    RunConfig { sensor: SensorConfig { photoreceptor, noise, ..SensorConfig::default() }, ..config() }
}

fn stream(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig, packet_us: i64) -> Vec<Vec<Event>> {
    events(gpu, scene, config, (40_000, packet_us))
}

#[test]
fn events_are_those_of_the_emulator_on_the_same_light() {
    let Some(gpu) = crate::tests::device() else { return };
    for config in [config(), noisy()] {
        meets_the_emulator(&gpu, &config);
    }
}

/// What each of `emulators` fires at the light that view `index` shows every 2 ms, `until_us` included.
fn on_the_light(
    simulator: &mut Simulator,
    index: usize,
    until_us: i64,
    mut emulators: [EventEmulator; 2],
) -> [Vec<Event>; 2] {
    let mut events = [Vec::new(), Vec::new()];
    for k in 0..=(until_us + 1_999) / 2_000 {
        let light: Vec<f32> =
            simulator.luminance(index, 2_000 * k).unwrap().iter().map(|y| *y as f32).collect();
        for (emulator, events) in emulators.iter_mut().zip(&mut events) {
            emulator.push_into(&Frames::linear(&light), 2_000 * k, std::slice::from_mut(events)).unwrap();
        }
    }
    events
}

fn meets_the_emulator(gpu: &Gpu, config: &RunConfig) {
    let scene = batch(&[0.0, 0.4]);
    let got = stream(gpu, &scene, config, 10_000);
    let (views, _) = view::views(&scene, config).unwrap();
    let mut simulator = Simulator::new(gpu, scene, config.clone()).unwrap();
    for (index, view) in views.iter().enumerate() {
        let of_key = |key| {
            let config = EmulatorConfig {
                width: 72,
                height: 54,
                sensor: config.sensor.clone(),
                reference_luminance: 0.5,
                ..EmulatorConfig::default()
            };
            emulator(config, key).unwrap()
        };
        let emulators = [view.key, views[1 - index].key].map(of_key);
        let [mut expected, mut other] = on_the_light(&mut simulator, index, 40_000, emulators);
        expected.retain(|event| event.t < 40_000);
        other.retain(|event| event.t < 40_000);
        assert!(expected.len() > 500, "{}", expected.len());
        assert!(got[index] == expected, "view {index}: {} {}", got[index].len(), expected.len());
        assert!(got[index] != other, "canary: the noise of another environment");
    }
}

#[test]
fn the_host_says_why_its_events_fired() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.0]);
    let caused = RunConfig { labels: vec![LabelKind::Cause], ..noisy() };
    let mut simulator = Simulator::new(&gpu, scene.clone(), caused).unwrap();
    let view = simulator.step(40_000).unwrap().views.remove(0);
    let count = |cause: Cause| view.causes.iter().filter(|own| **own == cause as u8).count();
    assert!(count(Cause::Signal) > 500 && count(Cause::Shot) > 500, "{}", view.events.len());
    assert_eq!(count(Cause::Signal) + count(Cause::Shot), view.events.len());
    // Asking changes no event.
    assert!(view.events == stream(&gpu, &scene, &noisy(), 40_000)[0]);
}

#[test]
fn coverage_samples_reach_the_host_too() {
    let Some(gpu) = crate::tests::device() else { return };
    let edges = RunConfig { antialias: Antialias::Edges, samples: 16, ..config() };
    let scene = batch(&[0.0]);
    let (with, without) = (stream(&gpu, &scene, &edges, 10_000), stream(&gpu, &scene, &config(), 10_000));
    assert!(with[0].len() > 500 && with != without);
    assert!(stream(&gpu, &scene, &edges, 3_333) == with);
}

/// Pixels that see frames, of thresholds, of a chain with noise and a bus, and of a diffusion.
fn exposed() -> [RunConfig; 3] {
    let exposure = Exposure { time_us: 5_000, period_us: 7_001 };
    let mut noisy = SensorConfig::preset("v2e-noisy").unwrap();
    noisy.readout = Readout { latency_us: 2_500.0, jitter_us: 400.0, ..Readout::default() };
    [SensorConfig::default(), noisy, config().sensor]
        .map(|sensor| RunConfig { sensor: SensorConfig { exposure: exposure.clone(), ..sensor }, ..config() })
}

#[test]
fn exposed_events_are_those_of_the_emulator_on_the_same_light() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.0, 0.4]);
    for config in exposed() {
        let got = stream(&gpu, &scene, &config, 10_000);
        let (views, _) = view::views(&scene, &config).unwrap();
        let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
        // All light that events before 40 ms come of, and no more.
        let until = config.sensor.exposure.needed_us(40_000);
        assert!((45_000..52_001).contains(&until), "{until}");
        for (index, view) in views.iter().enumerate() {
            let of = |exposure: Exposure| {
                let sensor = SensorConfig { exposure, ..config.sensor.clone() };
                let size = EmulatorConfig { width: 72, height: 54, ..EmulatorConfig::default() };
                emulator(EmulatorConfig { sensor, reference_luminance: 0.5, ..size }, view.key).unwrap()
            };
            let emulators = [config.sensor.exposure.clone(), Exposure::default()].map(of);
            let [mut expected, mut other] = on_the_light(&mut simulator, index, until, emulators);
            // The last frame before the end lies behind it: events are known up to there.
            assert!(expected.iter().any(|event| event.t > 38_000));
            expected.retain(|event| event.t < 40_000);
            other.retain(|event| event.t < 40_000);
            assert!(expected.len() > 400, "{}", expected.len());
            assert!(got[index] == expected, "view {index}: {} {}", got[index].len(), expected.len());
            assert!(got[index] != other, "canary: light itself");
        }
    }
}

#[test]
fn a_longer_run_of_exposed_pixels_begins_with_the_shorter_one() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.3, 0.0]);
    for config in exposed() {
        let expected = stream(&gpu, &scene, &config, 10_000);
        let longer = events(&gpu, &scene, &config, (60_000, 7_000));
        for (longer, expected) in longer.iter().zip(&expected) {
            assert!(expected.len() > 200, "{}", expected.len());
            assert!(longer.iter().filter(|event| event.t < 40_000).eq(expected));
            assert!(longer.len() > expected.len(), "canary");
        }
    }
}

#[test]
fn exposed_pixels_tell_why_they_fired() {
    let Some(gpu) = crate::tests::device() else { return };
    let [_, noisy, _] = exposed();
    let caused = RunConfig { labels: vec![LabelKind::Cause], ..noisy.clone() };
    let scene = batch(&[0.0]);
    let mut simulator = Simulator::new(&gpu, scene.clone(), caused.clone()).unwrap();
    let view = simulator.step(40_000).unwrap().views.remove(0);
    assert!(view.events == stream(&gpu, &scene, &noisy, 40_000)[0], "asking changes no event");
    let count = |cause| view.causes.iter().filter(|c| **c == cause).count();
    assert!(
        view.causes.len() == view.events.len() && count(0) > 100 && count(2) > 10,
        "{} {}",
        count(0),
        count(2)
    );
}
