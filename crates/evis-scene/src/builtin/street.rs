//! A drive along a street: long straight motion, facades at all depths, thin poles.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DMat4, DQuat, DVec3};

use super::class;
use super::parts::{Assembly, Dice, labels, paint};
use crate::builder::{EventCamera, Placement, SceneBuilder, ShapeSettings};
use crate::error::SceneError;
use crate::model::{Light, Material, Mesh, Scene, Trs};
use crate::motion::Path;
use crate::primitive::Shape;
use crate::procedural::{Pattern, srgb};

/// The street runs from here to `FAR` along -Z.
const NEAR: f64 = 30.0;
const FAR: f64 = -170.0;
/// Half the road's width, and the distance of the houses from the middle.
const ROAD: f64 = 4.0;
const HOUSES: f64 = 7.6;

pub(super) fn load(seed: u64) -> Result<Scene, SceneError> {
    let mut scene = SceneBuilder::new("street");
    scene.duration_s(6.0)?;
    scene.background([3.2, 4.6, 7.0])?;
    scene.ambient([2.2, 2.6, 3.3])?;
    let sun = Light::directional("sun", 26.0).colored([1.0, 0.92, 0.78]).with_shadow();
    scene.light(sun, Placement::looking_at([30.0, 42.0, 24.0], [0.0, 0.0, -30.0]))?;
    let mut dice = Dice::new(seed ^ 0x57);
    ground(&mut scene, seed)?;
    houses(&mut scene, seed, &mut dice)?;
    poles(&mut scene, seed)?;
    trees(&mut scene, seed, &mut dice)?;
    cars(&mut scene, seed)?;

    let start = Trs { translation: DVec3::new(1.5, 1.5, 10.0), ..Trs::default() };
    let path = Path::ConstantVelocity { start, velocity: DVec3::new(0.0, 0.0, -9.0) };
    scene.camera(EventCamera::new("camera").fov_y_degrees(60.0), Placement::along(path))?;
    scene.build()
}

fn ground(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let (length, middle) = (NEAR - FAR, (NEAR + FAR) / 2.0);
    let asphalt = paint(scene, seed, "road", Pattern::Road, 1024, None)?;
    let road = scene.material(Material::diffuse("road").textured(asphalt))?;
    let settings = ShapeSettings::semantic(class::GROUND).repeat(1.0, length / (2.0 * ROAD)).segments(1, 50);
    let place = Placement::at([0.0, 0.0, middle]);
    scene.shape_with("road", Shape::Plane { size: [2.0 * ROAD, length] }, road, settings, place)?;

    let slabs =
        paint(scene, seed, "pavement", Pattern::Concrete, 512, Some([srgb(0xb5aea2), srgb(0x5c5750)]))?;
    let pavement = scene.material(Material::diffuse("pavement").textured(slabs))?;
    let grass = paint(scene, seed, "grass", Pattern::Noise, 512, Some([srgb(0x4c7a2e), srgb(0x8da548)]))?;
    let grass = scene.material(Material::diffuse("grass").textured(grass))?;
    for (side, sign) in [("left", -1.0), ("right", 1.0)] {
        let width = HOUSES - ROAD;
        let settings = ShapeSettings::semantic(class::GROUND).repeat(2.0, length / 3.0);
        let place = Placement::at([sign * (ROAD + width / 2.0), 0.14, middle]);
        let shape = Shape::Plane { size: [width, length] };
        scene.shape_with(format!("pavement {side}"), shape, pavement, settings, place)?;
        let settings = ShapeSettings::semantic(class::GROUND).repeat(length / 1.6, 1.0);
        // The kerb is a strip that stands along the road, facing it. It reaches below the road: edges that only
        // touch, with other vertices on either side, let single pixels of sky through.
        let place =
            Placement::at([sign * ROAD, 0.04, middle]).turned(DQuat::from_rotation_y(-sign * FRAC_PI_2));
        scene.shape_with(
            format!("kerb {side}"),
            Shape::Card { size: [length, 0.2] },
            pavement,
            settings,
            place,
        )?;
        let settings = ShapeSettings::semantic(class::GROUND).repeat(20.0, 80.0);
        let place = Placement::at([sign * (HOUSES + 25.0), 0.0, middle]);
        let shape = Shape::Plane { size: [50.0, length] };
        scene.shape_with(format!("grass {side}"), shape, grass, settings, place)?;
    }
    Ok(())
}

