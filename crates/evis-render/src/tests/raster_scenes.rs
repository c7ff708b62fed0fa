//! Scenes that between them use everything that a surface can be, each small enough to be compared ray by ray.

use std::f64::consts::PI;
use std::sync::LazyLock;

use evis_scene::builder::{EventCamera, Labels, Placement, Sampling, SceneBuilder, ShapeSettings};
use evis_scene::environment::Environment;
use evis_scene::motion::{Curve, Interpolation, Path, WaveShape, Waveform};
use evis_scene::primitive::Shape;
use evis_scene::procedural::{Pattern, Procedural};
use evis_scene::{
    AlphaMode, Image, Lens, Light, Material, Mesh, MorphTarget, Primitive, Scene, ShadingModel, Skin,
    TextureRef, Trs, Wrap,
};
use glam::{DMat4, DQuat, DVec3};
use half::f16;

pub const WIDTH: u32 = 48;
pub const HEIGHT: u32 = 36;

/// Prefiltered once: it takes a while.
static STUDIO: LazyLock<Environment> = LazyLock::new(Environment::studio);

/// Smooth numbers in [0, 1], another for every texel and channel.
fn noise(x: u32, y: u32, channel: u32) -> f32 {
    let v = (f64::from(x) * 12.9898 + f64::from(y) * 78.233 + f64::from(channel) * 37.719).sin() * 43758.5453;
    (v - v.floor()) as f32
}

/// An 8x8 texture: few pixels on the screen, so that it is magnified.
fn texture(scene: &mut SceneBuilder, wrap: Wrap, texel: impl Fn(u32, u32) -> [f32; 4]) -> usize {
    let texels = (0..64).map(|i| texel(i % 8, i / 8).map(f16::from_f32)).collect();
    let image = Image { name: "small".into(), width: 8, height: 8, texels };
    scene.texture(image, Sampling { wrap_u: wrap, wrap_v: wrap, nearest: false }).unwrap()
}

fn colors(scene: &mut SceneBuilder) -> usize {
    texture(scene, Wrap::Repeat, |x, y| {
        [0, 1, 2, 3].map(|c| 0.2 + if c == 3 { 0.8 } else { 0.7 * noise(x, y, c) })
    })
}

fn primitive(shape: Shape, segments: [u32; 2], material: usize) -> Primitive {
    Primitive { material, ..shape.build(Some(segments), [1.0; 2]).unwrap() }
}

/// With a part of the picture on each face: the level of detail below the base is the driver's own.
fn magnified(mut primitive: Primitive) -> Primitive {
    primitive.uvs[0].iter_mut().flatten().flatten().for_each(|v| *v *= 0.4);
    primitive
}

fn add(
    scene: &mut SceneBuilder,
    name: &str,
    primitive: Primitive,
    semantic_id: u32,
    place: Placement,
) -> usize {
    let mesh = Mesh { primitives: vec![primitive], ..Mesh::default() };
    let mesh = scene.mesh(mesh).unwrap();
    scene.object(name, mesh, Labels { semantic_id, instance_id: 0 }, place).unwrap()
}

fn camera(scene: &mut SceneBuilder, place: Placement) {
    scene.camera(EventCamera::new("camera").size(WIDTH, HEIGHT).fov_y_degrees(50.0), place).unwrap();
}

fn turned(axis: DVec3, radians: f64) -> DQuat {
    DQuat::from_axis_angle(axis.normalize(), radians)
}

