//! Light of surfaces with normal, roughness, occlusion and emission maps, against rays.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use evis_decoupled::{Settings, luminance};
use evis_scene::environment::Environment;
use evis_scene::motion::{Path, WaveShape, Waveform};
use evis_scene::primitive::Shape;
use evis_scene::{
    Image, Lens, LightKind, Material, Mesh, Motion, Node, Scene, ShadingModel, Texture, TextureRef, Trs, Wrap,
};
use glam::{DQuat, DVec3};
use half::f16;

mod common;

use common::{camera, exact, f1, light, noise, off, truth_of};

const SIZE: (u32, u32) = (32, 24);
const TEXELS: u32 = 48;

/// A ball and a card, mapped all over, that turn and move under a lamp with a shadow, a second lamp and a studio.
fn scene(model: ShadingModel, waveform: Option<Waveform>) -> Scene {
    let mut scene = Scene {
        ambient: [0.02; 3],
        environment: Some(Environment { intensity: 0.6, rotation: 0.4, ..Environment::studio() }),
        ..Scene::default()
    };
    let mut texture = |channel: u32, value: &dyn Fn(u32, u32) -> [f32; 4]| {
        let at = |i: u32| value(i % TEXELS, i / TEXELS).map(f16::from_f32);
        let texels = (0..TEXELS * TEXELS).map(at).collect();
        let image = scene.images.len();
        scene.images.push(Image { name: format!("map {channel}"), width: TEXELS, height: TEXELS, texels });
        let (wrap_u, wrap_v) = (Wrap::Repeat, Wrap::Mirror);
        scene.textures.push(Texture { image, wrap_u, wrap_v, nearest: false });
        let transform = [1.0, 0.1 * channel as f32, 0.3, -0.1, 1.2, 0.7];
        Some(TextureRef { texture: image, uv_set: 0, transform })
    };
    let of = |channel: u32, low: f32, high: f32| {
        move |x: u32, y: u32| [0, 1, 2, 3].map(|c| low + (high - low) * noise(4 * channel + c, x, y))
    };
    let base_color_texture = texture(0, &of(0, 0.2, 0.9));
    let normal_texture = texture(1, &|x, y| {
        let [a, b] = [0, 1].map(|c| 0.5 + 0.25 * (noise(9 + c, x, y) - 0.5));
        [a, b, 0.97, 1.0]
    });
    let metallic_roughness_texture = texture(2, &of(2, 0.4, 1.0));
    let occlusion_texture = texture(3, &of(3, 0.3, 1.0));
    let emissive_texture = texture(4, &of(4, 0.0, 1.0));
    scene.materials.push(Material {
        model,
        base_color: [0.9, 0.8, 0.7, 1.0],
        base_color_texture,
        metallic: 0.7,
        roughness: 0.9,
        normal_texture,
        normal_scale: 0.8,
        metallic_roughness_texture,
        occlusion_texture,
        occlusion_strength: 0.8,
        emissive: [0.1, 0.05, 0.02],
        emissive_texture,
        emission_waveform: waveform,
        ..Material::default()
    });
    for shape in [Shape::Card { size: [2.4, 2.0] }, Shape::Sphere { radius: 0.5 }] {
        let primitive = shape.build(None, [1.0, 1.0]).unwrap();
        assert!(primitive.tangents.is_some());
        scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
    }
    let mut moving = |mesh: usize, place: DVec3, rate: f64| {
        let start = Trs { translation: place, ..Trs::default() };
        let turned = Trs { rotation: DQuat::from_rotation_x(-0.5), ..Trs::default() };
        let path = Path::Chain(vec![
            Path::ConstantVelocity { start, velocity: DVec3::new(0.4, 0.1, 0.0) },
            Path::Spin { start: turned, axis: DVec3::Y, rate },
        ]);
        scene.add_node(Node { mesh: Some(mesh), motion: Motion::Path(path.into()), ..Node::default() });
    };
    moving(0, DVec3::new(0.0, -0.1, -3.0), 0.6);
    moving(1, DVec3::new(-0.2, 0.2, -1.9), 2.0);
    for (kind, casts_shadow, place, intensity) in [
        (LightKind::Directional, true, DVec3::ZERO, 2.0),
        (LightKind::Point, false, DVec3::new(1.0, 1.0, -1.0), 1.5),
    ] {
        let number = Some(scene.lights.len());
        scene.lights.push(light(kind, casts_shadow, intensity));
        let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.6, -0.7, 0.0);
        let pose = Trs { translation: place, rotation: turn, ..Trs::default() }.matrix();
        scene.add_node(Node { light: number, motion: Motion::Fixed(pose), ..Node::default() });
    }
    let node = scene.add_node(Node::default());
    scene.cameras.push(camera(node, Lens::FieldOfView { fov_y: 0.7 }));
    scene
}

