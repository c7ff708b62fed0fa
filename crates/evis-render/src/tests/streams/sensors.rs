//! Cameras with different sensors in one run: each has the bytes that it has alone.

use std::collections::BTreeMap;
use std::sync::Arc;

use evis_core::sensor::{Readout, SensorConfig};
use evis_core::{Event, LabelKind, TriggerRule, Warp};
use evis_scene::{Scene, Variant};

use super::gather::{events, gather};
use crate::config::{Method, RunConfig};
use crate::engine::simulator::Simulator;
use crate::engine::{Engine, Parts, classes};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::world::view;

/// The spinner with a camera each for thresholds, a chain with a bus, a diffusion, a latch in another size, and again
/// thresholds, with one of its own.
fn rig() -> (Arc<Scene>, BTreeMap<String, SensorConfig>) {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let mut chain = SensorConfig::preset("gen4-like").unwrap();
    chain.noise.shot_hz = 40.0;
    chain.readout = Readout { latency_us: 90.0, jitter_us: 30.0, rate_limit_hz: 3e4, ..Readout::default() };
    let latch = SensorConfig { trigger: TriggerRule::Latch, log_eps: 1e-5, ..SensorConfig::default() };
    let sensors = [
        ("plain", SensorConfig::default()),
        ("chain", chain),
        ("diffusion", SensorConfig::preset("davis346").unwrap()),
        ("latch", latch),
        ("keen", SensorConfig::default()),
    ];
    let first = scene.cameras.remove(0);
    for (name, _) in &sensors {
        let mut camera = first.clone();
        camera.name = (*name).into();
        let (width, height) = if *name == "latch" { (60, 44) } else { (80, 60) };
        (camera.width, camera.height) = (Some(width), Some(height));
        camera.threshold_on = (*name == "keen").then_some(0.15);
        scene.cameras.push(camera);
    }
    (Arc::new(scene), sensors.map(|(name, sensor)| (name.to_owned(), sensor)).into())
}

