//! The reference for the raster passes, itself held against closed forms.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use evis_scene::environment::Environment;
use evis_scene::{
    AlphaMode, Image, Light, LightKind, Material, Mesh, MorphTarget, Node, PixelLens, Primitive, Rays, Scene,
    SceneState, ShadingModel, Skin, Texture, TextureRef, Wrap,
};
use evis_truth::rays::Textures;
use evis_truth::rays::geometry::Geometry;
use evis_truth::rays::{Options, Pinhole, RayCaster, TextureFilter};
use glam::{DMat4, DQuat, DVec3};
use half::f16;

const CENTER: [[f64; 2]; 1] = [[0.0, 0.0]];

/// A card in the plane z = 0, facing +Z, from (-x, -y) to (x, y); u right, v down.
fn card(x: f32, y: f32) -> Primitive {
    Primitive {
        positions: vec![[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]],
        normals: vec![[0.0, 0.0, 1.0]; 4],
        tangents: Some(vec![[1.0, 0.0, 0.0, 1.0]; 4]),
        uvs: [Some(vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]), None],
        indices: vec![0, 1, 2, 0, 2, 3],
        ..Primitive::default()
    }
}

fn unlit(color: [f32; 4]) -> Material {
    Material { model: ShadingModel::Unlit, base_color: color, ..Material::default() }
}

/// One node per mesh, mesh i with material i where it exists.
fn scene(primitives: Vec<Primitive>, materials: Vec<Material>) -> Scene {
    let mut scene = Scene { materials, ..Scene::default() };
    for (i, mut primitive) in primitives.into_iter().enumerate() {
        primitive.material = i.min(scene.materials.len() - 1);
        scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
        let (mesh, id) = (Some(i), i as u32 + 1);
        scene.add_node(Node { mesh, instance_id: id, semantic_id: 10 * id, ..Node::default() });
    }
    scene
}

fn still(scene: &Scene) -> SceneState {
    SceneState {
        world_from_node: vec![DMat4::IDENTITY; scene.nodes.len()],
        morph_weights: vec![Vec::new(); scene.nodes.len()],
        light_factor: vec![1.0; scene.lights.len()],
        emission_factor: vec![1.0; scene.materials.len()],
        ..SceneState::default()
    }
}

/// At (0, 0, 2), looking along -Z; a metre at the origin is 50 pixels.
fn camera() -> Pinhole {
    Pinhole {
        world_from_camera: DMat4::from_translation(DVec3::new(0.0, 0.0, 2.0)),
        lens: PixelLens {
            focal: [100.0, 100.0],
            center: [16.0, 12.0],
            width: 32,
            height: 24,
            near: 0.01,
            rays: Rays::Central,
        },
    }
}

/// [`camera`] with another lens.
fn with_lens(lens: PixelLens) -> Pinhole {
    Pinhole { lens, ..camera() }
}

fn light(scene: &mut Scene, state: &mut SceneState, light: Light, pose: DMat4) {
    scene.lights.push(light);
    let light = Some(scene.lights.len() - 1);
    scene.add_node(Node { light, ..Node::default() });
    state.world_from_node.push(pose);
    state.morph_weights.push(Vec::new());
    state.light_factor.push(1.0);
}

fn lamp(kind: LightKind, intensity: f32) -> Light {
    Light::new("", kind, intensity).colored([1.0, 0.5, 0.25])
}

/// Radiance at the image point that sees the world's origin.
fn at_center(scene: &Scene, state: &SceneState) -> DVec3 {
    at_pixel(scene, state, &camera(), [16.0, 12.0], Options::default())
}

fn at_pixel(scene: &Scene, state: &SceneState, camera: &Pinhole, pixel: [f64; 2], options: Options) -> DVec3 {
    let textures = Textures::new(scene);
    RayCaster::new(scene, state, &textures, options).radiance_at(camera, pixel)
}

#[track_caller]
fn near(a: DVec3, b: DVec3, tolerance: f64) {
    assert!((a - b).abs().max_element() <= tolerance, "{a} is not {b}");
}

#[test]
fn a_pixel_holds_the_mean_of_what_it_covers_in_linear_light() {
    // The card's right edge lies at x = 0.13 m: pixel 16 + 6.5, in the middle of column 22.
    let mut scene = scene(vec![card(0.13, 0.2)], vec![unlit([4.0, 2.0, 1.0, 1.0])]);
    scene.background = [0.5, 0.5, 0.5];
    let state = still(&scene);
    let textures = Textures::new(&scene);
    let raster = RayCaster::new(&scene, &state, &textures, Options::default());
    let n = 16;
    let offsets: Vec<[f64; 2]> = (0..n * n)
        .map(|i| [(i % n, n), (i / n, n)].map(|(k, n)| (f64::from(k) + 0.5) / f64::from(n) - 0.5))
        .collect();
    let picture = raster.color(&camera(), &offsets);
    let at = |x: usize, y: usize| picture[y * 32 + x];
    near(at(16, 12), DVec3::new(4.0, 2.0, 1.0), 1e-12);
    near(at(22, 12), DVec3::new(2.25, 1.25, 0.75), 1e-12);
    near(at(23, 12), DVec3::splat(0.5), 1e-12);
    let luminance = raster.luminance(&camera(), &offsets)[12 * 32 + 22];
    assert!((luminance - (0.2126 * 2.25 + 0.7152 * 1.25 + 0.0722 * 0.75)).abs() < 1e-12);
    // Canary: one sample at the centre cannot know of the edge.
    let plain = raster.color(&camera(), &CENTER)[12 * 32 + 22];
    assert!((plain - at(22, 12)).length() > 1.0);
}

