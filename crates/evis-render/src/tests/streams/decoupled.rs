//! Decoupled sampling behind the simulator.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use evis_core::metric::{ScoreSettings, score};
use evis_core::sensor::{Refractory, RefractoryRule};
use evis_core::{Cause, Event, LabelKind, SensorConfig};
use evis_scene::{Light, Scene, Variant};
use evis_truth::{PixelChoice, TruthSettings};

use crate::config::{Compute, Method, Quality, RunConfig};
use crate::engine::simulator::Simulator;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::output::packet::Packet;
use crate::request::SamplingRequest;

use super::built_in::scene;
use super::skips::seeds;
use crate::tests::random_scenes::{self, LENGTH_MS};

/// Random scenes that every run tries; `make check-long` tries more.
const SEEDS: std::ops::Range<u64> = 0..12;

fn config() -> RunConfig {
    RunConfig { method: Method::Decoupled, size: Some((40, 30)), ..RunConfig::default() }
}

fn by_view(packets: impl IntoIterator<Item = Packet>) -> Vec<Vec<Event>> {
    let mut events = Vec::new();
    for packet in packets {
        events.resize(packet.views.len(), Vec::new());
        events.iter_mut().zip(packet.views).for_each(|(all, view)| all.extend(view.events));
    }
    events
}

/// One of thresholds, one that is followed in continuous time, and one that takes frames of an exposure.
fn sensors() -> [SensorConfig; 3] {
    let preset = |name| SensorConfig::preset(name).unwrap();
    let mut exposed = preset("v2e");
    exposed.exposure.time_us = 1500;
    [SensorConfig::default(), preset("dvxplorer-like"), exposed]
}

#[test]
fn packets_streams_and_neighbours_change_no_byte() {
    for sensor in sensors() {
        no_byte_changes(None, RunConfig { sensor, ..config() });
    }
}

#[test]
fn passes_on_the_device_change_no_byte_by_packets_and_neighbours() {
    let Some(gpu) = crate::tests::device() else { return };
    for sensor in sensors() {
        no_byte_changes(Some(&gpu), RunConfig { compute: Compute::Gpu, sensor, ..config() });
    }
}

#[test]
fn passes_on_the_device_are_for_decoupled_sampling() {
    let passes = RunConfig { compute: Compute::Gpu, ..config() };
    let error = Simulator::new(None, scene("spinner"), passes).err().unwrap();
    assert!(matches!(error, EngineError::NoDevice), "{error}");
    let request = SamplingRequest {
        compute: Some(Compute::Gpu),
        method: Some(Method::Native),
        ..SamplingRequest::default()
    };
    let error = request.check().unwrap_err().to_string();
    assert!(error.contains("compute is gpu") && error.contains("native renders on the device"), "{error}");
}

fn no_byte_changes(gpu: Option<&Gpu>, config: RunConfig) {
    let config = || config.clone();
    let mut scene = (*scene("spinner")).clone();
    let clock = |time_offset_s| Variant { time_offset_s, ..Variant::default() };
    scene.variants = vec![clock(0.0), clock(0.3)];
    let scene = Arc::new(scene);
    let new = || Simulator::new(gpu, scene.clone(), config()).unwrap();
    let whole = by_view([new().step(100_000).unwrap()]);
    assert!(whole.len() == 2 && whole[0] != whole[1] && whole.iter().all(|events| events.len() > 50));
    let mut stepped = new();
    let steps = [1_000, 33_000, 33_001, 100_000].map(|until_us| {
        let packet = stepped.step(until_us).unwrap();
        assert!(packet.views.iter().flat_map(|view| &view.events).all(|e| e.t < until_us));
        packet
    });
    let counted: u64 = steps.iter().map(|packet| packet.report.events).sum();
    assert_eq!(counted as usize, whole.iter().map(Vec::len).sum::<usize>());
    assert!(by_view(steps) == whole, "steps");
    assert!(by_view(new().stream(100_000, 7_000).unwrap().map(Result::unwrap)) == whole, "packets");
    let mut alone = (*scene).clone();
    alone.variants.clear();
    let reference_luminance = new().config().reference_luminance;
    let alone = Simulator::new(gpu, Arc::new(alone), RunConfig { reference_luminance, ..config() });
    assert!(by_view([alone.unwrap().step(100_000).unwrap()]) == whole[..1], "a view without neighbours");
}

