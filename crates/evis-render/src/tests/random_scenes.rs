//! Random scenes: everything that may change a picture, and everything that looks as if it did and does not.
//!
//! Times are in milliseconds of a stream at [`RATE_HZ`]: some motions return to the same pose at every second instant, or
//! last for less than a block.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use evis_scene::builder::{EventCamera, Labels, Placement, Sampling, SceneBuilder, look_rotation};
use evis_scene::environment::Environment;
use evis_scene::motion::{Curve, Interpolation, Motion, Path, WaveShape, Waveform};
use evis_scene::primitive::Shape;
use evis_scene::procedural::{Pattern, Procedural};
use evis_scene::{AlphaMode, Light, Material, Mesh, MorphTarget, Primitive, Scene, Skin, Trs, Variant};
use glam::{DMat4, DQuat, DVec3};

/// Instants per second for which the motions are made.
pub const RATE_HZ: f64 = 1000.0;
/// How long something happens.
pub const LENGTH_MS: u32 = 48;

static STUDIO: LazyLock<Environment> = LazyLock::new(Environment::studio);

/// Numbers from a seed (G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", 2014).
pub struct Dice(pub u64);

impl Dice {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.word() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn one_of(&mut self, count: usize) -> usize {
        (self.word() % count as u64) as usize
    }

    /// One time in `count`.
    fn rarely(&mut self, count: usize) -> bool {
        self.one_of(count) == 0
    }

    fn vector(&mut self, most: f64) -> DVec3 {
        DVec3::from([0; 3].map(|_| self.between(-most, most)))
    }

    fn turn(&mut self, most: f64) -> DQuat {
        let axis = self.vector(1.0).normalize_or(DVec3::Y);
        DQuat::from_axis_angle(axis, self.between(-most, most))
    }

    fn pose(&mut self) -> Trs {
        let translation = self.vector(1.0) * DVec3::new(1.6, 1.0, 1.2);
        Trs { translation, rotation: self.turn(3.0), ..Trs::default() }
    }
}

/// Keys of a curve, at milliseconds.
fn curve(width: usize, interpolation: Interpolation, keys: &[(f64, &[f64])]) -> Curve {
    Curve {
        times: keys.iter().map(|(ms, _)| ms * 1e-3).collect(),
        values: keys.iter().flat_map(|(_, values)| values.iter().copied()).collect(),
        width,
        interpolation,
    }
}

/// Every kind of motion of a node.
fn motion(dice: &mut Dice, rest: Trs) -> Motion {
    let at = rest.translation.to_array();
    let by = |v: DVec3| (rest.translation + v).to_array();
    let animated = |translation| Motion::Animated { rest, translation, rotation: None, scale: None };
    let linear = Interpolation::Linear;
    let end = f64::from(LENGTH_MS);
    match dice.one_of(12) {
        0 | 1 => Motion::Fixed(rest.matrix()),
        // Keys that are equal.
        2 => animated(Some(curve(3, linear, &[(0.0, &at), (end, &at)]))),
        // It pauses from 12 to 40 ms.
        3 => {
            let (here, there) = (by(dice.vector(0.1)), by(dice.vector(0.1)));
            animated(Some(curve(3, linear, &[(0.0, &at), (12.0, &here), (40.0, &here), (end, &there)])))
        }
        // Elsewhere for 1 to 3 ms.
        4 => {
            let (from, there) = (dice.between(3.0, 40.0).floor() + 0.5, by(dice.vector(0.6)));
            let until = from + 1.0 + dice.one_of(3) as f64;
            animated(Some(curve(3, Interpolation::Step, &[(0.0, &at), (from, &there), (until, &at)])))
        }
        // Back at the same pose at every second instant, or at every fourth.
        5 => {
            let (there, period) = (by(dice.vector(0.05)), [2, 4][dice.one_of(2)]);
            let keys: Vec<(f64, &[f64])> = (0..=LENGTH_MS + 2)
                .map(|ms| (f64::from(ms), if ms % period == 1 { &there[..] } else { &at[..] }))
                .collect();
            animated(Some(curve(3, linear, &keys)))
        }
        6 => Motion::Path(Path::Spin { start: rest, axis: DVec3::Y, rate: dice.between(-9.0, 9.0) }.into()),
        // Fast enough to enter or leave the picture.
        7 => Motion::Path(Path::ConstantVelocity { start: rest, velocity: dice.vector(40.0) }.into()),
        8 => Motion::Path(Path::ConstantVelocity { start: rest, velocity: dice.vector(1.0) }.into()),
        // Shrinks to nothing, and is nothing for a while.
        9 => {
            let scale =
                curve(3, linear, &[(0.0, &[1.0; 3]), (15.0, &[0.0; 3]), (33.0, &[0.0; 3]), (end, &[1.0; 3])]);
            Motion::Animated { rest, translation: None, rotation: None, scale: Some(scale) }
        }
        // A swing of which the ends and the middle of blocks see nothing.
        10 => {
            let there = by(dice.vector(0.4));
            let keys: Vec<(f64, &[f64])> = (0..=2 * LENGTH_MS / 8)
                .map(|k| (4.0 * f64::from(k), if k % 2 == 1 { &there[..] } else { &at[..] }))
                .collect();
            animated(Some(curve(3, linear, &keys)))
        }
        _ => Motion::Path(Path::Spin { start: rest, axis: DVec3::X, rate: 0.0 }.into()),
    }
}

