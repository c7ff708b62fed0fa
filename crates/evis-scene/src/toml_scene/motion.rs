//! Poses, motions and waveforms of scene files.

use glam::{DQuat, DVec3, EulerRot};

use super::keys::Keys;
use super::trajectory::{self, Format};
use crate::builder::{Placement, look_rotation, still};
use crate::error::SceneError;
use crate::model::Trs;
use crate::motion::{Path, PathInterpolation, WaveShape, Waveform};

/// Pose and motion of an object; the parent is left to the caller.
pub(super) fn placement(keys: &mut Keys<'_>) -> Result<Placement, SceneError> {
    let pose = pose(keys)?;
    let Some(mut motion) = keys.table("motion")? else {
        return Ok(Placement { pose, ..Placement::default() });
    };
    let (path, started) = path(&mut motion, pose)?;
    motion.finish()?;
    let pose = if started { Trs::default() } else { pose };
    Ok(Placement { pose, path: Some(path), ..Placement::default() })
}

/// `position`, one way to turn, `scale`.
pub(super) fn pose(keys: &mut Keys<'_>) -> Result<Trs, SceneError> {
    let translation = vector(keys, "position")?.unwrap_or_default();
    keys.at_most_one(&["rotation", "rotation_degrees", "look_at"])?;
    let mut rotation = DQuat::IDENTITY;
    if let Some(xyzw) = keys.numbers::<4>("rotation")? {
        let given = DQuat::from_array(xyzw);
        if !(0.99..=1.01).contains(&given.length()) {
            return Err(keys.error(format!(
                "rotation is {xyzw:?} with length {:.4}; it takes a unit quaternion [x, y, z, w]",
                given.length()
            )));
        }
        rotation = given.normalize();
    }
    if let Some(degrees) = vector(keys, "rotation_degrees")? {
        let [x, y, z] = degrees.to_array().map(f64::to_radians);
        rotation = DQuat::from_euler(EulerRot::ZYX, z, y, x);
    }
    let up = vector(keys, "up")?;
    match (vector(keys, "look_at")?, up) {
        (Some(target), _) if target == translation => {
            return Err(
                keys.error(format!("look_at is {target}, the position itself; it takes another point"))
            );
        }
        (Some(target), up) => rotation = look_rotation(target - translation, up.unwrap_or(DVec3::Y)),
        (None, Some(up)) => {
            return Err(keys.error(format!("up is {up}, but there is no look_at that it could belong to")));
        }
        (None, None) => {}
    }
    let scale = match keys.get("scale") {
        Some(toml::Value::Array(_)) => vector(keys, "scale")?.unwrap_or(DVec3::ONE),
        _ => DVec3::splat(keys.number_or("scale", 1.0)?),
    };
    Ok(Trs { translation, rotation, scale })
}

#[derive(Clone, Copy)]
enum Kind {
    ConstantVelocity,
    Spin,
    FigureEight,
    Ballistic,
    Trajectory,
    Keys,
    Chain,
}

const KINDS: [(&str, Kind); 7] = [
    ("constant_velocity", Kind::ConstantVelocity),
    ("spin", Kind::Spin),
    ("figure_eight", Kind::FigureEight),
    ("ballistic", Kind::Ballistic),
    ("trajectory", Kind::Trajectory),
    ("keys", Kind::Keys),
    ("chain", Kind::Chain),
];

