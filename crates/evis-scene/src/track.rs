//! The poses of one node over time, as a host gives them.

use std::f64::consts::TAU;
use std::fmt;
use std::sync::{PoisonError, RwLock};

use glam::{DMat4, DQuat, DVec3};

use crate::interpolate::{hermite, slerp, unit};
use crate::steps::Steps;

/// The pose of a node in the world at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostPose {
    /// Scene time in microseconds.
    pub t_us: i64,
    /// Metres.
    pub position: DVec3,
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Metres per second.
    pub velocity: Option<DVec3>,
    /// Radians per second about the axes of the world.
    pub angular_velocity: Option<DVec3>,
}

impl HostPose {
    /// At `position` (metres) and turned by the quaternion `rotation` (x, y, z, w), with a velocity in metres per second.
    pub fn new(t_us: i64, position: [f64; 3], rotation: [f64; 4], velocity: Option<[f64; 3]>) -> Self {
        let (position, rotation) = (DVec3::from(position), DQuat::from_array(rotation));
        Self { t_us, position, rotation, velocity: velocity.map(DVec3::from), angular_velocity: None }
    }

    /// The same, turning at `angular_velocity`, in radians per second about the axes of the world.
    #[must_use]
    pub fn turning(self, angular_velocity: Option<[f64; 3]>) -> Self {
        Self { angular_velocity: angular_velocity.map(DVec3::from), ..self }
    }
}

/// The poses of a node in one environment. Between two of them positions run straight, or along the cubic that has the
/// velocities of both where they are given; rotations turn evenly along the shorter arc, or along the cubic in rotation vectors
/// that has the angular velocities of both. Before the first and after the last one the node rests. While it is hidden, it is
/// scaled to nothing.
pub struct Track {
    scale: DVec3,
    poses: RwLock<Vec<HostPose>>,
    pub(crate) visible: Steps<bool>,
}

impl fmt::Debug for Track {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Track").field("scale", &self.scale).finish_non_exhaustive()
    }
}

impl Track {
    /// A node that is at `world_from_node` at `t_us`. Its scale stays.
    pub fn new(t_us: i64, world_from_node: &DMat4) -> Self {
        let (scale, rotation, position) = world_from_node.to_scale_rotation_translation();
        let rotation = rotation.normalize();
        let first = HostPose { t_us, position, rotation, velocity: None, angular_velocity: None };
        Self { scale, poses: RwLock::new(vec![first]), visible: Steps::new(true) }
    }

    /// `world_from_node` at scene time `t_us`.
    pub fn world_from_node(&self, t_us: f64) -> DMat4 {
        let poses = self.poses.read().unwrap_or_else(PoisonError::into_inner);
        let above = poses.partition_point(|pose| pose.t_us as f64 <= t_us);
        let (position, rotation) = match (above.checked_sub(1).and_then(|i| poses.get(i)), poses.get(above)) {
            (Some(a), Some(b)) => between(a, b, t_us),
            (Some(only), None) | (None, Some(only)) => (only.position, only.rotation),
            (None, None) => (DVec3::ZERO, DQuat::IDENTITY),
        };
        let scale = if self.visible.at(t_us) == Some(false) { DVec3::ZERO } else { self.scale };
        DMat4::from_scale_rotation_translation(scale, rotation, position)
    }

    /// Times in (start, end), in microseconds of scene time and ascending, at which it has a pose.
    pub fn times(&self, start_us: f64, end_us: f64) -> Vec<f64> {
        let poses = self.poses.read().unwrap_or_else(PoisonError::into_inner);
        let times = poses.iter().map(|pose| pose.t_us as f64);
        times.filter(|t| *t > start_us && *t < end_us).collect()
    }

    /// Appends poses; one at the time of the only one replaces it.
    pub(crate) fn append(&self, new: &[HostPose]) {
        let mut poses = self.poses.write().unwrap_or_else(PoisonError::into_inner);
        if let (Some(first), [only]) = (new.first(), &poses[..])
            && only.t_us == first.t_us
        {
            poses.clear();
        }
        poses.extend_from_slice(new);
    }

    /// Has these poses and no others.
    pub(crate) fn replace(&self, poses: &[HostPose]) {
        *self.poses.write().unwrap_or_else(PoisonError::into_inner) = poses.to_vec();
    }

    /// Forgets poses that no time from `t_us` on needs.
    pub(crate) fn forget_before(&self, t_us: i64) {
        let mut poses = self.poses.write().unwrap_or_else(PoisonError::into_inner);
        let old = poses.partition_point(|pose| pose.t_us <= t_us).saturating_sub(1);
        poses.drain(..old);
        self.visible.forget_before(t_us);
    }

