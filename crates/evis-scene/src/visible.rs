//! What a camera sees of a scene, on a coarse grid: surface points, their speed in pixels, and the clearance around it.

use glam::{DMat4, DVec2, DVec3};

use crate::framing::deformed;
use crate::model::Scene;
use crate::pixel_lens::{PixelLens, PixelRay};
use crate::pose::SceneState;

/// Rays of the coarse grid along each axis.
const COLUMNS: usize = 64;
const ROWS: usize = 48;

/// Half of the step, in seconds, over which image speeds are taken.
const HALF_STEP_S: f64 = 1e-5;

impl PixelLens {
    /// Width and height in pixels.
    pub(crate) fn size(&self) -> DVec2 {
        DVec2::new(self.width.into(), self.height.into())
    }

    /// Where the camera shows a point of its own frame; `None` outside of its near and far planes.
    pub(crate) fn sees(&self, p: DVec3) -> Option<DVec2> {
        self.project(p).filter(|_| (self.near..=self.far()).contains(&-p.z))
    }

    /// Whether `pixel` lies in the picture.
    pub(crate) fn shows(&self, pixel: DVec2) -> bool {
        pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(self.size()).all()
    }

    /// Whether `pixel` lies in the central half of the picture, along each axis.
    pub(crate) fn is_central(&self, pixel: DVec2) -> bool {
        (pixel - 0.5 * self.size()).abs().cmple(0.25 * self.size()).all()
    }

    /// Distance to the farthest point of the near plane that the picture shows.
    pub(crate) fn near_reach(&self) -> f64 {
        let size = self.size();
        let corners = [DVec2::ZERO, size, size.with_y(0.0), size.with_x(0.0)];
        corners.map(|corner| self.ray(corner).at(self.near).length()).into_iter().fold(0.0, f64::max)
    }

    fn grid(&self) -> impl Iterator<Item = (usize, PixelRay)> + use<> {
        let (lens, cell) = (*self, self.size() / DVec2::new(COLUMNS as f64, ROWS as f64));
        (0..COLUMNS * ROWS).map(move |i| {
            let at = DVec2::new((i % COLUMNS) as f64 + 0.5, (i / COLUMNS) as f64 + 0.5);
            (i, lens.ray(at * cell))
        })
    }

    /// Points at `depth` metres before the camera, all over the picture.
    pub(crate) fn plane(&self, depth: f64) -> Vec<DVec3> {
        self.grid().map(|(_, ray)| ray.at(depth)).collect()
    }
}

/// A triangle that is drawn.
pub(crate) struct Triangle {
    /// Node whose mesh it belongs to.
    pub node: usize,
    /// In the world, counter-clockwise from its front.
    pub corners: [DVec3; 3],
    /// Whether its back is drawn too.
    pub both: bool,
}

impl Scene {
    /// Calls `visit` with every triangle drawn at `t_s`, node by node.
    pub(crate) fn visit_triangles(&self, t_s: f64, mut visit: impl FnMut(&Triangle)) {
        let mut state = SceneState::default();
        self.evaluate(t_s, &mut state);
        let (mut joints, mut corners) = (Vec::new(), Vec::new());
        for (index, node) in self.nodes.iter().enumerate() {
            let Some(mesh) = node.mesh.and_then(|m| self.meshes.get(m)) else { continue };
            joints.clear();
            if let Some(skin) = node.skin {
                self.joint_matrices(skin, &state, &mut joints);
            }
            let (world, weights) = (&state.world_from_node[index], &state.morph_weights[index]);
            let mirrored = joints.is_empty() && world.determinant() < 0.0;
            for primitive in &mesh.primitives {
                let both = self.materials.get(primitive.material).is_none_or(|m| m.double_sided);
                let count = primitive.positions.len();
                corners.clear();
                corners.extend((0..count).map(|i| deformed(primitive, i, world, weights, &joints)));
                for indices in primitive.indices.as_chunks::<3>().0 {
                    let [a, b, c] =
                        indices.map(|i| corners.get(i as usize).copied().flatten().filter(|p| p.is_finite()));
                    if let (Some(a), Some(b), Some(c)) = (a, b, c) {
                        let corners = if mirrored { [a, c, b] } else { [a, b, c] };
                        visit(&Triangle { node: index, corners, both });
                    }
                }
            }
        }
    }