#[test]
fn labels_frames_and_poses_are_those_of_rendering() {
    let Some(gpu) = crate::tests::device() else { return };
    let labelled = |method| RunConfig {
        method,
        labels: vec![LabelKind::Depth, LabelKind::Cause],
        frame_rate_hz: Some(50.0),
        reference_luminance: Some(0.5),
        ..config()
    };
    let take = |method, steps: &[i64]| {
        let mut simulator = Simulator::new(&gpu, scene("spinner"), labelled(method)).unwrap();
        steps.iter().map(|until_us| simulator.step(*until_us).unwrap()).collect::<Vec<_>>()
    };
    let (own, rendered) =
        (take(Method::Decoupled, &[10_000, 60_000]), take(Method::Native, &[10_000, 60_000]));
    let mut labels = 0;
    for (own, rendered) in own.iter().zip(&rendered) {
        let (own, rendered) = (&own.views[0], &rendered.views[0]);
        assert_eq!(own.poses, rendered.poses);
        assert_eq!(own.causes, vec![0; own.events.len()]);
        assert!(own.labels == rendered.labels);
        labels += own.labels.len();
    }
    assert_eq!(labels, 3 + 3, "depth and frames at 50 Hz during 60 ms");
    // Labels need a device, events do not.
    let error = Simulator::new(None, scene("spinner"), labelled(Method::Decoupled)).err().unwrap();
    assert!(matches!(&error, EngineError::NoDevice) && error.to_string().contains("mesa"), "{error}");
}

#[test]
fn a_sensor_with_noise_fires_as_rendering_says() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut sensor = SensorConfig::preset("dvxplorer-like").unwrap();
    sensor.noise.shot_hz = 5.0;
    // Pixels fire at noise and light within it.
    sensor.refractory = Refractory { period_us: 4000, rule: RefractoryRule::Suppress };
    let config = |method| RunConfig {
        method,
        sensor: sensor.clone(),
        labels: vec![LabelKind::Cause],
        size: Some((64, 48)),
        seed: 3,
        reference_luminance: Some(0.5),
        rate_hz: 4000.0,
        samples: 64,
        ..RunConfig::default()
    };
    let [own, rendered] = [Method::Decoupled, Method::Native].map(|method| {
        let mut simulator = Simulator::new(&gpu, scene("spinner"), config(method)).unwrap();
        // Two blocks: counts of losses are of what has been simulated.
        let packet = simulator.step(65_536).unwrap();
        let report = packet.report.clone();
        let view = packet.views.into_iter().next().unwrap();
        (view.events, view.causes, report)
    });
    // What noise does it does to both; the bus, on which events of light wait too, moves it by microseconds.
    let noise = |(events, causes, _): &(Vec<Event>, Vec<u8>, _)| {
        let all = events.iter().zip(causes).filter(|(_, cause)| **cause != Cause::Signal as u8);
        all.map(|(e, cause)| (e.x, e.y, e.p, *cause, e.t / 1000)).collect::<HashSet<_>>()
    };
    let (a, b) = (noise(&own), noise(&rendered));
    let common = a.intersection(&b).count();
    println!(
        "noise: {} and {}, {common} alike; {} and {} events",
        a.len(),
        b.len(),
        own.0.len(),
        rendered.0.len()
    );
    assert!(
        a.len() > 100 && common * 10 >= 9 * a.len().max(b.len()),
        "{common} of {} and {}",
        a.len(),
        b.len()
    );
    // Counts per pixel and polarity.
    let counts = |events: &[Event]| {
        let mut counts = HashMap::new();
        events.iter().for_each(|e| *counts.entry((e.x, e.y, e.p)).or_insert(0_i32) += 1);
        counts
    };
    let (a, b) = (counts(&own.0), counts(&rendered.0));
    let apart: i32 = a
        .keys()
        .chain(b.keys())
        .collect::<HashSet<_>>()
        .into_iter()
        .map(|k| (a.get(k).unwrap_or(&0) - b.get(k).unwrap_or(&0)).abs())
        .sum();
    println!("counts differ by {apart}");
    assert!((apart as usize) < (own.0.len() + rendered.0.len()) / 20, "{apart} of {}", own.0.len());
    let [own, rendered] = [own.2.suppressed, rendered.2.suppressed];
    println!("{own} suppressed, {rendered} by rendering");
    assert!(own > 20 && own.abs_diff(rendered) * 4 < own, "{own} suppressed, {rendered} by rendering");
}

