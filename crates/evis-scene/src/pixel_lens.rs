//! A camera's lens in pixels of one picture, without a distortion that it may have.

use crate::error::SceneError;
use crate::lens::PinholeLens;
use crate::model::{Camera, Scene, Variant};

/// Pixels along each edge of a picture, at most.
const LARGEST_EDGE: u32 = 8192;

/// A pinhole lens in pixels, and the picture that it is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelLens {
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels from the top left corner, pixel centres at +0.5.
    pub center: [f64; 2],
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Near plane: the planar distance in metres below which nothing is seen.
    pub near: f64,
}

impl PixelLens {
    /// That of `camera` at `size`, the camera's own or its default: see [`Camera::pixels`].
    pub fn new(camera: &Camera, size: Option<(u32, u32)>) -> Self {
        let (width, height) = camera.pixels(size);
        let PinholeLens { focal, center } = camera.pinhole((width, height));
        Self { focal, center, width, height, near: camera.near }
    }

    /// How it projects.
    pub const fn pinhole(&self) -> PinholeLens {
        PinholeLens { focal: self.focal, center: self.center }
    }

    /// Whether something can be seen through it, as the lens of camera `name`.
    ///
    /// # Errors
    /// Names the numbers that cannot be used.
    pub fn check(&self, name: &str) -> Result<(), SceneError> {
        let Self { focal, center, width, height, near } = *self;
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
        let lens = PixelLens { focal: [50.0, 60.0], center: [32.0, 24.0], width: 64, height: 48, near: 0.1 };
        lens.check("eye").unwrap();
        let refused = [
            (PixelLens { width: 0, ..lens }, "0x48"),
            (PixelLens { height: 8193, ..lens }, "64x8193"),
            (PixelLens { focal: [50.0, 0.0], ..lens }, "[50.0, 0.0]"),
            (PixelLens { focal: [f64::INFINITY, 60.0], ..lens }, "[inf, 60.0]"),
            (PixelLens { center: [f64::NAN, 24.0], ..lens }, "[NaN, 24.0]"),
            (PixelLens { near: -0.1, ..lens }, "-0.1 m"),
        ];
        for (lens, value) in refused {
            let text = lens.check("eye").unwrap_err().to_string();
            assert!(text.contains("'eye'") && text.contains(value), "{text}");
        }
    }
}
