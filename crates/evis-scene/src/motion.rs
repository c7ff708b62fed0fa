//! Motion as functions of time: curves (glTF), paths and waveforms, evaluated exactly at any time.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::interpolate::{hermite, slerp, unit};
use crate::track::Track;
use crate::transform::Trs;

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
    /// Poses that a host gives, in the world whatever the parent is; see [`crate::Scene::drive`].
    Driven(Arc<Track>),
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
    /// Swings about `start`: a sum of sines in translation and rotation. At no time farther from it than the sum of
    /// the amplitudes.
    Harmonic {
        /// The middle of the motion.
        start: Trs,
        /// The sines that are summed.
        terms: Vec<Harmonic>,
    },
    /// `first * second * …`, each evaluated at the same time.
    Chain(Vec<Path>),
}

/// One sine of a [`Path::Harmonic`], `sin(2 pi (frequency_hz t + phase))` times its amplitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Harmonic {
    /// Cycles per second.
    pub frequency_hz: f64,
    /// Part of a cycle by which it is ahead.
    pub phase: f64,
    /// Amplitude of the translation in metres, along the axes of the path's start.
    pub translation: DVec3,
    /// Amplitude of the rotation vector (axis times angle) in radians, in the axes of the path's start.
    pub rotation: DVec3,
}

impl Harmonic {
    /// Value of the sine at `t_s` seconds.
    fn sine(&self, t_s: f64) -> f64 {
        (std::f64::consts::TAU * (self.frequency_hz * t_s + self.phase).rem_euclid(1.0)).sin()
    }
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

/// The span of `times` that holds `t_s`: lower key, upper key, position between them in [0, 1] and its length.
/// Outside the keys both are the nearest key. `None` where there is no key.
fn span(times: &[f64], t_s: f64) -> Option<(usize, usize, f64, f64)> {
    let last = times.len().checked_sub(1)?;
    // The first key above t; written so that a NaN time lands on the first key.
    let above = times.partition_point(|&key| key <= t_s);
    if above == 0 {
        return Some((0, 0, 0.0, 0.0));
    }
    if above > last {
        return Some((last, last, 0.0, 0.0));
    }
    let (t0, t1) = (times[above - 1], times[above]);
    Some((above - 1, above, (t_s - t0) / (t1 - t0), t1 - t0))
}

impl Curve {
    /// A curve that always has the given value.
    pub fn constant(values: Vec<f64>) -> Self {
        let width = values.len();
        Self { times: vec![0.0], values, width, interpolation: Interpolation::Step }
    }

    /// Whether lengths, times and values fit together.
    ///
    /// # Errors
    /// Says what does not.
    pub fn check(&self) -> Result<(), String> {
        let per_key = if self.interpolation == Interpolation::CubicSpline { 3 } else { 1 };
        let wanted = self.times.len().checked_mul(self.width).and_then(|n| n.checked_mul(per_key));
        if self.times.is_empty() {
            return Err("a curve has no keys".into());
        }
        if wanted != Some(self.values.len()) {
            return Err(format!(
                "a curve of {} keys with {} components holds {} values, not {}",
                self.times.len(),
                self.width,
                self.values.len(),
                self.times.len().saturating_mul(self.width).saturating_mul(per_key),
            ));
        }
        check_times(&self.times)?;
        match self.values.iter().find(|v| !v.is_finite()) {
            Some(v) => Err(format!("a curve holds the value {v}; values must be finite")),
            None => Ok(()),
        }
    }

    /// The value at `t_s` seconds, clamped outside the keys (glTF 2.0, appendix C). Rotations need [`Curve::rotation`].
    /// Components without a value (a curve that [`Curve::check`] refuses) are left as they are.
    pub fn sample(&self, t_s: f64, out: &mut [f64]) {
        self.visit(t_s, |i, v| {
            if let Some(slot) = out.get_mut(i) {
                *slot = v;
            }
        });
    }

