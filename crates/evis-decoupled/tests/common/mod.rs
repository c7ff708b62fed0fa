//! Pictures by rays, and numbers that look random.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![allow(dead_code, reason = "each test takes what it needs")]

use evis_core::Truth;
use evis_core::metric::{ScoreSettings, score};
use evis_decoupled::{Settings, simulate};
use evis_scene::primitive::Shape;
use evis_scene::{
    Camera, Image, Lens, Light, LightKind, Material, Mesh, Motion, Node, PixelLens, Primitive, Scene,
    SceneState, Texture, TextureRef, Wrap,
};
use evis_truth::rays::{Options, Pinhole, RayCaster, SplitSum, TextureFilter, Textures};
use evis_truth::{Lattice, PixelChoice, TruthSettings, truth};
use half::f16;

/// Numbers in [0, 1) by place.
pub fn noise(channel: u32, x: u32, y: u32) -> f32 {
    let v = (x.wrapping_mul(747_796_405) ^ y.wrapping_mul(2_891_336_453) ^ channel.wrapping_mul(277_803_737))
        .wrapping_mul(0x9e37_79b9);
    let v = ((v >> ((v >> 28) + 4)) ^ v).wrapping_mul(277_803_737);
    ((v >> 22) ^ v) as f32 / u32::MAX as f32
}

/// By many rays per pixel.
pub fn exact(scene: &Scene, size: (u32, u32), t_us: f64) -> Vec<f64> {
    let textures = Textures::new(scene);
    let mut state = SceneState::default();
    scene.evaluate(t_us * 1e-6, &mut state);
    let options = Options { filter: TextureFilter::BaseLevel, shadows: true, split_sum: SplitSum::Tabulated };
    let caster = RayCaster::new(scene, &state, &textures, options);
    let pinhole = Pinhole {
        world_from_camera: scene.world_from_camera(0, &state).unwrap(),
        lens: PixelLens::new(&scene.cameras[0], Some(size)),
    };
    let offsets = Lattice::Second.offsets(1);
    let pixel = |i: u32| {
        let middle = [f64::from(i % size.0) + 0.5, f64::from(i / size.0) + 0.5];
        let light = |o: &[f64; 2]| caster.look(&pinhole, [middle[0] + o[0], middle[1] + o[1]]).0;
        offsets.iter().map(light).sum::<f64>() / offsets.len() as f64
    };
    (0..size.0 * size.1).map(pixel).collect()
}

/// Root mean square of what ln of one is off by.
pub fn off(found: &[f64], exact: &[f64]) -> f64 {
    let squares = found.iter().zip(exact).map(|(f, e)| (f + 1e-3).ln() - (e + 1e-3).ln()).map(|v| v * v);
    (squares.sum::<f64>() / found.len() as f64).sqrt()
}

/// A camera of the run's size and sensor.
pub fn camera(node: usize, lens: Lens) -> Camera {
    Camera { near: 0.05, ..Camera::new("camera", node, lens) }
}

/// A shape of a material of its own, on a node that moves so.
pub fn add(scene: &mut Scene, shape: Shape, material: Material, motion: Motion) {
    add_of(scene, (shape, None), material, motion);
}

/// The same of so many segments.
pub fn add_of(
    scene: &mut Scene,
    (shape, segments): (Shape, Option<[u32; 2]>),
    material: Material,
    motion: Motion,
) {
    let number = scene.materials.len();
    scene.materials.push(material);
    let primitive = Primitive { material: number, ..shape.build(segments, [1.0, 1.0]).unwrap() };
    let mesh = Some(scene.meshes.len());
    scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
    scene.add_node(Node { mesh, motion, ..Node::default() });
}

/// A square texture, which repeats.
pub fn add_texture(scene: &mut Scene, size: u32, texel: impl Fn(u32, u32) -> [f32; 4]) -> Option<TextureRef> {
    let texels = (0..size * size).map(|i| texel(i % size, i / size).map(f16::from_f32)).collect();
    let image = scene.images.len();
    scene.images.push(Image { name: String::new(), width: size, height: size, texels });
    scene.textures.push(Texture { image, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false });
    Some(TextureRef::new(image))
}

/// A steady light without a range.
pub fn light(kind: LightKind, casts_shadow: bool, intensity: f32) -> Light {
    Light { color: [1.0, 0.9, 0.8], casts_shadow, ..Light::new("", kind, intensity) }
}

/// The oracle's events at so many pixels of `scene`, and the settings that they were made with.
pub fn truth_of(scene: &Scene, size: (u32, u32), duration_us: i64, pixels: usize) -> (TruthSettings, Truth) {
    let pixels = PixelChoice::Count(pixels);
    let asked = TruthSettings { size: Some(size), duration_us, pixels, ..TruthSettings::default() };
    let truth = truth(scene, &asked, &|_| true).unwrap();
    (asked, truth)
}

/// F1 within 1 ms, scaled, of what `scene` makes an ideal sensor fire, against a truth of these settings; and how many events
/// that are.
pub fn f1(scene: &Scene, asked: &TruthSettings, truth: &Truth) -> (f64, usize) {
    let reference_luminance = Some(truth.reference_luminance);
    let (size, duration_us) = (asked.size, asked.duration_us);
    let settings = Settings { size, duration_us, reference_luminance, ..Settings::default() };
    let events = simulate(scene, &settings).unwrap().events;
    let found = score(&events, truth, &ScoreSettings::default()).unwrap();
    (found.at(1000).unwrap().scaled.f1, events.len())
}
