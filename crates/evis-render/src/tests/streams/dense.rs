//! Dense arrays in the place of events: those of the events that the same stream has without them, whoever makes them.

use std::sync::Arc;

use evis_core::sensor::{Noise, SensorConfig};
use evis_core::{Event, LabelKind, TriggerRule, Warp};
use evis_representation::{
    Decay, Polarities, Slice, counts, event_frame, normalize_nonzero, time_surfaces, voxel_grid,
};
use evis_scene::{HostJump, HostNames, HostPose, HostStep, Scene, Variant};

use crate::config::dense::{DenseKind, DenseOutput};
use crate::config::{Compute, Method, RunConfig};
use crate::engine::Engine;
use crate::engine::decoupled::Decoupled;
use crate::engine::simulator::{EnvironmentSensor, Simulator};
use crate::gpu::Gpu;
use crate::output::packet::Packet;
use crate::output::{DenseValues, DenseWindow};
use crate::world::view;

use super::gather::{batch, events};

const UNTIL_US: i64 = 30_000;
const WINDOW_US: i64 = 4000;

fn kinds() -> [DenseKind; 6] {
    let grid = |bins, polarities, normalize| DenseKind::VoxelGrid { bins, polarities, normalize };
    [
        DenseKind::EventFrame,
        DenseKind::Counts,
        grid(5, Polarities::Signed, false),
        grid(3, Polarities::Split, false),
        grid(5, Polarities::Signed, true),
        DenseKind::TimeSurface { tau_us: 3000.0, decay: Decay::Exponential },
    ]
}

