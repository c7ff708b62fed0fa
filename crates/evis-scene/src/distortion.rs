//! Distortion models: OpenCV's, in normalised image coordinates (x right, y down).

use std::f64::consts::{FRAC_PI_2, PI};

use crate::error::SceneError;

/// Newton's method ends when a step is below this, in normalised image coordinates.
pub(crate) const TOLERANCE: f64 = 1e-12;
/// Angles at which the sign of a radial derivative is looked up, from the axis to the largest angle.
const ANGLES: usize = 4096;

/// How a lens departs from a pinhole. Coefficients have no unit: they apply to normalised image coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// OpenCV's radial-tangential model (`projectPoints`), with its rational part.
    RadialTangential {
        /// k1 to k6: `(1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)`.
        radial: [f64; 6],
        /// p1, p2.
        tangential: [f64; 2],
    },
    /// Kannala and Brandt's model (its fisheye module, Kalibr's `equidistant`):
    /// `theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)`.
    Fisheye {
        /// k1 to k4.
        radial: [f64; 4],
    },
}

impl Distortion {
    /// Its name in scene files: `radtan` or `fisheye`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::RadialTangential { .. } => "radtan",
            Self::Fisheye { .. } => "fisheye",
        }
    }

    /// Coefficients in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4.
    pub fn coefficients(&self) -> Vec<f64> {
        match self {
            Self::RadialTangential { radial: [k1, k2, k3, k4, k5, k6], tangential: [p1, p2] } => {
                vec![*k1, *k2, *p1, *p2, *k3, *k4, *k5, *k6]
            }
            Self::Fisheye { radial } => radial.to_vec(),
        }
    }

    /// Names of a model's coefficients, in OpenCV's order; empty for a model that does not exist.
    pub fn names(model: &str) -> &'static [&'static str] {
        match model {
            "radtan" => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            "fisheye" => &["k1", "k2", "k3", "k4"],
            _ => &[],
        }
    }

    /// Whether all coefficients are finite.
    pub(crate) fn check(&self) -> Result<(), SceneError> {
        Self::from_coefficients(self.name(), &self.coefficients()).map(drop)
    }

    /// From coefficients in OpenCV's order; missing ones at the end are 0.
    ///
    /// # Errors
    /// A model other than `radtan` and `fisheye`, too many coefficients, or one that is not finite.
    pub fn from_coefficients(model: &str, coefficients: &[f64]) -> Result<Self, SceneError> {
        let most = Self::names(model).len();
        if most == 0 {
            return Err(SceneError::Rule(format!(
                "the distortion model is '{model}'; 'radtan' (OpenCV's k1 k2 p1 p2 k3 k4 k5 k6) and 'fisheye' \
                 (Kannala-Brandt, k1 to k4) work"
            )));
        }
        if coefficients.len() > most {
            return Err(SceneError::Rule(format!(
                "the distortion has {} coefficients; {model} takes {most} at most",
                coefficients.len()
            )));
        }
        if let Some(value) = coefficients.iter().find(|value| !value.is_finite()) {
            return Err(SceneError::Rule(format!(
                "the distortion has the coefficient {value}; finite numbers work"
            )));
        }
        let at = |i: usize| coefficients.get(i).copied().unwrap_or(0.0);
        Ok(if model == "fisheye" {
            Self::Fisheye { radial: [at(0), at(1), at(2), at(3)] }
        } else {
            Self::RadialTangential {
                radial: [at(0), at(1), at(4), at(5), at(6), at(7)],
                tangential: [at(2), at(3)],
            }
        })
    }

    /// Distorted radius, and its derivative, of radius `r` (radial-tangential) or angle `r` (fisheye).
    pub(crate) fn radius(&self, r: f64) -> [f64; 2] {
        let u = r * r;
        match self {
            Self::RadialTangential { radial: [k1, k2, k3, k4, k5, k6], .. } => {
                let (n, dn) = (1.0 + u * (k1 + u * (k2 + u * k3)), k1 + u * (2.0 * k2 + u * 3.0 * k3));
                let (d, dd) = (1.0 + u * (k4 + u * (k5 + u * k6)), k4 + u * (2.0 * k5 + u * 3.0 * k6));
                [r * n / d, (n + 2.0 * u * dn) / d - 2.0 * u * n * dd / (d * d)]
            }
            Self::Fisheye { radial: [k1, k2, k3, k4] } => [
                r * (1.0 + u * (k1 + u * (k2 + u * (k3 + u * k4)))),
                1.0 + u * (3.0 * k1 + u * (5.0 * k2 + u * (7.0 * k3 + u * 9.0 * k4))),
            ],
        }
    }

    /// The largest angle from the axis up to which the distorted radius grows: beyond it the model folds.
    pub(crate) fn largest_angle(&self) -> f64 {
        let (most, radius): (f64, fn(f64) -> f64) = match self {
            Self::RadialTangential { .. } => (FRAC_PI_2, f64::tan),
            Self::Fisheye { .. } => (PI, |angle| angle),
        };
        let grows = |angle: f64| {
            let r = radius(angle);
            let [distorted, slope] = self.radius(r);
            // Behind a pole of the rational model the radius is negative.
            slope > 0.0 && distorted >= 0.0
        };
        let at = |i: usize| most * i as f64 / ANGLES as f64;
        let Some(first) = (1..ANGLES).find(|&i| !grows(at(i))) else { return most };
        let (mut low, mut high) = (at(first - 1), at(first));
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if grows(middle) { low = middle } else { high = middle }
        }
        low
    }

    /// The radius or angle whose distorted radius is `distorted`, at most `largest`.
    pub(crate) fn inverse_radius(&self, distorted: f64, largest: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, largest);
        if !high.is_finite() {
            high = 1.0;
            while self.radius(high)[0] < distorted {
                high *= 2.0;
                if high > 1e12 {
                    return None;
                }
            }
        }
        if distorted > self.radius(high)[0] {
            return None;
        }
        // Newton's method, kept within the bracket.
        let mut r = distorted.clamp(low, high);
        for _ in 0..200 {
            let [value, slope] = self.radius(r);
            if value > distorted {
                high = r
            } else {
                low = r
            }
            let step = r - (value - distorted) / slope;
            let next = if step > low && step < high { step } else { 0.5 * (low + high) };
            if (next - r).abs() <= TOLERANCE * (1.0 + r) {
                return Some(next);
            }
            r = next;
        }
        Some(r)
    }
}