    /// The unit quaternion at `t_s` seconds: slerp along the shorter arc, held, or a normalised spline.
    pub fn rotation(&self, t_s: f64) -> DQuat {
        if self.interpolation == Interpolation::Linear
            && let Some((k0, k1, u, _)) = span(&self.times, t_s)
            && let (Some(a), Some(b)) = (self.quaternion(k0), self.quaternion(k1))
        {
            return slerp(a, b, u);
        }
        let mut q = [0.0, 0.0, 0.0, 1.0];
        self.sample(t_s, &mut q);
        unit(DQuat::from_array(q))
    }

    fn quaternion(&self, key: usize) -> Option<DQuat> {
        let q = self.values.get(key * 4..key * 4 + 4)?;
        Some(unit(DQuat::from_xyzw(q[0], q[1], q[2], q[3])))
    }

    /// Calls `emit` with each component's index and value at `t_s`.
    pub(crate) fn visit(&self, t_s: f64, mut emit: impl FnMut(usize, f64)) {
        let Some((k0, k1, u, length_s)) = span(&self.times, t_s) else { return };
        let value = |row: usize, i: usize| self.values.get(row * self.width + i).copied();
        let spline = self.interpolation == Interpolation::CubicSpline;
        let [h0, ht0, h1, ht1] = hermite(u);
        for i in 0..self.width {
            let v = match self.interpolation {
                // A spline's row k is (in-tangent, value, out-tangent).
                _ if k0 == k1 => value(if spline { 3 * k0 + 1 } else { k0 }, i),
                Interpolation::Step => value(k0, i),
                Interpolation::Linear => value(k0, i)
                    .zip(value(k1, i))
                    .map(|(a, b)| if a == b { a } else { a * (1.0 - u) + b * u }),
                Interpolation::CubicSpline => value(3 * k0 + 1, i)
                    .zip(value(3 * k0 + 2, i))
                    .zip(value(3 * k1, i).zip(value(3 * k1 + 1, i)))
                    .map(|((p0, m0), (m1, p1))| {
                        if p0 == p1 && m0 == 0.0 && m1 == 0.0 {
                            // What rests keeps its bits: the weights of both values add up to 1 only but for rounding.
                            return p0;
                        }
                        h0 * p0 + ht0 * length_s * m0 + h1 * p1 + ht1 * length_s * m1
                    }),
            };
            if let Some(v) = v {
                emit(i, v);
            }
        }
    }

    /// Whether the value is the same at all times.
    pub fn rests(&self) -> bool {
        if self.width == 0 {
            return true;
        }
        let rows: Vec<&[f64]> = self.values.chunks(self.width).collect();
        if self.interpolation == Interpolation::CubicSpline {
            // Rows are (in-tangent, value, out-tangent); one key alone holds whatever its tangents are.
            let level = |key: &&[&[f64]]| {
                [key.first(), key.get(2)].into_iter().flatten().all(|t| t.iter().all(|v| *v == 0.0))
            };
            let keys: Vec<&[&[f64]]> = rows.chunks(3).collect();
            return keys.len() < 2
                || keys.iter().all(level) && keys.windows(2).all(|w| w[0].get(1) == w[1].get(1));
        }
        rows.windows(2).all(|w| w[0] == w[1])
    }

    fn vector(&self, t_s: f64, rest: DVec3) -> DVec3 {
        let mut out = rest.to_array();
        self.sample(t_s, &mut out);
        DVec3::from_array(out)
    }
}

fn check_times(times: &[f64]) -> Result<(), String> {
    if let Some(t) = times.iter().find(|t| !t.is_finite()) {
        return Err(format!("a key lies at the time {t}; times must be finite"));
    }
    match times.windows(2).find(|w| w[0] >= w[1]) {
        Some(w) => Err(format!("key times must increase, but {} follows {}", w[1], w[0])),
        None => Ok(()),
    }
}

impl Motion {
    /// `parent_from_node` at `t_s` seconds.
    pub fn matrix(&self, t_s: f64) -> DMat4 {
        match self {
            Self::Fixed(matrix) => *matrix,
            Self::Animated { rest, translation, rotation, scale } => Trs {
                translation: translation
                    .as_ref()
                    .map_or(rest.translation, |c| c.vector(t_s, rest.translation)),
                rotation: rotation.as_ref().map_or(rest.rotation, |c| c.rotation(t_s)),
                scale: scale.as_ref().map_or(rest.scale, |c| c.vector(t_s, rest.scale)),
            }
            .matrix(),
            Self::Path(path) => path.matrix(t_s),
            Self::Driven(track) => track.world_from_node(t_s * 1e6),
        }
    }