#[test]
fn light_of_mapped_surfaces_is_that_of_rays() {
    let sine = Waveform { shape: WaveShape::Sine, frequency_hz: 30.0, phase: 0.1, low: 0.2, high: 1.0 };
    for (model, waveform) in [
        (ShadingModel::MetallicRoughness, None),
        (ShadingModel::MetallicRoughness, Some(sine)),
        (ShadingModel::Diffuse, None),
    ] {
        let scene = scene(model, waveform);
        let settings = Settings { size: Some(SIZE), ..Settings::default() };
        for part in [0.0, 0.5] {
            let t_us = 32_768.0 * (1.0 + part);
            let wanted = exact(&scene, SIZE, t_us);
            let found = luminance(&scene, &settings, t_us).unwrap();
            let error = off(&found, &wanted);
            let mut plain = scene.clone();
            let material = &mut plain.materials[0];
            (material.normal_texture, material.metallic_roughness_texture) = (None, None);
            let canary = off(&luminance(&plain, &settings, t_us).unwrap(), &wanted);
            println!("{model:?} at {part}: {error:.4} off, {canary:.4} without two maps");
            assert!(error < 0.02, "{model:?} at {part}: {error:.4}");
            assert!(canary > 3.0 * error, "canary: {canary:.4}");
        }
    }
}

/// Eight lamps whose shadows count, with maps and without, beside a glow that changes.
#[test]
fn eight_lamps_throw_shadows() {
    let sine = Waveform { shape: WaveShape::Sine, frequency_hz: 30.0, phase: 0.1, low: 0.2, high: 1.0 };
    for mapped in [true, false] {
        let mut scene = scene(ShadingModel::MetallicRoughness, Some(sine));
        if !mapped {
            let plain = Material { emissive: scene.materials[0].emissive, ..Material::diffuse("plain") };
            scene.materials[0] = Material { emission_waveform: Some(sine), ..plain };
        }
        scene.lights.clear();
        scene.nodes.iter_mut().for_each(|node| node.light = None);
        for k in 0..8 {
            let turn = 0.25 * std::f64::consts::PI * f64::from(k);
            let (yaw, pitch) = (0.6 * turn.cos(), 0.5 * turn.sin());
            let pose = DQuat::from_euler(glam::EulerRot::YXZ, yaw, pitch, 0.0);
            let motion = Motion::Fixed(Trs { rotation: pose, ..Trs::default() }.matrix());
            scene.lights.push(light(LightKind::Directional, true, 0.3 + 0.1 * k as f32));
            scene.add_node(Node { light: Some(k as usize), motion, ..Node::default() });
        }
        assert_eq!(evis_decoupled::unsupported(&scene), None);
        let settings = Settings { size: Some(SIZE), ..Settings::default() };
        let wanted = exact(&scene, SIZE, 40_000.0);
        let error = off(&luminance(&scene, &settings, 40_000.0).unwrap(), &wanted);
        let mut without = scene.clone();
        without.lights[4..].iter_mut().for_each(|light| light.casts_shadow = false);
        let canary = off(&luminance(&without, &settings, 40_000.0).unwrap(), &wanted);
        let (asked, truth) = truth_of(&scene, (64, 48), 30_000, 150);
        let (found, count) = f1(&scene, &asked, &truth);
        println!("mapped {mapped}: {error:.4} off, {canary:.4} with four; F1 {found:.4} of {count} events");
        assert!(error < 0.02 && canary > 1.5 * error, "mapped {mapped}: {error:.4} {canary:.4}");
        assert!(found > 0.9 && count > 150, "{found:.4} of {count}");
    }
}

/// Light is found at few places of a pixel, but not what a fine texture is there.
#[test]
fn fine_base_colour_is_not_that_of_few_places() {
    let mut scene = scene(ShadingModel::Diffuse, None);
    let size = 8 * TEXELS;
    let texel = |i: u32| {
        let value = noise(0, i % size, i / size);
        [0.05 + 0.9 * value, 0.1 + 0.8 * value, 0.3, 1.0].map(f16::from_f32)
    };
    let texels = (0..size * size).map(texel).collect();
    scene.images[0] = Image { name: "fine".into(), width: size, height: size, texels };
    let settings = Settings { size: Some(SIZE), ..Settings::default() };
    let error = off(&luminance(&scene, &settings, 49_152.0).unwrap(), &exact(&scene, SIZE, 49_152.0));
    println!("{error:.4} off");
    assert!(error < 0.014, "{error:.4}");
}

/// While things move, light is read from pictures of it.
#[test]
fn mapped_surfaces_fire_as_rays_say() {
    let scene = scene(ShadingModel::MetallicRoughness, None);
    let (asked, truth) = truth_of(&scene, (64, 48), 60_000, 250);
    let (found, count) = f1(&scene, &asked, &truth);
    let mut plain = scene.clone();
    (plain.materials[0].normal_texture, plain.materials[0].occlusion_texture) = (None, None);
    let (canary, _) = f1(&plain, &asked, &truth);
    println!("F1 {found:.4} of {count} events, {canary:.4} without two maps");
    assert!(found > 0.92 && count > 1000, "{found:.4} of {count}");
    assert!(canary < found - 0.1, "canary: {canary:.4}");
}
