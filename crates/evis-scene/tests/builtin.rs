//! The built-in scenes: complete, repeatable, and with pictures that make events.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::sync::LazyLock;

use evis_scene::builtin::{class, load, names};
use evis_scene::{Motion, Scene};

/// Every scene once: they are read by several tests.
static SCENES: LazyLock<Vec<Scene>> = LazyLock::new(|| {
    names().iter().map(|(name, _)| load(name, 3).unwrap_or_else(|e| panic!("{name}: {e}"))).collect()
});

fn scene(name: &str) -> &'static Scene {
    SCENES.iter().find(|scene| scene.name == name).expect("a scene of this name")
}

fn triangles(scene: &Scene) -> usize {
    let mesh = |m: usize| scene.meshes[m].primitives.iter().map(|p| p.indices.len() / 3).sum::<usize>();
    scene.nodes.iter().filter_map(|n| n.mesh).map(mesh).sum()
}

#[test]
fn scenes_are_complete() {
    for (name, description) in names() {
        let scene = scene(name);
        assert!(!description.is_empty() && scene.duration_s.is_some_and(|d| d >= 1.0), "{name}");
        assert_eq!(scene.cameras.len(), 1, "{name}");
        for (i, node) in scene.nodes.iter().enumerate() {
            assert!(!node.name.is_empty() && node.parent.is_none_or(|p| p < i), "{name}: {}", node.name);
            let known = class::NAMES.iter().any(|(id, _)| *id == node.semantic_id);
            assert_eq!(node.mesh.is_some(), known, "{name}: {} has a class where it is seen", node.name);
            assert_eq!(node.mesh.is_some(), node.instance_id > 0, "{name}: {} is numbered", node.name);
        }
        assert!(scene.lights.iter().filter(|l| l.casts_shadow).count() <= 2, "{name}");
    }
}

#[test]
fn scenes_have_their_size_and_their_moving_parts() {
    for (name, least, most, moving) in [
        ("warehouse", 8_000, 40_000, 14),
        ("spinner", 4, 100, 2),
        ("street", 8_000, 60_000, 7),
        ("desk", 2_000, 40_000, 4),
        ("tumble", 5_000, 40_000, 15),
    ] {
        let scene = scene(name);
        let count = triangles(scene);
        assert!((least..=most).contains(&count), "{name}: {count} triangles");
        let paths = scene.nodes.iter().filter(|n| matches!(n.motion, Motion::Path(_))).count()
            + scene.rigid_bodies.iter().filter(|(_, body)| body.is_dynamic()).count();
        assert!(paths >= moving, "{name}: {paths} paths");
    }
    let desk = scene("desk");
    assert!(
        matches!(desk.nodes[desk.cameras[0].node].motion, Motion::Fixed(_)),
        "the desk's camera stands still"
    );
}

#[test]
fn the_seed_is_all_that_changes_a_scene() {
    let images = |seed| load("spinner", seed).expect("built in").images;
    assert!(images(1) == images(1));
    assert!(images(1) != images(2));
    let nodes = |seed| format!("{:?}", load("warehouse", seed).expect("built in").nodes);
    assert!(nodes(1) == nodes(1) && nodes(1) != nodes(2), "goods lie elsewhere");
}

#[test]
fn textures_have_contrast_from_texel_to_texel() {
    for (name, _) in names() {
        for image in &scene(name).images {
            let log_luminance = |i: usize| {
                let [r, g, b, _] = image.texels[i].map(|c| f64::from(c.to_f32()));
                (0.2126 * r + 0.7152 * g + 0.0722 * b).max(1e-6).ln()
            };
            let steps: Vec<f64> = (1..image.texels.len())
                .map(|i| log_luminance(i) - log_luminance(i - 1))
                .map(|d| d * d)
                .collect();
            let rms = (steps.iter().sum::<f64>() / steps.len() as f64).sqrt();
            let mean = (0..image.texels.len()).map(log_luminance).sum::<f64>() / image.texels.len() as f64;
            assert!((0.03..1.2).contains(&rms), "{name}: {} changes by {rms:.3} per texel", image.name);
            assert!(
                (0.02..0.9).contains(&mean.exp()),
                "{name}: {} has log-mean {:.3}",
                image.name,
                mean.exp()
            );
        }
    }
}

#[test]
fn cameras_move_at_the_speeds_that_the_studies_need() {
    // Mean image speed of points four metres ahead of the camera, at 640x480, over four seconds.
    for (name, least, most) in [("spinner", 100.0, 200.0), ("warehouse", 100.0, 300.0), ("desk", 0.0, 0.0)] {
        let scene = scene(name);
        let camera = &scene.cameras[0];
        let evis_scene::Lens::FieldOfView { fov_y } = camera.lens else { panic!("{name}") };
        let focal = 240.0 / (fov_y / 2.0).tan();
        let pose = |t: f64| {
            let mut state = evis_scene::SceneState::default();
            scene.evaluate(t, &mut state);
            state.world_from_node[camera.node]
        };
        let speeds = (0..64).map(|i| {
            let (t, dt) = (0.25 * f64::from(i / 4), 1e-3);
            let corner = glam::DVec2::new([-1.5, 1.5][i as usize % 2], [-1.0, 1.0][i as usize / 2 % 2]);
            let point = pose(t).transform_point3(corner.extend(-4.0));
            let pixel = |t: f64| {
                let p = pose(t).inverse().transform_point3(point);
                glam::DVec2::new(p.x, p.y) * (focal / -p.z)
            };
            (pixel(t + dt) - pixel(t)).length() / dt
        });
        let mean = speeds.sum::<f64>() / 64.0;
        assert!((least..=most).contains(&mean), "{name}: {mean:.0} px/s");
    }
}

