//! Where things are put, and how they move there.

use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3};

use super::check::{check_trs, checked_path};
use crate::error::SceneError;
use crate::model::Trs;
use crate::motion::{Motion, Path};
use crate::rigid_body::RigidBody;

/// Where something is, what it hangs on, and how it moves.
#[derive(Clone, Debug, Default)]
pub struct Placement {
    /// Pose in the parent's frame.
    pub pose: Trs,
    /// Motion in the frame of `pose`.
    pub path: Option<Path>,
    /// Node that carries it; `None` is the world.
    pub parent: Option<usize>,
    /// The rigid body that it is, in place of a path; `evis_physics::simulate` moves it.
    pub rigid_body: Option<RigidBody>,
}

impl Placement {
    /// At `position`, unturned.
    pub fn at(position: impl Into<DVec3>) -> Self {
        Self { pose: Trs { translation: position.into(), ..Trs::default() }, ..Self::default() }
    }

    /// Along `path`, which holds its own start.
    pub fn along(path: Path) -> Self {
        Self { path: Some(path), ..Self::default() }
    }

    /// At `eye`, with -Z (where cameras look and lights shine) towards `target` and +Y upwards.
    pub fn looking_at(eye: impl Into<DVec3>, target: impl Into<DVec3>) -> Self {
        let (eye, target) = (eye.into(), target.into());
        Self::at(eye).turned(look_rotation(target - eye, DVec3::Y))
    }

    /// With this rotation.
    pub fn turned(mut self, rotation: DQuat) -> Self {
        self.pose.rotation = rotation;
        self
    }

    /// With this scale per axis.
    pub fn scaled(mut self, scale: impl Into<DVec3>) -> Self {
        self.pose.scale = scale.into();
        self
    }

    /// On the node `parent`.
    pub fn on(mut self, parent: usize) -> Self {
        self.parent = Some(parent);
        self
    }

    /// As this rigid body; its node's pose is where it starts.
    pub fn as_body(mut self, body: RigidBody) -> Self {
        self.rigid_body = Some(body);
        self
    }

    /// Moving along `path` in the frame of the pose.
    pub fn moving(mut self, path: Path) -> Self {
        self.path = Some(path);
        self
    }

    pub(super) fn motion(&self) -> Result<Motion, SceneError> {
        check_trs(&self.pose)?;
        let Some(path) = &self.path else { return Ok(Motion::Fixed(self.pose.matrix())) };
        let path = checked_path(path)?;
        if self.pose == Trs::default() {
            return Ok(Motion::Path(Arc::new(path)));
        }
        // The scale goes last: it sizes what is placed here and leaves the path's metres alone.
        let rigid = Trs { scale: DVec3::ONE, ..self.pose };
        let mut chain = vec![still(rigid), path];
        if self.pose.scale != DVec3::ONE {
            chain.push(still(Trs { scale: self.pose.scale, ..Trs::default() }));
        }
        Ok(Motion::Path(Arc::new(Path::Chain(chain))))
    }
}

/// A path that stays where it is.
pub fn still(pose: Trs) -> Path {
    Path::ConstantVelocity { start: pose, velocity: DVec3::ZERO }
}

/// Rotation that turns -Z towards `direction` and +Y as far towards `up` as that allows. Where `direction` has no
/// length or is parallel to `up`, another upright is taken.
pub fn look_rotation(direction: DVec3, up: DVec3) -> DQuat {
    let back = -direction.normalize_or(DVec3::NEG_Z);
    let up = up.normalize_or(DVec3::Y);
    // Straight up or down: the top of the picture points to -Z (or +Y for a tilted upright along z).
    let up = if back.cross(up).length_squared() > 1e-12 {
        up
    } else if back.z.abs() < 0.9 {
        DVec3::NEG_Z
    } else {
        DVec3::Y
    };
    let right = up.cross(back).normalize();
    DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back)).normalize()
}
