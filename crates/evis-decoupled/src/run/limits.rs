//! What a scene has that this method cannot show.

use evis_scene::Scene;
use glam::DVec3;

use crate::Error;
use crate::packed::MOST_OWN;
use crate::scene::holes::{Holes, times};
use crate::scene::world::{Frame, World, fastest_hz};

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
/// Those that it always follows where crowded tiles alone are rendered: fewer are not worth a second engine.
const FEW_IN_TILES: usize = 30_000;
/// Times at which tiles are counted.
const TIMES: u32 = 9;

/// How many triangles that camera `camera` may see at the start are smaller than a pixel, where these are so many that rendering
/// costs a fraction of following each; else `None`. `size` is as in [`crate::Settings`].
///
/// # Errors
/// A camera that does not exist, or whose lens, size or pose cannot be used.
pub fn crowded(scene: &Scene, camera: usize, size: Option<(u32, u32)>) -> Result<Option<usize>, Error> {
    let lens = scene.pixel_lens(None, camera, size, 0.0)?;
    let pixels = f64::from(lens.width) * f64::from(lens.height);
    let most = FEW_SMALL.max((SMALL_PER_PIXEL * pixels) as usize);
    if triangles(scene) <= most {
        return Ok(None);
    }
    let world = World::new(scene, camera, size)?;
    let mut small = 0;
    for_each_small(&world, &world.frame(0.0)?, |_| small += 1);
    Ok((small > most).then_some(small))
}

/// Tiles of a picture in which many triangles are smaller than pixels.
#[derive(Clone, Debug)]
pub struct CrowdedTiles {
    /// Whether a tile is one of them at some time, row by row.
    pub tiles: Vec<bool>,
    /// Triangles smaller than a pixel in them, at most at any time.
    pub small: usize,
}

/// The tiles of `side` pixels in which camera `camera` may see more than `per_pixel` triangles smaller than a pixel for each pixel,
/// from `start_us` of the scene's time on. `None` where such triangles are few in all, and where the lens is distorted: its tiles
/// are not those of the picture without distortion.
///
/// Triangles are counted at nine times until the scene ends, or within one second. `size` is as in [`crate::Settings`].
///
/// # Errors
/// As [`crowded`].
pub fn crowded_tiles(
    scene: &Scene,
    camera: usize,
    size: Option<(u32, u32)>,
    start_us: i64,
    (side, per_pixel): (u32, f64),
) -> Result<Option<CrowdedTiles>, Error> {
    let lens = scene.pixel_lens(None, camera, size, 0.0)?;
    let side = side.max(1);
    let [columns, rows] = [lens.width, lens.height].map(|pixels| pixels.div_ceil(side) as usize);
    if triangles(scene) <= FEW_IN_TILES {
        return Ok(None);
    }
    let world = World::new(scene, camera, size)?;
    if world.tiles.is_some() {
        return Ok(None);
    }
    let most = (per_pixel * f64::from(side).powi(2)) as usize;
    let mut found = CrowdedTiles { tiles: vec![false; columns * rows], small: 0 };
    for (k, t_s) in times(scene, start_us as f64 * 1e-6, TIMES).enumerate() {
        let frame = match world.frame(t_s * 1e6) {
            Ok(frame) => frame,
            Err(error) if k == 0 => return Err(error),
            // Poses end before the scene does.
            Err(_) => break,
        };
        let mut counts = vec![0_usize; columns * rows];
        for_each_small(&world, &frame, |[x, y]| {
            let place = [x, y].map(|v| (v / f64::from(side)).max(0.0) as usize);
            counts[place[1].min(rows - 1) * columns + place[0].min(columns - 1)] += 1;
        });
        let mut small = 0;
        for (count, tile) in counts.into_iter().zip(&mut found.tiles).filter(|(count, _)| *count > most) {
            *tile = true;
            small += count;
        }
        found.small = found.small.max(small);
    }
    Ok((found.small > FEW_IN_TILES).then_some(found))
}

