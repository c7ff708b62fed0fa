//! Sampling each tile at its own rate gives what sampling everything at that rate gives.

use evis_core::{Event, SensorConfig};
use evis_scene::builder::{EventCamera, Labels, Placement, SceneBuilder};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{Material, Mesh, Primitive, Trs};
use glam::{DQuat, DVec3};

use crate::config::Antialias;

use crate::config::Interpolation;

use crate::config::RunConfig;

use super::built_in::{deliver, engine, force, run, scene};

fn config(adaptive_px: Option<f64>, rate_hz: f64) -> RunConfig {
    RunConfig {
        size: Some((100, 76)),
        rate_hz,
        adaptive_px,
        samples: 2,
        reference_luminance: Some(1.0),
        ..Default::default()
    }
}

#[test]
fn at_one_rate_everywhere_it_is_native_at_that_rate() {
    let Some(gpu) = crate::tests::device() else { return };
    let noisy = SensorConfig::preset("evis").unwrap();
    let shared = SensorConfig::preset("v2e-noisy").unwrap();
    let (whole, edges) = ((Antialias::Samples, 2), (Antialias::Edges, 16));
    for (name, sensor, (antialias, samples)) in [
        ("spinner", SensorConfig::default(), whole),
        ("spinner", noisy, whole),
        ("desk", shared, whole),
        ("spinner", SensorConfig::default(), edges),
    ] {
        let scene = scene(name);
        for log2_stride in [0, 2, 4] {
            let with = |base| RunConfig { sensor: sensor.clone(), antialias, samples, ..base };
            let plain = with(config(None, 1000.0 / f64::from(1 << log2_stride)));
            let adaptive = with(config(Some(1.0), 1000.0));
            let all = run(&gpu, &scene, &plain, 8_000);
            let mut engine = engine(&gpu, &scene, &adaptive);
            force(&mut engine, log2_stride);
            let drawn = deliver(engine, 8_000);
            let (count, expected) = (drawn.events[0].len(), all.events[0].len());
            assert!(expected > 100, "{name}");
            assert!(drawn.events == all.events, "{name} {log2_stride}: {count} and {expected}");
            if name == "spinner" {
                // Blocks end at 64 ms, which native samples too.
                assert_eq!(drawn.drawn_pixels, all.drawn_pixels, "{name} {log2_stride}");
            }
        }
    }
}

#[test]
fn the_finest_rate_everywhere_changes_nothing_and_what_is_still_is_left_out() {
    let Some(gpu) = crate::tests::device() else { return };
    for name in ["spinner", "desk"] {
        let scene = scene(name);
        let native = run(&gpu, &scene, &config(None, 1000.0), 16_000);
        // So small a step is never kept: whatever moves is sampled at every instant.
        let finest = run(&gpu, &scene, &config(Some(1e-9), 1000.0), 16_000);
        assert!(finest.events == native.events, "{name}");
        let (drawn, all) = (finest.drawn_pixels, native.drawn_pixels);
        // Whole tiles instead of rectangles, and half of the picture at most where only a toy moves.
        let most = if name == "desk" { 65 * 100 * 76 / 2 } else { all };
        assert!(drawn <= most, "{name}: {drawn} of {most}, native {all}");
    }
}

#[test]
fn curves_fire_other_events_than_lines_of_fewer_pixels_than_native() {
    let Some(gpu) = crate::tests::device() else { return };
    for name in ["spinner", "desk"] {
        let alone = scene(name);
        let config = config(Some(0.3), 2000.0);
        let ran = run(&gpu, &alone, &config, 64_000);
        let native = RunConfig { adaptive_px: None, ..config.clone() };
        let all = run(&gpu, &alone, &native, 64_000).drawn_pixels;
        assert!(ran.drawn_pixels < all / 2, "{name}: {} of {all} pixels", ran.drawn_pixels);
        let curves = RunConfig { between: Interpolation::Curve, ..config };
        assert!(run(&gpu, &alone, &curves, 64_000).events != ran.events, "{name}");
    }
}

#[test]
fn a_coarser_rate_keeps_close_to_the_finest() {
    let Some(gpu) = crate::tests::device() else { return };
    for name in ["spinner", "desk", "street"] {
        let scene = scene(name);
        let [fine, adaptive, coarse] = [None, Some(0.2), Some(3.0)]
            .map(|px| run(&gpu, &scene, &config(px, 2000.0), 16_000).events.remove(0));
        // Events of a pixel and polarity that have a partner within 1 ms.
        let found = |events: &[Event]| {
            let mut left: std::collections::HashMap<_, Vec<i64>> = Default::default();
            for e in events {
                left.entry((e.x, e.y, e.p)).or_default().push(e.t);
            }
            let near = |e: &&Event| {
                left.get(&(e.x, e.y, e.p)).is_some_and(|times| times.iter().any(|t| (t - e.t).abs() <= 1_000))
            };
            fine.iter().filter(near).count() as f64 / fine.len() as f64
        };
        let (close, far) = (found(&adaptive), found(&coarse));
        assert!(close > 0.9 && far < close - 0.05, "{name}: {close:.3}, canary {far:.3}");
    }
}

#[test]
fn what_a_plane_of_an_orthographic_camera_cuts_is_sampled_as_it_moves() {
    let Some(gpu) = crate::tests::device() else { return };
    // A card aslant, or the camera, goes along the rays: nothing moves in the picture but the border of the cut.
    let along = |velocity: f64| {
        let start = Trs::default();
        Path::ConstantVelocity { start, velocity: DVec3::NEG_Z * velocity }
    };
    for (card_velocity, camera_velocity) in [(3.0, 0.0), (0.0, 3.0)] {
        let mut s = SceneBuilder::new("cut");
        s.background([0.1; 3]).unwrap();
        let bright = s.material(Material::unlit("bright").colored([0.9; 3])).unwrap();
        let card =
            Primitive { material: bright, ..Shape::Card { size: [3.0, 3.0] }.build(None, [1.0; 2]).unwrap() };
        let mesh = s.mesh(Mesh { primitives: vec![card], ..Mesh::default() }).unwrap();
        let aslant = DQuat::from_rotation_y(0.9);
        let place = Placement::at([0.0, 0.0, -3.0]).turned(aslant).moving(along(card_velocity));
        s.object("card", mesh, Labels::default(), place).unwrap();
        let eye = EventCamera::new("eye").orthographic(1.5, 3.2);
        s.camera(eye, Placement::default().moving(along(camera_velocity))).unwrap();
        let scene = std::sync::Arc::new(s.build().unwrap());
        let native = run(&gpu, &scene, &config(None, 1000.0), 16_000);
        let adaptive = run(&gpu, &scene, &config(Some(0.5), 1000.0), 16_000);
        let (count, expected) = (adaptive.events[0].len(), native.events[0].len());
        assert!(expected > 500, "{card_velocity}: {expected}");
        assert!(adaptive.events == native.events, "{card_velocity}: {count} and {expected}");
    }
}
