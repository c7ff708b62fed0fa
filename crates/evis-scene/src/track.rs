//! The poses of one node over time, as a host gives them.

use std::fmt;
use std::sync::{PoisonError, RwLock};

use glam::{DMat4, DQuat, DVec3};

use crate::interpolate::{hermite, slerp};
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
}

impl HostPose {
    /// At `position` (metres) and turned by the quaternion `rotation` (x, y, z, w), with a velocity in metres per second.
    pub fn new(t_us: i64, position: [f64; 3], rotation: [f64; 4], velocity: Option<[f64; 3]>) -> Self {
        let (position, rotation) = (DVec3::from(position), DQuat::from_array(rotation));
        Self { t_us, position, rotation, velocity: velocity.map(DVec3::from) }
    }
}

/// The poses of a node in one environment. Between two of them positions run straight, or along the cubic that has the
/// velocities of both where they are given; rotations turn evenly along the shorter arc. Before the first and after the last
/// one the node rests. While it is hidden, it is scaled to nothing.
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
        let first = HostPose { t_us, position, rotation: rotation.normalize(), velocity: None };
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
    let rotation = if a.rotation == b.rotation { a.rotation } else { slerp(a.rotation, b.rotation, u) };
    (position, rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(t_us: i64, x: f64) -> HostPose {
        HostPose { t_us, position: DVec3::new(x, 0.0, 0.0), rotation: DQuat::IDENTITY, velocity: None }
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
}