    /// Whether the matrix is the same at all times, as far as the kind of motion tells.
    pub fn is_fixed(&self) -> bool {
        match self {
            Self::Fixed(_) => true,
            Self::Animated { translation, rotation, scale, .. } => {
                [translation, rotation, scale].into_iter().flatten().all(|c| c.times.len() < 2)
            }
            Self::Path(path) => matches!(path.as_ref(), Path::Keys { times, .. } if times.len() < 2),
            Self::Driven(_) => false,
        }
    }

    /// Whether the matrix is the same at all times, by the values of what could move it.
    pub fn rests(&self) -> bool {
        match self {
            Self::Fixed(_) => true,
            Self::Animated { translation, rotation, scale, .. } => {
                [translation, rotation, scale].into_iter().flatten().all(Curve::rests)
            }
            Self::Path(path) => path.rests(),
            Self::Driven(_) => false,
        }
    }

    /// Time of the last key in seconds; `None` where the motion has no natural end.
    pub fn end_s(&self) -> Option<f64> {
        match self {
            Self::Fixed(_) => None,
            Self::Animated { translation, rotation, scale, .. } => [translation, rotation, scale]
                .into_iter()
                .flatten()
                .filter_map(|c| c.times.last().copied())
                .fold(None, |end: Option<f64>, t| Some(end.map_or(t, |e| e.max(t)))),
            Self::Path(path) => path.end_s(),
            Self::Driven(_) => None,
        }
    }

    /// Whether the motion can be evaluated at every time.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Fixed(matrix) if matrix.is_finite() => Ok(()),
            Self::Fixed(_) => Err("its matrix is not finite".into()),
            Self::Animated { rest, translation, rotation, scale } => {
                check_trs(rest)?;
                for (what, curve, width) in
                    [("translation", translation, 3), ("rotation", rotation, 4), ("scale", scale, 3)]
                {
                    let Some(curve) = curve else { continue };
                    if curve.width != width {
                        return Err(format!("its {what} curve has {} components, not {width}", curve.width));
                    }
                    curve.check().map_err(|reason| format!("{what}: {reason}"))?;
                }
                Ok(())
            }
            Self::Path(path) => path.check(),
            Self::Driven(_) => Ok(()),
        }
    }
}

/// Fastest turn, radians per second: a million degrees. Far beyond it nothing says where something is at a microsecond.
const MOST_RATE: f64 = 17_453.3;

fn check_rate(rate: f64) -> Result<(), String> {
    if rate.abs() <= MOST_RATE {
        return Ok(());
    }
    Err(format!("it turns by {} degrees per second; up to 1000000 work", rate.to_degrees()))
}

fn check_trs(trs: &Trs) -> Result<(), String> {
    if !trs.matrix().is_finite() {
        return Err("its translation, rotation or scale is not finite".into());
    }
    if (trs.rotation.length() - 1.0).abs() > 1e-3 {
        return Err(format!(
            "its rotation has length {}; rotations are unit quaternions",
            trs.rotation.length()
        ));
    }
    Ok(())
}

/// The rotation of `angle` radians about `axis`; none where the axis has no direction.
fn turn(axis: DVec3, angle: f64) -> DQuat {
    axis.try_normalize().map_or(DQuat::IDENTITY, |axis| DQuat::from_axis_angle(axis, angle))
}

/// The rotation whose -Z points along `direction` with +Y up (north up, -Z, where it points straight up or down);
/// `None` where there is no direction.
pub(crate) fn looking_along(direction: DVec3) -> Option<DQuat> {
    let back = -direction.try_normalize()?;
    let right = DVec3::Y.cross(back);
    // Near the poles the horizon is lost; any fixed rule is as good as another, as long as it is one.
    let right = if right.length_squared() > 1e-20 { right.normalize() } else { DVec3::X };
    Some(DQuat::from_mat3(&glam::DMat3::from_cols(right, back.cross(right), back)))
}

