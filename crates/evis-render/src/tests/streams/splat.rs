//! `splat`: whole streams keep their bytes, and motions with a closed form come out as they must.

use std::sync::Arc;

use evis_core::{SensorConfig, Warp, WarpVariant};
use evis_scene::builder::{EventCamera, Placement, Sampling, SceneBuilder, ShapeSettings};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::procedural::{Pattern, Procedural};
use evis_scene::{Material, Scene, Trs};
use glam::DVec3;

use crate::config::Antialias;

use crate::config::Method;

use crate::config::RunConfig;
use crate::engine::Engine;
use crate::engine::simulator::Simulator;
use crate::gpu::Gpu;

use super::built_in::engine;

/// Pixels per unit of tangent.
const FOCAL: f64 = 100.0;
const SIZE: [u32; 2] = [64, 48];
const KEYFRAME_HZ: f64 = 100.0;
const STEPS: u32 = 4;

fn splat() -> Warp {
    Warp { margin: Some(16), ..Warp::default().at(KEYFRAME_HZ, STEPS) }
}

fn paper() -> Warp {
    Warp { variant: WarpVariant::EvisPaper, ..splat() }
}

fn config(splat: Warp) -> RunConfig {
    RunConfig {
        method: Method::Splat(splat),
        samples: 1,
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

/// A textured box's front, one metre before the camera, moved by `path`.
fn board(path: Path) -> Arc<Scene> {
    let mut s = SceneBuilder::new("board");
    s.background([0.2; 3]).unwrap();
    let picture = Procedural::new(Pattern::Noise, 64, 5).with_colors([0.05; 3], [0.9; 3]);
    let picture = s.procedural("picture", &picture, Sampling::default()).unwrap();
    let material = s.material(Material::unlit("picture").textured(picture)).unwrap();
    let shape = Shape::Box { size: [4.0, 4.0, 0.2] };
    s.shape_with("board", shape, material, ShapeSettings::default(), Placement::along(path)).unwrap();
    let [width, height] = SIZE.map(f64::from);
    let camera = EventCamera::new("camera").size(SIZE[0], SIZE[1]).near(0.01);
    let camera = camera.intrinsics(FOCAL, FOCAL, width / 2.0, height / 2.0);
    s.camera(camera, Placement::at([0.0, 0.0, 0.0])).unwrap();
    Arc::new(s.build().unwrap())
}

/// With its front at z = -1.
fn start() -> Trs {
    Trs { translation: DVec3::new(0.013, 0.007, -1.1), ..Trs::default() }
}

/// `pixels` per gap to the right.
fn sliding(pixels: f64) -> Arc<Scene> {
    let velocity = DVec3::X * (pixels * KEYFRAME_HZ / FOCAL);
    board(Path::ConstantVelocity { start: start(), velocity })
}

/// `radians` per gap about the optical axis.
fn turning(radians: f64) -> Arc<Scene> {
    let start = Trs { translation: DVec3::new(0.0, 0.0, -1.1), ..Trs::default() };
    board(Path::Spin { start, axis: DVec3::Z, rate: radians * KEYFRAME_HZ })
}

/// Largest difference of two pictures relative to the second.
fn worst(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.max(0.01)).fold(0.0, f32::max)
}

#[test]
fn a_plane_at_constant_velocity_is_warped_exactly() {
    let Some(gpu) = crate::tests::device() else { return };
    // Four pixels a gap, one an instant: what is rendered there has the same samples.
    let scene = sliding(4.0);
    let native =
        RunConfig { method: Method::Native, rate_hz: KEYFRAME_HZ * f64::from(STEPS), ..config(splat()) };
    let expected = engine(&gpu, &scene, &native).instants(0, 9).unwrap();
    for settings in [splat(), paper()] {
        let got = engine(&gpu, &scene, &config(settings)).instants(0, 9).unwrap();
        for (k, (got, expected)) in got.iter().zip(&expected).enumerate() {
            let worst = worst(got, expected);
            assert!(worst < 2e-3, "{settings:?}, instant {k}: {worst}");
        }
        assert!(worst(&got[1], &expected[2]) > 0.1, "canary: one instant is not another");
    }
}

/// Displacements of the newer side in pixels from the keyframe, at its last instant, by keyframe pixel. The older side of
/// `evis-paper` is placed in holes alone.
fn displacements(gpu: &Gpu, engine: &Engine) -> Vec<Option<([f64; 2], [f64; 2])>> {
    let store = engine.splat_store().unwrap();
    let (width, height) = (store.keyframes.width as usize, store.keyframes.height as usize);
    let words: Vec<u32> = crate::tests::read(gpu, &store.placed);
    (0..width * height)
        .map(|i| {
            let [x, y, key] = [3, 4, 5].map(|plane| words[plane * width * height + i]);
            let here = [(i % width) as f64 - 16.0, (i / width) as f64 - 16.0];
            let there = crate::cpu::splat::position([x as i32, y as i32]).map(|q| f64::from(q) / 1024.0);
            (key != 0).then_some((here, [there[0] - here[0], there[1] - here[1]]))
        })
        .collect()
}

#[test]
fn rotation_bends_linear_motion_by_its_sagitta_and_leaves_exact_motion_alone() {
    let Some(gpu) = crate::tests::device() else { return };
    for angle in [0.1f64, 0.2, 0.4] {
        let scene = turning(angle);
        for variant in [WarpVariant::EvisPaper, WarpVariant::Splat] {
            // One instant, in the middle of the first gap.
            let settings = Warp { steps: Some(2), variant, ..splat() };
            let mut engine = engine(&gpu, &scene, &config(settings));
            engine.instants(1, 1).unwrap();
            let (mut compared, mut largest) = (0, 0.0f64);
            for (here, moved) in displacements(&gpu, &engine).into_iter().flatten() {
                // From the axis, x right and y down: back by half of a turn to the left on the screen.
                let r = [here[0] + 0.5 - 32.0, here[1] + 0.5 - 24.0];
                let (s, c) = (-angle / 2.0).sin_cos();
                let exact = [r[0] * c + r[1] * s - r[0], r[1] * c - r[0] * s - r[1]];
                let error = (moved[0] - exact[0]).hypot(moved[1] - exact[1]);
                let radius = r[0].hypot(r[1]);
                let sagitta = radius * (1.0 - (angle / 2.0).cos());
                let expected = if variant == WarpVariant::EvisPaper { sagitta } else { 0.0 };
                assert!(
                    (error - expected).abs() < 4e-3,
                    "{variant:?} {angle}, r {radius}: {error}, {expected}"
                );
                assert!((sagitta - radius * angle * angle / 8.0).abs() < 2e-3 * radius * angle * angle);
                compared += 1;
                largest = largest.max(error);
            }
            assert!(compared > 2000, "{compared}");
            assert!(
                (largest > 0.02) == (variant == WarpVariant::EvisPaper),
                "canary: the two differ, {largest}"
            );
        }
    }
}

#[test]
fn what_stands_still_never_fires() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = board(Path::ConstantVelocity { start: start(), velocity: DVec3::ZERO });
    for settings in [splat(), paper()] {
        let mut config = config(settings);
        config.sensor.threshold_on = 1e-3;
        config.sensor.threshold_off = 1e-3;
        let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
        let packet = simulator.step(60_000).unwrap();
        assert_eq!((packet.report.events, packet.report.unknown), (0, 0), "{settings:?}");
        assert!(packet.report.instants >= 24 && packet.report.keyframes >= 6);
        let mut moving = Simulator::new(&gpu, sliding(1.0), config).unwrap();
        assert!(moving.step(60_000).unwrap().report.events > 1000, "canary");
    }
}

