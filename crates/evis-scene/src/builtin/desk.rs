//! A desk before a still camera: one toy moves, every other pixel is silent.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DMat4, DQuat, DVec3};

use super::class;
use super::parts::{Assembly, Dice, labels, paint};
use crate::builder::{EventCamera, Placement, SceneBuilder, ShapeSettings, still};
use crate::error::SceneError;
use crate::model::{Light, Material, Mesh, Scene, Trs};
use crate::motion::Path;
use crate::primitive::Shape;
use crate::procedural::{Pattern, srgb};

pub(super) fn load(seed: u64) -> Result<Scene, SceneError> {
    let mut scene = SceneBuilder::new("desk");
    scene.duration_s(4.0)?;
    scene.background([0.05, 0.05, 0.06])?;
    scene.ambient([1.6, 1.7, 2.0])?;
    let mut dice = Dice::new(seed ^ 0xde);
    room(&mut scene, seed)?;
    books(&mut scene, seed, &mut dice)?;
    mug(&mut scene, seed)?;
    lamp(&mut scene, seed)?;
    small_things(&mut scene, seed)?;

    let beads =
        paint(&mut scene, seed, "toy", Pattern::Checker, 256, Some([srgb(0xf0d040), srgb(0xc02c50)]))?;
    let toy = scene.material(Material::diffuse("toy").textured(beads))?;
    let start = Trs { translation: DVec3::new(0.02, 0.062, 0.12), ..Trs::default() };
    let path = Path::Chain(vec![
        Path::FigureEight { start, size: [0.2, 0.07], period_s: 4.0, look_at: None },
        Path::Spin { start: Trs::default(), axis: DVec3::new(0.3, 1.0, 0.2).normalize(), rate: TAU / 2.0 },
    ]);
    let settings = ShapeSettings::semantic(class::MOVING).segments(48, 24);
    scene.shape_with("toy", Shape::Sphere { radius: 0.06 }, toy, settings, Placement::along(path))?;

    let eye = Placement::looking_at([0.0, 0.48, 0.95], [0.0, 0.14, 0.0]);
    scene.camera(EventCamera::new("camera").fov_y_degrees(48.0), eye)?;
    scene.build()
}

fn room(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let planks = paint(scene, seed, "desk", Pattern::Wood, 1024, Some([srgb(0xb98652), srgb(0x6f4524)]))?;
    let top = scene.material(Material::glossy("desk top", 0.0, 0.5).textured(planks))?;
    let settings = ShapeSettings::semantic(class::FURNITURE).repeat(1.0, 0.5);
    scene.shape_with(
        "desk top",
        Shape::Box { size: [1.7, 0.04, 0.85] },
        top,
        settings,
        Placement::at([0.0, -0.02, 0.0]),
    )?;
    let plaster =
        paint(scene, seed, "plaster", Pattern::Bricks, 512, Some([srgb(0xcfd8d6), srgb(0xa8b4b2)]))?;
    let wall = scene.material(Material::diffuse("wall").textured(plaster))?;
    let settings = ShapeSettings::semantic(class::BUILDING).repeat(3.0, 2.0);
    scene.shape_with(
        "wall",
        Shape::Card { size: [4.0, 2.6] },
        wall,
        settings,
        Placement::at([0.0, 0.6, -0.6]),
    )?;
    let carpet = paint(scene, seed, "carpet", Pattern::Fabric, 256, None)?;
    let floor = scene.material(Material::diffuse("carpet").textured(carpet))?;
    let settings = ShapeSettings::semantic(class::GROUND).repeat(8.0, 8.0);
    scene.shape_with(
        "floor",
        Shape::Plane { size: [4.0; 2] },
        floor,
        settings,
        Placement::at([0.0, -0.74, 0.4]),
    )?;
    let picture = paint(scene, seed, "picture", Pattern::Poster, 512, None)?;
    let picture = scene.material(Material::diffuse("picture").textured(picture))?;
    let settings = ShapeSettings::semantic(class::BUILDING);
    scene.shape_with(
        "picture",
        Shape::Card { size: [0.42, 0.42] },
        picture,
        settings,
        Placement::at([0.12, 0.42, -0.59]),
    )?;
    let frame_material =
        scene.material(Material::diffuse("frame").textured(planks).colored(srgb(0x8a7868)))?;
    let mut frame = Assembly::new(frame_material);
    for (x, y, w, h) in
        [(0.0, 0.22, 0.46, 0.02), (0.0, -0.22, 0.46, 0.02), (0.22, 0.0, 0.02, 0.42), (-0.22, 0.0, 0.02, 0.42)]
    {
        frame.beam([x, y, 0.0], [w, h, 0.03], 0.4)?;
    }
    let mesh = scene.mesh(Mesh { name: "frame".into(), primitives: vec![frame.whole], ..Mesh::default() })?;
    scene.object("frame", mesh, labels(class::BUILDING), Placement::at([0.12, 0.42, -0.583]))?;
    Ok(())
}