/// Unlit: a texture on the second set of coordinates, turned; vertex colours; a background; a camera with its own
/// principal point on a node that is scaled and sheared.
pub fn unlit() -> Scene {
    let mut s = SceneBuilder::new("unlit");
    s.background([0.3, 0.1, 0.2]).unwrap();
    let map = colors(&mut s);
    let turn = TextureRef { texture: map, uv_set: 1, transform: [0.8, -0.3, 0.2, 0.4, 0.7, -0.1] };
    let textured =
        Material { base_color_texture: Some(turn), ..Material::unlit("textured").colored([1.0, 0.5, 2.0]) };
    let textured = s.material(textured).unwrap();
    let mut card = primitive(Shape::Card { size: [1.6, 1.4] }, [2, 2], textured);
    card.uvs[1] = card.uvs[0].as_ref().map(|uv| uv.iter().map(|[u, v]| [v * 1.1, 1.0 - u]).collect());
    add(&mut s, "card", card, 1, Placement::at([-0.6, 0.1, 0.0]).turned(turned(DVec3::Y, 0.5)));
    let painted = s.material(Material::unlit("painted").colored([0.9, 1.0, 0.8])).unwrap();
    let mut ball = primitive(Shape::Sphere { radius: 0.5 }, [12, 8], painted);
    ball.colors = Some(ball.positions.iter().map(|[x, y, z]| [0.5 + x, 0.5 + y, 0.6 + z, 1.0]).collect());
    add(&mut s, "ball", ball, 2, Placement::at([0.7, -0.1, 0.3]));
    let rig = s.node("rig", Placement::at([0.0, 0.0, 2.5]).scaled([2.0, 0.5, 1.5])).unwrap();
    let lens = EventCamera::new("camera").size(WIDTH, HEIGHT).intrinsics(40.0, 43.0, 21.3, 19.9);
    s.camera(lens, Placement::default().on(rig).turned(turned(DVec3::new(0.1, 1.0, 0.3), 0.12))).unwrap();
    s.build().unwrap()
}

pub fn wrong_texture_transform(scene: &mut Scene) {
    for material in &mut scene.materials {
        if let Some(texture) = &mut material.base_color_texture {
            texture.transform[2] += 0.02;
        }
    }
}

fn waveform(shape: WaveShape, phase: f64) -> Option<Waveform> {
    Some(Waveform { shape, frequency_hz: 40.0, phase, low: 0.2, high: 1.3 })
}

/// Lambert under every kind of light, with an occlusion texture, emission and lights that vary in time.
pub fn diffuse() -> Scene {
    let mut s = SceneBuilder::new("diffuse");
    s.ambient([0.1, 0.15, 0.05]).unwrap();
    let (map, holes) = (colors(&mut s), texture(&mut s, Wrap::Mirror, |x, y| [noise(x, y, 7); 4]));
    let floor = Material {
        occlusion_texture: Some(TextureRef::new(holes)),
        occlusion_strength: 0.8,
        emissive_texture: Some(TextureRef::new(map)),
        ..Material::diffuse("floor").textured(map)
    };
    let floor = s.material(floor.emitting([0.1, 0.3, 0.2], waveform(WaveShape::Sine, 0.1))).unwrap();
    let red = s.material(Material::diffuse("red").colored([0.8, 0.3, 0.2])).unwrap();
    let plane = primitive(Shape::Plane { size: [3.0, 3.0] }, [1, 1], floor);
    add(&mut s, "floor", plane, 1, Placement::at([0.0, -0.6, 0.0]));
    let cube = primitive(Shape::Box { size: [0.7; 3] }, [1, 1], red);
    add(
        &mut s,
        "box",
        cube,
        2,
        Placement::at([-0.6, 0.1, 0.2]).turned(turned(DVec3::new(0.3, 1.0, 0.1), 0.7)),
    );
    let ball = primitive(Shape::Sphere { radius: 0.4 }, [24, 12], red);
    add(&mut s, "ball", ball, 3, Placement::at([0.6, 0.0, 0.0]).scaled([1.0, 1.6, 0.8]));
    let sun = Light::directional("sun", 1.5).colored([1.0, 0.9, 0.7]);
    s.light(sun, Placement::looking_at([1.0, 3.0, 2.0], [0.0; 3])).unwrap();
    let bulb = Light { range: Some(2.5), ..Light::point("bulb", 1.2).colored([0.4, 0.7, 1.0]) };
    let bulb = Light { waveform: waveform(WaveShape::Pwm { duty: 0.3 }, 0.0), ..bulb };
    s.light(bulb, Placement::at([0.2, 0.8, 0.9])).unwrap();
    let spot = Light::spot("spot", 6.0, 12.0, 25.0).colored([1.0, 0.4, 0.9]);
    let rig = s.node("rig", Placement::at([0.0, 0.0, 0.0]).scaled([-1.0, 1.0, 2.0])).unwrap();
    s.light(spot, Placement::looking_at([1.0, 2.0, 0.6], [-0.3, -0.6, 0.2]).on(rig)).unwrap();
    camera(&mut s, Placement::looking_at([0.2, 1.1, 2.6], [0.0, -0.1, 0.0]));
    s.build().unwrap()
}

