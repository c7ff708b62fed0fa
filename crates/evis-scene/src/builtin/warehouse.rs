//! A hall with shelves: many parts, many edges, thrown objects.

use glam::{DQuat, DVec3};

use super::class;
use super::parts::{Assembly, Dice, labels, paint};
use crate::builder::{EventCamera, Placement, SceneBuilder, ShapeSettings};
use crate::error::SceneError;
use crate::model::{Light, Material, Mesh, Scene, Trs};
use crate::motion::{Path, WaveShape, Waveform};
use crate::primitive::Shape;
use crate::procedural::{Pattern, srgb};

/// Half the hall's width, its height, its near and far end.
const HALL: [f64; 4] = [9.0, 7.0, 9.0, -17.0];
/// Shelf: width along the aisle, depth, height.
const BAY: [f64; 3] = [2.7, 1.1, 4.6];
/// Heights of the boards.
const LEVELS: [f64; 3] = [0.12, 1.75, 3.3];
/// Distance of the shelves' middle from the aisle's.
const AISLE: f64 = 4.1;
const BAYS: u32 = 6;

pub(super) fn load(seed: u64) -> Result<Scene, SceneError> {
    let mut scene = SceneBuilder::new("warehouse");
    scene.duration_s(4.0)?;
    scene.background([0.02, 0.02, 0.025])?;
    scene.ambient([3.0, 3.1, 3.4])?;
    let mut dice = Dice::new(seed);
    hall(&mut scene, seed)?;
    let goods = Goods::new(&mut scene, seed)?;
    shelves(&mut scene, seed, &goods, &mut dice)?;
    floor_goods(&mut scene, &goods, &mut dice)?;
    lights(&mut scene)?;
    thrown(&mut scene, &goods, &mut dice)?;

    let eye = Trs { translation: DVec3::new(0.0, 1.75, 3.4), ..Trs::default() };
    let look_at = Some(DVec3::new(0.0, 1.5, -6.5));
    let path = Path::FigureEight { start: eye, size: [2.0, 1.0], period_s: 5.0, look_at };
    scene.camera(EventCamera::new("camera").fov_y_degrees(58.0), Placement::along(path))?;
    scene.build()
}

