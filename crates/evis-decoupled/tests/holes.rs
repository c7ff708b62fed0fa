//! Surfaces with alpha masks, against rays.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use evis_decoupled::scene::holes::Holes;
use evis_decoupled::{Settings, luminance};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{
    AlphaMode, Image, Lens, LightKind, Material, Mesh, Motion, Node, Scene, Skin, Texture, TextureRef, Trs,
    Wrap,
};
use glam::{DMat4, DQuat, DVec3};
use half::f16;

mod common;

use common::{camera, exact, f1, light, noise, off, truth_of};

const SIZE: (u32, u32) = (48, 36);
const TEXELS: u32 = 24;
const WRAPS: [[Wrap; 2]; 3] =
    [[Wrap::Repeat, Wrap::Mirror], [Wrap::Clamp, Wrap::Repeat], [Wrap::Mirror, Wrap::Clamp]];

/// A card with holes that moves and turns before a textured wall, on which a lamp throws its shadow.
fn scene(wraps: [Wrap; 2], uv_scale: f32, cutoff: f32) -> Scene {
    let mut scene = Scene { ambient: [0.15; 3], ..Scene::default() };
    let texel = |i: u32, channel: u32| noise(channel, i % TEXELS, i / TEXELS);
    for (name, holes) in [("leaves", true), ("wall", false)] {
        let value = |i: u32| {
            let [r, g, b] = [0, 1, 2].map(|c| 0.3 + 0.5 * texel(i, c + 4 * u32::from(holes)));
            [r, g, b, if holes { texel(i, 3) } else { 1.0 }].map(f16::from_f32)
        };
        let image = scene.images.len();
        let texels = (0..TEXELS * TEXELS).map(value).collect();
        scene.images.push(Image { name: name.into(), width: TEXELS, height: TEXELS, texels });
        let [wrap_u, wrap_v] = if holes { wraps } else { [Wrap::Repeat; 2] };
        scene.textures.push(Texture { image, wrap_u, wrap_v, nearest: false });
        let transform = if holes {
            [uv_scale, 0.2, -0.37, -0.3, uv_scale.abs(), 0.21]
        } else {
            [2.0, 0.0, 0.1, 0.0, 2.0, 0.2]
        };
        let base_color_texture = Some(TextureRef { texture: image, uv_set: 0, transform });
        let alpha = if holes { AlphaMode::Mask(cutoff) } else { AlphaMode::Opaque };
        scene.materials.push(Material { base_color_texture, alpha, ..Material::diffuse(name) });
    }
    for (material, size) in [(0, [1.6, 1.3]), (1, [6.0, 5.0])] {
        let mut primitive = Shape::Card { size }.build(None, [1.0, 1.0]).unwrap();
        primitive.material = material;
        scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
    }
    let start = Trs { translation: DVec3::new(-0.1, 0.05, -3.0), ..Trs::default() };
    let turned = Trs { rotation: DQuat::from_rotation_x(-0.4), ..Trs::default() };
    let path = Path::Chain(vec![
        Path::ConstantVelocity { start, velocity: DVec3::new(2.5, 1.0, 0.3) },
        Path::Spin { start: turned, axis: DVec3::Y, rate: 4.0 },
    ]);
    scene.add_node(Node { mesh: Some(0), motion: Motion::Path(path.into()), ..Node::default() });
    let wall = Trs { translation: DVec3::new(0.0, 0.0, -4.0), ..Trs::default() }.matrix();
    scene.add_node(Node { mesh: Some(1), motion: Motion::Fixed(wall), ..Node::default() });
    scene.lights.push(light(LightKind::Directional, true, 2.0));
    let turn = Trs { rotation: DQuat::from_euler(glam::EulerRot::YXZ, 0.3, -0.35, 0.0), ..Trs::default() };
    scene.add_node(Node { light: Some(0), motion: Motion::Fixed(turn.matrix()), ..Node::default() });
    let node = scene.add_node(Node::default());
    scene.cameras.push(camera(node, Lens::FieldOfView { fov_y: 0.6 }));
    scene
}

fn without_mask(scene: &Scene) -> Scene {
    let mut opaque = scene.clone();
    opaque.materials[0].alpha = AlphaMode::Opaque;
    opaque
}

#[test]
fn light_through_holes_is_that_of_rays() {
    for (case, wraps) in WRAPS.into_iter().enumerate() {
        // The second one is mirrored.
        let scene = scene(wraps, [0.5, -0.9, 1.3][case], [0.5, 0.35, 0.62][case]);
        let settings = Settings { size: Some(SIZE), ..Settings::default() };
        for t_us in [0.0, 60_000.0] {
            let wanted = exact(&scene, SIZE, t_us);
            let error = off(&luminance(&scene, &settings, t_us).unwrap(), &wanted);
            let canary = off(&luminance(&without_mask(&scene), &settings, t_us).unwrap(), &wanted);
            println!("{wraps:?} at {t_us}: {error:.4} off, {canary:.4} without holes");
            assert!(error < 0.01, "{wraps:?}: {error:.4}");
            assert!(canary > 20.0 * error, "canary: {canary:.4}");
        }
    }
}

