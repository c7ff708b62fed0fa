//! What a host changes, shows and hides in steps, as the oracle sees it.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::sync::Arc;

use evis_core::SensorConfig;
use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
use evis_scene::primitive::Shape;
use evis_scene::{
    HostNames, HostPoses, HostStep, Light, LightChange, Material, MaterialChange, Scene, ShadingModel,
    Variant,
};
use evis_truth::{TruthSettings, truth};

const BACKGROUND: f64 = 0.1;
const THRESHOLD: f64 = 0.2;
const EPS: f64 = 1e-3;
/// Length of a step of the host.
const STEP_US: i64 = 10_000;

/// A card that fills the picture, with light of 0.2, of which a host moves the node and changes the material.
fn scene() -> (Scene, Arc<HostPoses>) {
    let mut s = SceneBuilder::new("host");
    s.background([BACKGROUND as f32; 3]).unwrap();
    let mut material = Material::unlit("paint");
    material.base_color = [0.2, 0.2, 0.2, 1.0];
    let paint = s.material(material).unwrap();
    s.shape("card", Shape::Card { size: [9.0, 9.0] }, paint, Placement::at([0.0, 0.0, -1.0])).unwrap();
    let camera = EventCamera::new("eye").size(6, 4).intrinsics(10.0, 10.0, 3.0, 2.0);
    s.camera(camera, Placement::at([0.0; 3])).unwrap();
    let mut scene = s.build().unwrap();
    let host = scene.drive_with(&["card".into()], &["paint".into()], 0).unwrap();
    (scene, host)
}

fn settings(duration_us: i64) -> TruthSettings {
    let sensor = SensorConfig {
        threshold_on: THRESHOLD as f32,
        threshold_off: THRESHOLD as f32,
        log_eps: EPS as f32,
        ..SensorConfig::default()
    };
    TruthSettings { duration_us, sensor, reference_luminance: Some(1.0), ..TruthSettings::default() }
}

/// Makes light `light` from just after the end of the last step on.
fn paint(host: &HostPoses, light: f32) {
    let change = MaterialChange { base_color: Some([light; 3]), ..MaterialChange::default() };
    let until_us = host.known_until_us() + STEP_US;
    host.advance(&HostStep { materials: &[(0, 0, change)], ..HostStep::default() }, until_us).unwrap();
}

fn show(host: &HostPoses, seen: bool) {
    let until_us = host.known_until_us() + STEP_US;
    let visible = [(0, 0, vec![(until_us, seen)])];
    host.advance(&HostStep { visible: &visible, ..HostStep::default() }, until_us).unwrap();
}

/// (time, sign) of what a pixel fires whose light changes to each of `lights` at its time.
fn expected(first: f64, lights: &[(i64, f64)]) -> Vec<(i64, i16)> {
    let log = |light: f64| (light + EPS).ln();
    let mut reference = log(first);
    let mut events = Vec::new();
    for (t_us, light) in lights {
        let distance = log(*light) - reference;
        let count = (distance.abs() / THRESHOLD).floor();
        reference += count * THRESHOLD * distance.signum();
        events.extend(std::iter::repeat_n((*t_us, i16::from(distance > 0.0)), count as usize));
    }
    events
}

#[test]
fn materials_and_visibility_change_in_steps() {
    let (scene, host) = scene();
    host.advance(&HostStep::default(), STEP_US).unwrap();
    paint(&host, 0.83);
    show(&host, false);
    show(&host, true);
    paint(&host, 0.02);
    let found = truth(&scene, &settings(5 * STEP_US), &|_| true).unwrap();
    let wanted = expected(0.2, &[(10_000, 0.83), (20_000, BACKGROUND), (30_000, 0.83), (40_000, 0.02)]);
    assert_eq!(wanted.len(), 7 + 10 + 10 + 18, "the test has no level near a threshold");
    for y in 0..4 {
        for x in 0..6 {
            let of = found.events.iter().filter(|e| (e.x, e.y) == (x, y));
            let of: Vec<(i64, i16)> = of.map(|e| (e.t, e.p)).collect();
            assert_eq!(of, wanted, "({x}, {y})");
        }
    }
    // Canary: a scene in which nothing was said.
    let (still, host) = self::scene();
    host.advance(&HostStep::default(), 5 * STEP_US).unwrap();
    assert!(truth(&still, &settings(5 * STEP_US), &|_| true).unwrap().events.is_empty());
}