fn hall(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let [half, height, near, far] = HALL;
    let (middle, length) = ((near + far) / 2.0, near - far);
    let concrete =
        paint(scene, seed, "floor", Pattern::Concrete, 1024, Some([srgb(0x9fa39a), srgb(0x44443f)]))?;
    let floor = scene.material(Material::glossy("floor", 0.0, 0.55).textured(concrete))?;
    let ground = ShapeSettings::semantic(class::GROUND).repeat(4.0, 6.0);
    scene.shape_with(
        "floor",
        Shape::Plane { size: [2.0 * half, length] },
        floor,
        ground,
        Placement::at([0.0, 0.0, middle]),
    )?;

    // Yellow lines along the aisle, a hand's breadth wide and a millimetre thick.
    let paint_texture =
        paint(scene, seed, "paint", Pattern::Concrete, 256, Some([srgb(0xe8b820), srgb(0xc89a18)]))?;
    let line = scene.material(Material::diffuse("line").textured(paint_texture))?;
    for (name, x) in [("line left", -2.9), ("line right", 2.9)] {
        let settings = ShapeSettings::semantic(class::GROUND).repeat(1.0, 120.0);
        let place = Placement::at([x, 0.002, middle]);
        scene.shape_with(name, Shape::Plane { size: [0.12, length] }, line, settings, place)?;
    }
    for i in 0..6 {
        let settings = ShapeSettings::semantic(class::GROUND).repeat(20.0, 1.0);
        let place =
            Placement::at([0.0, 0.002, -11.2 - 0.35 * f64::from(i)]).turned(DQuat::from_rotation_y(0.35));
        scene.shape_with(
            format!("crossing {i}"),
            Shape::Plane { size: [3.6, 0.14] },
            line,
            settings,
            place,
        )?;
    }

    let brick = paint(scene, seed, "wall", Pattern::Bricks, 512, Some([srgb(0xb7694e), srgb(0xc8c0b0)]))?;
    let wall = scene.material(Material::diffuse("wall").textured(brick))?;
    let panels =
        paint(scene, seed, "side wall", Pattern::Stripes, 512, Some([srgb(0xa9b4b8), srgb(0x8d9aa0)]))?;
    let side = scene.material(Material::diffuse("side wall").textured(panels))?;
    let turn = |degrees: f64| DQuat::from_rotation_y(degrees.to_radians());
    for (name, material, x, z, width, degrees) in [
        ("far wall", wall, 0.0, far, 2.0 * half, 0.0),
        ("near wall", wall, 0.0, near, 2.0 * half, 180.0),
        ("left wall", side, -half, middle, length, 90.0),
        ("right wall", side, half, middle, length, -90.0),
    ] {
        let settings = ShapeSettings::semantic(class::BUILDING).repeat((width / 2.6).round(), 3.0);
        let place = Placement::at([x, height / 2.0, z]).turned(turn(degrees));
        scene.shape_with(name, Shape::Card { size: [width, height] }, material, settings, place)?;
    }
    let sheet = paint(scene, seed, "ceiling", Pattern::Metal, 256, Some([srgb(0x8f979c), srgb(0x5d6468)]))?;
    let ceiling = scene.material(Material::diffuse("ceiling").textured(sheet))?;
    let settings = ShapeSettings::semantic(class::BUILDING).repeat(6.0, 9.0);
    let place = Placement::at([0.0, height, middle]).turned(DQuat::from_rotation_x(std::f64::consts::PI));
    scene.shape_with("ceiling", Shape::Plane { size: [2.0 * half, length] }, ceiling, settings, place)?;

    let steel = scene.material(Material::diffuse("truss steel").textured(sheet).colored(srgb(0xd8e0e8)))?;
    let mut truss = Assembly::new(steel);
    // Nothing ends or meets in one plane with what it touches: which is seen there would be up to rounding.
    let span = [2.0 * half - 0.02, 0.10, 0.10];
    truss.beam([0.0, 0.0, 0.0], span, 0.5)?.beam([0.0, 0.8, 0.0], span, 0.5)?;
    let pitch = 2.0 * half / 16.0;
    for i in 0..16u32 {
        let (x, odd) = (-half + pitch * f64::from(i), f64::from(i % 2));
        let thickness = 0.06 - 0.004 * odd;
        truss.bar([x, 0.8 * odd, 0.0], [x + pitch, 0.8 * (1.0 - odd), 0.0], thickness, 0.5)?;
    }
    let mesh = scene.mesh(Mesh { name: "truss".into(), primitives: vec![truss.whole], ..Mesh::default() })?;
    for i in 0..8u32 {
        let place = Placement::at([0.0, height - 1.0, near - 1.6 - 3.2 * f64::from(i)]);
        scene.object(format!("truss {i}"), mesh, labels(class::BUILDING), place)?;
    }

    // A roller door and a poster give the far wall something to look at.
    let slats = paint(scene, seed, "door", Pattern::Stripes, 512, Some([srgb(0x3f8f86), srgb(0x2f6f68)]))?;
    let door = scene.material(Material::diffuse("door").textured(slats))?;
    let settings = ShapeSettings::semantic(class::BUILDING).repeat(2.0, 2.0);
    let place =
        Placement::at([0.0, 1.9, far + 0.02]).turned(DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2));
    scene.shape_with("door", Shape::Card { size: [3.8, 4.0] }, door, settings, place)?;
    for (name, x, pattern) in [("poster left", -4.3, Pattern::Poster), ("poster right", 4.3, Pattern::Label)]
    {
        let picture = paint(scene, seed, name, pattern, 512, None)?;
        let material = scene.material(Material::diffuse(name).textured(picture))?;
        let settings = ShapeSettings::semantic(class::BUILDING);
        let place = Placement::at([x, 2.6, far + 0.03]);
        scene.shape_with(name, Shape::Card { size: [2.4, 2.4] }, material, settings, place)?;
    }
    Ok(())
}