fn books(scene: &mut SceneBuilder, seed: u64, dice: &mut Dice) -> Result<(), SceneError> {
    let paper = paint(scene, seed, "pages", Pattern::Stripes, 256, Some([srgb(0xeee6d2), srgb(0xcfc4a8)]))?;
    let pages = scene.material(Material::diffuse("pages").textured(paper))?;
    let covers = [0xa83a32, 0x2f5f98, 0x3f8050, 0xcf9430, 0x6a4a8a, 0x2c7a80];
    let mut materials = Vec::new();
    for (i, color) in covers.into_iter().enumerate() {
        let name = format!("cover {i}");
        let print = paint(scene, seed, &name, Pattern::Label, 256, Some([srgb(color), srgb(0xf0e2b0)]))?;
        materials.push(scene.material(Material::diffuse(name).textured(print))?);
    }
    let book = |scene: &mut SceneBuilder, name: String, cover: usize, size: [f64; 3], place: Placement| {
        let [thick, high, deep] = size;
        // Spine and boards around a block of pages that is set back on three sides.
        let (mut case, mut block) = (Assembly::new(cover), Assembly::new(pages));
        let board = 0.003;
        let part = |to: &mut Assembly, size: [f64; 3], at: [f64; 3]| {
            to.part(Shape::Box { size }, 1.0, DMat4::from_translation(at.into())).map(|_| ())
        };
        part(&mut block, [thick - 2.0 * board, high - 0.012, deep - 0.008], [0.0, 0.0, -0.002])?;
        for x in [-1.0, 1.0] {
            part(&mut case, [board, high, deep - board], [x * (thick - board) / 2.0, 0.0, -board / 2.0])?;
        }
        part(&mut case, [thick, high, board], [0.0, 0.0, (deep - board) / 2.0])?;
        for assembly in [&mut case, &mut block] {
            stretch_to_unit(assembly);
        }
        let primitives = vec![case.whole, block.whole];
        let mesh = scene.mesh(Mesh { name: "book".into(), primitives, ..Mesh::default() })?;
        scene.object(name, mesh, labels(class::THING), place)
    };
    // A row that stands, the last one leaning.
    let mut x = -0.72;
    for i in 0..9 {
        let (thick, high) = (dice.between(0.026, 0.055), dice.between(0.19, 0.27));
        let cover = dice.pick(&materials).unwrap_or(0);
        let place = Placement::at([x + thick / 2.0, high / 2.0, -0.28 + dice.between(-0.01, 0.01)]);
        book(scene, format!("book {i}"), cover, [thick, high, 0.17], place)?;
        x += thick + 0.002;
    }
    let lean = 0.28f64;
    let (thick, high) = (0.035, 0.23);
    let [sin, cos] = [lean.sin(), lean.cos()];
    let at = [x + 0.004 + (thick * cos + high * sin) / 2.0, (high * cos + thick * sin) / 2.0, -0.28];
    let place = Placement::at(at).turned(DQuat::from_rotation_z(lean));
    let cover = dice.pick(&materials).unwrap_or(0);
    book(scene, "book leaning".into(), cover, [thick, high, 0.17], place)?;
    // A pile that lies.
    let mut y = 0.0;
    for i in 0..4 {
        let (thick, long) = (dice.between(0.022, 0.04), dice.between(0.19, 0.24));
        let lie = DQuat::from_rotation_y(dice.between(-0.35, 0.35)) * DQuat::from_rotation_z(FRAC_PI_2);
        let cover = materials.get(i % materials.len().max(1)).copied().unwrap_or(0);
        let place = Placement::at([-0.42, y + thick / 2.0, 0.04]).turned(lie);
        book(scene, format!("book lying {i}"), cover, [thick, long, 0.16], place)?;
        y += thick + 0.001;
    }
    Ok(())
}

