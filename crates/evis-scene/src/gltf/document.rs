//! The structure of a file, typed and untyped, with its buffers.

use std::path::Path;

use ::gltf::json::Root;
use evis_limits::Budget;
use serde_json::Value;

use super::file;

/// Extensions whose content is read. `KHR_mesh_quantization` only widens the types that accessors may have.
const SUPPORTED_EXTENSIONS: [&str; 5] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Memory of a value of JSON, untyped and typed, bytes.
const BYTES_PER_NODE: u64 = 128;

/// A parsed file with its buffers.
pub(super) struct Document {
    pub root: Root,
    /// The same structure untyped, for what the types leave out.
    pub value: Value,
    pub buffers: Vec<Vec<u8>>,
    /// What reading it may still allocate.
    pub budget: Budget,
}

/// Reads a file's structure and its buffers.
pub(super) fn parse(
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
pub(super) fn label(what: &str, index: usize, name: Option<&String>) -> String {
    name.map_or_else(|| format!("{what} {index}"), |name| format!("{what} {index} '{name}'"))
}

/// The element `index` of a list, or an error that says what refers to it.
pub(super) fn element<'a, T>(list: &'a [T], what: &str, index: usize, user: &str) -> Result<&'a T, String> {
    list.get(index).ok_or_else(|| format!("{user} refers to {what} {index}, but there are {}", list.len()))
}