/// Of light that is rendered at the same rate, with 144 samples.
#[test]
fn a_sensor_that_takes_frames_fires_as_rendering_says() {
    let Some(gpu) = crate::tests::device() else { return };
    let preset = |name| SensorConfig::preset(name).unwrap();
    let mut exposed = SensorConfig::default();
    exposed.exposure.time_us = 2000;
    let sensors = [
        ("evis", preset("evis")),
        ("v2e", preset("v2e")),
        ("openeb", preset("openeb")),
        ("exposed", exposed),
    ];
    for (name, sensor) in sensors {
        let config = |method| RunConfig {
            method,
            sensor: sensor.clone(),
            labels: vec![LabelKind::Cause],
            size: Some((64, 48)),
            seed: 3,
            reference_luminance: Some(0.5),
            rate_hz: 2000.0,
            samples: 144,
            ..RunConfig::default()
        };
        let [own, rendered] = [Method::Decoupled, Method::Native].map(|method| {
            let packet =
                Simulator::new(&gpu, scene("spinner"), config(method)).unwrap().step(60_000).unwrap();
            let view = packet.views.into_iter().next().unwrap();
            let mut times = HashMap::new();
            for e in &view.events {
                times.entry((e.x, e.y, e.p)).or_insert_with(Vec::new).push(e.t);
            }
            (times, view.events.len(), view.causes.iter().filter(|c| **c != Cause::Signal as u8).count())
        });
        // Events of a pixel and polarity, one after another, are the same one where they lie within 1 ms.
        let alike = |later_us: i64| {
            let mut alike = 0;
            for (pixel, times) in &own.0 {
                let mut others = rendered.0.get(pixel).map_or(&[][..], Vec::as_slice);
                for t in times.iter().map(|t| t + later_us) {
                    let before = others.iter().take_while(|o| **o < t - 1000).count();
                    others = &others[before..];
                    if others.first().is_some_and(|o| *o <= t + 1000) {
                        (alike, others) = (alike + 1, &others[1..]);
                    }
                }
            }
            alike as f64 / own.1.max(rendered.1) as f64
        };
        let (now, later) = (alike(0), alike(1500));
        println!(
            "{name}: {} and {} events, {now:.3} alike, {later:.3} 1.5 ms later; {} and {} of noise",
            own.1, rendered.1, own.2, rendered.2
        );
        assert!(own.1 > 300 && now > 0.95 && later < now - 0.15, "{name}: {now} and {later}");
        assert!(own.2.abs_diff(rendered.2) * 20 <= own.2.max(rendered.2), "{name}");
    }
}

#[test]
fn frames_are_taken_as_a_host_says_and_exposures_are_refused_there() {
    let mut driven = (*scene("spinner")).clone();
    let node = driven.nodes.iter().position(|node| node.mesh.is_some()).unwrap();
    let name = driven.nodes[node].name.clone();
    driven.drive(&[name], 0).unwrap();
    let driven = Arc::new(driven);
    let sensor = SensorConfig::preset("v2e").unwrap();
    let config = |sensor| RunConfig { sensor, pose_step_us: Some(10_000), ..config() };
    let new = || Simulator::new(None, driven.clone(), config(sensor.clone())).unwrap();
    let steps =
        |simulator: &mut Simulator, steps: &[i64]| by_view(steps.iter().map(|t| simulator.step(*t).unwrap()));
    let whole = steps(&mut new(), &[40_000]);
    assert!(whole[0].len() > 20, "{} events", whole[0].len());
    assert_eq!(steps(&mut new(), &[10_000, 20_000, 30_000, 40_000]), whole);
    let mut exposed = sensor.clone();
    exposed.exposure.time_us = 1000;
    let refused = Simulator::new(None, driven.clone(), config(exposed)).err().unwrap().to_string();
    assert!(refused.contains("sensor.exposure is on"), "{refused}");
    // Frames end with steps.
    let between = RunConfig { rate_hz: 300.0, pose_step_us: Some(5_000), ..config(sensor.clone()) };
    let refused = Simulator::new(None, driven.clone(), between).err().unwrap().to_string();
    assert!(refused.contains("pose_step_us is 5000"), "{refused}");
}

