//! Floor 3: streams and labels of cameras with distorted lenses.

use std::sync::Arc;

use evis_core::{Event, LabelData, LabelKind, Warp};
use evis_scene::{Camera, Distortion, Lens, Scene, SceneState, rigid};
use evis_truth::rays::{Geometry, Options, Pinhole, RayCaster, SceneCamera, Textures};

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
    let Some(gpu) = super::device() else { return };
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
                [events_beside.clone()],
                "{camera} {antialias:?}"
            );
        }
    }
}

#[test]
fn a_camera_without_coefficients_shows_what_a_pinhole_shows() {
    let Some(gpu) = super::device() else { return };
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
    let Some(gpu) = super::device() else { return };
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
            let Lens::Intrinsics { fx, fy, cx, cy } = scene.cameras[0].lens else { panic!() };
            let pinhole = Pinhole {
                world_from_camera: world_from_camera.unwrap(),
                focal: [fx, fy],
                center: [cx, cy],
                width: SIZE.0 as usize,
                height: SIZE.1 as usize,
                near: scene.cameras[0].near,
            };
            (state, pinhole)
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
    let Some(gpu) = super::device() else { return };
    let scene = Arc::new(radtan());
    let splat = RunConfig { method: Method::Splat(Warp::default()), ..config() };
    let decoupled = RunConfig { method: Method::Decoupled, ..config() };
    let adaptive = RunConfig { adaptive_px: Some(0.5), ..config() };
    let frames = RunConfig { frame_rate_hz: Some(20.0), ..config() };
    for (config, words) in
        [(splat, "splat"), (decoupled, "decoupled"), (adaptive, "adaptive_px"), (frames, "frame_rate")]
    {
        let error = Simulator::new(&gpu, Arc::clone(&scene), config.clone()).err().unwrap().to_string();
        assert!(error.contains(words) && error.contains("'bent'"), "{error}");
        let plain = RunConfig { cameras: vec!["plain".into()], ..config };
        assert!(Simulator::new(&gpu, Arc::clone(&scene), plain).is_ok(), "{words}");
    }
    for quality in Quality::ALL {
        let mut config = RunConfig { shadow_map: Some(256), ..config() };
        let request = SamplingRequest { quality: Some(quality), ..SamplingRequest::default() };
        let notes = request.apply(Some(&gpu), &scene, &mut config).unwrap();
        assert!(notes.iter().any(|note| note.contains("distorted")), "{quality:?}: {notes:?}");
        assert!(config.method == Method::Native && config.adaptive_px.is_none(), "{quality:?}");
    }
}
