//! Spheres and boxes before a wall, all in one textured diffuse material, under one light, seen by a moving camera.

use evis_render::scene::builder::{EventCamera, Placement, Sampling, SceneBuilder, ShapeSettings};
use evis_render::scene::motion::Path;
use evis_render::scene::primitive::Shape;
use evis_render::scene::procedural::{Pattern, Procedural};
use evis_render::scene::{Light, Material, Scene, Trs};

use super::Failure;

/// How finely a scene is cut.
#[derive(Clone, Copy)]
pub struct Detail {
    /// Columns and rows of objects.
    pub grid: [u32; 2],
    /// Segments of a sphere, around and along.
    pub sphere: [u32; 2],
    /// Segments of a box's face.
    pub face: [u32; 2],
}

/// About 0.5k, 8k and 38k triangles.
pub const DETAILS: [Detail; 3] = [
    Detail { grid: [4, 3], sphere: [8, 5], face: [1, 1] },
    Detail { grid: [8, 6], sphere: [18, 9], face: [2, 2] },
    Detail { grid: [12, 9], sphere: [25, 13], face: [3, 3] },
];

/// The scene of `detail`.
pub fn build(detail: Detail) -> Result<Scene, Failure> {
    let mut scene = SceneBuilder::new("benchmark");
    let picture = Procedural::new(Pattern::Noise, 512, 3).with_colors([0.1, 0.12, 0.1], [0.8, 0.75, 0.7]);
    let picture = scene.procedural("picture", &picture, Sampling::default())?;
    let material = scene.material(Material::diffuse("picture").textured(picture))?;
    let wall = Shape::Box { size: [12.0, 9.0, 0.2] };
    let wall_at = Placement::at([0.0, 0.0, -2.0]);
    scene.shape_with("wall", wall, material, ShapeSettings::default().repeat(3.0, 2.0), wall_at)?;
    let [columns, rows] = detail.grid;
    let pitch = [8.0 / f64::from(columns), 6.0 / f64::from(rows)];
    for row in 0..rows {
        for column in 0..columns {
            let number = row * columns + column;
            let at = [
                (f64::from(column) + 0.5) * pitch[0] - 4.0,
                (f64::from(row) + 0.5) * pitch[1] - 3.0,
                // Three depths: neighbours cover each other here and there.
                f64::from(number % 3) * 0.5 - 0.8,
            ];
            let radius = pitch[0] * 0.5;
            let (shape, [u, v]) = if (row + column) % 2 == 0 {
                (Shape::Sphere { radius }, detail.sphere)
            } else {
                (Shape::Box { size: [radius * 1.6; 3] }, detail.face)
            };
            let settings = ShapeSettings::default().segments(u, v);
            scene.shape_with(format!("object {number}"), shape, material, settings, Placement::at(at))?;
        }
    }
    scene.light(Light::directional("sun", 3.0), Placement::looking_at([2.0, 4.0, 5.0], [0.0; 3]))?;
    scene.ambient([0.3; 3])?;
    // 0.8 m/s at most, about 100 pixels per second.
    let path = Path::FigureEight {
        start: Trs { translation: [0.0, 0.0, 5.0].into(), ..Trs::default() },
        size: [0.5, 0.25],
        period_s: 4.0,
        look_at: None,
    };
    scene.camera(EventCamera::new("camera").fov_y_degrees(45.0), Placement::along(path))?;
    Ok(scene.build()?)
}

/// Its triangles, as drawn.
pub fn triangle_count(scene: &Scene) -> usize {
    let meshes = scene.nodes.iter().filter_map(|n| n.mesh);
    meshes.flat_map(|m| &scene.meshes[m].primitives).map(|p| p.indices.len() / 3).sum()
}
