//! Rigid bodies among the nodes of a scene: where they start, and what keeps them from being simulated.

use glam::{DMat4, DQuat, DVec3};

use crate::error::SceneError;
use crate::model::Scene;
use crate::pose::SceneState;
use crate::rigid_body::Collider;

/// Where a body's node is in the world, and how large.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyPose {
    /// Metres.
    pub translation: DVec3,
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Per axis of the node.
    pub scale: DVec3,
}

/// Relative error of a matrix up to which it counts as one without shear.
const SHEAR: f64 = 1e-9;

impl Scene {
    /// Refuses a scene whose bodies nothing has simulated: they would hang in the air.
    ///
    /// # Errors
    /// Names such a body.
    pub fn check_simulated(&self) -> Result<(), SceneError> {
        match self.rigid_bodies.iter().find(|(_, body)| body.is_dynamic()) {
            Some((node, _)) => Err(SceneError::Rule(format!(
                "{} is a rigid body that was not simulated; call evis_physics::simulate on the scene first",
                self.body_label(*node)
            ))),
            None => Ok(()),
        }
    }

    /// World pose of the node of a body at the start; all of its ancestors rest.
    ///
    /// # Errors
    /// A node that moves, and scales that skew.
    pub fn body_pose(&self, node: usize) -> Result<BodyPose, String> {
        let label = self.body_label(node);
        let mut at = Some(node);
        while let Some(index) = at {
            let Some(found) = self.nodes.get(index) else { break };
            if !found.motion.rests() {
                return Err(if index == node {
                    format!("{label} has a motion and is a rigid body; give it one of the two")
                } else {
                    format!(
                        "{label} hangs on {}, which moves; the parents of a rigid body must rest",
                        self.body_label(index)
                    )
                });
            }
            at = found.parent;
        }
        let mut state = SceneState::default();
        self.evaluate(0.0, &mut state);
        let world = state.world_from_node.get(node).copied().unwrap_or_default();
        let (scale, rotation, translation) = world.to_scale_rotation_translation();
        let again = DMat4::from_scale_rotation_translation(scale, rotation, translation);
        let error = (again - world).to_cols_array().into_iter().fold(0.0, |e: f64, v| e.max(v.abs()));
        // A scale of 0 leaves no rotation.
        let upright = rotation.is_finite() && error <= SHEAR * scale.abs().max_element();
        if !upright {
            return Err(format!(
                "{label} is skewed by the scales above it; a rigid body takes parents that are scaled the same along all axes"
            ));
        }
        Ok(BodyPose { translation, rotation, scale })
    }

    /// Everything about bodies that depends on the scene around them.
    ///
    /// # Errors
    /// Says which body cannot be simulated, why, and what would work.
    pub fn check_rigid_bodies(&self) -> Result<(), String> {
        for (i, (node, body)) in self.rigid_bodies.iter().enumerate() {
            let label = self.body_label(*node);
            if *node >= self.nodes.len() {
                return Err(format!("a rigid body has node {node}; there are {}", self.nodes.len()));
            }
            if self.rigid_bodies[..i].iter().any(|(other, _)| other == node) {
                return Err(format!("{label} has two rigid bodies; it takes one"));
            }
            let mut above = self.nodes[*node].parent;
            while let Some(parent) = above {
                let carrier = self.rigid_bodies.iter().find(|(n, body)| *n == parent && body.is_dynamic());
                if carrier.is_some() {
                    return Err(format!(
                        "{label} hangs on the rigid body {} and is one itself; leave it out, it moves along, or hang it elsewhere",
                        self.body_label(parent)
                    ));
                }
                above = self.nodes[parent].parent;
            }
            let pose = self.body_pose(*node)?;
            check_scale(body.collider.unwrap_or(Collider::Hull), pose.scale)
                .map_err(|error| format!("{label}: {error}"))?;
            if body.is_dynamic() && self.duration_s.is_none() {
                return Err(format!(
                    "{label} is a rigid body, and the scene has no duration_s until which it is to be simulated; give one"
                ));
            }
            if self
                .variants
                .iter()
                .flat_map(|v| &v.node_offsets)
                .any(|(moved, _)| self.carries(*moved, *node))
            {
                return Err(format!(
                    "an environment has an offset for {label} or what it hangs on; rigid bodies are simulated once for all environments, so leave it out"
                ));
            }
        }
        Ok(())
    }

    /// Whether `node` is `above`, or hangs on it.
    pub fn carries(&self, above: usize, node: usize) -> bool {
        std::iter::successors(Some(node), |n| self.nodes.get(*n)?.parent).any(|n| n == above)
    }

    fn body_label(&self, node: usize) -> String {
        match self.nodes.get(node) {
            Some(found) if !found.name.is_empty() => format!("'{}'", found.name),
            _ => format!("node {node}"),
        }
    }
}

/// Refuses scales that make another shape of a collider.
fn check_scale(collider: Collider, scale: DVec3) -> Result<(), String> {
    let [x, y, z] = scale.abs().to_array();
    let same = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.max(b);
    let fits = match collider {
        Collider::Sphere { .. } | Collider::Capsule { .. } => same(x, y) && same(y, z),
        Collider::Cylinder { .. } => same(x, z),
        Collider::Box { .. } | Collider::HalfSpace | Collider::Hull | Collider::Mesh => true,
    };
    if fits {
        return Ok(());
    }
    Err(format!(
        "its scale is {scale}, which makes no {} of a {}; use the collider \"hull\", or another size in place of the scale",
        collider.name(),
        collider.name()
    ))
}
