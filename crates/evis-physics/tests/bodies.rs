//! Bodies against closed forms: falls, bounces, spins, rest; the same bits in every run.
#![cfg(feature = "rapier")]
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::hash::{DefaultHasher, Hasher};

use evis_physics::simulate;
use evis_scene::toml_scene::parse;
use evis_scene::{Motion, Scene, SceneState};
use glam::{DMat3, DMat4, DQuat, DVec3};

/// Seconds of a step, and of the parts in which it is taken.
const STEP_S: f64 = 1e-3;
const SUBSTEP_S: f64 = STEP_S / 4.0;
const GRAVITY: f64 = -9.81;

fn read(objects: &str) -> Scene {
    let text = format!("duration_s = 2.0\nambient = [1, 1, 1]\n{objects}\n[[materials]]\nname = 'm'\n");
    parse(&text, "").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn simulated(objects: &str) -> Scene {
    let mut scene = read(objects);
    simulate(&mut scene).unwrap();
    assert!(scene.rigid_bodies.is_empty() && scene.check_simulated().is_ok());
    scene
}

fn refusal(objects: &str) -> String {
    let mut scene = read(objects);
    let before = format!("{:?}", scene.nodes);
    let error = simulate(&mut scene).unwrap_err().to_string();
    assert_eq!(format!("{:?}", scene.nodes), before, "what is refused changes nothing");
    error
}

fn pose(scene: &Scene, name: &str, t_s: f64) -> DMat4 {
    let node = scene.nodes.iter().position(|node| node.name == name).unwrap();
    let mut state = SceneState::default();
    scene.evaluate(t_s, &mut state);
    state.world_from_node[node]
}

fn place(scene: &Scene, name: &str, t_s: f64) -> DVec3 {
    pose(scene, name, t_s).w_axis.truncate()
}

/// Keys of translation and of rotation.
fn keys(scene: &Scene, name: &str) -> [usize; 2] {
    let node = scene.nodes.iter().find(|node| node.name == name).unwrap();
    let Motion::Animated { translation: Some(translation), rotation: Some(rotation), .. } = &node.motion
    else {
        panic!("{name}: {:?}", node.motion);
    };
    [translation.times.len(), rotation.times.len()]
}

const FLOOR: &str = "[[primitives]]\nname = 'floor'\nshape = 'plane'\nsize = [4, 4]\nmaterial = 'm'\nrigid_body = { fixed = true }\n";

fn ball(keys: &str) -> String {
    format!("[[primitives]]\nname = 'ball'\nshape = 'sphere'\nradius = 0.1\nmaterial = 'm'\n{keys}\n")
}

fn cube(keys: &str) -> String {
    format!("[[primitives]]\nname = 'box'\nshape = 'box'\nsize = [0.2, 0.3, 0.4]\nmaterial = 'm'\n{keys}\n")
}

#[test]
fn free_fall_is_the_closed_form_of_the_integrator_between_steps_too() {
    let scene =
        simulated(&ball("position = [1, 20, 0]\nrigid_body = { velocity = [3, 2, -0.5], launch_s = 0.25 }"));
    let exact = |t_s: f64, part_s: f64| {
        let t = (t_s - 0.25).max(0.0);
        let fall = DVec3::Y * (0.5 * GRAVITY * t * (t + part_s));
        DVec3::new(1.0, 20.0, 0.0) + DVec3::new(3.0, 2.0, -0.5) * t + fall
    };
    for k in 0..=4000 {
        // Every other time is the middle of a step.
        let t_s = f64::from(k) * 0.5 * STEP_S;
        let error = place(&scene, "ball", t_s).distance(exact(t_s, SUBSTEP_S));
        assert!(error < 1e-9, "{t_s} s: {error}");
    }
    assert!(place(&scene, "ball", 2.0).distance(exact(2.0, STEP_S)) > 1e-3, "canary: a step in one part");
    assert_eq!(keys(&scene, "ball"), [3, 2], "start, launch and end");
    assert_eq!(place(&scene, "ball", 0.25), DVec3::new(1.0, 20.0, 0.0));
    assert_eq!(place(&scene, "ball", 9.0), place(&scene, "ball", 2.0), "it stays where it was at the end");
}

#[test]
fn a_bouncing_ball_rises_to_the_square_of_its_restitution() {
    let heights = |restitution: f64| {
        let body = format!("position = [0, 1.1, 0]\nrigid_body = {{ restitution = {restitution} }}");
        let scene = simulated(&format!("{FLOOR}{}", ball(&body)));
        let y: Vec<f64> = (0..2000).map(|k| place(&scene, "ball", f64::from(k) * STEP_S).y - 0.1).collect();
        let lowest = y.iter().copied().fold(f64::MAX, f64::min);
        assert!(lowest > -2e-3, "it sinks in by {lowest} m");
        y.windows(3).filter(|w| w[1] > w[0] && w[1] > w[2]).map(|w| w[1]).collect::<Vec<_>>()
    };
    for restitution in [0.5_f64, 0.8, 1.0] {
        let found = heights(restitution);
        let mut expected = 1.0;
        for height in &found[..2] {
            expected *= restitution * restitution;
            assert!((height / expected - 1.0).abs() < 0.03, "{restitution}: {found:?}, not {expected}");
        }
    }
    assert!(heights(0.0).iter().all(|height| *height < 1e-3), "canary: no bounce");
}

#[test]
fn a_box_that_has_come_to_rest_does_not_move_by_a_bit() {
    let body =
        "position = [0, 0.4, 0]\nrotation_degrees = [8, 20, 5]\nrigid_body = { velocity = [0.6, 0, 0] }";
    let scene = simulated(&format!("{FLOOR}{}", cube(body)));
    let last = pose(&scene, "box", 2.0);
    assert!((last.w_axis.y - 0.15).abs() < 5e-4, "it lies on its side: {last}");
    assert!(last.y_axis.y > 1.0 - 1e-6, "upright: {last}");
    let bits = |m: DMat4| m.to_cols_array().map(f64::to_bits);
    let still =
        (0..2000).rev().take_while(|k| bits(pose(&scene, "box", f64::from(*k) * 0.97e-3)) == bits(last));
    let still_s = still.count() as f64 * 0.97e-3;
    assert!(still_s > 1.0, "it rests for {still_s} s");
    assert_ne!(bits(pose(&scene, "box", 0.2)), bits(last), "canary");
}

#[test]
fn the_same_scene_gives_the_same_bits() {
    let hash = |scene: &Scene| {
        let mut hashers = [DefaultHasher::new()];
        evis_scene::digest(scene, "", &mut hashers);
        hashers[0].finish()
    };
    let [a, b] =
        [evis_physics::load("tumble", 1, None).unwrap(), evis_physics::load("tumble", 1, None).unwrap()];
    assert_eq!(hash(&a), hash(&b));
    assert_ne!(hash(&a), hash(&evis_physics::load("tumble", 2, None).unwrap()), "canary");
}

#[test]
fn a_thrown_body_keeps_its_angular_momentum() {
    // Spun about an axis near the middle one of its moments of inertia, it turns over and back.
    let body = "position = [0, 30, 0]\nrigid_body = { spin_axis = [0.02, 0.03, 1], spin_degrees_per_s = 900, mass = 2 }";
    let scene = simulated(&cube(body).replace("size = [0.2, 0.3, 0.4]", "size = [0.4, 0.1, 0.25]"));
    let [x, y, z] = [0.4, 0.1, 0.25_f64];
    let inertia = DVec3::new(y * y + z * z, x * x + z * z, x * x + y * y) * (2.0 / 12.0);
    let momentum = |t_s: f64| {
        let rotation = |t_s: f64| DQuat::from_mat4(&pose(&scene, "box", t_s));
        let dt = 1e-4;
        let turn = rotation(t_s + dt) * rotation(t_s - dt).inverse();
        let spin = turn.to_scaled_axis() / (2.0 * dt);
        let axes = DMat3::from_quat(rotation(t_s));
        (axes * DMat3::from_diagonal(inertia) * axes.transpose() * spin, spin)
    };
    let (first, spun) = momentum(0.01);
    let (mut worst, mut turned) = (0.0_f64, 0.0_f64);
    for k in 1..190 {
        let (now, spin) = momentum(0.01 * f64::from(k));
        worst = worst.max(first.angle_between(now).to_degrees());
        turned = turned.max(spun.angle_between(spin).to_degrees());
        assert!((now.length() / first.length() - 1.0).abs() < 0.02, "{now} after {first}");
    }
    assert!(worst < 2.0, "its axis is off by {worst} degrees");
    assert!(turned > 10.0, "canary: the spin's own axis wanders by {turned} degrees only");
}

#[test]
fn parents_that_rest_change_nothing_but_the_frame() {
    let thrown = "rigid_body = { velocity = [0, 0, 2], spin_axis = [0, 0, 1], spin_degrees_per_s = 300, shape = 'sphere', radius = 0.1 }";
    let free = simulated(&format!("{FLOOR}{}", cube(&format!("position = [1, 0.5, 0]\n{thrown}"))));
    // Half the size, at twice the distance, a quarter turn to the left.
    let parent =
        "[[nodes]]\nname = 'table'\nposition = [1, 0, 0]\nrotation_degrees = [0, 90, 0]\nscale = 2\n";
    let hung = cube(&format!("parent = 'table'\nposition = [0, 0.25, 0]\n{thrown}"))
        .replace("[0, 0, 2]", "[-2, 0, 0]")
        .replace("spin_axis = [0, 0, 1]", "spin_axis = [-1, 0, 0]")
        .replace("radius = 0.1", "radius = 0.05");
    let hung = simulated(&format!("{FLOOR}{parent}{hung}"));
    for k in 0..100 {
        let t_s = 0.0197 * f64::from(k);
        let error = place(&free, "box", t_s).distance(place(&hung, "box", t_s));
        assert!(error < 2.5e-5, "{t_s} s: {error}");
    }
}

#[test]
fn hulls_meshes_and_children_take_part() {
    let pile = "\
[[nodes]]
name = 'pair'
position = [0, 0.5, 0]
rigid_body = { restitution = 0.1 }
[[primitives]]
name = 'left'
parent = 'pair'
shape = 'box'
size = [0.2, 0.2, 0.2]
material = 'm'
position = [-0.3, 0, 0]
[[primitives]]
name = 'right'
parent = 'pair'
shape = 'box'
size = [0.2, 0.2, 0.2]
material = 'm'
position = [0.1, 0, 0]
[[primitives]]
name = 'table'
shape = 'card'
size = [2, 2]
material = 'm'
position = [0, 0.25, 0]
rotation_degrees = [-90, 0, 0]
rigid_body = { fixed = true }
";
    let scene = simulated(pile);
    let there = place(&scene, "pair", 2.0);
    assert!((there.y - 0.35).abs() < 2e-3, "the pair lies on the table: {there}");
    let apart = place(&scene, "right", 2.0) - place(&scene, "left", 2.0);
    assert!((apart.length() - 0.4).abs() < 1e-9, "{apart}");
    let through = simulated(&pile.replace("rigid_body = { fixed = true }", ""));
    assert!(place(&through, "pair", 2.0).y < -10.0, "canary: no table");
}

#[test]
fn what_cannot_be_simulated_is_named() {
    let flat = "[[nodes]]\nname = 'leaf'\nrigid_body = {}\n[[primitives]]\nname = 'sheet'\nparent = 'leaf'\nshape = 'plane'\nsize = [1, 1]\nmaterial = 'm'\n";
    let empty = "[[nodes]]\nname = 'ghost'\nrigid_body = {}\n";
    let fast = ball("rigid_body = { spin_degrees_per_s = 100000 }");
    let long = format!("[dynamics]\nrate_hz = 100000\n{}", ball("rigid_body = {}"));
    for (objects, expected) in [
        (flat.to_owned(), ["'leaf'", "no volume"]),
        (format!("{empty}{}", ball("")), ["'ghost'", "no mesh"]),
        (fast, ["'ball'", "up to 90000.0"]),
    ] {
        let found = refusal(&objects);
        assert!(expected.iter().all(|part| found.contains(part)), "{found}");
    }
    let mut endless = read(&long);
    endless.duration_s = Some(1e9);
    let found = simulate(&mut endless).unwrap_err().to_string();
    assert!(found.contains("poses of rigid bodies") && found.contains("duration_s"), "{found}");
}

#[test]
fn a_framing_camera_sees_where_bodies_go() {
    let objects = ball("position = [0, 0.1, 0]\nrigid_body = { velocity = [20, 0, 0] }");
    let (before, after) = (read(&objects), simulated(&objects));
    let eye = |scene: &Scene| place(scene, "default camera", 0.0);
    assert!(eye(&after).length() > 3.0 * eye(&before).length(), "{} {}", eye(&before), eye(&after));
}

#[test]
fn the_built_in_scene_has_few_keys_and_comes_to_life() {
    let scene = evis_physics::load("tumble", 0, None).unwrap();
    let moving: Vec<&str> = scene
        .nodes
        .iter()
        .filter(|node| matches!(node.motion, Motion::Animated { .. }))
        .map(|node| node.name.as_str())
        .collect();
    assert_eq!(moving.len(), 15);
    let total: usize = moving.iter().flat_map(|name| keys(&scene, name)).sum();
    assert!(total < 15 * 2 * 100, "{total} keys of 30000 poses");
    for name in moving {
        let (from, to) = (place(&scene, name, 0.0), place(&scene, name, 1.0));
        assert!(to.y > 0.0 && to.is_finite(), "{name} is in the room: {to}");
        assert!(name.starts_with("tower") || from.distance(to) > 0.3, "{name} moves");
    }
}

/// Numbers that are the same in every run.
struct Numbers(u64);

impl Numbers {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Between the two, on a scale of logarithms.
    fn scale(&mut self, low: f64, high: f64) -> f64 {
        (low.ln() + (high / low).ln() * self.unit()).exp()
    }
}

#[test]
fn bodies_at_the_ends_of_their_ranges_never_panic() {
    let mut numbers = Numbers(1);
    let (mut good, mut refused) = (0, 0);
    for _ in 0..60 {
        let mut objects = FLOOR.to_owned();
        for i in 0..6 {
            let n = &mut numbers;
            let length = |n: &mut Numbers| n.scale(2e-4, 1e4);
            let shape = match (n.unit() * 4.0) as u32 {
                0 => format!("shape = 'box'\nsize = [{}, {}, {}]", length(n), length(n), length(n)),
                1 => format!("shape = 'sphere'\nradius = {}", length(n)),
                2 => format!("shape = 'cylinder'\nradius = {}\nheight = {}", length(n), length(n)),
                _ => format!("shape = 'capsule'\nradius = {}\nheight = {}", length(n), length(n)),
            };
            let hull = if n.unit() < 0.3 { ", shape = 'hull'" } else { "" };
            let at = n.scale(1e-3, 10.0);
            objects += &format!(
                "[[primitives]]\nname = 'body {i}'\n{shape}\nmaterial = 'm'\nposition = [{at}, {at}, 0]\nrigid_body = {{ mass = {}, velocity = [{}, -{}, 0], spin_degrees_per_s = {}, restitution = {}, friction = {}{hull} }}\n",
                n.scale(1e-6, 1e9),
                n.scale(1e-3, 700.0),
                n.scale(1e-3, 700.0),
                n.scale(1.0, 9e4),
                n.unit(),
                n.scale(1e-3, 100.0),
            );
        }
        let mut scene = read(&objects);
        scene.duration_s = Some(0.03);
        match simulate(&mut scene) {
            Ok(()) => good += 1,
            Err(error) => {
                let error = error.to_string();
                assert!(error.contains("diverges") || error.contains("no volume"), "{error}");
                refused += 1;
            }
        }
        assert!((0..6).all(|i| place(&scene, &format!("body {i}"), 0.03).is_finite()));
    }
    assert!(good > 30, "{good} scenes were simulated, {refused} refused");
}
