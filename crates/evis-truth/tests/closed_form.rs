//! The two oracles agree: scenes whose light is known in closed form, rendered ray by ray.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::TAU;
use std::sync::Arc;

use evis_core::closed_form::{
    Bar, Edge, ExponentialRamp, Flicker, FlickerShape, Footprint, LinearRamp, Signal, Sinusoid, Spokes,
};
use evis_core::metric::{ScoreSettings, score};
use evis_core::{SensorConfig, Truth, closed_form};
use evis_scene::motion::{Curve, Interpolation, Path, WaveShape, Waveform};
use evis_scene::{Camera, Lens, Light, Material, Mesh, Motion, Node, Primitive, Scene, ShadingModel, Trs};
use evis_truth::{Audit, Lattice, PixelChoice, TruthSettings, truth};
use glam::{DMat4, DQuat, DVec3};

const WIDTH: u32 = 32;
const HEIGHT: u32 = 24;
/// A metre at the distance of the wall is this many pixels.
const PX: f64 = 100.0;
const DURATION_US: i64 = 200_000;

/// A camera at the origin that looks along -Z; the wall at z = -1 is `PX` pixels per metre.
fn scene() -> Scene {
    let mut scene = Scene::default();
    let node = scene.add_node(Node::default());
    let lens = Lens::Intrinsics { fx: PX, fy: PX, cx: f64::from(WIDTH) / 2.0, cy: f64::from(HEIGHT) / 2.0 };
    let camera = Camera::new("camera", node, lens);
    scene.cameras.push(Camera { width: Some(WIDTH), height: Some(HEIGHT), ..camera });
    scene
}

/// World position of an image point on the wall.
fn on_wall(x: f64, y: f64) -> DVec3 {
    DVec3::new((x - f64::from(WIDTH) / 2.0) / PX, (f64::from(HEIGHT) / 2.0 - y) / PX, -1.0)
}

fn flat(corners: [[f64; 2]; 4]) -> Primitive {
    Primitive {
        positions: corners.map(|[x, y]| [x as f32, y as f32, 0.0]).to_vec(),
        normals: vec![[0.0, 0.0, 1.0]; 4],
        indices: vec![0, 1, 2, 0, 2, 3],
        ..Primitive::default()
    }
}

