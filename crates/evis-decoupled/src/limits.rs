//! What a scene has that this method cannot show.

use evis_scene::{Material, Scene};

use crate::Error;
use crate::holes::Holes;
use crate::light::MOST_OWN;
use crate::world::fastest_hz;

/// The fastest analytic motion, in periods per second: an eighth of a period takes the shortest block.
const MOST_HZ: f64 = 1500.0;

/// The first thing in `scene` that decoupled sampling cannot show, in words that stand after "cannot show"; `None` where it
/// can show everything.
pub fn unsupported(scene: &Scene) -> Option<String> {
    let drawn = scene.nodes.iter().filter_map(|node| scene.meshes.get(node.mesh?));
    let mut seen = vec![false; scene.materials.len()];
    for primitive in drawn.flat_map(|mesh| &mesh.primitives) {
        let Some(material) = scene.materials.get(primitive.material) else { continue };
        if std::mem::replace(&mut seen[primitive.material], true) {
            continue;
        }
        if let Some(limit) = of_material(scene, material) {
            return Some(format!("material {:?}: it has {limit}", material.name));
        }
    }
    let apart = scene.lights.iter().filter(|light| light.casts_shadow || light.waveform.is_some()).count();
    if apart > MOST_OWN {
        return Some(format!(
            "{apart} lights that throw shadows or change their strength ({MOST_OWN} at most)"
        ));
    }
    let hz = fastest_hz(scene) * scene.speed.unwrap_or(1.0);
    if hz > MOST_HZ {
        return Some(format!("motion at {hz:.0} Hz ({MOST_HZ} Hz at most)"));
    }
    match Holes::of(scene, None) {
        Err(Error::Unsupported(what)) => Some(what),
        _ => None,
    }
}

fn of_material(scene: &Scene, material: &Material) -> Option<&'static str> {
    let nearest = |texture: &Option<evis_scene::TextureRef>| {
        texture.as_ref().and_then(|t| scene.textures.get(t.texture)).is_some_and(|t| t.nearest)
    };
    if nearest(&material.base_color_texture) {
        return Some("a texture without interpolation");
    }
    None
}

#[cfg(test)]
mod tests {
    use evis_scene::AlphaMode;

    use super::*;

    #[test]
    fn built_in_scenes_can_be_shown_and_what_cannot_is_named() {
        for (name, _) in evis_scene::builtin::names() {
            let scene = evis_scene::builtin::load(name, 0).unwrap();
            assert_eq!(unsupported(&scene), None, "{name}");
        }
        let scene = evis_scene::builtin::load("desk", 0).unwrap();
        let drawn = scene.nodes.iter().find_map(|n| n.mesh).unwrap();
        let material = scene.meshes[drawn].primitives[0].material;
        let mut masked = scene.clone();
        masked.materials[material].alpha = AlphaMode::Mask(0.5);
        assert_eq!(unsupported(&masked), None);
        let primitive = &mut masked.meshes[drawn].primitives[0];
        let alpha = |k: usize| [1.0, 1.0, 1.0, if k == 0 { 0.4 } else { 1.0 }];
        primitive.colors = Some((0..primitive.positions.len()).map(alpha).collect());
        assert!(unsupported(&masked).unwrap().contains("holes"));
        let mut lit = scene;
        let lamp = lit.lights[0].clone();
        lit.lights.extend((0..5).map(|_| evis_scene::Light { casts_shadow: true, ..lamp.clone() }));
        assert!(unsupported(&lit).unwrap().contains("shadows"));
    }
}
