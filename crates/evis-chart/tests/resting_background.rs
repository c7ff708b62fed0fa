//! A background that has an animation and rests, seen by a camera that moves: the standard preset against the oracle.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::sync::Arc;

use evis_core::metric::{ScoreSettings, score};
use evis_render::{Gpu, Quality, RunConfig, Simulator};
use evis_scene::builder::{EventCamera, Labels, Placement, Sampling, SceneBuilder, ShapeSettings};
use evis_scene::motion::{Curve, Interpolation, Motion, Path};
use evis_scene::primitive::Shape;
use evis_scene::procedural::{Pattern, Procedural};
use evis_scene::{Material, Scene, Trs};
use evis_truth::{PixelChoice, TruthSettings, truth};
use glam::DVec3;

const DURATION_US: i64 = 60_000;

/// A wall with an animation whose keys are equal, and a card that spins before it.
fn scene(card: bool, velocity: DVec3, turn: f64) -> Scene {
    let mut s = SceneBuilder::new("resting background");
    s.duration_s(0.4).unwrap();
    let texture = |s: &mut SceneBuilder, pattern, seed| {
        s.procedural("texture", &Procedural::new(pattern, 128, seed), Sampling::default()).unwrap()
    };
    let bricks = texture(&mut s, Pattern::Bricks, 3);
    let bricks = s.material(Material::unlit("bricks").textured(bricks)).unwrap();
    let checks = texture(&mut s, Pattern::Checker, 5);
    let checks = s.material(Material::unlit("checks").textured(checks)).unwrap();
    let wall = Trs { translation: DVec3::new(0.0, 0.0, -2.0), ..Trs::default() };
    let repeat = ShapeSettings::default().repeat(1.0, 1.0);
    let size = [9.0, 6.0];
    let wall_node =
        s.shape_with("wall", Shape::Card { size }, bricks, repeat, Placement::at(wall.translation)).unwrap();
    if card {
        let spin =
            Path::Spin { start: Trs::default(), axis: DVec3::new(0.2, 0.1, 1.0).normalize(), rate: 3.0 };
        let mesh = s.scene().meshes.len();
        s.shape("card", Shape::Card { size: [0.9, 0.7] }, checks, Placement::along(spin)).unwrap();
        assert!(s.scene().meshes.len() > mesh && Labels::default().semantic_id == 0);
    }
    let start = Trs { translation: DVec3::new(0.1, 0.1, 2.0), ..Trs::default() };
    let path = Path::Chain(vec![
        Path::ConstantVelocity { start, velocity },
        Path::Spin { start: Trs::default(), axis: DVec3::new(0.1, 1.0, 0.3).normalize(), rate: turn },
    ]);
    let camera = EventCamera::new("camera").size(320, 240).fov_y_degrees(48.0);
    s.camera(camera, Placement::along(path)).unwrap();
    let mut scene = s.build().unwrap();
    let at = wall.translation.to_array();
    let translation = Some(Curve {
        times: vec![0.0, 0.1, 0.4],
        values: [at; 3].concat(),
        width: 3,
        interpolation: Interpolation::Linear,
    });
    scene.nodes[wall_node].motion = Motion::Animated { rest: wall, translation, rotation: None, scale: None };
    scene.validate().unwrap();
    scene
}

/// F1 within 1 ms, scaled by image speed, and the median time error in microseconds: of what `standard` is on this machine,
/// and of what it renders where it does.
fn accuracy(gpu: &Gpu, scene: Scene) -> ([(f64, f64); 2], usize) {
    let settings = TruthSettings {
        duration_us: DURATION_US,
        pixels: PixelChoice::Count(250),
        ..TruthSettings::default()
    };
    let truth = truth(&scene, &settings, &|_| true).unwrap();
    let scene = Arc::new(scene);
    let standard = Quality::Standard.sampling();
    let found = [standard, standard.rendered()].map(|sampling| {
        let mut config = RunConfig {
            quality: Some(Quality::Standard),
            reference_luminance: Some(truth.reference_luminance as f32),
            ..RunConfig::default()
        };
        sampling.apply(Some(gpu), &scene, &mut config).unwrap();
        let mut simulator = Simulator::new(gpu, Arc::clone(&scene), config).unwrap();
        let events = simulator.step(DURATION_US).unwrap().views.remove(0).events;
        let settings = ScoreSettings { tolerances_us: vec![1000], ..ScoreSettings::default() };
        let score = score(&events, &truth, &settings).unwrap();
        let scaled = &score.at(1000).unwrap().scaled;
        (scaled.f1, scaled.time_error.as_ref().unwrap().median_us)
    });
    (found, truth.events.len())
}

#[test]
fn the_standard_preset_renders_a_background_that_may_move_and_rests() {
    let gpu = match Gpu::open(None) {
        Ok(gpu) => gpu,
        Err(error) => {
            assert!(std::env::var_os("EVIS_REQUIRE_GPU").is_none_or(|v| v != "1"), "{error}");
            eprintln!("NOT RUN: {error}");
            return;
        }
    };
    let passing = || scene(true, DVec3::new(0.4, 0.1, -0.3), 0.8);
    for (name, scene) in [
        ("passing", passing()),
        ("three times as fast", passing().at_speed(3.0).unwrap()),
        ("coming nearer", scene(false, DVec3::new(0.0, 0.0, -6.0), 0.0)),
    ] {
        let (found, events) = accuracy(&gpu, scene);
        assert!(events > 300, "{name}: {events}");
        for (how, (f1, median_us)) in ["by default", "rendered"].into_iter().zip(found) {
            eprintln!(
                "{name}, {how}: F1 (1 ms) {f1:.4}, median time error {median_us:.1} us, {events} events in truth"
            );
            assert!(f1 >= 0.98, "{name}, {how}: F1 {f1}");
            assert!(median_us <= 50.0, "{name}, {how}: median {median_us} us");
        }
    }
}
