//! Lenses: where a camera shows a point, and in which direction it sees a pixel. [`LensModel`] is the one interface:
//! rendering, labels, decoupled sampling's checks, the oracle and conversions project and unproject through it.
//!
//! Camera space is that of glTF: x right, y up, looking along -z. Pixels grow right and down from the top left corner,
//! pixel centres at +0.5. The distortion models are OpenCV's, in its axes (x right, y down, z forward).

use std::f64::consts::FRAC_PI_2;

use glam::{DMat2, DVec2, DVec3};

use crate::distortion::{Distortion, TOLERANCE};
use crate::error::SceneError;
use crate::model::{Camera, Lens, Scene, Variant};

/// What an inverse may miss its point by, in normalised image coordinates.
const ACCEPTED: f64 = 1e-10;
/// Steps of Newton's method at most. It converges quadratically from the radial solution.
const STEPS: usize = 50;

/// A lens in pixels: the way from points of camera space to places in the picture, and back.
pub trait LensModel {
    /// Where the camera shows `point` of its own frame, and how the pixel moves with the point's x, y and z: the three
    /// columns of the Jacobian, in pixels per metre. `None` where it shows nothing: behind it, and where the model is not one
    /// to one.
    fn project_with_jacobian(&self, point: DVec3) -> Option<(DVec2, [DVec2; 3])>;

    /// The direction, of length 1, in which the camera sees `pixel`; `None` where it sees nothing.
    fn unproject(&self, pixel: DVec2) -> Option<DVec3>;

    /// Where the camera shows `point` of its own frame; `None` where it shows nothing.
    fn project(&self, point: DVec3) -> Option<DVec2> {
        self.project_with_jacobian(point).map(|(pixel, _)| pixel)
    }

    /// The ray of `pixel` with planar depth 1, and how its x and y change per pixel to the right and per pixel down;
    /// `None` where the camera sees nothing, or nothing before it.
    fn planar_ray(&self, pixel: DVec2) -> Option<(DVec3, [DVec2; 2])> {
        let seen = self.unproject(pixel)?;
        if seen.z >= -1e-9 {
            return None;
        }
        let ray = seen / -seen.z;
        let (_, [dx, dy, _]) = self.project_with_jacobian(ray)?;
        let inverse = DMat2::from_cols(dx, dy).inverse();
        Some((ray, [inverse.x_axis, inverse.y_axis]))
    }
}

/// A lens without distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeLens {
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels, pixel centres at +0.5.
    pub center: [f64; 2],
}

impl PinholeLens {
    /// The ray of `pixel` with planar depth 1: (x, y, -1).
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        let slope = (pixel - DVec2::from(self.center)) / DVec2::from(self.focal);
        DVec3::new(slope.x, -slope.y, -1.0)
    }
}

impl LensModel for PinholeLens {
    fn project_with_jacobian(&self, point: DVec3) -> Option<(DVec2, [DVec2; 3])> {
        let pixel = self.project(point)?;
        let [x, y] = self.focal.map(|focal| focal / -point.z);
        let by_depth = (pixel - DVec2::from(self.center)) / -point.z;
        Some((pixel, [DVec2::new(x, 0.0), DVec2::new(0.0, -y), by_depth]))
    }

    fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        Some(self.ray(pixel).normalize())
    }

    fn project(&self, point: DVec3) -> Option<DVec2> {
        let across = DVec2::from(self.focal) * DVec2::new(point.x, -point.y);
        (point.z < 0.0).then(|| DVec2::from(self.center) + across / -point.z)
    }

    fn planar_ray(&self, pixel: DVec2) -> Option<(DVec3, [DVec2; 2])> {
        let [fx, fy] = self.focal;
        Some((self.ray(pixel), [DVec2::X / fx, DVec2::NEG_Y / fy]))
    }
}

/// A lens as calibration files and scenes have it: pinhole, radial-tangential or fisheye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibratedLens {
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels, pixel centres at +0.5.
    pub center: [f64; 2],
    /// `None` for a pinhole.
    pub distortion: Option<Distortion>,
    /// Angle from the axis, in radians, up to which the model is one to one.
    largest_angle: f64,
}

impl CalibratedLens {
    /// A lens of `focal` lengths and principal point `center` in pixels.
    ///
    /// # Errors
    /// Focal lengths that are not above 0, a centre that is not finite, coefficients that are not finite.
    pub fn new(
        focal: [f64; 2],
        center: [f64; 2],
        distortion: Option<Distortion>,
    ) -> Result<Self, SceneError> {
        if !(focal.iter().all(|f| f.is_finite() && *f > 0.0) && center.iter().all(|c| c.is_finite())) {
            let text = format!(
                "a lens has focal lengths {focal:?} and centre {center:?}; focal lengths above 0 and a finite centre work"
            );
            return Err(SceneError::Rule(text));
        }
        if let Some(distortion) = &distortion {
            distortion.check()?;
        }
        let largest_angle = distortion.as_ref().map_or(FRAC_PI_2, Distortion::largest_angle);
        Ok(Self { focal, center, distortion, largest_angle })
    }