pub fn wrong_light(scene: &mut Scene) {
    for light in scene.lights.iter_mut().take(1) {
        light.intensity *= 1.05;
    }
}

pub fn wrong_occlusion(scene: &mut Scene) {
    for material in &mut scene.materials {
        material.occlusion_strength = 0.0;
    }
}

pub fn wrong_waveform(scene: &mut Scene) {
    for material in &mut scene.materials {
        if let Some(wave) = &mut material.emission_waveform {
            wave.phase += 0.2;
        }
    }
}

/// A bumpy metallic-roughness material with every texture.
fn bumpy(s: &mut SceneBuilder, double_sided: bool) -> usize {
    let map = colors(s);
    let normals = texture(s, Wrap::Repeat, |x, y| {
        [0.5 + 0.6 * (noise(x, y, 1) - 0.5), 0.5 + 0.8 * (noise(x, y, 2) - 0.5), 0.9, 1.0]
    });
    let surface = texture(s, Wrap::Clamp, |x, y| [1.0, 0.4 + 0.6 * noise(x, y, 3), noise(x, y, 4), 1.0]);
    let holes = texture(s, Wrap::Mirror, |x, y| [0.2 + 0.8 * noise(x, y, 5), 0.0, 0.0, 1.0]);
    let glow = texture(s, Wrap::Repeat, |x, y| [noise(x, y, 6).powi(4), 0.1, 0.0, 1.0]);
    let material = Material {
        metallic_roughness_texture: Some(TextureRef::new(surface)),
        normal_texture: Some(TextureRef::new(normals)),
        normal_scale: 0.9,
        occlusion_texture: Some(TextureRef::new(holes)),
        occlusion_strength: 0.7,
        emissive_texture: Some(TextureRef::new(glow)),
        emissive: [0.5, 0.2, 0.1],
        double_sided,
        ..Material::glossy("bumpy", 0.9, 0.8).textured(map)
    };
    s.material(material).unwrap()
}

/// Metallic-roughness with every texture: as it is, mirrored, stretched and mirrored, and seen from behind.
pub fn glossy() -> Scene {
    let mut s = SceneBuilder::new("glossy");
    s.ambient([0.2, 0.2, 0.25]).unwrap();
    s.background([0.05, 0.05, 0.1]).unwrap();
    let (one, both) = (bumpy(&mut s, false), bumpy(&mut s, true));
    let card = |material| primitive(Shape::Card { size: [0.9, 0.9] }, [1, 1], material);
    let tilt = turned(DVec3::new(0.4, 1.0, 0.2), 0.4);
    add(&mut s, "plain", card(one), 1, Placement::at([-0.6, 0.5, 0.0]).turned(tilt));
    add(
        &mut s,
        "mirrored",
        card(one),
        2,
        Placement::at([0.6, 0.5, 0.0]).turned(tilt).scaled([-1.0, 1.0, 1.0]),
    );
    let back = turned(DVec3::new(0.1, 1.0, 0.0), PI - 0.4);
    add(&mut s, "behind", card(both), 3, Placement::at([-0.6, -0.5, 0.0]).turned(back));
    let cube = magnified(primitive(Shape::Box { size: [0.6, 0.6, 0.6] }, [1, 1], one));
    let place = Placement::at([0.6, -0.5, 0.0]).turned(turned(DVec3::new(0.3, 1.0, 0.2), 0.6));
    add(&mut s, "stretched", cube, 4, place.scaled([1.3, -0.9, 0.7]));
    let smooth = s.material(Material::glossy("smooth", 0.2, 0.35).colored([0.9, 0.6, 0.2])).unwrap();
    let ball = primitive(Shape::Sphere { radius: 0.25 }, [32, 16], smooth);
    add(&mut s, "ball", ball, 5, Placement::at([0.0, 0.0, 0.4]));
    s.light(Light::directional("sun", 2.0), Placement::looking_at([1.5, 2.0, 3.0], [0.0; 3])).unwrap();
    s.light(Light::point("bulb", 2.0), Placement::at([-1.0, -0.6, 1.4])).unwrap();
    camera(&mut s, Placement::at([0.0, 0.0, 2.6]));
    s.build().unwrap()
}

