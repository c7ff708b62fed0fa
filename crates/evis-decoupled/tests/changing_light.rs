//! Light that changes quickly within a pixel, a surface or a block: highlights that go by, shadows across a texture, a ball
//! that turns away from its only lamp.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use evis_decoupled::{Settings, luminance};
use evis_scene::environment::Environment;
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{Lens, LightKind, Material, Motion, Node, Scene, Trs};
use glam::{DQuat, DVec3};

mod common;

use common::{add, add_texture, camera, exact, f1, light, noise, off, truth_of};

const SIZE: (u32, u32) = (48, 36);

fn still(translation: DVec3, rotation: DQuat) -> Motion {
    Motion::Fixed(Trs { translation, rotation, ..Trs::default() }.matrix())
}

fn moving(translation: DVec3, velocity: DVec3) -> Motion {
    let start = Trs { translation, ..Trs::default() };
    Motion::Path(Path::ConstantVelocity { start, velocity }.into())
}

fn spinning(translation: DVec3, rate: f64) -> Motion {
    let start = Trs { translation, ..Trs::default() };
    Motion::Path(Path::Spin { start, axis: DVec3::new(0.3, 1.0, 0.1).normalize(), rate }.into())
}

fn add_camera(scene: &mut Scene) {
    let node = scene.add_node(Node::default());
    scene.cameras.push(camera(node, Lens::FieldOfView { fov_y: 0.7 }));
}

/// What `scene` looks like between moments of any division of its second block, and what it fires.
struct Measured {
    /// Error of light against rays.
    error: f64,
    /// How much light itself changes within `later_us`.
    canary: f64,
    /// F1 against the oracle, and events.
    found: f64,
    count: usize,
}

impl Measured {
    fn of(scene: &Scene, later_us: f64, duration_us: i64) -> Self {
        let settings = Settings { size: Some(SIZE), ..Settings::default() };
        let t_us = 32_768.0 * 1.36;
        let wanted = exact(scene, SIZE, t_us);
        let error = off(&luminance(scene, &settings, t_us).unwrap(), &wanted);
        let canary = off(&exact(scene, SIZE, t_us + later_us), &wanted);
        let (asked, truth) = truth_of(scene, SIZE, duration_us, 200);
        let (found, count) = f1(scene, &asked, &truth);
        Self { error, canary, found, count }
    }
}

/// A lamp flies past a glossy card and a glossy ball that spins; `mapped` ones have a normal map, which says nothing.
fn glossy(mapped: bool) -> Scene {
    let mut scene = Scene { ambient: [0.05; 3], ..Scene::default() };
    let flat = if mapped { add_texture(&mut scene, 1, |_, _| [0.5, 0.5, 1.0, 1.0]) } else { None };
    let material = |roughness| Material {
        metallic: 1.0,
        roughness,
        base_color: [0.7, 0.6, 0.5, 1.0],
        normal_texture: flat,
        ..Material::default()
    };
    add(
        &mut scene,
        Shape::Card { size: [1.6, 1.2] },
        material(0.25),
        still(DVec3::Z * -1.5, DQuat::IDENTITY),
    );
    add(&mut scene, Shape::Box { size: [0.3; 3] }, material(0.3), spinning(DVec3::new(0.1, 0.05, -1.1), 9.0));
    scene.lights.push(light(LightKind::Point, false, 0.5));
    let path = moving(DVec3::new(-0.5, 0.2, -0.9), DVec3::new(8.0, -1.0, 0.0));
    scene.add_node(Node { light: Some(0), motion: path, ..Node::default() });
    add_camera(&mut scene);
    scene
}

#[test]
fn highlights_go_by_as_rays_say() {
    for mapped in [false, true] {
        let scene = glossy(mapped);
        let Measured { error, canary, found, count } = Measured::of(&scene, 500.0, 80_000);
        println!(
            "mapped {mapped}: {error:.4} off, {canary:.4} half a millisecond later; F1 {found:.4} of {count}"
        );
        assert!(error < 0.01 && canary > 2.0 * error, "mapped {mapped}: {error:.4}, {canary:.4}");
        assert!(found > 0.97 && count > 1000, "mapped {mapped}: {found:.4} of {count}");
    }
}

/// A ball that spins throws its shadow on a checked floor, under one lamp without any other light.
fn checked() -> Scene {
    let mut scene = Scene::default();
    let checks = add_texture(&mut scene, 64, |x, y| {
        let value = if (x / 8 + y / 8) % 2 == 0 { 0.05 } else { 0.9 };
        [value, value, value, 1.0]
    });
    let spots = add_texture(&mut scene, 16, |x, y| {
        let value = 0.3 + 0.6 * noise(0, x, y);
        [value, value, value, 1.0]
    });
    let floor = still(DVec3::new(0.0, -0.4, -2.0), DQuat::from_rotation_x(-1.1));
    let textured = |base_color_texture| Material { base_color_texture, ..Material::diffuse("") };
    add(&mut scene, Shape::Card { size: [3.0, 3.0] }, textured(checks), floor);
    add(
        &mut scene,
        Shape::Sphere { radius: 0.3 },
        textured(spots),
        spinning(DVec3::new(-0.1, 0.1, -1.6), 3.0),
    );
    add(
        &mut scene,
        Shape::Card { size: [0.3, 0.2] },
        Material::diffuse("card"),
        moving(DVec3::new(0.2, 0.4, -1.7), DVec3::new(1.0, 0.2, 0.0)),
    );
    scene.lights.push(light(LightKind::Directional, true, 3.0));
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.7, -0.9, 0.0);
    scene.add_node(Node { light: Some(0), motion: still(DVec3::ZERO, turn), ..Node::default() });
    add_camera(&mut scene);
    scene
}

