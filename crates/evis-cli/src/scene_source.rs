//! Where scenes come from: the only file that calls the loaders.

use std::path::Path;

use evis_scene::source::Opening;
use evis_scene::{Scene, SceneError, SceneState, builtin};

use crate::options;

/// Names of the built-in scenes, each with what it shows.
pub(crate) fn builtins() -> &'static [(&'static str, &'static str)] {
    builtin::names()
}

/// Opens `source`: a built-in name, a `.toml`, `.gltf` or `.glb` file, or a picture.
pub(crate) fn open(source: &str, opening: &Opening) -> Result<Scene, SceneError> {
    if is_film(source) {
        return Err(SceneError::Rule(format!(
            "{source} is a film, or frames, and no scene; `video {source} -o OUT.h5` turns it into events"
        )));
    }
    if is_named_as_recording(source) {
        return Err(SceneError::Rule(format!(
            "{source} is a file of events, and no scene; `info {source}` and `preview {source} -o OUT.png` show it, and \
             `run SCENE --settings {source}` simulates with its settings"
        )));
    }
    let mut scene = evis_physics::open(source, opening)?;
    for warning in &mut scene.warnings {
        *warning = options::in_text(warning);
    }
    Ok(scene)
}

/// Endings of films, and of arrays of frames.
const FILMS: [&str; 12] =
    ["mp4", "m4v", "mov", "avi", "mkv", "webm", "mpg", "mpeg", "wmv", "ogv", "gif", "npy"];

/// Whether `source` is what `video` takes and no scene.
fn is_film(source: &str) -> bool {
    let path = Path::new(source);
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| FILMS.contains(&ending.as_str())) || path.is_dir()
}

/// Whether `source` is a file with the ending of a recording.
fn is_named_as_recording(source: &str) -> bool {
    let path = Path::new(source);
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    path.is_file() && ending.is_some_and(|ending| ["h5", "hdf5"].contains(&ending.as_str()))
}

/// What is said of a scene in which nothing changes for `cameras` (all, if empty).
pub(crate) fn at_rest(scene: &Scene, cameras: &[String]) -> Option<String> {
    let remedy = "--camera-motion orbit, dolly or shake moves the camera";
    scene
        .rests(cameras)
        .then(|| format!("nothing moves and no light changes, so nothing but noise can fire: {remedy}"))
}

/// How long the scene says that it lasts.
pub(crate) fn own_duration_s(scene: &Scene) -> Option<f64> {
    scene.duration_s.filter(|s| s.is_finite() && *s > 0.0)
}

/// When motion ends, where that is before `time_s`, as far as some times say; motion by formulas goes on.
pub(crate) fn rests_before(scene: &Scene, time_s: f64) -> Option<f64> {
    let end_s = own_duration_s(scene).filter(|end_s| time_s > end_s + 1.0e-6)?;
    let at = |time_s: f64| {
        let mut state = SceneState::default();
        scene.evaluate(time_s, &mut state);
        state
    };
    let end = at(end_s);
    // No multiples of each other: what comes back is seen elsewhere at one of them.
    [0.013, 0.37, 1.0, 2.9].iter().all(|later| at(end_s + later) == end).then_some(end_s)
}

/// Loads a built-in scene to describe it.
pub(crate) fn describe(name: &str) -> Result<Scene, SceneError> {
    evis_physics::load(name, 0, None)
}

/// Triangles drawn at one instant, a mesh counted once per node that carries it.
pub(crate) fn triangles(scene: &Scene) -> usize {
    let of_mesh = |index: usize| {
        scene.meshes.get(index).map_or(0, |mesh| mesh.primitives.iter().map(|p| p.indices.len() / 3).sum())
    };
    scene.nodes.iter().filter_map(|node| node.mesh).map(of_mesh).sum()
}
