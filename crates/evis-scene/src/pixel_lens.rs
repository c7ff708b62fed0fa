//! A camera's lens in pixels of one picture, without a distortion that it may have: perspective or orthographic.

use glam::{DMat4, DVec2, DVec3};

use crate::error::SceneError;
use crate::lens::{LensModel, PinholeLens};
use crate::model::{Camera, Lens, Scene, Variant};

/// Pixels along each edge of a picture, at most.
const LARGEST_EDGE: u32 = 8192;

/// How the rays of a picture run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rays {
    /// Through the camera's position: perspective.
    Central,
    /// Along the camera's axis, as far as `far`: orthographic.
    Parallel {
        /// Far plane: the planar distance in metres beyond which nothing is seen.
        far: f64,
    },
}

/// A lens without distortion in pixels, and the picture that it is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelLens {
    /// Focal lengths in pixels; of parallel rays, pixels per metre.
    pub focal: [f64; 2],
    /// Principal point in pixels from the top left corner, pixel centres at +0.5.
    pub center: [f64; 2],
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Near plane: the planar distance in metres below which nothing is seen.
    pub near: f64,
    /// How rays run.
    pub rays: Rays,
}

/// From where a camera looks at the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Eye {
    /// From a point.
    At(DVec3),
    /// Along a unit vector, everywhere alike: where rays are parallel.
    Along(DVec3),
}

impl Eye {
    /// The way in which it sees `point`; its length is that of the way from a point, or 1.
    pub fn toward(&self, point: DVec3) -> DVec3 {
        match *self {
            Self::At(eye) => point - eye,
            Self::Along(way) => way,
        }
    }
}

/// What a pixel sees without distortion, in camera space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelRay {
    /// At planar depth 0.
    pub origin: DVec3,
    /// Planar depth 1: z is -1.
    pub direction: DVec3,
}

impl PixelRay {
    /// The point at a planar depth.
    pub fn at(&self, depth: f64) -> DVec3 {
        self.origin + self.direction * depth
    }
}

impl PixelLens {
    /// That of `camera` at `size`, the camera's own or its default: see [`Camera::pixels`].
    pub fn new(camera: &Camera, size: Option<(u32, u32)>) -> Self {
        let (width, height) = camera.pixels(size);
        let [focal, center] = camera.focal_and_center((width, height));
        let rays = match camera.lens {
            Lens::Orthographic { far, .. } => Rays::Parallel { far },
            Lens::FieldOfView { .. } | Lens::Intrinsics { .. } => Rays::Central,
        };
        Self { focal, center, width, height, near: camera.near, rays }
    }

    /// How it projects, where rays are central.
    pub const fn pinhole(&self) -> PinholeLens {
        PinholeLens { focal: self.focal, center: self.center }
    }

    /// Far plane; infinite where rays are central.
    pub const fn far(&self) -> f64 {
        match self.rays {
            Rays::Central => f64::INFINITY,
            Rays::Parallel { far } => far,
        }
    }

    /// Whether rays are parallel: an orthographic camera.
    pub const fn is_parallel(&self) -> bool {
        matches!(self.rays, Rays::Parallel { .. })
    }

    /// Where the camera shows `point` of its own frame; `None` where it lies behind it.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        match self.rays {
            Rays::Central => self.pinhole().project(point),
            Rays::Parallel { .. } => {
                let across = DVec2::from(self.focal) * DVec2::new(point.x, -point.y);
                (point.z < 0.0).then(|| DVec2::from(self.center) + across)
            }
        }
    }

    /// As [`PixelLens::project`], with the pixel's derivatives by the point's x, y and z, in pixels per metre.
    pub fn project_with_jacobian(&self, point: DVec3) -> Option<(DVec2, [DVec2; 3])> {
        match self.rays {
            Rays::Central => self.pinhole().project_with_jacobian(point),
            Rays::Parallel { .. } => {
                let [x, y] = self.focal;
                Some((self.project(point)?, [DVec2::new(x, 0.0), DVec2::new(0.0, -y), DVec2::ZERO]))
            }
        }
    }

    /// What `pixel` sees.
    pub fn ray(&self, pixel: DVec2) -> PixelRay {
        let ray = self.pinhole().ray(pixel);
        match self.rays {
            Rays::Central => PixelRay { origin: DVec3::ZERO, direction: ray },
            Rays::Parallel { .. } => PixelRay { origin: ray.with_z(0.0), direction: DVec3::NEG_Z },
        }
    }

    /// From where a camera with this rigid pose looks.
    pub fn eye(&self, world_from_camera: &DMat4) -> Eye {
        match self.rays {
            Rays::Central => Eye::At(world_from_camera.w_axis.truncate()),
            Rays::Parallel { .. } => Eye::Along(world_from_camera.transform_vector3(DVec3::NEG_Z)),
        }
    }

    /// Pixels per metre across the picture, at planar depth `depth`.
    pub fn pixels_per_metre(&self, depth: f64) -> DVec2 {
        match self.rays {
            Rays::Central => DVec2::from(self.focal) / depth,
            Rays::Parallel { .. } => self.focal.into(),
        }
    }

    /// Whether something can be seen through it, as the lens of camera `name`.
    ///
    /// # Errors
    /// Names the numbers that cannot be used.
    pub fn check(&self, name: &str) -> Result<(), SceneError> {
        let Self { focal, center, width, height, near, rays } = *self;
        if ![width, height].iter().all(|edge| (1..=LARGEST_EDGE).contains(edge)) {
            return Err(SceneError::Rule(format!(
                "camera '{name}' has {width}x{height} pixels; each side must be between 1 and {LARGEST_EDGE}"
            )));
        }
        let positive = focal.iter().chain([&near]).all(|v| v.is_finite() && *v > 0.0);
        if !(positive && center.iter().all(|c| c.is_finite())) {
            return Err(SceneError::Rule(format!(
                "camera '{name}' has focal lengths {focal:?} px, centre {center:?} px and near plane {near} m; all must be \
                 finite, focal lengths and near plane above 0"
            )));
        }
        if let Rays::Parallel { far } = rays
            && !(far.is_finite() && far > near)
        {
            return Err(SceneError::Rule(format!(
                "camera '{name}' has its far plane at {far} m and its near plane at {near} m; the far one must lie beyond"
            )));
        }
        Ok(())
    }
}

