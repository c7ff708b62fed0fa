//! A scene that tests of several modules share.

use evis_scene::primitive::Shape;
use evis_scene::{
    Camera, Lens, Light, LightKind, Material, Mesh, Motion, Node, Primitive, Scene, ShadingModel,
};
use glam::{DMat4, DQuat, DVec3};
use std::sync::Arc;

use evis_scene::Trs;
use evis_scene::motion::Path;

/// Plain solids that spin over a floor which reaches behind the camera, under a sun and a spot that throw shadows.
pub(crate) fn solids() -> Scene {
    let mut scene = Scene { background: [0.3; 3], ambient: [0.3; 3], ..Scene::default() };
    let mut add = |shape: Shape, color: [f32; 3], roughness: Option<f32>, motion: Motion| {
        let [r, g, b] = color;
        let material = scene.materials.len();
        scene.materials.push(Material {
            model: roughness.map_or(ShadingModel::Diffuse, |_| ShadingModel::MetallicRoughness),
            base_color: [r, g, b, 1.0],
            roughness: roughness.unwrap_or(1.0),
            metallic: 0.0,
            ..Material::default()
        });
        let mesh = Some(scene.meshes.len());
        let primitive = Primitive { material, ..shape.build(None, [1.0; 2]).unwrap() };
        scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
        scene.add_node(Node { mesh, motion, ..Node::default() })
    };
    let spinning = |place: [f64; 3], rate: f64| {
        let start = Trs { translation: DVec3::from_array(place), ..Trs::default() };
        let axis = DVec3::new(0.3, 1.0, 0.1).normalize();
        Motion::Path(Arc::new(Path::Spin { start, axis, rate }))
    };
    add(Shape::Plane { size: [8.0, 8.0] }, [0.5; 3], None, Motion::Fixed(DMat4::IDENTITY));
    add(Shape::Sphere { radius: 0.3 }, [0.7, 0.1, 0.1], Some(0.4), spinning([-0.5, 0.3, -0.2], 3.0));
    add(Shape::Box { size: [0.4, 0.3, 0.5] }, [0.2, 0.4, 0.8], None, spinning([0.3, 0.4, 0.1], -5.0));
    let capsule = Shape::Capsule { radius: 0.1, height: 0.4 };
    add(capsule, [0.9; 3], Some(0.3), spinning([0.0, 0.35, -0.7], 8.0));
    let cylinder = Shape::Cylinder { radius: 0.15, height: 0.4 };
    add(cylinder, [0.3, 0.8, 0.4], None, spinning([0.7, 0.5, -0.6], 2.0));
    let facing = |from: DVec3, to: DVec3| {
        let rotation = DQuat::from_rotation_arc(DVec3::NEG_Z, (to - from).normalize());
        Motion::Fixed(DMat4::from_rotation_translation(rotation, from))
    };
    let spot = LightKind::Spot { inner: 0.2, outer: 0.9 };
    let lamps = [(LightKind::Directional, 3.0, [2.0, 4.0, 1.0]), (spot, 12.0, [-1.5, 2.5, 1.0])];
    for (number, (kind, intensity, place)) in lamps.into_iter().enumerate() {
        scene.lights.push(Light { casts_shadow: true, ..Light::new("", kind, intensity) });
        let motion = facing(DVec3::from_array(place), DVec3::ZERO);
        scene.add_node(Node { light: Some(number), motion, ..Node::default() });
    }
    let start = Trs {
        translation: DVec3::new(0.1, 0.7, 1.8),
        rotation: DQuat::from_rotation_x(-0.25),
        ..Trs::default()
    };
    let velocity = DVec3::new(0.4, 0.1, -0.3);
    let motion = Motion::Path(Arc::new(Path::ConstantVelocity { start, velocity }));
    let node = scene.add_node(Node { motion, ..Node::default() });
    scene.cameras.push(Camera::new("camera", node, Lens::FieldOfView { fov_y: 0.8 }));
    scene
}
