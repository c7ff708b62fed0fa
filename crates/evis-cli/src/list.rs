//! `scenes`, `sensors` and `devices`.

use evis_core::sensor::PRESETS;
use serde::Serialize;

use crate::args::ListArgs;
use crate::failure::bad_input;
use crate::{scene_source, text};

#[derive(Serialize)]
struct SceneLine {
    name: &'static str,
    shows: &'static str,
    duration_s: Option<f64>,
    cameras: Vec<String>,
    environments: usize,
    triangles: usize,
}

/// Lists the built-in scenes.
pub(crate) fn scenes(args: &ListArgs) -> anyhow::Result<i32> {
    let mut lines = Vec::new();
    for (name, shows) in scene_source::builtins() {
        let scene = scene_source::describe(name)?;
        lines.push(SceneLine {
            name,
            shows,
            duration_s: scene.duration_s,
            cameras: scene.cameras.iter().map(|c| c.name.clone()).collect(),
            environments: scene.variants.len().max(1),
            triangles: scene_source::triangles(&scene),
        });
    }
    if args.json {
        text::say_json(&lines)?;
        return Ok(0);
    }
    for line in lines {
        text::say(&format!(
            "{}: {}\n    {} triangles, cameras: {}",
            line.name,
            line.shows,
            text::grouped(line.triangles as u64),
            line.cameras.join(", ")
        ));
    }
    Ok(0)
}

#[derive(Serialize)]
struct SensorLine {
    name: &'static str,
    source: &'static str,
    models: Vec<String>,
}

/// Lists the sensor presets.
pub(crate) fn sensors(args: &ListArgs) -> anyhow::Result<i32> {
    let lines: Vec<_> = PRESETS
        .iter()
        .map(|preset| SensorLine {
            name: preset.name,
            source: preset.source,
            models: preset.sensor().models(),
        })
        .collect();
    if args.json {
        text::say_json(&lines)?;
        return Ok(0);
    }
    for line in lines {
        text::say(&format!(
            "{}\n{}",
            line.name,
            text::wrapped(&format!("models {}", line.models.join(", ")), 4)
        ));
        text::say(&text::wrapped(&format!("source: {}", line.source), 4));
    }
    Ok(0)
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
