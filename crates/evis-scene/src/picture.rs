//! A still picture as a scene: a textured unlit plane before one camera.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use glam::{DMat4, DVec2, DVec3};
use half::f16;

use crate::error::SceneError;
use crate::image::{self, Transfer};
use crate::model::{
    Camera, Framing, Lens, Material, Mesh, Node, Primitive, Scene, ShadingModel, Texture, TextureRef, Wrap,
};
use crate::motion::Motion;

/// Endings of the files that are read as pictures, in lower case.
pub const ENDINGS: [&str; 7] = ["png", "jpg", "jpeg", "hdr", "exr", "tif", "tiff"];

/// The picture extends beyond the view on each side by this share of the view, at least, so that a moving camera
/// never shows its border.
pub(crate) const MARGIN: f64 = 0.08;

/// Half of the view's diagonal over the camera's distance: a narrow view, so that turning the camera bends little of the
/// picture.
const HALF_DIAGONAL_TANGENT: f64 = 0.45;

/// Reads a picture: PNG, JPEG and TIFF as sRGB (IEC 61966-2-1), which is decoded to linear light; Radiance, OpenEXR and TIFF of
/// floats as linear light. The scene is a plane, 1 metre high, in z = 0 about the origin, that shows it unlit, and a
/// camera before it with the picture's aspect that sees all but a margin; [`Scene::move_cameras`] fits it to another size.
///
/// # Errors
/// A file that cannot be read, or is no usable picture.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    // The decoders are outside code and this build checks for overflow: a damaged file must not take a program down.
    let decoded = catch_unwind(AssertUnwindSafe(|| image::load(path, Transfer::Srgb)));
    let mut picture = decoded.unwrap_or_else(|_| {
        Err(SceneError::invalid(path, "is damaged: its decoder gave up; export it again"))
    })?;
    let mut scene = Scene {
        name: path.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        ..Scene::default()
    };
    repair(&mut picture, &mut scene.warnings);
    let aspect = f64::from(picture.width) / f64::from(picture.height);
    let half_size = [0.5 * aspect, 0.5];
    scene.images.push(picture);
    // A camera of another aspect that nobody fitted sees the picture mirrored beyond its border, and no edge.
    scene.textures.push(Texture { image: 0, wrap_u: Wrap::Mirror, wrap_v: Wrap::Mirror, nearest: false });
    scene.materials.push(Material {
        name: "picture".into(),
        model: ShadingModel::Unlit,
        base_color_texture: Some(TextureRef::new(0)),
        ..Material::default()
    });
    scene.meshes.push(Mesh { name: "picture".into(), primitives: vec![plane(half_size)], ..Mesh::default() });
    scene.add_node(Node { name: "picture".into(), mesh: Some(0), ..Node::default() });
    let node = scene.add_node(Node { name: "default camera".into(), ..Node::default() });
    scene.cameras.push(Camera {
        aspect: Some(aspect),
        ..Camera::new("default", node, Lens::FieldOfView { fov_y: 1.0 })
    });
    scene.framing = Some(Framing::Picture { half_size });
    scene.fit_picture(None);
    scene.validate()?;
    Ok(scene)
}

/// Numbers that are no light are black, and alpha counts for nothing.
fn repair(picture: &mut crate::model::Image, warnings: &mut Vec<String>) {
    let (mut broken, mut clear) = (0_u64, 0_u64);
    for [r, g, b, alpha] in &mut picture.texels {
        let lights = [r, g, b];
        broken += u64::from(lights.iter().any(|v| !v.is_finite()));
        for light in lights {
            if !light.is_finite() {
                *light = f16::ZERO;
            }
        }
        clear += u64::from(*alpha < f16::ONE);
        *alpha = f16::ONE;
    }
    let name = &picture.name;
    if broken > 0 {
        warnings.push(format!(
            "picture '{name}': {broken} pixels hold numbers that are not finite and are black"
        ));
    }
    if clear > 0 {
        warnings.push(format!("picture '{name}': its transparency is ignored ({clear} pixels)"));
    }
}

/// Three times the picture along each axis, in z = 0 and facing +Z.
fn plane([x, y]: [f64; 2]) -> Primitive {
    let corners = [(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)];
    Primitive {
        material: 0,
        positions: corners.iter().map(|(u, v)| [(u * x) as f32, (v * y) as f32, 0.0]).collect(),
        normals: vec![[0.0, 0.0, 1.0]; 4],
        // v runs down; the picture itself is [0, 1].
        uvs: [
            Some(corners.iter().map(|(u, v)| [0.5 + 0.5 * *u as f32, 0.5 - 0.5 * *v as f32]).collect()),
            None,
        ],
        indices: vec![0, 1, 2, 0, 2, 3],
        ..Primitive::default()
    }
}

impl Scene {
    /// Fits the camera of a picture to views of `size` pixels ([`Camera::pixels`]): it sees the largest part of the picture
    /// that has the view's aspect and leaves a margin on each side. Does nothing for other scenes.
    pub(crate) fn fit_picture(&mut self, size: Option<(u32, u32)>) {
        let (Some(Framing::Picture { half_size }), [camera]) = (self.framing, &mut self.cameras[..]) else {
            return;
        };
        let (width, height) = camera.pixels(size);
        let view = DVec2::new(width.into(), height.into());
        let seen = DVec2::from(half_size) / (1.0 + 2.0 * MARGIN);
        let half_view = view * (seen / view).min_element();
        let distance = half_view.length() / HALF_DIAGONAL_TANGENT;
        camera.lens = Lens::FieldOfView { fov_y: 2.0 * (half_view.y / distance).atan() };
        camera.near = 0.1 * distance;
        if let Some(node) = self.nodes.get_mut(camera.node) {
            node.motion = Motion::Fixed(DMat4::from_translation(DVec3::Z * distance));
        }
    }
}