/// Triangles of a scene, those of each node.
fn triangles(scene: &Scene) -> usize {
    let of = |mesh: usize| {
        scene.meshes.get(mesh).map_or(0, |m| m.primitives.iter().map(|p| p.indices.len() / 3).sum::<usize>())
    };
    scene.nodes.iter().filter_map(|node| node.mesh).map(of).sum()
}

/// Calls `found` with a corner of each triangle in the picture that shows its front and is smaller than a pixel.
fn for_each_small(world: &World, frame: &Frame, mut found: impl FnMut([f64; 2])) {
    let [left, top, right, bottom] = world.seen();
    for (index, surface) in world.surfaces.iter().enumerate() {
        let mirrored = !surface.deforms && frame.world_from_node(surface.node).determinant() < 0.0;
        let image: Vec<DVec3> = world
            .vertices(index as u32, frame)
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
            if front && inside && area.abs() < 1.0 {
                found([a.x, a.y]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use evis_scene::motion::Path;
    use evis_scene::{Motion, Trs};

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

    #[test]
    fn tiles_are_crowded_where_triangles_are_and_at_any_time() {
        let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
        // A ball in the place of the square, which flies by from left to right.
        let node = scene.nodes.iter().rposition(|node| node.mesh.is_some()).unwrap();
        let mesh = scene.nodes[node].mesh.unwrap();
        let material = scene.meshes[mesh].primitives[0].material;
        scene.materials[material].double_sided = false;
        let start = Trs { translation: DVec3::new(-1.0, 0.0, -2.8), ..Trs::default() };
        let flight = Path::ConstantVelocity { start, velocity: DVec3::new(0.5, 0.0, 0.0) };
        scene.nodes[node].motion = Motion::Path(Arc::new(flight));
        let period_s = scene.duration_s.unwrap();
        let mut tiles_within =
            |end_s: f64, segments: [u32; 2], size: (u32, u32), side: u32, per_pixel: f64| {
                scene.duration_s = Some(end_s);
                let ball =
                    evis_scene::primitive::Shape::Sphere { radius: 0.6 }.build(Some(segments), [1.0; 2]);
                scene.meshes[mesh].primitives = vec![evis_scene::Primitive { material, ..ball.unwrap() }];
                crowded_tiles(&scene, 0, Some(size), 0, (side, per_pixel)).unwrap()
            };
        let mut tiles_of =
            |segments, size, side, per_pixel| tiles_within(period_s, segments, size, side, per_pixel);
        let fine = [400, 200];
        let found = tiles_of(fine, (64, 48), 8, 1.0).unwrap();
        assert_eq!(found.tiles.len(), 8 * 6);
        let count = |found: &CrowdedTiles| found.tiles.iter().filter(|tile| **tile).count();
        assert!((8..40).contains(&count(&found)), "{:?}", found.tiles);
        assert!(!found.tiles[0] && found.tiles[3 * 8 + 4], "{:?}", found.tiles);
        // Half of them show their back.
        assert!((40_000..85_000).contains(&found.small), "{} of 160 000", found.small);
        let fewer = tiles_of(fine, (64, 48), 8, 60.0).unwrap();
        assert!(count(&fewer) < count(&found), "{:?}", fewer.tiles);
        assert!(tiles_of(fine, (1920, 1440), 8, 1.0).is_none(), "most are larger than a pixel");
        assert!(tiles_of([200, 100], (64, 48), 8, 1.0).is_none(), "few in all");
        // At any time, not at first alone.
        let at_first = tiles_within(1e-3, fine, (64, 48), 8, 1.0).unwrap();
        assert!(2 * count(&at_first) < count(&found), "{:?} {:?}", at_first.tiles, found.tiles);
        assert!(crowded_tiles(&scene, 7, None, 0, (8, 1.0)).is_err(), "no such camera");
    }
}