/// The weights of a node's targets over time: they rest, move, pulse or pause, below 0 and beyond 1 too.
fn weights(dice: &mut Dice) -> Option<Curve> {
    let mut pair = || [dice.between(-1.0, 2.0), dice.between(-1.5, 1.0)];
    let (a, b) = (pair(), pair());
    let end = f64::from(LENGTH_MS);
    match dice.one_of(4) {
        0 => None,
        1 => Some(curve(2, Interpolation::Linear, &[(0.0, &a), (end, &a)])),
        2 => Some(curve(2, Interpolation::Linear, &[(0.0, &a), (10.0, &b), (30.0, &b), (end, &a)])),
        _ => Some(curve(2, Interpolation::Step, &[(0.0, &a), (21.5, &b), (23.5, &a)])),
    }
}

fn waveform(dice: &mut Dice) -> Option<Waveform> {
    let shape = match dice.one_of(4) {
        0 => WaveShape::Sine,
        1 => WaveShape::Pwm { duty: 0.1 },
        _ => return None,
    };
    let frequency_hz = dice.between(20.0, 500.0);
    Some(Waveform { shape, frequency_hz, phase: dice.between(0.0, 1.0), low: 0.0, high: 1.0 })
}

fn shape(dice: &mut Dice, material: usize) -> Primitive {
    let size = 0.25 + dice.between(0.0, 0.5);
    let shape = match dice.one_of(3) {
        0 => Shape::Sphere { radius: size / 2.0 },
        1 => Shape::Card { size: [size, 0.7 * size] },
        _ => Shape::Box { size: [size, 0.6 * size, 0.8 * size] },
    };
    Primitive { material, ..shape.build(Some([6, 4]), [1.0; 2]).unwrap() }
}

