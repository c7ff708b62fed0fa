//! glTF 2.0, `.gltf` and `.glb`.
//!
//! The file's structure is read with the `gltf` crate's own types. Buffers, accessors and images are read here, with
//! every range checked: the crate's readers and its validation panic on malformed files (an index out of range, a
//! count of zero), and its types leave out the texture transforms of normal and occlusion maps.

mod accessor;
mod animation;
mod file;
mod material;
mod mesh;
mod node;

use std::path::Path;

use ::gltf::json::Root;
use evis_limits::Budget;
use serde_json::Value;

use crate::error::SceneError;
use crate::model::Scene;

/// Extensions whose content is read. `KHR_mesh_quantization` only widens the types that accessors may have.
const SUPPORTED_EXTENSIONS: [&str; 5] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

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

/// Memory of a value of JSON, untyped and typed, bytes.
const BYTES_PER_NODE: u64 = 128;

/// A parsed file with its buffers.
struct Document {
    root: Root,
    /// The same structure untyped, for what the types leave out.
    value: Value,
    buffers: Vec<Vec<u8>>,
    /// What reading it may still allocate.
    budget: Budget,
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

fn parse(
    bytes: &[u8],
    folder: &Path,
    budget: Budget,
    warnings: &mut Vec<String>,
) -> Result<Document, String> {
    let (json, binary) = file::split(bytes)?;
    // A value of a few characters takes two nodes of a tree.
    let nodes = json.iter().filter(|b| matches!(b, b',' | b':' | b'[' | b'{')).count() as u64;
    budget.take(nodes.saturating_mul(BYTES_PER_NODE).saturating_add(2 * json.len() as u64), "its JSON")?;
    let mut value: Value =
        serde_json::from_slice(json).map_err(|e| format!("its JSON cannot be read: {e}"))?;
    let version = value.pointer("/asset/version").and_then(Value::as_str).unwrap_or("none");
    if version.split('.').next() != Some("2") {
        return Err(format!("its asset version is {version}; glTF 2.0 works"));
    }
    check_extensions(&value, warnings)?;
    complete(&mut value, warnings);
    let mut typed = value.clone();
    remove_extras(&mut typed);
    let root: Root = serde_json::from_value(typed).map_err(|e| format!("it is no valid glTF: {e}"))?;
    let buffers = root.buffers.iter().enumerate();
    let buffers =
        buffers.map(|(i, b)| file::buffer(i, b.uri.as_deref(), b.byte_length.0, folder, binary, &budget));
    Ok(Document { buffers: buffers.collect::<Result<_, _>>()?, root, value, budget })
}

fn check_extensions(value: &Value, warnings: &mut Vec<String>) -> Result<(), String> {
    let unsupported = |list: &str| -> Vec<String> {
        let names = value.get(list).and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
        names.filter(|n| !SUPPORTED_EXTENSIONS.contains(n)).map(str::to_owned).collect()
    };
    let required = unsupported("extensionsRequired");
    if !required.is_empty() {
        let supported = SUPPORTED_EXTENSIONS.join(", ");
        return Err(format!("it requires {}, which is not supported ({supported} are)", required.join(", ")));
    }
    let used = unsupported("extensionsUsed");
    if !used.is_empty() {
        warnings.push(format!("extensions that are not supported are ignored: {}", used.join(", ")));
    }
    Ok(())
}

/// Makes the structure fit the typed one where an extension allows more than the core (a channel without a node, a
/// texture without an image).
fn complete(value: &mut Value, warnings: &mut Vec<String>) {
    for animation in value.get_mut("animations").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(channels) = animation.get_mut("channels").and_then(Value::as_array_mut) {
            let before = channels.len();
            channels.retain(|c| c.pointer("/target/node").is_some());
            if channels.len() < before {
                warnings.push(format!(
                    "{} animation channels move no node and are ignored",
                    before - channels.len()
                ));
            }
        }
    }
    for texture in value.get_mut("textures").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(texture) = texture.as_object_mut() {
            // No image has this index, so the texture counts as unreadable where it is used.
            texture.entry("source").or_insert_with(|| Value::from(u32::MAX));
        }
    }
}

/// Takes away extras: they may have any type (glTF 2.0, 3.3.2), and the typed structure takes objects alone.
fn remove_extras(value: &mut Value) {
    match value {
        Value::Object(members) => {
            members.remove("extras");
            members.values_mut().for_each(remove_extras);
        }
        Value::Array(elements) => elements.iter_mut().for_each(remove_extras),
        _ => {}
    }
}

/// `'name'`, or the index where there is none.
fn label(what: &str, index: usize, name: Option<&String>) -> String {
    name.map_or_else(|| format!("{what} {index}"), |name| format!("{what} {index} '{name}'"))
}

/// The element `index` of a list, or an error that says what refers to it.
fn element<'a, T>(list: &'a [T], what: &str, index: usize, user: &str) -> Result<&'a T, String> {
    list.get(index).ok_or_else(|| format!("{user} refers to {what} {index}, but there are {}", list.len()))
}