/// Puts the whole picture on every face again, whatever the face's size.
fn stretch_to_unit(assembly: &mut Assembly) {
    if let Some(uvs) = &mut assembly.whole.uvs[0] {
        for face in uvs.chunks_exact_mut(4) {
            face.copy_from_slice(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]);
        }
    }
}

fn mug(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let print = paint(scene, seed, "mug", Pattern::Poster, 256, Some([srgb(0xf4f0e6), srgb(0x1f4e6a)]))?;
    let glaze = scene.material(Material::glossy("mug", 0.0, 0.2).textured(print))?;
    let coffee = scene.material(Material::glossy("coffee", 0.0, 0.15).colored(srgb(0x4a2c18)))?;
    let inside = scene.material(Material::glossy("mug inside", 0.0, 0.25).colored(srgb(0xf0ece2)))?;
    let settings = ShapeSettings::semantic(class::THING).repeat(2.0, 1.0).segments(48, 1);
    let place = Placement::at([0.34, 0.05, 0.02]).turned(DQuat::from_rotation_y(0.4));
    let mug =
        scene.shape_with("mug", Shape::Cylinder { radius: 0.042, height: 0.1 }, glaze, settings, place)?;
    let settings = ShapeSettings::semantic(class::THING).segments(48, 1);
    let rim = Shape::Cylinder { radius: 0.0405, height: 0.002 };
    scene.shape_with("mug rim", rim, inside, settings, Placement::at([0.0, 0.0505, 0.0]).on(mug))?;
    let surface = Shape::Cylinder { radius: 0.037, height: 0.002 };
    scene.shape_with("coffee", surface, coffee, settings, Placement::at([0.0, 0.0515, 0.0]).on(mug))?;
    let mut handle = Assembly::new(inside);
    let point = |i: u32| {
        let angle = FRAC_PI_2 - std::f64::consts::PI * f64::from(i) / 10.0;
        DVec3::new(0.038 + 0.034 * angle.cos(), 0.03 * angle.sin(), 0.0)
    };
    for i in 0..10 {
        let (a, b) = (point(i), point(i + 1));
        let turn = DQuat::from_rotation_arc(DVec3::Y, (b - a).normalize());
        let shape = Shape::Capsule { radius: 0.0065, height: a.distance(b) };
        handle.part(shape, 1.0, DMat4::from_rotation_translation(turn, (a + b) / 2.0))?;
    }
    let handle =
        scene.mesh(Mesh { name: "handle".into(), primitives: vec![handle.whole], ..Mesh::default() })?;
    scene.object("mug handle", handle, labels(class::THING), Placement::default().on(mug))?;
    Ok(())
}

