//! What a builder refuses: each check names the value and what works.

use glam::{DQuat, DVec3};

use super::camera::EventCamera;
use crate::error::SceneError;
use crate::factors::{light_color, within};
use crate::model::{AlphaMode, Lens, Light, LightKind, Material, Primitive, TextureRef, Trs};
use crate::motion::{Path, WaveShape, Waveform};
use crate::rigid_body::{BodyKind, BodyMass, Collider, RigidBody};

pub(super) fn rule<T>(message: String) -> Result<T, SceneError> {
    Err(SceneError::Rule(message))
}

pub(super) fn in_object(name: &str, error: SceneError) -> SceneError {
    match error {
        SceneError::Rule(message) => SceneError::Rule(format!("'{name}': {message}")),
        other => other,
    }
}

pub(super) fn finite(what: &str, value: f64) -> Result<(), SceneError> {
    if value.is_finite() { Ok(()) } else { rule(format!("{what} is {value}; it takes a finite number")) }
}

pub(super) fn positive(what: &str, value: f64, unit: &str) -> Result<(), SceneError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    rule(format!("{what} is {value}; it takes {unit} above 0"))
}

pub(super) fn not_negative(what: &str, value: f64, unit: &str) -> Result<(), SceneError> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    rule(format!("{what} is {value}; it takes {unit}, 0 or more"))
}

pub(super) fn check_waveform(waveform: &Waveform) -> Result<(), SceneError> {
    positive("frequency_hz", waveform.frequency_hz, "cycles per second")?;
    if !(0.0..1.0).contains(&waveform.phase) {
        return rule(format!("phase is {}; it takes a part of a cycle, from 0 to below 1", waveform.phase));
    }
    not_negative("low", waveform.low, "a factor")?;
    not_negative("high", waveform.high, "a factor")?;
    if waveform.low > waveform.high {
        return rule(format!(
            "low is {} and high is {}; low takes at most high",
            waveform.low, waveform.high
        ));
    }
    if let WaveShape::Pwm { duty } = waveform.shape
        && !(duty > 0.0 && duty < 1.0)
    {
        return rule(format!("duty is {duty}; it takes a part of a cycle between 0 and 1, both excluded"));
    }
    Ok(())
}

pub(super) fn check_material(material: &Material, textures: usize) -> Result<(), SceneError> {
    let check = || {
        material.factors().check()?;
        within("alpha of base_color", material.base_color[3].into(), 0.0, 1.0)?;
        within("occlusion_strength", material.occlusion_strength.into(), 0.0, 1.0)?;
        finite("normal_scale", material.normal_scale.into())?;
        if let AlphaMode::Mask(cutoff) = material.alpha {
            within("alpha_cutoff", cutoff.into(), 0.0, 1.0)?;
        }
        if let Some(waveform) = &material.emission_waveform {
            check_waveform(waveform)?;
        }
        for reference in texture_references(&mut material.clone()) {
            if reference.texture >= textures {
                return rule(format!("texture {} does not exist; there are {textures}", reference.texture));
            }
            if reference.uv_set > 1 || !reference.transform.iter().all(|v| v.is_finite()) {
                return rule(format!(
                    "texture {} has a uv_set above 1 or a transform that is not finite",
                    reference.texture
                ));
            }
        }
        Ok(())
    };
    check().map_err(|error| in_object(&material.name, error))
}

pub(super) fn check_light(light: &Light) -> Result<(), SceneError> {
    let check = || {
        light_color("color", light.color)?;
        let unit = if light.kind == LightKind::Directional { "lux" } else { "candela" };
        not_negative("intensity", light.intensity.into(), unit)?;
        if let Some(range) = light.range {
            positive("range", range.into(), "metres")?;
        }
        if let LightKind::Spot { inner, outer } = light.kind {
            let [inner, outer] = [inner, outer].map(|a| f64::from(a).to_degrees());
            if !(inner >= 0.0 && inner < outer && outer <= 90.001) {
                return rule(format!(
                    "inner_degrees is {inner:.4} and outer_degrees is {outer:.4}; they take 0 <= inner < outer <= 90"
                ));
            }
        }
        if light.casts_shadow && light.kind == LightKind::Point {
            return rule(
                "casts_shadow is true on a point light; only directional and spot lights throw shadows"
                    .into(),
            );
        }
        light.waveform.as_ref().map_or(Ok(()), check_waveform)
    };
    check().map_err(|error| in_object(&light.name, error))
}

