//! The whole sensor chain with every kind of noise: small buffers, other cameras, least limits; `streams/bytes.rs` has
//! packets, steps, neighbours and threads.

use std::sync::Arc;

use evis_core::Event;
use evis_core::sensor::{Noise, Readout, SensorConfig};
use evis_scene::Scene;

use super::gather::{batch, events, gather};
use crate::config::RunConfig;
use crate::engine::Engine;
use crate::gpu::Gpu;
use crate::world::view;

/// Two sensors that have everything between them.
fn sensors() -> [SensorConfig; 2] {
    let mut v2e = SensorConfig::preset("v2e").unwrap();
    v2e.noise = Noise { shot_hz: 40.0, leak_hz: 5.0, hot_share: 0.01, hot_hz: 400.0, ..v2e.noise };
    v2e.readout = Readout { latency_us: 90.0, latency_light_us: 5.0, jitter_us: 30.0, ..Readout::default() };
    let mut gen4 = SensorConfig::preset("gen4-like").unwrap();
    gen4.noise.shot_hz = 40.0;
    gen4.readout.rate_limit_hz = 3e4;
    [v2e, gen4]
}

fn config(sensor: &SensorConfig) -> RunConfig {
    RunConfig {
        sensor: sensor.clone(),
        size: Some((80, 60)),
        rate_hz: 700.0,
        samples: 2,
        seed: 11,
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

fn stream(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig, packet_us: i64) -> Vec<Vec<Event>> {
    events(gpu, scene, config, (60_000, packet_us))
}

#[test]
fn a_camera_of_two_has_the_noise_that_it_has_alone() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let mut second = scene.cameras[0].clone();
    second.name = "second".into();
    scene.cameras.push(second);
    let scene = Arc::new(scene);
    let both = config(&sensors()[0]);
    let one = RunConfig { cameras: vec!["second".into()], ..both.clone() };
    let (both, one) = (stream(&gpu, &scene, &both, 10_000), stream(&gpu, &scene, &one, 10_000));
    assert!(both[1] == one[0]);
    assert!(both[0] != both[1], "canary: two cameras at one place have noise of their own");
}

#[test]
fn a_device_with_the_least_limits_gives_the_same_bytes() {
    let Some(gpu) = crate::tests::device() else { return };
    let (device, queue) = crate::tests::least_device();
    let given = Gpu::from_device(device, queue);
    let (scene, config) = (batch(&[0.0]), config(&sensors()[0]));
    assert!(stream(&given, &scene, &config, 10_000) == stream(&gpu, &scene, &config, 10_000));
}

#[test]
fn small_buffers_cost_reruns_and_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.0, 0.5]);
    for sensor in sensors() {
        let mut config = config(&sensor);
        let (views, _) = view::views(&scene, &config).unwrap();
        let run = |limits: Option<(u32, u32, u64)>, config: &mut RunConfig| {
            let mut engine = Engine::new(&gpu, scene.clone(), views.clone(), config).unwrap();
            if let Some((capacity, most, feed)) = limits {
                engine.limit_buffers(capacity, most);
                engine.limit_feed(feed);
            }
            let packets: Vec<_> =
                [20_000, 40_000, 60_000].into_iter().map(|t| engine.deliver(t, 60_000).unwrap()).collect();
            let reruns: u64 = packets.iter().map(|p| p.report.reruns).sum();
            let lost: u64 = packets.iter().map(|p| p.report.suppressed + p.report.dropped).sum();
            (gather(packets.into_iter()), lost, reruns)
        };
        let (expected, lost, none) = run(None, &mut config);
        assert!(none == 0 && lost > 0);
        let (grown, same, reruns) = run(Some((16, 1 << 20, 1 << 20)), &mut config);
        assert!(reruns > 0 && grown == expected && same == lost, "grown buffers");
        let busiest = expected.iter().map(|v| v.0.len()).sum::<usize>() as u32 / 5;
        let (split, same, reruns) = run(Some((16, busiest, 1 << 20)), &mut config);
        assert!(reruns > 0 && split == expected && same == lost, "split submissions");
        // Room for the candidates of an instant or two.
        let (split, same, _) = run(Some((1 << 18, 1 << 20, 4_000)), &mut config);
        assert!(split == expected && same == lost, "submissions split by their candidates");
    }
}

#[test]
fn noise_that_does_not_fit_is_refused_by_name() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut config = config(&sensors()[0]);
    config.sensor.noise.shot_hz = 10_000.0;
    let (views, _) = view::views(&batch(&[0.0]), &config).unwrap();
    let mut engine = Engine::new(&gpu, batch(&[0.0]), views, &mut config).unwrap();
    engine.limit_feed(4_000);
    let error = engine.deliver(20_000, 20_000).unwrap_err().to_string();
    assert!(error.contains("noise") && error.contains("`rate_hz`"), "{error}");
}

#[test]
fn what_the_engine_has_not_is_refused_by_name() {
    let refused = |config: RunConfig| config.check().unwrap_err().to_string();
    let slow = RunConfig { rate_hz: 1e-3, ..config(&sensors()[0]) };
    assert!(refused(slow).contains("rate"));
    let mut bad = config(&sensors()[0]);
    bad.sensor.photoreceptor.cutoff_hz = f32::NAN;
    assert!(refused(bad).contains("photoreceptor.cutoff_hz"));
    let ideal = RunConfig { rate_hz: 1e-3, ..RunConfig::default() };
    assert!(ideal.check().is_ok(), "canary: thresholds alone have no such limit");
}
