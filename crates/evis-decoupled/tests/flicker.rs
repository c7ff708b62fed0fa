//! Light and motion that are back where they were at the times of a block's evaluations.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use evis_decoupled::{Settings, simulate};
use evis_scene::motion::{Harmonic, Path, WaveShape, Waveform};
use evis_scene::{Lens, Material, Mesh, Motion, Node, Scene, ShadingModel, Trs};
use glam::DVec3;

mod common;

use common::camera;

/// A grey card before a camera, `path` moves it.
fn card(waveform: Option<Waveform>, path: Option<Path>) -> Scene {
    let shape = evis_scene::primitive::Shape::Card { size: [1.0, 1.0] }.build(None, [1.0, 1.0]).unwrap();
    let material = Material {
        model: ShadingModel::Unlit,
        base_color: [0.5, 0.5, 0.5, 1.0],
        emission_waveform: waveform,
        ..Material::default()
    };
    let away = Trs { translation: DVec3::new(0.0, 0.0, -2.0), ..Trs::default() };
    let motion = path.map_or(Motion::Fixed(away.matrix()), |path| Motion::Path(path.into()));
    let mut scene = Scene {
        background: [0.05; 3],
        materials: vec![material],
        meshes: vec![Mesh { primitives: vec![shape], ..Mesh::default() }],
        ..Scene::default()
    };
    scene.add_node(Node { mesh: Some(0), motion, ..Node::default() });
    let node = scene.add_node(Node::default());
    let lens = Lens::FieldOfView { fov_y: 0.8 };
    scene.cameras.push(camera(node, lens));
    scene
}

fn settings() -> Settings {
    Settings {
        size: Some((16, 12)),
        duration_us: 100_000,
        reference_luminance: Some(0.5),
        ..Settings::default()
    }
}

#[test]
fn sines_fire_at_the_times_of_their_formula() {
    for frequency_hz in [30.517_578_125, 122.070_312_5, 500.0, 976.562_5] {
        let wave = Waveform { shape: WaveShape::Sine, frequency_hz, phase: 0.3, low: 0.2, high: 1.0 };
        let events = simulate(&card(Some(wave), None), &settings()).unwrap().events;
        let of: Vec<i64> = events.iter().filter(|e| (e.x, e.y) == (8, 6)).map(|e| e.t).collect();
        // ln((0.5 factor) / 0.5 + eps) crosses its thresholds: found in steps of a microsecond.
        let log = |t_us: f64| (wave.factor(t_us * 1e-6) + 1e-3).ln();
        let (mut reference, mut wanted) = (log(0.0), Vec::new());
        for t in 1..100_000 {
            let now = log(f64::from(t));
            while (now - reference).abs() >= 0.2 {
                reference += 0.2 * (now - reference).signum();
                wanted.push(i64::from(t));
            }
        }
        assert!(wanted.len() > 20, "{frequency_hz} Hz: {}", wanted.len());
        assert_eq!(of.len(), wanted.len(), "{frequency_hz} Hz");
        let worst = of.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).max().unwrap();
        // A thousandth of the light, where it turns slowest.
        let within_us = (0.02 / frequency_hz * 1e6) as i64;
        assert!(worst <= within_us, "{frequency_hz} Hz: {worst} us, {within_us} us allowed");
    }
}

#[test]
fn a_vibration_with_a_whole_number_of_swings_in_a_block_is_seen() {
    let swing = |frequency_hz: f64| {
        let term = Harmonic {
            frequency_hz,
            phase: 0.0,
            translation: DVec3::new(0.1, 0.0, 0.0),
            rotation: DVec3::ZERO,
        };
        let start = Trs { translation: DVec3::new(0.0, 0.0, -2.0), ..Trs::default() };
        Path::Harmonic { start, terms: vec![term] }
    };
    // 4, 8 and 16 swings in 32 768 us: back at the same pose at every quarter of it.
    for swings in [4.0, 8.0, 16.0] {
        let frequency_hz = swings / 0.032_768;
        let events = simulate(&card(None, Some(swing(frequency_hz))), &settings()).unwrap().events;
        let half_swings = 0.2 * frequency_hz;
        // Both edges of the card, each in eight rows or so, each half swing.
        let least = (8.0 * half_swings) as usize;
        assert!(events.len() > least, "{frequency_hz} Hz: {} events, {least} expected", events.len());
    }
    let still = simulate(&card(None, Some(swing(0.0))), &settings()).unwrap().events;
    assert!(still.is_empty(), "canary: what rests fires nothing");
}

#[test]
fn edges_of_square_waves_are_jumps_wherever_rounding_puts_them() {
    for (frequency_hz, phase, duty) in [(435.123_456_7, 0.3, 0.1), (77.77, 0.9, 0.5), (333.3, 0.123_456, 0.7)]
    {
        let wave = Waveform { shape: WaveShape::Pwm { duty }, frequency_hz, phase, low: 0.2, high: 1.0 };
        let events = simulate(&card(Some(wave), None), &settings()).unwrap().events;
        let of = events.iter().filter(|e| (e.x, e.y) == (8, 6));
        let mut count = 0;
        for event in of {
            // An edge within a microsecond.
            let factor = |t_us: f64| wave.factor(t_us * 1e-6);
            let (before, after) = (factor(event.t as f64 - 1.0), factor(event.t as f64 + 2.0));
            assert!(before != after, "{frequency_hz} Hz: an event at {} us, between edges", event.t);
            count += 1;
        }
        // ln 5 / 0.2 = 8.05 thresholds at each edge; light that is back at its first level may just reach the eighth or not.
        let of_edge = f64::from(count) / (0.2 * frequency_hz);
        assert!((6.7..8.4).contains(&of_edge), "{frequency_hz} Hz: {count} events");
    }
}
