//! Scenes that are probably a mistake: a camera inside a model, a model of an unlikely size, an image that moves too fast.

use glam::{DMat4, DVec3};

use crate::model::Scene;
use crate::pixel_lens::PixelLens;
use crate::pose::SceneState;
use crate::visible::hit;

/// Largest side of a likely scene, metres.
const LIKELY_M: std::ops::RangeInclusive<f64> = 1.0e-3..=1.0e4;

/// Largest side of a likely model that comes without a camera, metres: more than rooms have.
const LIKELY_MODEL_M: f64 = 50.0;

/// Times of a stream at which image motion is measured.
const MOTION_SAMPLES: u32 = 6;

/// Why a camera does not show what its scene holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enclosure {
    /// The surfaces around it face away, and their backs are not drawn.
    Undrawn,
    /// It shows nothing but the inside of one mesh, and the rest of the scene lies outside.
    Alone,
}

/// The surface that a direction meets first.
#[derive(Clone, Copy)]
struct Nearest {
    depth: f64,
    is_front: bool,
    both: bool,
}

impl Scene {
    /// A warning about a scene whose unit is probably not the metre: one below a millimetre, or beyond 10 km.
    pub fn unlikely_size(&self) -> Option<String> {
        let (low, high) = self.bounds(0.0)?;
        unlikely_size((high - low).max_element())
    }

    /// A warning about a model without a camera of its own that is far larger than a room, though its unit may be the metre.
    /// Events do not tell, since the camera that is added frames it; depth and poses do.
    pub fn unlikely_model_size(&self) -> Option<String> {
        let (low, high) = self.bounds(0.0).filter(|_| self.framing.is_some())?;
        unlikely_model_size((high - low).max_element())
    }

    /// What is said of the camera `camera` where it is inside a mesh at `t_s`; `None` where it is not, and where it is in a
    /// room. Decided for poses of the scene itself, not of its variants.
    ///
    /// It is inside where every direction meets the back of the mesh first. In a room that is modelled from within, the
    /// fronts surround it. A mesh that is drawn from both sides is a room where anything else is in it, or nothing else is
    /// outside of it.
    pub fn enclosed_camera(&self, camera: usize, t_s: f64) -> Option<String> {
        let (node, enclosure) = self.enclosure(camera, t_s)?;
        let camera = &self.cameras.get(camera)?.name;
        let node = self.nodes.get(node).map(|node| node.name.as_str()).filter(|name| !name.is_empty());
        let mesh = node.map_or_else(|| "a mesh without a name".to_owned(), |name| format!("'{name}'"));
        Some(match enclosure {
            Enclosure::Undrawn => format!(
                "camera '{camera}' starts inside {mesh}, whose surfaces face outwards and are not drawn from within; move \
                 it out, or make the material double-sided"
            ),
            Enclosure::Alone => format!(
                "camera '{camera}' starts inside {mesh} and shows nothing else of the scene; move it out"
            ),
        })
    }

    /// The node whose mesh encloses the camera at `t_s`.
    pub(crate) fn enclosure(&self, camera: usize, t_s: f64) -> Option<(usize, Enclosure)> {
        let mut state = SceneState::default();
        self.evaluate(t_s, &mut state);
        let eye = self.world_from_camera(camera, &state)?.w_axis.truncate();
        // Boxes first: most meshes are not around the camera.
        let mut boxes: Vec<Option<(DVec3, DVec3)>> = vec![None; self.nodes.len()];
        self.visit_triangles(t_s, |triangle| {
            let bounds = &mut boxes[triangle.node];
            for p in triangle.corners {
                let (low, high) = bounds.unwrap_or((p, p));
                *bounds = Some((low.min(p), high.max(p)));
            }
        });
        let holds = |(low, high): (DVec3, DVec3), p: DVec3| p.cmpgt(low).all() && p.cmplt(high).all();
        let around: Vec<usize> =
            (0..boxes.len()).filter(|node| boxes[*node].is_some_and(|bounds| holds(bounds, eye))).collect();
        if around.is_empty() {
            return None;
        }
        let directions = directions();
        let mut nearest = vec![[None::<Nearest>; DIRECTIONS]; around.len()];
        self.visit_triangles(t_s, |triangle| {
            let Some(place) = around.iter().position(|node| *node == triangle.node) else { return };
            let corners = triangle.corners.map(|p| p - eye);
            for (direction, nearest) in directions.iter().zip(&mut nearest[place]) {
                let Some(depth) = hit(*direction, &corners, true).filter(|depth| *depth > 0.0) else {
                    continue;
                };
                if nearest.is_none_or(|nearest| depth < nearest.depth) {
                    let is_front = hit(*direction, &corners, false).is_some();
                    *nearest = Some(Nearest { depth, is_front, both: triangle.both });
                }
            }
        });
        let others = |node: usize, inside: bool| {
            let bounds = boxes[node].unwrap_or_default();
            boxes.iter().enumerate().any(|(other, of)| {
                other != node && of.is_some_and(|(low, high)| holds(bounds, 0.5 * (low + high)) == inside)
            })
        };
        around.iter().zip(nearest).find_map(|(&node, nearest)| {
            let is_inside = nearest.iter().all(|nearest| nearest.is_some_and(|nearest| !nearest.is_front));
            if !is_inside {
                return None;
            }
            if nearest.iter().flatten().all(|nearest| !nearest.both) {
                return Some((node, Enclosure::Undrawn));
            }
            (!others(node, true) && others(node, false)).then_some((node, Enclosure::Alone))
        })
    }