fn lamp(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let sheet = paint(scene, seed, "lamp", Pattern::Metal, 128, Some([srgb(0xf0f0f0), srgb(0xb8b8b8)]))?;
    let enamel =
        scene.material(Material::glossy("lamp", 0.1, 0.35).textured(sheet).colored(srgb(0x2f8f7c)))?;
    let glow = scene.material(Material::unlit("bulb").colored([40.0, 36.0, 28.0]))?;
    let (foot, elbow, head) = ([0.56, 0.0, -0.22], [0.66, 0.3, -0.24], [0.40, 0.47, -0.12]);
    let mut parts = Assembly::new(enamel);
    let lift = |at: [f64; 3], y: f64| DMat4::from_translation(DVec3::from(at) + DVec3::Y * y);
    parts.part(Shape::Cylinder { radius: 0.075, height: 0.02 }, 1.0, lift(foot, 0.01))?;
    let rod = |a: [f64; 3], b: [f64; 3]| {
        let (a, b) = (DVec3::from(a), DVec3::from(b));
        let turn = DQuat::from_rotation_arc(DVec3::Y, (b - a).normalize());
        let shape = Shape::Capsule { radius: 0.008, height: a.distance(b) };
        (shape, DMat4::from_rotation_translation(turn, (a + b) / 2.0))
    };
    for (a, b) in [(foot, elbow), (elbow, head)] {
        let (shape, place) = rod(a, b);
        parts.part(shape, 1.0, place)?;
    }
    parts.part(Shape::Sphere { radius: 0.014 }, 1.0, lift(elbow, 0.0))?;
    // The shade points down towards the desk.
    let aim = DVec3::new(-0.28, -1.0, 0.3).normalize();
    let turn = DQuat::from_rotation_arc(DVec3::NEG_Y, aim);
    let at = |along: f64| DMat4::from_rotation_translation(turn, DVec3::from(head) + aim * along);
    for (radius, height, along) in
        [(0.03, 0.04, 0.0), (0.045, 0.03, 0.03), (0.058, 0.03, 0.055), (0.068, 0.03, 0.08)]
    {
        parts.part(Shape::Cylinder { radius, height }, 1.0, at(along))?;
    }
    let mut bulb = Assembly::new(glow);
    bulb.part(Shape::Cylinder { radius: 0.06, height: 0.004 }, 1.0, at(0.096))?;
    let primitives = vec![parts.whole, bulb.whole];
    let mesh = scene.mesh(Mesh { name: "lamp".into(), primitives, ..Mesh::default() })?;
    scene.object("lamp", mesh, labels(class::LAMP), Placement::default())?;
    let from = DVec3::from(head) + aim * 0.11;
    let light = Light::spot("lamp light", 3.6, 30.0, 72.0).colored([1.0, 0.88, 0.68]).with_shadow();
    scene.light(light, Placement::looking_at(from, from + aim))?;
    let window = Light::directional("window light", 7.0).colored([0.82, 0.9, 1.0]);
    scene.light(window, Placement::looking_at([-1.6, 1.8, 1.4], [0.0, 0.0, 0.0]))?;
    Ok(())
}

fn small_things(scene: &mut SceneBuilder, seed: u64) -> Result<(), SceneError> {
    let print = paint(scene, seed, "notes", Pattern::Label, 512, None)?;
    let notes = scene.material(Material::diffuse("notes").textured(print))?;
    for (i, (x, z, turn)) in [(0.30, 0.24, -0.25), (0.26, 0.26, 0.12)].into_iter().enumerate() {
        let place = Placement::at([x, 0.002 + 0.002 * i as f64, z]).turned(DQuat::from_rotation_y(turn));
        let settings = ShapeSettings::semantic(class::THING);
        let shape = Shape::Box { size: [0.15, 0.002, 0.21] };
        scene.shape_with(format!("sheet {i}"), shape, notes, settings, place)?;
    }
    let stripes = paint(scene, seed, "pencil", Pattern::Stripes, 64, Some([srgb(0xf0b830), srgb(0xc07020)]))?;
    for (i, color) in [0xffffff, 0x80c0ff, 0xff9090].into_iter().enumerate() {
        let name = format!("pencil {i}");
        let material =
            scene.material(Material::diffuse(name.clone()).textured(stripes).colored(srgb(color)))?;
        let turn = DQuat::from_rotation_y(0.3 + 0.5 * i as f64) * DQuat::from_rotation_z(FRAC_PI_2);
        let start = Trs {
            translation: DVec3::new(-0.16 + 0.09 * i as f64, 0.005, 0.3),
            rotation: turn,
            ..Trs::default()
        };
        let settings = ShapeSettings::semantic(class::THING).segments(10, 1);
        let shape = Shape::Cylinder { radius: 0.0045, height: 0.17 };
        scene.shape_with(name, shape, material, settings, Placement::along(still(start)))?;
    }
    Ok(())
}