#[test]
fn labels_agree_with_a_tilted_plane() {
    let scene = scene(vec![card(5.0, 5.0), card(0.1, 0.1)], vec![unlit([1.0; 4])]);
    let mut state = still(&scene);
    let tilt = DQuat::from_rotation_y(0.5);
    state.world_from_node[0] = DMat4::from_rotation_translation(tilt, DVec3::new(0.0, 0.0, -1.0));
    let textures = Textures::new(&scene);
    let raster = RayCaster::new(&scene, &state, &textures, Options::default());
    let camera = camera();
    let labels = raster.labels(&camera);
    let normal = tilt * DVec3::Z;
    let mut cards = 0;
    for i in 0..32 * 24 {
        let direction = camera.ray([(i % 32) as f64 + 0.5, (i / 32) as f64 + 0.5]).direction;
        let plane =
            (DVec3::new(0.0, 0.0, -1.0) - DVec3::new(0.0, 0.0, 2.0)).dot(normal) / direction.dot(normal);
        if labels.instance[i] == 2 {
            cards += 1;
            assert_eq!((labels.depth[i], labels.semantic[i]), (2.0, 20));
            near(labels.normal[i], DVec3::Z, 1e-12);
        } else {
            assert_eq!((labels.instance[i], labels.semantic[i]), (1, 10));
            assert!((labels.depth[i] - plane).abs() < 1e-9, "{} {plane}", labels.depth[i]);
            near(labels.normal[i], normal, 1e-12);
        }
    }
    assert_eq!(cards, 100, "0.2 m are 10 pixels");
    // A near plane behind the card shows what lies behind it; one behind everything shows nothing.
    for (near, instance, depth) in [(2.5, 1, true), (50.0, 0, false)] {
        let labels = raster.labels(&Pinhole { lens: PixelLens { near, ..camera.lens }, ..camera });
        assert_eq!(labels.instance[12 * 32 + 16], instance);
        assert_eq!(labels.depth[12 * 32 + 16].is_finite(), depth);
    }
}

