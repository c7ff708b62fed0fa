//! Lenses of cameras, before distortion.

use crate::error::SceneError;

/// How a camera maps space to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// Vertical field of view in radians; square pixels, centred.
    FieldOfView {
        /// Radians.
        fov_y: f64,
    },
    /// Pinhole intrinsics in pixels, for the camera's own width and height.
    Intrinsics {
        /// Horizontal focal length.
        fx: f64,
        /// Vertical focal length.
        fy: f64,
        /// Principal point from the left edge (pixel centres at +0.5).
        cx: f64,
        /// Principal point from the top edge.
        cy: f64,
    },
    /// An orthographic camera: parallel rays, square pixels, centred.
    Orthographic {
        /// What the picture shows from its lower to its upper edge, in metres.
        height: f64,
        /// Far plane: the planar distance in metres beyond which nothing is seen.
        far: f64,
    },
}

impl Lens {
    /// Whether a camera may have it.
    ///
    /// # Errors
    /// Names the number that is out of range.
    pub fn check(&self) -> Result<(), SceneError> {
        let rule = |text: String| Err(SceneError::Rule(text));
        match *self {
            Self::FieldOfView { fov_y } => {
                let degrees = fov_y.to_degrees();
                if !(0.01..=179.0).contains(&degrees) {
                    return rule(format!(
                        "fov_y_degrees is {}; it takes degrees between 0.01 and 179",
                        // As it was written, though it was kept in radians.
                        (degrees * 1.0e9).round() / 1.0e9
                    ));
                }
            }
            Self::Orthographic { height, far } => {
                if !(height.is_finite() && height > 0.0) {
                    return rule(format!("orthographic_height is {height}; it takes metres above 0"));
                }
                if !(far.is_finite() && far > 0.0) {
                    return rule(format!("far is {far}; it takes metres above 0, beyond the near plane"));
                }
            }
            Self::Intrinsics { fx, fy, cx, cy } => {
                for (what, focal) in [("fx", fx), ("fy", fy)] {
                    if !(focal.is_finite() && focal > 0.0) {
                        return rule(format!("{what} is {focal}; it takes pixels above 0"));
                    }
                }
                for (what, center) in [("cx", cx), ("cy", cy)] {
                    if !center.is_finite() {
                        return rule(format!("{what} is {center}; it takes a finite number"));
                    }
                }
            }
        }
        Ok(())
    }
}