    /// Calls `visit` with every point drawn at `t_s`, in the world.
    pub(crate) fn visit_points(&self, t_s: f64, mut visit: impl FnMut(DVec3)) {
        self.visit_triangles(t_s, |triangle| triangle.corners.into_iter().for_each(&mut visit));
    }

    /// Points of surfaces that the camera shows at `t_s`, in its own frame, spread evenly over the picture.
    pub(crate) fn visible_points(&self, lens: &PixelLens, world_from_camera: &DMat4, t_s: f64) -> Vec<DVec3> {
        self.visible_surfaces(lens, world_from_camera, t_s).into_iter().map(|(_, point)| point).collect()
    }

    /// The same points, each with the node that shows there.
    pub(crate) fn visible_surfaces(
        &self,
        lens: &PixelLens,
        world_from_camera: &DMat4,
        t_s: f64,
    ) -> Vec<(usize, DVec3)> {
        let camera_from_world = world_from_camera.inverse();
        let rays: Vec<PixelRay> = lens.grid().map(|(_, ray)| ray).collect();
        let mut nearest = vec![(0, f64::INFINITY); rays.len()];
        let per_cell = DVec2::new(COLUMNS as f64, ROWS as f64) / lens.size();
        self.visit_triangles(t_s, |triangle| {
            let corners = triangle.corners.map(|p| camera_from_world.transform_point3(p));
            if corners.iter().all(|p| -p.z < lens.near) {
                return;
            }
            let [first, last] = cells(lens, per_cell, &corners);
            for row in first[1]..last[1] {
                for column in first[0]..last[0] {
                    let i = row * COLUMNS + column;
                    let PixelRay { origin, direction } = rays[i];
                    let depth = hit(direction, &corners.map(|corner| corner - origin), triangle.both)
                        .filter(|d| (lens.near..=lens.far()).contains(d));
                    if let Some(depth) = depth.filter(|depth| *depth < nearest[i].1) {
                        nearest[i] = (triangle.node, depth);
                    }
                }
            }
        });
        rays.iter()
            .zip(nearest)
            .filter(|(_, (_, depth))| depth.is_finite())
            .map(|(ray, (node, depth))| (node, ray.at(depth)))
            .collect()
    }

    /// Distance from the nearest surface, at any of the scene's framing times, to the nearest of `eyes`; infinite
    /// where nothing is drawn.
    pub(crate) fn clearance(&self, eyes: &[DVec3]) -> f64 {
        let mut squared = f64::INFINITY;
        for t_s in self.framing_times() {
            self.visit_triangles(t_s, |triangle| {
                for eye in eyes {
                    squared = squared.min(eye.distance_squared(nearest_point(*eye, &triangle.corners)));
                }
            });
        }
        squared.sqrt()
    }
}

/// First and past-the-last column and row of the coarse grid's rays that may hit the triangle.
fn cells(lens: &PixelLens, per_cell: DVec2, corners: &[DVec3; 3]) -> [[usize; 2]; 2] {
    let pixels = corners.map(|p| lens.sees(p));
    let [Some(a), Some(b), Some(c)] = pixels else {
        // It reaches behind the near plane: it may show anywhere.
        return [[0, 0], [COLUMNS, ROWS]];
    };
    let (low, high) = (a.min(b).min(c) * per_cell, a.max(b).max(c) * per_cell);
    let range = |low: f64, high: f64, count: usize| {
        // The ray of cell i passes at i + 0.5; casts saturate.
        let first = ((low - 0.5).floor().max(0.0) as usize).min(count);
        (first, ((high + 0.5).ceil().max(0.0) as usize).clamp(first, count))
    };
    let (x, y) = (range(low.x, high.x, COLUMNS), range(low.y, high.y, ROWS));
    [[x.0, y.0], [x.1, y.1]]
}