fn rigid(start: &Trs, rotation: DQuat, translation: DVec3) -> DMat4 {
    DMat4::from_scale_rotation_translation(start.scale, rotation, translation)
}

/// Catmull-Rom velocity at `key`: the slope there of the parabola through it and its neighbours; at the ends the
/// slope of the parabola through the outer three keys, so quadratic motion is reproduced exactly.
fn catmull_rom_velocity(times: &[f64], positions: &[DVec3], key: usize) -> DVec3 {
    let slope = |k: usize| (positions[k + 1] - positions[k]) / (times[k + 1] - times[k]);
    let inner = |k: usize| {
        let (before, after) = (times[k] - times[k - 1], times[k + 1] - times[k]);
        (slope(k - 1) * after + slope(k) * before) / (before + after)
    };
    let last = times.len() - 1;
    match key {
        _ if last == 0 => DVec3::ZERO,
        _ if last == 1 => slope(0),
        0 => slope(0) * 2.0 - inner(1),
        k if k == last => slope(last - 1) * 2.0 - inner(last - 1),
        k => inner(k),
    }
}

impl Path {
    /// Appends the times at which it may bend or jump, in seconds.
    pub(crate) fn break_times(&self, times: &mut Vec<f64>) {
        match self {
            Self::Ballistic { launch_s, .. } => times.push(*launch_s),
            Self::Keys { times: keys, .. } => times.extend_from_slice(keys),
            Self::Chain(paths) => paths.iter().for_each(|p| p.break_times(times)),
            Self::ConstantVelocity { .. }
            | Self::Spin { .. }
            | Self::FigureEight { .. }
            | Self::Harmonic { .. } => {}
        }
    }

    /// `parent_from_node` at `t_s` seconds.
    pub fn matrix(&self, t_s: f64) -> DMat4 {
        match self {
            Self::ConstantVelocity { start, velocity } => {
                rigid(start, start.rotation, start.translation + *velocity * t_s)
            }
            Self::Spin { start, axis, rate } => {
                rigid(start, turn(*axis, rate * t_s) * start.rotation, start.translation)
            }
            Self::FigureEight { start, size, period_s, look_at } => {
                let angle = std::f64::consts::TAU * t_s / period_s;
                let offset = DVec3::new(size[0] * angle.sin(), 0.0, size[1] * (2.0 * angle).sin());
                let position = start.translation + start.rotation * offset;
                let rotation =
                    look_at.and_then(|target| looking_along(target - position)).unwrap_or(start.rotation);
                rigid(start, rotation, position)
            }
            Self::Ballistic { start, velocity, gravity, spin_axis, spin_rate, launch_s } => {
                let t = (t_s - launch_s).max(0.0);
                let position = start.translation + *velocity * t + *gravity * (0.5 * t * t);
                rigid(start, turn(*spin_axis, spin_rate * t) * start.rotation, position)
            }
            Self::Keys { times, positions, rotations, velocities, interpolation } => {
                let (position, rotation) =
                    keyed_pose(times, positions, rotations, velocities, *interpolation, t_s)
                        .unwrap_or_default();
                DMat4::from_rotation_translation(rotation, position)
            }
            Self::Harmonic { start, terms } => {
                let sum = |amplitude: fn(&Harmonic) -> DVec3| {
                    terms.iter().map(|term| amplitude(term) * term.sine(t_s)).sum::<DVec3>()
                };
                let rotation = start.rotation * DQuat::from_scaled_axis(sum(|term| term.rotation));
                rigid(start, rotation, start.translation + start.rotation * sum(|term| term.translation))
            }
            Self::Chain(paths) => {
                paths.iter().fold(DMat4::IDENTITY, |product, path| product * path.matrix(t_s))
            }
        }
    }

    /// Time of the last key in seconds; `None` where the path goes on for ever.
    pub fn end_s(&self) -> Option<f64> {
        match self {
            Self::Keys { times, .. } => times.last().copied(),
            Self::Chain(paths) => paths.iter().map(Self::end_s).reduce(|a, b| Some(a?.max(b?))).flatten(),
            _ => None,
        }
    }