#[test]
fn a_stopped_step_goes_on_and_loses_nothing() {
    let mut simulator = Simulator::new(None, scene("spinner"), config()).unwrap();
    let whole = by_view([Simulator::new(None, scene("spinner"), config()).unwrap().step(300_000).unwrap()]);
    simulator.stop().store(true, Ordering::Relaxed);
    assert!(matches!(simulator.step(300_000), Err(EngineError::Stopped)));
    assert_eq!(simulator.now_us(), 0);
    simulator.stop().store(false, Ordering::Relaxed);
    assert_eq!(by_view([simulator.step(300_000).unwrap()]), whole);
}

#[test]
fn times_that_no_event_can_have_are_refused_with_the_limit() {
    let new = || Simulator::new(None, scene("spinner"), config()).unwrap();
    let refused = |error: Option<EngineError>| {
        let error = error.unwrap().to_string();
        assert!(error.contains("9000000000000000") && error.contains("at most 4503599627370496"), "{error}");
    };
    let mut simulator = new();
    refused(simulator.step(9_000_000_000_000_000).err());
    refused(new().stream(9_000_000_000_000_000, 1000).err());
    assert_eq!(simulator.now_us(), 0);
    simulator.step(1_000).unwrap();
}

/// The oracle evaluates every pixel; decoupled sampling leaves out those that it takes for resting.
#[test]
fn random_scenes_fire_as_the_oracle_says() {
    let (mut both, mut later, mut all, mut shown) = (0.0, 0.0, 0.0, 0);
    for seed in seeds(SEEDS) {
        let mut scene = random_scenes::scene(seed);
        if evis_decoupled::unsupported(&scene).is_some() {
            continue;
        }
        shown += 1;
        // Truth is that of the first.
        scene.variants.clear();
        let duration_us = i64::from(LENGTH_MS) * 1000;
        let settings = TruthSettings {
            duration_us,
            pixels: PixelChoice::Count(50),
            reference_luminance: Some(0.5),
            ..TruthSettings::default()
        };
        let truth = evis_truth::truth(&scene, &settings, &|_| true).unwrap();
        let config = RunConfig { size: None, reference_luminance: Some(0.5), ..config() };
        let mut simulator = Simulator::new(None, Arc::new(scene), config).unwrap();
        let events = by_view([simulator.step(duration_us).unwrap()]).remove(0);
        if truth.events.is_empty() {
            // Nothing to match: whatever fires at its pixels is wrong.
            let known = |event: &&Event| truth.pixels.contains(&[event.x, event.y]);
            let wrong = events.iter().filter(known).count();
            eprintln!("seed {seed}: {wrong} events where truth has none");
            all += wrong as f64;
            continue;
        }
        let f1 = |events: &[Event]| {
            let score = score(events, &truth, &ScoreSettings::default()).unwrap();
            (score.at(1000).unwrap().plain.f1, (score.events + score.truth_events) as f64)
        };
        let (own, weight) = f1(&events);
        let mut late = events;
        late.iter_mut().for_each(|event| event.t += 1_500);
        eprintln!("seed {seed}: F1 {own:.4}, {} events of truth", truth.events.len());
        both += own * weight;
        later += f1(&late).0 * weight;
        all += weight;
    }
    let (f1, canary) = (both / all, later / all);
    eprintln!("F1 {f1:.4}");
    assert!(shown >= 4 && all > 1_000.0 && f1 > 0.97, "{shown} scenes, F1 {f1} of {all} events");
    assert!(canary < f1 - 0.1, "events that come 1.5 ms late match as well: {canary}");
}