/// Lengths of `ray`, from the origin, to where it hits the triangle, from its front or where `both` from either side: depth,
/// where z = -1 (Möller and Trumbore 1997).
pub(crate) fn hit(ray: DVec3, [a, b, c]: &[DVec3; 3], both: bool) -> Option<f64> {
    let (ab, ac) = (*b - *a, *c - *a);
    let p = ray.cross(ac);
    // Above 0 where the ray meets the front.
    let determinant = ab.dot(p);
    if determinant == 0.0 || (determinant < 0.0 && !both) {
        return None;
    }
    let u = -a.dot(p) / determinant;
    let q = -a.cross(ab);
    let v = ray.dot(q) / determinant;
    let depth = ac.dot(q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && depth.is_finite()).then_some(depth)
}

/// The point of the triangle that is nearest to `p` (Ericson, Real-Time Collision Detection, 5.1.5).
fn nearest_point(p: DVec3, [a, b, c]: &[DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (*b - *a, *c - *a, p - *a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - *b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return *a + ab * (d1 / (d1 - d3));
    }
    let cp = p - *c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return *a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return *b + (*c - *b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let scale = 1.0 / (va + vb + vc);
    *a + ab * (vb * scale) + ac * (vc * scale)
}

/// Mean image speed, in pixels per second, of resting `points` (in the camera's frame where `start_from_camera` is the
/// identity) over `times_s`, of those that show in the central half of the picture, else in all of it; `None` where none
/// does.
pub(crate) fn image_speed(
    lens: &PixelLens,
    points: &[DVec3],
    start_from_camera: impl Fn(f64) -> DMat4,
    times_s: impl Iterator<Item = f64>,
) -> Option<f64> {
    let (mut central, mut anywhere) = ((0.0, 0_u32), (0.0, 0_u32));
    for t_s in times_s {
        let [before, now, after] =
            [t_s - HALF_STEP_S, t_s, t_s + HALF_STEP_S].map(|t| start_from_camera(t).inverse());
        for point in points {
            let at = |m: &DMat4| lens.sees(m.transform_point3(*point));
            let (Some(p0), Some(p), Some(p1)) = (at(&before), at(&now), at(&after)) else { continue };
            let speed = (p1 - p0).length() / (2.0 * HALF_STEP_S);
            if !speed.is_finite() {
                continue;
            }
            if lens.is_central(p) {
                central = (central.0 + speed, central.1 + 1);
            }
            if lens.shows(p) {
                anywhere = (anywhere.0 + speed, anywhere.1 + 1);
            }
        }
    }
    let (sum, count) = if central.1 > 0 { central } else { anywhere };
    (count > 0).then(|| sum / f64::from(count))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [DVec3; 3] =
        [DVec3::new(0.0, 0.0, -2.0), DVec3::new(3.0, 0.0, -2.0), DVec3::new(0.0, 3.0, -2.0)];

    #[test]
    fn the_nearest_point_is_no_farther_than_any_other() {
        let mut state = 5_u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 * 4.0 - 2.0
        };
        for _ in 0..2000 {
            let mut point = || DVec3::new(random(), random(), random());
            let (eye, [a, b, c]) = (point(), [point(), point(), point()]);
            let nearest = nearest_point(eye, &[a, b, c]);
            let best = (0..=60)
                .flat_map(|i| (0..=60 - i).map(move |k| (f64::from(i) / 60.0, f64::from(k) / 60.0)))
                .map(|(u, v)| eye.distance(a + (b - a) * u + (c - a) * v))
                .fold(f64::INFINITY, f64::min);
            let distance = eye.distance(nearest);
            assert!(distance <= best + 1e-9, "{distance} > {best}");
            assert!(distance >= best - 0.15, "{distance} is not on the triangle: {best}");
        }
    }

    #[test]
    fn rays_hit_fronts_and_backs_of_what_is_drawn_from_both_sides() {
        let [a, b, c] = TRIANGLE;
        let ray = DVec3::new(0.3, 0.3, -1.0);
        assert_eq!(hit(ray, &TRIANGLE, false), Some(2.0));
        assert_eq!(hit(ray, &[a, c, b], false), None, "a back");
        assert_eq!(hit(ray, &[a, c, b], true), Some(2.0));
        assert_eq!(hit(DVec3::new(1.0, 1.0, -1.0), &TRIANGLE, true), None, "beside it");
    }
}
