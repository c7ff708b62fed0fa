//! Environments that differ in lenses, lights and materials: each fires as a scene of its own that has these.

use std::sync::Arc;

use evis_core::{Event, LabelKind, SensorConfig};
use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
use evis_scene::primitive::Shape;
use evis_scene::{
    HostJump, HostNames, HostPose, HostStep, Lens, Light, LightChange, Material, Scene, Variant,
};

use crate::config::{Compute, Method, RunConfig, Shadows};
use crate::engine::simulator::{EnvironmentLens, Simulator};
use crate::gpu::Gpu;

use super::bytes::otherwise;
use super::gather::gather;

const UNTIL_US: i64 = 30_000;

fn configs() -> Vec<(&'static str, RunConfig)> {
    let base = RunConfig {
        size: Some((64, 48)),
        rate_hz: 700.0,
        samples: 2,
        shadow_map: Some(512),
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    };
    let labels = vec![LabelKind::Depth, LabelKind::FlowBackward, LabelKind::Hdr];
    let adaptive = RunConfig { adaptive_px: Some(0.5), ..base.clone() };
    vec![
        ("native", RunConfig { labels, label_rate_hz: 100.0, ..base.clone() }),
        ("adaptive", adaptive.clone()),
        ("adaptive, shadow rays", RunConfig { shadows: Some(Shadows::Rays), ..adaptive }),
        (
            "splat",
            RunConfig { method: Method::Splat(evis_core::Warp::default().at(60.0, 4)), ..base.clone() },
        ),
        ("decoupled", RunConfig { method: Method::Decoupled, ..base }),
    ]
}

#[test]
fn an_environment_fires_as_a_scene_of_its_own() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut scene = evis_scene::builtin::load("desk", 0).unwrap();
    // Shaders read factors of materials from one place for both.
    scene.materials.iter_mut().for_each(|material| material.driven = true);
    let mut own = scene.clone();
    let changed = otherwise(&scene, Variant::default());
    for (index, steps) in &changed.factors {
        let factors = steps.at(0.0).unwrap();
        let [r, g, b] = factors.base_color;
        own.materials[*index].base_color = [r, g, b, own.materials[*index].base_color[3]];
    }
    own.lights.iter_mut().for_each(|light| light.intensity *= 0.6);
    for camera in &mut own.cameras {
        let Lens::FieldOfView { fov_y } = &mut camera.lens else { panic!("another lens") };
        *fov_y *= 0.8;
    }
    assert!(!own.lights.is_empty() && changed.factors.len() > 2);
    scene.variants = vec![Variant::default(), changed];
    let (scene, own) = (Arc::new(scene), Arc::new(own));
    for (name, config) in configs() {
        let run = |scene: &Arc<Scene>| {
            let simulator = Simulator::new(&gpu, Arc::clone(scene), config.clone()).unwrap();
            let cameras: Vec<_> = (0..simulator.environments()).map(|e| simulator.cameras_of(e)).collect();
            (gather(simulator.stream(UNTIL_US, 10_000).unwrap().map(Result::unwrap)), cameras)
        };
        let ((batch, cameras), (alone, own_cameras)) = (run(&scene), run(&own));
        assert!(alone[0].0.len() > 50, "{name}: {} events", alone[0].0.len());
        assert!(batch[1] == alone[0], "{name}: {} events, {}", batch[1].0.len(), alone[0].0.len());
        assert!(batch[0] != batch[1], "{name}: canary");
        assert_eq!(cameras[1], own_cameras[0], "{name}");
        assert_ne!(cameras[0], cameras[1], "{name}");
    }
}