fn houses(scene: &mut SceneBuilder, seed: u64, dice: &mut Dice) -> Result<(), SceneError> {
    let mut facades = Vec::new();
    for (name, wall) in [
        ("facade sand", 0xd9b98a),
        ("facade rose", 0xc77f6a),
        ("facade sage", 0x8fa58a),
        ("facade blue", 0x7d97b8),
        ("facade ochre", 0xd8a040),
        ("facade grey", 0xa8a29a),
    ] {
        let picture = paint(scene, seed, name, Pattern::Facade, 512, Some([srgb(wall), srgb(0x35506c)]))?;
        facades.push(scene.material(Material::diffuse(name).textured(picture))?);
    }
    let brick =
        paint(scene, seed, "shop brick", Pattern::Bricks, 512, Some([srgb(0x8a4a38), srgb(0xb8ad9c)]))?;
    let brick = scene.material(Material::diffuse("shop brick").textured(brick))?;
    let tiles = paint(scene, seed, "roof", Pattern::Bricks, 256, Some([srgb(0xa04a32), srgb(0x5a2a20)]))?;
    let roof = scene.material(Material::diffuse("roof").textured(tiles))?;
    let stripes =
        paint(scene, seed, "awning", Pattern::Stripes, 256, Some([srgb(0xf2ede0), srgb(0xc23b30)]))?;
    let awning = scene.material(Material::diffuse("awning").textured(stripes))?;
    let mut windows = Vec::new();
    for (name, pattern, paper) in [
        ("shop window a", Pattern::Poster, 0xf0e0c0),
        ("shop window b", Pattern::Poster, 0xbcd8e0),
        ("shop window c", Pattern::Books, 0x3a2a20),
        ("shop window d", Pattern::Poster, 0xe8c8a0),
        ("shop window e", Pattern::Books, 0x203038),
    ] {
        let ink = if pattern == Pattern::Poster { 0x1b2a49 } else { 0xe8d8a8 };
        let picture = paint(scene, seed, name, pattern, 256, Some([srgb(paper), srgb(ink)]))?;
        windows.push(scene.material(Material::glossy(name, 0.0, 0.25).textured(picture))?);
    }

    for (side, sign) in [("left", -1.0), ("right", 1.0)] {
        let mut z = NEAR;
        for i in 0..24 {
            let width = dice.pick(&[8.0, 10.0, 12.0, 14.0]).unwrap_or(10.0);
            if z - width < FAR {
                break;
            }
            let storeys = (2.0 + 3.0 * dice.unit()).floor();
            let (height, depth) = (storeys * 3.0, 9.0);
            let set_back = dice.between(0.0, 0.7);
            let x = sign * (HOUSES + set_back + depth / 2.0);
            let along = z - width / 2.0;
            let name = format!("house {side} {i}");
            let place = Placement::at([x, 3.2 + height / 2.0, along]);
            let facade = dice.pick(&facades).unwrap_or(0);
            // Four windows of the picture take about eleven metres, four storeys twelve.
            let settings =
                ShapeSettings::semantic(class::BUILDING).repeat((width / 2.7).round() / 4.0, storeys / 4.0);
            let shape = Shape::Box { size: [depth, height, width] };
            let house = scene.shape_with(&name, shape, facade, settings, place)?;
            let part =
                |scene: &mut SceneBuilder, what: &str, shape, material, repeat: [f64; 2], at: [f64; 3]| {
                    let settings = ShapeSettings::semantic(class::BUILDING).repeat(repeat[0], repeat[1]);
                    let place = Placement::at(at).on(house);
                    scene.shape_with(format!("{name} {what}"), shape, material, settings, place)
                };
            let floor = -height / 2.0 - 1.6;
            let size = [depth + 0.1, 3.2, width - 0.02];
            part(scene, "ground floor", Shape::Box { size }, brick, [width / 3.0, 1.0], [0.0, floor, 0.0])?;
            // Roofs overlap their neighbours, and must not lie in one plane with them.
            let lift = height / 2.0 + 0.17 + 0.02 * f64::from(i % 2);
            let size = [depth + 0.7, 0.35, width + 0.1];
            part(scene, "roof", Shape::Box { size }, roof, [width / 2.0, 0.25], [0.0, lift, 0.0])?;
            let front = -sign * (depth / 2.0 + 0.06);
            let shops = (width / 4.0).floor();
            for shop in 0..shops as u32 {
                let at = (f64::from(shop) + 0.5 - shops / 2.0) * width / shops;
                let size = [0.08, 1.9, 2.4];
                let what = format!("window {shop}");
                let window = dice.pick(&windows).unwrap_or(0);
                part(scene, &what, Shape::Box { size }, window, [1.0, 1.0], [front, floor - 0.2, at])?;
                let size = [1.1, 0.12, 2.8];
                let what = format!("awning {shop}");
                part(
                    scene,
                    &what,
                    Shape::Box { size },
                    awning,
                    [1.0, 1.0],
                    [front - sign * 0.5, floor + 1.15, at],
                )?;
            }
            z -= width + if dice.unit() < 0.2 { 2.5 } else { 0.0 };
        }
    }
    Ok(())
}