/// As if mirroring turned no bitangent: the node's own mirror is undone by the tangents' w.
pub fn wrong_bitangent(scene: &mut Scene) {
    for primitive in scene.meshes.iter_mut().flat_map(|m| &mut m.primitives) {
        for tangent in primitive.tangents.iter_mut().flatten() {
            tangent[3] = -tangent[3];
        }
    }
}

pub fn wrong_roughness(scene: &mut Scene) {
    for material in &mut scene.materials {
        material.roughness *= 0.9;
    }
}

/// Image-based light on all models, the sky behind, turned and brightened.
pub fn environment() -> Scene {
    let mut s = SceneBuilder::new("environment");
    s.environment(Environment { rotation: 0.7, intensity: 1.5, ..STUDIO.clone() });
    let materials = [
        Material::glossy("steel", 1.0, 0.4).colored([0.9, 0.8, 0.7]),
        Material::glossy("plastic", 0.0, 0.7).colored([0.2, 0.5, 0.8]),
        Material::diffuse("chalk").colored([0.9; 3]),
    ];
    for (i, material) in materials.into_iter().enumerate() {
        let material = s.material(material).unwrap();
        let ball = primitive(Shape::Sphere { radius: 0.42 }, [32, 16], material);
        add(&mut s, &format!("ball {i}"), ball, 1, Placement::at([i as f64 - 1.0, 0.1 * i as f64, 0.0]));
    }
    camera(&mut s, Placement::looking_at([0.3, 0.5, 2.6], [0.0, 0.1, 0.0]));
    s.build().unwrap()
}

pub fn wrong_environment_rotation(scene: &mut Scene) {
    if let Some(environment) = &mut scene.environment {
        environment.rotation += 0.2;
    }
}

/// The same light from everywhere: what is seen has a closed form, but for the split sum.
pub fn furnace() -> Scene {
    let mut scene = environment();
    scene.environment = Some(Environment::uniform([0.5, 0.6, 0.7]));
    scene
}

pub fn wrong_environment_intensity(scene: &mut Scene) {
    if let Some(environment) = &mut scene.environment {
        environment.intensity *= 1.03;
    }
}

/// Holes by alpha mask, one-sided and two-sided, in front of a lit box; one of them mirrored.
pub fn masked() -> Scene {
    let mut s = SceneBuilder::new("masked");
    s.ambient([0.3; 3]).unwrap();
    s.background([0.1, 0.2, 0.4]).unwrap();
    // A blob of alpha in the middle: its outline is a smooth curve.
    let blob = texture(&mut s, Wrap::Clamp, |x, y| {
        let d = (f64::from(x) - 3.5).hypot(f64::from(y) - 3.5) as f32;
        [0.9, 0.7, 0.3, (1.2 - d / 4.0).clamp(0.0, 1.0)]
    });
    let leaf = Material { alpha: AlphaMode::Mask(0.5), ..Material::diffuse("leaf").textured(blob) };
    let both = Material { double_sided: true, ..leaf.clone() };
    let bare = Material { alpha: AlphaMode::Mask(0.5), ..Material::unlit("bare").textured(blob) };
    let [leaf, both, bare] = [leaf, both, bare].map(|m| s.material(m).unwrap());
    let card = |material| primitive(Shape::Card { size: [1.0, 1.0] }, [1, 1], material);
    let turn = turned(DVec3::Y, 0.4);
    add(&mut s, "leaf", card(leaf), 1, Placement::at([-0.9, 0.4, 0.5]).turned(turn));
    // Only the mirrored card's other winding shows; the card turned away is not drawn at all.
    add(&mut s, "mirrored", card(leaf), 2, Placement::at([0.0, 0.4, 0.5]).scaled([-1.0, 1.0, 1.0]));
    add(&mut s, "away", card(leaf), 3, Placement::at([0.9, 0.4, 0.5]).turned(turned(DVec3::Y, PI - 0.3)));
    add(&mut s, "both", card(both), 4, Placement::at([-0.9, -0.6, 0.5]).turned(turned(DVec3::Y, PI + 0.3)));
    add(&mut s, "bare", card(bare), 5, Placement::at([0.2, -0.6, 0.5]));
    let wall = s.material(Material::diffuse("wall").colored([0.2, 0.6, 0.3])).unwrap();
    add(
        &mut s,
        "wall",
        primitive(Shape::Box { size: [2.2, 1.6, 0.5] }, [1, 1], wall),
        6,
        Placement::at([0.3, 0.0, -0.6]),
    );
    s.light(Light::directional("sun", 2.0), Placement::looking_at([1.0, 1.0, 3.0], [0.0; 3])).unwrap();
    camera(&mut s, Placement::at([0.0, 0.0, 3.2]));
    s.build().unwrap()
}

