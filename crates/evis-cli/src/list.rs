//! `scenes` and `devices`.

use serde::Serialize;

use crate::args::ListArgs;
use crate::failure::bad_input;
use crate::{scene_source, text};

#[derive(Serialize)]
struct SceneLine {
    name: String,
    duration_s: Option<f64>,
    cameras: Vec<String>,
    environments: usize,
    triangles: usize,
}

/// Lists the built-in scenes.
pub(crate) fn scenes(args: &ListArgs) -> anyhow::Result<i32> {
    let mut lines = Vec::new();
    for name in scene_source::names() {
        let scene = scene_source::describe(&name)?;
        lines.push(SceneLine {
            name,
            duration_s: scene.duration_s,
            cameras: scene.cameras.iter().map(|c| c.name.clone()).collect(),
            environments: scene.variants.len().max(1),
            triangles: triangles(&scene),
        });
    }
    if args.json {
        text::say_json(&lines)?;
        return Ok(0);
    }
    for line in lines {
        let duration = line.duration_s.map_or("no end".into(), |s| format!("{s} s"));
        text::say(&format!(
            "{:<12} {:>8}  {:>8} triangles  cameras: {}",
            line.name,
            duration,
            line.triangles,
            line.cameras.join(", ")
        ));
    }
    Ok(0)
}

/// Triangles drawn at one instant, a mesh counted once per node that carries it.
fn triangles(scene: &evis_scene::Scene) -> usize {
    let of_mesh = |index: usize| {
        scene.meshes.get(index).map_or(0, |mesh| mesh.primitives.iter().map(|p| p.indices.len() / 3).sum())
    };
    scene.nodes.iter().filter_map(|node| node.mesh).map(of_mesh).sum()
}

/// Lists the devices.
pub(crate) fn devices(args: &ListArgs) -> anyhow::Result<i32> {
    let devices = evis_render::list_devices();
    if args.json {
        text::say_json(&devices)?;
        return Ok(0);
    }
    if devices.is_empty() {
        return Err(bad_input(
            "no device: no Vulkan, Metal or DirectX 12 driver was found. Install one; without a GPU, Mesa's \
             lavapipe does (Debian, Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers)",
        ));
    }
    for device in devices {
        text::say(&format!(
            "{:>2}  {}  ({}, {}; {})",
            device.index, device.name, device.kind, device.backend, device.driver
        ));
    }
    Ok(0)
}
