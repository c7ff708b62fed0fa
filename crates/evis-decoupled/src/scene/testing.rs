//! What tests of several modules build scenes from, and a scene.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{
    Camera, Lens, Light, LightKind, Material, Mesh, Motion, Node, Primitive, Scene, ShadingModel, Trs,
};
use glam::{DMat4, DQuat, DVec3};

/// Numbers from 0 to 1 that follow from `seed`.
pub(crate) fn numbers(seed: u32) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        f64::from(state >> 8) / f64::from(1 << 24)
    }
}

/// Adds `primitive` on a node that moves so.
pub(crate) fn add(scene: &mut Scene, primitive: Primitive, motion: Motion) {
    let mesh = Some(scene.meshes.len());
    scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
    scene.add_node(Node { mesh, motion, ..Node::default() });
}

/// Around the y axis, with the radii of its ring and of its tube.
pub(crate) fn torus([ring, tube]: [f64; 2], [around, across]: [u32; 2]) -> Primitive {
    let mut made = Primitive::default();
    for (i, j) in (0..around).flat_map(|i| (0..across).map(move |j| (i, j))) {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(around)).sin_cos();
        let (up, out) = (std::f64::consts::TAU * f64::from(j) / f64::from(across)).sin_cos();
        let normal = DVec3::new(out * sin, up, out * cos);
        let place = DVec3::new(ring * sin, 0.0, ring * cos) + normal * tube;
        made.positions.push(place.as_vec3().to_array());
        made.normals.push(normal.as_vec3().to_array());
        let corner = |i: u32, j: u32| i % around * across + j % across;
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        made.indices.extend([a, b, c, a, c, d]);
    }
    made
}

/// Plain solids that spin over a floor which reaches behind the camera, under a sun and a spot that throw shadows.
pub(crate) fn solids() -> Scene {
    let mut scene = Scene { background: [0.3; 3], ambient: [0.3; 3], ..Scene::default() };
    let mut solid = |primitive: Primitive, color: [f32; 3], roughness: Option<f32>, motion: Motion| {
        let [r, g, b] = color;
        let material = scene.materials.len();
        scene.materials.push(Material {
            model: roughness.map_or(ShadingModel::Diffuse, |_| ShadingModel::MetallicRoughness),
            base_color: [r, g, b, 1.0],
            roughness: roughness.unwrap_or(1.0),
            metallic: 0.0,
            ..Material::default()
        });
        add(&mut scene, Primitive { material, ..primitive }, motion);
    };
    let spinning = |place: [f64; 3], rate: f64| {
        let start = Trs { translation: DVec3::from_array(place), ..Trs::default() };
        let axis = DVec3::new(0.3, 1.0, 0.1).normalize();
        Motion::Path(Arc::new(Path::Spin { start, axis, rate }))
    };
    let of = |shape: Shape| shape.build(None, [1.0; 2]).unwrap();
    solid(of(Shape::Plane { size: [8.0, 8.0] }), [0.5; 3], None, Motion::Fixed(DMat4::IDENTITY));
    solid(of(Shape::Sphere { radius: 0.3 }), [0.7, 0.1, 0.1], Some(0.4), spinning([-0.5, 0.3, -0.2], 3.0));
    solid(of(Shape::Box { size: [0.4, 0.3, 0.5] }), [0.2, 0.4, 0.8], None, spinning([0.3, 0.4, 0.1], -5.0));
    let capsule = Shape::Capsule { radius: 0.1, height: 0.4 };
    solid(of(capsule), [0.9; 3], Some(0.3), spinning([0.0, 0.35, -0.7], 8.0));
    let cylinder = Shape::Cylinder { radius: 0.15, height: 0.4 };
    solid(of(cylinder), [0.3, 0.8, 0.4], None, spinning([0.7, 0.5, -0.6], 2.0));
    // Upright, so that its upper half shadows the lower one.
    let upright = Trs {
        translation: DVec3::new(0.05, 0.95, -0.6),
        rotation: DQuat::from_rotation_x(FRAC_PI_2),
        ..Trs::default()
    };
    let turning = Path::Spin { start: upright, axis: DVec3::Y, rate: 4.0 };
    solid(torus([0.2, 0.08], [20, 10]), [0.6; 3], None, Motion::Path(Arc::new(turning)));
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