    /// Angle from the optical axis, in radians, up to which the model is one to one. Points beyond it are shown nowhere.
    pub const fn largest_angle(&self) -> f64 {
        self.largest_angle
    }

    /// The same focal lengths and principal point without distortion.
    pub const fn pinhole(&self) -> PinholeLens {
        PinholeLens { focal: self.focal, center: self.center }
    }

    /// Distorted image coordinates of normalised ones, and the Jacobian.
    fn distort(&self, n: DVec2, tangential: [f64; 2]) -> Option<(DVec2, DMat2)> {
        let (image, jacobian) = self.distort_anywhere(n, tangential);
        let inside = n.length() < self.largest_radius() && jacobian.determinant() > 0.0;
        inside.then_some((image, jacobian))
    }

    fn distort_anywhere(&self, n: DVec2, [p1, p2]: [f64; 2]) -> (DVec2, DMat2) {
        let r = n.length();
        let [distorted, slope] = self.distortion.map_or([r, 1.0], |d| d.radius(r));
        // The factor, and its derivative by r divided by r.
        let (factor, bend) =
            if r > 1e-9 { (distorted / r, (slope - distorted / r) / (r * r)) } else { (1.0, 0.0) };
        let (x, y, u) = (n.x, n.y, r * r);
        let tangential =
            DVec2::new(2.0 * p1 * x * y + p2 * (u + 2.0 * x * x), p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y);
        let across = 2.0 * (p1 * x + p2 * y) + bend * x * y;
        let jacobian = DMat2::from_cols(
            DVec2::new(factor + bend * x * x + 2.0 * p1 * y + 6.0 * p2 * x, across),
            DVec2::new(across, factor + bend * y * y + 6.0 * p1 * y + 2.0 * p2 * x),
        );
        (n * factor + tangential, jacobian)
    }

    /// Normalised image coordinates of distorted ones.
    fn undistort(&self, image: DVec2, tangential: [f64; 2]) -> Option<DVec2> {
        let distortion = self.distortion.as_ref()?;
        let distorted = image.length();
        let largest = self.largest_radius();
        // Tangential terms are small: the radial solution, or the last one there is, is a good start.
        let start = distortion.inverse_radius(distorted, largest);
        let radius = start.unwrap_or(if largest.is_finite() { largest * (1.0 - 1e-6) } else { distorted });
        let mut n = if distorted > 0.0 { image * (radius / distorted) } else { DVec2::ZERO };
        for _ in 0..STEPS {
            let (at, jacobian) = self.distort_anywhere(n, tangential);
            let step = jacobian.inverse() * (image - at);
            if !step.is_finite() {
                return None;
            }
            n += step;
            if step.length() <= TOLERANCE * (1.0 + n.length()) {
                break;
            }
        }
        let (at, _) = self.distort(n, tangential)?;
        ((at - image).length() <= ACCEPTED * (1.0 + distorted)).then_some(n)
    }

    fn largest_radius(&self) -> f64 {
        if self.largest_angle < FRAC_PI_2 { self.largest_angle.tan() } else { f64::INFINITY }
    }

    /// Image coordinates of a point in OpenCV's axes, and their derivatives by it.
    fn fisheye(&self, p: DVec3) -> Option<(DVec2, [DVec2; 3])> {
        let distortion = self.distortion.as_ref()?;
        let (across, square) = (p.truncate(), p.length_squared());
        let radius = across.length();
        let angle = radius.atan2(p.z);
        if square.is_nan() || square <= 0.0 || angle >= self.largest_angle {
            return None;
        }
        let [distorted, slope] = distortion.radius(angle);
        if radius < 1e-12 * p.z.abs() {
            // On the axis it is a pinhole.
            return Some((across / p.z, [DVec2::X / p.z, DVec2::Y / p.z, -across / (p.z * p.z)]));
        }
        let way = across / radius;
        // d(image) = way slope d(angle) + distorted d(way).
        let along = |d: DVec2, dz: f64| {
            let by_radius = way.dot(d);
            let angle = (by_radius * p.z - radius * dz) / square;
            way * (slope * angle) + (d - way * by_radius) * (distorted / radius)
        };
        Some((way * distorted, [along(DVec2::X, 0.0), along(DVec2::Y, 0.0), along(DVec2::ZERO, 1.0)]))
    }
}

