//! How a camera maps space to homogeneous image points, perspective or orthographic.

use evis_scene::{PixelLens, Rays};
use glam::{DMat3, DMat4, DVec3, DVec4};

/// From some space to homogeneous image points (x z, y z, z): image point (x, y) in pixels, and depth z.
///
/// Of central rays z is planar depth, and the map is linear. Of parallel rays it is projective: with planar depth d and a depth f
/// far beyond everything, z = f / (f - d). As of a pinhole, planes stay planes, 1/z is linear on the image of one, and z grows
/// with depth; so visibility and shadows are found alike. What is beyond f has a negative z, as has what is behind a pinhole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screen {
    /// Homogeneous coordinates: of parallel rays (x, y, 1) times a factor, and then the divisor.
    matrix: DMat4,
    parallel: bool,
}

impl Default for Screen {
    fn default() -> Self {
        Self { matrix: DMat4::IDENTITY, parallel: false }
    }
}

impl Screen {
    /// From the space of the camera with `lens`; all is nearer than `beyond`.
    pub fn from_camera(lens: &PixelLens, beyond: f64) -> Self {
        let [fx, fy] = lens.focal;
        let [cx, cy] = lens.center;
        let matrix = match lens.rays {
            Rays::Central => DMat4::from_cols_array(&[
                fx, 0.0, 0.0, 0.0, 0.0, -fy, 0.0, 0.0, -cx, -cy, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
            ]),
            Rays::Parallel { .. } => DMat4::from_cols(
                DVec4::new(fx, 0.0, 0.0, 0.0),
                DVec4::new(0.0, -fy, 0.0, 0.0),
                DVec4::new(0.0, 0.0, 0.0, 1.0 / beyond),
                DVec4::new(cx, cy, 1.0, 1.0),
            ),
        };
        Self { matrix, parallel: lens.is_parallel() }
    }

    /// What planar depth `depth` before a camera with `lens` is here.
    fn depth(lens: &PixelLens, beyond: f64, depth: f64) -> f64 {
        match lens.rays {
            Rays::Central => depth,
            Rays::Parallel { .. } => 1.0 / (1.0 - depth / beyond),
        }
    }

    /// The same from a space that `matrix` takes to this one's.
    #[must_use]
    pub fn after(&self, matrix: &DMat4) -> Self {
        Self { matrix: self.matrix * *matrix, ..*self }
    }

    /// The homogeneous image point of a point.
    #[inline(always)]
    pub fn point(&self, point: DVec3) -> DVec3 {
        if self.parallel {
            let h = self.matrix * point.extend(1.0);
            return h.truncate() / h.w;
        }
        self.matrix.transform_point3(point)
    }

    /// That of a place (`weight` 1) or of what lies infinitely far in a direction (0), and its weight there.
    pub fn place(&self, place: DVec3, weight: f64) -> (DVec3, f64) {
        let h = self.matrix * place.extend(weight);
        (h.truncate(), h.w)
    }

    /// Whether rays are parallel.
    pub const fn is_parallel(&self) -> bool {
        self.parallel
    }

    /// The linear map from image points (x, y, 1) to the directions in which they are seen.
    pub fn directions(&self) -> DMat3 {
        if !self.parallel {
            return DMat3::from_mat4(self.matrix).inverse();
        }
        // What moves no image point, and away: the divisor falls with depth.
        let [x, y, divisor] = [0, 1, 3].map(|row| self.matrix.row(row).truncate());
        let along = x.cross(y).normalize_or(DVec3::NEG_Z);
        let away = if divisor.dot(along) < 0.0 { along } else { -along };
        DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, away)
    }

    /// The homogeneous image point of what lies infinitely far in `direction`, where rays are central.
    pub fn direction(&self, direction: DVec3) -> DVec3 {
        self.matrix.transform_vector3(direction)
    }
}

/// Depths of homogeneous image points between which something is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depths {
    /// At the near plane.
    pub near: f64,
    /// At the far plane; infinite where there is none.
    pub far: f64,
}

impl Depths {
    /// Of the camera with `lens`; all is nearer than `beyond`.
    pub fn new(lens: &PixelLens, beyond: f64) -> Self {
        let [near, far] = [lens.near, lens.far()].map(|depth| Screen::depth(lens, beyond, depth));
        Self { near, far }
    }
}