/// The rectangle [x0, x1] x [y0, y1] in the plane z = 0, metres.
fn card(x0: f64, x1: f64, y0: f64, y1: f64) -> Primitive {
    flat([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
}

fn grey(luminance: f64) -> Material {
    let v = luminance as f32;
    Material { model: ShadingModel::Unlit, base_color: [v, v, v, 1.0], ..Material::default() }
}

fn add(scene: &mut Scene, mut primitive: Primitive, material: Material, motion: Motion) {
    scene.materials.push(material);
    primitive.material = scene.materials.len() - 1;
    scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
    let mesh = Some(scene.meshes.len() - 1);
    scene.add_node(Node { mesh, motion, instance_id: scene.nodes.len() as u32, ..Node::default() });
}

fn at(place: DVec3) -> Motion {
    Motion::Fixed(DMat4::from_translation(place))
}

fn moving(place: DVec3, rotation: DQuat, velocity: DVec3) -> Motion {
    let start = Trs { translation: place, rotation, scale: DVec3::ONE };
    Motion::Path(Arc::new(Path::ConstantVelocity { start, velocity }))
}

/// A wall behind the one at z = -1 that fills the view.
fn backdrop(scene: &mut Scene, luminance: f64) {
    add(scene, card(-3.0, 3.0, -3.0, 3.0), grey(luminance), at(DVec3::new(0.0, 0.0, -2.0)));
}

/// Unequal thresholds: with equal ones, light that returns to where it was ends on a threshold, and whether the last event
/// fires is up to rounding.
fn sensor() -> SensorConfig {
    SensorConfig { threshold_off: 0.23, ..Default::default() }
}

fn settings(lattice: Lattice, pixels: PixelChoice) -> TruthSettings {
    let (duration_us, sensor) = (DURATION_US, sensor());
    TruthSettings {
        sensor,
        duration_us,
        pixels,
        lattice,
        reference_luminance: Some(1.0),
        time_error_us: Some(1.0),
        ..Default::default()
    }
}

/// How far the oracles' events are apart in time.
#[derive(Debug)]
struct Apart {
    rms_us: f64,
    worst_us: f64,
}

/// Compares the oracles on `pixels` pixels, after checking that each pixel's polarities agree.
#[track_caller]
fn difference(scene: &Scene, signal: &dyn Signal, lattice: Lattice, pixels: usize) -> Apart {
    let rendered = truth(scene, &settings(lattice, PixelChoice::Count(pixels)), &|_| true).unwrap();
    let exact = exact(&rendered, signal);
    assert!(exact.events.len() > 20, "something happens: {}", exact.events.len());
    let (mut worst, mut squares, mut count) = (0.0_f64, 0.0, 0.0);
    for pixel in &rendered.pixels {
        let own = |t: &Truth| -> Vec<(i64, i16)> {
            let of_pixel = t.events.iter().filter(|e| [e.x, e.y] == *pixel);
            of_pixel.map(|e| (e.t, e.p)).collect()
        };
        let (a, b) = (own(&rendered), own(&exact));
        // An event within a millisecond of the end may fall on either side of it.
        let early = |list: &[(i64, i16)]| list.iter().filter(|e| e.0 < DURATION_US - 1000).count();
        assert!(
            early(&a) <= b.len() && early(&b) <= a.len(),
            "{pixel:?}: {} and {} events",
            a.len(),
            b.len()
        );
        for (a, b) in a.iter().zip(&b) {
            assert_eq!(a.1, b.1, "{pixel:?}: polarity at {} and {} us", a.0, b.0);
            let error = (a.0 - b.0).abs() as f64;
            worst = worst.max(error);
            squares += error * error;
            count += 1.0;
        }
    }
    Apart { rms_us: f64::sqrt(squares / count), worst_us: worst }
}

/// Time in which a pattern moves by the distance of two samples of the smallest lattice along an axis.
fn lattice_step_us(speed_px_per_s: f64) -> f64 {
    1e6 / 144.0 / speed_px_per_s
}

fn exact(rendered: &Truth, signal: &dyn Signal) -> Truth {
    closed_form::truth(signal, &rendered.camera, &sensor(), 1.0, &rendered.pixels, DURATION_US).unwrap()
}

#[test]
fn an_edge_crosses_when_its_area_says_so() {
    for (degrees, speed, lattice) in [
        (0.0, 120.0, Lattice::First),
        (0.0, 35.0, Lattice::Second),
        (20.0, 120.0, Lattice::First),
        (45.0, 77.0, Lattice::First),
        (68.0, 120.0, Lattice::Second),
    ] {
        let angle = f64::to_radians(degrees);
        let edge = Edge {
            light_behind: 0.1,
            light_ahead: 1.0,
            angle_radians: angle,
            position_px: 2.3,
            speed_px_per_s: speed,
        };
        let mut scene = scene();
        backdrop(&mut scene, 1.0);
        // The card's right side is the edge; y of the image runs down, so the card turns the other way.
        let (sine, cosine) = angle.sin_cos();
        let place = on_wall(2.3 * cosine, 2.3 * sine);
        let velocity = DVec3::new(cosine, -sine, 0.0) * speed / PX;
        let motion = moving(place, DQuat::from_rotation_z(-angle), velocity);
        add(&mut scene, card(-4.0, 0.0, -4.0, 4.0), grey(0.1), motion);
        let worst = difference(&scene, &edge, lattice, 30);
        // Where an oblique edge just touches a pixel, light hardly changes and its error weighs most.
        let fits = worst.rms_us <= 6.0 && worst.worst_us <= lattice_step_us(speed);
        assert!(fits, "{degrees} degrees at {speed} px/s: {worst:?}");
    }
}

#[test]
fn a_bar_narrower_than_a_pixel_rises_and_falls_in_time() {
    for (width, degrees) in [(0.4, 0.0), (0.7, 30.0), (2.5, 10.0)] {
        let angle = f64::to_radians(degrees);
        let bar = Bar {
            light_bar: 4.0,
            light_beside: 0.3,
            width_px: width,
            angle_radians: angle,
            position_px: 1.7,
            speed_px_per_s: 90.0,
        };
        let mut scene = scene();
        backdrop(&mut scene, 0.3);
        let (sine, cosine) = angle.sin_cos();
        let velocity = DVec3::new(cosine, -sine, 0.0) * 90.0 / PX;
        let motion = moving(on_wall(1.7 * cosine, 1.7 * sine), DQuat::from_rotation_z(-angle), velocity);
        let half = width / 2.0 / PX;
        add(&mut scene, card(-half, half, -4.0, 4.0), grey(4.0), motion);
        let worst = difference(&scene, &bar, Lattice::First, 24);
        let fits = worst.rms_us <= 8.0 && worst.worst_us <= lattice_step_us(90.0);
        assert!(fits, "{width} px, {degrees} degrees: {worst:?}");
    }
}

#[test]
fn a_shadow_s_border_is_an_edge() {
    // Light comes from the left, over an occluder that the camera does not see.
    let (reflected, speed) = (0.6, 60.0);
    let direct = 2.0;
    let mut scene = scene();
    scene.ambient = [0.25; 3];
    let diffuse =
        Material { model: ShadingModel::Diffuse, base_color: [0.6, 0.6, 0.6, 1.0], ..Material::default() };
    add(&mut scene, card(-2.0, 2.0, -2.0, 2.0), diffuse, at(DVec3::new(0.0, 0.0, -1.0)));
    scene.lights.push(Light::directional("", direct).with_shadow());
    let toward = DVec3::new(0.6, 0.0, -0.8);
    let pose = DMat4::from_quat(DQuat::from_rotation_arc(DVec3::NEG_Z, toward));
    scene.add_node(Node { light: Some(0), motion: Motion::Fixed(pose), ..Node::default() });
    // Half a metre before the wall: its shadow lies 0.5 * 0.6 / 0.8 m to the right.
    let edge_m = on_wall(3.1, 0.0).x - 0.375;
    let motion = moving(DVec3::new(edge_m, 0.0, -0.5), DQuat::IDENTITY, DVec3::X * speed / PX);
    add(&mut scene, card(-1.0, 0.0, -1.0, 1.0), grey(0.0), motion);
    let lit = f64::from(0.6_f32) * (0.25 + 0.8 * f64::from(direct) / std::f64::consts::PI);
    let edge = Edge {
        light_behind: f64::from(0.6_f32) * 0.25,
        light_ahead: lit,
        angle_radians: 0.0,
        position_px: 3.1,
        speed_px_per_s: speed,
    };
    assert!(lit > reflected * 0.25);
    let worst = difference(&scene, &edge, Lattice::First, 40);
    assert!(worst.worst_us <= 3.0, "{worst:?}");
    let regions =
        truth(&scene, &settings(Lattice::First, PixelChoice::Count(40)), &|_| true).unwrap().event_region;
    let named = regions.iter().filter(|r| **r == evis_core::Region::ShadowEdge).count();
    // A probe has four rays across a pixel: an edge in the outer eighth of it is not met.
    assert!(named * 4 >= regions.len() * 3, "{named} of {}", regions.len());
}

#[test]
fn flicker_crosses_with_its_waveform() {
    for (shape, same) in [
        (WaveShape::Sine, FlickerShape::Sine),
        (WaveShape::Square, FlickerShape::Square),
        (WaveShape::Pwm { duty: 0.3 }, FlickerShape::Pwm { duty: 0.3 }),
    ] {
        let flicker = Flicker { shape: same, mean: 0.5, depth: 0.6, frequency_hz: 13.0, phase_cycles: 0.2 };
        let mut scene = scene();
        let wave = Waveform { shape, frequency_hz: 13.0, phase: 0.2, low: 0.2, high: 0.8 };
        let material = Material { emission_waveform: Some(wave), ..grey(1.0) };
        add(&mut scene, card(-3.0, 3.0, -3.0, 3.0), material, at(DVec3::new(0.0, 0.0, -2.0)));
        let worst = difference(&scene, &flicker, Lattice::First, 8);
        assert!(worst.worst_us <= 2.0, "{shape:?}: {worst:?}");
    }
}

/// A strip of `segments` columns from `x0` to `x1` metres with vertex colours.
fn strip(x0: f64, x1: f64, segments: u32, luminance: impl Fn(f64) -> f64) -> Primitive {
    let mut primitive = Primitive::default();
    let mut colors = Vec::new();
    for i in 0..=segments {
        let x = x0 + (x1 - x0) * f64::from(i) / f64::from(segments);
        let v = luminance(x) as f32;
        for y in [-3.0, 3.0] {
            primitive.positions.push([x as f32, y, 0.0]);
            primitive.normals.push([0.0, 0.0, 1.0]);
            colors.push([v, v, v, 1.0]);
        }
        if i > 0 {
            let k = 2 * i;
            primitive.indices.extend([k - 2, k, k + 1, k - 2, k + 1, k - 1]);
        }
    }
    primitive.colors = Some(colors);
    primitive
}

#[test]
fn ramps_and_gratings_that_drift_cross_in_time() {
    let speed = 50.0;
    let angle: f64 = 0.5;
    let (sine, cosine) = angle.sin_cos();
    let velocity = DVec3::new(cosine, -sine, 0.0) * speed / PX;
    let motion = || moving(on_wall(0.0, 0.0), DQuat::from_rotation_z(-angle), velocity);
    // Along the pattern's own axis, in pixels from the image's corner at t = 0.
    let run = |primitive: Primitive, signal: &dyn Signal| {
        let mut scene = scene();
        add(&mut scene, primitive, grey(1.0), motion());
        difference(&scene, signal, Lattice::First, 30)
    };

    let frequency = 0.05;
    let grating = strip(-1.0, 1.0, 8000, |x| 0.5 + 0.4 * (TAU * frequency * x * PX).sin());
    let sinusoid = Sinusoid {
        mean: 0.5,
        swing: 0.4,
        cycles_per_px: [frequency * cosine, frequency * sine],
        frequency_hz: frequency * speed,
        phase_radians: 0.0,
        footprint: Footprint::Box,
    };
    let worst = run(grating, &sinusoid);
    // One event in hundreds lies where the grating turns back just after a threshold.
    assert!(worst.rms_us <= 1.0 && worst.worst_us <= 5.0, "grating: {worst:?}");

    let ramp = strip(-0.5, 0.5, 1, |x| 2.2 - 4.0 * x);
    let linear = LinearRamp {
        start: 2.2,
        rate_per_s: 4.0 / PX * speed,
        gradient_per_px: [-4.0 / PX * cosine, -4.0 / PX * sine],
    };
    let worst = run(ramp, &linear);
    assert!(worst.worst_us <= 2.0, "linear ramp: {worst:?}");

    let growth = strip(-1.0, 1.0, 20_000, |x| 0.5 * (-8.0 * x).exp());
    let exponential = ExponentialRamp {
        start: 0.5,
        growth_per_s: 8.0 / PX * speed,
        gradient_per_px: [-8.0 / PX * cosine, -8.0 / PX * sine],
    };
    // The closed form takes the pixel's centre: over its box exp(g x) is greater by sinh(g/2)/(g/2) along each axis,
    // the same factor at all times, which changes the logarithm by a constant and, but for eps, no time.
    let worst = run(growth, &exponential);
    assert!(worst.worst_us <= 2.0, "exponential ramp: {worst:?}");
}

#[test]
fn a_turning_star_crosses_in_time() {
    let (spokes, turn) = (9, 4.0);
    // Rings of thin pieces: shorter ones would lie in each other's boxes less, but there would be more of them.
    let (rings, segments) = (10_u32, 16_000_u32);
    let radius = |ring: u32| (5.0 + 5.0 * f64::from(ring) / f64::from(rings)) / PX;
    let mut primitive = Primitive::default();
    let mut colors = Vec::new();
    for i in 0..=segments {
        // Image angles run from x towards y down: the world's run the other way.
        let angle = TAU * f64::from(i) / f64::from(segments);
        let v = (0.5 + 0.4 * (f64::from(spokes) * angle).sin()) as f32;
        for ring in 0..=rings {
            let (x, y) = (radius(ring) * angle.cos(), -radius(ring) * angle.sin());
            primitive.positions.push([x as f32, y as f32, 0.0]);
            primitive.normals.push([0.0, 0.0, 1.0]);
            colors.push([v, v, v, 1.0]);
            if i > 0 && ring > 0 {
                let (here, before) = (i * (rings + 1) + ring, (i - 1) * (rings + 1) + ring);
                primitive.indices.extend([before - 1, before, here, before - 1, here, here - 1]);
            }
        }
    }
    primitive.colors = Some(colors);
    let mut scene = scene();
    let center = [f64::from(WIDTH) / 2.0, f64::from(HEIGHT) / 2.0];
    let start = Trs { translation: on_wall(center[0], center[1]), ..Trs::default() };
    let motion = Motion::Path(Arc::new(Path::Spin { start, axis: DVec3::NEG_Z, rate: turn }));
    add(&mut scene, primitive, Material { double_sided: true, ..grey(1.0) }, motion);
    let star = Spokes {
        mean: 0.5,
        swing: 0.4,
        spokes,
        center_px: center,
        turn_per_s: turn,
        phase_radians: 0.0,
        footprint: Footprint::Box,
    };
    // Pixels that lie wholly within the ring.
    let crop = PixelChoice::Crop { x: 22, y: 10, width: 2, height: 4 };
    let rendered = truth(&scene, &settings(Lattice::First, crop), &|_| true).unwrap();
    let got = score(&rendered.events, &exact(&rendered, &star), &ScoreSettings::default()).unwrap();
    let at = &got.at(100).unwrap().plain;
    assert!(at.f1 == 1.0 && at.matched > 40, "{at:?}");
    let time = at.time_error.as_ref().unwrap();
    assert!(time.rms_us < 2.0, "{time:?}");
}

#[test]
fn canary_a_shifted_pattern_is_late() {
    let mut scene = scene();
    backdrop(&mut scene, 1.0);
    let motion = moving(on_wall(2.3, 0.0), DQuat::IDENTITY, DVec3::X * 120.0 / PX);
    add(&mut scene, card(-4.0, 0.0, -4.0, 4.0), grey(0.1), motion);
    let edge = |position_px| Edge {
        light_behind: 0.1,
        light_ahead: 1.0,
        angle_radians: 0.0,
        position_px,
        speed_px_per_s: 120.0,
    };
    // A hundredth of a pixel at 120 px/s is 83 us.
    let worst = difference(&scene, &edge(2.29), Lattice::First, 20);
    assert!((worst.rms_us - 83.3).abs() < 4.0, "{worst:?}");
}

#[test]
fn a_truth_asked_for_again_is_read() {
    let mut scene = scene();
    let wave = Waveform { shape: WaveShape::Sine, frequency_hz: 20.0, phase: 0.0, low: 0.2, high: 0.8 };
    let material = Material { emission_waveform: Some(wave), ..grey(1.0) };
    add(&mut scene, card(-3.0, 3.0, -3.0, 3.0), material, at(DVec3::new(0.0, 0.0, -2.0)));
    let folder = std::env::temp_dir().join(format!("evis-truth-cache-{}", std::process::id()));
    let settings = TruthSettings { duration_us: 20_000, ..settings(Lattice::First, PixelChoice::Count(2)) };
    let first = evis_truth::cached(&folder, &scene, &settings, &|_| true).unwrap();
    assert!(!first.events.is_empty());
    // Read, not made: a stop would end the making.
    let again = evis_truth::cached(&folder, &scene, &settings, &|_| false).unwrap();
    assert_eq!(first, again);
    let other = TruthSettings { duration_us: 21_000, ..settings };
    assert!(
        evis_truth::cached(&folder, &scene, &other, &|_| false).is_err(),
        "canary: another truth is made"
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_audit_finds_what_too_long_a_step_jumps_over() {
    // A bar passes each pixel in 1.4 / 90 s, and leaves it as it was.
    let mut scene = scene();
    backdrop(&mut scene, 0.3);
    let motion = moving(on_wall(1.7, 0.0), DQuat::IDENTITY, DVec3::X * 90.0 / PX);
    add(&mut scene, card(-0.2 / PX, 0.2 / PX, -4.0, 4.0), grey(4.0), motion);
    let ask = |step_us, audit_share| {
        let settings =
            TruthSettings { step_us, audit_share, ..settings(Lattice::First, PixelChoice::Count(24)) };
        let truth = truth(&scene, &settings, &|_| true).unwrap();
        (Audit::of(&truth).unwrap(), truth.events.len())
    };
    let (fine, events) = ask(None, 0.2);
    assert_eq!(fine.missed, 0, "{fine:?}");
    assert!(fine.audited as f64 > 0.15 * fine.intervals as f64 && events > 20, "{fine:?}");
    // Canary: looks 40 ms apart see the bar in some pixels only.
    let (coarse, found) = ask(Some(40_000), 1.0);
    assert!(found < events && coarse.missed > 0, "{coarse:?}, {found} of {events} events");
    assert_eq!(coarse.audited, coarse.intervals);
    assert!(coarse.missed_at_most > coarse.missed as f64, "{coarse:?}");
    // What is missed by more than a pair of events per step is missed in that many steps.
    assert!(coarse.missed as usize <= (events - found) / 2, "{coarse:?}, {found} of {events} events");
}

/// Events per pixel, as times and polarities.
fn by_pixel(truth: &Truth) -> Vec<Vec<(i64, i16)>> {
    let of =
        |pixel: &[u16; 2]| truth.events.iter().filter(|e| [e.x, e.y] == *pixel).map(|e| (e.t, e.p)).collect();
    truth.pixels.iter().map(of).collect()
}

#[test]
fn what_swings_fires_alike_in_every_swing() {
    // Equal thresholds: the last event of a swing fires where light is back at its level, and nowhere else.
    const SWING_US: i64 = 2000;
    const SWINGS: i64 = 6;
    let mut scene = scene();
    backdrop(&mut scene, 0.2);
    let rest =
        Trs { translation: on_wall(14.0, 9.0), rotation: DQuat::from_rotation_z(0.3), scale: DVec3::ONE };
    let there = rest.translation + DVec3::X * 2.3 / PX;
    let keys = 0..=2 * SWINGS;
    let translation = Curve {
        times: keys.clone().map(|k| 0.5e-6 * (k * SWING_US) as f64).collect(),
        values: keys.flat_map(|k| if k % 2 == 0 { rest.translation } else { there }.to_array()).collect(),
        width: 3,
        interpolation: Interpolation::Linear,
    };
    let motion = Motion::Animated { rest, translation: Some(translation), rotation: None, scale: None };
    add(&mut scene, card(-0.3, 0.0, -0.3, 0.3), grey(1.0), motion);
    let settings = TruthSettings {
        sensor: SensorConfig::default(),
        duration_us: SWINGS * SWING_US,
        ..settings(Lattice::First, PixelChoice::Crop { x: 10, y: 2, width: 10, height: 14 })
    };
    let mut fired = 0;
    for events in by_pixel(&truth(&scene, &settings, &|_| true).unwrap()) {
        let of_swing = |swing: i64| -> Vec<(i64, i16)> {
            // The turn itself ends a swing; when light only touches a level is known less well.
            let [from, until] = [0, 1].map(|k| (swing + k) * SWING_US + 5);
            let inside = events.iter().filter(|e| e.0 > from && e.0 <= until);
            inside.map(|(t, p)| (t - swing * SWING_US, *p)).collect()
        };
        let first = of_swing(0);
        fired += first.len();
        for swing in 1..SWINGS {
            let other = of_swing(swing);
            let alike = first.len() == other.len()
                && first.iter().zip(&other).all(|(a, b)| a.1 == b.1 && a.0.abs_diff(b.0) <= 20);
            assert!(alike, "swing {swing}: {other:?}, the first one {first:?}");
        }
    }
    assert!(fired > 200, "{fired} events in a swing");
}

#[test]
fn exponential_light_is_sampled_exactly() {
    // Between two instants light comes from far below the threshold to above it. Without eps, which bends logarithms.
    let sensor = SensorConfig { threshold_on: 0.19, log_eps: 1e-6, ..sensor() };
    let worst = |primitive| {
        let mut scene = scene();
        let motion = moving(on_wall(0.0, 0.0), DQuat::IDENTITY, DVec3::X * 50.0 / PX);
        add(&mut scene, primitive, grey(1.0), motion);
        let ask = |sampled_hz| {
            let settings = settings(Lattice::First, PixelChoice::Count(24));
            let settings = TruthSettings { sensor: sensor.clone(), sampled_hz, ..settings };
            by_pixel(&truth(&scene, &settings, &|_| true).unwrap())
        };
        let (exact, sampled) = (ask(None), ask(Some(50.0)));
        assert!(exact.iter().map(Vec::len).sum::<usize>() > 20, "something happens: {exact:?}");
        let pairs = sampled.iter().zip(&exact).flat_map(|(sampled, exact)| {
            // An event at the very end may fall on either side of it.
            assert!(sampled.len().abs_diff(exact.len()) <= 1, "{sampled:?} {exact:?}");
            sampled.iter().zip(exact)
        });
        pairs.fold(0, |worst, (sampled, exact)| {
            assert_eq!(sampled.1, exact.1);
            worst.max(sampled.0.abs_diff(exact.0))
        })
    };
    let growth = worst(strip(-1.0, 1.0, 20_000, |x| 0.5 * (-8.0 * x).exp()));
    assert!(growth <= 3, "{growth} us");
    let ramp = worst(strip(-0.5, 0.38, 1, |x| 1.6 - 4.0 * x));
    assert!(ramp > 30, "canary, a linear ramp: {ramp} us");
}

#[test]
fn what_is_sampled_comes_to_truth_as_the_rate_grows() {
    // A bar that stays within a pixel for 16 ms, and leaves it as it was.
    let mut scene = scene();
    backdrop(&mut scene, 0.3);
    let motion = moving(on_wall(1.7, 0.0), DQuat::IDENTITY, DVec3::X * 90.0 / PX);
    add(&mut scene, card(-0.2 / PX, 0.2 / PX, -4.0, 4.0), grey(4.0), motion);
    let ask = |sampled_hz| {
        let settings = TruthSettings { sampled_hz, ..settings(Lattice::First, PixelChoice::Count(24)) };
        truth(&scene, &settings, &|_| true).unwrap()
    };
    let exact = ask(None);
    assert!(exact.sampled_hz().is_none() && Audit::of(&exact).is_some());
    let f1 = [30.0, 120.0, 480.0, 1920.0].map(|hz| {
        let sampled = ask(Some(hz));
        assert_eq!((sampled.sampled_hz(), Audit::of(&sampled)), (Some(hz), None));
        score(&sampled.events, &exact, &ScoreSettings::default()).unwrap().at(300).unwrap().plain.f1
    });
    assert!(f1.is_sorted_by(|a, b| a < b) && f1[0] < 0.5 && f1[3] > 0.99, "{f1:?}");
}