/// Materials and meshes of what is stored.
struct Goods {
    cartons: Vec<usize>,
    totes: Vec<usize>,
    barrels: Vec<usize>,
    pallet: usize,
}

impl Goods {
    fn new(scene: &mut SceneBuilder, seed: u64) -> Result<Self, SceneError> {
        let mut cartons = Vec::new();
        for (name, card, ink) in [
            ("carton brown", 0xb98d5c, 0x3d2c1c),
            ("carton light", 0xd2b184, 0x8c2f2b),
            ("carton dark", 0x96683f, 0x1d2b45),
            ("carton white", 0xd8d4c8, 0x2a5d8f),
        ] {
            let picture = paint(scene, seed, name, Pattern::Cardboard, 512, Some([srgb(card), srgb(ink)]))?;
            cartons.push(scene.material(Material::diffuse(name).textured(picture))?);
        }
        let crate_picture =
            paint(scene, seed, "tote", Pattern::Label, 256, Some([srgb(0xf4f4f0), srgb(0x404040)]))?;
        let mut totes = Vec::new();
        for (name, color) in [
            ("tote red", 0xd0402f),
            ("tote blue", 0x2f78c4),
            ("tote green", 0x3f9a52),
            ("tote yellow", 0xe2b22c),
        ] {
            totes.push(scene.material(Material::diffuse(name).textured(crate_picture).colored(srgb(color)))?);
        }
        let drum = paint(scene, seed, "drum", Pattern::Metal, 256, Some([srgb(0xe8e8e8), srgb(0xa0a0a0)]))?;
        let mut barrels = Vec::new();
        for (name, color) in [("drum blue", 0x2f64b0), ("drum orange", 0xdd7a2a), ("drum green", 0x2f8a5a)] {
            barrels
                .push(scene.material(Material::glossy(name, 0.1, 0.35).textured(drum).colored(srgb(color)))?);
        }
        let planks =
            paint(scene, seed, "pallet", Pattern::Wood, 256, Some([srgb(0xc49a66), srgb(0x7a5630)]))?;
        let planks = scene.material(Material::diffuse("pallet").textured(planks))?;
        let mut pallet = Assembly::new(planks);
        for i in 0..3 {
            let z = 0.42 * f64::from(i - 1);
            pallet.beam([0.0, 0.07, z], [1.2, 0.1, 0.1], 0.8)?.beam(
                [0.0, 0.01, z],
                [1.2, 0.02, 0.12],
                0.8,
            )?;
        }
        for i in 0..7 {
            pallet.beam([-0.55 + 1.1 / 6.0 * f64::from(i), 0.13, 0.0], [0.12, 0.02, 0.96], 0.8)?;
        }
        let pallet = Mesh { name: "pallet".into(), primitives: vec![pallet.whole], ..Mesh::default() };
        Ok(Self { cartons, totes, barrels, pallet: scene.mesh(pallet)? })
    }

    /// A carton most of the time, else a tote.
    fn material(&self, dice: &mut Dice) -> usize {
        let from = if dice.unit() < 0.72 { &self.cartons } else { &self.totes };
        dice.pick(from).unwrap_or(0)
    }
}

