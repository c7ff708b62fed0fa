//! What a scene has that this method cannot show.

use evis_scene::Scene;
use glam::DVec3;

use crate::Error;
use crate::scene::holes::Holes;
use crate::scene::world::{World, fastest_hz};
use crate::shading::light::MOST_OWN;

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

/// Triangles smaller than a pixel that decoupled sampling always follows.
const FEW_SMALL: usize = 10_000;
/// Above that, how many per pixel of the picture.
const SMALL_PER_PIXEL: f64 = 0.25;

/// How many triangles that camera `camera` may see at the start are smaller than a pixel, where these are so many that rendering
/// costs a fraction of following each; else `None`. `size` is as in [`crate::Settings`].
///
/// # Errors
/// A camera that does not exist, or whose lens, size or pose cannot be used.
pub fn crowded(scene: &Scene, camera: usize, size: Option<(u32, u32)>) -> Result<Option<usize>, Error> {
    let triangles_of = |mesh: usize| {
        scene.meshes.get(mesh).map_or(0, |m| m.primitives.iter().map(|p| p.indices.len() / 3).sum())
    };
    let all: usize = scene.nodes.iter().filter_map(|node| node.mesh).map(triangles_of).sum();
    let lens = scene.pixel_lens(None, camera, size, 0.0)?;
    let pixels = f64::from(lens.width) * f64::from(lens.height);
    let most = FEW_SMALL.max((SMALL_PER_PIXEL * pixels) as usize);
    if all <= most {
        return Ok(None);
    }
    let world = World::new(scene, camera, size)?;
    let frame = world.frame(0.0)?;
    let [left, top, right, bottom] = world.seen();
    let mut small = 0;
    for (index, surface) in world.surfaces.iter().enumerate() {
        let mirrored = !surface.deforms && frame.world_from_node(surface.node).determinant() < 0.0;
        let image: Vec<DVec3> = world
            .vertices(index as u32, &frame)
            .iter()
            .map(|(place, _)| frame.screen_from_world.point(*place))
            .map(|h| {
                if h.z > frame.depths.near && h.z < frame.depths.far {
                    DVec3::new(h.x / h.z, h.y / h.z, 1.0)
                } else {
                    DVec3::NAN
                }
            })
            .collect();
        for triangle in world.primitive(index as u32).indices.as_chunks::<3>().0 {
            let [Some(a), Some(b), Some(c)] = triangle.map(|v| image.get(v as usize)) else { continue };
            // Counter-clockwise is below 0 where y runs down; what is nearer than the near plane is no number.
            let area = 0.5 * (b - a).cross(c - a).z * if mirrored { -1.0 } else { 1.0 };
            let front = area < 0.0 || surface.double_sided;
            let inside = a.x > left && a.x < right && a.y > top && a.y < bottom;
            small += usize::from(front && inside && area.abs() < 1.0);
        }
    }
    Ok((small > most).then_some(small))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::facets::{bounding_box, wide};

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

    #[test]
    fn a_mesh_finer_than_pixels_is_crowded_and_one_that_is_not_is_not() {
        let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
        let node = scene.nodes.iter().position(|node| node.mesh.is_some()).unwrap();
        let mesh = scene.nodes[node].mesh.unwrap();
        let card = scene.meshes[mesh].primitives[0].clone();
        // The card as a grid of `n` by `n` squares.
        let grid = |n: u32| {
            let mut fine = evis_scene::Primitive { material: card.material, ..Default::default() };
            let [low, high] = bounding_box(card.positions.iter().map(|p| wide(*p)));
            for (j, i) in (0..=n).flat_map(|j| (0..=n).map(move |i| (j, i))) {
                let at = DVec3::new(f64::from(i), f64::from(j), 0.0) / f64::from(n);
                fine.positions.push((low + (high - low) * at).as_vec3().to_array());
                fine.normals.push([0.0, 0.0, 1.0]);
            }
            for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
                let (a, row) = (j * (n + 1) + i, n + 1);
                fine.indices.extend([a, a + 1, a + 1 + row, a, a + 1 + row, a + row]);
            }
            fine
        };
        let mut small_of = |n: u32, size: (u32, u32)| {
            scene.meshes[mesh].primitives = vec![grid(n)];
            crowded(&scene, 0, Some(size)).unwrap()
        };
        assert_eq!(small_of(60, (64, 48)), None, "7 200 triangles");
        assert_eq!(small_of(100, (64, 48)), None, "20 000 triangles, most of them beside the picture");
        let small = small_of(200, (64, 48)).unwrap();
        assert!((10_000..40_000).contains(&small), "{small} of 80 000 triangles");
        assert_eq!(small_of(200, (1280, 960)), None, "more pixels than triangles");
        assert!(crowded(&scene, 7, None).is_err(), "no such camera");
    }
}