fn config() -> RunConfig {
    RunConfig {
        size: Some((70, 40)),
        rate_hz: 700.0,
        samples: 2,
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

fn dense(kind: DenseKind) -> Option<DenseOutput> {
    Some(DenseOutput { kind, window_us: WINDOW_US })
}

/// Windows of each view, in order.
fn windows(packets: impl Iterator<Item = Packet>) -> Vec<Vec<DenseWindow>> {
    let mut all: Vec<Vec<DenseWindow>> = Vec::new();
    for packet in packets {
        all.resize_with(packet.views.len(), Vec::new);
        for (all, view) in all.iter_mut().zip(packet.views) {
            assert!(view.events.is_empty());
            let made = view.dense.unwrap();
            assert!(made.iter().all(|w| w.end_us > packet.start_us && w.end_us <= packet.end_us));
            all.extend(made);
        }
    }
    for view in &all {
        let starts: Vec<i64> = view.iter().map(|window| window.start_us).collect();
        let expected: Vec<i64> = (0..starts.len() as i64).map(|k| k * WINDOW_US).collect();
        assert_eq!(starts, expected);
    }
    all
}

fn stream(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig, packet_us: i64) -> Vec<Vec<DenseWindow>> {
    let simulator = Simulator::new(gpu, scene.clone(), config.clone()).unwrap();
    windows(simulator.stream(UNTIL_US, packet_us).unwrap().map(Result::unwrap))
}

/// How far values of `window` are from those of `events`, at most, and the sum of their magnitudes.
fn deviation(kind: &DenseKind, window: &DenseWindow, events: &[Event]) -> (f64, f64) {
    let slice = Slice::new(events, (70, 40)).unwrap();
    let slice = slice.between(Some(window.start_us), Some(window.end_us)).unwrap();
    let (shape, expected): (Vec<usize>, Vec<f64>) = match *kind {
        DenseKind::EventFrame => {
            let made = event_frame(&slice).unwrap();
            (made.shape, made.data.into_iter().map(f64::from).collect())
        }
        DenseKind::Counts => {
            let made = counts(&slice).unwrap();
            (made.shape, made.data.into_iter().map(f64::from).collect())
        }
        DenseKind::VoxelGrid { bins, polarities, normalize } => {
            let mut made = voxel_grid(&slice, bins as usize, polarities).unwrap();
            if normalize {
                normalize_nonzero(&mut made.data);
            }
            (made.shape, made.data.into_iter().map(f64::from).collect())
        }
        DenseKind::TimeSurface { tau_us, decay } => {
            let made = time_surfaces(&slice, &[window.end_us], tau_us, decay).unwrap();
            (made.shape[1..].to_vec(), made.data.into_iter().map(f64::from).collect())
        }
    };
    let (own_shape, values): (&Vec<usize>, Vec<f64>) = match &window.values {
        DenseValues::I32(array) => (&array.shape, array.data.iter().map(|v| f64::from(*v)).collect()),
        DenseValues::F32(array) => (&array.shape, array.data.iter().map(|v| f64::from(*v)).collect()),
    };
    assert_eq!((own_shape, values.len()), (&shape, expected.len()));
    let off = values.iter().zip(&expected).map(|(own, of)| (own - of).abs()).fold(0.0, f64::max);
    (off, expected.iter().map(|value| value.abs()).sum())
}

/// Whether `windows` are of `events`, view by view.
fn assert_of(name: &str, kind: &DenseKind, windows: &[Vec<DenseWindow>], events: &[Vec<Event>]) {
    // Sums of floats in another order.
    let tolerance = match kind {
        DenseKind::VoxelGrid { .. } => 2e-5,
        _ => 0.0,
    };
    assert_eq!(windows.len(), events.len());
    for (view, (windows, events)) in windows.iter().zip(events).enumerate() {
        assert_eq!(windows.len() as i64, UNTIL_US / WINDOW_US, "{name}, {kind:?}");
        let mut sums = 0.0;
        for window in windows {
            let (off, sum) = deviation(kind, window, events);
            assert!(off <= tolerance, "{name}, {kind:?}, view {view}, from {} us: {off}", window.start_us);
            sums += sum;
        }
        assert!(sums > 50.0, "{name}, {kind:?}, view {view}: {sums}");
        // Canary: a window has not its neighbour's values.
        let moved = DenseWindow { start_us: WINDOW_US, end_us: 2 * WINDOW_US, ..windows[0].clone() };
        assert!(deviation(kind, &moved, events).0 > 0.1, "{name}, {kind:?}");
    }
}

fn sensors() -> [(&'static str, SensorConfig); 5] {
    let mut noisy = SensorConfig::preset("v2e").unwrap();
    noisy.noise = Noise { shot_hz: 40.0, leak_hz: 5.0, ..noisy.noise };
    let mut late = SensorConfig::preset("gen4-like").unwrap();
    late.readout.latency_us = 90.0;
    [
        ("thresholds", SensorConfig::default()),
        ("v2e", noisy),
        // What leaves the sensor late, and a sensor that the host walks: arrays are made on the host.
        ("gen4-like", late),
        ("davis346", SensorConfig::preset("davis346").unwrap()),
        ("latch", SensorConfig { trigger: TriggerRule::Latch, ..SensorConfig::default() }),
    ]
}

#[test]
fn arrays_are_those_of_the_events() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.3, 0.0]);
    let base = config();
    let splat = Method::Splat(Warp::default().at(100.0, 7));
    let methods = [
        ("native", base.clone()),
        ("adaptive", RunConfig { adaptive_px: Some(0.4), rate_hz: 2000.0, ..base.clone() }),
        ("splat", RunConfig { method: splat, ..base.clone() }),
        ("decoupled", RunConfig { method: Method::Decoupled, ..base.clone() }),
        // What latches fires at instants, every second of which is the first microsecond of a window.
        ("borders", RunConfig { rate_hz: 500.0, ..base }),
    ];
    for (method, config) in methods {
        for (sensor, settings) in sensors() {
            if (method == "borders") != (sensor == "latch") {
                continue;
            }
            let name = format!("{method}, {sensor}");
            let config = RunConfig { sensor: settings, ..config.clone() };
            let fired = events(&gpu, &scene, &config, (UNTIL_US, UNTIL_US));
            for kind in kinds() {
                // Every kind once; on other sensors and methods, what differs there.
                if method != "native" && !matches!(kind, DenseKind::Counts) {
                    continue;
                }
                let config = RunConfig { dense: dense(kind), ..config.clone() };
                assert_of(&name, &kind, &stream(&gpu, &scene, &config, 10_000), &fired);
            }
        }
    }
}

#[test]
fn packets_and_small_buffers_change_no_array() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.3, 0.0]);
    let [(_, thresholds), (_, v2e), ..] = sensors();
    for (kind, sensor) in [(kinds()[1], thresholds.clone()), (kinds()[2], thresholds), (kinds()[2], v2e)] {
        let config = RunConfig { dense: dense(kind), sensor, ..config() };
        let expected = stream(&gpu, &scene, &config, 10_000);
        assert!(stream(&gpu, &scene, &config, 777) == expected, "{kind:?}: packets of 777 us");
        let mut own = config.clone();
        let (views, _) = view::views(&scene, &own).unwrap();
        let mut engine = Engine::new(&gpu, scene.clone(), views, &mut own).unwrap();
        engine.limit_buffers(16, 1 << 20);
        let ends = [15_000, UNTIL_US];
        // Made on the device: an engine makes none on the host.
        let packets: Vec<_> = ends.into_iter().map(|t| engine.deliver(t, UNTIL_US).unwrap()).collect();
        let reruns = packets.iter().map(|packet| packet.report.reruns).sum::<u64>();
        // Of thresholds alone there is no list of events that could be too short.
        assert_eq!(reruns > 0, !config.sensor.is_ideal(), "{kind:?}: {reruns} reruns");
        assert!(windows(packets.into_iter()) == expected, "{kind:?}: buffers that grow");
    }
}

