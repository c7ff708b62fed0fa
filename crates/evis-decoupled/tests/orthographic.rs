//! Orthographic cameras against rays: light, shadows, textures and maps, what their planes cut, and events.

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

fn path(translation: DVec3, rotation: DQuat, velocity: DVec3, rate: f64) -> Motion {
    let start = Trs { translation, rotation, ..Trs::default() };
    let axis = DVec3::new(0.3, 1.0, 0.1).normalize();
    let spin = Path::Spin { start: Trs::default(), axis, rate };
    Motion::Path(Path::Chain(vec![Path::ConstantVelocity { start, velocity }, spin]).into())
}

/// A floor with a print, a bumpy wall, a glossy box that spins and a ball that flies, under a sun, a spot and a bulb of which
/// two throw shadows, before a camera that moves and turns; its near plane cuts the ball, its far plane the wall.
fn scene(perspective: bool) -> Scene {
    let mut scene = Scene { ambient: [0.1; 3], background: [0.3; 3], ..Scene::default() };
    let print = add_texture(&mut scene, 16, |x, y| {
        let v = if (x + y) % 2 == 0 { 0.25 } else { 0.6 } + 0.2 * noise(0, x, y);
        [v, v, v, 1.0]
    });
    let bumps = add_texture(&mut scene, 8, |x, y| [0.5 + 0.15 * (noise(1, x, y) - 0.5), 0.5, 0.95, 1.0]);
    let printed =
        Material { base_color_texture: print, roughness: 0.8, metallic: 0.0, ..Material::default() };
    let bumpy = Material { normal_texture: bumps, roughness: 0.6, metallic: 0.0, ..Material::default() };
    let metal =
        Material { base_color: [0.7, 0.6, 0.5, 1.0], metallic: 1.0, roughness: 0.35, ..Material::default() };
    let flat = DQuat::from_rotation_x(-1.0);
    let still = DVec3::ZERO;
    add(
        &mut scene,
        Shape::Card { size: [4.0, 3.0] },
        printed,
        path(DVec3::new(0.0, -0.3, -3.0), flat, still, 0.0),
    );
    let aslant = DQuat::from_rotation_y(0.5);
    add(
        &mut scene,
        Shape::Card { size: [2.0, 1.2] },
        bumpy,
        path(DVec3::new(0.9, 0.7, -3.4), aslant, still, 0.0),
    );
    add(
        &mut scene,
        Shape::Box { size: [0.5; 3] },
        metal.clone(),
        path(DVec3::new(-0.3, 0.1, -2.4), flat, still, 6.0),
    );
    let flies = path(DVec3::new(0.2, 0.4, -1.1), DQuat::IDENTITY, DVec3::new(2.0, -1.0, 0.3), 0.0);
    add(&mut scene, Shape::Sphere { radius: 0.25 }, metal, flies);
    scene.lights.push(light(LightKind::Directional, true, 2.0));
    scene.lights.push(light(LightKind::Spot { inner: 0.2, outer: 0.5 }, true, 4.0));
    scene.lights.push(light(LightKind::Point, false, 0.6));
    let sun = DQuat::from_rotation_x(-0.9) * DQuat::from_rotation_y(0.3);
    let spot = DQuat::from_rotation_x(-0.5) * DQuat::from_rotation_y(-0.2);
    for (index, (place, rotation)) in [
        (DVec3::ZERO, sun),
        (DVec3::new(0.3, 1.5, -1.0), spot),
        (DVec3::new(-0.8, 0.6, -1.6), DQuat::IDENTITY),
    ]
    .into_iter()
    .enumerate()
    {
        let motion = path(place, rotation, still, 0.0);
        scene.add_node(Node { light: Some(index), motion, ..Node::default() });
    }
    let node = scene.add_node(Node {
        motion: path(DVec3::ZERO, DQuat::IDENTITY, DVec3::new(0.3, 0.1, -0.2), 0.2),
        ..Node::default()
    });
    let lens = if perspective {
        Lens::FieldOfView { fov_y: 0.7 }
    } else {
        Lens::Orthographic { height: 1.8, far: 3.7 }
    };
    scene.cameras.push(evis_scene::Camera { near: 1.0, ..camera(node, lens) });
    scene
}