    /// Whether the path can be evaluated at every time.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        let axis_ok = |axis: &DVec3, rate: f64| {
            if !rate.is_finite() {
                Err(format!("its turn rate is {rate}; it must be finite"))
            } else if rate != 0.0 && (axis.length() - 1.0).abs() > 1e-3 {
                Err(format!("its axis {axis} is not a unit vector"))
            } else {
                Ok(())
            }
        };
        let finite = |what: &str, v: &DVec3| {
            if v.is_finite() { Ok(()) } else { Err(format!("its {what} {v} is not finite")) }
        };
        match self {
            Self::ConstantVelocity { start, velocity } => {
                check_trs(start)?;
                finite("velocity", velocity)
            }
            Self::Spin { start, axis, rate } => {
                check_trs(start)?;
                axis_ok(axis, *rate)?;
                check_rate(*rate)
            }
            Self::FigureEight { start, size, period_s, look_at } => {
                check_trs(start)?;
                finite("size", &DVec3::new(size[0], 0.0, size[1]))?;
                finite("point to look at", &look_at.unwrap_or_default())?;
                if period_s.is_finite() && *period_s > 0.0 {
                    Ok(())
                } else {
                    Err(format!("its period is {period_s} s; it must be above 0"))
                }
            }
            Self::Ballistic { start, velocity, gravity, spin_axis, spin_rate, launch_s } => {
                check_trs(start)?;
                finite("velocity", velocity)?;
                finite("gravity", gravity)?;
                finite("launch time", &DVec3::splat(*launch_s))?;
                axis_ok(spin_axis, *spin_rate)?;
                check_rate(*spin_rate)
            }
            Self::Keys { times, positions, rotations, velocities, interpolation } => {
                let n = times.len();
                if n == 0 {
                    return Err("it has no poses".into());
                }
                let hermite = *interpolation == PathInterpolation::Hermite;
                if positions.len() != n || rotations.len() != n || (hermite && velocities.len() != n) {
                    return Err(format!(
                        "it has {n} times, {} positions, {} rotations and {} velocities; these numbers must agree",
                        positions.len(),
                        rotations.len(),
                        velocities.len(),
                    ));
                }
                check_times(times)?;
                positions.iter().try_for_each(|p| finite("position", p))?;
                velocities.iter().try_for_each(|v| finite("velocity", v))?;
                match rotations.iter().find(|q| (q.length() - 1.0).abs() > 1e-3 || !q.is_finite()) {
                    Some(q) => Err(format!("its rotation {q} has length {}; rotations are unit", q.length())),
                    None => Ok(()),
                }
            }
            Self::Harmonic { start, terms } => {
                check_trs(start)?;
                terms.iter().try_for_each(|term| {
                    finite("frequency and phase", &DVec3::new(term.frequency_hz, term.phase, 0.0))?;
                    finite("amplitude of translation", &term.translation)?;
                    finite("amplitude of rotation", &term.rotation)
                })
            }
            Self::Chain(paths) => paths.iter().try_for_each(Self::check),
        }
    }

    /// Whether the matrix is the same at all times, whatever kind of path it is.
    pub fn rests(&self) -> bool {
        let zero = |v: &DVec3| *v == DVec3::ZERO;
        match self {
            Self::ConstantVelocity { velocity, .. } => zero(velocity),
            Self::Spin { rate, .. } => *rate == 0.0,
            Self::FigureEight { size, .. } => *size == [0.0; 2],
            Self::Ballistic { velocity, gravity, spin_rate, .. } => {
                zero(velocity) && zero(gravity) && *spin_rate == 0.0
            }
            Self::Keys { positions, rotations, velocities, .. } => {
                positions.windows(2).all(|w| w[0] == w[1])
                    && rotations.windows(2).all(|w| w[0] == w[1])
                    && velocities.iter().all(zero)
            }
            Self::Harmonic { terms, .. } => terms.iter().all(|t| zero(&t.translation) && zero(&t.rotation)),
            Self::Chain(paths) => paths.iter().all(Self::rests),
        }
    }
}

