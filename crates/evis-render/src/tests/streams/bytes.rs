//! What changes no byte of a stream. One table, method × sensor, and five ways to run each: packets, steps,
//! neighbours, threads, small buffers.

use std::sync::Arc;

use evis_core::sensor::{Exposure, Noise, Readout, SensorConfig};
use evis_core::{Event, LabelFrame, LabelKind, TriggerRule, Warp};
use evis_scene::{Camera, Distortion, Lens, Light, LightFactors, Material, MaterialFactors, Scene, Variant};

use crate::config::{Antialias, Interpolation, Method, RunConfig, Shadows};
use crate::engine::Engine;
use crate::engine::simulator::Simulator;
use crate::gpu::Gpu;
use crate::world::view;

use super::gather::gather;

/// Stream that every run makes.
const UNTIL_US: i64 = 30_000;

/// Clocks of the environments of the stream that the others are compared with.
const CLOCKS_S: [f64; 2] = [0.3, 0.0];

/// Everything that reaches a user, by view.
type Stream = Vec<(Vec<Event>, Vec<LabelFrame>)>;

/// A row of the table.
struct Case {
    name: String,
    scene: Scene,
    config: RunConfig,
    /// Events that the first environment has at least.
    least: usize,
    /// Whether the device has buffers for its events; the host walks other sensors.
    on_device: bool,
    /// Whether pixels differ, or have noise.
    noisy: bool,
}

fn labels() -> Vec<LabelKind> {
    vec![LabelKind::Depth, LabelKind::FlowForward, LabelKind::Instance]
}

