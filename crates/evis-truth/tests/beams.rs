//! A beam sees what each of its rays sees alone.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_scene::{PixelLens, Rays, Scene, SceneState, builtin};
use evis_truth::rays::{Beam, Options, Pinhole, RayCaster, TextureFilter, Textures};
use glam::DMat4;

fn pinhole(scene: &Scene, state: &SceneState) -> Pinhole {
    Pinhole {
        world_from_camera: scene.world_from_camera(0, state).unwrap_or(DMat4::IDENTITY),
        lens: PixelLens {
            focal: [430.0; 2],
            center: [320.0, 240.0],
            width: 640,
            height: 480,
            near: 0.01,
            rays: Rays::Central,
        },
    }
}

/// Pixels of 2.5 cm, and a far plane that cuts some of what is seen.
fn orthographic(scene: &Scene, state: &SceneState) -> Pinhole {
    let camera = pinhole(scene, state);
    let lens = PixelLens { focal: [40.0; 2], near: 0.5, rays: Rays::Parallel { far: 20.0 }, ..camera.lens };
    Pinhole { lens, ..camera }
}

#[test]
fn beams_see_what_single_rays_see() {
    let options = Options { filter: TextureFilter::BaseLevel, shadows: true, ..Options::default() };
    for name in ["spinner", "warehouse", "street", "desk"] {
        let scene = builtin::load(name, 0).unwrap();
        let textures = Textures::new(&scene);
        let mut state = SceneState::default();
        scene.evaluate(0.0142, &mut state);
        let caster = RayCaster::new(&scene, &state, &textures, options);
        for camera in [pinhole, orthographic].map(|camera| camera(&scene, &state)) {
            compare(name, &caster, &camera);
        }
    }
}

fn compare(name: &str, caster: &RayCaster<'_>, camera: &Pinhole) {
    let (mut kinds, mut strays) = (std::collections::BTreeSet::new(), 0);
    for i in 0..400 {
        let at = |step: f64, size: f64| (f64::from(i) * step).fract() * size;
        let low = [at(0.754_877, 639.0).floor(), at(0.569_840, 479.0).floor()];
        let beam = Beam::new(caster, camera, low, [low[0] + 1.0, low[1] + 1.0]);
        for j in 0..60 {
            let inside = [(f64::from(j) * 0.618_034).fract(), f64::from(j) / 59.0];
            let pixel = [low[0] + inside[0], low[1] + inside[1]];
            let (a, b) = (beam.look(pixel), caster.look(camera, pixel));
            assert_eq!(a, b, "{name} at {pixel:?}");
            kinds.insert(a.1);
            // A ray beside the beam sees something else, sooner or later, than what the beam holds.
            let beside = [pixel[0] + 40.0, pixel[1]];
            strays += u32::from(beam.look(beside) != caster.look(camera, beside));
        }
    }
    assert!(kinds.len() > 1 && strays > 100, "canary: {name}: {} kinds, {strays} strays", kinds.len());
}