impl Scene {
    /// The lens of camera `camera` (an index) in one of the scene's environments at `t_us`, without a distortion that it may
    /// have, at `size` pixels or as [`Camera::pixels`] says.
    ///
    /// # Errors
    /// A camera that does not exist, or through which nothing can be seen.
    pub fn pixel_lens(
        &self,
        variant: Option<&Variant>,
        camera: usize,
        size: Option<(u32, u32)>,
        t_us: f64,
    ) -> Result<PixelLens, SceneError> {
        let Some(camera) = self.camera_in(variant, camera, t_us) else {
            return Err(SceneError::Rule(format!(
                "there is no camera {camera}; it has {}",
                self.cameras.len()
            )));
        };
        let lens = PixelLens::new(&camera, size);
        lens.check(&camera.name)?;
        Ok(lens)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nothing_is_seen_through_is_refused() {
        let rays = Rays::Central;
        let lens =
            PixelLens { focal: [50.0, 60.0], center: [32.0, 24.0], width: 64, height: 48, near: 0.1, rays };
        lens.check("eye").unwrap();
        let refused = [
            (PixelLens { width: 0, ..lens }, "0x48"),
            (PixelLens { height: 8193, ..lens }, "64x8193"),
            (PixelLens { focal: [50.0, 0.0], ..lens }, "[50.0, 0.0]"),
            (PixelLens { focal: [f64::INFINITY, 60.0], ..lens }, "[inf, 60.0]"),
            (PixelLens { center: [f64::NAN, 24.0], ..lens }, "[NaN, 24.0]"),
            (PixelLens { near: -0.1, ..lens }, "-0.1 m"),
            (PixelLens { rays: Rays::Parallel { far: 0.1 }, ..lens }, "far plane at 0.1 m"),
            (PixelLens { rays: Rays::Parallel { far: f64::INFINITY }, ..lens }, "inf m"),
        ];
        for (lens, value) in refused {
            let text = lens.check("eye").unwrap_err().to_string();
            assert!(text.contains("'eye'") && text.contains(value), "{text}");
        }
    }

    #[test]
    fn an_orthographic_picture_is_the_same_at_every_depth() {
        let camera =
            Camera { near: 0.5, ..Camera::new("eye", 0, Lens::Orthographic { height: 3.0, far: 20.0 }) };
        let lens = PixelLens::new(&camera, Some((80, 60)));
        lens.check("eye").unwrap();
        // 20 px per metre: the upper left corner is 2 m to the left and 1.5 m up.
        for depth in [0.7, 9.0] {
            assert_eq!(lens.project(DVec3::new(-2.0, 1.5, -depth)), Some(DVec2::ZERO));
            let point = DVec3::new(0.3, -0.4, -depth);
            let pixel = lens.project(point).unwrap();
            assert!((pixel - DVec2::new(46.0, 38.0)).length() < 1e-12, "{pixel}");
            assert!((lens.ray(pixel).at(depth) - point).length() < 1e-12);
            let (_, [x, y, z]) = lens.project_with_jacobian(point).unwrap();
            assert_eq!([x, y, z], [DVec2::X * 20.0, DVec2::NEG_Y * 20.0, DVec2::ZERO]);
        }
        assert_eq!(lens.project(DVec3::Z), None, "behind it");
        // Another size shows as much from below to above.
        let small = PixelLens::new(&camera, Some((20, 30)));
        assert_eq!((small.focal, small.center), ([10.0; 2], [10.0, 15.0]));
        assert_eq!(camera.pinhole((80, 60)), None);
    }
}