/// Two chains of the device that have every stage between them, a diffusion on the host, and pixels that see frames.
fn sensors() -> [(&'static str, SensorConfig); 5] {
    let mut v2e = SensorConfig::preset("v2e").unwrap();
    v2e.noise = Noise { shot_hz: 40.0, leak_hz: 5.0, hot_share: 0.01, hot_hz: 400.0, ..v2e.noise };
    v2e.readout = Readout { latency_us: 90.0, latency_light_us: 5.0, jitter_us: 30.0, ..Readout::default() };
    let mut gen4 = SensorConfig::preset("gen4-like").unwrap();
    gen4.noise.shot_hz = 40.0;
    gen4.readout.rate_limit_hz = 3e4;
    let readout = Readout { latency_us: 90.0, jitter_us: 30.0, rate_limit_hz: 3e5, ..Readout::default() };
    let mut davis = SensorConfig { readout, ..SensorConfig::preset("davis346").unwrap() };
    davis.refractory.period_us = 300;
    let latch = SensorConfig { trigger: TriggerRule::Latch, log_eps: 1e-5, ..SensorConfig::default() };
    [
        ("thresholds", SensorConfig::default()),
        ("latch", latch),
        ("v2e", v2e),
        ("gen4-like", gen4),
        ("davis346", davis),
    ]
}

/// `spinner` through a distorted lens.
fn distorted() -> Scene {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let distortion = Distortion::from_coefficients("radtan", &[-0.33, 0.1, 1e-3, -2e-3]).unwrap();
    scene.distortions.insert(scene.cameras[0].name.clone(), distortion);
    scene
}

fn methods() -> [(&'static str, RunConfig); 5] {
    let base = RunConfig {
        size: Some((64, 48)),
        rate_hz: 700.0,
        samples: 2,
        seed: 11,
        // That of the first view otherwise, which neighbours change.
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    };
    let adaptive = RunConfig { adaptive_px: Some(0.4), rate_hz: 2000.0, ..base.clone() };
    let splat = |warp: Warp| RunConfig { method: Method::Splat(warp.at(100.0, 7)), ..base.clone() };
    [
        ("native", base.clone()),
        ("adaptive", adaptive.clone()),
        ("curves", RunConfig { between: Interpolation::Curve, ..adaptive }),
        ("splat", splat(Warp::default())),
        ("evis-paper", splat(Warp::evis_paper(7))),
    ]
}

/// Every method with every sensor that differs for it, then lenses, shadows, labels and another scene.
fn cases() -> Vec<Case> {
    let spinner = || evis_scene::builtin::load("spinner", 0).unwrap();
    let mut cases = Vec::new();
    for (method, config) in methods() {
        for (sensor, settings) in sensors() {
            // Cubics are for thresholds that cross, and latches for samples: other pairs are the same passes again.
            let leaves_out = match method {
                "curves" => sensor != "thresholds",
                "adaptive" | "splat" => sensor == "latch",
                _ => false,
            };
            if leaves_out {
                continue;
            }
            cases.push(Case {
                name: format!("{method}, {sensor}"),
                scene: spinner(),
                on_device: !settings.walks_on_host(),
                noisy: !["thresholds", "latch"].contains(&sensor),
                config: RunConfig { sensor: settings, ..config.clone() },
                least: 50,
            });
        }
    }
    let [(_, native), (_, adaptive), _, (_, splat), _] = methods();
    let case = |name: &str, scene, config| Case {
        name: name.to_owned(),
        scene,
        config,
        least: 50,
        on_device: true,
        noisy: false,
    };
    let exposure = Exposure { time_us: 5_000, period_us: 7_001 };
    let exposed = |config: RunConfig| {
        let sensor = SensorConfig { exposure: exposure.clone(), ..config.sensor.clone() };
        RunConfig { sensor, label_rate_hz: 300.0, labels: vec![LabelKind::Depth], ..config }
    };
    let on_host = |name: &str, config| Case { on_device: false, ..case(name, spinner(), exposed(config)) };
    cases.extend([
        case("native, labels", spinner(), RunConfig { labels: labels(), ..native.clone() }),
        case("splat, labels", spinner(), RunConfig { labels: labels(), ..splat.clone() }),
        case("native, distorted lens", distorted(), native.clone()),
        case(
            "native, distorted lens, coverage samples",
            distorted(),
            RunConfig { antialias: Antialias::Edges, samples: 4, ..native.clone() },
        ),
        case(
            "adaptive, desk with shadow rays",
            evis_scene::builtin::load("desk", 0).unwrap(),
            RunConfig { shadows: Some(Shadows::Rays), shadow_map: Some(512), ..adaptive.clone() },
        ),
        on_host("native, exposed", native),
        on_host("adaptive, exposed", adaptive),
        on_host("splat, exposed", splat),
    ]);
    cases
}

/// The scene of `case` in environments with these clocks; one that is ahead has other lenses, lights and materials, too.
fn environments(case: &Case, clocks_s: &[f64]) -> Arc<Scene> {
    let mut scene = case.scene.clone();
    scene.materials.iter_mut().for_each(|material| material.driven = true);
    let variant = |&time_offset_s: &f64| {
        let own = Variant { time_offset_s, ..Variant::default() };
        if time_offset_s == 0.0 { own } else { otherwise(&scene, own) }
    };
    scene.variants = clocks_s.iter().map(variant).collect();
    Arc::new(scene)
}

/// `variant` with longer lenses, dimmer lights and darker materials than `scene` has.
pub(super) fn otherwise(scene: &Scene, variant: Variant) -> Variant {
    let lens = |camera: &Camera| match camera.lens {
        Lens::FieldOfView { fov_y } => Lens::FieldOfView { fov_y: 0.8 * fov_y },
        Lens::Intrinsics { fx, fy, cx, cy } => {
            Lens::Intrinsics { fx: 1.3 * fx, fy: 1.2 * fy, cx: cx + 2.0, cy }
        }
        Lens::Orthographic { height, far } => Lens::Orthographic { height: 0.8 * height, far },
    };
    let light = |light: &Light| LightFactors { intensity: 0.6 * light.intensity, ..light.factors() };
    let material = |material: &Material| {
        let own = material.factors();
        MaterialFactors { base_color: own.base_color.map(|c| 0.7 * c), ..own }
    };
    let materials = scene.materials.iter().map(material).enumerate();
    let variant = materials.fold(variant, |variant, (index, own)| variant.with_material(index, own));
    let lights = scene.lights.iter().map(light).enumerate();
    let variant = lights.fold(variant, |variant, (index, own)| variant.with_light(index, own));
    let lenses = scene.cameras.iter().map(lens).enumerate();
    lenses.fold(variant, |variant, (index, own)| variant.with_lens(index, own))
}

fn simulator(gpu: &Gpu, case: &Case, clocks_s: &[f64]) -> Simulator {
    Simulator::new(gpu, environments(case, clocks_s), case.config.clone()).unwrap()
}

/// In packets of `packet_us`.
fn packets(gpu: &Gpu, case: &Case, clocks_s: &[f64], packet_us: i64) -> Stream {
    gather(simulator(gpu, case, clocks_s).stream(UNTIL_US, packet_us).unwrap().map(Result::unwrap))
}

/// In steps, which submit no further than they must.
fn steps(gpu: &Gpu, case: &Case) -> Stream {
    let mut simulator = simulator(gpu, case, &CLOCKS_S);
    gather([1, 5_000, 5_001, 20_000, UNTIL_US].into_iter().map(|t| simulator.step(t).unwrap()))
}

/// `run` by `count` threads.
fn with_threads(count: usize, run: impl FnOnce() -> Stream + Send) -> Stream {
    rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap().install(run)
}

/// With room for few events at first, which may grow to `most`; and how many submissions ran again.
fn small_buffers(gpu: &Gpu, case: &Case, most: u32) -> (Stream, u64) {
    let scene = environments(case, &CLOCKS_S);
    let mut config = case.config.clone();
    let (views, _) = view::views(&scene, &config).unwrap();
    let mut engine = Engine::new(gpu, scene, views, &mut config).unwrap();
    engine.limit_buffers(16, most);
    let packets: Vec<_> =
        [15_000, UNTIL_US].into_iter().map(|t| engine.deliver(t, UNTIL_US).unwrap()).collect();
    let reruns = packets.iter().map(|packet| packet.report.reruns).sum();
    (gather(packets.into_iter()), reruns)
}

/// Every way to run the cases of `method`.
fn check(method: &str) {
    let Some(gpu) = crate::tests::device() else { return };
    let cases: Vec<Case> = cases().into_iter().filter(|case| case.name.starts_with(method)).collect();
    assert!(!cases.is_empty());
    for case in &cases {
        let name = &case.name;
        // Packets and steps, by three threads and by one.
        let expected = with_threads(3, || packets(&gpu, case, &CLOCKS_S, 777));
        assert!(expected[0].0.len() >= case.least, "{name}: {} events", expected[0].0.len());
        assert_eq!(expected.iter().any(|view| !view.1.is_empty()), !case.config.labels.is_empty(), "{name}");
        let stepped = with_threads(1, || steps(&gpu, case));
        assert!(stepped == expected, "{name}: steps by one thread, packets of 777 us by three");
        // Neighbours. An environment's noise follows its number; its clock is its own.
        let others = packets(&gpu, case, &[CLOCKS_S[1]; 2], 10_000);
        assert!(others[1] == expected[1], "{name}: beside another environment");
        assert!((others[0].0 != others[1].0) == case.noisy, "{name}: each environment has noise of its own");
        assert!(expected[0].0 != expected[1].0, "{name}: canary, another clock");
        // Buffers that prove too small.
        if case.on_device {
            let (grown, reruns) = small_buffers(&gpu, case, 1 << 20);
            assert!(reruns > 0 && grown == expected, "{name}: {reruns} reruns, buffers that grow");
        }
        if case.on_device && case.config.method == Method::Native && case.config.adaptive_px.is_none() {
            // More than the busiest instant has, fewer than a submission.
            let half = expected.iter().map(|view| view.0.len()).sum::<usize>() / 2;
            let (split, reruns) = small_buffers(&gpu, case, half as u32);
            assert!(reruns > 0 && split == expected, "{name}: {reruns} reruns, submissions that are split");
        }
    }
}

#[test]
fn native_streams_keep_their_bytes_however_they_are_run() {
    check("native");
}

#[test]
fn adaptive_streams_keep_their_bytes_however_they_are_run() {
    check("adaptive");
    check("curves");
}

#[test]
fn splatted_streams_keep_their_bytes_however_they_are_run() {
    check("splat");
}

#[test]
fn streams_of_the_paper_keep_their_bytes_however_they_are_run() {
    check("evis-paper");
}
