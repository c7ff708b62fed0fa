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
        assert!(!description.is_empty() && scene.duration_s.is_some_and(|d| d >= 3.0), "{name}");
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
    ] {
        let scene = scene(name);
        let count = triangles(scene);
        assert!((least..=most).contains(&count), "{name}: {count} triangles");
        let paths = scene.nodes.iter().filter(|n| matches!(n.motion, Motion::Path(_))).count();
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
            let log_luma = |i: usize| {
                let [r, g, b, _] = image.texels[i].map(|c| f64::from(c.to_f32()));
                (0.2126 * r + 0.7152 * g + 0.0722 * b).max(1e-6).ln()
            };
            let steps: Vec<f64> =
                (1..image.texels.len()).map(|i| log_luma(i) - log_luma(i - 1)).map(|d| d * d).collect();
            let rms = (steps.iter().sum::<f64>() / steps.len() as f64).sqrt();
            let mean = (0..image.texels.len()).map(log_luma).sum::<f64>() / image.texels.len() as f64;
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
