//! A pinhole camera at one instant.

use glam::{DMat4, DVec3};

/// A pinhole camera, looking along its own -Z; pixels grow right and down from the top left, centres at +0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Rigid pose.
    pub world_from_camera: DMat4,
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels from the top left corner.
    pub center: [f64; 2],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Planar distance, in metres, below which nothing is seen.
    pub near: f64,
}

/// A ray through a pixel. `direction` has planar depth 1, so a parameter along it is planar depth.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// World position of the camera.
    pub origin: DVec3,
    /// World direction, 1 along the optical axis.
    pub direction: DVec3,
    /// Change of `direction` per pixel to the right and per pixel down.
    pub per_pixel: [DVec3; 2],
}

impl Pinhole {
    /// The ray through image point `pixel`.
    pub fn ray(&self, pixel: [f64; 2]) -> Ray {
        let rotate = |v: DVec3| self.world_from_camera.transform_vector3(v);
        let [x, y] =
            [(pixel[0] - self.center[0]) / self.focal[0], (pixel[1] - self.center[1]) / self.focal[1]];
        Ray {
            origin: self.world_from_camera.w_axis.truncate(),
            direction: rotate(DVec3::new(x, -y, -1.0)),
            per_pixel: [rotate(DVec3::X / self.focal[0]), rotate(DVec3::NEG_Y / self.focal[1])],
        }
    }

    /// Image point of a world point; `None` where it does not lie in front of the camera.
    pub fn project(&self, world: DVec3) -> Option<[f64; 2]> {
        self.project_camera(self.world_from_camera.inverse().transform_point3(world))
    }

    /// Image point of what lies infinitely far in world direction `direction`.
    pub fn project_direction(&self, direction: DVec3) -> Option<[f64; 2]> {
        self.project_camera(self.world_from_camera.inverse().transform_vector3(direction))
    }

    fn project_camera(&self, p: DVec3) -> Option<[f64; 2]> {
        (p.z < 0.0).then(|| {
            [self.center[0] + self.focal[0] * p.x / -p.z, self.center[1] - self.focal[1] * p.y / -p.z]
        })
    }
}
