//! A camera's lens in pixels.

use evis_scene::{PinholeLens, Scene, Variant};

use crate::Error;

/// A pinhole lens in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelLens {
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels from the top left corner.
    pub center: [f64; 2],
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Planar distance in metres below which nothing is seen.
    pub near: f64,
}

impl PixelLens {
    /// That of camera `camera` of `scene` in `variant` at `t_us`, at `size` pixels or the camera's own size, without distortion.
    ///
    /// # Errors
    /// A camera that does not exist, or whose lens or size cannot be used.
    pub fn new(
        scene: &Scene,
        variant: Option<&Variant>,
        camera: usize,
        size: Option<(u32, u32)>,
        t_us: f64,
    ) -> Result<Self, Error> {
        let Some(camera) = scene.camera_in(variant, camera, t_us) else {
            let count = scene.cameras.len();
            return Err(Error::Camera(format!("camera {camera} does not exist; the scene has {count}")));
        };
        let (width, height) = camera.pixels(size);
        if !(1..=8192).contains(&width) || !(1..=8192).contains(&height) {
            let reason = format!("the size is {width}x{height} pixels; each side must be between 1 and 8192");
            return Err(Error::Camera(reason));
        }
        let (focal, center) = camera.intrinsics((width, height));
        let usable = focal.iter().all(|f| f.is_finite() && *f > 0.0)
            && center.iter().all(|c| c.is_finite())
            && camera.near.is_finite()
            && camera.near > 0.0;
        if !usable {
            let name = &camera.name;
            return Err(Error::Camera(format!(
                "camera '{name}' has focal lengths {focal:?} px, centre {center:?} px and near plane {} m; all must be \
                 finite, focal lengths and near plane above 0",
                camera.near
            )));
        }
        Ok(Self { focal, center, width, height, near: camera.near })
    }

    /// How it projects.
    pub const fn pinhole(&self) -> PinholeLens {
        PinholeLens { focal: self.focal, center: self.center }
    }
}