/// The motion of a table, and whether `start` is in it; where not, the motion happens in the frame of `start`.
fn path(keys: &mut Keys<'_>, start: Trs) -> Result<(Path, bool), SceneError> {
    let kind = keys.choice("kind", &KINDS)?;
    let path = match keys.needs("kind", kind)? {
        Kind::ConstantVelocity => {
            let velocity = vector(keys, "velocity")?;
            Path::ConstantVelocity { start, velocity: keys.needs("velocity", velocity)? }
        }
        Kind::Spin => {
            let rate = keys.number("degrees_per_s")?;
            let rate = keys.needs("degrees_per_s", rate)?.to_radians();
            Path::Spin { start, axis: vector(keys, "axis")?.unwrap_or(DVec3::Y), rate }
        }
        Kind::FigureEight => {
            let (size, period_s) = (keys.numbers::<2>("size")?, keys.number("period_s")?);
            let (size, period_s) = (keys.needs("size", size)?, keys.needs("period_s", period_s)?);
            Path::FigureEight { start, size, period_s, look_at: vector(keys, "look_at")? }
        }
        Kind::Ballistic => {
            let velocity = vector(keys, "velocity")?;
            Path::Ballistic {
                start,
                velocity: keys.needs("velocity", velocity)?,
                gravity: vector(keys, "gravity")?.unwrap_or(DVec3::new(0.0, -9.81, 0.0)),
                spin_axis: vector(keys, "spin_axis")?.unwrap_or(DVec3::Y),
                spin_rate: keys.number_or("spin_degrees_per_s", 0.0)?.to_radians(),
                launch_s: keys.number_or("launch_s", 0.0)?,
            }
        }
        Kind::Trajectory => return Ok((trajectory_file(keys)?, false)),
        Kind::Keys => return Ok((key_poses(keys)?, false)),
        Kind::Chain => {
            let mut links = Vec::new();
            for mut link in keys.tables("motions")? {
                let pose = pose(&mut link)?;
                let (path, started) =
                    if link.has("kind") { path(&mut link, pose)? } else { (still(pose), true) };
                if !started && pose != Trs::default() {
                    links.push(still(pose));
                }
                links.push(path);
                link.finish()?;
            }
            if links.is_empty() {
                return Err(
                    keys.error("motions is missing or empty; a chain takes a list of at least one motion")
                );
            }
            return Ok((Path::Chain(links), false));
        }
    };
    Ok((path, true))
}

fn trajectory_file(keys: &mut Keys<'_>) -> Result<Path, SceneError> {
    let file = keys.file("file")?;
    let format = Format {
        unit_s: keys.choice("time_unit", &trajectory::UNITS)?,
        from_zero: keys.flag("from_zero")?.unwrap_or(true),
        offset_s: keys.number_or("time_offset_s", 0.0)?,
        opencv_axes: keys.choice("axes", &[("opengl", false), ("opencv", true)])?.unwrap_or(false),
        interpolation: interpolation(keys)?,
    };
    trajectory::load(&keys.needs("file", file)?, format)
}

fn key_poses(keys: &mut Keys<'_>) -> Result<Path, SceneError> {
    let (times, positions) = (keys.list("times_s")?, keys.rows::<3>("positions")?);
    let times = keys.needs("times_s", times)?;
    let positions: Vec<_> = keys.needs("positions", positions)?.into_iter().map(DVec3::from_array).collect();
    let rotations = match keys.rows::<4>("rotations")? {
        Some(rows) => rows.into_iter().map(|q| DQuat::from_array(q).normalize()).collect(),
        None => vec![DQuat::IDENTITY; positions.len()],
    };
    let velocities =
        keys.rows::<3>("velocities")?.unwrap_or_default().into_iter().map(DVec3::from_array).collect();
    Ok(Path::Keys { times, positions, rotations, velocities, interpolation: interpolation(keys)? })
}

fn interpolation(keys: &mut Keys<'_>) -> Result<PathInterpolation, SceneError> {
    let rules = [
        ("linear", PathInterpolation::Linear),
        ("catmull_rom", PathInterpolation::CatmullRom),
        ("hermite", PathInterpolation::Hermite),
    ];
    Ok(keys.choice("interpolation", &rules)?.unwrap_or_default())
}

/// The waveform under `key`.
pub(super) fn waveform(keys: &mut Keys<'_>, key: &'static str) -> Result<Option<Waveform>, SceneError> {
    let Some(mut keys) = keys.table(key)? else { return Ok(None) };
    let shapes = [("sine", 0), ("square", 1), ("pwm", 2)];
    let shape = keys.choice("shape", &shapes)?;
    let shape = match keys.needs("shape", shape)? {
        0 => WaveShape::Sine,
        1 => WaveShape::Square,
        _ => {
            let duty = keys.number("duty")?;
            WaveShape::Pwm { duty: keys.needs("duty", duty)? }
        }
    };
    let frequency_hz = keys.number("frequency_hz")?;
    let waveform = Waveform {
        shape,
        frequency_hz: keys.needs("frequency_hz", frequency_hz)?,
        phase: keys.number_or("phase", 0.0)?,
        low: keys.number_or("low", 0.0)?,
        high: keys.number_or("high", 1.0)?,
    };
    keys.finish()?;
    Ok(Some(waveform))
}

/// Three numbers.
pub(super) fn vector(keys: &mut Keys<'_>, key: &'static str) -> Result<Option<DVec3>, SceneError> {
    Ok(keys.numbers::<3>(key)?.map(DVec3::from_array))
}