fn poles(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let sheet = paint(scene, seed, "pole", Pattern::Metal, 128, Some([srgb(0xd0d4d8), srgb(0x80868c)]))?;
    let steel = scene.material(Material::diffuse("pole").textured(sheet).colored(srgb(0x6f7d78)))?;
    let glow = scene.material(Material::unlit("street lamp").colored([9.0, 8.6, 7.8]))?;
    let stripes =
        paint(scene, seed, "bollard", Pattern::Stripes, 128, Some([srgb(0xf0ece4), srgb(0xc8342c)]))?;
    let bollard = scene.material(Material::diffuse("bollard").textured(stripes))?;

    let mut post = Assembly::new(steel);
    let upright = |y: f64| DMat4::from_translation(DVec3::new(0.0, y, 0.0));
    post.part(Shape::Cylinder { radius: 0.055, height: 5.2 }, 1.0, upright(2.6))?;
    post.part(Shape::Cylinder { radius: 0.11, height: 0.71 }, 1.0, upright(0.345))?;
    post.bar([0.0, 5.15, 0.0], [1.4, 5.45, 0.0], 0.05, 1.0)?.beam([1.5, 5.47, 0.0], [0.6, 0.08, 0.2], 1.0)?;
    let mut lamp = Assembly::new(glow);
    lamp.beam([1.5, 5.41, 0.0], [0.5, 0.05, 0.16], 1.0)?;
    let primitives = vec![post.whole, lamp.whole];
    let mesh = scene.mesh(Mesh { name: "street lamp".into(), primitives, ..Mesh::default() })?;
    for i in 0..14u32 {
        for (side, sign) in [("left", -1.0), ("right", 1.0)] {
            let z = 18.0 - 13.0 * f64::from(i) - if sign > 0.0 { 6.5 } else { 0.0 };
            let turn = DQuat::from_rotation_y(if sign > 0.0 { std::f64::consts::PI } else { 0.0 });
            let place = Placement::at([sign * (ROAD + 0.5), 0.14, z]).turned(turn);
            scene.object(format!("lamp post {side} {i}"), mesh, labels(class::POLE), place)?;
        }
    }
    // Cables from post to post, thinner than a pixel from a few metres on.
    let mut cables = Assembly::new(steel);
    for i in 0..13u32 {
        let z = 18.0 - 13.0 * f64::from(i);
        for (side, shift) in [(-1.0, 0.0), (1.0, -6.5)] {
            let x = side * (ROAD + 0.5);
            let (a, b) = ([x, 5.2, z + shift], [x, 5.2, z + shift - 13.0]);
            let sag = [x, 4.75, z + shift - 6.5];
            // Not equally thick, so that they do not meet in one plane.
            cables.bar(a, sag, 0.016, 1.0)?.bar(sag, b, 0.0155, 1.0)?;
        }
    }
    let cables =
        scene.mesh(Mesh { name: "cables".into(), primitives: vec![cables.whole], ..Mesh::default() })?;
    scene.object("cables", cables, labels(class::POLE), Placement::default())?;
    for i in 0..36u32 {
        let settings = ShapeSettings::semantic(class::POLE).segments(12, 1);
        let shape = Shape::Cylinder { radius: 0.05, height: 0.9 };
        // Rings around the bollard: the picture's stripes lie across.
        let sign = if i % 2 == 0 { -1.0 } else { 1.0 };
        let place = Placement::at([sign * (ROAD + 0.22), 0.59, 14.0 - 2.6 * f64::from(i)]);
        scene.shape_with(format!("bollard {i}"), shape, bollard, settings, place)?;
    }
    Ok(())
}

