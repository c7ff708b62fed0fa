//! All rays of one small patch of the picture at once: what any of them can meet is looked up a single time, and so
//! is what can lie between a triangle that they meet and a lamp.

use std::cell::RefCell;

use glam::DVec3;

use super::bvh::{HalfSpace, before};
use super::caster::{Kind, RayCaster, Shortlist};
use super::geometry::{Candidate, Geometry, Hit, Place};
use super::pinhole::{Projection, Ray};
use super::shade::Lamp;

/// With more triangles than this in a beam, a tree finds them faster than a list.
const LIMIT: usize = 64;
const WIDE_LIMIT: usize = 1024;
/// By how many pixels a beam is wider than asked for: far more than rounding, far less than anything seen.
const SLACK_PX: f64 = 1e-6;

/// The rays of `camera` through a rectangle of the picture.
pub struct Beam<'c, 's> {
    caster: &'c RayCaster<'s>,
    camera: &'c dyn Projection,
    corners: [Ray; 4],
    sides: [HalfSpace; 4],
    /// What they can meet, by least depth; `None` where a tree is asked instead.
    seen: Option<Vec<Candidate>>,
    blockers: RefCell<Vec<Blockers>>,
}

/// What can lie between a triangle's part in the beam and a lamp; `None` where a tree is asked instead.
struct Blockers {
    triangle: usize,
    lamp: usize,
    list: Option<Vec<Candidate>>,
}

impl<'c, 's> Beam<'c, 's> {
    /// The beam through image points from `low` to `high`.
    pub fn new(caster: &'c RayCaster<'s>, camera: &'c dyn Projection, low: [f64; 2], high: [f64; 2]) -> Self {
        Self::limited(caster, camera, [low, high], LIMIT)
    }

    /// As [`Beam::new`], for more of the picture than a few pixels.
    pub fn wide(
        caster: &'c RayCaster<'s>,
        camera: &'c dyn Projection,
        low: [f64; 2],
        high: [f64; 2],
    ) -> Self {
        Self::limited(caster, camera, [low, high], WIDE_LIMIT)
    }

    fn limited(
        caster: &'c RayCaster<'s>,
        camera: &'c dyn Projection,
        [low, high]: [[f64; 2]; 2],
        limit: usize,
    ) -> Self {
        let [x0, y0] = low.map(|v| v - SLACK_PX);
        let [x1, y1] = high.map(|v| v + SLACK_PX);
        let known = camera.corners([x0, y0], [x1, y1]);
        let corners = known.unwrap_or_else(|| [camera.ray([0.5 * (x0 + x1), 0.5 * (y0 + y1)]); 4]);
        let origin = corners[0].origin;
        let parallel = camera.pinhole().lens.is_parallel();
        let middle = 0.25 * corners.iter().map(|c| c.origin + c.direction).sum::<DVec3>();
        let sides = [0, 1, 2, 3].map(|k| {
            let (ray, next) = (&corners[k], &corners[(k + 1) % 4]);
            let normal = if parallel {
                ray.direction.cross(next.origin - ray.origin)
            } else {
                ray.direction.cross(next.direction)
            };
            let inward = if normal.dot(middle - ray.origin) < 0.0 { -normal } else { normal };
            HalfSpace::through(ray.origin, inward)
        });
        // The plane through a side of a triangle, and the apex of the beam or its direction.
        let plane = |edge: [DVec3; 2]| {
            if parallel {
                (edge[1] - edge[0]).cross(corners[0].direction)
            } else {
                (edge[0] - origin).cross(edge[1] - origin)
            }
        };
        let forward = camera.pinhole().world_from_camera.transform_vector3(DVec3::NEG_Z);
        let depth = HalfSpace::through(origin, forward);
        let near = camera.pinhole().lens.near;
        let ends = corners.map(|c| c.origin + c.direction);
        let judge = |candidate: &Candidate| {
            if beside(candidate, &plane, &ends, 0.0) {
                return Place::Beside;
            }
            let shut = corners.iter().try_fold(0.0_f64, |shut, ray| {
                let hit = candidate.meet(ray.origin, ray.direction)?;
                let closed = hit.distance >= near && caster.closes(&hit, ray);
                closed.then_some(shut.max(hit.distance))
            });
            shut.map_or(Place::Inside, |shut| Place::Across(shut * (1.0 + 1e-9)))
        };
        let seen = known.and_then(|_| caster.geometry().within(&sides, &depth, limit, judge));
        Self { caster, camera, corners, sides, seen, blockers: RefCell::default() }
    }