/// A sensor of which the device has the stages, and whose events leave it at once.
fn staged() -> SensorConfig {
    let mut sensor = SensorConfig::default();
    sensor.photoreceptor.cutoff_hz = 200.0;
    sensor.noise = Noise { shot_hz: 40.0, leak_hz: 5.0, ..sensor.noise };
    sensor
}

#[test]
fn a_device_that_follows_pixels_makes_arrays_of_their_events() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch(&[0.3, 0.0]);
    let config = RunConfig { method: Method::Decoupled, compute: Compute::Gpu, sensor: staged(), ..config() };
    let fired = events(&gpu, &scene, &config, (UNTIL_US, UNTIL_US));
    for kind in kinds() {
        let config = RunConfig { dense: dense(kind), ..config.clone() };
        let made = stream(&gpu, &scene, &config, 10_000);
        assert_of("on a device", &kind, &made, &fired);
        assert!(stream(&gpu, &scene, &config, 777) == made, "{kind:?}: packets of 777 us");
    }
    // Events of thresholds alone come to the host, which makes arrays of them; those of stages do not.
    for (sensor, stay) in [(staged(), true), (SensorConfig::default(), false)] {
        let mut config = RunConfig { sensor, dense: dense(DenseKind::Counts), ..config.clone() };
        let (views, cameras) = view::views(&scene, &config).unwrap();
        let mut own = Decoupled::new(Some(&gpu), scene.clone(), views, &cameras, &mut config).unwrap();
        let packet = own.deliver(UNTIL_US, UNTIL_US).unwrap();
        assert!(packet.report.events > 100);
        for view in packet.views {
            assert_eq!((view.dense.is_some(), view.events.is_empty()), (stay, stay));
        }
    }
}

/// Two environments in which a host moves what spins.
fn driven() -> Arc<Scene> {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    scene.variants = vec![Variant::default(), Variant::default()];
    let node = scene.nodes.iter().find(|node| node.mesh.is_some()).unwrap().name.clone();
    let nodes = [node];
    scene.leave_to_host(&HostNames { nodes: &nodes, ..HostNames::default() }, 0).unwrap();
    Arc::new(scene)
}

/// A device has the stages of the sensor that a view began with. With others its light comes down; where the device makes arrays of
/// its events, it keeps them.
#[test]
fn views_on_a_device_get_other_sensors_at_a_reset() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut brisk = staged();
    brisk.threshold_on = 0.1;
    let mut held = SensorConfig::default();
    held.refractory.period_us = 500;
    let pose = |t_us: i64| HostPose::new(t_us, [t_us as f64 * 3e-5, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None);
    let new = |compute, dense: Option<DenseOutput>| {
        let config = RunConfig {
            method: Method::Decoupled,
            compute,
            sensor: staged(),
            pose_step_us: Some(WINDOW_US),
            dense,
            ..config()
        };
        Simulator::new(&gpu, driven(), config).unwrap()
    };
    let reset = |simulator: &mut Simulator, of: &[usize], sensor: Option<&SensorConfig>| {
        let poses: Vec<_> = of.iter().map(|environment| (*environment, 0, pose(0))).collect();
        let jump = HostJump { poses: &poses, ..HostJump::default() };
        let of_sensor =
            |sensor: &SensorConfig| EnvironmentSensor { environment: 1, camera: 0, sensor: sensor.clone() };
        let sensors: Vec<_> = sensor.map(of_sensor).into_iter().collect();
        simulator.reset_to(of, &[], &sensors, &[], &jump)
    };
    let steps = |simulator: &mut Simulator, sensors: &[SensorConfig]| {
        reset(simulator, &[0, 1], None).unwrap();
        let mut fired = Vec::new();
        for (step, sensor) in (1..).zip(sensors) {
            reset(simulator, &[1], Some(sensor)).unwrap();
            let until_us = step * WINDOW_US;
            let poses = [0, 1].map(|environment| (environment, 0, vec![pose(until_us)]));
            fired.push(
                simulator.step_with(until_us, &HostStep { poses: &poses, ..HostStep::default() }).unwrap(),
            );
        }
        fired
    };
    let sensors = [brisk.clone(), SensorConfig::default(), held.clone(), staged()];
    let [own, followed] =
        [Compute::Cpu, Compute::Gpu].map(|compute| steps(&mut new(compute, None), &sensors));
    let counts = |packets: &[Packet]| -> Vec<usize> {
        packets.iter().flat_map(|packet| packet.views.iter().map(|view| view.events.len())).collect()
    };
    let (own, followed) = (counts(&own), counts(&followed));
    println!("{own:?} and {followed:?} events");
    assert!(own.iter().zip(&followed).all(|(own, followed)| own.abs_diff(*followed) <= 2 + own / 20));
    // Most of them are noise, which two of the sensors have not.
    let is_noisy: Vec<bool> = own.iter().map(|count| *count > 300).collect();
    assert_eq!(is_noisy, [true, true, true, false, true, false, true, true], "{own:?}");
    let mut arrays = new(Compute::Gpu, dense(DenseKind::Counts));
    let made = steps(&mut arrays, &[brisk, staged()]);
    assert!(made.iter().flat_map(|packet| &packet.views).all(|view| view.dense.as_ref().unwrap().len() == 1));
    for other in [SensorConfig::default(), held] {
        let refused = reset(&mut arrays, &[1], Some(&other)).unwrap_err().to_string();
        assert!(refused.contains("stages that are on stay on"), "{refused}");
    }
}

