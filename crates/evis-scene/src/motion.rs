//! Motion as functions of time: curves (glTF), paths and waveforms, evaluated exactly at any time.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3};

use crate::model::Trs;

/// How values between keys are found (glTF 2.0, appendix C).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// Straight, or along the shorter arc for rotations.
    #[default]
    Linear,
    /// Holds the last key.
    Step,
    /// Hermite with in- and out-tangents; values hold (in-tangent, value, out-tangent) per key.
    CubicSpline,
}

/// A sampled curve of vectors with `width` components (3, 4 for quaternions xyzw, or the number of morph targets).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Seconds, strictly increasing.
    pub times: Vec<f64>,
    /// `times.len() * width` values, three times as many for [`Interpolation::CubicSpline`].
    pub values: Vec<f64>,
    /// Components per key.
    pub width: usize,
    /// Rule between keys.
    pub interpolation: Interpolation,
}

/// `parent_from_node` over time.
#[derive(Clone, Debug)]
pub enum Motion {
    /// Never moves.
    Fixed(DMat4),
    /// glTF animation: each channel replaces the rest value.
    Animated {
        /// Values of the channels that have no curve.
        rest: Trs,
        /// 3 components.
        translation: Option<Curve>,
        /// 4 components, (x, y, z, w).
        rotation: Option<Curve>,
        /// 3 components.
        scale: Option<Curve>,
    },
    /// A rigid path.
    Path(Arc<Path>),
}

impl Default for Motion {
    fn default() -> Self {
        Self::Fixed(DMat4::IDENTITY)
    }
}

/// How poses between keys are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PathInterpolation {
    /// Straight positions, slerp for rotations.
    #[default]
    Linear,
    /// Catmull-Rom positions (non-uniform knots), slerp for rotations.
    CatmullRom,
    /// Cubic Hermite positions with given velocities, slerp for rotations.
    Hermite,
}

/// A rigid path: analytic, or through poses.
#[derive(Clone, Debug)]
pub enum Path {
    /// `start + velocity * t`, fixed rotation.
    ConstantVelocity {
        /// Pose at t = 0.
        start: Trs,
        /// Metres per second.
        velocity: DVec3,
    },
    /// Turns about an axis through `start`'s origin.
    Spin {
        /// Pose at t = 0.
        start: Trs,
        /// Unit axis, in the parent's frame.
        axis: DVec3,
        /// Radians per second.
        rate: f64,
    },
    /// Lemniscate of Gerono in the plane of `start`'s x and z: x = a sin(wt), z = b sin(2wt).
    FigureEight {
        /// Centre and rotation.
        start: Trs,
        /// (a, b) in metres.
        size: [f64; 2],
        /// Seconds per round.
        period_s: f64,
        /// Point to look at, in the parent's frame; `None` keeps `start`'s rotation.
        look_at: Option<DVec3>,
    },
    /// Free fall after a launch, spinning; stays at its start before `launch_s`.
    Ballistic {
        /// Pose at launch.
        start: Trs,
        /// Launch velocity, metres per second.
        velocity: DVec3,
        /// Acceleration, (0, -9.81, 0) on Earth.
        gravity: DVec3,
        /// Unit axis of the spin.
        spin_axis: DVec3,
        /// Radians per second.
        spin_rate: f64,
        /// Seconds.
        launch_s: f64,
    },
    /// Through poses at given times; clamped outside them.
    Keys {
        /// Seconds, strictly increasing.
        times: Vec<f64>,
        /// Positions.
        positions: Vec<DVec3>,
        /// Rotations.
        rotations: Vec<DQuat>,
        /// Metres per second at each key, for [`PathInterpolation::Hermite`]; empty otherwise.
        velocities: Vec<DVec3>,
        /// Rule between keys.
        interpolation: PathInterpolation,
    },
    /// `first * second * …`, each evaluated at the same time.
    Chain(Vec<Path>),
}

/// Periodic factor on light or emission, never negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waveform {
    /// Shape.
    pub shape: WaveShape,
    /// Cycles per second.
    pub frequency_hz: f64,
    /// Part of a cycle by which it is ahead, in [0, 1).
    pub phase: f64,
    /// Value at the low end.
    pub low: f64,
    /// Value at the high end.
    pub high: f64,
}

/// Shape of a [`Waveform`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WaveShape {
    /// Sine between low and high, at the middle and rising at phase 0.
    Sine,
    /// High in the first half of a cycle, low in the second.
    Square,
    /// High in the first `duty` of a cycle, low in the rest.
    Pwm {
        /// In (0, 1).
        duty: f64,
    },
}