/// A white card that fills the picture, lit by a lamp of 1 lux from the front; a dark ball before it that a host moves.
fn lit(environments: usize) -> Scene {
    let mut s = SceneBuilder::new("lit");
    let white = s.material(Material::diffuse("white")).unwrap();
    s.shape("card", Shape::Card { size: [40.0, 40.0] }, white, Placement::at([0.0, 0.0, -2.0])).unwrap();
    let dark = Material { base_color: [0.2, 0.2, 0.2, 1.0], ..Material::diffuse("dark") };
    let dark = s.material(dark).unwrap();
    s.shape("ball", Shape::Sphere { radius: 0.2 }, dark, Placement::at([0.0, 0.0, -1.5])).unwrap();
    s.light(Light::directional("lamp", 1.0), Placement::at([0.0; 3])).unwrap();
    s.camera(EventCamera::new("eye").size(12, 8).fov_y_degrees(60.0), Placement::at([0.0; 3])).unwrap();
    for _ in 0..environments {
        s.variant(Variant::default()).unwrap();
    }
    s.build().unwrap()
}

fn driven(gpu: &Gpu, environments: usize, config: &RunConfig) -> Simulator {
    let mut scene = lit(environments);
    let names = HostNames { nodes: &["ball".into()], lights: &["lamp".into()], materials: &[] };
    scene.leave_to_host(&names, 0).unwrap();
    Simulator::new(gpu, Arc::new(scene), config.clone()).unwrap()
}

fn host_configs() -> Vec<(&'static str, RunConfig)> {
    let base = RunConfig {
        rate_hz: 1000.0,
        samples: 1,
        reference_luminance: Some(0.3),
        pose_step_us: Some(10_000),
        ..RunConfig::default()
    };
    let decoupled = RunConfig { method: Method::Decoupled, size: Some((12, 8)), ..base.clone() };
    // More stages than thresholds, which a device has: events leave it a microsecond later.
    let mut sensor = SensorConfig::default();
    sensor.readout.latency_us = 1.0;
    vec![
        ("native", base.clone()),
        ("adaptive", RunConfig { adaptive_px: Some(0.5), ..base }),
        ("decoupled", decoupled.clone()),
        ("stages on a device", RunConfig { compute: Compute::Gpu, sensor, ..decoupled }),
    ]
}

#[test]
fn a_light_that_a_host_changes_fires_at_once_in_its_environment() {
    let Some(gpu) = crate::tests::device() else { return };
    let dim = |intensity| LightChange { intensity: Some(intensity), ..LightChange::default() };
    let off = LightChange { on: Some(false), ..LightChange::default() };
    for (name, config) in host_configs() {
        let mut simulator = driven(&gpu, 2, &config);
        let mut step = |until_us: i64, lights: &[(usize, usize, LightChange)]| {
            simulator.step_with(until_us, &HostStep { lights, ..HostStep::default() }).unwrap()
        };
        let still = step(10_000, &[]);
        // ln 2.7 is 4.97 thresholds, on every pixel of the card.
        let brighter = step(20_000, &[(1, 0, dim(2.7))]);
        let dark = step(30_000, &[(1, 0, off), (0, 0, dim(1.0))]);
        assert!(still.views.iter().all(|view| view.events.is_empty()), "{name}");
        assert!(brighter.views[0].events.is_empty() && dark.views[0].events.is_empty(), "{name}");
        let on = &brighter.views[1].events;
        assert_eq!(on.len(), 4 * 12 * 8, "{name}");
        assert!(on.iter().all(|e| e.p == 1 && (10_000..=11_000).contains(&e.t)), "{name}");
        assert!(dark.views[1].events.len() > 10 * 12 * 8, "{name}");
        assert!(dark.views[1].events.iter().all(|e| e.p == 0 && e.t <= 21_000), "{name}");
    }
}