fn config(sensors: &BTreeMap<String, SensorConfig>) -> RunConfig {
    RunConfig {
        sensors: sensors.clone(),
        rate_hz: 700.0,
        samples: 4,
        seed: 11,
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

/// By camera: what it sends in 40 ms.
fn streams(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig) -> BTreeMap<String, Vec<Vec<Event>>> {
    let simulator = Simulator::new(gpu, scene.clone(), config.clone()).unwrap();
    let names: Vec<String> = simulator.cameras().iter().map(|camera| camera.name.clone()).collect();
    let mut of: BTreeMap<String, Vec<Vec<Event>>> = BTreeMap::new();
    for (index, events) in events(gpu, scene, config, (40_000, 7_000)).into_iter().enumerate() {
        of.entry(names[index % names.len()].clone()).or_default().push(events);
    }
    of
}

fn methods() -> Vec<(Method, Option<f64>)> {
    vec![
        (Method::Native, None),
        (Method::Native, Some(0.4)),
        (Method::Splat(Warp::default().at(100.0, 7)), None),
    ]
}

#[test]
fn neighbours_with_other_sensors_change_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let (scene, sensors) = rig();
    let names: Vec<String> = scene.cameras.iter().map(|camera| camera.name.clone()).collect();
    for (method, adaptive_px) in methods() {
        let what = format!("{} {adaptive_px:?}", method.name());
        let run = |cameras: &[&str]| {
            let cameras = cameras.iter().map(|name| (*name).to_owned()).collect();
            streams(&gpu, &scene, &RunConfig { method, adaptive_px, cameras, ..config(&sensors) })
        };
        let together = run(&[]);
        for name in &names {
            assert!(together[name][0].len() > 300, "{what} {name}: {}", together[name][0].len());
            assert!(run(&[name])[name] == together[name], "{what} {name} alone");
        }
        let turned = run(&["latch", "keen", "diffusion", "plain", "chain"]);
        assert!(turned == together, "{what}: in another order");
        let fewer = run(&["chain", "diffusion", "plain"]);
        assert!(fewer.iter().all(|(name, events)| *events == together[name]), "{what}: without two of them");
        // Canary: one sensor for all gives the others' cameras other streams.
        let same = RunConfig { method, adaptive_px, sensors: BTreeMap::new(), ..config(&sensors) };
        let same = streams(&gpu, &scene, &same);
        for name in &names {
            let has_it = ["plain", "keen"].contains(&name.as_str());
            assert_eq!(same[name] == together[name], has_it, "{what} {name}");
        }
    }
}

#[test]
fn batches_packets_and_small_buffers_change_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let (scene, sensors) = rig();
    let mut batch = Scene::clone(&scene);
    let clock = |time_offset_s| Variant { time_offset_s, ..Variant::default() };
    batch.variants = vec![clock(0.0), clock(0.3)];
    let batch = Arc::new(batch);
    for adaptive_px in [None, Some(0.4)] {
        let mut config =
            RunConfig { adaptive_px, labels: vec![LabelKind::Depth, LabelKind::Cause], ..config(&sensors) };
        let expected = gather(
            Simulator::new(&gpu, batch.clone(), config.clone())
                .unwrap()
                .stream(40_000, 10_000)
                .unwrap()
                .map(Result::unwrap),
        );
        assert_eq!(expected.len(), 10);
        let single = events(&gpu, &scene, &config, (40_000, 777));
        let first: Vec<_> = expected[..5].iter().map(|view| view.0.clone()).collect();
        assert!(single == first, "an environment alone, in packets of 777 us");
        let (views, _) = view::views(&batch, &config).unwrap();
        let mut engine = Engine::new(&gpu, batch.clone(), views, &mut config).unwrap();
        engine.limit_buffers(16, 1 << 20);
        let mut reruns = 0;
        let small = gather([5_000, 5_001, 40_000].into_iter().map(|until_us| {
            let packet = engine.deliver(until_us, 40_000).unwrap();
            reruns += packet.report.reruns;
            packet
        }));
        assert!(reruns > 0 && small == expected, "buffers that overflow");
        assert!(expected[0].0 != expected[5].0, "canary: the environments differ");
    }
}

#[test]
fn sensors_that_agree_share_what_they_shared_before() {
    let Some(gpu) = crate::tests::device() else { return };
    let (scene, sensors) = rig();
    let of = |sensors: &BTreeMap<String, SensorConfig>| {
        let mut config = config(sensors);
        let (views, _) = view::views(&scene, &config).unwrap();
        let classes = classes(&views);
        let mut engine = Engine::new(&gpu, scene.clone(), views, &mut config).unwrap();
        let Parts { passes, groups, .. } = engine.parts();
        let first = &passes.walks[0];
        let same = passes.walks.iter().map(|walk| Arc::ptr_eq(walk, first)).collect::<Vec<_>>();
        (classes, groups.len(), same)
    };
    // Two sizes: two classes, of the same passes, whatever the thresholds.
    assert_eq!(of(&BTreeMap::new()), (vec![vec![0, 1, 2, 4], vec![3]], 2, vec![true; 2]));
    let passes = vec![true, false, false, false];
    assert_eq!(of(&sensors), (vec![vec![0, 4], vec![1], vec![2], vec![3]], 4, passes));
}

#[test]
fn the_settings_in_force_tell_every_cameras_sensor() {
    let Some(gpu) = crate::tests::device() else { return };
    let (scene, sensors) = rig();
    let told = |config: RunConfig| Simulator::new(&gpu, scene.clone(), config).unwrap().config().clone();
    let config = told(config(&sensors));
    for (name, given) in &sensors {
        let threshold_on = if name == "keen" { 0.15 } else { given.threshold_on };
        let in_force = SensorConfig { threshold_on, ..given.clone() };
        assert!(*config.sensor_of(name) == in_force, "{name}");
    }
    assert!(!config.sensors.contains_key("plain"), "the run's own");
    assert_eq!(told(config.clone()), config, "asked for by themselves, they are the same");
    // What no camera has is not told.
    let cameras = vec!["chain".to_owned(), "latch".to_owned()];
    let two = told(RunConfig { cameras, ..config });
    assert!(
        two.sensor == sensors["chain"] && two.sensors == [("latch".into(), sensors["latch"].clone())].into()
    );
}