/// The body, its axis made a unit.
pub(super) fn check_body(body: &RigidBody, moves: bool) -> Result<RigidBody, SceneError> {
    let mut body = *body;
    if moves {
        return rule("it has a motion and is a rigid body; give it one of the two".into());
    }
    within("friction", body.friction, 0.0, 100.0)?;
    within("restitution", body.restitution, 0.0, 1.0)?;
    for (what, length) in body.collider.iter().flat_map(Collider::lengths) {
        within(&format!("{what} of its collider"), length, 1e-4, 1e5)?;
    }
    let BodyKind::Dynamic { mass, velocity, spin_axis, spin_rate, launch_s } = &mut body.kind else {
        return Ok(body);
    };
    if let Some(collider @ (Collider::HalfSpace | Collider::Mesh)) = body.collider {
        return rule(format!(
            "its collider is a {}, which has no mass; a body that moves takes box, sphere, cylinder, capsule or hull",
            collider.name()
        ));
    }
    match *mass {
        BodyMass::Density(density) => within("density", density, 1e-3, 1e6)?,
        BodyMass::Kilograms(mass) => within("mass", mass, 1e-6, 1e9)?,
    }
    finite_vector("velocity", *velocity)?;
    within("length of velocity", velocity.length(), 0.0, 1000.0)?;
    *spin_axis = unit_axis("spin_axis", *spin_axis)?;
    finite("spin_rate", *spin_rate)?;
    not_negative("launch_s", *launch_s, "seconds")?;
    Ok(body)
}

pub(crate) fn check_camera(camera: &EventCamera) -> Result<(), SceneError> {
    let check = || {
        camera.lens.check()?;
        if let Some(distortion) = &camera.distortion {
            distortion.check()?;
            if !matches!(camera.lens, Lens::Intrinsics { .. }) {
                return rule(
                    "distortion is given without focal lengths; it takes fx (and fy, cx, cy) in place of a field of view"
                        .into(),
                );
            }
        }
        if let Some(size) = camera.size
            && !size.iter().all(|n| (1..=8192).contains(n))
        {
            return rule(format!(
                "size is {size:?}; it takes a width and a height between 1 and 8192 pixels"
            ));
        }
        positive("near", camera.near, "metres")?;
        if let Lens::Orthographic { far, .. } = camera.lens
            && far <= camera.near
        {
            return rule(format!(
                "far is {far} and near {}; far takes metres beyond the near plane",
                camera.near
            ));
        }
        for (what, threshold) in ["threshold_on", "threshold_off"].iter().zip(camera.thresholds) {
            if let Some(threshold) = threshold {
                positive(what, threshold.into(), "a log contrast")?;
            }
        }
        Ok(())
    };
    check().map_err(|error| in_object(&camera.name, error))
}

pub(super) fn check_primitive(primitive: &Primitive) -> Result<(), SceneError> {
    let vertices = primitive.positions.len();
    if primitive.normals.len() != vertices {
        return rule(format!(
            "a primitive has {vertices} positions and {} normals; both take one per vertex",
            primitive.normals.len()
        ));
    }
    if primitive.indices.is_empty() || !primitive.indices.len().is_multiple_of(3) {
        return rule(format!(
            "a primitive has {} indices; it takes three per triangle",
            primitive.indices.len()
        ));
    }
    if let Some(index) = primitive.indices.iter().find(|i| **i as usize >= vertices) {
        return rule(format!("a primitive uses vertex {index}; it has {vertices}"));
    }
    if !primitive.positions.iter().flatten().all(|v| v.is_finite()) {
        return rule("a primitive has a position that is not finite".into());
    }
    Ok(())
}

pub(super) fn check_trs(pose: &Trs) -> Result<(), SceneError> {
    if !pose.translation.is_finite() {
        return rule(format!("position is {}; it takes three finite numbers", pose.translation));
    }
    if !pose.rotation.is_finite() || (pose.rotation.length() - 1.0).abs() > 1e-6 {
        return rule(format!("rotation is {}; it takes a unit quaternion (x, y, z, w)", pose.rotation));
    }
    if !pose.scale.is_finite() || pose.scale.min_element().abs().min(pose.scale.max_element().abs()) < 1e-9 {
        return rule(format!("scale is {}; it takes three finite numbers other than 0", pose.scale));
    }
    Ok(())
}

