//! glTF 2.0, `.gltf` and `.glb`.
//!
//! The file's structure is read with the `gltf` crate's own types. Buffers, accessors and images are read here, with
//! every range checked: the crate's readers and its validation panic on malformed files (an index out of range, a
//! count of zero), and its types leave out the texture transforms of normal and occlusion maps.

mod accessor;
mod animation;
mod document;
mod file;
mod material;
mod mesh;
mod node;

use std::path::Path;

use evis_limits::Budget;

use document::{Document, parse};

use crate::error::SceneError;
use crate::model::Scene;

/// What is taken from a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Animation to play, by name or by index in digits; `None` takes the first.
    pub animation: Option<String>,
    /// The file is a scene of its own: it is validated, and gets a framing camera where it has none. Without it the
    /// file is a part of another scene, which is validated as a whole.
    pub standalone: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { animation: None, standalone: true }
    }
}

/// Reads a `.gltf` or `.glb` file, told apart by content.
///
/// Animations are clamped outside their keys; `Scene::duration_s` is the end of the chosen one. Lights are those of
/// the file: see [`Scene::needs_light`] and [`Scene::add_default_light`].
///
/// # Errors
/// A file that cannot be read; one that breaks a rule of glTF 2.0 or of [`Scene::validate`]; a required extension
/// that is not supported (named); an animation that does not exist (the existing ones are listed).
pub fn load(path: &Path, options: &Options) -> Result<Scene, SceneError> {
    let budget = Budget::default();
    let bytes = evis_limits::read_file(path, &budget)
        .map_err(|source| SceneError::Io { path: path.to_owned(), source })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut scene = read_within(&bytes, folder, options, budget).map_err(|e| match e {
        SceneError::Rule(reason) => SceneError::invalid(path, reason),
        other => other,
    })?;
    scene.name = path.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    Ok(scene)
}

/// Reads a file's bytes; files that it refers to are looked for in `folder`.
///
/// # Errors
/// As [`load`], with [`SceneError::Rule`] for content.
pub fn read(bytes: &[u8], folder: &Path, options: &Options) -> Result<Scene, SceneError> {
    read_within(bytes, folder, options, Budget::default())
}

fn read_within(bytes: &[u8], folder: &Path, options: &Options, budget: Budget) -> Result<Scene, SceneError> {
    let mut scene = Scene::default();
    let document = parse(bytes, folder, budget, &mut scene.warnings).map_err(SceneError::Rule)?;
    let animation = animation::choose(&document, options.animation.as_deref())?;
    if options.animation.is_none() {
        scene.warnings.extend(animation::unchosen(&document));
    }
    scene.animations = animation::asked_for(&document);
    scene.animation = animation.map(|index| animation::name(&document, index));
    fill(&document, folder, animation, &mut scene).map_err(SceneError::Rule)?;
    if options.standalone {
        scene.validate()?;
        scene.frame_if_unseen();
    }
    Ok(scene)
}

fn fill(
    document: &Document,
    folder: &Path,
    animation: Option<usize>,
    scene: &mut Scene,
) -> Result<(), String> {
    material::read(document, folder, scene)?;
    mesh::read(document, scene)?;
    let tracks = animation::read(document, animation, scene)?;
    node::read(document, tracks, scene)
}