#[test]
fn adaptive_time_gives_a_diffusion_the_light_of_every_instant() {
    let Some(gpu) = crate::tests::device() else { return };
    let (scene, sensors) = rig();
    let run = |name: &str, adaptive_px| {
        let cameras = vec![name.to_owned()];
        // Blocks on the grid of an even rate are its instants.
        let even = RunConfig { rate_hz: 1000.0, samples: 1, ..config(&sensors) };
        streams(&gpu, &scene, &RunConfig { adaptive_px, cameras, ..even })
    };
    assert!(run("diffusion", Some(0.4)) == run("diffusion", None));
    assert!(run("chain", Some(0.4)) != run("chain", None), "canary: others have tiles of their own rate");
    for (method, adaptive_px) in methods().into_iter().filter(|(_, px)| px.is_some()) {
        // The light of some instants: how much of it is not what is rendered there.
        let light = |name: &str, method, adaptive_px| {
            let cameras = vec![name.to_owned()];
            let even = RunConfig { rate_hz: 1000.0, ..config(&sensors) };
            let mut config = RunConfig { method, adaptive_px, cameras, ..even };
            let (views, _) = view::views(&scene, &config).unwrap();
            let mut engine = Engine::new(&gpu, scene.clone(), views, &mut config).unwrap();
            engine.instants(17, 16).unwrap()
        };
        let rendered = light("plain", Method::Native, None);
        let wrong = |name: &str| {
            let pairs = light(name, method, adaptive_px).into_iter().flatten().zip(rendered.iter().flatten());
            pairs.filter(|(a, b)| (a.max(1e-3) / b.max(1e-3)).ln().abs() > 0.2).count() as f64
                / (16.0 * 4800.0)
        };
        let (every, own_rate) = (wrong("diffusion"), wrong("plain"));
        assert!(every < 0.02, "{}: {every}", method.name());
        assert!(own_rate > 0.2, "canary, {}: {own_rate}", method.name());
    }
}

#[test]
fn what_cannot_be_is_refused_with_its_camera() {
    let (scene, sensors) = rig();
    let with = |name: &str, change: fn(&mut SensorConfig)| {
        let mut config = config(&sensors);
        change(config.sensors.entry(name.into()).or_default());
        config
    };
    let refused = |config: RunConfig| -> String {
        let checked = config.check().map_err(EngineError::from).and_then(|()| view::views(&scene, &config));
        checked.unwrap_err().to_string()
    };
    let zero = refused(with("latch", |sensor| sensor.threshold_off = 0.0));
    assert!(zero.contains("camera 'latch'") && zero.contains("threshold_off is 0"), "{zero}");
    let unknown = refused(with("letch", |_| ()));
    assert!(unknown.contains("letch") && unknown.contains("latch"), "{unknown}");
    let slow = refused(RunConfig { rate_hz: 1e-3, ..config(&sensors) });
    assert!(slow.contains("rate"), "{slow}");
    let mut ideal = sensors.clone();
    ideal.retain(|name, _| ["plain", "latch", "keen"].contains(&name.as_str()));
    assert!(RunConfig { rate_hz: 1e-3, ..config(&ideal) }.check().is_ok(), "canary");
    let mut small = Scene::clone(&scene);
    small.cameras[1].threshold_on = Some(1e-5);
    let error = view::views(&small, &config(&sensors)).unwrap_err().to_string();
    assert!(error.contains("camera 'chain'") && error.contains("0.00001"), "{error}");
}