/// What ln of its light is off by at some times, with its holes and without them.
fn off_rays(scene: &Scene) -> [f64; 2] {
    let settings = Settings { size: Some(SIZE), ..Settings::default() };
    let errors = [0.0, 60_000.0].map(|t_us| {
        let wanted = exact(scene, SIZE, t_us);
        [scene, &without_mask(scene)].map(|s| off(&luminance(s, &settings, t_us).unwrap(), &wanted))
    });
    [0, 1].map(|k| errors[0][k].max(errors[1][k]))
}

/// Alpha of vertices beside that of a texture, and alone, and on a facet that is one place of the texture.
#[test]
fn alpha_of_vertices_counts() {
    for case in 0..3 {
        let mut scene = scene(WRAPS[case], 0.6, 0.45);
        let primitive = &mut scene.meshes[0].primitives[0];
        let alphas = [[0.2, 1.0, 0.7, 1.0], [0.1, 0.9, 0.3, 0.8], [1.3, 0.3, 0.9, 0.2]][case];
        primitive.colors = Some(alphas.map(|a| [0.9, 0.8, 1.0, a]).to_vec());
        match case {
            1 => scene.materials[0].base_color_texture = None,
            2 => primitive.uvs[0].as_mut().unwrap().fill([0.53, 0.41]),
            _ => {}
        }
        let [error, canary] = off_rays(&scene);
        println!("case {case}: {error:.4} off, {canary:.4} without holes");
        assert!(error < 0.01, "case {case}: {error:.4}");
        assert!(canary > 10.0 * error, "canary: {canary:.4}");
    }
}

#[test]
fn texels_without_interpolation_have_borders() {
    for (case, wraps) in WRAPS.into_iter().enumerate() {
        let mut scene = scene(wraps, [0.5, -0.9, 1.3][case], [0.5, 0.35, 0.62][case]);
        let smooth = scene.clone();
        scene.textures.iter_mut().for_each(|texture| texture.nearest = true);
        let [error, canary] = off_rays(&scene);
        let settings = Settings { size: Some(SIZE), ..Settings::default() };
        let wrong = off(&luminance(&smooth, &settings, 0.0).unwrap(), &exact(&scene, SIZE, 0.0));
        println!("{wraps:?}: {error:.4} off, {canary:.4} without holes, {wrong:.4} with interpolation");
        // Parts of a pixel are read over parallelograms, which matters more at steps.
        assert!(error < 0.015, "{wraps:?}: {error:.4}");
        assert!(canary.min(wrong) > 8.0 * error, "canaries: {canary:.4} {wrong:.4}");
    }
}

/// A card that a skeleton bends, and its holes with it.
fn bent() -> Scene {
    let mut scene = scene(WRAPS[0], 0.6, 0.5);
    let mut card = Shape::Card { size: [1.6, 1.3] }.build(Some([4, 3]), [1.0, 1.0]).unwrap();
    let share = |x: f32| (x / 1.6 + 0.5).clamp(0.0, 1.0);
    card.joints = Some(vec![[0, 1, 0, 0]; card.positions.len()]);
    card.joint_weights =
        Some(card.positions.iter().map(|p| [1.0 - share(p[0]), share(p[0]), 0.0, 0.0]).collect());
    scene.meshes[0].primitives[0] = card;
    let place = |x: f64| Trs { translation: DVec3::new(x, 0.0, -3.0), ..Trs::default() };
    let spin = Path::Spin { start: place(0.1), axis: DVec3::new(0.2, 1.0, 0.3).normalize(), rate: -9.0 };
    let slide = Path::ConstantVelocity { start: place(-0.2), velocity: DVec3::new(1.0, -1.5, 0.4) };
    let joints = [slide, spin]
        .map(|path| scene.add_node(Node { motion: Motion::Path(path.into()), ..Node::default() }));
    scene.skins.push(Skin { joints: joints.to_vec(), inverse_bind: vec![DMat4::IDENTITY; 2] });
    let node = scene.nodes.iter_mut().find(|node| node.mesh == Some(0)).unwrap();
    // Its own pose does not count.
    (node.skin, node.motion) = (Some(0), Motion::Fixed(DMat4::from_translation(DVec3::splat(9.0))));
    scene
}

#[test]
fn holes_follow_a_skeleton() {
    let scene = bent();
    let [error, canary] = off_rays(&scene);
    let (asked, truth) = truth_of(&scene, (96, 72), 40_000, 300);
    let (found, count) = f1(&scene, &asked, &truth);
    println!("{error:.4} off, {canary:.4} without holes; F1 {found:.4} of {count} events");
    assert!(error < 0.01, "{error:.4}");
    assert!(canary > 10.0 * error, "canary: {canary:.4}");
    assert!(found > 0.95 && count > 1000, "{found:.4} of {count}");
}