impl LensModel for CalibratedLens {
    fn project_with_jacobian(&self, point: DVec3) -> Option<(DVec2, [DVec2; 3])> {
        // In OpenCV's axes: y down, z forward.
        let p = DVec3::new(point.x, -point.y, -point.z);
        let (image, [dx, dy, dz]) = match self.distortion {
            None => return self.pinhole().project_with_jacobian(point),
            Some(Distortion::Fisheye { .. }) => self.fisheye(p)?,
            Some(Distortion::RadialTangential { tangential, .. }) => {
                if p.z.is_nan() || p.z <= 0.0 {
                    return None;
                }
                let normalised = p.truncate() / p.z;
                let (image, by_normalised) = self.distort(normalised, tangential)?;
                let (a, b) = (by_normalised.x_axis / p.z, by_normalised.y_axis / p.z);
                (image, [a, b, -(a * normalised.x + b * normalised.y)])
            }
        };
        let (focal, center) = (DVec2::from(self.focal), DVec2::from(self.center));
        Some((center + focal * image, [focal * dx, -focal * dy, -focal * dz]))
    }

    fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        let image = (pixel - DVec2::from(self.center)) / DVec2::from(self.focal);
        let seen = match self.distortion {
            None => return self.pinhole().unproject(pixel),
            Some(distortion @ Distortion::Fisheye { .. }) => {
                let distorted = image.length();
                let angle = distortion.inverse_radius(distorted, self.largest_angle)?;
                let across = if distorted > 0.0 { image * (angle.sin() / distorted) } else { DVec2::ZERO };
                DVec3::new(across.x, across.y, angle.cos())
            }
            Some(Distortion::RadialTangential { tangential, .. }) => {
                self.undistort(image, tangential)?.extend(1.0).normalize()
            }
        };
        Some(DVec3::new(seen.x, -seen.y, -seen.z))
    }
}

impl Camera {
    /// Width and height in pixels: `size`, the camera's own, or its aspect (4:3 where it has none) at 480 rows.
    pub fn pixels(&self, size: Option<(u32, u32)>) -> (u32, u32) {
        size.or(self.width.zip(self.height)).unwrap_or_else(|| {
            let aspect = self.aspect.filter(|a| a.is_finite() && *a > 0.0).unwrap_or(4.0 / 3.0);
            (((480.0 * aspect).round() as u32).clamp(1, 8192), 480)
        })
    }

    /// The lens, without a distortion that it may have, in a picture of `width` by `height` pixels: intrinsics belong to
    /// the camera's own size, and another size sees the same field. `None` for an orthographic camera.
    pub fn pinhole(&self, size: (u32, u32)) -> Option<PinholeLens> {
        let [focal, center] = self.focal_and_center(size);
        let is_central = !matches!(self.lens, Lens::Orthographic { .. });
        is_central.then_some(PinholeLens { focal, center })
    }

    /// Focal lengths in pixels, or pixels per metre of an orthographic camera, and principal point.
    pub(crate) fn focal_and_center(&self, (width, height): (u32, u32)) -> [[f64; 2]; 2] {
        let size = DVec2::new(width.into(), height.into());
        let [focal, center] = match self.lens {
            Lens::FieldOfView { fov_y } => [DVec2::splat(0.5 * size.y / (0.5 * fov_y).tan()), 0.5 * size],
            Lens::Orthographic { height, .. } => [DVec2::splat(size.y / height), 0.5 * size],
            Lens::Intrinsics { fx, fy, cx, cy } => {
                let own =
                    DVec2::new(self.width.unwrap_or(width).into(), self.height.unwrap_or(height).into());
                let scale = size / own;
                [DVec2::new(fx, fy) * scale, DVec2::new(cx, cy) * scale]
            }
        };
        [focal.into(), center.into()]
    }
}

impl Scene {
    /// The lens of camera `camera` (an index) in pixels of a picture of `width` by `height`, as [`Camera::pinhole`] has it.
    ///
    /// # Errors
    /// As [`CalibratedLens::new`]; a camera that does not exist, or is orthographic.
    pub fn calibrated_lens(
        &self,
        camera: usize,
        width: u32,
        height: u32,
    ) -> Result<CalibratedLens, SceneError> {
        self.calibrated_lens_in(None, camera, width, height)
    }

    /// As [`Scene::calibrated_lens`], in one of the scene's environments.
    ///
    /// # Errors
    /// As [`Scene::calibrated_lens`].
    pub fn calibrated_lens_in(
        &self,
        variant: Option<&Variant>,
        camera: usize,
        width: u32,
        height: u32,
    ) -> Result<CalibratedLens, SceneError> {
        let Some(camera) = self.camera_in(variant, camera, f64::INFINITY) else {
            return Err(SceneError::Rule(format!(
                "there is no camera {camera}; it has {}",
                self.cameras.len()
            )));
        };
        let Some(PinholeLens { focal, center }) = camera.pinhole((width, height)) else {
            return Err(SceneError::Rule(format!(
                "camera '{}' is orthographic; it has neither focal lengths nor distortion",
                camera.name
            )));
        };
        CalibratedLens::new(focal, center, self.distortions.get(&camera.name).copied())
            .map_err(|error| SceneError::Rule(format!("camera '{}': {error}", camera.name)))
    }
}