#[test]
fn presets_take_it_where_it_knows_the_scene_and_say_where_not() {
    let Some(gpu) = crate::tests::device() else { return };
    let apply = |gpu: Option<&Gpu>, scene: &Scene, request: SamplingRequest, base: RunConfig| {
        let mut config = base;
        let notes = request.apply(gpu, scene, &mut config);
        notes.map(|notes| (config.method, config.adaptive_px, notes.join("; ")))
    };
    let quality = |quality| SamplingRequest { quality: Some(quality), ..Default::default() };
    let desk = scene("desk");
    let base = || RunConfig { size: Some((40, 30)), ..RunConfig::default() };
    let (method, step_px, _) = apply(Some(&gpu), &desk, quality(Quality::High), base()).unwrap();
    assert_eq!((method, step_px), (Method::Decoupled, Some(0.5)));
    // Rendering by software is slower.
    let (method, step_px, _) = apply(Some(&gpu), &desk, quality(Quality::Standard), base()).unwrap();
    let software = gpu.summary().kind == "cpu";
    let expected = if software { (Method::Decoupled, Some(1.0)) } else { (Method::Native, Some(0.5)) };
    assert_eq!((method, step_px), expected);
    // Without a device there is nothing else.
    let (method, _, notes) = apply(None, &desk, quality(Quality::Reference), base()).unwrap();
    assert!(method == Method::Decoupled && notes.contains("no device"), "{notes}");
    // Intervals can be set; settings of instants ask for rendering.
    let by_hand = SamplingRequest { adaptive_px: Some(0.7), ..quality(Quality::High) };
    let (method, step_px, _) = apply(Some(&gpu), &desk, by_hand.clone(), base()).unwrap();
    assert_eq!((method, step_px), (Method::Decoupled, Some(0.7)));
    let by_hand = SamplingRequest { samples: Some(64), ..by_hand };
    let (method, step_px, _) = apply(Some(&gpu), &desk, by_hand, base()).unwrap();
    assert_eq!((method, step_px), (Method::Native, Some(0.7)));
    let mut crowded = (*desk).clone();
    crowded.lights = vec![Light { casts_shadow: true, ..desk.lights[0].clone() }; 9];
    let (method, _, notes) = apply(Some(&gpu), &crowded, quality(Quality::High), base()).unwrap();
    assert!(method == Method::Native && notes.contains("9 lights"), "{notes}");
    let v2e = RunConfig { sensor: SensorConfig::preset("v2e").unwrap(), ..base() };
    let (method, _, notes) = apply(Some(&gpu), &desk, quality(Quality::High), v2e.clone()).unwrap();
    assert!(method == Method::Decoupled && notes.contains("4000 frames"), "{notes}");
    let rate = SamplingRequest { rate_hz: Some(500.0), ..quality(Quality::High) };
    let (method, _, notes) = apply(Some(&gpu), &desk, rate.clone(), v2e.clone()).unwrap();
    assert!(method == Method::Decoupled && notes.contains("500 frames"), "{notes}");
    assert_eq!(apply(Some(&gpu), &desk, rate, base()).unwrap().0, Method::Native);
    // Noise and a bandwidth have their place in continuous time.
    let real = RunConfig { sensor: SensorConfig::preset("dvxplorer-like").unwrap(), ..base() };
    let (method, _, notes) = apply(Some(&gpu), &desk, quality(Quality::High), real).unwrap();
    assert!(method == Method::Decoupled && notes.is_empty(), "{notes}");
    let rendered = SamplingRequest { method: Some(Method::Native), ..quality(Quality::High) };
    assert_eq!(apply(Some(&gpu), &desk, rendered, base()).unwrap().0, Method::Native);
    // Asked for by hand it is refused.
    let by_name = || SamplingRequest { method: Some(Method::Decoupled), ..Default::default() };
    let refused = |scene: &Scene, base| {
        let mut config = base;
        by_name().apply(Some(&gpu), scene, &mut config).unwrap();
        Simulator::new(&gpu, Arc::new(scene.clone()), config).err().unwrap().to_string()
    };
    assert!(refused(&crowded, base()).contains("9 lights"));
    let told = |request: SamplingRequest| apply(Some(&gpu), &desk, request, base()).unwrap_err().to_string();
    assert!(told(SamplingRequest { rate_hz: Some(100.0), ..by_name() }).contains("rate_hz is 100"));
    let step = SamplingRequest { adaptive_px: Some(0.01), ..by_name() };
    let mut config = base();
    step.apply(Some(&gpu), &desk, &mut config).unwrap();
    let refused = Simulator::new(&gpu, desk.clone(), config).err().unwrap().to_string();
    assert!(refused.contains("adaptive_px") && refused.contains("0.05"), "{refused}");
    assert!(told(SamplingRequest { quality: Some(Quality::High), ..by_name() }).contains("high"));
}
