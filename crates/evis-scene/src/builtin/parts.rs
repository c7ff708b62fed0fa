//! What the built-in scenes are put together from.

use glam::{DMat4, DQuat, DVec3};

use crate::builder::{Labels, SceneBuilder};
use crate::error::SceneError;
use crate::model::Primitive;
use crate::primitive::{Shape, append};
use crate::procedural::{Pattern, Procedural, hash, uniform};

/// Random choices of a scene: the `n`-th number after a seed.
pub struct Dice {
    seed: u64,
    drawn: u32,
}

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self { seed, drawn: 0 }
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f64 {
        self.drawn += 1;
        uniform(self.seed, 77, self.drawn, 0).into()
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub fn pick<T: Copy>(&mut self, from: &[T]) -> Option<T> {
        let index = (self.unit() * from.len() as f64) as usize;
        from.get(index).copied()
    }
}

/// A texture of `pattern` with its own seed.
pub fn paint(
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

pub fn labels(semantic_id: u32) -> Labels {
    Labels { semantic_id, instance_id: 0 }
}

/// Boxes and other shapes welded into one draw.
pub struct Assembly {
    pub whole: Primitive,
}

impl Assembly {
    pub fn new(material: usize) -> Self {
        Self { whole: Primitive { material, ..Primitive::default() } }
    }

    /// A box of `size` about `centre`; its picture keeps about `texture_m` metres per repeat.
    pub fn beam(
        &mut self,
        centre: [f64; 3],
        size: [f64; 3],
        texture_m: f64,
    ) -> Result<&mut Self, SceneError> {
        self.part(Shape::Box { size }, texture_m, DMat4::from_translation(centre.into()))
    }

    /// A square bar from `a` to `b`.
    pub fn bar(
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

    pub fn part(&mut self, shape: Shape, texture_m: f64, transform: DMat4) -> Result<&mut Self, SceneError> {
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
