//! A scene by what a user calls it: a built-in name, or a file.

use std::path::Path;

use crate::environment::Environment;
use crate::{CameraMotionSettings, Scene, SceneError, builtin, gltf, picture, toml_scene};

/// How a scene is opened.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Opening {
    /// Varies built-in scenes.
    pub seed: u64,
    /// Which of a glTF file's animations plays, by name or by index in digits; `None` plays the first.
    pub animation: Option<String>,
    /// See [`Scene::at_speed`]; `None` for 1.
    pub speed: Option<f64>,
    /// See [`Scene::move_cameras`].
    pub camera_motion: CameraMotionSettings,
}

/// Loads `source` as [`load`] does, and moves its cameras as [`Scene::move_cameras`] does: a file that has neither a
/// camera nor any motion gets both.
///
/// # Errors
/// As [`load`], [`Scene::move_cameras`] and [`Scene::at_speed`].
pub fn open(source: &str, opening: &Opening) -> Result<Scene, SceneError> {
    open_with(source, opening, |_| Ok(()))
}

/// As [`open`], with `simulate` between loading and moving: it makes motion of rigid bodies, as `evis_physics::simulate`
/// does.
///
/// # Errors
/// As [`open`], and those of `simulate`.
pub fn open_with(
    source: &str,
    opening: &Opening,
    simulate: impl FnOnce(&mut Scene) -> Result<(), SceneError>,
) -> Result<Scene, SceneError> {
    let mut scene = load_with_animation(source, opening.seed, opening.animation.as_deref())?;
    simulate(&mut scene)?;
    scene.move_cameras(&opening.camera_motion)?;
    scene.at_speed(opening.speed.unwrap_or(1.0))
}

/// Loads `source`: a built-in name, a `.toml`, `.gltf` or `.glb` file, or a picture ([`picture::load`]). `seed` varies
/// built-in scenes. Nothing is moved that the file does not move: [`open`] does that.
///
/// A glTF file needs nothing else: where it has no camera, one that frames it is added; where nothing lights
/// surfaces that answer light, the studio does ([`Environment::studio`]), and a warning says so.
///
/// # Errors
/// Unknown names (the ones that exist are listed), unreadable and invalid files.
pub fn load(source: &str, seed: u64) -> Result<Scene, SceneError> {
    load_with_animation(source, seed, None)
}

/// The same, where `animation` (by name, or by index in digits) of a glTF file plays instead of the first.
///
/// # Errors
/// As [`load`]; an animation that does not exist (the ones that do are listed), and one of what is no glTF file.
pub fn load_with_animation(source: &str, seed: u64, animation: Option<&str>) -> Result<Scene, SceneError> {
    let path = Path::new(source);
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if let Some(animation) = animation
        && !matches!(ending.as_deref(), Some("gltf" | "glb"))
    {
        return Err(SceneError::Rule(format!(
            "animation is '{animation}', but {source} is no .gltf or .glb file; leave it out (a scene file names \
             animations in its [[gltf]] tables)"
        )));
    }
    if builtin::names().iter().any(|(name, _)| *name == source) {
        return builtin::load(source, seed);
    }
    match ending.as_deref() {
        Some("toml") => toml_scene::load(path),
        Some("gltf" | "glb") => {
            let options =
                gltf::Options { animation: animation.map(str::to_owned), ..gltf::Options::default() };
            let mut scene = gltf::load(path, &options)?;
            scene.warnings.extend(scene.unlikely_model_size());
            if scene.needs_light() && scene.environment.is_none() {
                scene.warnings.push("no light in the file: lit by the built-in studio".into());
                scene.environment = Some(Environment::studio());
            }
            Ok(scene)
        }
        Some(ending) if picture::ENDINGS.contains(&ending) => picture::load(path),
        _ => Err(SceneError::Unknown {
            what: "scene (a built-in name, a .toml, .gltf or .glb file, or a .png, .jpg, .hdr, .exr or .tif picture)",
            name: source.into(),
            known: builtin::names().iter().map(|(name, _)| (*name).to_owned()).collect(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_names_list_what_there_is() {
        let text = load("warehuose", 0).unwrap_err().to_string();
        assert!(text.contains("warehuose") && text.contains("warehouse"), "{text}");
        assert!(load("missing.glb", 0).unwrap_err().to_string().contains("missing.glb"));
    }
}
