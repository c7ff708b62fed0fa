//! Rigid bodies as a scene describes them: shapes, masses and throws. `evis_physics::simulate` makes motion of them.

use glam::{DMat4, DQuat, DVec3};

use crate::model::Scene;
use crate::pose::SceneState;

/// How the bodies of a scene are simulated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    /// Metres per second squared; (0, -9.81, 0) on Earth.
    pub gravity: DVec3,
    /// Steps per second, 100 to 100000. Contacts are found once per step.
    pub rate_hz: f64,
    /// Parts, 1 to 64, in which the solver takes a step.
    pub substeps: u32,
}

impl Default for Dynamics {
    fn default() -> Self {
        Self { gravity: DVec3::new(0.0, -9.81, 0.0), rate_hz: 1000.0, substeps: 4 }
    }
}

/// What a body touches others with, in the space of its node, whose scale counts; metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Collider {
    /// Axis-aligned, about the origin.
    Box {
        /// Along x, y and z.
        size: [f64; 3],
    },
    /// About the origin.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// Along y, about the origin.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Along y.
        height: f64,
    },
    /// Along y, about the origin, with half a sphere on each end.
    Capsule {
        /// Radius.
        radius: f64,
        /// Distance between the centres of the two half spheres.
        height: f64,
    },
    /// Everything below the plane through the origin whose normal is +Y, without an end. For fixed bodies.
    HalfSpace,
    /// The convex hull of the meshes of the node and of what hangs on it.
    Hull,
    /// The triangles of these meshes. For fixed bodies: a surface has no inside, so it has no mass.
    Mesh,
}

impl Collider {
    /// Name as scene files write it.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Box { .. } => "box",
            Self::Sphere { .. } => "sphere",
            Self::Cylinder { .. } => "cylinder",
            Self::Capsule { .. } => "capsule",
            Self::HalfSpace => "half_space",
            Self::Hull => "hull",
            Self::Mesh => "mesh",
        }
    }

    /// Its lengths, with their names.
    pub(crate) fn lengths(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Self::Box { size } => size.map(|s| ("size", s)).to_vec(),
            Self::Sphere { radius } => vec![("radius", radius)],
            Self::Cylinder { radius, height } | Self::Capsule { radius, height } => {
                vec![("radius", radius), ("height", height)]
            }
            Self::HalfSpace | Self::Hull | Self::Mesh => Vec::new(),
        }
    }
}

/// How heavy a body is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodyMass {
    /// Kilograms per cubic metre of the collider.
    Density(f64),
    /// Kilograms, spread evenly over the collider.
    Kilograms(f64),
}

/// Whether a body moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodyKind {
    /// Others hit it, and it stays where it is.
    Fixed,
    /// It rests until its launch, then flies, falls and bounces.
    Dynamic {
        /// Mass.
        mass: BodyMass,
        /// Velocity of its centre of mass at the launch, metres per second in the parent's frame.
        velocity: DVec3,
        /// Unit axis of its spin at the launch, in the parent's frame.
        spin_axis: DVec3,
        /// Radians per second.
        spin_rate: f64,
        /// Seconds of scene time; rounded up to a step.
        launch_s: f64,
    },
}

/// A rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBody {
    /// Whether it moves, and how it starts.
    pub kind: BodyKind,
    /// What it touches others with. `None` takes the shape that its node shows ([`crate::primitive::Shape::collider`]),
    /// or else the hull.
    pub collider: Option<Collider>,
    /// Coefficient of Coulomb friction; the mean of two bodies' counts.
    pub friction: f64,
    /// Part of the normal speed that a bounce leaves, 0 to 1; the larger one of two bodies' counts.
    pub restitution: f64,
}

/// Density of water.
const DENSITY: f64 = 1000.0;

impl RigidBody {
    /// Falls from where it is placed: 1000 kg/m³, friction 0.5, no bounce.
    pub fn dropped() -> Self {
        Self::thrown(DVec3::ZERO)
    }

    /// As [`RigidBody::dropped`], with this velocity in metres per second, in the parent's frame.
    pub fn thrown(velocity: impl Into<DVec3>) -> Self {
        let kind = BodyKind::Dynamic {
            mass: BodyMass::Density(DENSITY),
            velocity: velocity.into(),
            spin_axis: DVec3::Y,
            spin_rate: 0.0,
            launch_s: 0.0,
        };
        Self { kind, collider: None, friction: 0.5, restitution: 0.0 }
    }

    /// Stays, and lets others hit it: a floor, a wall, an obstacle.
    pub fn fixed() -> Self {
        Self { kind: BodyKind::Fixed, ..Self::dropped() }
    }

    /// With this collider.
    pub fn collider(mut self, collider: Collider) -> Self {
        self.collider = Some(collider);
        self
    }

    /// With this friction and restitution.
    pub fn surface(mut self, friction: f64, restitution: f64) -> Self {
        (self.friction, self.restitution) = (friction, restitution);
        self
    }

    /// With this mass; a fixed body has none that matters.
    pub fn mass(mut self, of: BodyMass) -> Self {
        if let BodyKind::Dynamic { mass, .. } = &mut self.kind {
            *mass = of;
        }
        self
    }

    /// Spinning about `axis` at the launch, radians per second; a fixed body does not.
    pub fn spinning(mut self, axis: impl Into<DVec3>, rate: f64) -> Self {
        if let BodyKind::Dynamic { spin_axis, spin_rate, .. } = &mut self.kind {
            (*spin_axis, *spin_rate) = (axis.into(), rate);
        }
        self
    }

    /// Launched at `t_s` seconds; a fixed body is not.
    pub fn launched(mut self, t_s: f64) -> Self {
        if let BodyKind::Dynamic { launch_s, .. } = &mut self.kind {
            *launch_s = t_s;
        }
        self
    }

    /// Whether it moves.
    pub const fn is_dynamic(&self) -> bool {
        matches!(self.kind, BodyKind::Dynamic { .. })
    }
}

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
    pub fn check_simulated(&self) -> Result<(), crate::SceneError> {
        match self.rigid_bodies.iter().find(|(_, body)| body.is_dynamic()) {
            Some((node, _)) => Err(crate::SceneError::Rule(format!(
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
        if !(error <= SHEAR * scale.abs().max_element()) {
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
