//! Rigid bodies of scene files.

use glam::DVec3;

use super::keys::Keys;
use super::motion::vector;
use crate::builder::SceneBuilder;
use crate::error::SceneError;
use crate::rigid_body::{BodyKind, BodyMass, Collider, Dynamics, RigidBody};

/// The table `[dynamics]`.
pub(super) fn dynamics(mut keys: Keys<'_>, scene: &mut SceneBuilder) -> Result<(), SceneError> {
    let default = Dynamics::default();
    let dynamics = Dynamics {
        gravity: vector(&mut keys, "gravity")?.unwrap_or(default.gravity),
        rate_hz: keys.number_or("rate_hz", default.rate_hz)?,
        substeps: keys.integer("substeps", 64)?.map_or(default.substeps, |n| n as u32),
    };
    scene.dynamics(dynamics).map_err(|e| keys.locate(e))?;
    keys.finish()
}

/// The table under `rigid_body`.
pub(super) fn rigid_body(keys: &mut Keys<'_>) -> Result<Option<RigidBody>, SceneError> {
    let Some(mut keys) = keys.table("rigid_body")? else { return Ok(None) };
    let fixed = keys.flag("fixed")?.unwrap_or(false);
    let mut body = if fixed { RigidBody::fixed() } else { RigidBody::dropped() };
    body.collider = collider(&mut keys)?;
    body.friction = keys.number_or("friction", body.friction)?;
    body.restitution = keys.number_or("restitution", body.restitution)?;
    // What moves has these keys; a fixed body has none of them, so they are unknown there.
    if let BodyKind::Dynamic { mass, velocity, spin_axis, spin_rate, launch_s } = &mut body.kind {
        keys.at_most_one(&["density", "mass"])?;
        if let Some(density) = keys.number("density")? {
            *mass = BodyMass::Density(density);
        }
        if let Some(kilograms) = keys.number("mass")? {
            *mass = BodyMass::Kilograms(kilograms);
        }
        *velocity = vector(&mut keys, "velocity")?.unwrap_or(*velocity);
        *spin_axis = vector(&mut keys, "spin_axis")?.unwrap_or(DVec3::Y);
        *spin_rate = keys.number_or("spin_degrees_per_s", 0.0)?.to_radians();
        *launch_s = keys.number_or("launch_s", 0.0)?;
    }
    keys.finish()?;
    Ok(Some(body))
}

fn collider(keys: &mut Keys<'_>) -> Result<Option<Collider>, SceneError> {
    let kinds = [
        Collider::Box { size: [1.0; 3] },
        Collider::Sphere { radius: 1.0 },
        Collider::Cylinder { radius: 1.0, height: 1.0 },
        Collider::Capsule { radius: 1.0, height: 1.0 },
        Collider::HalfSpace,
        Collider::Hull,
        Collider::Mesh,
    ]
    .map(|collider| (collider.name(), collider));
    let Some(mut collider) = keys.choice("shape", &kinds)? else { return Ok(None) };
    match &mut collider {
        Collider::Box { size } => {
            let given = keys.numbers::<3>("size")?;
            *size = keys.needs("size", given)?;
        }
        Collider::Sphere { radius } => *radius = needed(keys, "radius")?,
        Collider::Cylinder { radius, height } | Collider::Capsule { radius, height } => {
            (*radius, *height) = (needed(keys, "radius")?, needed(keys, "height")?);
        }
        Collider::HalfSpace | Collider::Hull | Collider::Mesh => {}
    }
    Ok(Some(collider))
}

fn needed(keys: &mut Keys<'_>, key: &'static str) -> Result<f64, SceneError> {
    let value = keys.number(key)?;
    keys.needs(key, value)
}
