//! Streams and labels of cameras with distorted lenses.

use std::sync::Arc;

use evis_core::{Event, LabelData, LabelKind, Warp};
use evis_scene::builder::{EventCamera, Placement, Sampling, SceneBuilder};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::procedural::{Pattern, Procedural};
use evis_scene::{
    Camera, Distortion, Lens, LensModel, Material, PixelLens, Rig, Scene, SceneState, Trs, rigid,
};
use glam::{DVec2, DVec3};

use evis_core::metric::{ScoreSettings, score};
use evis_truth::rays::{Geometry, Options, Pinhole, RayCaster, SceneCamera, Textures};
use evis_truth::{PixelChoice, TruthSettings};

use crate::config::{Antialias, Method, Quality, RunConfig};
use crate::engine::Simulator;
use crate::request::SamplingRequest;

const SIZE: (u32, u32) = (64, 48);

/// `spinner` with a camera "bent" that has a distorted lens, and one beside it, "plain", that has none.
fn scene(model: &str, coefficients: &[f64]) -> Scene {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let own = Camera {
        name: "bent".into(),
        lens: Lens::Intrinsics { fx: 55.0, fy: 56.0, cx: 33.0, cy: 23.0 },
        width: Some(SIZE.0),
        height: Some(SIZE.1),
        ..scene.cameras[0].clone()
    };
    let plain = Camera { name: "plain".into(), ..own.clone() };
    scene.cameras = vec![own, plain];
    let distortion = Distortion::from_coefficients(model, coefficients).unwrap();
    scene.distortions.insert("bent".into(), distortion);
    scene.validate().unwrap();
    scene
}

fn radtan() -> Scene {
    scene("radtan", &[-0.33, 0.1, 1e-3, -2e-3])
}

fn config() -> RunConfig {
    RunConfig { rate_hz: 500.0, reference_luminance: Some(0.5), audit: 0.0, ..RunConfig::default() }
}

fn events(gpu: &crate::gpu::Gpu, scene: &Scene, config: &RunConfig, packet_us: i64) -> Vec<Vec<Event>> {
    let mut simulator = Simulator::new(gpu, Arc::new(scene.clone()), config.clone()).unwrap();
    let mut events = vec![Vec::new(); simulator.cameras().len()];
    let mut t_us = 0;
    while t_us < 60_000 {
        t_us += packet_us;
        for (all, view) in events.iter_mut().zip(simulator.step(t_us).unwrap().views) {
            all.extend(view.events);
        }
    }
    events
}

#[test]
fn packets_and_neighbours_change_no_byte_of_a_distorted_camera() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = radtan();
    for antialias in [Antialias::Samples, Antialias::Edges] {
        let config = RunConfig { antialias, samples: 4, ..config() };
        let both = events(&gpu, &scene, &config, 60_000);
        assert!(both[0].len() > 500 && both[0] != both[1], "{} and {}", both[0].len(), both[1].len());
        assert_eq!(events(&gpu, &scene, &config, 7_500), both, "{antialias:?}");
        for (camera, events_beside) in ["bent", "plain"].into_iter().zip(&both) {
            let config = RunConfig { cameras: vec![camera.into()], ..config.clone() };
            assert_eq!(
                events(&gpu, &scene, &config, 20_000),
                std::slice::from_ref(events_beside),
                "{camera} {antialias:?}"
            );
        }
    }
}

#[test]
fn a_camera_without_coefficients_shows_what_a_pinhole_shows() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = scene("radtan", &[]);
    let config = RunConfig { samples: 16, ..config() };
    let mut simulator = Simulator::new(&gpu, Arc::new(scene), config).unwrap();
    let [bent, plain] = [0, 1].map(|view| simulator.luminance(view, 10_000).unwrap());
    let apart = |a: &[f64], b: &[f64]| {
        let difference: f64 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
        difference / b.iter().sum::<f64>()
    };
    assert!(apart(&bent, &plain) < 0.01, "{}", apart(&bent, &plain));
    let later = simulator.luminance(1, 60_000).unwrap();
    assert!(apart(&bent, &later) > 0.05, "canary: {}", apart(&bent, &later));
}