#[test]
fn a_reset_gives_an_environment_its_lens_and_lights_and_changes_no_other() {
    let Some(gpu) = crate::tests::device() else { return };
    let lens = Lens::Intrinsics { fx: 20.0, fy: 22.0, cx: 5.0, cy: 4.5 };
    let color = [0.3, 0.6, 0.2];
    let lamp = LightChange { color: Some(color), intensity: Some(0.7), on: None };
    for (name, config) in host_configs() {
        let ball = |simulator: &mut Simulator, until_us: i64, x: f64| {
            let pose = HostPose::new(until_us, [x, 0.0, -1.5], [0.0, 0.0, 0.0, 1.0], None);
            let poses: Vec<_> = (0..simulator.environments()).map(|e| (e, 0, vec![pose])).collect();
            simulator.step_with_poses(until_us, &poses).unwrap()
        };
        let (mut simulator, mut plain) = (driven(&gpu, 3, &config), driven(&gpu, 3, &config));
        for simulator in [&mut simulator, &mut plain] {
            ball(simulator, 10_000, 0.1);
        }
        let at = |x: f64| HostPose::new(0, [x, 0.0, -1.5], [0.0, 0.0, 0.0, 1.0], None);
        let lenses = [EnvironmentLens { environment: 1, camera: 0, lens }];
        let jump = HostJump { poses: &[(1, 0, at(0.0))], lights: &[(1, 0, lamp)], ..HostJump::default() };
        simulator.reset_to(&[1], &[], &[], &lenses, &jump).unwrap();
        let (found, expected) = (ball(&mut simulator, 20_000, 0.3), ball(&mut plain, 20_000, 0.3));
        for environment in [0, 2] {
            let [found, expected] = [&found, &expected].map(|packet| &packet.views[environment].events);
            let counts = [found.len(), expected.len()];
            assert!(found == expected && !found.is_empty(), "{name}: {environment}, {counts:?} events");
        }
        // A stream of a scene that has them begins there.
        let mut own = lit(1);
        own.lights[0].color = color;
        own.lights[0].intensity = 0.7;
        own.cameras[0].lens = lens;
        let names = HostNames { nodes: &["ball".into()], ..HostNames::default() };
        own.leave_to_host(&names, 0).unwrap();
        let mut own = Simulator::new(&gpu, Arc::new(own), config.clone()).unwrap();
        let mut wanted = ball(&mut own, 10_000, 0.3).views.remove(0).events;
        wanted.iter_mut().for_each(|event| event.t += 10_000);
        let fired = &found.views[1].events;
        if config.method == Method::Decoupled {
            // Times are sums of the stream's time and a part of a block: they may be rounded the other way.
            let key = |events: &[Event]| {
                let mut keys: Vec<_> = events.iter().map(|e| (e.x, e.y, e.t, e.p)).collect();
                keys.sort_unstable();
                keys
            };
            let (a, b) = (key(fired), key(&wanted));
            assert_eq!(a.len(), b.len(), "{name}");
            let near =
                a.iter().zip(&b).all(|(a, b)| (a.0, a.1, a.3) == (b.0, b.1, b.3) && (a.2 - b.2).abs() <= 1);
            assert!(near, "{name}");
        } else {
            assert!(*fired == wanted, "{name}: {} events, {}", fired.len(), wanted.len());
        }
        assert!(wanted.len() > 10 && *fired != expected.views[1].events, "{name}: canary");
        assert_eq!(simulator.cameras_of(1)[0].fx, 20.0);
        assert_eq!(simulator.cameras_of(0), plain.cameras_of(0));
        // What cannot be changes nothing.
        let bad = EnvironmentLens { environment: 1, camera: 0, lens: Lens::FieldOfView { fov_y: 4.0 } };
        let refused = |simulator: &mut Simulator, lens: EnvironmentLens, of: &[usize]| {
            let jump = HostJump::default();
            simulator.reset_to(of, &[], &[], &[lens], &jump).unwrap_err().to_string()
        };
        assert!(refused(&mut simulator, bad, &[1]).contains("fov_y_degrees is 229"), "{name}");
        let other = EnvironmentLens { camera: 3, lens, ..bad };
        assert!(refused(&mut simulator, other, &[1]).contains("one of the 1 cameras"), "{name}");
        let fine = EnvironmentLens { lens, ..bad };
        assert!(
            refused(&mut simulator, fine, &[0]).contains("only for environments that are reset"),
            "{name}"
        );
        assert_eq!(simulator.cameras_of(1)[0].fx, 20.0);
    }
}