#[test]
fn the_tree_finds_what_every_triangle_finds() {
    let mut primitive = Primitive::default();
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f32 / (1 << 24) as f32 - 0.5
    };
    for i in 0..600 {
        let center = [random(), random(), random()];
        for _ in 0..3 {
            primitive.positions.push(center.map(|c| c + 0.3 * random()));
            primitive.normals.push([0.0, 0.0, 1.0]);
        }
        primitive.indices.extend([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    // Corners that are no numbers and indices out of range harm nobody.
    primitive.positions[5] = [f32::NAN; 3];
    primitive.indices.extend([0, 1, 999_999]);
    let scene = scene(vec![primitive], vec![unlit([1.0; 4])]);
    let geometry = Geometry::new(&scene, &still(&scene));
    // Everything against every ray: Cramer's rule instead of the tree's own test.
    let meets = |t: usize, origin: DVec3, direction: DVec3| {
        let [a, b, c] = geometry.corners(t).map(|v| v.position);
        let solved = glam::DMat3::from_cols(b - a, c - a, -direction).inverse() * (origin - a);
        (solved.x >= 0.0 && solved.y >= 0.0 && solved.x + solved.y <= 1.0 && solved.z >= 0.0)
            .then_some(solved.z)
    };
    let mut hits = 0;
    for i in 0..400 {
        let origin = DVec3::new(0.02 * f64::from(i % 20) - 0.2, 0.02 * f64::from(i / 20) - 0.2, 3.0);
        let direction = [DVec3::NEG_Z, DVec3::new(0.05, -0.02, -1.0)][i as usize % 2];
        let found = geometry.nearest(origin, direction, 0.0, f64::INFINITY, |_| true);
        let truth = (0..geometry.matter().triangle_count())
            .filter_map(|t| Some((t, meets(t, origin, direction)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        assert_eq!(found.map(|h| h.triangle), truth.map(|t| t.0));
        let far = truth.map_or(9.0, |t| t.1 - 1e-9);
        assert!(!geometry.any(origin, direction, 0.0, far, |_| true), "nothing lies before the nearest");
        assert_eq!(geometry.any(origin, direction, 0.0, far + 2e-9, |_| true), found.is_some());
        hits += usize::from(found.is_some());
    }
    assert!((100..400).contains(&hits), "{hits}");
}

#[test]
fn back_faces_are_culled_and_mirrors_keep_their_outside() {
    let mut materials = [unlit([1.0; 4])];
    let turned = DMat4::from_rotation_y(PI);
    let mirror = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let sees = |material: &Material, pose: DMat4| {
        let mut scene = scene(vec![card(1.0, 1.0)], vec![material.clone()]);
        scene.background = [0.0; 3];
        let mut state = still(&scene);
        state.world_from_node[0] = pose;
        at_center(&scene, &state).x > 0.5
    };
    assert!(sees(&materials[0], DMat4::IDENTITY));
    assert!(!sees(&materials[0], turned));
    assert!(sees(&materials[0], mirror));
    assert!(!sees(&materials[0], turned * mirror));
    materials[0].double_sided = true;
    assert!(sees(&materials[0], turned) && sees(&materials[0], turned * mirror));

    // A double-sided back is lit, and labelled, with the turned normal.
    let mut lit = scene(
        vec![card(1.0, 1.0)],
        vec![Material { model: ShadingModel::Diffuse, double_sided: true, ..Material::default() }],
    );
    let mut state = still(&lit);
    light(&mut lit, &mut state, lamp(LightKind::Directional, PI as f32), DMat4::IDENTITY);
    for pose in [DMat4::IDENTITY, turned, mirror] {
        state.world_from_node[0] = pose;
        near(at_center(&lit, &state), DVec3::new(1.0, 0.5, 0.25), 1e-7);
        let textures = Textures::new(&lit);
        let labels = RayCaster::new(&lit, &state, &textures, Options::default()).labels(&camera());
        near(labels.normal[12 * 32 + 16], DVec3::Z, 1e-12);
    }
}

#[test]
fn masked_surfaces_have_holes() {
    let texels = [0.2, 0.8].map(|a| [f16::ONE, f16::ONE, f16::ONE, f16::from_f32(a)]).to_vec();
    let mut scene = scene(
        vec![card(0.2, 0.2)],
        vec![Material {
            alpha: AlphaMode::Mask(0.5),
            base_color_texture: Some(TextureRef::new(0)),
            ..unlit([1.0, 1.0, 1.0, 1.0])
        }],
    );
    scene.background = [0.0; 3];
    scene.images.push(Image { name: String::new(), width: 2, height: 1, texels });
    scene.textures.push(Texture { image: 0, wrap_u: Wrap::Clamp, wrap_v: Wrap::Clamp, nearest: false });
    let state = still(&scene);
    let base = Options { filter: TextureFilter::BaseLevel, shadows: false, ..Options::default() };
    let at = |x: f64| at_pixel(&scene, &state, &camera(), [x, 12.0], base).x;
    // Alpha is bilinear between 0.2 and 0.8 and passes 0.5 in the middle of the card.
    assert_eq!([at(7.0), at(15.9), at(16.1), at(25.0), at(27.0)], [0.0, 0.0, 1.0, 1.0, 0.0]);
}

#[test]
fn punctual_lights_follow_their_laws() {
    let mut scene = scene(
        vec![card(5.0, 5.0)],
        vec![Material {
            model: ShadingModel::Diffuse,
            base_color: [0.5, 1.0, 1.0, 1.0],
            ..Material::default()
        }],
    );
    scene.ambient = [0.1, 0.2, 0.3];
    let state = still(&scene);
    let lit = |l: Light, pose: DMat4| {
        let (mut scene, mut state) = (scene.clone(), state.clone());
        light(&mut scene, &mut state, l, pose);
        at_center(&scene, &state) - DVec3::new(0.05, 0.2, 0.3)
    };
    // Base colour times light colour.
    let white = DVec3::new(0.5, 0.5, 0.25);

    // 30 degrees off the normal, 10 lux: cos 30 * 10 / pi.
    let slanted = lit(lamp(LightKind::Directional, 10.0), DMat4::from_rotation_x(PI / 6.0));
    near(slanted, white * 10.0 * (PI / 6.0).cos() / PI, 1e-6);
    // A scaled node shines no brighter.
    let scaled = DMat4::from_rotation_x(PI / 6.0) * DMat4::from_scale(DVec3::splat(3.0));
    near(lit(lamp(LightKind::Directional, 10.0), scaled), slanted, 1e-12);
    // From behind: nothing.
    near(lit(lamp(LightKind::Directional, 10.0), DMat4::from_rotation_x(PI)), DVec3::ZERO, 1e-7);

    // 7 candela at (0, 3, 4): distance 5, cosine 0.8.
    let place = DMat4::from_translation(DVec3::new(0.0, 3.0, 4.0));
    let point = white * 7.0 * 0.8 / 25.0 / PI;
    near(lit(lamp(LightKind::Point, 7.0), place), point, 1e-6);
    let ranged = |range: f32| lit(Light { range: Some(range), ..lamp(LightKind::Point, 7.0) }, place);
    near(ranged(10.0), point * (1.0 - 0.5_f64.powi(4)), 1e-6);
    near(ranged(4.9), DVec3::ZERO, 1e-7);

    // A spot at (0, 0, 4), turned so that the origin lies at a given angle from its axis.
    let spot = |angle: f64| {
        let kind = LightKind::Spot { inner: 0.2, outer: 0.6 };
        let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, 4.0)) * DMat4::from_rotation_y(angle);
        lit(lamp(kind, 7.0), pose).x / (0.5 * 7.0 / 16.0 / PI)
    };
    let (inner, outer) = (0.2_f64.cos(), 0.6_f64.cos());
    for angle in [0.0, 0.19, 0.21, 0.4, 0.59, 0.61, 2.0] {
        let linear = ((f64::cos(angle) - outer) / (inner - outer)).clamp(0.0, 1.0);
        assert!((spot(angle) - linear * linear).abs() < 1e-6, "{angle}: {}", spot(angle));
    }

    // The waveform's factor.
    let (mut dimmed, mut half) = (scene.clone(), state.clone());
    light(&mut dimmed, &mut half, lamp(LightKind::Point, 7.0), place);
    half.light_factor[0] = 0.5;
    near(at_center(&dimmed, &half) - DVec3::new(0.05, 0.2, 0.3), point * 0.5, 1e-6);
}

#[test]
fn shadows_are_sharp_and_only_where_asked_for() {
    // A blocker floats 0.5 m above the floor card; light falls at 45 degrees from the right.
    let floor = Material { model: ShadingModel::Diffuse, ..Material::default() };
    let mut scene = scene(vec![card(5.0, 5.0), card(0.05, 5.0)], vec![floor]);
    let mut state = still(&scene);
    state.world_from_node[1] = DMat4::from_translation(DVec3::new(0.6, 0.0, 0.5));
    let sun = Light { casts_shadow: true, ..lamp(LightKind::Directional, 1.0) };
    light(&mut scene, &mut state, sun, DMat4::from_rotation_y(FRAC_PI_4));
    let at = |x: f64, shadows: bool| {
        let options = Options { shadows, ..Options::default() };
        at_pixel(&scene, &state, &camera(), [16.0 + 50.0 * x, 12.0], options).x
    };
    let bright = FRAC_PI_4.cos() / PI;
    // The shadow lies at x = 0.1, 0.05 to each side.
    for (x, expected) in [(0.04, bright), (0.06, 0.0), (0.14, 0.0), (0.16, bright)] {
        assert!((at(x, true) - expected).abs() < 1e-6, "{x}: {}", at(x, true));
        assert!((at(x, false) - bright).abs() < 1e-6);
    }
}

#[test]
fn metallic_roughness_equals_its_formula_at_normal_incidence() {
    // With light, eye and normal in line: D = 1 / (pi alpha^2), G = 1, F = F0.
    for (metallic, roughness) in [(0.0_f64, 0.5_f64), (1.0, 0.5), (0.3, 0.8), (0.0, 1.0), (1.0, 0.0)] {
        let base = DVec3::new(0.9, 0.5, 0.1);
        let mut scene = scene(
            vec![card(1.0, 1.0)],
            vec![Material {
                base_color: [0.9, 0.5, 0.1, 1.0],
                metallic: metallic as f32,
                roughness: roughness as f32,
                emissive: [0.0, 0.0, 2.0],
                ..Material::default()
            }],
        );
        let mut state = still(&scene);
        let sun = Light { color: [1.0; 3], ..lamp(LightKind::Directional, 3.0) };
        light(&mut scene, &mut state, sun, DMat4::IDENTITY);
        state.emission_factor[0] = 0.25;
        let f0 = DVec3::splat(0.04).lerp(base, metallic);
        let alpha = (roughness * roughness).max(0.002);
        let diffuse = (1.0 - f0) * base * (1.0 - metallic) / PI;
        let expected = (diffuse + f0 / (4.0 * PI * alpha * alpha)) * 3.0 + DVec3::new(0.0, 0.0, 0.5);
        let found = at_center(&scene, &state);
        assert!(
            ((found - expected) / expected).abs().max_element() < 1e-5,
            "{metallic} {roughness}: {found}"
        );
    }
}

#[test]
fn a_grazing_highlight_equals_the_formula_in_angles() {
    // Light at 60 degrees to one side, eye at 0: h at 30 degrees.
    let mut scene = scene(
        vec![card(1.0, 1.0)],
        vec![Material {
            base_color: [0.8, 0.8, 0.8, 1.0],
            metallic: 1.0,
            roughness: 0.6,
            ..Material::default()
        }],
    );
    let mut state = still(&scene);
    let sun = Light { color: [1.0; 3], ..lamp(LightKind::Directional, 1.0) };
    light(&mut scene, &mut state, sun, DMat4::from_rotation_y(PI / 3.0));
    let alpha2 = 0.6_f64.powi(4);
    let (cos_h, cos_l) = (0.75_f64.sqrt(), 0.5_f64);
    let d = alpha2 / (PI * (0.75 * (alpha2 - 1.0) + 1.0).powi(2));
    // Smith's height-correlated G, from Lambda of each direction; Lambda of the normal itself is 0.
    let tan2 = 1.0 / (cos_l * cos_l) - 1.0;
    let lambda = 0.5 * ((1.0 + alpha2 * tan2).sqrt() - 1.0);
    let f = 0.8 + 0.2 * (1.0 - cos_h).powi(5);
    let expected = d * f / (1.0 + lambda) / (4.0 * cos_l) * cos_l;
    let found = at_center(&scene, &state).y;
    assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
}

#[test]
fn a_uniform_environment_is_reflected_without_gain() {
    let mut scene = scene(vec![card(1.0, 1.0)], vec![Material::default()]);
    scene.environment = Some(Environment::uniform([2.0, 1.0, 0.5]));
    let state = still(&scene);
    let sky = DVec3::new(2.0, 1.0, 0.5);
    // A smooth white metal at normal incidence is a perfect mirror of it.
    scene.materials[0] = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
    near(at_center(&scene, &state), sky, 1e-9);
    // A white dielectric loses what single scattering loses, and never gains.
    for roughness in [0.0, 0.5, 1.0] {
        scene.materials[0] = Material { metallic: 0.0, roughness, ..Material::default() };
        let part = at_center(&scene, &state) / sky;
        assert!(part.max_element() <= 1.0 + 1e-9 && part.min_element() > 0.97, "{roughness}: {part}");
    }
    // Lambert: exactly the base colour's part; occlusion takes its share.
    scene.materials[0] =
        Material { model: ShadingModel::Diffuse, base_color: [0.5, 0.5, 0.5, 1.0], ..Material::default() };
    near(at_center(&scene, &state), sky * 0.5, 1e-9);
    scene.images.push(Image {
        name: String::new(),
        width: 1,
        height: 1,
        texels: vec![[f16::from_f32(0.5); 4]],
    });
    scene.textures.push(Texture::new(0));
    scene.materials[0].occlusion_texture = Some(TextureRef::new(0));
    scene.materials[0].occlusion_strength = 0.5;
    near(at_center(&scene, &state), sky * 0.5 * 0.75, 1e-9);
    // Behind everything the sky itself, unless it is hidden.
    scene.nodes[0].mesh = None;
    near(at_center(&scene, &state), sky, 1e-9);
    scene.background = [0.25; 3];
    if let Some(environment) = &mut scene.environment {
        environment.visible = false;
    }
    near(at_center(&scene, &state), DVec3::splat(0.25), 1e-9);
}

fn ramp(width: u32, height: u32, f: impl Fn(u32, u32) -> f32) -> Image {
    let texels = (0..width * height).map(|i| [f16::from_f32(f(i % width, i / width)); 4]).collect();
    Image { name: String::new(), width, height, texels }
}

/// A card of 4 by 4 texels, one metre wide; the texture coordinate is scaled by `scale`.
fn textured(wrap: Wrap, nearest: bool, scale: f32) -> Scene {
    let mut reference = TextureRef::new(0);
    reference.transform = [scale, 0.0, 0.25, 0.0, scale, 0.0];
    let material = Material { base_color_texture: Some(reference), ..unlit([1.0; 4]) };
    let mut scene = scene(vec![card(0.5, 0.5)], vec![material]);
    scene.images.push(ramp(4, 4, |x, y| (x + 10 * y) as f32));
    scene.textures.push(Texture { image: 0, wrap_u: wrap, wrap_v: Wrap::Clamp, nearest });
    scene
}

#[test]
fn textures_are_upright_wrapped_and_bilinear() {
    let base = Options { filter: TextureFilter::BaseLevel, shadows: false, ..Options::default() };
    let at = |scene: &Scene, u: f64, v: f64| {
        // Image point of (u, v) of the card, which spans pixels -9 to 41 and -13 to 37.
        at_pixel(scene, &still(scene), &camera(), [-9.0 + 50.0 * u, -13.0 + 50.0 * v], base).x
    };
    // The transform adds 0.25: one texel to the right. Texel centres are at 0.125 + k / 4.
    let plain = textured(Wrap::Repeat, false, 1.0);
    for (u, v, expected) in [
        (0.125, 0.125, 1.0),
        (0.375, 0.625, 22.0),
        (0.25, 0.125, 1.5),
        (0.125, 0.25, 6.0),
        // Beyond the last texel: repeats the first.
        (0.75, 0.125, 1.5),
        (0.875, 0.125, 0.0),
    ] {
        assert!((at(&plain, u, v) - expected).abs() < 1e-9, "({u}, {v}): {}", at(&plain, u, v));
    }
    assert!((at(&textured(Wrap::Clamp, false, 1.0), 0.875, 0.125) - 3.0).abs() < 1e-9);
    assert!((at(&textured(Wrap::Mirror, false, 1.0), 0.875, 0.125) - 3.0).abs() < 1e-9);
    // At u = 1.375: one and a half texels beyond the edge, mirrored to 2.5 and 1.5 before it.
    assert!((at(&textured(Wrap::Mirror, false, 1.5), 0.75, 0.125 / 1.5) - 2.0).abs() < 1e-9);
    assert!((at(&textured(Wrap::Repeat, true, 1.0), 0.24, 0.1) - 1.0).abs() < 1e-9);
}

#[test]
fn mip_levels_follow_the_exact_footprint() {
    // A checkerboard of single texels: its mean is 0.5, and only the base level differs from it.
    let material = Material { base_color_texture: Some(TextureRef::new(0)), ..unlit([1.0; 4]) };
    let mut scene = scene(vec![card(0.5, 0.5)], vec![material]);
    scene.images.push(ramp(256, 256, |x, y| ((x + y) % 2) as f32));
    scene.textures.push(Texture::new(0));
    let mut state = still(&scene);
    let spread = |state: &SceneState, camera: &Pinhole, samples: f64| {
        let options =
            Options { filter: TextureFilter::Mipmapped { samples }, shadows: false, ..Options::default() };
        let textures = Textures::new(&scene);
        let raster = RayCaster::new(&scene, state, &textures, options);
        (0..64)
            .map(|i| (raster.radiance_at(camera, [10.0 + 0.17 * f64::from(i), 12.3]).x - 0.5).abs())
            .fold(0.0, f64::max)
    };
    // 256 texels over 50 pixels: level log2(5.12) = 2.36, all grey.
    assert!(spread(&state, &camera(), 1.0) < 1e-9);
    // One of sixteen samples reads level 0.36: the base level shows with a weight of 0.64.
    let biased = spread(&state, &camera(), 16.0);
    assert!((0.1..0.5 * 0.645).contains(&biased), "{biased}");
    // Magnified, it is the base level alone; the row of image points lies half a texel from the middle.
    let magnified =
        with_lens(PixelLens { focal: [1000.0; 2], center: [16.0, 12.3 - 500.0 / 512.0], ..camera().lens });
    assert!(spread(&state, &magnified, 1.0) > 0.45);
    // Seen at a slant the footprint is long in one axis, and the longer one counts.
    let close = with_lens(PixelLens { focal: [300.0; 2], ..camera().lens });
    let upright = spread(&state, &close, 1.0);
    state.world_from_node[0] = DMat4::from_rotation_x(-1.2);
    let slanted = spread(&state, &close, 1.0);
    assert!(upright > 0.05 && slanted < 1e-9, "{upright} {slanted}");
    // Several samples share the area: the axis that they resolve keeps its detail.
    let (by_area, by_length) =
        (spread(&state, &close, 16.0), (1.0 / (300.0 / 512.0) / 1.2_f64.cos()).log2() - 2.0);
    assert!(by_area > 0.3, "{by_area}, by the longer axis alone level {by_length}");
}

#[test]
fn normal_maps_tilt_in_the_texture_s_frame_also_in_a_mirror() {
    // A normal turned 45 degrees towards the bitangent, that is up (v runs down, the bitangent up).
    let tilted = [0.5, 0.5 + 0.5 * 0.5_f32.sqrt(), 0.5 + 0.5 * 0.5_f32.sqrt(), 1.0].map(f16::from_f32);
    let material = Material {
        model: ShadingModel::Diffuse,
        normal_texture: Some(TextureRef::new(0)),
        double_sided: true,
        ..Material::default()
    };
    let mut scene = scene(vec![card(1.0, 1.0)], vec![material]);
    scene.images.push(Image { name: String::new(), width: 1, height: 1, texels: vec![tilted] });
    scene.textures.push(Texture::new(0));
    let mut state = still(&scene);
    // Light from straight above: along the tilted normal's 45 degrees.
    let sun = Light { color: [1.0; 3], ..lamp(LightKind::Directional, PI as f32) };
    light(&mut scene, &mut state, sun, DMat4::from_rotation_x(-FRAC_PI_2));
    let expected = 0.5_f64.sqrt();
    for (pose, expected) in [
        (DMat4::IDENTITY, expected),
        // Mirrored left to right, up stays up.
        (DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)), expected),
        // Mirrored upside down, the texture's up points down.
        (DMat4::from_scale(DVec3::new(1.0, -1.0, 1.0)), 0.0),
        (DMat4::from_rotation_z(PI), 0.0),
    ] {
        state.world_from_node[0] = pose;
        let found = at_center(&scene, &state).x;
        assert!((found - expected).abs() < 2e-3, "{pose}: {found}");
    }
}

#[test]
fn normals_stay_upright_under_stretching() {
    // A plane of slope 1, stretched twofold along x: slope 1/2.
    let mut primitive = card(1.0, 1.0);
    for (p, n) in primitive.positions.iter_mut().zip(&mut primitive.normals) {
        p[2] = p[0];
        let s = 0.5_f32.sqrt();
        *n = [-s, 0.0, s];
    }
    let scene = scene(vec![primitive], vec![unlit([1.0; 4])]);
    let mut state = still(&scene);
    state.world_from_node[0] = DMat4::from_scale(DVec3::new(2.0, 1.0, 1.0));
    let geometry = Geometry::new(&scene, &state);
    let expected = DVec3::new(-1.0, 0.0, 2.0).normalize();
    near(geometry.corners(0)[0].normal, expected, 1e-6);
}

#[test]
fn morphs_and_skins_move_vertices_as_the_specification_says() {
    let mut primitive = card(0.5, 0.5);
    primitive.morph_targets = vec![
        MorphTarget { positions: vec![[0.0, 0.0, 1.0]; 4], normals: vec![[0.0; 3]; 4] },
        MorphTarget { positions: vec![[0.5, 0.0, 0.0]; 4], normals: vec![[1.0, 0.0, -1.0]; 4] },
    ];
    let mut scene = scene(vec![primitive], vec![unlit([1.0; 4])]);
    let mut state = still(&scene);
    state.morph_weights[0] = vec![0.25, 1.0];
    state.world_from_node[0] = DMat4::from_translation(DVec3::Y);
    let vertex = Geometry::new(&scene, &state).corners(0)[1];
    near(vertex.position, DVec3::new(1.0, 0.5, 0.25), 1e-12);
    near(vertex.normal, DVec3::X, 1e-12);

    // Two joints, the second turned a quarter about its bind place (1, 0, 0); the node's own pose is ignored.
    let joints = [0, 1].map(|_| scene.add_node(Node::default())).to_vec();
    let inverse_bind = vec![DMat4::IDENTITY, DMat4::from_translation(DVec3::NEG_X)];
    scene.skins.push(Skin { joints, inverse_bind });
    scene.nodes[0].skin = Some(0);
    let primitive = &mut scene.meshes[0].primitives[0];
    primitive.morph_targets.clear();
    primitive.joints = Some(vec![[0, 1, 0, 0]; 4]);
    primitive.joint_weights =
        Some(vec![[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]);
    let lifted = DMat4::from_translation(DVec3::new(0.0, 0.0, 3.0));
    let turned = DMat4::from_translation(DVec3::new(1.0, 0.0, 3.0)) * DMat4::from_rotation_z(FRAC_PI_2);
    state.world_from_node.extend([lifted, turned]);
    let geometry = Geometry::new(&scene, &state);
    let vertices = geometry.corners(0);
    near(vertices[0].position, DVec3::new(-0.5, -0.5, 3.0), 1e-12);
    // (0.5, -0.5) is (-0.5, -0.5) from the joint's place; a quarter turn makes it (0.5, -0.5).
    near(vertices[1].position, DVec3::new(1.5, -0.5, 3.0), 1e-12);
    // Half way between (0.5, 0.5) and 1 + (-0.5, -0.5).
    near(vertices[2].position, DVec3::new(0.5, 0.0, 3.0), 1e-12);
}

#[test]
fn flow_follows_the_same_point_of_matter() {
    let scene = scene(vec![card(5.0, 5.0), card(0.1, 0.1)], vec![unlit([1.0; 4])]);
    let mut state = still(&scene);
    state.world_from_node[0] = DMat4::from_translation(DVec3::new(0.0, 0.0, -2.0));
    let textures = Textures::new(&scene);
    let raster = RayCaster::new(&scene, &state, &textures, Options::default());
    let camera = camera();

    // Everything stands still.
    let none = raster.flow(&camera, raster.geometry(), &camera);
    assert!(none.iter().all(|f| f.unwrap().iter().all(|v| v.abs() < 1e-10)));

    // The small card moves and turns in its plane; the camera moves sideways.
    let mut later = state.clone();
    later.world_from_node[1] =
        DMat4::from_rotation_translation(DQuat::from_rotation_z(0.3), DVec3::new(0.05, 0.02, 0.0));
    let moved = Pinhole { world_from_camera: DMat4::from_translation(DVec3::new(0.1, 0.0, 2.0)), ..camera };
    let flow = raster.flow(&camera, &Geometry::new(&scene, &later), &moved);
    let labels = raster.labels(&camera);
    for (i, found) in flow.iter().enumerate() {
        let [x, y] = [(i % 32) as f64 + 0.5, (i / 32) as f64 + 0.5];
        let found = found.unwrap();
        let expected = if labels.instance[i] == 2 {
            let (px, py) = ((x - 16.0) / 50.0, (12.0 - y) / 50.0);
            let (sin, cos) = 0.3_f64.sin_cos();
            let there = [cos * px - sin * py + 0.05 - 0.1, sin * px + cos * py + 0.02];
            [16.0 + 50.0 * there[0] - x, 12.0 - 50.0 * there[1] - y]
        } else {
            // 4 m away: 25 pixels per metre.
            [-2.5, 0.0]
        };
        assert!((found[0] - expected[0]).abs() < 1e-9 && (found[1] - expected[1]).abs() < 1e-9, "{i}");
    }

    // The sky turns with the camera and does not feel its place; what ends up behind it has no flow.
    let mut empty = scene.clone();
    empty.nodes.iter_mut().for_each(|n| n.mesh = None);
    let raster = RayCaster::new(&empty, &state, &textures, Options::default());
    let pose = DMat4::from_rotation_translation(DQuat::from_rotation_y(0.01), DVec3::new(7.0, 8.0, 9.0));
    let flow = raster.flow(&camera, raster.geometry(), &Pinhole { world_from_camera: pose, ..camera });
    // Turning left moves the picture to the right by f tan(0.01) at the axis.
    let [dx, dy] = flow[12 * 32 + 16].unwrap();
    assert!((dx - 100.0 * 0.01_f64.tan()).abs() < 1e-3 && dy.abs() < 1e-4, "{dx} {dy}");
    let behind = Pinhole { world_from_camera: DMat4::from_rotation_y(PI), ..camera };
    assert!(raster.flow(&camera, raster.geometry(), &behind).iter().all(Option::is_none));
}

#[test]
fn vertex_colors_multiply_and_unlit_follows_its_waveform() {
    let mut primitive = card(0.5, 0.5);
    primitive.colors =
        Some(vec![[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0]]);
    let scene = scene(vec![primitive], vec![Material { emissive: [9.0; 3], ..unlit([2.0, 1.0, 1.0, 1.0]) }]);
    let mut state = still(&scene);
    state.emission_factor[0] = 0.5;
    // A quarter from the left, three quarters up, where the two triangles agree with the bilinear form's planes.
    let found = at_pixel(&scene, &state, &camera(), [16.0 - 12.5, 12.0 - 12.5], Options::default());
    near(found, DVec3::new(0.25 * 2.0 * 0.5, 0.75 * 0.5, 0.0), 1e-12);
}

#[test]
fn what_may_move_is_hit_where_what_rests_would_be() {
    // A mirrored, sheared card, a morphing one and a still one: once all still, once each free to move.
    let mut morphing = card(0.4, 0.4);
    morphing.morph_targets =
        vec![MorphTarget { positions: vec![[0.1, 0.0, 0.3]; 4], normals: vec![[0.2, 0.0, 0.0]; 4] }];
    let scene = scene(vec![card(0.5, 0.3), morphing, card(2.0, 2.0)], vec![unlit([1.0; 4])]);
    let mut state = still(&scene);
    state.world_from_node[0] = DMat4::from_scale_rotation_translation(
        DVec3::new(-1.0, 1.5, 0.7),
        DQuat::from_rotation_y(0.4),
        DVec3::new(0.3, 0.1, 0.5),
    );
    state.world_from_node[1] = DMat4::from_translation(DVec3::new(-0.3, 0.0, 0.2));
    state.morph_weights[1] = vec![0.7];
    let still = Geometry::new(&scene, &state);
    let matter = std::sync::Arc::new(evis_truth::rays::Matter::new(&scene, &self::still(&scene), |n| n < 2));
    let moving = Geometry::at(&matter, &scene, &state);
    let mut objects = [0; 3];
    for i in 0..1600 {
        let origin = DVec3::new(0.05 * f64::from(i % 40) - 1.0, 0.05 * f64::from(i / 40) - 1.0, 3.0);
        let direction = DVec3::new(0.03, -0.02, -1.0);
        let [a, b] = [&still, &moving].map(|g| g.nearest(origin, direction, 0.0, f64::INFINITY, |_| true));
        let (Some(a), Some(b)) = (a, b) else { panic!("the last card fills the view") };
        assert_eq!((a.triangle, a.object, a.front), (b.triangle, b.object, b.front));
        assert!((a.distance - b.distance).abs() < 1e-12);
        near(still.position(a.triangle, a.barycentric), moving.position(b.triangle, b.barycentric), 1e-12);
        for (p, q) in still.corners(a.triangle).into_iter().zip(moving.corners(b.triangle)) {
            near(p.normal, q.normal, 1e-12);
            near(p.tangent.0, q.tangent.0, 1e-12);
            assert_eq!(p.tangent.1, q.tangent.1);
        }
        objects[a.object] += 1;
    }
    assert!(objects.iter().all(|n| *n > 20), "each card is seen: {objects:?}");
}

#[test]
fn a_sample_s_share_of_a_texture_is_its_mean() {
    // Stripes of one texel, 5.12 texels per pixel: a place off the middle of a stripe reads light or dark, the mean does not.
    let material = Material { base_color_texture: Some(TextureRef::new(0)), ..unlit([1.0; 4]) };
    let mut scene = scene(vec![card(0.5, 0.5)], vec![material]);
    scene.images.push(ramp(256, 256, |x, _| (x % 2) as f32));
    scene.textures.push(Texture::new(0));
    let state = still(&scene);
    let textures = Textures::new(&scene);
    let worst = |filter| {
        let options = Options { filter, shadows: false, ..Options::default() };
        let raster = RayCaster::new(&scene, &state, &textures, options);
        (0..64)
            .map(|i| (raster.radiance_at(&camera(), [10.0 + 0.17 * f64::from(i), 12.3]).x - 0.5).abs())
            .fold(0.0, f64::max)
    };
    let averaged = |side: f64| TextureFilter::Averaged { shift: [0.0; 2], size: [side; 2], taps: 4.0 };
    // A quarter of a pixel is 1.28 texels, read at two places 0.64 texels apart: around a stripe's middle, where the
    // bilinear stripes are a triangle wave of slope 1, both are 0.32 below its height of 0.5.
    let (base, mean) = (worst(TextureFilter::BaseLevel), worst(averaged(0.25)));
    assert!(base > 0.45, "canary: stripes are seen where nothing is averaged: {base}");
    assert!((mean - 0.18).abs() < 0.01, "{mean}");
    // Of the whole pixel, four places 1.28 texels apart leave the rest to the mip levels.
    assert!(worst(averaged(1.0)) < 0.4);
    let magnified = |filter| {
        let options = Options { filter, shadows: false, ..Options::default() };
        let camera = with_lens(PixelLens { focal: [1000.0; 2], ..camera().lens });
        RayCaster::new(&scene, &state, &textures, options).radiance_at(&camera, [16.3, 12.3]).x
    };
    let exact = magnified(TextureFilter::BaseLevel);
    assert!((magnified(averaged(0.5)) - exact).abs() < 1e-12);
}