#[test]
fn what_has_holes_fires_as_rays_say() {
    let scene = scene(WRAPS[0], 0.6, 0.5);
    let (asked, truth) = truth_of(&scene, (96, 72), 60_000, 400);
    let (found, count) = f1(&scene, &asked, &truth);
    let (canary, _) = f1(&without_mask(&scene), &asked, &truth);
    println!("F1 {found:.4} of {count} events, {canary:.4} without holes");
    assert!(found > 0.95 && count > 1000, "{found:.4} of {count}");
    assert!(canary < 0.7, "canary: {canary:.4}");
}

#[test]
fn what_is_whole_stays_and_what_is_transparent_goes() {
    let triangles = |scene: &Scene| Holes::of(scene, None).unwrap().primitive(scene, 0, 0).indices.len() / 3;
    let filled = |alpha: f32| {
        let mut scene = scene(WRAPS[1], 0.6, 0.5);
        scene.images[0].texels.iter_mut().for_each(|texel| texel[3] = f16::from_f32(alpha));
        scene
    };
    let whole = scene(WRAPS[1], 0.6, 0.0);
    let card = whole.meshes[0].primitives[0].indices.len() / 3;
    assert_eq!((triangles(&whole), triangles(&filled(1.0))), (card, card));
    assert_eq!([0.2, f32::NAN, f32::NEG_INFINITY].map(|alpha| triangles(&filled(alpha))), [0; 3]);
    // A factor that leaves nothing, and coordinates that lead nowhere.
    let mut clear = scene(WRAPS[1], 0.6, 0.5);
    clear.materials[0].base_color[3] = 0.0;
    let mut lost = scene(WRAPS[1], 0.6, 0.5);
    lost.meshes[0].primitives[0].uvs[0].as_mut().unwrap()[0] = [f32::NAN, f32::INFINITY];
    assert_eq!(triangles(&clear), 0);
    assert!(triangles(&lost) < triangles(&scene(WRAPS[1], 0.6, 0.5)));
    // All of a card in one place of the texture is there, or is not.
    for (place, there) in [([0.02, 0.02], None), ([0.5, 0.5], Some(card))] {
        let mut flat = filled(if there.is_some() { 0.9 } else { 0.1 });
        flat.meshes[0].primitives[0].uvs[0].as_mut().unwrap().fill(place);
        assert_eq!(triangles(&flat), there.unwrap_or(0));
    }
}

/// However small a facet is on the texture.
#[test]
fn facets_of_less_than_a_texel_have_their_holes() {
    let mut fine = scene(WRAPS[0], 1.0, 0.5);
    let cells = 96_u32;
    let place = |k: u32| [k % (cells + 1), k / (cells + 1)].map(|v| v as f32 / cells as f32);
    let corners = (cells + 1) * (cells + 1);
    let at = |k: u32| k / cells * (cells + 1) + k % cells;
    let quads = (0..cells * cells).map(at);
    let primitive = &mut fine.meshes[0].primitives[0];
    primitive.positions =
        (0..corners).map(|k| place(k).map(|v| 1.6 * v - 0.8)).map(|[x, y]| [x, -y, 0.0]).collect();
    primitive.normals = vec![[0.0, 0.0, 1.0]; corners as usize];
    primitive.tangents = None;
    primitive.uvs = [Some((0..corners).map(|k| place(k).map(|v| 0.2 * v)).collect()), None];
    primitive.indices =
        quads.flat_map(|a| [a, a + cells + 1, a + 1, a + 1, a + cells + 1, a + cells + 2]).collect();
    // The first eighth of the texture is transparent.
    for (k, texel) in fine.images[0].texels.iter_mut().enumerate() {
        texel[3] = f16::from_f32(if k as u32 % TEXELS < TEXELS / 8 { 0.0 } else { 1.0 });
    }
    fine.materials[0].base_color_texture.as_mut().unwrap().transform = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let holes = Holes::of(&fine, None).unwrap();
    let cut = holes.primitive(&fine, 0, 0);
    let area: f32 = (cut.indices.as_chunks::<3>().0.iter())
        .map(|t| {
            let [a, b, c] = t.map(|k| glam::Vec3::from_array(cut.positions[k as usize]));
            0.5 * (b - a).cross(c - a).length()
        })
        .sum();
    // The border lies at 3 texels of the card's 4.8.
    let expected = 1.6 * 1.6 * (1.0 - 3.0 / 4.8);
    assert!((area - expected).abs() < 0.01 * expected, "{area} for {expected}");
}

/// A fence of which the texture repeats a million times has more pieces than fit.
#[test]
fn holes_beyond_number_are_refused() {
    let scene = scene(WRAPS[0], 1e4, 0.5);
    let error = Holes::of(&scene, None).unwrap_err().to_string();
    assert!(error.contains("leaves") && error.contains("holes"), "{error}");
    assert!(evis_decoupled::unsupported(&scene).is_some());
}
