//! Bodies that are dropped and thrown, and collide; the camera stands still.

use std::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec3};

use super::class;
use super::parts::{Dice, paint};
use crate::builder::{EventCamera, Placement, SceneBuilder, ShapeSettings};
use crate::error::SceneError;
use crate::model::{Light, Material, Scene};
use crate::primitive::Shape;
use crate::procedural::{Pattern, srgb};
use crate::rigid_body::{BodyMass, RigidBody};

pub(super) fn load(seed: u64) -> Result<Scene, SceneError> {
    let mut scene = SceneBuilder::new("tumble");
    scene.duration_s(1.0)?;
    scene.background([0.02, 0.02, 0.025])?;
    scene.ambient([1.3, 1.35, 1.5])?;
    let mut dice = Dice::new(seed ^ 0x7b);
    room(&mut scene, seed)?;
    let paints = Paints::new(&mut scene, seed)?;
    obstacles(&mut scene, &paints)?;
    tower(&mut scene, &paints, &mut dice)?;
    thrown(&mut scene, &paints, &mut dice)?;

    let lamp = Light::spot("lamp", 200.0, 30.0, 60.0).colored([1.0, 0.95, 0.87]).with_shadow();
    scene.light(lamp, Placement::looking_at([-1.5, 3.2, 2.4], [0.1, 0.2, -0.2]))?;
    let eye = Placement::looking_at([0.15, 0.95, 2.65], [0.05, 0.42, -0.15]);
    scene.camera(EventCamera::new("camera").fov_y_degrees(42.0), eye)?;
    scene.build()
}

fn room(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let boards = paint(scene, seed, "floor", Pattern::Wood, 1024, Some([srgb(0xb08a5e), srgb(0x6a4a2c)]))?;
    let floor = scene.material(Material::glossy("floor", 0.0, 0.5).textured(boards))?;
    let settings = ShapeSettings::semantic(class::GROUND).repeat(4.0, 3.0);
    let place = Placement::default().as_body(RigidBody::fixed());
    scene.shape_with("floor", Shape::Plane { size: [7.0, 5.0] }, floor, settings, place)?;
    let brick = paint(scene, seed, "wall", Pattern::Bricks, 512, Some([srgb(0xa9b3b5), srgb(0x8a9496)]))?;
    let wall = scene.material(Material::diffuse("wall").textured(brick))?;
    let settings = ShapeSettings::semantic(class::BUILDING).repeat(5.0, 2.0);
    // A slab, so that what is thrown at the wall meets something solid; it ends below the floor.
    let place = Placement::at([0.0, 1.2, -1.35]).as_body(RigidBody::fixed().surface(0.4, 0.3));
    scene.shape_with("wall", Shape::Box { size: [7.0, 2.5, 0.1] }, wall, settings, place)?;
    Ok(())
}

/// Materials of what lies and flies about.
struct Paints {
    cartons: Vec<usize>,
    balls: Vec<usize>,
    tins: Vec<usize>,
    stone: usize,
    plank: usize,
}

impl Paints {
    fn new(scene: &mut SceneBuilder, seed: u64) -> Result<Self, SceneError> {
        let mut several = |name: &str, pattern, size, colors: &[[u32; 2]]| {
            let mut made = Vec::new();
            for (i, [surface, detail]) in colors.iter().enumerate() {
                let name = format!("{name} {i}");
                let colors = Some([srgb(*surface), srgb(*detail)]);
                let picture = paint(scene, seed, &name, pattern, size, colors)?;
                made.push(scene.material(Material::diffuse(name).textured(picture))?);
            }
            Ok::<_, SceneError>(made)
        };
        Ok(Self {
            cartons: several(
                "carton",
                Pattern::Cardboard,
                512,
                &[[0xc39a66, 0x6e4f2c], [0xb98a52, 0x5a3f22], [0xd0ae7c, 0x80602f]],
            )?,
            balls: several(
                "ball",
                Pattern::Checker,
                256,
                &[[0xd84a3a, 0xf0e6d0], [0x2f6fb8, 0xf0d040], [0x2f9a5c, 0xe8e8e0]],
            )?,
            tins: several("tin", Pattern::Label, 256, &[[0xb8c4cc, 0x8a2430], [0xe0c060, 0x2c4470]])?,
            stone: several("stone", Pattern::Concrete, 256, &[[0x98a0a0, 0x50544f]])?.remove(0),
            plank: several("plank", Pattern::Wood, 256, &[[0xd8b078, 0x8a5c30]])?.remove(0),
        })
    }
}