#[test]
fn what_a_lamp_reaches_of_a_pixel_looks_as_rays_say() {
    let scene = checked();
    let settings = Settings { size: Some(SIZE), ..Settings::default() };
    for part in [1.0, 1.36] {
        let t_us = 32_768.0 * part;
        let wanted = exact(&scene, SIZE, t_us);
        let error = off(&luminance(&scene, &settings, t_us).unwrap(), &wanted);
        let mut open = scene.clone();
        open.lights[0].casts_shadow = false;
        let canary = off(&luminance(&open, &settings, t_us).unwrap(), &wanted);
        println!("at {part} blocks: {error:.4} off, {canary:.4} without shadows");
        assert!(error < 0.03, "at {part} blocks: {error:.4}");
        assert!(canary > 5.0 * error, "canary: {canary:.4}");
    }
    let (asked, truth) = truth_of(&scene, (64, 48), 60_000, 300);
    let (found, count) = f1(&scene, &asked, &truth);
    println!("F1 {found:.4} of {count} events");
    assert!(found > 0.96 && count > 1000, "{found:.4} of {count}");
}

#[test]
fn mirrors_show_what_is_around_as_rays_say() {
    let mut scene = Scene {
        environment: Some(Environment { visible: false, ..Environment::studio() }),
        ..Scene::default()
    };
    let mirror = || Material {
        metallic: 1.0,
        roughness: 0.2,
        base_color: [0.7, 0.6, 0.5, 1.0],
        ..Material::default()
    };
    add(&mut scene, Shape::Card { size: [1.6, 1.2] }, mirror(), spinning(DVec3::Z * -1.8, 1.0));
    add(&mut scene, Shape::Box { size: [0.3; 3] }, mirror(), spinning(DVec3::new(0.1, 0.05, -1.1), 6.0));
    let rolling = moving(DVec3::new(-0.6, 0.05, -1.1), DVec3::X * 3.0);
    add(&mut scene, Shape::Sphere { radius: 0.2 }, mirror(), rolling);
    add_camera(&mut scene);
    let (asked, truth) = truth_of(&scene, (48, 36), 80_000, 200);
    let (found, count) = f1(&scene, &asked, &truth);
    let mut turned = scene.clone();
    turned.environment.as_mut().unwrap().rotation += 0.05;
    let (canary, _) = f1(&turned, &asked, &truth);
    println!("F1 {found:.4} of {count} events, {canary:.4} in surroundings that are turned");
    assert!(found > 0.94 && count > 1000, "{found:.4} of {count}");
    assert!(canary < found - 0.1, "canary: {canary:.4}");
}

/// Nothing but the sky, seen by a camera that turns.
#[test]
fn a_camera_that_turns_sees_the_sky_as_rays_say() {
    let mut scene = Scene {
        environment: Some(Environment { visible: true, ..Environment::studio() }),
        ..Scene::default()
    };
    let start = Trs::default();
    let turning =
        Motion::Path(Path::Spin { start, axis: DVec3::new(0.2, 1.0, 0.1).normalize(), rate: 3.0 }.into());
    let node = scene.add_node(Node { motion: turning, ..Node::default() });
    scene.cameras.push(camera(node, Lens::FieldOfView { fov_y: 0.7 }));
    let Measured { error, canary, found, count } = Measured::of(&scene, 2000.0, 80_000);
    println!("{error:.4} off, {canary:.4} two milliseconds later; F1 {found:.4} of {count} events");
    assert!(error < 0.002 && canary > 1.5 * error, "{error:.4}, {canary:.4}");
    assert!(found > 0.997 && count > 300, "{found:.4} of {count}");
}

/// A spot sweeps over a wall that is still.
#[test]
fn the_edge_of_a_cone_goes_by_as_rays_say() {
    // The second lights a few pixels.
    for (casts_shadow, [inner, outer], rate, (least_f1, events)) in [
        (false, [0.12, 0.15], -6.0, (0.94, 1000)),
        (true, [0.12, 0.15], -6.0, (0.94, 1000)),
        (true, [0.02, 0.03], -4.0, (0.92, 100)),
    ] {
        let mut scene = Scene { ambient: [0.1; 3], ..Scene::default() };
        add(
            &mut scene,
            Shape::Card { size: [3.0, 2.0] },
            Material::diffuse("wall"),
            still(DVec3::Z * -2.0, DQuat::IDENTITY),
        );
        scene.lights.push(light(LightKind::Spot { inner, outer }, casts_shadow, 6.0));
        let start = Trs {
            translation: DVec3::new(0.1, 0.0, -0.2),
            rotation: DQuat::from_rotation_y(0.4),
            ..Trs::default()
        };
        let path = Path::Spin { start, axis: DVec3::Y, rate };
        scene.add_node(Node { light: Some(0), motion: Motion::Path(path.into()), ..Node::default() });
        add_camera(&mut scene);
        let Measured { error, canary, found, count } = Measured::of(&scene, 500.0, 100_000);
        println!(
            "shadows {casts_shadow}: {error:.4} off, {canary:.4} half a millisecond later; F1 {found:.4} of {count}"
        );
        assert!(error < 0.015 && canary > 1.5 * error, "shadows {casts_shadow}: {error:.4}, {canary:.4}");
        assert!(found > least_f1 && count > events, "shadows {casts_shadow}: {found:.4} of {count}");
    }
}
