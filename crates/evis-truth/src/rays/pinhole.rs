//! Cameras at one instant: a pinhole or an orthographic one, and one whose lens is distorted.

use evis_scene::{CalibratedLens, LensModel, PixelLens, PixelRay, Rays};
use glam::{DMat4, DVec2, DVec3};

/// Points along each side of a rectangle of the picture at which a distorted lens is asked for its rays.
const SIDE_POINTS: usize = 8;

/// By how much of itself a beam through a distorted lens is wider on each side, for what its sides bend between these points.
const BEND: f64 = 0.01;

/// How a camera shows the world at one instant.
pub trait Projection: Sync {
    /// Its pose, its picture and its near plane; the lens too, but for its distortion.
    fn pinhole(&self) -> &Pinhole;

    /// The ray through image point `pixel`.
    fn ray(&self, pixel: [f64; 2]) -> Ray;

    /// Image point of a point or a direction in camera space; `None` where it is not in front of the camera.
    fn project_camera(&self, point: DVec3) -> Option<[f64; 2]>;

    /// Four rays in order around a convex beam that holds the rays of all image points between `low` and `high`; `None`
    /// where the camera does not see all of them.
    fn corners(&self, low: [f64; 2], high: [f64; 2]) -> Option<[Ray; 4]>;

    /// Image point of a world point; `None` where it does not lie in front of the camera.
    fn project(&self, world: DVec3) -> Option<[f64; 2]> {
        self.project_camera(self.pinhole().world_from_camera.inverse().transform_point3(world))
    }

    /// Image point of what lies infinitely far in world direction `direction`; `None` also where rays are parallel, since all
    /// of a picture shows one point of the sky then, or none.
    fn project_direction(&self, direction: DVec3) -> Option<[f64; 2]> {
        if self.pinhole().lens.is_parallel() {
            return None;
        }
        self.project_camera(self.pinhole().world_from_camera.inverse().transform_vector3(direction))
    }
}

/// A camera without distortion, looking along its own -Z; pixels grow right and down from the top left, centres at +0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Rigid pose.
    pub world_from_camera: DMat4,
    /// Its lens and picture.
    pub lens: PixelLens,
}

/// A ray through a pixel. `direction` has planar depth 1, so a parameter along it is planar depth.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// World position at planar depth 0: of a pinhole, the camera.
    pub origin: DVec3,
    /// World direction, 1 along the optical axis.
    pub direction: DVec3,
    /// Change of `direction` per pixel to the right and per pixel down.
    pub per_pixel: [DVec3; 2],
    /// Change of `origin` per pixel to the right and per pixel down: of parallel rays.
    pub shift: [DVec3; 2],
}

impl Pinhole {
    /// The ray through image point `pixel`.
    pub fn ray(&self, pixel: [f64; 2]) -> Ray {
        match self.lens.rays {
            Rays::Central => self.ray_through(&self.lens.pinhole(), pixel),
            Rays::Parallel { .. } => {
                let PixelRay { origin, direction } = self.lens.ray(pixel.into());
                let rotate = |v: DVec3| self.world_from_camera.transform_vector3(v);
                let [x, y] = self.lens.focal;
                Ray {
                    origin: self.world_from_camera.transform_point3(origin),
                    direction: rotate(direction),
                    per_pixel: [DVec3::ZERO; 2],
                    shift: [DVec3::X / x, DVec3::NEG_Y / y].map(rotate),
                }
            }
        }
    }

    /// The ray through image point `pixel` of `lens`, from this camera's place.
    fn ray_through(&self, lens: &impl LensModel, pixel: [f64; 2]) -> Ray {
        let rotate = |v: DVec3| self.world_from_camera.transform_vector3(v);
        // All pixels are seen, as `Clock` checks; what lies beyond them and is not, meets nothing.
        let (direction, per_pixel) = lens.planar_ray(pixel.into()).unwrap_or((DVec3::NAN, [DVec2::NAN; 2]));
        Ray {
            origin: self.world_from_camera.w_axis.truncate(),
            direction: rotate(direction),
            per_pixel: per_pixel.map(|d| rotate(d.extend(0.0))),
            shift: [DVec3::ZERO; 2],
        }
    }

    /// Image point of a world point; `None` where it does not lie in front of the camera.
    pub fn project(&self, world: DVec3) -> Option<[f64; 2]> {
        Projection::project(self, world)
    }

    /// Image point of what lies infinitely far in world direction `direction`.
    pub fn project_direction(&self, direction: DVec3) -> Option<[f64; 2]> {
        Projection::project_direction(self, direction)
    }
}

impl Projection for Pinhole {
    fn pinhole(&self) -> &Pinhole {
        self
    }

    fn ray(&self, pixel: [f64; 2]) -> Ray {
        Pinhole::ray(self, pixel)
    }

    fn project_camera(&self, point: DVec3) -> Option<[f64; 2]> {
        self.lens.project(point).map(Into::into)
    }

    fn corners(&self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Option<[Ray; 4]> {
        Some([[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|at| Pinhole::ray(self, at)))
    }
}

/// A camera of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneCamera {
    /// All but the distortion.
    pub pinhole: Pinhole,
    /// The lens, where it is distorted.
    pub lens: Option<CalibratedLens>,
}

impl Projection for SceneCamera {
    fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    fn ray(&self, pixel: [f64; 2]) -> Ray {
        match &self.lens {
            None => self.pinhole.ray(pixel),
            Some(lens) => self.pinhole.ray_through(lens, pixel),
        }
    }

    fn project_camera(&self, point: DVec3) -> Option<[f64; 2]> {
        match &self.lens {
            None => self.pinhole.project_camera(point),
            Some(lens) if point.z < 0.0 => lens.project(point).map(Into::into),
            Some(_) => None,
        }
    }

    fn corners(&self, low: [f64; 2], high: [f64; 2]) -> Option<[Ray; 4]> {
        let Some(lens) = &self.lens else { return self.pinhole.corners(low, high) };
        let (low, high) = (DVec2::from(low), DVec2::from(high));
        let (mut least, mut most) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for i in 0..=SIDE_POINTS {
            let along = low.lerp(high, i as f64 / SIDE_POINTS as f64);
            for at in [[along.x, low.y], [along.x, high.y], [low.x, along.y], [high.x, along.y]] {
                let (ray, _) = lens.planar_ray(at.into())?;
                (least, most) = (least.min(ray.truncate()), most.max(ray.truncate()));
            }
        }
        let margin = (most - least) * BEND;
        let (least, most) = (least - margin, most + margin);
        let middle = self.ray((0.5 * (low + high)).into());
        let rotate = |v: DVec3| self.pinhole.world_from_camera.transform_vector3(v);
        let corners = [[least.x, least.y], [most.x, least.y], [most.x, most.y], [least.x, most.y]];
        Some(corners.map(|[x, y]| Ray { direction: rotate(DVec3::new(x, y, -1.0)), ..middle }))
    }
}