pub fn wrong_cutoff(scene: &mut Scene) {
    for material in &mut scene.materials {
        if let AlphaMode::Mask(cutoff) = &mut material.alpha {
            *cutoff = 0.7;
        }
    }
}

/// A skinned column whose joint bends, stretches and shears, and a ball that swells: lit, the column bumpy.
pub fn deformed() -> Scene {
    let mut s = SceneBuilder::new("deformed");
    s.ambient([0.2; 3]).unwrap();
    s.background([0.1, 0.15, 0.2]).unwrap();
    let (bumpy, clay) =
        (bumpy(&mut s, false), s.material(Material::diffuse("clay").colored([0.7, 0.5, 0.4])).unwrap());
    let root = s.node("root", Placement::at([-0.5, -0.8, 0.0])).unwrap();
    let bend = Path::Spin { start: Trs::default(), axis: DVec3::new(0.3, 0.2, 1.0).normalize(), rate: -9.0 };
    let place = Placement::at([0.0, 0.6, 0.0]).scaled([1.5, 0.8, 0.6]).moving(bend).on(root);
    let tip = s.node("tip", place).unwrap();
    let mut column = magnified(primitive(Shape::Box { size: [0.5, 1.2, 0.5] }, [1, 6], bumpy));
    column.joints = Some(vec![[0, 1, 0, 0]; column.positions.len()]);
    let share = |y: f32| (y / 1.2 + 0.5).clamp(0.0, 1.0);
    let weights = column.positions.iter().map(|[_, y, _]| [1.0 - share(*y), share(*y), 0.0, 0.0]);
    column.joint_weights = Some(weights.collect());
    // Its own pose does not count.
    let node = add(&mut s, "column", column, 1, Placement::at([5.0, 0.0, 0.0]));
    let mut ball = primitive(Shape::Sphere { radius: 0.5 }, [24, 12], clay);
    let swell = |[x, y, z]: [f32; 3]| [0.4 * y * y, 0.5 * x, 0.2 * z];
    let lean = |[x, y, _]: [f32; 3]| [0.5 * y, -0.4 * x, 0.1];
    ball.morph_targets = vec![
        MorphTarget {
            positions: ball.positions.iter().copied().map(swell).collect(),
            normals: ball.normals.iter().copied().map(lean).collect(),
        },
        MorphTarget {
            positions: ball.positions.iter().map(|p| p.map(|v| -0.3 * v)).collect(),
            normals: vec![[0.0; 3]; ball.positions.len()],
        },
    ];
    let ball = add(&mut s, "swelling", ball, 2, Placement::at([0.7, 0.0, 0.2]).scaled([1.0, 1.2, 0.9]));
    s.light(Light::directional("sun", 2.5), Placement::looking_at([2.0, 2.0, 3.0], [0.0; 3])).unwrap();
    camera(&mut s, Placement::at([0.0, 0.0, 3.0]));
    let mut scene = s.build().unwrap();
    let inverse_bind = [-0.6, 0.0].map(|y| DMat4::from_translation(DVec3::new(0.0, -y, 0.0)));
    scene.skins.push(Skin { joints: vec![root, tip], inverse_bind: inverse_bind.to_vec() });
    scene.nodes[node].skin = Some(0);
    scene.nodes[ball].morph = Some(Curve {
        times: vec![0.0, 0.05, 0.1],
        values: vec![0.1, 0.6, 1.0, 0.0, 0.0, 0.2],
        width: 2,
        interpolation: Interpolation::Linear,
    });
    scene.validate().unwrap();
    scene
}

