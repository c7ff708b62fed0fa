//! Floor 3: whole intervals. Runs, chunkings, batch orders and threads give the same bytes.

use std::sync::Arc;

use evis_core::{Event, LabelKind};
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::engine::Engine;
use crate::engine::simulator::Simulator;
use crate::gpu::Gpu;
use crate::output::packet::Packet;
use crate::world::view;

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

#[test]
fn runs_and_packet_lengths_give_the_same_bytes() {
    let Some(gpu) = super::device() else { return };
    let mut config = config();
    config.labels = vec![LabelKind::Depth, LabelKind::FlowForward, LabelKind::Instance];
    let scene = scene();
    let expected = stream(&gpu, &scene, &config, 10_000);
    assert!(expected[0].0.len() > 1000 && expected[0].1.len() == 9, "{}", expected[0].1.len());
    for packet_us in [10_000, 60_000, 777, 3_333] {
        assert!(stream(&gpu, &scene, &config, packet_us) == expected, "packets of {packet_us} us differ");
    }
    // Steps submit no further than they must: other submissions, the same bytes.
    let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
    let stepped = gather([5_000, 5_001, 40_000, 60_000].into_iter().map(|t| simulator.step(t).unwrap()));
    assert!(stepped == expected, "steps differ");
    // Canary: another rate must not give the same stream.
    config.rate_hz = 701.0;
    assert!(stream(&gpu, &scene, &config, 10_000) != expected);
}

#[test]
fn thread_counts_give_the_same_bytes() {
    let Some(gpu) = super::device() else { return };
    let (scene, config) = (batch(&[0.0, 0.2, 0.4]), config());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
            gather(std::iter::once(simulator.step(40_000).unwrap()))
        })
    };
    let one = with(1);
    assert!(one == with(2) && one == with(8));
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
fn a_views_bytes_do_not_depend_on_its_neighbours() {
    let Some(gpu) = super::device() else { return };
    // The reference luminance is measured in the first view: fixed here, so that only neighbours change.
    let config = RunConfig { reference_luminance: Some(0.5), labels: vec![LabelKind::Depth], ..config() };
    let alone: Vec<_> =
        [0.0, 0.3, 0.7].iter().map(|&o| stream(&gpu, &batch(&[o]), &config, 10_000).remove(0)).collect();
    assert!(alone[0].0 != alone[1].0, "canary: the environments differ");
    let together = stream(&gpu, &batch(&[0.0, 0.3, 0.7]), &config, 10_000);
    assert!(together == alone, "in one batch");
    let mut turned = stream(&gpu, &batch(&[0.7, 0.3, 0.0, 0.1]), &config, 10_000);
    turned.truncate(3);
    turned.reverse();
    assert!(turned == alone, "in another order, with another neighbour");
}

#[test]
fn a_buffer_that_proves_too_small_costs_a_rerun_and_no_event() {
    let Some(gpu) = super::device() else { return };
    let scene = batch(&[0.0, 0.5]);
    let mut config = RunConfig { reference_luminance: Some(0.5), ..config() };
    let (views, _) = view::views(&scene, &config).unwrap();
    let run = |capacity: u32, most: u32, config: &mut RunConfig| {
        let mut engine = Engine::new(&gpu, scene.clone(), views.clone(), config).unwrap();
        engine.limit_buffers(capacity, most);
        let packets: Vec<_> =
            [20_000, 40_000, 60_000].into_iter().map(|t| engine.deliver(t, 60_000).unwrap()).collect();
        let reruns: u64 = packets.iter().map(|p| p.report.reruns).sum();
        (gather(packets.into_iter()), reruns)
    };
    let (expected, none) = run(1 << 18, 1 << 20, &mut config);
    assert_eq!(none, 0);
    let (grown, reruns) = run(16, 1 << 20, &mut config);
    assert!(reruns > 0 && grown == expected, "grown buffers");
    let busiest = expected.iter().map(|v| v.0.len()).sum::<usize>() as u32 / 20;
    let (split, reruns) = run(16, busiest, &mut config);
    assert!(reruns > 0 && split == expected, "split submissions");
}

#[test]
fn a_device_from_outside_gives_the_same_bytes() {
    let Some(gpu) = super::device() else { return };
    let (device, queue) = super::least_device();
    let given = Gpu::from_device(device.clone(), queue.clone());
    let (scene, config) = (scene(), config());
    assert!(stream(&given, &scene, &config, 10_000) == stream(&gpu, &scene, &config, 10_000));
    // The host goes on using it.
    queue.submit([]);
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
}
