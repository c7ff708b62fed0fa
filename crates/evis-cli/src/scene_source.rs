//! Where scenes come from: the only file that calls the loaders.

use evis_scene::source::Opening;
use evis_scene::{CameraMotionSettings, Scene, SceneError, builtin, source};

/// Names of the built-in scenes, each with what it shows.
pub(crate) fn builtins() -> &'static [(&'static str, &'static str)] {
    builtin::names()
}

/// Opens `source`: a built-in name, a `.toml`, `.gltf` or `.glb` file, or a picture. `seed` varies built-in scenes;
/// everything in it happens `speed` times as fast.
pub(crate) fn open(
    source: &str,
    seed: u64,
    speed: Option<f64>,
    camera_motion: CameraMotionSettings,
) -> Result<Scene, SceneError> {
    source::open(source, &Opening { seed, speed, camera_motion })
}

/// What is said of a scene in which nothing changes for `cameras` (all, if empty).
pub(crate) fn at_rest(scene: &Scene, cameras: &[String]) -> Option<String> {
    let remedy = "--camera-motion orbit, dolly or shake moves the camera";
    scene
        .rests(cameras)
        .then(|| format!("nothing moves and no light changes, so nothing but noise can fire: {remedy}"))
}

/// Loads a built-in scene to describe it.
pub(crate) fn describe(name: &str) -> Result<Scene, SceneError> {
    builtin::load(name, 0)
}
