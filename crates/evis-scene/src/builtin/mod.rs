//! Scenes made by code: nothing to download, the same for the same seed on any machine.
//!
//! Semantic classes are those of [`class`]; every part that can be told apart is a node of its own.

pub mod class;
mod desk;
mod parts;
mod spinner;
mod street;
mod tumble;
mod warehouse;

use crate::error::SceneError;
use crate::model::Scene;

type Load = fn(u64) -> Result<Scene, SceneError>;

const SCENES: [(&str, Load); 5] = [
    ("warehouse", warehouse::load),
    ("spinner", spinner::load),
    ("street", street::load),
    ("desk", desk::load),
    ("tumble", tumble::load),
];

const NAMES: [(&str, &str); 5] = [
    (
        "warehouse",
        "shelves full of cartons, several lights, thrown objects, a camera on a figure eight (4 s)",
    ),
    (
        "spinner",
        "a spinning, moving square before a textured plane, a moving and turning camera (4 s, unlit)",
    ),
    ("street", "a drive along a street with facades, poles, trees and cars (6 s)"),
    ("desk", "a still camera before a desk on which one toy moves (4 s)"),
    ("tumble", "rigid bodies, dropped and thrown, that collide before a still camera (1 s)"),
];

/// Names and one-line descriptions.
pub fn names() -> &'static [(&'static str, &'static str)] {
    &NAMES
}

/// The built-in scene `name`; `seed` changes its textures and what lies where. The bodies of `tumble` are still to be
/// simulated: `evis_physics::load` does both.
///
/// # Errors
/// A name that does not exist; the ones that do are listed.
pub fn load(name: &str, seed: u64) -> Result<Scene, SceneError> {
    match SCENES.iter().find(|(n, _)| *n == name) {
        Some((_, load)) => {
            let mut scene = load(seed)?;
            scene.class_names = class::NAMES.map(|(id, name)| (id, name.to_owned())).into();
            Ok(scene)
        }
        None => Err(SceneError::Unknown {
            what: "built-in scene",
            name: name.into(),
            known: NAMES.iter().map(|(n, _)| (*n).into()).collect(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_loads_and_unknown_names_are_told_what_exists() {
        for (name, _) in names() {
            assert_eq!(&load(name, 1).map(|s| s.name).unwrap_or_default(), name);
        }
        let message = load("wharehouse", 0).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(
            message.contains("'wharehouse'") && message.contains("warehouse, spinner, street, desk, tumble"),
            "{message}"
        );
    }
}