pub fn wrong_morph(scene: &mut Scene) {
    for curve in scene.nodes.iter_mut().filter_map(|n| n.morph.as_mut()) {
        for value in &mut curve.values {
            *value *= 1.1;
        }
    }
}

pub fn wrong_bind(scene: &mut Scene) {
    scene.skins[0].inverse_bind[1].w_axis.x += 0.05;
}

fn shadows(light: Light, from: [f64; 3], moving: bool) -> Scene {
    let mut s = SceneBuilder::new("shadows");
    let paper = s.material(Material::diffuse("paper").colored([0.8; 3])).unwrap();
    let floor = primitive(Shape::Plane { size: [3.0, 3.0] }, [1, 1], paper);
    add(&mut s, "floor", floor, 1, Placement::at([0.0, -0.5, 0.0]));
    let cube = primitive(Shape::Box { size: [0.6, 0.5, 0.6] }, [1, 1], paper);
    let place = Placement::at([0.1, 0.2, 0.0]).turned(turned(DVec3::Y, 0.5));
    let slide = Path::ConstantVelocity { start: Trs::default(), velocity: DVec3::new(-20.0, 0.0, 5.0) };
    add(&mut s, "box", cube, 2, if moving { place.moving(slide) } else { place });
    s.light(light.with_shadow(), Placement::looking_at(from, [0.0, -0.5, 0.0])).unwrap();
    s.duration_s(0.05).unwrap();
    camera(&mut s, Placement::looking_at([0.2, 1.9, 2.1], [0.0, -0.3, 0.0]));
    s.build().unwrap()
}

pub fn sunlight() -> Scene {
    shadows(Light::directional("sun", 3.0), [1.0, 2.0, 0.6], false)
}

/// Low light across the texels' diagonal: where a filter of several texels darkens its own surface first.
pub fn evening() -> Scene {
    shadows(Light::directional("sun", 3.0), [2.0, 0.2, 1.7], false)
}

pub fn moving_spotlight() -> Scene {
    shadows(Light::spot("lamp", 12.0, 25.0, 35.0), [0.9, 2.2, 0.5], true)
}

pub fn wrong_caster(scene: &mut Scene) {
    for position in scene.meshes[1].primitives.iter_mut().flat_map(|p| &mut p.positions) {
        position[0] *= 1.3;
    }
}

/// Plain colours: what `--antialias edges` shows is how much of a pixel each covers.
pub fn plain() -> Scene {
    let mut s = SceneBuilder::new("plain");
    s.background([0.1, 0.3, 0.2]).unwrap();
    for (i, color) in [[0.9, 0.2, 0.1], [0.2, 0.8, 0.9]].into_iter().enumerate() {
        let material = s.material(Material::unlit(format!("plain {i}")).colored(color)).unwrap();
        let card = primitive(Shape::Card { size: [1.3, 0.9] }, [1, 1], material);
        let x = i as f64;
        let place = Placement::at([0.5 * x - 0.3, 0.3 * x, 0.2 * x]).turned(turned(DVec3::Z, 0.3 + x));
        add(&mut s, &format!("card {i}"), card, 1, place);
    }
    camera(&mut s, Placement::at([0.0, 0.0, 2.5]));
    s.build().unwrap()
}