fn obstacles(scene: &mut SceneBuilder, paints: &Paints) -> Result<(), SceneError> {
    let fixed = RigidBody::fixed().surface(0.35, 0.2);
    let settings = ShapeSettings::semantic(class::FURNITURE);
    let ramp = Placement::at([-0.62, 0.2, -0.2]).turned(DQuat::from_rotation_z(-0.42)).as_body(fixed);
    scene.shape_with("ramp", Shape::Box { size: [0.9, 0.04, 0.6] }, paints.plank, settings, ramp)?;
    let post = Placement::at([0.12, 0.17, -0.62]).as_body(fixed);
    let settings = ShapeSettings::semantic(class::FURNITURE).segments(32, 1);
    scene.shape_with("post", Shape::Cylinder { radius: 0.1, height: 0.38 }, paints.stone, settings, post)?;
    let dome = Placement::at([1.0, -0.03, 0.3]).as_body(fixed);
    let settings = ShapeSettings::semantic(class::FURNITURE).segments(40, 20);
    scene.shape_with("dome", Shape::Sphere { radius: 0.15 }, paints.stone, settings, dome)?;
    Ok(())
}

/// Six cartons that stand until a ball arrives.
fn tower(scene: &mut SceneBuilder, paints: &Paints, dice: &mut Dice) -> Result<(), SceneError> {
    let edge = 0.18;
    for (row, count) in [(0u32, 3u32), (1, 2), (2, 1)] {
        for i in 0..count {
            let across = (f64::from(i) - 0.5 * f64::from(count - 1)) * (edge + 0.02);
            let place = Placement::at([0.62 + across, edge * (0.5 + f64::from(row)), -0.45])
                .turned(DQuat::from_rotation_y(dice.between(-0.06, 0.06)))
                .as_body(RigidBody::dropped().mass(BodyMass::Density(150.0)));
            let carton = dice.pick(&paints.cartons).unwrap_or(0);
            let settings = ShapeSettings::semantic(class::GOODS);
            let shape = Shape::Box { size: [edge; 3] };
            scene.shape_with(format!("tower {row} {i}"), shape, carton, settings, place)?;
        }
    }
    Ok(())
}

fn thrown(scene: &mut SceneBuilder, paints: &Paints, dice: &mut Dice) -> Result<(), SceneError> {
    let carton = |size| Shape::Box { size };
    let (ball, tin) =
        (|radius| Shape::Sphere { radius }, |radius, height| Shape::Cylinder { radius, height });
    let pill = Shape::Capsule { radius: 0.05, height: 0.14 };
    let lying = DQuat::from_rotation_x(FRAC_PI_2);
    let upright = DQuat::IDENTITY;
    // Shape, place, rotation, velocity, spin in radians per second, density, restitution.
    let bodies = [
        (ball(0.11), [-1.75, 0.75, -0.4], upright, [4.4, 1.45, 0.0], 6.0, 400.0, 0.5),
        (carton([0.2, 0.14, 0.16]), [-0.68, 0.95, -0.2], upright, [0.1, 0.0, 0.0], 3.0, 150.0, 0.25),
        (tin(0.075, 0.2), [-0.85, 0.62, -0.15], lying, [0.0, 0.0, 0.0], 0.0, 300.0, 0.2),
        (pill, [1.7, 0.8, 0.15], upright, [-3.0, 1.6, -0.2], 9.0, 500.0, 0.4),
        (ball(0.07), [0.1, 1.15, -0.6], upright, [0.15, 0.0, 0.1], 2.0, 300.0, 0.8),
        (ball(0.06), [1.0, 1.0, 0.33], upright, [-0.1, 0.0, 0.0], 4.0, 300.0, 0.75),
        (carton([0.12, 0.12, 0.12]), [-1.6, 0.45, 0.35], upright, [2.9, 2.3, -0.15], 8.0, 150.0, 0.3),
        (tin(0.05, 0.13), [1.6, 0.5, -0.2], upright, [-2.2, 2.6, 0.25], 10.0, 400.0, 0.35),
        (carton([0.24, 0.1, 0.18]), [0.05, 0.7, 0.3], upright, [-0.5, 0.8, 0.0], 5.0, 120.0, 0.2),
    ];
    for (i, (shape, place, turn, velocity, spin, density, restitution)) in bodies.into_iter().enumerate() {
        let material = match shape {
            Shape::Box { .. } => dice.pick(&paints.cartons),
            // Three balls, each of its own colour.
            Shape::Sphere { .. } => paints.balls.get(i % paints.balls.len().max(1)).copied(),
            _ => dice.pick(&paints.tins),
        };
        let axis = DVec3::new(dice.between(-1.0, 1.0), dice.between(0.2, 1.0), dice.between(-1.0, 1.0));
        let velocity = DVec3::from(velocity) * dice.between(0.97, 1.03);
        let body = RigidBody::thrown(velocity)
            .spinning(axis.normalize_or(DVec3::Y), spin)
            .mass(BodyMass::Density(density))
            .surface(0.45, restitution);
        let settings = match shape {
            Shape::Sphere { .. } => ShapeSettings::semantic(class::MOVING).segments(48, 24),
            Shape::Cylinder { .. } => ShapeSettings::semantic(class::MOVING).segments(36, 1),
            _ => ShapeSettings::semantic(class::MOVING),
        };
        let place = Placement::at(place).turned(turn).as_body(body);
        scene.shape_with(format!("thrown {i}"), shape, material.unwrap_or(0), settings, place)?;
    }
    Ok(())
}