pub(super) fn unit_axis(what: &str, axis: DVec3) -> Result<DVec3, SceneError> {
    match axis.try_normalize() {
        Some(unit) if axis.is_finite() => Ok(unit),
        _ => rule(format!("{what} is {axis}; it takes a direction that is not zero")),
    }
}

pub(super) fn finite_vector(what: &str, vector: DVec3) -> Result<(), SceneError> {
    if vector.is_finite() {
        Ok(())
    } else {
        rule(format!("{what} is {vector}; it takes three finite numbers"))
    }
}

/// The path, its axes made units.
pub(super) fn checked_path(path: &Path) -> Result<Path, SceneError> {
    let mut path = path.clone();
    match &mut path {
        Path::ConstantVelocity { start, velocity } => {
            check_trs(start)?;
            finite_vector("velocity", *velocity)?;
        }
        Path::Spin { start, axis, rate } => {
            check_trs(start)?;
            *axis = unit_axis("axis", *axis)?;
            finite("rate", *rate)?;
        }
        Path::FigureEight { start, size, period_s, look_at } => {
            check_trs(start)?;
            finite("size", size[0])?;
            finite("size", size[1])?;
            positive("period_s", *period_s, "seconds")?;
            finite_vector("look_at", look_at.unwrap_or_default())?;
        }
        Path::Ballistic { start, velocity, gravity, spin_axis, spin_rate, launch_s } => {
            check_trs(start)?;
            finite_vector("velocity", *velocity)?;
            finite_vector("gravity", *gravity)?;
            *spin_axis = unit_axis("spin_axis", *spin_axis)?;
            finite("spin_rate", *spin_rate)?;
            finite("launch_s", *launch_s)?;
        }
        Path::Keys { times, positions, rotations, velocities, interpolation } => {
            check_keys(times, positions, rotations)?;
            let hermite = *interpolation == crate::motion::PathInterpolation::Hermite;
            let expected = if hermite { times.len() } else { 0 };
            if velocities.len() != expected {
                return rule(format!(
                    "a path of {} keys has {} velocities; this interpolation takes {expected}",
                    times.len(),
                    velocities.len()
                ));
            }
            velocities.iter().try_for_each(|v| finite_vector("velocity", *v))?;
        }
        Path::Harmonic { start, terms } => {
            check_trs(start)?;
            for term in terms {
                finite("frequency_hz", term.frequency_hz)?;
                finite("phase", term.phase)?;
                finite_vector("amplitude of translation", term.translation)?;
                finite_vector("amplitude of rotation", term.rotation)?;
            }
        }
        Path::Chain(links) => {
            if links.is_empty() {
                return rule("a chain has no motions; it takes at least one".into());
            }
            for link in links {
                *link = checked_path(link)?;
            }
        }
    }
    Ok(path)
}

pub(super) fn check_keys(times: &[f64], positions: &[DVec3], rotations: &[DQuat]) -> Result<(), SceneError> {
    if times.is_empty() || positions.len() != times.len() || rotations.len() != times.len() {
        return rule(format!(
            "a path has {} times, {} positions and {} rotations; it takes as many of each, at least 1",
            times.len(),
            positions.len(),
            rotations.len()
        ));
    }
    if let Some(pair) =
        times.array_windows().find(|[a, b]| a.partial_cmp(b) != Some(std::cmp::Ordering::Less))
    {
        return rule(format!(
            "time {} s of a path comes after {} s; times must increase strictly",
            pair[1], pair[0]
        ));
    }
    for time in times {
        finite("time", *time)?;
    }
    for (position, rotation) in positions.iter().zip(rotations) {
        check_trs(&Trs { translation: *position, rotation: *rotation, scale: DVec3::ONE })?;
    }
    Ok(())
}

pub(super) fn texture_references(material: &mut Material) -> impl Iterator<Item = &mut TextureRef> {
    [
        &mut material.base_color_texture,
        &mut material.metallic_roughness_texture,
        &mut material.normal_texture,
        &mut material.occlusion_texture,
        &mut material.emissive_texture,
    ]
    .into_iter()
    .flatten()
}