    /// By how many pixels anything in the beam moves, at most, until `later`, the scene's geometry and camera of another
    /// time. `None` where that cannot be told: there is too much in it, something passes the camera, or one of `boxes`,
    /// through which something moves, may throw a shadow into it.
    pub fn fastest(
        &self,
        (geometry, camera): (&Geometry, &dyn Projection),
        boxes: &[(DVec3, DVec3)],
    ) -> Option<f64> {
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let mut most = 0.0_f64;
        // The sky. Parallel rays show one point of it, which a turn exchanges.
        let parallel = self.camera.pinhole().lens.is_parallel();
        let axis = |camera: &dyn Projection| camera.pinhole().world_from_camera.z_axis;
        if parallel && axis(self.camera) != axis(camera) {
            return None;
        }
        for ray in self.corners.iter().filter(|_| !parallel) {
            let here = self.camera.project_direction(ray.direction)?;
            most = most.max(apart(here, camera.project_direction(ray.direction)?));
        }
        let front = HalfSpace::through(
            self.corners[0].origin + self.camera.pinhole().lens.near * self.forward(),
            self.forward(),
        );
        for candidate in self.seen.as_ref()? {
            let corners = candidate.triangle.corners();
            let part = self.sides.iter().chain([&front]).fold(corners.to_vec(), |p, side| clipped(&p, side));
            let id = candidate.triangle.id as usize;
            for p in &part {
                let then = geometry.position(id, candidate.triangle.barycentric(*p));
                most = most.max(apart(self.camera.project(*p)?, camera.project(then)?));
            }
            if part.is_empty() || boxes.is_empty() {
                continue;
            }
            for lamp in self.caster.shadow_lamps() {
                let bounds = toward(&part, lamp)?;
                let meets = |(low, high): &(DVec3, DVec3)| {
                    low.x <= high.x && bounds.iter().all(|b| b.highest(*low, *high) >= 0.0)
                };
                if boxes.iter().any(meets) {
                    return None;
                }
            }
        }
        Some(most)
    }

    fn forward(&self) -> DVec3 {
        self.camera.pinhole().world_from_camera.transform_vector3(DVec3::NEG_Z)
    }

    /// As [`RayCaster::look`], for an image point of the beam.
    pub fn look(&self, pixel: [f64; 2]) -> (f64, Kind) {
        self.caster.look_in(self.camera, pixel, Some(self))
    }

    /// As [`RayCaster::kind`], for an image point of the beam.
    pub fn kind(&self, pixel: [f64; 2]) -> Kind {
        self.caster.kind_in(self.camera, pixel, Some(self))
    }
}

impl Shortlist for Beam<'_, '_> {
    fn nearest(&self, ray: &Ray, near: f64, accept: &mut dyn FnMut(&Hit) -> bool) -> Option<Hit> {
        let Some(seen) = &self.seen else {
            return self.caster.geometry().nearest(ray.origin, ray.direction, near, f64::INFINITY, accept);
        };
        let mut best: Option<Hit> = None;
        for candidate in seen {
            if best.is_some_and(|b| candidate.near > b.distance * (1.0 + 1e-9)) {
                break;
            }
            let Some(hit) = candidate.meet(ray.origin, ray.direction) else { continue };
            let first = best.is_none_or(|b| before((hit.distance, hit.triangle), (b.distance, b.triangle)));
            if first && hit.distance >= near && accept(&hit) {
                best = Some(hit);
            }
        }
        best
    }

    fn any(
        &self,
        ray: &Ray,
        triangle: usize,
        lamp: &Lamp,
        [near, far]: [f64; 2],
        accept: &mut dyn FnMut(&Hit) -> bool,
    ) -> bool {
        let mut known = self.blockers.borrow_mut();
        let place = known.iter().position(|b| b.triangle == triangle && b.lamp == lamp.number);
        let place = place.unwrap_or_else(|| {
            let list = self.between(triangle, lamp);
            known.push(Blockers { triangle, lamp: lamp.number, list });
            known.len() - 1
        });
        match &known[place].list {
            Some(list) => list.iter().any(|candidate| {
                candidate
                    .meet(ray.origin, ray.direction)
                    .is_some_and(|hit| hit.distance >= near && hit.distance <= far && accept(&hit))
            }),
            None => self.caster.geometry().any(ray.origin, ray.direction, near, far, accept),
        }
    }
}