fn trees(scene: &mut SceneBuilder, seed: u64, dice: &mut Dice) -> Result<(), SceneError> {
    let bark = paint(scene, seed, "bark", Pattern::Wood, 256, Some([srgb(0x6f5238), srgb(0x35261a)]))?;
    let bark = scene.material(Material::diffuse("bark").textured(bark))?;
    let leaves = paint(scene, seed, "leaves", Pattern::Asphalt, 256, Some([srgb(0x3f7030), srgb(0xa8c060)]))?;
    let leaves = scene.material(Material::diffuse("leaves").textured(leaves))?;
    let mut trunk = Assembly::new(bark);
    let lift = |x: f64, y: f64, z: f64| DMat4::from_translation(DVec3::new(x, y, z));
    trunk.part(Shape::Cylinder { radius: 0.11, height: 2.6 }, 1.0, lift(0.0, 1.3, 0.0))?;
    trunk.bar([0.0, 2.2, 0.0], [0.5, 3.1, 0.2], 0.08, 1.0)?.bar(
        [0.0, 2.3, 0.0],
        [-0.45, 3.2, -0.2],
        0.08,
        1.0,
    )?;
    let mut crown = Assembly::new(leaves);
    for (x, y, z, r) in
        [(0.0, 3.6, 0.0, 0.95), (0.55, 3.2, 0.2, 0.65), (-0.5, 3.3, -0.25, 0.7), (0.05, 4.3, 0.1, 0.6)]
    {
        crown.part(Shape::Sphere { radius: r }, 1.0, lift(x, y, z))?;
    }
    let primitives = vec![trunk.whole, crown.whole];
    let mesh = scene.mesh(Mesh { name: "tree".into(), primitives, ..Mesh::default() })?;
    for i in 0..8u32 {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        let scale = dice.between(0.8, 1.15);
        let place =
            Placement::at([sign * (ROAD + 1.5), 0.14, 2.0 - 15.0 * f64::from(i) + dice.between(-2.0, 2.0)])
                .turned(DQuat::from_rotation_y(dice.between(0.0, TAU)))
                .scaled(DVec3::splat(scale));
        scene.object(format!("tree {i}"), mesh, labels(class::PLANT), place)?;
    }
    Ok(())
}

