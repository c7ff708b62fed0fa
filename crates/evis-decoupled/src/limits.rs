//! What a scene has that this method cannot show.

use evis_scene::Scene;

use crate::Error;
use crate::holes::Holes;
use crate::light::MOST_OWN;
use crate::world::fastest_hz;

/// The fastest analytic motion, in periods per second: an eighth of a period takes the shortest block.
const MOST_HZ: f64 = 1500.0;

/// The first thing in `scene` that decoupled sampling cannot show, in words that stand after "cannot show"; `None` where it
/// can show everything.
pub fn unsupported(scene: &Scene) -> Option<String> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_scenes_can_be_shown_and_what_cannot_is_named() {
        for (name, _) in evis_scene::builtin::names() {
            let scene = evis_scene::builtin::load(name, 0).unwrap();
            assert_eq!(unsupported(&scene), None, "{name}");
        }
        let scene = evis_scene::builtin::load("desk", 0).unwrap();
        let mut lit = scene;
        let lamp = lit.lights[0].clone();
        lit.lights.extend((0..8).map(|_| evis_scene::Light { casts_shadow: true, ..lamp.clone() }));
        assert!(unsupported(&lit).unwrap().contains("shadows"));
    }
}
