//! The chosen animation as curves per node.

use std::collections::HashMap;

use ::gltf::json;
use ::gltf::json::accessor::Type;
use ::gltf::json::animation::{Interpolation as Rule, Property};
use ::gltf::json::validation::Checked;

use super::document::{Document, element, label};
use crate::error::SceneError;
use crate::model::Scene;
use crate::motion::{Curve, Interpolation};

/// Curves of one node.
#[derive(Default)]
pub(super) struct Track {
    pub translation: Option<Curve>,
    pub rotation: Option<Curve>,
    pub scale: Option<Curve>,
    pub weights: Option<Curve>,
}

/// By the file's node index.
pub(super) type Tracks = HashMap<usize, Track>;

/// Index of the animation asked for; the first where none is.
pub(super) fn choose(document: &Document, asked: Option<&str>) -> Result<Option<usize>, SceneError> {
    let animations = &document.root.animations;
    let Some(asked) = asked else { return Ok((!animations.is_empty()).then_some(0)) };
    let by_name = animations.iter().position(|a| a.name.as_deref() == Some(asked));
    let by_index = || asked.parse().ok().filter(|i| *i < animations.len());
    by_name.or_else(by_index).map(Some).ok_or_else(|| SceneError::Unknown {
        what: "animation",
        name: asked.into(),
        known: names(document).collect(),
    })
}

/// What animations are asked for by: their names, else their indices.
fn names(document: &Document) -> impl Iterator<Item = String> {
    let animations = document.root.animations.iter().enumerate();
    animations.map(|(i, animation)| animation.name.clone().unwrap_or_else(|| i.to_string()))
}

/// What animation `index` is asked for by: its index, where another animation has its name.
pub(super) fn name(document: &Document, index: usize) -> String {
    let name = names(document).nth(index).unwrap_or_default();
    match choose(document, Some(&name)) {
        Ok(Some(found)) if found == index => name,
        _ => index.to_string(),
    }
}

/// What each animation is asked for by.
pub(super) fn asked_for(document: &Document) -> Vec<String> {
    (0..document.root.animations.len()).map(|index| name(document, index)).collect()
}

/// What is said where the first of several animations plays because nobody chose one.
pub(super) fn unchosen(document: &Document) -> Option<String> {
    let mut names = names(document);
    let (first, others) = (names.next()?, names.collect::<Vec<_>>());
    (!others.is_empty()).then(|| {
        format!("animation '{first}' plays; `animation` chooses another of the file: {}", others.join(", "))
    })
}

/// Curves of animation `index`; sets the scene's duration.
pub(super) fn read(document: &Document, index: Option<usize>, scene: &mut Scene) -> Result<Tracks, String> {
    let mut tracks = Tracks::new();
    let Some((index, animation)) = index.and_then(|i| Some((i, document.root.animations.get(i)?))) else {
        return Ok(tracks);
    };
    let mut end_s = 0.0_f64;
    for (c, channel) in animation.channels.iter().enumerate() {
        let user = format!("{}, channel {c}", label("animation", index, animation.name.as_ref()));
        let node_index = channel.target.node.value();
        let node = element(&document.root.nodes, "node", node_index, &user)?;
        let sampler = element(&animation.samplers, "sampler", channel.sampler.value(), &user)?;
        let Checked::Valid(property) = channel.target.path else {
            scene.warnings.push(format!("{user} moves an unknown property and is ignored"));
            continue;
        };
        let width = match property {
            Property::Translation | Property::Scale => 3,
            Property::Rotation => 4,
            Property::MorphTargetWeights => {
                let mesh = node.mesh.and_then(|m| scene.meshes.get(m.value()));
                mesh.map_or(0, |m| m.morph_weights.len())
            }
        };
        if width == 0 {
            scene
                .warnings
                .push(format!("{user} drives morph weights of a node without targets and is ignored"));
            continue;
        }
        let curve = read_curve(document, sampler, property, width, &user, &mut scene.warnings)?;
        end_s = end_s.max(curve.times.last().copied().unwrap_or(0.0));
        let track = tracks.entry(node_index).or_default();
        let slot = match property {
            Property::Translation => &mut track.translation,
            Property::Rotation => &mut track.rotation,
            Property::Scale => &mut track.scale,
            Property::MorphTargetWeights => &mut track.weights,
        };
        *slot = Some(curve);
    }
    scene.duration_s = Some(end_s);
    Ok(tracks)
}

fn read_curve(
    document: &Document,
    sampler: &json::animation::Sampler,
    property: Property,
    width: usize,
    user: &str,
    warnings: &mut Vec<String>,
) -> Result<Curve, String> {
    let interpolation = match sampler.interpolation {
        Checked::Valid(Rule::Linear) => Interpolation::Linear,
        Checked::Valid(Rule::Step) => Interpolation::Step,
        Checked::Valid(Rule::CubicSpline) => Interpolation::CubicSpline,
        Checked::Invalid => return Err(format!("{user} has an unknown interpolation")),
    };
    let times = document.elements(sampler.input.value(), &[Type::Scalar], user)?.floats(false);
    let type_ = match property {
        Property::Translation | Property::Scale => Type::Vec3,
        Property::Rotation => Type::Vec4,
        Property::MorphTargetWeights => Type::Scalar,
    };
    // Integers are always normalised here: glTF 2.0, 3.11 allows no others.
    let always_normalized = matches!(property, Property::Rotation | Property::MorphTargetWeights);
    let values = document.elements(sampler.output.value(), &[type_], user)?.floats(always_normalized);
    document.budget.take_values::<f64>((times.len() + values.len()) as u64, user)?;
    let mut curve = Curve {
        times: times.into_iter().map(f64::from).collect(),
        values: values.into_iter().map(f64::from).collect(),
        width,
        interpolation,
    };
    let row = width * if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
    if curve.times.windows(2).any(|w| w[0] == w[1]) && curve.values.len() == row * curve.times.len() {
        // Some exporters repeat a key; the later one holds from there on.
        let keep: Vec<usize> =
            (0..curve.times.len()).filter(|&k| curve.times.get(k + 1) != Some(&curve.times[k])).collect();
        warnings.push(format!(
            "{user} repeats {} key times; the last of each counts",
            curve.times.len() - keep.len()
        ));
        curve.values =
            keep.iter().flat_map(|k| curve.values[k * row..(k + 1) * row].iter().copied()).collect();
        curve.times = keep.iter().map(|k| curve.times[*k]).collect();
    }
    curve.check().map_err(|reason| format!("{user}: {reason}"))?;
    Ok(curve)
}