/// `scene` as an orthographic camera at the same place shows it, between two planes.
pub fn orthographic(mut scene: Scene, height: f64, [near, far]: [f64; 2]) -> Scene {
    for camera in &mut scene.cameras {
        camera.lens = Lens::Orthographic { height, far };
        camera.near = near;
    }
    scene
}

/// Both planes cut something: the ball, and what is tilted.
pub fn orthographic_glossy() -> Scene {
    orthographic(glossy(), 2.1, [2.1, 2.65])
}

pub fn orthographic_environment() -> Scene {
    orthographic(environment(), 2.2, [0.1, 8.0])
}

pub fn orthographic_sunlight() -> Scene {
    orthographic(sunlight(), 2.6, [0.1, 12.0])
}

pub fn wrong_planes(scene: &mut Scene) {
    for camera in &mut scene.cameras {
        if let Lens::Orthographic { far, .. } = &mut camera.lens {
            *far += 0.05;
        }
        camera.near -= 0.05;
    }
}

/// A tenth of a pixel beside the point.
pub fn wrong_camera(scene: &mut Scene) {
    for camera in &mut scene.cameras {
        let (w, h) = (f64::from(WIDTH), f64::from(HEIGHT));
        camera.lens = match camera.lens {
            Lens::FieldOfView { fov_y } => {
                let f = h / (2.0 * (fov_y / 2.0).tan());
                Lens::Intrinsics { fx: f, fy: f, cx: w / 2.0 + 0.1, cy: h / 2.0 }
            }
            Lens::Intrinsics { fx, fy, cx, cy } => Lens::Intrinsics { fx, fy, cx: cx + 0.1, cy },
            Lens::Orthographic { height, far } => Lens::Orthographic { height: 1.01 * height, far },
        };
    }
}

/// A floor into the distance, with more texels than pixels.
pub fn minified() -> Scene {
    let mut s = SceneBuilder::new("minified");
    s.background([0.4, 0.5, 0.6]).unwrap();
    let grit = s.procedural("grit", &Procedural::new(Pattern::Noise, 256, 3), Sampling::default()).unwrap();
    let material = s.material(Material::unlit("floor").textured(grit)).unwrap();
    s.shape_with(
        "floor",
        Shape::Plane { size: [20.0, 20.0] },
        material,
        ShapeSettings::default().repeat(4.0, 4.0),
        Placement::at([0.0, -1.0, -6.0]),
    )
    .unwrap();
    camera(&mut s, Placement::at([0.0, 0.3, 1.0]).turned(turned(DVec3::X, -0.3)));
    s.build().unwrap()
}

/// Everything that moves in its own way, before the sky, seen by a camera that moves and turns.
pub fn moving(turn_rate: f64) -> Scene {
    let mut scene = deformed();
    let mut s = SceneBuilder::new("moving");
    let plain = s.material(Material::diffuse("plain").colored([0.5, 0.6, 0.2])).unwrap();
    let cube = primitive(Shape::Box { size: [0.5, 0.4, 0.3] }, [1, 1], plain);
    let spin = Path::Spin { start: Trs::default(), axis: DVec3::new(1.0, 2.0, 0.5).normalize(), rate: 12.0 };
    add(&mut s, "spinning", cube, 7, Placement::at([0.3, 0.8, 0.5]).scaled([1.0, -1.2, 0.9]).moving(spin));
    let pose = Trs { translation: DVec3::new(0.0, 0.1, 3.0), ..Trs::default() };
    camera(
        &mut s,
        Placement::along(Path::Chain(vec![
            Path::ConstantVelocity { start: pose, velocity: DVec3::new(2.0, -1.0, -8.0) },
            Path::Spin {
                start: Trs::default(),
                axis: DVec3::new(0.2, 1.0, 0.4).normalize(),
                rate: turn_rate,
            },
        ])),
    );
    scene.cameras.clear();
    s.include("deformed", scene, Labels::default(), Placement::default()).unwrap();
    s.environment(Environment { intensity: 0.8, ..STUDIO.clone() });
    let scene = s.build().unwrap();
    assert!(scene.materials.iter().any(|m| m.model == ShadingModel::MetallicRoughness));
    scene
}
