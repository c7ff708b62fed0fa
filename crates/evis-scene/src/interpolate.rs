//! Values between keys.

use glam::DQuat;

/// Weights of (value 0, tangent 0, value 1, tangent 1) of a cubic Hermite at `u` in [0, 1]; tangents per unit of `u`.
pub(crate) fn hermite(u: f64) -> [f64; 4] {
    let v = 1.0 - u;
    [(1.0 + 2.0 * u) * v * v, u * v * v, u * u * (3.0 - 2.0 * u), -u * u * v]
}

/// Unit quaternion, identity where `q` has no direction.
pub(crate) fn unit(q: DQuat) -> DQuat {
    let length = q.length();
    if length.is_finite() && length > 0.0 { q / length } else { DQuat::IDENTITY }
}

/// Shortest-arc spherical interpolation of unit quaternions, exact also for close ones (glam's own switches to a
/// normalised lerp above a cosine of 0.9995, an error that a slow rotation under a telephoto lens would show).
pub(crate) fn slerp(a: DQuat, b: DQuat, u: f64) -> DQuat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    // The half-chord form keeps full precision where the arc cosine of the dot product has none.
    let angle = 2.0 * (a - b).length().atan2((a + b).length());
    if angle < 1e-9 {
        return unit(a * (1.0 - u) + b * u);
    }
    let s = angle.sin();
    unit(a * (((1.0 - u) * angle).sin() / s) + b * ((u * angle).sin() / s))
}