fn shelves(scene: &mut SceneBuilder, seed: u64, goods: &Goods, dice: &mut Dice) -> Result<(), SceneError> {
    let sheet = paint(scene, seed, "shelf", Pattern::Metal, 256, Some([srgb(0xf0f0f0), srgb(0xa8a8a8)]))?;
    let upright =
        scene.material(Material::diffuse("shelf upright").textured(sheet).colored(srgb(0x2f5fa8)))?;
    let cross = scene.material(Material::diffuse("shelf beam").textured(sheet).colored(srgb(0xe8762a)))?;
    let mesh_deck =
        scene.material(Material::glossy("shelf deck", 0.6, 0.45).textured(sheet).colored(srgb(0xb8bcc0)))?;
    let [width, depth, height] = BAY;
    let (mut posts, mut beams, mut decks) =
        (Assembly::new(upright), Assembly::new(cross), Assembly::new(mesh_deck));
    for z in [-width / 2.0, width / 2.0] {
        for x in [-depth / 2.0, depth / 2.0] {
            posts.beam([x, height / 2.0, z], [0.09, height, 0.09], 0.6)?;
        }
        for i in 0..5 {
            let (side, thickness) = if i % 2 == 0 { (0.5, 0.04) } else { (-0.5, 0.036) };
            let y = 0.3 + 0.85 * f64::from(i);
            posts.bar([-side * depth, y, z], [side * depth, y + 0.85, z], thickness, 0.6)?;
        }
    }
    for level in LEVELS {
        for x in [-depth / 2.0, depth / 2.0] {
            beams.beam([x, level - 0.063, 0.0], [0.05, 0.12, width - 0.09], 0.6)?;
        }
        for i in 0..12 {
            let z = (f64::from(i) - 5.5) * (width - 0.2) / 12.0;
            decks.beam([0.0, level - 0.012, z], [depth, 0.024, 0.09], 0.6)?;
        }
    }
    let primitives = vec![posts.whole, beams.whole, decks.whole];
    let shelf = scene.mesh(Mesh { name: "shelf".into(), primitives, ..Mesh::default() })?;

    for (side, sign) in [("left", -1.0), ("right", 1.0)] {
        for bay in 0..BAYS {
            let z = 1.0 - (width + 0.12) * f64::from(bay);
            let name = format!("shelf {side} {bay}");
            let at = |x: f64, y: f64, along: f64| Placement::at([sign * AISLE + x, y, z + along]);
            scene.object(&name, shelf, labels(class::FURNITURE), at(0.0, 0.0, 0.0))?;
            for (level, board) in LEVELS.into_iter().enumerate() {
                let mut along = -width / 2.0 + 0.16;
                let mut base = board;
                if dice.unit() < 0.5 {
                    base += 0.145;
                    let turn = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
                    for (half, shift) in [-0.62, 0.62].into_iter().enumerate() {
                        let name = format!("pallet {side} {bay} {level} {half}");
                        scene.object(
                            name,
                            goods.pallet,
                            labels(class::GOODS),
                            at(0.0, board, shift).turned(turn),
                        )?;
                    }
                }
                // Cartons side by side; their sizes are few, so that they share meshes.
                for i in 0..8 {
                    let (w, h, d) = dice
                        .pick(&[
                            (0.45, 0.4, 0.7),
                            (0.6, 0.55, 0.8),
                            (0.38, 0.75, 0.6),
                            (0.7, 0.35, 0.8),
                            (0.5, 0.5, 0.5),
                        ])
                        .unwrap_or((0.5, 0.5, 0.5));
                    if along + w > width / 2.0 - 0.1 {
                        break;
                    }
                    if dice.unit() < 0.9 {
                        let name = format!("carton {side} {bay} {level} {i}");
                        let x = sign * dice.between(-0.12, 0.05);
                        let turn = DQuat::from_rotation_y(dice.between(-0.09, 0.09));
                        let place = at(x, base + h / 2.0, along + w / 2.0).turned(turn);
                        let material = goods.material(dice);
                        carton(scene, name, [d, h, w], material, place)?;
                        if h < 0.5 && dice.unit() < 0.6 {
                            let name = format!("carton {side} {bay} {level} {i} upper");
                            let turn = DQuat::from_rotation_y(dice.between(-0.25, 0.25));
                            let place = at(x, base + h + 0.16, along + w / 2.0).turned(turn);
                            let material = goods.material(dice);
                            carton(scene, name, [0.5, 0.32, 0.36], material, place)?;
                        }
                    }
                    along += w + dice.between(0.04, 0.16);
                }
            }
        }
    }
    Ok(())
}