/// A scene of its own for every seed.
pub fn scene(seed: u64) -> Scene {
    let mut dice = Dice(seed);
    let mut s = SceneBuilder::new(format!("random {seed}"));
    s.background([0.2, 0.25, 0.3]).unwrap();
    s.ambient([0.15; 3]).unwrap();
    s.duration_s(f64::from(LENGTH_MS) * 1e-3).unwrap();
    if dice.rarely(4) {
        s.environment(Environment { intensity: 0.8, ..STUDIO.clone() });
    }
    let pattern = s.procedural("grit", &Procedural::new(Pattern::Noise, 64, 3), Sampling::default()).unwrap();
    let holes =
        s.procedural("checks", &Procedural::new(Pattern::Checker, 16, 2), Sampling::default()).unwrap();
    let mut materials = vec![
        s.material(Material::unlit("plain").textured(pattern)).unwrap(),
        s.material(Material::diffuse("dull").textured(pattern)).unwrap(),
        s.material(Material::diffuse("grey").colored([0.5; 3])).unwrap(),
        s.material(Material { alpha: AlphaMode::Mask(0.5), ..Material::diffuse("leaf").textured(holes) })
            .unwrap(),
    ];
    let glow = Material::diffuse("glow").emitting([0.4, 0.3, 0.1], waveform(&mut dice));
    materials.push(s.material(glow).unwrap());

    // A wall and a floor, that may have a motion and rest.
    let mut nodes = Vec::new();
    for (name, size, pose) in [
        ("wall", [9.0, 6.0], Trs { translation: DVec3::new(0.0, 0.5, -2.2), ..Trs::default() }),
        (
            "floor",
            [9.0, 6.0],
            Trs {
                translation: DVec3::new(0.0, -1.2, 0.0),
                rotation: DQuat::from_rotation_x(-TAU / 4.0),
                ..Trs::default()
            },
        ),
    ] {
        if dice.rarely(5) {
            continue;
        }
        let card = Shape::Card { size }.build(Some([4, 3]), [4.0; 2]).unwrap();
        let material = materials[dice.one_of(3)];
        let mesh =
            s.mesh(Mesh { primitives: vec![Primitive { material, ..card }], ..Mesh::default() }).unwrap();
        let node = s.object(name, mesh, Labels::default(), Placement::default()).unwrap();
        let at = pose.translation.to_array();
        let motion = match dice.one_of(3) {
            0 => Motion::Fixed(pose.matrix()),
            _ => Motion::Animated {
                rest: pose,
                translation: Some(curve(3, Interpolation::Linear, &[(0.0, &at), (10.0, &at), (48.0, &at)])),
                rotation: None,
                scale: None,
            },
        };
        nodes.push((node, motion));
    }
    // A box around everything, the camera too.
    if dice.rarely(6) {
        let around = Shape::Box { size: [12.0; 3] }.build(Some([3, 3]), [5.0; 2]).unwrap();
        let material = Material { double_sided: true, ..Material::unlit("around").textured(pattern) };
        let material = s.material(material).unwrap();
        let mesh =
            s.mesh(Mesh { primitives: vec![Primitive { material, ..around }], ..Mesh::default() }).unwrap();
        let node = s.object("around", mesh, Labels::default(), Placement::default()).unwrap();
        nodes.push((node, motion(&mut dice, Trs::default())));
    }
    let mut skinned = Vec::new();
    let mut morphing = Vec::new();
    for i in 0..2 + dice.one_of(5) {
        let material = materials[dice.one_of(materials.len())];
        let mut primitive = shape(&mut dice, material);
        let mut parent = None;
        if dice.rarely(4) {
            let rest = Trs { translation: dice.vector(0.3), ..Trs::default() };
            let rig = s.node(format!("rig {i}"), Placement::default()).unwrap();
            nodes.push((rig, motion(&mut dice, rest)));
            parent = Some(rig);
        }
        let deforms = dice.one_of(5);
        if deforms == 0 {
            let count = primitive.positions.len();
            let target = |by: &mut dyn FnMut([f32; 3]) -> [f32; 3]| MorphTarget {
                positions: primitive.positions.iter().map(|p| by(*p)).collect(),
                normals: vec![[0.0; 3]; count],
            };
            let swell = target(&mut |p| p.map(|v| 0.8 * v));
            let lean = target(&mut |[_, y, z]| [0.9 * y, 0.0, -0.5 * z]);
            primitive.morph_targets = vec![swell, lean];
        }
        if deforms == 1 {
            // Weights are normalised when the scene is built; some stay negative.
            let least = if dice.rarely(2) { -0.6 } else { 0.0 };
            let share = |y: f32| (2.0 * y + 0.5).clamp(0.0, 1.0);
            let of =
                |[_, y, _]: &[f32; 3]| [1.3 * (1.0 - share(*y)) - least, 1.3 * share(*y) + least, 0.0, 0.0];
            primitive.joints = Some(vec![[0, 1, 0, 0]; primitive.positions.len()]);
            primitive.joint_weights = Some(primitive.positions.iter().map(of).collect());
        }
        let mesh = Mesh { primitives: vec![primitive], morph_weights: Vec::new(), ..Mesh::default() };
        let mesh = s.mesh(mesh).unwrap();
        let place = parent.map_or_else(Placement::default, |parent| Placement::default().on(parent));
        let node = s.object(format!("object {i}"), mesh, Labels::default(), place).unwrap();
        let pose = dice.pose();
        nodes.push((node, motion(&mut dice, pose)));
        match deforms {
            0 => morphing.push((node, weights(&mut dice))),
            1 => {
                let joints = ["root", "tip"].map(|name| {
                    let joint = s.node(format!("{name} {i}"), Placement::default()).unwrap();
                    let rest = Trs { translation: pose.translation + dice.vector(0.2), ..pose };
                    nodes.push((joint, motion(&mut dice, rest)));
                    joint
                });
                skinned.push((node, joints));
            }
            _ => {}
        }
    }
    for i in 0..1 + dice.one_of(2) {
        let light = match dice.one_of(4) {
            0 => Light::point(format!("bulb {i}"), 3.0),
            1 => Light::directional(format!("sun {i}"), 2.0).with_shadow(),
            2 => Light::spot(format!("lamp {i}"), 30.0, 30.0, 40.0).with_shadow(),
            _ => Light::directional(format!("far sun {i}"), 1.5),
        };
        // Most lights are steady: where one changes, everything is rendered.
        let light = Light { waveform: if dice.rarely(4) { waveform(&mut dice) } else { None }, ..light };
        let from = DVec3::new(dice.between(-2.0, 2.0), dice.between(2.0, 4.0), dice.between(0.5, 3.0));
        let mut place = Placement::looking_at(from, [0.0, -0.5, -0.5]);
        if dice.rarely(6) {
            place =
                place.moving(Path::ConstantVelocity { start: Trs::default(), velocity: dice.vector(2.0) });
        }
        s.light(light, place).unwrap();
    }
    let eye = DVec3::new(dice.between(-0.5, 0.5), dice.between(0.0, 0.6), 3.0);
    let start = Trs { translation: eye, rotation: look_rotation(-eye, DVec3::Y), ..Trs::default() };
    let sizes = [(70, 50), (100, 76), (91, 61), (57, 83)];
    let (width, height) = sizes[dice.one_of(sizes.len())];
    let mount = s.node("mount", Placement::default()).unwrap();
    let camera = EventCamera::new("camera").size(width, height).fov_y_degrees(48.0);
    s.camera(camera, Placement::default().on(mount)).unwrap();
    nodes.push((
        mount,
        match dice.one_of(6) {
            0 => Motion::Fixed(start.matrix()),
            // What rests may have keys, and cameras vibrate and cut too.
            1 => motion(&mut dice, start),
            2 => {
                let rest = start.rotation.to_array();
                let turned = (start.rotation * dice.turn(0.3)).to_array();
                let rotation = curve(4, Interpolation::Step, &[(0.0, &rest), (20.5, &turned)]);
                Motion::Animated { rest: start, translation: None, rotation: Some(rotation), scale: None }
            }
            _ => Motion::Path(
                Path::Chain(vec![
                    Path::ConstantVelocity { start, velocity: dice.vector(1.5) },
                    Path::Spin {
                        start: Trs::default(),
                        axis: dice.vector(1.0).normalize_or(DVec3::Y),
                        rate: dice.between(-1.5, 1.5),
                    },
                ])
                .into(),
            ),
        },
    ));

    let mut scene = s.build().unwrap();
    for (node, motion) in nodes {
        scene.nodes[node].motion = motion;
    }
    for (node, curve) in morphing {
        scene.nodes[node].morph = curve;
    }
    for (node, joints) in skinned {
        let bind = [0.0, 0.2].map(|y| DMat4::from_translation(DVec3::new(0.0, -y, 0.0)));
        scene.nodes[node].skin = Some(scene.skins.len());
        scene.skins.push(Skin { joints: joints.to_vec(), inverse_bind: bind.to_vec() });
    }
    if dice.rarely(4) {
        let variant = |time_offset_s| Variant { time_offset_s, ..Variant::default() };
        scene.variants = vec![variant(0.0), variant(dice.between(0.0, 0.02))];
    }
    scene.validate().unwrap();
    scene
}
