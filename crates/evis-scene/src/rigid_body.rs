//! Rigid bodies as a scene describes them: shapes, masses and throws. `evis_physics::simulate` makes motion of them.

use glam::DVec3;

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