impl Beam<'_, '_> {
    /// Triangles that may lie between the part of triangle `triangle` in the beam, and `lamp`.
    fn between(&self, triangle: usize, lamp: &Lamp) -> Option<Vec<Candidate>> {
        let corners = self.caster.geometry().corners(triangle).map(|v| v.position);
        let part = self.sides.iter().fold(corners.to_vec(), |part, side| clipped(&part, side));
        let bounds = toward(&part, lamp)?;
        let slack = slack(&part);
        let along = lamp.incident(corners[0]).to_light;
        let side = |edge: [DVec3; 2]| match lamp.place() {
            None => (edge[1] - edge[0]).cross(along),
            Some(place) => (edge[0] - place).cross(edge[1] - place),
        };
        let judge = |candidate: &Candidate| {
            if candidate.triangle.id as usize == triangle || beside(candidate, &side, &part, slack) {
                return Place::Beside;
            }
            // One opaque triangle that darkens the whole part is all that counts.
            let darkens = part.iter().all(|p| {
                let incident = lamp.incident(*p);
                candidate.meet(*p, incident.to_light).is_some_and(|hit| {
                    let apart =
                        hit.distance > 2.0 * RayCaster::start(*p) && hit.distance <= incident.distance;
                    apart && self.caster.opaque(&hit)
                })
            });
            if darkens { Place::Across(-1.0) } else { Place::Inside }
        };
        self.caster.geometry().within(&bounds, &HalfSpace::default(), LIMIT, judge)
    }
}

/// Half spaces that hold all rays from `part`, a convex polygon, to `lamp`; `None` where the lamp is too near.
fn toward(part: &[DVec3], lamp: &Lamp) -> Option<Vec<HalfSpace>> {
    if part.is_empty() {
        return None;
    }
    let slack = slack(part);
    let middle = part.iter().sum::<DVec3>() / part.len() as f64;
    let widest =
        part.iter().map(|p| *p - middle).max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))?;
    // Axes across the light, the first along the part's greatest width.
    let axes = |along: DVec3| {
        let u = widest.reject_from_normalized(along).try_normalize();
        let u = u.unwrap_or_else(|| along.any_orthonormal_vector());
        [u, along.cross(u)]
    };
    let range = |value: &dyn Fn(DVec3) -> f64| {
        part.iter()
            .map(|p| value(*p))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let mut bounds = Vec::with_capacity(6);
    match lamp.place() {
        None => {
            let along = lamp.incident(middle).to_light;
            for axis in axes(along) {
                let (low, high) = range(&|p| p.dot(axis));
                bounds.push(HalfSpace { normal: axis, offset: slack - low });
                bounds.push(HalfSpace { normal: -axis, offset: slack + high });
            }
            let (low, _) = range(&|p| p.dot(along));
            bounds.push(HalfSpace { normal: along, offset: slack - low });
        }
        Some(place) => {
            let along = (middle - place).try_normalize()?;
            let (low, high) = range(&|p| (p - place).dot(along));
            // A part beside or around the lamp is no beam.
            if low < 1e3 * slack {
                return None;
            }
            for axis in axes(along) {
                let (least, most) = range(&|p| (p - place).dot(axis) / (p - place).dot(along));
                bounds.push(HalfSpace::through(place, axis - (least - 1e-9) * along));
                bounds.push(HalfSpace::through(place, (most + 1e-9) * along - axis));
            }
            bounds.push(HalfSpace { normal: -along, offset: high + slack + place.dot(along) });
            bounds.push(HalfSpace { normal: along, offset: slack - place.dot(along) });
        }
    }
    Some(bounds)
}

/// Beyond rounding where coordinates are as large as those of `part`.
fn slack(part: &[DVec3]) -> f64 {
    1e-9 * (1.0 + part.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max))
}

/// Whether a plane that contains a side of a triangle, and the apex or the direction of a beam, has the triangle on one
/// side and all `ends`, points of the beam, on the other, `slack` away from it. `normal` gives the plane's normal for
/// a side.
fn beside(candidate: &Candidate, normal: &dyn Fn([DVec3; 2]) -> DVec3, ends: &[DVec3], slack: f64) -> bool {
    let [a, b, c] = candidate.triangle.corners();
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().any(|[p, q, inside]| {
        let normal = normal([p, q]);
        let height = normal.dot(inside - p);
        let outward = if height < 0.0 { normal } else { -normal };
        let limit = slack * normal.length();
        height != 0.0 && ends.iter().all(|end| outward.dot(*end - p) > limit)
    })
}

/// The part of a convex polygon that lies in `side`.
fn clipped(polygon: &[DVec3], side: &HalfSpace) -> Vec<DVec3> {
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (i, &p) in polygon.iter().enumerate() {
        let q = polygon[(i + 1) % polygon.len()];
        let (a, b) = (side.value(p), side.value(q));
        if a >= 0.0 {
            part.push(p);
        }
        if (a >= 0.0) != (b >= 0.0) {
            part.push(p + (q - p) * (a / (a - b)));
        }
    }
    part
}
