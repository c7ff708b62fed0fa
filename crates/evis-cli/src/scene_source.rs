//! Where scenes come from: the only file that calls the loaders.

use evis_scene::{Scene, SceneError, builtin, source};

/// Names of the built-in scenes.
pub(crate) fn names() -> Vec<String> {
    builtin::names().iter().map(|(name, _)| (*name).to_owned()).collect()
}

/// Loads `source`: a built-in name, or a `.toml`, `.gltf` or `.glb` file. `seed` varies built-in scenes.
pub(crate) fn load(source: &str, seed: u64) -> anyhow::Result<Scene> {
    Ok(source::load(source, seed)?)
}

/// Loads a built-in scene to describe it; `None` where it cannot be built.
pub(crate) fn describe(name: &str) -> Result<Scene, SceneError> {
    builtin::load(name, 0)
}
