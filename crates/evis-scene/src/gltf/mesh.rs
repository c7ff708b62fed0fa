//! Meshes: triangles out of every topology that has a surface.

use ::gltf::json;
use ::gltf::json::accessor::Type;
use ::gltf::json::mesh::{Mode, Semantic};
use ::gltf::json::validation::Checked;

use super::document::{Document, label};
use crate::model::{Mesh, MorphTarget, Primitive, Scene};

/// Appends the file's meshes.
pub(super) fn read(document: &Document, scene: &mut Scene) -> Result<(), String> {
    for (i, source) in document.root.meshes.iter().enumerate() {
        let what = label("mesh", i, source.name.as_ref());
        let mut mesh = Mesh {
            name: source.name.clone().unwrap_or_else(|| format!("mesh {i}")),
            primitives: Vec::with_capacity(source.primitives.len()),
            morph_weights: source.weights.clone().unwrap_or_default(),
        };
        for (k, source) in source.primitives.iter().enumerate() {
            let what = format!("{what}, primitive {k}");
            mesh.primitives.extend(primitive(document, source, &what, &mut scene.warnings)?);
        }
        let targets = mesh.primitives.first().map_or(0, |p| p.morph_targets.len());
        if mesh.primitives.is_empty() {
            mesh.morph_weights.clear();
        } else if mesh.morph_weights.len() < targets {
            mesh.morph_weights.resize(targets, 0.0);
        }
        scene.meshes.push(mesh);
    }
    Ok(())
}

/// `None`, with a warning, where there is no surface.
fn primitive(
    document: &Document,
    source: &json::mesh::Primitive,
    what: &str,
    warnings: &mut Vec<String>,
) -> Result<Option<Primitive>, String> {
    let mode = match source.mode {
        Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => mode,
        Checked::Valid(_) => {
            warnings.push(format!("{what} is made of points or lines and is not drawn"));
            return Ok(None);
        }
        Checked::Invalid => return Err(format!("{what} has an unknown mode")),
    };
    let attribute = |semantic: Semantic| source.attributes.get(&Checked::Valid(semantic)).map(|a| a.value());
    let Some(positions) = attribute(Semantic::Positions) else {
        warnings.push(format!("{what} has no positions and is not drawn"));
        return Ok(None);
    };
    let positions: Vec<[f32; 3]> =
        document.elements(positions, &[Type::Vec3], &format!("positions of {what}"))?.vectors(false);
    let count = positions.len();

    let elements = |semantic: Semantic, types: &[Type]| {
        let Some(accessor) = attribute(semantic.clone()) else { return Ok(None) };
        let user = format!("{semantic:?} of {what}");
        let elements = document.elements(accessor, types, &user)?;
        if elements.count != count {
            return Err(format!("{user} has {} elements for {count} positions", elements.count));
        }
        Ok(Some(elements))
    };
    let normals = elements(Semantic::Normals, &[Type::Vec3])?.map(|e| e.vectors(false));
    let tangents = elements(Semantic::Tangents, &[Type::Vec4])?.map(|e| e.vectors(false));
    let uv =
        |set| Ok::<_, String>(elements(Semantic::TexCoords(set), &[Type::Vec2])?.map(|e| e.vectors(false)));
    let colors = elements(Semantic::Colors(0), &[Type::Vec3, Type::Vec4])?.map(|e| {
        let opaque = |c: &[f32]| [c[0], c[1], c[2], c.get(3).copied().unwrap_or(1.0)];
        e.floats(true).chunks_exact(e.width).map(opaque).collect()
    });
    let joints = match elements(Semantic::Joints(0), &[Type::Vec4])? {
        Some(e) => Some(joint_sets(&e.integers()?, what)?),
        None => None,
    };
    let joint_weights = elements(Semantic::Weights(0), &[Type::Vec4])?.map(|e| e.vectors(true));
    if attribute(Semantic::Joints(1)).is_some() {
        warnings.push(format!("{what} has more than four joints per vertex; the first four deform it"));
    }

    let targets = source.targets.iter().flatten().enumerate();
    let morph_targets =
        targets.map(|(k, t)| morph_target(document, t, count, &format!("morph target {k} of {what}")));
    let morph_targets = morph_targets.collect::<Result<_, _>>()?;

    let order = match source.indices {
        Some(accessor) => {
            let user = format!("indices of {what}");
            let order = document.elements(accessor.value(), &[Type::Scalar], &user)?.integers()?;
            match order.iter().find(|i| **i as usize >= count) {
                Some(i) => return Err(format!("{user} hold {i}, but there are {count} vertices")),
                None => order,
            }
        }
        None => {
            document.budget.take_values::<u32>(count as u64, what)?;
            (0..u32::try_from(count).map_err(|_| format!("{what} has {count} vertices"))?).collect()
        }
    };
    if mode != Mode::Triangles {
        document.budget.take_values::<[u32; 3]>(order.len() as u64, what)?;
    }
    Ok(Some(Primitive {
        // Without a material: the default one, which follows the file's own.
        material: source.material.map_or(document.root.materials.len(), |m| m.value()),
        positions,
        normals: normals.unwrap_or_default(),
        tangents,
        uvs: [uv(0)?, uv(1)?],
        colors,
        joints,
        joint_weights,
        morph_targets,
        indices: triangles(order, mode, what, warnings),
    }))
}