    /// The last pose.
    pub(crate) fn last(&self) -> Option<HostPose> {
        self.poses.read().unwrap_or_else(PoisonError::into_inner).last().copied()
    }

    /// Time of the last pose.
    pub(crate) fn last_us(&self) -> i64 {
        let poses = self.poses.read().unwrap_or_else(PoisonError::into_inner);
        poses.last().map_or(i64::MIN, |pose| pose.t_us)
    }

    /// Whether the host has given nothing yet.
    pub(crate) fn is_new(&self) -> bool {
        self.poses.read().unwrap_or_else(PoisonError::into_inner).len() == 1
    }
}

/// Position and rotation at `t_us`, between two poses.
fn between(a: &HostPose, b: &HostPose, t_us: f64) -> (DVec3, DQuat) {
    let length_us = (b.t_us - a.t_us) as f64;
    let u = (t_us - a.t_us as f64) / length_us;
    let position = match (a.velocity, b.velocity) {
        (Some(va), Some(vb)) => {
            let length_s = length_us * 1e-6;
            let [p0, m0, p1, m1] = hermite(u);
            p0 * a.position + m0 * length_s * va + p1 * b.position + m1 * length_s * vb
        }
        // Exact where nothing moves.
        _ if a.position == b.position => a.position,
        _ => a.position * (1.0 - u) + b.position * u,
    };
    let rotation = match (a.angular_velocity, b.angular_velocity) {
        (Some(wa), Some(wb)) => {
            let length_s = length_us * 1e-6;
            turning(a.rotation, wa * length_s, b.rotation, wb * length_s, u)
        }
        _ if a.rotation == b.rotation => a.rotation,
        _ => slerp(a.rotation, b.rotation, u),
    };
    (position, rotation)
}

/// The rotation at `u` between `a` and `b`, which turn by `wa` and `wb` (radians about the world's axes, per unit of `u`) there.
///
/// Rotations are a times the exponential of a vector, which is the cubic Hermite between 0 and the logarithm of the whole turn.
/// So it is exact about a fixed axis, where the angle is a cubic of time. The logarithm is the one nearest to the mean turn: up to
/// half a turn less or more.
fn turning(a: DQuat, wa: DVec3, b: DQuat, wb: DVec3, u: f64) -> DQuat {
    let (wa, wb) = (a.inverse() * wa, b.inverse() * wb);
    let whole = logarithm(a.inverse() * b, (wa + wb) / 2.0);
    let [_, m0, p1, m1] = hermite(u);
    let vector = m0 * wa + p1 * whole + m1 * rate_of_vector(whole, wb);
    unit(a * DQuat::from_scaled_axis(vector))
}

/// The rotation vector of `q` that is nearest to `like`.
fn logarithm(q: DQuat, like: DVec3) -> DVec3 {
    let sine = q.xyz().length();
    let angle = 2.0 * sine.atan2(q.w);
    let axis = if sine > 1e-12 { q.xyz() / sine } else { like.normalize_or_zero() };
    let turns = ((axis.dot(like) - angle) / TAU).round();
    axis * (angle + turns * TAU)
}