    /// How far, in pixels, what the camera shows moves within `interval_s`: the 99th percentile over a coarse grid of
    /// points, and the most of some times of the `duration_s` from `start_s` on. Meshes count as rigid. `size` is that of the picture; `None` for the
    /// camera's own.
    pub fn image_motion_px(
        &self,
        camera: usize,
        size: Option<(u32, u32)>,
        (start_s, duration_s): (f64, f64),
        interval_s: f64,
    ) -> f64 {
        let Some(lens) = self.cameras.get(camera).map(|camera| PixelLens::new(camera, size)) else {
            return 0.0;
        };
        let [mut before, mut after] = [SceneState::default(), SceneState::default()];
        let mut most = 0.0_f64;
        for k in 0..MOTION_SAMPLES {
            let t_s = start_s + duration_s * f64::from(k) / f64::from(MOTION_SAMPLES);
            self.evaluate(t_s, &mut before);
            self.evaluate(t_s + interval_s, &mut after);
            let poses = [&before, &after].map(|state| self.world_from_camera(camera, state));
            let [Some(world_from_camera), Some(moved)] = poses else { continue };
            let camera_from_world = moved.inverse();
            let surfaces = self.visible_surfaces(&lens, &world_from_camera, t_s);
            let mut motions: Vec<f64> = surfaces
                .into_iter()
                .filter_map(|(node, point)| {
                    let [from, to] = [&before, &after].map(|state| state.world_from_node[node]);
                    let now = camera_from_world * rigid_step(&from, &to) * world_from_camera;
                    let now = lens.sees(now.transform_point3(point))?;
                    Some(lens.sees(point)?.distance(now)).filter(|motion| motion.is_finite())
                })
                .collect();
            // Single points close to the camera may move by any number of pixels.
            motions.sort_by(f64::total_cmp);
            most = most.max(motions.iter().rev().nth(motions.len() / 100).copied().unwrap_or(0.0));
        }
        most
    }
}

/// World after from world before, of a node; the identity where its scale is 0.
fn rigid_step(from: &DMat4, to: &DMat4) -> DMat4 {
    let step = *to * from.inverse();
    if step.is_finite() { step } else { DMat4::IDENTITY }
}

fn unlikely_size(largest_m: f64) -> Option<String> {
    (largest_m > 0.0 && !LIKELY_M.contains(&largest_m)).then(|| {
        let unit = if largest_m < 1.0 { (1.0e3, "mm") } else { (1.0e-3, "km") };
        format!(
            "the scene's largest side is {} {}; glTF counts in metres: scale the model, in Blender before the export or with a \
             node above it",
            significant(largest_m * unit.0),
            unit.1
        )
    })
}