/// A triangle in the world, and what it belongs to.
struct Facet {
    name: String,
    corners: [glam::DVec3; 3],
    normal: glam::DVec3,
    double_sided: bool,
    low: glam::DVec3,
    high: glam::DVec3,
}

impl Facet {
    /// `None` where it has no area.
    fn new(name: String, corners: [glam::DVec3; 3], double_sided: bool) -> Option<Self> {
        let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let low = corners[0].min(corners[1]).min(corners[2]);
        let high = corners[0].max(corners[1]).max(corners[2]);
        (cross.length() > 1e-9).then(|| Self {
            name,
            corners,
            normal: cross.normalize(),
            double_sided,
            low,
            high,
        })
    }
}

fn facets(scene: &Scene) -> Vec<Facet> {
    let mut state = evis_scene::SceneState::default();
    scene.evaluate(0.0, &mut state);
    let mut facets = Vec::new();
    for (node, world) in scene.nodes.iter().zip(&state.world_from_node) {
        for primitive in node.mesh.iter().flat_map(|mesh| &scene.meshes[*mesh].primitives) {
            let material = &scene.materials[primitive.material];
            for triangle in primitive.indices.chunks_exact(3) {
                let corners = [0, 1, 2].map(|i| {
                    let position = primitive.positions[triangle[i] as usize];
                    world.transform_point3(glam::Vec3::from(position).as_dvec3())
                });
                let name = format!("{} ({})", node.name, material.name);
                facets.extend(Facet::new(name, corners, material.double_sided));
            }
        }
    }
    facets
}

/// Whether both lie in one plane, look the same way and share more than a millimetre of it.
fn coincide(a: &Facet, b: &Facet) -> bool {
    const FLAT_M: f64 = 1e-4;
    const SHARED_M: f64 = 1e-3;
    let along = a.normal.dot(b.normal);
    if along.abs() < 1.0 - 1e-7 || (along < 0.0 && !a.double_sided && !b.double_sided) {
        return false;
    }
    if b.corners.iter().any(|corner| (*corner - a.corners[0]).dot(a.normal).abs() > FLAT_M) {
        return false;
    }
    // Two triangles of a plane are apart where an edge's normal says so.
    let range = |facet: &Facet, axis: glam::DVec3| {
        let at = facet.corners.map(|corner| corner.dot(axis));
        (at.iter().copied().fold(f64::MAX, f64::min), at.iter().copied().fold(f64::MIN, f64::max))
    };
    [a, b].into_iter().flat_map(|facet| (0..3).map(move |i| (facet, i))).all(|(facet, i)| {
        let edge = facet.corners[(i + 1) % 3] - facet.corners[i];
        let axis = edge.cross(a.normal).normalize();
        let ((a0, a1), (b0, b1)) = (range(a, axis), range(b, axis));
        a1.min(b1) - a0.max(b0) > SHARED_M
    })
}

fn coincidences(facets: &mut [Facet]) -> std::collections::BTreeSet<(String, String)> {
    facets.sort_by(|a, b| a.low.x.total_cmp(&b.low.x));
    let mut found = std::collections::BTreeSet::new();
    for (i, a) in facets.iter().enumerate() {
        for b in facets[i + 1..].iter().take_while(|b| b.low.x <= a.high.x + 1e-4) {
            let apart = b.low.y > a.high.y + 1e-4
                || a.low.y > b.high.y + 1e-4
                || b.low.z > a.high.z + 1e-4
                || a.low.z > b.high.z + 1e-4;
            if !apart && coincide(a, b) {
                let (low, high) = if a.name <= b.name { (a, b) } else { (b, a) };
                found.insert((low.name.clone(), high.name.clone()));
            }
        }
    }
    found
}

#[test]
fn no_two_surfaces_lie_in_one_place() {
    // Which of two surfaces in one plane is seen is up to rounding, and differs from pixel to pixel and time to time:
    // events without a cause.
    for (seed, (name, _)) in
        [0, 1, 3].into_iter().flat_map(|seed| names().iter().map(move |name| (seed, name)))
    {
        let found = coincidences(&mut facets(&load(name, seed).unwrap()));
        assert!(found.is_empty(), "{name} with seed {seed}: {found:#?}");
    }
}

#[test]
fn surfaces_in_one_place_are_found() {
    let corner = glam::DVec3::from([0.3, -0.2, 1.0]);
    let turn = glam::DQuat::from_rotation_x(0.7);
    let facet = |name: &str, shift: [f64; 3], mirrored: bool, double_sided: bool| {
        let mut corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
            .map(|at| corner + turn * (glam::DVec3::from(at) + glam::DVec3::from(shift)));
        if mirrored {
            corners.swap(1, 2);
        }
        Facet::new(name.into(), corners, double_sided).unwrap()
    };
    let first = || facet("first", [0.0; 3], false, false);
    for (second, meet) in [
        (facet("shifted along", [0.2, 0.1, 0.0], false, false), true),
        (facet("lifted", [0.2, 0.1, 2e-3], false, false), false),
        (facet("beside", [1.0, 0.0, 0.0], false, false), false),
        (facet("back to back", [0.2, 0.1, 0.0], true, false), false),
        (facet("seen from both sides", [0.2, 0.1, 0.0], true, true), true),
    ] {
        let name = second.name.clone();
        assert_eq!(coincidences(&mut [second, first()]).len(), usize::from(meet), "{name}");
    }
}