/// How fast the rotation vector `v` changes where what it turns has the angular velocity `w` in its own frame: w times the inverse
/// of the right Jacobian (Bullo & Murray, "Proportional derivative control on the Euclidean group", 1995).
fn rate_of_vector(v: DVec3, w: DVec3) -> DVec3 {
    let angle = v.length();
    let half = angle / 2.0;
    // 1/angle^2 - (1 + cos) / (2 angle sin): by its series where both are large, and without its pole at a whole turn.
    let bend = if angle < 1e-3 { 1.0 / 12.0 } else { ((1.0 - half / half.tan()) / (angle * angle)).min(1.0) };
    w + 0.5 * v.cross(w) + bend * v.cross(v.cross(w))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(t_us: i64, x: f64) -> HostPose {
        HostPose::new(t_us, [x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None)
    }

    fn x(track: &Track, t_us: f64) -> f64 {
        track.world_from_node(t_us).w_axis.x
    }

    #[test]
    fn poses_are_met_and_the_way_between_them_is_straight_or_a_cubic() {
        let track = Track::new(0, &DMat4::from_scale(DVec3::splat(2.0)));
        track.append(&[at(1000, 1.0), at(3000, 2.0)]);
        for (t_us, expected) in
            [(-5.0, 0.0), (0.0, 0.0), (500.0, 0.5), (1000.0, 1.0), (2000.0, 1.5), (9e9, 2.0)]
        {
            assert!((x(&track, t_us) - expected).abs() < 1e-12, "{t_us}");
        }
        assert_eq!(track.world_from_node(700.0).x_axis.x, 2.0, "the scale stays");
        assert_eq!(track.times(0.0, 3000.0), [1000.0], "between the ends");
        // Free fall: p = v t + g t^2 / 2 is met everywhere, where both ends say how fast it is.
        let fall = |t_us: i64| {
            let t = t_us as f64 * 1e-6;
            let velocity = Some(DVec3::new(3.0 - 9.81 * t, 0.0, 0.0));
            HostPose { velocity, ..at(t_us, 3.0 * t - 0.5 * 9.81 * t * t) }
        };
        let track = Track::new(0, &DMat4::IDENTITY);
        track.append(&[fall(0), fall(20_000)]);
        for t_us in [0, 3_000, 11_000, 20_000] {
            assert!((x(&track, t_us as f64) - fall(t_us).position.x).abs() < 1e-12, "{t_us}");
        }
    }

    #[test]
    fn rotations_turn_evenly() {
        let track = Track::new(0, &DMat4::IDENTITY);
        let turned = |t_us: i64, angle| HostPose { rotation: DQuat::from_rotation_z(angle), ..at(t_us, 0.0) };
        track.append(&[turned(1000, 1.0)]);
        let (_, rotation, _) = track.world_from_node(250.0).to_scale_rotation_translation();
        assert!((rotation - DQuat::from_rotation_z(0.25)).length() < 1e-12);
    }

    /// Angle between the rotation of `track` at `t_us` and `expected`.
    fn off(track: &Track, t_us: f64, expected: DQuat) -> f64 {
        let (_, rotation, _) = track.world_from_node(t_us).to_scale_rotation_translation();
        2.0 * (rotation.inverse() * expected).xyz().length().asin()
    }

    #[test]
    fn angular_velocities_are_met_and_turns_about_an_axis_are_exact() {
        // 0.6 turns in 10 ms, faster and faster: the shorter arc would go back.
        let axis = DVec3::new(1.0, 2.0, -0.5).normalize();
        let start = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.0, 2.0);
        let (speed, gain) = (0.4 * TAU / 0.01, 0.4 * TAU / 1e-4);
        let exact = |t_us: f64| {
            let t = t_us * 1e-6;
            DQuat::from_axis_angle(axis, speed * t + gain * t * t / 2.0) * start
        };
        let at = |t_us: i64| {
            let velocity = axis * (speed + gain * t_us as f64 * 1e-6);
            let turned = HostPose { rotation: exact(t_us as f64), ..at(t_us, 0.0) };
            turned.turning(Some(velocity.to_array()))
        };
        let track = Track::new(0, &DMat4::IDENTITY);
        track.append(&[at(0), at(10_000)]);
        for t_us in [0.0, 1234.5, 5000.0, 9000.0, 10_000.0] {
            assert!(off(&track, t_us, exact(t_us)) < 1e-7, "{t_us}");
        }
        // Canary: without them it turns the other way.
        let plain = Track::new(0, &DMat4::IDENTITY);
        plain.append(&[at(0).turning(None), at(10_000).turning(None)]);
        assert!(off(&plain, 5000.0, exact(5000.0)) > 1.0);
    }

    #[test]
    fn a_body_that_tumbles_is_followed_to_the_fourth_order() {
        // A rotation about an axis that itself turns: exp(t p) exp(t q), whose angular velocity is p + exp(t p) q.
        let (p, q) = (DVec3::new(9.0, 1.0, -4.0), DVec3::new(-2.0, 12.0, 5.0));
        let exact = |t: f64| DQuat::from_scaled_axis(p * t) * DQuat::from_scaled_axis(q * t);
        let worst = |step_us: i64, twists: bool| {
            let pose = |t_us: i64| {
                let t = t_us as f64 * 1e-6;
                let velocity = p + DQuat::from_scaled_axis(p * t) * q;
                let pose = HostPose { rotation: exact(t), ..at(t_us, 0.0) };
                pose.turning(twists.then(|| velocity.to_array()))
            };
            let track = Track::new(0, &DMat4::IDENTITY);
            track.append(&(0..=80_000 / step_us).map(|k| pose(k * step_us)).collect::<Vec<_>>());
            let times = (0..8000).map(|k| f64::from(k) * 10.0);
            times.map(|t_us| off(&track, t_us, exact(t_us * 1e-6))).fold(0.0, f64::max)
        };
        let [coarse, fine, plain] = [worst(20_000, true), worst(10_000, true), worst(10_000, false)];
        assert!(fine > 0.0 && coarse / fine > 12.0, "{coarse} {fine}");
        assert!(fine < plain / 50.0, "{fine} {plain}");
    }
}