/// `value` with three digits.
fn significant(value: f64) -> String {
    let decimals = (2.0 - value.log10().floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn unlikely_model_size(largest_m: f64) -> Option<String> {
    (largest_m > LIKELY_MODEL_M && LIKELY_M.contains(&largest_m)).then(|| {
        format!(
            "the model is {largest_m:.0} m large; glTF counts in metres, and so do depth and poses: if it was made in \
             centimetres, scale it by 0.01, in Blender before the export or in a scene file"
        )
    })
}

const DIRECTIONS: usize = 26;

/// Directions all around: to the faces, edges and corners of a cube, turned so that they do not run along the edges of
/// models, which are mostly upright.
fn directions() -> [DVec3; DIRECTIONS] {
    let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.31, 0.47, 0.23);
    let mut directions = [DVec3::ZERO; DIRECTIONS];
    let steps = (0..27)
        .filter(|k| *k != 13)
        .map(|k| DVec3::new(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9)) - 1.0);
    directions.iter_mut().zip(steps).for_each(|(direction, step)| *direction = turn * step.normalize());
    directions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder::{EventCamera, Placement, SceneBuilder};
    use crate::model::{Material, Trs};
    use crate::motion::Path;
    use crate::primitive::Shape;

    /// A room of `side` metres around the camera, drawn from both sides or from outside alone, and a ball of half a metre at
    /// `ball`.
    fn room(side: f64, double_sided: bool, ball: Option<DVec3>) -> Scene {
        let mut s = SceneBuilder::new("room");
        let wall = s.material(Material { double_sided, ..Material::unlit("wall") }).unwrap();
        s.shape("room", Shape::Box { size: [side; 3] }, wall, Placement::default()).unwrap();
        if let Some(at) = ball {
            s.shape("ball", Shape::Sphere { radius: 0.5 }, wall, Placement::at(at)).unwrap();
        }
        s.camera(EventCamera::new("eye"), Placement::at([0.1, 0.2, 0.1])).unwrap();
        s.build().unwrap()
    }

    #[test]
    fn a_camera_inside_a_model_is_told_from_one_in_a_room() {
        let near = Some(DVec3::new(0.0, -1.0, -2.0));
        let far = Some(DVec3::new(0.0, 0.0, -20.0));
        let enclosure =
            |side, double_sided, ball| room(side, double_sided, ball).enclosure(0, 0.0).map(|(_, e)| e);
        assert_eq!(enclosure(6.0, false, None), Some(Enclosure::Undrawn), "walls that are not drawn");
        assert_eq!(enclosure(6.0, false, near), Some(Enclosure::Undrawn));
        assert_eq!(enclosure(6.0, true, None), None, "the room is all there is");
        assert_eq!(enclosure(6.0, true, near), None, "a room with something in it");
        assert_eq!(enclosure(6.0, true, far), Some(Enclosure::Alone), "one model of several");
        // The camera is beside it.
        assert_eq!(enclosure(0.1, false, None), None);
        let told = room(6.0, true, far).enclosed_camera(0, 0.0).unwrap();
        assert!(told.contains("'eye'") && told.contains("'room'"), "{told}");
        // A room that is modelled from within: its fronts surround the camera.
        let mut within = room(6.0, false, far);
        for triangle in within.meshes[0].primitives[0].indices.as_chunks_mut::<3>().0 {
            triangle.swap(1, 2);
        }
        assert_eq!(within.enclosure(0, 0.0), None);
    }

    #[test]
    fn no_built_in_scene_has_its_camera_inside_a_model() {
        for (name, _) in crate::builtin::names() {
            let scene = crate::builtin::load(name, 0).unwrap();
            for t_s in [0.0, 0.7, 2.1] {
                assert_eq!(scene.enclosed_camera(0, t_s), None, "{name}");
            }
        }
    }

    #[test]
    fn image_motion_is_that_of_the_pinhole() {
        let mut s = SceneBuilder::new("pan");
        let white = s.material(Material::unlit("white")).unwrap();
        let velocity = DVec3::new(2.0, 0.0, 0.0);
        let path = Path::ConstantVelocity {
            start: Trs { translation: DVec3::new(0.0, 0.0, -4.0), ..Trs::default() },
            velocity,
        };
        s.shape("card", Shape::Card { size: [1.0, 1.0] }, white, Placement::along(path)).unwrap();
        s.camera(EventCamera::new("eye").fov_y_degrees(90.0), Placement::default()).unwrap();
        let scene = s.build().unwrap();
        // f = 240 px, so 2 m/s at 4 m are 120 px/s.
        let moved = |interval_s| scene.image_motion_px(0, Some((640, 480)), (0.0, 0.5), interval_s);
        assert!((moved(0.1) - 12.0).abs() < 1e-6, "{}", moved(0.1));
        assert!((moved(0.2) - 24.0).abs() < 1e-6, "canary: the interval counts: {}", moved(0.2));
    }

    #[test]
    fn only_sizes_that_nobody_means_are_told() {
        assert_eq!([0.0, 2.0e-3, 1.0, 5.0e3].map(unlikely_size), [None, None, None, None]);
        assert!(
            unlikely_size(4.0e-4).is_some_and(|text| text.contains("the scene's largest side is 0.4 mm;"))
        );
        assert!(unlikely_size(2.0e4).is_some_and(|text| text.contains("20 km") && text.contains("metres")));
        assert_eq!([1.234_567, 0.4, 100.0, 2.5e-7].map(significant), ["1.23", "0.4", "100", "0.00000025"]);
        assert_eq!([0.0, 1.0, 50.0, 2.0e4].map(unlikely_model_size), [None, None, None, None]);
        assert!(
            unlikely_model_size(141.2).is_some_and(|text| text.contains("141 m") && text.contains("0.01"))
        );
        // A scene that has a camera may be a landscape.
        let vast = room(200.0, true, None);
        assert_eq!(vast.unlikely_model_size(), None);
        let framed = Scene { framing: Some(crate::model::Framing::Model), ..vast };
        assert!(framed.unlikely_model_size().is_some());
    }
}