fn floor_goods(scene: &mut SceneBuilder, goods: &Goods, dice: &mut Dice) -> Result<(), SceneError> {
    let spots = [(-2.2, -8.6), (2.1, -6.4), (-1.9, -13.4), (2.2, -13.0), (1.2, -14.6)];
    for (stack, (x, z)) in spots.into_iter().enumerate() {
        let turn = dice.between(-0.4, 0.4);
        let place = Placement::at([x, 0.0, z]).turned(DQuat::from_rotation_y(turn));
        let pallet = scene.object(format!("stack {stack}"), goods.pallet, labels(class::GOODS), place)?;
        for layer in 0..3 {
            for i in 0..2 {
                if layer == 2 && i == 1 && stack % 2 == 0 {
                    continue;
                }
                let place =
                    Placement::at([-0.29 + 0.58 * f64::from(i), 0.345 + 0.41 * f64::from(layer), 0.0])
                        .turned(DQuat::from_rotation_y(dice.between(-0.05, 0.05)))
                        .on(pallet);
                let material = goods.material(dice);
                carton(
                    scene,
                    format!("stack {stack} carton {layer} {i}"),
                    [0.54, 0.4, 0.8],
                    material,
                    place,
                )?;
            }
        }
    }
    let drums =
        [(-2.3, -4.4), (-2.35, -5.1), (-1.75, -4.8), (2.3, -9.6), (2.4, -10.3), (-0.4, -15.6), (0.3, -15.9)];
    for (i, (x, z)) in drums.into_iter().enumerate() {
        let material = dice.pick(&goods.barrels).unwrap_or(0);
        let settings = ShapeSettings::semantic(class::GOODS).repeat(3.0, 2.0).segments(28, 1);
        let place = Placement::at([x, 0.45, z]).turned(DQuat::from_rotation_y(dice.between(0.0, 6.0)));
        let shape = Shape::Cylinder { radius: 0.29, height: 0.9 };
        let drum = scene.shape_with(format!("drum {i}"), shape, material, settings, place)?;
        for (rim, y) in [-0.44, -0.15, 0.15, 0.44].into_iter().enumerate() {
            let settings = ShapeSettings::semantic(class::GOODS).segments(28, 1);
            let shape = Shape::Cylinder { radius: 0.302, height: 0.03 };
            scene.shape_with(
                format!("drum {i} rim {rim}"),
                shape,
                material,
                settings,
                Placement::at([0.0, y, 0.0]).on(drum),
            )?;
        }
    }
    Ok(())
}

fn lights(scene: &mut SceneBuilder) -> Result<(), SceneError> {
    let down = |x: f64, y: f64, z: f64| Placement::looking_at([x, y, z], [x, 0.0, z - 1e-3]);
    // One lamp throws the shadows; the others fill.
    let key = Light::spot("key light", 1500.0, 40.0, 78.0).colored([1.0, 0.95, 0.86]).with_shadow();
    scene.light(key, Placement::looking_at([0.6, 6.3, 2.0], [0.0, 0.0, -4.5]))?;
    let panel = scene.material(Material::unlit("lamp panel").colored([60.0, 58.0, 54.0]))?;
    for i in 0..3u32 {
        let z = 1.0 - 6.0 * f64::from(i);
        let light = Light::point(format!("lamp light {i}"), 420.0).colored([1.0, 0.96, 0.9]);
        scene.light(light, down(0.0, 5.5, z))?;
        let settings = ShapeSettings::semantic(class::LAMP);
        let shape = Shape::Box { size: [0.5, 0.06, 2.2] };
        scene.shape_with(format!("lamp {i}"), shape, panel, settings, Placement::at([0.0, 5.75, z]))?;
    }
    // A warning beacon over the door blinks.
    let blink =
        Waveform { shape: WaveShape::Pwm { duty: 0.3 }, frequency_hz: 4.0, phase: 0.0, low: 0.05, high: 1.0 };
    let beacon = scene.material(
        Material { model: crate::model::ShadingModel::Unlit, ..Material::diffuse("beacon") }
            .colored([50.0, 20.0, 2.0])
            .emitting([0.0; 3], Some(blink)),
    )?;
    let settings = ShapeSettings::semantic(class::LAMP).segments(20, 10);
    scene.shape_with(
        "beacon",
        Shape::Sphere { radius: 0.16 },
        beacon,
        settings,
        Placement::at([0.0, 4.25, -16.8]),
    )?;
    Ok(())
}

