//! Poses that a host gives while the scene runs: a physics engine, an agent, a recording that is still being made.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use glam::DVec3;

use crate::error::SceneError;
use crate::track::{HostPose, Track};

/// How far a quaternion's length may be from 1.
const UNIT_TOLERANCE: f64 = 1e-3;

/// The nodes of a scene that a host moves, in each environment, and until when their poses are known.
#[derive(Debug)]
pub struct HostPoses {
    names: Vec<String>,
    /// By environment, then in the order of `names`.
    tracks: Vec<Vec<Arc<Track>>>,
    known_until_us: AtomicI64,
}

impl HostPoses {
    /// Everything is known until `known_until_us`, where `tracks` begin: by environment, then in the order of `names`.
    pub(crate) const fn new(names: Vec<String>, tracks: Vec<Vec<Arc<Track>>>, known_until_us: i64) -> Self {
        Self { names, tracks, known_until_us: AtomicI64::new(known_until_us) }
    }

    /// Names of the nodes, as they were asked for.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of environments.
    pub fn environments(&self) -> usize {
        self.tracks.len()
    }

    /// Scene time in microseconds until which the poses of all nodes are known. Nothing is sampled after it.
    pub fn known_until_us(&self) -> i64 {
        self.known_until_us.load(Ordering::Acquire)
    }

    /// Whether `poses` of node `node` (an index into [`HostPoses::names`]) in `environment` may follow what is known, up to
    /// `until_us`.
    ///
    /// # Errors
    /// Nodes and environments that do not exist, times that do not ascend from what is known to `until_us`, values that are
    /// not finite, rotations that are no unit quaternions.
    pub fn check(
        &self,
        environment: usize,
        node: usize,
        poses: &[HostPose],
        until_us: i64,
    ) -> Result<(), SceneError> {
        let (Some(name), Some(track)) =
            (self.names.get(node), self.tracks.get(environment).and_then(|tracks| tracks.get(node)))
        else {
            return Err(SceneError::Rule(format!(
                "pose of node {node} in environment {environment}: a host moves {} node(s) in {} environment(s)",
                self.names.len(),
                self.tracks.len()
            )));
        };
        let place = || {
            if self.tracks.len() > 1 {
                format!("'{name}' of environment {environment}")
            } else {
                format!("'{name}'")
            }
        };
        let rule = |text: String| Err(SceneError::Rule(format!("pose of {}: {text}", place())));
        let known = track.last_us();
        let mut last = if track.is_new() { known - 1 } else { known };
        for pose in poses {
            if pose.t_us <= last {
                return rule(format!(
                    "its time is {} us; poses are known until {known} us, and must go on from there in order",
                    pose.t_us
                ));
            }
            last = pose.t_us;
            let velocity = pose.velocity.unwrap_or(DVec3::ZERO);
            if !(pose.position.is_finite() && pose.rotation.is_finite() && velocity.is_finite()) {
                return rule(format!("it holds a value that is not finite, at {} us", pose.t_us));
            }
            let length = pose.rotation.length();
            if (length - 1.0).abs() > UNIT_TOLERANCE {
                return rule(format!(
                    "its rotation has the length {length:.6} at {} us; give a unit quaternion (x, y, z, w)",
                    pose.t_us
                ));
            }
        }
        match poses.last() {
            Some(pose) if pose.t_us != until_us => {
                rule(format!("the last one is at {} us; the step ends at {until_us} us", pose.t_us))
            }
            _ => Ok(()),
        }
    }

    /// Makes everything known until `until_us`, with `poses` per environment, node and its poses. A node that is not among
    /// them stays where it is.
    ///
    /// # Errors
    /// As [`HostPoses::check`]; then nothing has changed.
    pub fn advance(&self, poses: &[(usize, usize, Vec<HostPose>)], until_us: i64) -> Result<(), SceneError> {
        let mut seen = HashSet::with_capacity(poses.len());
        for (environment, node, of) in poses {
            self.check(*environment, *node, of, until_us)?;
            if !seen.insert((environment, node)) {
                return Err(SceneError::Rule(format!("poses of '{}' are given twice", self.names[*node])));
            }
        }
        for (environment, node, poses) in poses {
            let unit: Vec<HostPose> =
                poses.iter().map(|p| HostPose { rotation: p.rotation.normalize(), ..*p }).collect();
            self.tracks[*environment][*node].append(&unit);
        }
        for track in self.tracks.iter().flatten() {
            let last_us = track.last_us();
            if last_us < until_us {
                // It rests: without a pose here, the next one would move it from the last one on.
                let rest = track.last().map(|pose| HostPose { t_us: until_us, velocity: None, ..pose });
                track.append(rest.as_slice());
            }
        }
        self.known_until_us.store(until_us, Ordering::Release);
        Ok(())
    }

    /// Lets nodes jump, now: each is at its pose, which is at [`HostPoses::known_until_us`], and was there before. What it was
    /// given earlier is forgotten. By environment and node, as [`HostPoses::advance`] has them.
    ///
    /// # Errors
    /// As [`HostPoses::check`]; then nothing has changed.
    pub fn jump(&self, poses: &[(usize, usize, HostPose)]) -> Result<(), SceneError> {
        let now_us = self.known_until_us();
        for (environment, node, pose) in poses {
            // Any time that follows will do for the rules of the rest.
            self.check(*environment, *node, &[HostPose { t_us: now_us + 1, ..*pose }], now_us + 1)?;
        }
        for (environment, node, pose) in poses {
            let unit =
                HostPose { t_us: now_us, rotation: pose.rotation.normalize(), velocity: None, ..*pose };
            self.tracks[*environment][*node].replace(&[HostPose { t_us: now_us - 1, ..unit }, unit]);
        }
        Ok(())
    }

    /// Forgets poses that no time from `t_us` on needs.
    pub fn forget_before(&self, t_us: i64) {
        self.tracks.iter().flatten().for_each(|track| track.forget_before(t_us));
    }
}