#[test]
fn a_reset_environment_has_nothing_of_before() {
    let Some(gpu) = crate::tests::device() else { return };
    let own = RunConfig { rate_hz: 500.0, pose_step_us: Some(WINDOW_US), ..config() };
    let followed = RunConfig {
        method: Method::Decoupled,
        compute: Compute::Gpu,
        sensor: staged(),
        rate_hz: config().rate_hz,
        ..own.clone()
    };
    // What is followed is evaluated as often as it moves.
    let run = |dense: Option<DenseOutput>, config: &RunConfig| {
        let speed = if config.method == Method::Decoupled { 4e-6 } else { 4e-5 };
        let config = RunConfig { dense, ..config.clone() };
        let mut simulator = Simulator::new(&gpu, driven(), config).unwrap();
        let pose =
            |t_us: i64| HostPose::new(t_us, [t_us as f64 * speed, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None);
        let mut packets = Vec::new();
        // Where it is in the file it would have to leave within a step.
        let poses = [0, 1].map(|environment| (environment, 0, pose(0)));
        let jump = HostJump { poses: &poses, ..HostJump::default() };
        simulator.reset_to(&[0, 1], &[], &[], &[], &jump).unwrap();
        for step in 1..=4 {
            let until_us = step * WINDOW_US;
            let poses = [0, 1].map(|environment| (environment, 0, vec![pose(until_us)]));
            packets.push(
                simulator.step_with(until_us, &HostStep { poses: &poses, ..HostStep::default() }).unwrap(),
            );
            if step == 2 {
                let poses = [(1, 0, pose(0))];
                let jump = HostJump { poses: &poses, ..HostJump::default() };
                simulator.reset_to(&[1], &[], &[], &[], &jump).unwrap();
            }
        }
        packets
    };
    let kind = DenseKind::Counts;
    for config in [&own, &followed] {
        let (fired, made) = (run(None, config), windows(run(dense(kind), config).into_iter()));
        for (view, windows) in made.iter().enumerate() {
            for (packet, window) in fired.iter().zip(windows) {
                let off = deviation(&kind, window, &packet.views[view].events).0;
                assert_eq!(off, 0.0, "{:?}, view {view}", config.method);
            }
        }
        assert!(made[0] != made[1], "canary: one was reset");
    }
    // Between two windows there is no reset.
    let config = RunConfig { dense: Some(DenseOutput { kind, window_us: 3000 }), ..own };
    let mut simulator = Simulator::new(&gpu, driven(), config).unwrap();
    simulator.step_with(WINDOW_US, &HostStep::default()).unwrap();
    let refused = simulator.reset(&[0], &[], &[]).unwrap_err().to_string();
    assert!(refused.contains("dense_window_us (3000 us)"), "{refused}");
}

#[test]
fn causes_are_of_events() {
    let config = RunConfig { labels: vec![LabelKind::Cause], dense: dense(DenseKind::Counts), ..config() };
    let refused = config.check().unwrap_err().to_string();
    assert!(refused.contains("dense arrays"), "{refused}");
}
