//! Where scenes come from: the only file that calls the loaders.

use std::path::Path;

use evis_scene::{Scene, SceneError, builtin, gltf, toml_scene};

use crate::failure::bad_input;

/// Names of the built-in scenes.
pub(crate) fn names() -> Vec<String> {
    builtin::names().iter().map(|name| (*name).to_string()).collect()
}

/// Loads `source`: a built-in name, or a `.toml`, `.gltf` or `.glb` file. `seed` varies built-in scenes.
pub(crate) fn load(source: &str, seed: u64) -> anyhow::Result<Scene> {
    if names().iter().any(|name| name == source) {
        return Ok(builtin::load(source, seed)?);
    }
    let path = Path::new(source);
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    match ending.as_deref() {
        Some("toml") => Ok(toml_scene::load(path)?),
        Some("gltf" | "glb") => Ok(gltf::load(path, &Default::default())?),
        _ => Err(bad_input(format!(
            "no scene '{source}'; SCENE is a built-in name ({}) or a .toml, .gltf or .glb file",
            names().join(", ")
        ))),
    }
}

/// Loads a built-in scene to describe it; `None` where it cannot be built.
pub(crate) fn describe(name: &str) -> Result<Scene, SceneError> {
    builtin::load(name, 0)
}