fn joint_sets(indices: &[u32], what: &str) -> Result<Vec<[u16; 4]>, String> {
    let narrow =
        |i: &u32| u16::try_from(*i).map_err(|_| format!("{what} is moved by joint {i}; 65535 is the last"));
    let narrowed: Vec<u16> = indices.iter().map(narrow).collect::<Result<_, _>>()?;
    Ok(narrowed.chunks_exact(4).filter_map(|c| c.try_into().ok()).collect())
}

fn morph_target(
    document: &Document,
    source: &json::mesh::MorphTarget,
    count: usize,
    what: &str,
) -> Result<MorphTarget, String> {
    let read = |accessor: Option<json::Index<json::Accessor>>, part: &str| {
        let Some(accessor) = accessor else {
            document.budget.take_values::<[f32; 3]>(count as u64, what)?;
            return Ok(vec![[0.0; 3]; count]);
        };
        let user = format!("{part} of {what}");
        let elements = document.elements(accessor.value(), &[Type::Vec3], &user)?;
        if elements.count == count {
            Ok(elements.vectors(false))
        } else {
            Err(format!("{user} have {} elements for {count} positions", elements.count))
        }
    };
    Ok(MorphTarget {
        positions: read(source.positions, "positions")?,
        normals: read(source.normals, "normals")?,
    })
}

/// Triangle list out of strips and fans (glTF 2.0, 3.7.2.1), with the same winding.
fn triangles(mut order: Vec<u32>, mode: Mode, what: &str, warnings: &mut Vec<String>) -> Vec<u32> {
    match mode {
        Mode::TriangleStrip => {
            let corners = order.windows(3).enumerate();
            corners
                .flat_map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] })
                .collect()
        }
        Mode::TriangleFan => {
            let first = order.first().copied().unwrap_or_default();
            order.get(1..).unwrap_or_default().windows(2).flat_map(|w| [w[0], w[1], first]).collect()
        }
        _ => {
            if !order.len().is_multiple_of(3) {
                warnings.push(format!("{what} ends within a triangle, which is left out"));
                order.truncate(order.len() / 3 * 3);
            }
            order
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_become_lists() {
        let mut warnings = Vec::new();
        let order = vec![10, 11, 12, 13, 14];
        let mut list = |mode| triangles(order.clone(), mode, "it", &mut warnings);
        assert_eq!(list(Mode::TriangleStrip), [10, 11, 12, 11, 13, 12, 12, 13, 14]);
        assert_eq!(list(Mode::TriangleFan), [11, 12, 10, 12, 13, 10, 13, 14, 10]);
        assert_eq!(list(Mode::Triangles), [10, 11, 12]);
        assert_eq!(warnings.len(), 1);
        assert!(triangles(vec![], Mode::TriangleFan, "it", &mut warnings).is_empty());
    }
}