#[test]
fn light_and_events_are_those_of_rays() {
    let scene = scene(false);
    let settings = Settings { size: Some(SIZE), ..Settings::default() };
    for t_us in [0.0, 44_000.0] {
        let wanted = exact(&scene, SIZE, t_us);
        let found = luminance(&scene, &settings, t_us).unwrap();
        let error = off(&found, &wanted);
        let canary = off(&exact(&scene, SIZE, t_us + 4000.0), &wanted);
        println!("{error:.4} off at {t_us} us, {canary:.4} 4 ms later");
        assert!(error < 0.02 && canary > 2.0 * error, "{error:.4}, {canary:.4}");
    }
    // Canary: through a pinhole it looks otherwise.
    let other = off(&exact(&self::scene(true), SIZE, 0.0), &exact(&scene, SIZE, 0.0));
    assert!(other > 0.2, "{other}");
    let [(found, count), (pinhole, _)] = [&scene, &self::scene(true)].map(|scene| {
        let (asked, truth) = truth_of(scene, SIZE, 80_000, 150);
        f1(scene, &asked, &truth)
    });
    println!("F1 {found:.4} of {count}; through a pinhole {pinhole:.4}");
    assert!(found > 0.96 && found > pinhole - 0.015 && count > 500, "{found:.4} of {count}, {pinhole:.4}");
}

#[test]
fn the_sky_is_one_point_and_changes_by_turns_alone() {
    let mut scene = Scene {
        environment: Some(Environment { visible: true, ..Environment::studio() }),
        ..Scene::default()
    };
    let node = scene.add_node(Node {
        motion: path(DVec3::ZERO, DQuat::IDENTITY, DVec3::new(3.0, 0.0, 0.0), 0.0),
        ..Node::default()
    });
    scene.cameras.push(camera(node, Lens::Orthographic { height: 1.0, far: 9.0 }));
    let settings = Settings {
        size: Some((8, 6)),
        duration_us: 100_000,
        reference_luminance: Some(1.0),
        ..Settings::default()
    };
    let picture = luminance(&scene, &settings, 0.0).unwrap();
    assert!(off(&picture, &exact(&scene, (8, 6), 0.0)) < 1e-3);
    assert!(picture.iter().all(|v| *v == picture[0] && *v > 0.0), "{picture:?}");
    let count = |scene: &Scene| evis_decoupled::simulate(scene, &settings).unwrap().events.len();
    assert_eq!(count(&scene), 0, "it only moves");
    scene.nodes[node].motion = path(DVec3::ZERO, DQuat::IDENTITY, DVec3::ZERO, 12.0);
    let (asked, truth) = truth_of(&scene, (8, 6), 100_000, 48);
    let (found, events) = f1(&scene, &asked, &truth);
    println!("F1 {found:.4} of {events}");
    assert!(events >= 48 && found > 0.97, "{found:.4} of {events}");
}

#[test]
fn what_a_plane_cuts_moves_though_nothing_else_does() {
    // A bright card aslant goes along the axis at 3 m/s: the border where the far plane cuts it sweeps the picture.
    let mut scene = Scene { background: [0.1; 3], ..Scene::default() };
    let bright = Material { emissive: [0.9; 3], base_color: [0.0, 0.0, 0.0, 1.0], ..Material::default() };
    let aslant = DQuat::from_rotation_y(0.9);
    let along = DVec3::new(0.0, 0.0, -3.0);
    add(&mut scene, Shape::Card { size: [3.0, 3.0] }, bright, path(DVec3::Z * -3.0, aslant, along, 0.0));
    let node = scene.add_node(Node::default());
    scene.cameras.push(camera(node, Lens::Orthographic { height: 1.5, far: 3.2 }));
    let (asked, truth) = truth_of(&scene, SIZE, 150_000, 150);
    let (found, count) = f1(&scene, &asked, &truth);
    println!("F1 {found:.4} of {count}");
    assert!(found > 0.98 && count > 2000, "{found:.4} of {count}");
}
