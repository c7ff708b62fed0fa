//! Where scenes come from: the only file that calls the loaders.

use evis_scene::{Scene, SceneError, builtin, source};

/// Names of the built-in scenes, each with what it shows.
pub(crate) fn builtins() -> &'static [(&'static str, &'static str)] {
    builtin::names()
}

/// Loads `source`: a built-in name, or a `.toml`, `.gltf` or `.glb` file. `seed` varies built-in scenes; everything in it
/// happens `speed` times as fast.
pub(crate) fn load(source: &str, seed: u64, speed: Option<f64>) -> anyhow::Result<Scene> {
    Ok(source::load(source, seed)?.at_speed(speed.unwrap_or(1.0))?)
}

/// Loads a built-in scene to describe it.
pub(crate) fn describe(name: &str) -> Result<Scene, SceneError> {
    builtin::load(name, 0)
}