#[test]
fn light_beyond_the_papers_range_is_counted_and_told() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = board(Path::ConstantVelocity { start: start(), velocity: DVec3::ZERO });
    let run = |splat: Warp, reference: f32, steps: i64, sensor: SensorConfig| {
        let config = RunConfig { reference_luminance: Some(reference), sensor, ..config(splat) };
        let mut simulator = Simulator::new(&gpu, scene.clone(), config).unwrap();
        let packets = (1..=steps).map(|k| simulator.step(k * 60_000 / steps).unwrap().report);
        packets.collect::<Vec<_>>()
    };
    let ideal = SensorConfig::default;
    // Light of 0.05 to 3; 65 536 Y_ref are 0.3.
    let dim = 0.3 / 65_536.0;
    let whole = run(paper(), dim, 1, ideal()).remove(0);
    assert!(whole.keyframes >= 6 && whole.clipped > 0, "{whole:?}");
    assert_eq!(whole.clipped % whole.keyframes, 0, "every keyframe shows the same: {whole:?}");
    let [light] = &whole.clipped_light[..] else { panic!("{whole:?}") };
    assert_eq!((light.camera.as_str(), light.environment, light.t_us), ("camera", 0, 0));
    assert_eq!((light.pixels, light.reference_luminance), (whole.clipped, dim));
    assert!(light.luminance > 0.5 && light.luminance < 3.0, "{light:?}");
    assert!((light.brightest - 0.3).abs() < 1e-6, "{light:?}");
    // However the stream is cut, and where the host walks the pixels.
    let parts = run(paper(), dim, 7, ideal());
    assert_eq!(parts.iter().map(|report| report.clipped).sum::<u64>(), whole.clipped);
    let walked = SensorConfig::preset("davis346").unwrap();
    assert_eq!(run(paper(), dim, 1, walked)[0].clipped, whole.clipped);
    // Below, nothing is counted; nor where nothing is clipped.
    for quiet in [run(paper(), 0.5, 1, ideal()), run(splat(), dim, 1, ideal())] {
        assert_eq!((quiet[0].clipped, quiet[0].clipped_light.len()), (0, 0));
    }
}

