//! Streams on a device from outside, and what the other files gather streams with.

use std::sync::Arc;

use evis_core::Event;
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::engine::simulator::Simulator;
use crate::gpu::Gpu;
use crate::output::packet::Packet;

fn scene() -> Arc<Scene> {
    Arc::new(evis_scene::builtin::load("spinner", 0).unwrap())
}

fn config() -> RunConfig {
    RunConfig { size: Some((80, 60)), rate_hz: 700.0, samples: 2, ..Default::default() }
}

/// Everything that reaches a user, in time order per view.
pub(super) fn gather(packets: impl Iterator<Item = Packet>) -> Vec<(Vec<Event>, Vec<evis_core::LabelFrame>)> {
    let mut out: Vec<(Vec<Event>, Vec<_>)> = Vec::new();
    let mut end = 0;
    for packet in packets {
        assert_eq!(packet.start_us, end, "packets tile time");
        end = packet.end_us;
        out.resize_with(packet.views.len(), Default::default);
        for (all, view) in out.iter_mut().zip(packet.views) {
            assert!(view.events.iter().all(|e| (packet.start_us..packet.end_us).contains(&e.t)));
            assert!(evis_core::event::is_ordered(&view.events));
            all.0.extend(view.events);
            all.1.extend(view.labels);
        }
    }
    out
}

/// The events of each view of a stream of `duration_us` in packets of `packet_us`.
pub(super) fn events(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    (duration_us, packet_us): (i64, i64),
) -> Vec<Vec<Event>> {
    let simulator = Simulator::new(gpu, scene.clone(), config.clone()).unwrap();
    let views = gather(simulator.stream(duration_us, packet_us).unwrap().map(Result::unwrap));
    views.into_iter().map(|view| view.0).collect()
}

fn stream(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    packet_us: i64,
) -> Vec<(Vec<Event>, Vec<evis_core::LabelFrame>)> {
    let simulator = Simulator::new(gpu, scene.clone(), config.clone()).unwrap();
    gather(simulator.stream(60_000, packet_us).unwrap().map(Result::unwrap))
}

/// The spinner with an environment per clock offset.
pub(super) fn batch(offsets: &[f64]) -> Arc<Scene> {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    scene.variants = offsets
        .iter()
        .map(|&time_offset_s| evis_scene::Variant { time_offset_s, ..Default::default() })
        .collect();
    Arc::new(scene)
}

#[test]
fn a_device_from_outside_gives_the_same_bytes() {
    let Some(gpu) = crate::tests::device() else { return };
    let (device, queue) = crate::tests::least_device();
    let given = Gpu::from_device(device.clone(), queue.clone());
    let (scene, config) = (scene(), config());
    assert!(stream(&given, &scene, &config, 10_000) == stream(&gpu, &scene, &config, 10_000));
    // The host goes on using it.
    queue.submit([]);
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
}