#[test]
fn a_short_glimpse_is_seen() {
    let (scene, host) = scene();
    show(&host, false);
    // Shown for 300 us, less than the time between two evaluations of what rests.
    let visible = [(0, 0, vec![(14_000, false), (14_300, true), (20_000, false)])];
    host.advance(&HostStep { visible: &visible, ..HostStep::default() }, 20_000).unwrap();
    let found = truth(&scene, &settings(20_000), &|_| true).unwrap();
    let wanted = expected(BACKGROUND, &[(14_000, 0.2), (14_300, BACKGROUND)]);
    let of = found.events.iter().filter(|e| (e.x, e.y) == (2, 1));
    assert_eq!(of.map(|e| (e.t, e.p)).collect::<Vec<_>>(), wanted);
    assert_eq!(wanted.len(), 6);
}

#[test]
fn what_the_host_has_not_said_or_what_is_forgotten_is_refused() {
    let (scene, host) = scene();
    host.advance(&HostStep::default(), 30_000).unwrap();
    let made = |settings: TruthSettings| truth(&scene, &settings, &|_| true).map_err(|e| e.to_string());
    let error = made(settings(30_001)).unwrap_err();
    assert!(error.contains("until 30000 us") && error.contains("ends at 30001 us"), "{error}");
    assert!(made(settings(30_000)).is_ok());
    host.forget_before(10_000);
    let error = made(settings(30_000)).unwrap_err();
    assert!(error.contains("before 10000 us") && error.contains("begins at 0 us"), "{error}");
    assert!(made(TruthSettings { start_us: 10_000, ..settings(20_000) }).is_ok());
}

#[test]
fn a_light_changes_in_steps() {
    let mut s = SceneBuilder::new("lit");
    let matt = Material { name: "matt".into(), model: ShadingModel::Diffuse, ..Material::default() };
    let matt = s.material(matt).unwrap();
    s.shape("card", Shape::Card { size: [9.0, 9.0] }, matt, Placement::at([0.0, 0.0, -1.0])).unwrap();
    // A white card of radiance 0.2.
    let lamp = Light::directional("lamp", 0.2 * std::f32::consts::PI);
    s.light(lamp, Placement::at([0.0; 3])).unwrap();
    let camera = EventCamera::new("eye").size(6, 4).intrinsics(10.0, 10.0, 3.0, 2.0);
    s.camera(camera, Placement::at([0.0; 3])).unwrap();
    let mut scene = s.build().unwrap();
    let host =
        scene.leave_to_host(&HostNames { lights: &["lamp".into()], ..HostNames::default() }, 0).unwrap();
    let say = |change: LightChange| {
        let until_us = host.known_until_us() + STEP_US;
        host.advance(&HostStep { lights: &[(0, 0, change)], ..HostStep::default() }, until_us).unwrap();
    };
    let none = LightChange::default();
    say(none);
    say(LightChange { intensity: Some(0.83 * std::f32::consts::PI), ..none });
    say(LightChange { on: Some(false), ..none });
    // What was said while it was off counts.
    say(LightChange { color: Some([0.1; 3]), on: Some(true), ..none });
    let found = truth(&scene, &settings(4 * STEP_US), &|_| true).unwrap();
    let wanted = expected(0.2, &[(10_000, 0.83), (20_000, 0.0), (30_000, 0.083)]);
    for (x, y) in [(0, 0), (3, 2), (5, 3)] {
        let of = found.events.iter().filter(|e| (e.x, e.y) == (x, y));
        assert_eq!(of.map(|e| (e.t, e.p)).collect::<Vec<_>>(), wanted, "({x}, {y})");
    }
    assert!(wanted.len() > 40);
    let error = host
        .advance(
            &HostStep {
                lights: &[(0, 0, LightChange { intensity: Some(-1.0), ..none })],
                ..HostStep::default()
            },
            5 * STEP_US,
        )
        .unwrap_err();
    assert!(error.to_string().contains("light of 'lamp': intensity is -1"), "{error}");
}

#[test]
fn truth_is_that_of_the_first_environment() {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let lens = evis_scene::Lens::FieldOfView { fov_y: 0.7 };
    let settings = TruthSettings { size: Some((16, 12)), ..settings(40_000) };
    let plain = truth(&scene, &settings, &|_| true).unwrap();
    let first = Variant { time_offset_s: 0.1, ..Variant::default() }.with_lens(0, lens);
    scene.variants = vec![first, Variant::default()];
    let first = truth(&scene, &settings, &|_| true).unwrap();
    scene.variants.clear();
    scene.cameras[0].lens = lens;
    let own = truth(&scene, &TruthSettings { start_us: 100_000, ..settings }, &|_| true).unwrap();
    assert_eq!(first.camera, own.camera);
    assert_eq!(first.events, own.events);
    assert!(first.events.len() > 5 && first.events != plain.events, "{} events", first.events.len());
}
