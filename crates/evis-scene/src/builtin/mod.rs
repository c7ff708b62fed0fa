//! Scenes made by code: nothing to download, the same for the same seed on any machine.
//!
//! Semantic classes are those of [`class`]; every part that can be told apart is a node of its own.

mod desk;
mod spinner;
mod street;
mod tumble;
mod warehouse;

use glam::{DMat4, DQuat, DVec3};

use crate::builder::{Labels, SceneBuilder};
use crate::error::SceneError;
use crate::model::{Primitive, Scene};
use crate::primitive::{Shape, append};
use crate::procedural::{Pattern, Procedural, hash, uniform};

/// Semantic classes of the built-in scenes. 0 is what has no class: background and sky.
pub mod class {
    /// Floor, road, pavement, table top.
    pub const GROUND: u32 = 1;
    /// Walls, ceilings, buildings and what is fixed to them.
    pub const BUILDING: u32 = 2;
    /// Shelves, desks, benches.
    pub const FURNITURE: u32 = 3;
    /// Cartons, crates, pallets, barrels.
    pub const GOODS: u32 = 4;
    /// What flies, rolls or spins by itself.
    pub const MOVING: u32 = 5;
    /// Cars.
    pub const VEHICLE: u32 = 6;
    /// Lamp posts, signs, pipes.
    pub const POLE: u32 = 7;
    /// Trees and plants.
    pub const PLANT: u32 = 8;
    /// Lamps and lit signs.
    pub const LAMP: u32 = 9;
    /// Books, mugs, pens.
    pub const THING: u32 = 10;

    /// Every class with its name.
    pub const NAMES: [(u32, &str); 10] = [
        (GROUND, "ground"),
        (BUILDING, "building"),
        (FURNITURE, "furniture"),
        (GOODS, "goods"),
        (MOVING, "moving"),
        (VEHICLE, "vehicle"),
        (POLE, "pole"),
        (PLANT, "plant"),
        (LAMP, "lamp"),
        (THING, "thing"),
    ];
}

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

/// Random choices of a scene: the `n`-th number after a seed.
struct Dice {
    seed: u64,
    drawn: u32,
}

impl Dice {
    fn new(seed: u64) -> Self {
        Self { seed, drawn: 0 }
    }

    /// In [0, 1).
    fn unit(&mut self) -> f64 {
        self.drawn += 1;
        uniform(self.seed, 77, self.drawn, 0).into()
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> Option<T> {
        let index = (self.unit() * from.len() as f64) as usize;
        from.get(index).copied()
    }
}

/// A texture of `pattern` with its own seed.
fn paint(
    scene: &mut SceneBuilder,
    seed: u64,
    name: &str,
    pattern: Pattern,
    size: u32,
    colors: Option<[[f32; 3]; 2]>,
) -> Result<usize, SceneError> {
    let stream = name.bytes().fold(0u32, |h, b| h.wrapping_mul(31).wrapping_add(b.into()));
    let mut picture = Procedural::new(pattern, size, hash(seed, stream, 0, 0));
    if let Some([surface, detail]) = colors {
        picture = picture.with_colors(surface, detail);
    }
    scene.procedural(name, &picture, Default::default())
}

fn labels(semantic_id: u32) -> Labels {
    Labels { semantic_id, instance_id: 0 }
}

/// Boxes and other shapes welded into one draw.
struct Assembly {
    whole: Primitive,
}

impl Assembly {
    fn new(material: usize) -> Self {
        Self { whole: Primitive { material, ..Primitive::default() } }
    }

    /// A box of `size` about `centre`; its picture keeps about `texture_m` metres per repeat.
    fn beam(&mut self, centre: [f64; 3], size: [f64; 3], texture_m: f64) -> Result<&mut Self, SceneError> {
        self.part(Shape::Box { size }, texture_m, DMat4::from_translation(centre.into()))
    }

    /// A square bar from `a` to `b`.
    fn bar(
        &mut self,
        a: [f64; 3],
        b: [f64; 3],
        thickness: f64,
        texture_m: f64,
    ) -> Result<&mut Self, SceneError> {
        let (a, b) = (DVec3::from(a), DVec3::from(b));
        let turn = DQuat::from_rotation_arc(DVec3::Y, (b - a).normalize_or(DVec3::Y));
        let shape = Shape::Box { size: [thickness, a.distance(b), thickness] };
        self.part(shape, texture_m, DMat4::from_rotation_translation(turn, (a + b) / 2.0))
    }

    fn part(&mut self, shape: Shape, texture_m: f64, transform: DMat4) -> Result<&mut Self, SceneError> {
        let mut part = shape.build(None, [1.0, 1.0])?;
        part.tangents = None;
        if let Some(uvs) = &mut part.uvs[0] {
            // Scale each face's picture by the face's own size: u and v run along the edges in metres.
            let positions = &part.positions;
            if let Shape::Box { .. } = shape {
                for (face, corners) in uvs.chunks_exact_mut(4).zip(positions.chunks_exact(4)) {
                    let length = |a: usize, b: usize| {
                        let d: f32 = (0..3).map(|k| (corners[a][k] - corners[b][k]).powi(2)).sum();
                        d.sqrt() / texture_m as f32
                    };
                    let (along_u, along_v) = (length(0, 1), length(0, 2));
                    face.iter_mut().for_each(|uv| *uv = [uv[0] * along_u, uv[1] * along_v]);
                }
            }
        }
        append(&mut self.whole, &part, transform);
        Ok(self)
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