#[test]
fn labels_of_a_distorted_camera_are_those_of_its_own_pixels() {
    let Some(gpu) = crate::tests::device() else { return };
    for scene in [radtan(), scene("fisheye", &[0.04, -0.02])] {
        let kinds =
            [LabelKind::Depth, LabelKind::Instance, LabelKind::FlowForward, LabelKind::FlowForwardValid];
        let config = RunConfig {
            cameras: vec!["bent".into()],
            labels: kinds.to_vec(),
            label_rate_hz: 100.0,
            ..config()
        };
        let mut simulator = Simulator::new(&gpu, Arc::new(scene.clone()), config).unwrap();
        let labels = simulator.step(15_000).unwrap().views.remove(0).labels;
        let found = |kind| {
            let label = labels.iter().find(|label| label.kind == kind && label.t_us == 0).unwrap();
            label.data.clone()
        };
        let (LabelData::F32(depth), LabelData::U32(instance)) = (found(kinds[0]), found(kinds[1])) else {
            panic!()
        };
        let (LabelData::F32(flow), LabelData::U8(valid)) = (found(kinds[2]), found(kinds[3])) else {
            panic!()
        };

        // The oracle: a ray through each pixel's centre.
        let textures = Textures::new(&scene);
        let at = |t_s: f64| {
            let mut state = SceneState::default();
            scene.evaluate(t_s, &mut state);
            let world_from_camera = rigid(&state.world_from_node[scene.cameras[0].node]);
            let lens = PixelLens::new(&scene.cameras[0], Some(SIZE));
            (state, Pinhole { world_from_camera: world_from_camera.unwrap(), lens })
        };
        let options = Options::default();
        let ((now, pinhole), (then, later)) = (at(0.0), at(0.01));
        let lens = scene.calibrated_lens(0, SIZE.0, SIZE.1).unwrap();
        let caster = RayCaster::new(&scene, &now, &textures, options);
        let agreement = |lens| {
            let camera = SceneCamera { pinhole, lens };
            let expected = caster.labels(&camera);
            let moved =
                caster.flow(&camera, &Geometry::new(&scene, &then), &SceneCamera { pinhole: later, lens });
            let share = |good: &dyn Fn(usize) -> bool| {
                (0..depth.len()).filter(|p| good(*p)).count() as f64 / depth.len() as f64
            };
            [
                share(&|p| {
                    let (a, b) = (f64::from(depth[p]), expected.depth[p]);
                    a == b || (a - b).abs() < 0.01 * b
                }),
                share(&|p| instance[p] == expected.instance[p]),
                share(&|p| match moved[p] {
                    None => valid[p] == 0,
                    Some(way) => {
                        let [x, y] = [0, 1].map(|k| f64::from(flow[2 * p + k]) - way[k]);
                        valid[p] == 1 && x.hypot(y) < 0.05
                    }
                }),
            ]
        };
        let own = agreement(Some(lens));
        assert!(own.iter().all(|share| *share > 0.97), "depth, instance, flow: {own:?}");
        let pinhole_agrees = agreement(None);
        assert!(pinhole_agrees.iter().any(|share| *share < 0.95), "canary: {pinhole_agrees:?}");
    }
}

#[test]
fn what_a_distorted_lens_cannot_have_is_refused_and_presets_avoid_it() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(radtan());
    let splat = RunConfig { method: Method::Splat(Warp::default()), ..config() };
    let adaptive = RunConfig { adaptive_px: Some(0.5), ..config() };
    let frames = RunConfig { frame_rate_hz: Some(20.0), ..config() };
    for (config, words) in [(splat, "splat"), (adaptive, "adaptive_px"), (frames, "frame_rate")] {
        let error = Simulator::new(&gpu, Arc::clone(&scene), config.clone()).err().unwrap().to_string();
        assert!(error.contains(words) && error.contains("'bent'"), "{error}");
        let plain = RunConfig { cameras: vec!["plain".into()], ..config };
        assert!(Simulator::new(&gpu, Arc::clone(&scene), plain).is_ok(), "{words}");
    }
    for quality in Quality::ALL {
        let mut config = RunConfig { shadow_map: Some(256), ..config() };
        let request = SamplingRequest { quality: Some(quality), ..SamplingRequest::default() };
        let notes = request.apply(Some(&gpu), &scene, &mut config).unwrap();
        if config.method == Method::Native {
            assert!(notes.iter().any(|note| note.contains("distorted")), "{quality:?}: {notes:?}");
            assert!(config.adaptive_px.is_none(), "{quality:?}");
        }
        let decoupled = match quality {
            Quality::High => true,
            Quality::Reference => false,
            Quality::Draft | Quality::Standard => gpu.summary().kind == "cpu",
        };
        assert_eq!(config.method == Method::Decoupled, decoupled, "{quality:?}");
    }
}