#[test]
fn what_no_keyframe_shows_is_black_for_the_paper_and_unknown_else() {
    let Some(gpu) = crate::tests::device() else { return };
    // Without a margin, a column enters from the left at every gap's first instants.
    let scene = sliding(12.0);
    let steps = |splat: Warp| engine(&gpu, &scene, &config(splat)).instants(1, 1).unwrap().remove(0);
    let bare = Warp { margin: Some(0), steps: Some(2), ..splat() };
    // Half way, either keyframe has six columns that the other lacks: together they see all.
    assert!(steps(bare).iter().all(|y| *y > 0.0));
    let bare_paper = Warp { variant: WarpVariant::EvisPaper, ..bare };
    assert!(steps(bare_paper).iter().all(|y| *y > 0.0));
    // What turns fast about a corner leaves places that neither shows.
    let start = Trs { translation: DVec3::new(0.2, 0.2, -1.1), ..Trs::default() };
    let swinging = board(Path::Spin { start, axis: DVec3::Y, rate: 1.2 * KEYFRAME_HZ });
    let steps = |splat: Warp| engine(&gpu, &swinging, &config(splat)).instants(1, 3).unwrap();
    let unknown = steps(Warp { margin: Some(0), ..splat() });
    let holes = unknown.iter().flatten().filter(|y| **y < 0.0).count();
    let black = steps(Warp { margin: Some(0), ..paper() });
    assert!(black.iter().flatten().all(|y| *y >= 0.0) && black.iter().flatten().any(|y| *y == 0.0));
    assert!(holes > 0, "there are holes");
    let mut simulator = Simulator::new(&gpu, swinging, config(Warp { margin: Some(0), ..splat() })).unwrap();
    assert!(simulator.step(30_000).unwrap().report.unknown > 0, "the report counts them");
}

#[test]
fn pictures_of_coverage_samples_that_no_texture_holds_are_refused_by_name() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = sliding(0.0);
    let texture_edge = gpu.device.limits().max_texture_dimension_2d;
    let refused = |method: Method| {
        // 64 samples are drawn as pictures of four times the width.
        let size = Some((texture_edge / 3, 16));
        let edges = RunConfig { method, antialias: Antialias::Edges, samples: 64, size, ..config(splat()) };
        let error = Simulator::new(&gpu, Arc::clone(&scene), edges).err().map(|error| error.to_string());
        error.unwrap_or_default()
    };
    let bare = Method::Splat(Warp { margin: Some(0), ..splat() });
    for method in [Method::Native, bare] {
        let error = refused(method);
        assert!(error.contains("do not fit this device") && error.contains("`size`"), "{error:?}");
    }
}
