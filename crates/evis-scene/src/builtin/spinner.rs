//! The reference scene of the method studies: textured plane, spinning square, moving and turning camera.

use std::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec3};

use super::class;
use super::parts::paint;
use crate::builder::{EventCamera, Placement, SceneBuilder, ShapeSettings, still};
use crate::error::SceneError;
use crate::model::{Material, Scene, Trs};
use crate::motion::Path;
use crate::primitive::Shape;
use crate::procedural::{Pattern, srgb};

/// Seconds after which the square and the camera are back.
const PERIOD_S: f64 = 4.0;

pub(super) fn load(seed: u64) -> Result<Scene, SceneError> {
    let mut scene = SceneBuilder::new("spinner");
    scene.duration_s(PERIOD_S)?;
    // About one texel per pixel of a 640x480 camera, on the plane and on the square.
    let colors = Some([srgb(0x2c6a74), srgb(0xd9a05a)]);
    let plane = paint(&mut scene, seed, "plane", Pattern::Noise, 1024, colors)?;
    let square = paint(&mut scene, seed, "square", Pattern::Poster, 256, None)?;
    let plane = scene.material(Material::unlit("plane").textured(plane))?;
    let square = scene.material(Material::unlit("square").textured(square))?;

    let behind = Placement::at([0.0, 0.0, -4.5]);
    scene.shape_with(
        "plane",
        Shape::Card { size: [13.0; 2] },
        plane,
        ShapeSettings::semantic(class::BUILDING),
        behind,
    )?;
    let path = upright_eight([0.0, 0.0, -2.8], [0.7, 0.35], PERIOD_S, spin(1.5));
    let settings = ShapeSettings::semantic(class::MOVING);
    scene.shape_with("square", Shape::Card { size: [1.6; 2] }, square, settings, Placement::along(path))?;
    // On the plane up to 85 px/s from travel and 60 px/s from the turn; about 250 px/s at the square's corners.
    let path = upright_eight([0.0; 3], [0.6, 0.3], PERIOD_S, spin(0.3));
    scene.camera(EventCamera::new("camera"), Placement::along(path))?;
    scene.build()
}

fn spin(rate: f64) -> Path {
    Path::Spin { start: Trs::default(), axis: DVec3::Z, rate }
}

/// A figure eight in x and y instead of x and z, then `inner` at its moving point.
fn upright_eight(centre: [f64; 3], size: [f64; 2], period_s: f64, inner: Path) -> Path {
    let tilt = |angle: f64| Trs { rotation: DQuat::from_rotation_x(angle), ..Trs::default() };
    let start = Trs { translation: centre.into(), ..tilt(FRAC_PI_2) };
    Path::Chain(vec![
        Path::FigureEight { start, size, period_s, look_at: None },
        still(tilt(-FRAC_PI_2)),
        inner,
    ])
}