/// The oracle casts its rays through the lens itself, one by one.
#[test]
fn decoupled_sampling_fires_as_the_oracle_says() {
    let fisheye = scene("fisheye", &[-0.03, 0.01, -0.005, 0.001]);
    for (name, mut scene) in [("radtan", radtan()), ("fisheye", fisheye)] {
        scene.cameras.truncate(1);
        scene.cameras[0] = Camera {
            lens: Lens::Intrinsics { fx: 275.0, fy: 280.0, cx: 165.0, cy: 115.0 },
            width: Some(320),
            height: Some(240),
            ..scene.cameras[0].clone()
        };
        let settings = TruthSettings {
            duration_us: 60_000,
            pixels: PixelChoice::Count(600),
            reference_luminance: Some(0.5),
            ..TruthSettings::default()
        };
        let truth = evis_truth::truth(&scene, &settings, &|_| true).unwrap();
        let f1 = |scene: &Scene| {
            let config = RunConfig { method: Method::Decoupled, ..config() };
            let packet = Simulator::new(None, Arc::new(scene.clone()), config).unwrap().step(60_000).unwrap();
            let events = &packet.views[0].events;
            let score = score(events, &truth, &ScoreSettings::default()).unwrap();
            [1000, 300].map(|tolerance_us| score.at(tolerance_us).unwrap().plain.f1)
        };
        let own = f1(&scene);
        let mut plain = scene.clone();
        plain.distortions.clear();
        let straight = f1(&plain);
        println!(
            "{name}: F1 {own:.4?}, {straight:.4?} without distortion, {} events of truth",
            truth.events.len()
        );
        assert!(truth.events.len() > 200 && own[0] > 0.97 && own[1] > 0.93, "{name}: {own:?}");
        assert!(straight[0] < 0.9, "canary: {straight:?}");
    }
}

/// A textured card that moves across before a distorted stereo pair.
fn stereo_scene(rig: &Rig) -> Scene {
    let mut s = SceneBuilder::new("stereo");
    let noise =
        s.procedural("noise", &Procedural::new(Pattern::Checker, 64, 3), Sampling::default()).unwrap();
    let card = s.material(Material::unlit("card").textured(noise)).unwrap();
    let start = Trs { translation: DVec3::new(-0.1, 0.05, 0.0), ..Trs::default() };
    let path = Path::ConstantVelocity { start, velocity: DVec3::new(0.8, 0.5, 0.6) };
    s.shape("card", Shape::Card { size: [1.1, 0.9] }, card, Placement::along(path)).unwrap();
    s.rig("head", rig, Placement::at(DVec3::new(0.0, 0.0, 2.0))).unwrap();
    s.build().unwrap()
}

#[test]
fn disparity_is_the_shift_of_the_point_that_fires() {
    let Some(gpu) = crate::tests::device() else { return };
    let distortion = Distortion::from_coefficients("radtan", &[-0.3, 0.1, 1e-3, -1e-3]).unwrap();
    let camera =
        EventCamera::new("camera").size(96, 72).intrinsics(90.0, 90.0, 47.0, 36.5).distortion(distortion);
    let rig = Rig::stereo(0.12, &camera).unwrap();
    let scene = Arc::new(stereo_scene(&rig));
    let config = RunConfig {
        rate_hz: 2000.0,
        antialias: Antialias::Edges,
        samples: 16,
        labels: vec![LabelKind::Depth],
        label_rate_hz: 100.0,
        reference_luminance: Some(0.4),
        ..RunConfig::default()
    };
    let mut simulator = Simulator::new(&gpu, Arc::clone(&scene), config).unwrap();
    let mut packet = simulator.step(50_000).unwrap();
    let right = packet.views.remove(1).events;
    let left = packet.views.remove(0);
    let lenses = [0, 1].map(|camera| scene.calibrated_lens(camera, 96, 72).unwrap());
    let baseline = DVec3::new(0.12, 0.0, 0.0);
    // Events of the left camera, by the depth label nearest in time: where the same point lies in the right one.
    let mut shifted = Vec::new();
    for event in &left.events {
        let labels = left.labels.iter().filter(|label| label.kind == LabelKind::Depth);
        let Some(label) = labels.min_by_key(|label| (label.t_us - event.t).abs()) else { continue };
        let LabelData::F32(depth) = &label.data else { panic!() };
        let depth = f64::from(depth[usize::from(event.y) * 96 + usize::from(event.x)]);
        let pixel = DVec2::new(f64::from(event.x) + 0.5, f64::from(event.y) + 0.5);
        if depth.is_finite() {
            let ray = lenses[0].unproject(pixel).unwrap();
            let point = ray * (depth / -ray.z) - baseline;
            shifted.extend(lenses[1].project(point).map(|there| (event, pixel, there)));
        }
    }
    assert!(shifted.len() > 1000, "{}", shifted.len());
    // The share that has an event of the same polarity of the right camera there, within a pixel and 2 ms.
    let share = |place: &dyn Fn(DVec2, DVec2) -> DVec2| {
        let matched = shifted.iter().filter(|(event, here, there)| {
            let at = place(*here, *there);
            right.iter().any(|other| {
                let center = DVec2::new(f64::from(other.x) + 0.5, f64::from(other.y) + 0.5);
                other.p == event.p
                    && (other.t - event.t).abs() < 2000
                    && (center - at).abs().max_element() <= 1.0
            })
        });
        matched.count() as f64 / shifted.len() as f64
    };
    let found = share(&|_, there| there);
    let none = share(&|here, _| here);
    let other_way = share(&|here, there| 2.0 * here - there);
    assert!(found > 0.93, "{found}");
    assert!(none < found - 0.2 && other_way < found - 0.2, "canary: {none} and {other_way}");
}