/// Position and rotation at `t_s`; `None` where keys are missing (a path that [`Path::check`] refuses).
fn keyed_pose(
    times: &[f64],
    positions: &[DVec3],
    rotations: &[DQuat],
    velocities: &[DVec3],
    rule: PathInterpolation,
    t_s: f64,
) -> Option<(DVec3, DQuat)> {
    let (k0, k1, u, length_s) = span(times, t_s)?;
    if positions.len() != times.len() || rotations.len() != times.len() {
        return None;
    }
    let (p0, p1) = (positions[k0], positions[k1]);
    let spline = |m0: DVec3, m1: DVec3| {
        let [h0, ht0, h1, ht1] = hermite(u);
        p0 * h0 + m0 * (ht0 * length_s) + p1 * h1 + m1 * (ht1 * length_s)
    };
    let position = match rule {
        _ if k0 == k1 => p0,
        PathInterpolation::Linear => p0 * (1.0 - u) + p1 * u,
        PathInterpolation::CatmullRom => {
            spline(catmull_rom_velocity(times, positions, k0), catmull_rom_velocity(times, positions, k1))
        }
        PathInterpolation::Hermite => spline(*velocities.get(k0)?, *velocities.get(k1)?),
    };
    Some((position, slerp(unit(rotations[k0]), unit(rotations[k1]), u)))
}

impl Waveform {
    /// Appends the times of its edges in a range and just around it, in seconds.
    pub(crate) fn edge_times(&self, [from, to]: [f64; 2], times: &mut Vec<f64>) {
        let duty = match self.shape {
            WaveShape::Sine => return,
            WaveShape::Square => 0.5,
            WaveShape::Pwm { duty } => duty,
        };
        if self.frequency_hz <= 0.0 {
            return;
        }
        let first = (from * self.frequency_hz + self.phase).floor();
        let last = (to * self.frequency_hz + self.phase).ceil();
        let mut cycle = first;
        while cycle <= last {
            times.extend([cycle, cycle + duty].map(|c| (c - self.phase) / self.frequency_hz));
            cycle += 1.0;
        }
    }

    /// Whether the factor is the same at all times.
    pub fn rests(&self) -> bool {
        self.low == self.high || self.frequency_hz == 0.0
    }

    /// The factor at `t_s` seconds, never negative.
    pub fn factor(&self, t_s: f64) -> f64 {
        let cycle = (self.frequency_hz * t_s + self.phase).rem_euclid(1.0);
        let part_high = |duty: f64| if cycle < duty { self.high } else { self.low };
        let value = match self.shape {
            WaveShape::Sine => {
                0.5 * (self.low + self.high)
                    + 0.5 * (self.high - self.low) * (std::f64::consts::TAU * cycle).sin()
            }
            WaveShape::Square => part_high(0.5),
            WaveShape::Pwm { duty } => part_high(duty),
        };
        value.max(0.0)
    }

    /// Whether the waveform has a factor at every time.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        let not_negative = |what: &str, v: f64| {
            if v.is_finite() && v >= 0.0 {
                Ok(())
            } else {
                Err(format!("{what} is {v}; it must be 0 or more"))
            }
        };
        not_negative("frequency_hz", self.frequency_hz)?;
        not_negative("low", self.low)?;
        not_negative("high", self.high)?;
        if !self.phase.is_finite() {
            return Err(format!("phase is {}; it must be finite", self.phase));
        }
        match self.shape {
            WaveShape::Pwm { duty } if !(duty > 0.0 && duty < 1.0) => {
                Err(format!("duty is {duty}; it must lie between 0 and 1"))
            }
            _ => Ok(()),
        }
    }
}

/// How a scene's cameras were moved, as recordings store it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AppliedMotion {
    /// `none`, `orbit`, `dolly`, `shake`, or a file of poses.
    pub motion: String,
    /// Mean image speed that was asked for, in pixels per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_px_per_s: Option<f64>,
    /// Whether nobody asked for it: the scene has neither a camera nor any motion.
    pub by_default: bool,
    /// What moves how fast, in the scene's units.
    pub description: String,
}