fn thrown(scene: &mut SceneBuilder, goods: &Goods, dice: &mut Dice) -> Result<(), SceneError> {
    let shapes = [
        Shape::Box { size: [0.4, 0.3, 0.34] },
        Shape::Sphere { radius: 0.17 },
        Shape::Capsule { radius: 0.09, height: 0.4 },
        Shape::Box { size: [0.26, 0.26, 0.26] },
        Shape::Cylinder { radius: 0.11, height: 0.42 },
        Shape::Sphere { radius: 0.12 },
    ];
    for i in 0..12u32 {
        let Some(shape) = shapes.get(i as usize % shapes.len()).copied() else { continue };
        let material = match shape {
            Shape::Box { .. } => goods.material(dice),
            Shape::Sphere { .. } => dice.pick(&goods.totes).unwrap_or(0),
            _ => dice.pick(&goods.barrels).unwrap_or(0),
        };
        // From the edge of a board on one side across the aisle.
        let side = if i % 2 == 0 { -1.0 } else { 1.0 };
        // Each waits at a place of its own.
        let place = [3.0, 0.0, 4.0, 1.0, 5.0, 2.0][i as usize / 2];
        let z = -5.5 + 0.78 * place + dice.between(0.0, 0.36);
        let start = Trs { translation: DVec3::new(side * 3.35, 1.95, z), ..Trs::default() };
        let velocity =
            DVec3::new(-side * dice.between(3.4, 5.2), dice.between(2.4, 4.6), dice.between(-0.8, 1.2));
        let spin_axis = DVec3::new(dice.between(-1.0, 1.0), 1.0, dice.between(-1.0, 1.0)).normalize();
        let path = Path::Ballistic {
            start,
            velocity,
            gravity: DVec3::new(0.0, -9.81, 0.0),
            spin_axis,
            spin_rate: dice.between(4.0, 10.0),
            launch_s: 0.15 + 0.3 * f64::from(i),
        };
        let settings = ShapeSettings::semantic(class::MOVING).repeat(1.0, 1.0);
        scene.shape_with(format!("thrown {i}"), shape, material, settings, Placement::along(path))?;
    }
    // A fan under the roof.
    let blade = scene.material(Material::diffuse("fan").colored(srgb(0x3a3f46)))?;
    let mut blades = Assembly::new(blade);
    for i in 0..2 {
        let size = if i == 0 { [2.4, 0.03, 0.2] } else { [0.2, 0.026, 2.4] };
        blades.beam([0.0, 0.0, 0.0], size, 1.0)?;
    }
    let fan = scene.mesh(Mesh { name: "fan".into(), primitives: vec![blades.whole], ..Mesh::default() })?;
    let start = Trs { translation: DVec3::new(0.0, 5.3, -8.0), ..Trs::default() };
    let path = Path::Spin { start, axis: DVec3::Y, rate: 5.0 };
    scene.object("fan", fan, labels(class::MOVING), Placement::along(path))?;
    Ok(())
}

fn carton(
    scene: &mut SceneBuilder,
    name: String,
    size: [f64; 3],
    material: usize,
    place: Placement,
) -> Result<usize, SceneError> {
    scene.shape_with(name, Shape::Box { size }, material, ShapeSettings::semantic(class::GOODS), place)
}