fn cars(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let rubber = scene.material(Material::diffuse("tyre").colored(srgb(0x2c2c2e)))?;
    let hub = paint(scene, seed, "hub", Pattern::Checker, 64, Some([srgb(0xd8d8dc), srgb(0x606468)]))?;
    let hub = scene.material(Material::diffuse("hub").textured(hub))?;
    let pane = scene.material(Material::glossy("car window", 0.0, 0.15).colored(srgb(0x26323c)))?;
    let white = scene.material(Material::unlit("headlight").colored([12.0, 11.5, 10.0]))?;
    let red = scene.material(Material::unlit("tail light").colored([6.0, 0.5, 0.3]))?;
    let sheet = paint(scene, seed, "car paint", Pattern::Metal, 256, Some([srgb(0xf4f4f4), srgb(0xd0d0d0)]))?;
    // Name, colour, lane, start, speed along z: oncoming on the left, parked, and one ahead.
    for (name, color, x, z, speed) in [
        ("car red", 0xc8322a, -1.9, -55.0, 10.0),
        ("car yellow", 0xe0b020, -1.9, -95.0, 12.0),
        ("car blue", 0x2f62b4, 1.8, -9.0, -6.5),
        ("car green", 0x2f8060, -1.9, -20.0, 8.0),
        ("car white", 0xd8dadc, 3.0, -24.0, 0.0),
        ("car black", 0x4a4e56, -3.0, -38.0, 0.0),
    ] {
        let paint = scene.material(Material::glossy(name, 0.2, 0.35).textured(sheet).colored(srgb(color)))?;
        let mut body = Assembly::new(paint);
        body.beam([0.0, 0.55, 0.0], [1.75, 0.5, 4.2], 1.0)?.beam([0.0, 1.36, 0.2], [1.4, 0.06, 1.9], 1.0)?;
        for x in [-0.66, 0.66] {
            body.bar([x, 0.78, -1.1], [x, 1.35, -0.65], 0.07, 1.0)?.bar(
                [x, 0.78, 1.55],
                [x, 1.35, 1.1],
                0.07,
                1.0,
            )?;
            body.bar([x, 0.78, 0.2], [x, 1.35, 0.2], 0.07, 1.0)?;
        }
        let mut glass = Assembly::new(pane);
        glass.beam([0.0, 1.065, 0.22], [1.36, 0.56, 2.0], 1.0)?;
        let mut rubbers = Assembly::new(rubber);
        let mut hubs = Assembly::new(hub);
        for x in [-0.82, 0.82] {
            for z in [-1.3, 1.3] {
                let turn = DMat4::from_rotation_translation(
                    DQuat::from_rotation_z(FRAC_PI_2),
                    DVec3::new(x, 0.32, z),
                );
                rubbers.part(Shape::Cylinder { radius: 0.32, height: 0.2 }, 1.0, turn)?;
                hubs.part(Shape::Cylinder { radius: 0.19, height: 0.23 }, 1.0, turn)?;
            }
        }
        let (mut front, mut rear) = (Assembly::new(white), Assembly::new(red));
        for x in [-0.62, 0.62] {
            front.beam([x, 0.62, -2.1], [0.32, 0.14, 0.04], 1.0)?;
            rear.beam([x, 0.62, 2.1], [0.32, 0.14, 0.04], 1.0)?;
        }
        let parts = [body, glass, rubbers, hubs, front, rear];
        let primitives = parts.into_iter().map(|part| part.whole).collect();
        let mesh = scene.mesh(Mesh { name: name.into(), primitives, ..Mesh::default() })?;
        // A car's front is -Z, as a camera's.
        let rotation =
            if speed > 0.0 { DQuat::from_rotation_y(std::f64::consts::PI) } else { DQuat::IDENTITY };
        let start = Trs { translation: DVec3::new(x, 0.0, z), rotation, ..Trs::default() };
        let path = Path::ConstantVelocity { start, velocity: DVec3::Z * speed };
        scene.object(name, mesh, labels(class::VEHICLE), Placement::along(path))?;
    }
    Ok(())
}
