//! What a host says while the scene runs: a physics engine, an agent, a recording that is still being made.

use std::collections::HashSet;
use std::f64::consts::TAU;
use std::hash::Hash;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use glam::DVec3;

use crate::error::SceneError;
use crate::factors::{LightChange, LightFactors, MaterialChange, MaterialFactors, ShadingModel};
use crate::intrinsics::Lens;
use crate::steps::Steps;
use crate::track::{HostPose, Track};

/// How far a quaternion's length may be from 1.
const UNIT_TOLERANCE: f64 = 1e-3;

/// How far a node may turn between two poses with angular velocities, in radians.
const MOST_TURN: f64 = TAU;

/// Environment, node, and whether it is seen up to each time in microseconds.
pub type VisibleSteps = (usize, usize, Vec<(i64, bool)>);

/// What a host says of a step. Nodes are indices into [`HostPoses::names`], materials into [`HostPoses::materials`], lights into
/// [`HostPoses::lights`].
#[derive(Clone, Copy, Debug, Default)]
pub struct HostStep<'a> {
    /// Environment, node, its poses; the last one is at the step's end.
    pub poses: &'a [(usize, usize, Vec<HostPose>)],
    /// Environment, node, and whether it is seen: up to each time in microseconds, from just after the one before; the first
    /// one from just after what is known, and in the very first step from ever. The last time is the step's end.
    pub visible: &'a [VisibleSteps],
    /// Environment, material, and what changes of it, just after what is known; in the very first step it was never otherwise.
    pub materials: &'a [(usize, usize, MaterialChange)],
    /// Environment, light, and what changes of it, when materials do.
    pub lights: &'a [(usize, usize, LightChange)],
}

impl HostStep<'_> {
    /// Whether nothing is said.
    pub const fn is_empty(&self) -> bool {
        self.poses.is_empty()
            && self.visible.is_empty()
            && self.materials.is_empty()
            && self.lights.is_empty()
    }
}

/// What a host lets be otherwise from now on, and from ever. Indices are those of [`HostStep`].
#[derive(Clone, Copy, Debug, Default)]
pub struct HostJump<'a> {
    /// Environment, node, its pose.
    pub poses: &'a [(usize, usize, HostPose)],
    /// Environment, node, whether it is seen.
    pub visible: &'a [(usize, usize, bool)],
    /// Environment, material, and what changes of it.
    pub materials: &'a [(usize, usize, MaterialChange)],
    /// Environment, light, and what changes of it.
    pub lights: &'a [(usize, usize, LightChange)],
}

impl HostJump<'_> {
    /// Environments that it concerns.
    pub fn environments(&self) -> impl Iterator<Item = usize> {
        let poses = self.poses.iter().map(|(environment, ..)| *environment);
        let visible = self.visible.iter().map(|(environment, ..)| *environment);
        let materials = self.materials.iter().map(|(environment, ..)| *environment);
        let lights = self.lights.iter().map(|(environment, ..)| *environment);
        poses.chain(visible).chain(materials).chain(lights)
    }
}

/// A node that a host moves.
#[derive(Debug)]
pub(crate) struct DrivenNode {
    /// As it was asked for.
    pub name: String,
    /// Why it cannot be hidden, where it cannot.
    pub always_seen: Option<String>,
    /// By environment.
    pub tracks: Vec<Arc<Track>>,
}

/// A material that a host changes, or what is drawn of a node.
#[derive(Debug)]
pub(crate) struct DrivenMaterial {
    /// As it was asked for.
    pub name: String,
    /// Its materials.
    pub parts: Vec<DrivenPart>,
}

/// A material of a [`DrivenMaterial`].
#[derive(Debug)]
pub(crate) struct DrivenPart {
    /// As the scene calls it.
    pub name: String,
    /// What it is.
    pub model: ShadingModel,
    /// By environment.
    pub factors: Vec<Arc<Steps<MaterialFactors>>>,
}

/// A light that a host changes.
#[derive(Debug)]
pub(crate) struct DrivenLight {
    /// As it was asked for.
    pub name: String,
    /// By environment.
    pub factors: Vec<Arc<Steps<LightFactors>>>,
}

/// What a host moves and changes.
#[derive(Debug)]
pub(crate) struct Driven {
    pub nodes: Vec<DrivenNode>,
    pub materials: Vec<DrivenMaterial>,
    pub lights: Vec<DrivenLight>,
    /// By camera of the scene, then by environment.
    pub lenses: Vec<Vec<Arc<Steps<Lens>>>>,
}

/// What a host moves and changes in a scene, in each environment, and until when that is known.
#[derive(Debug)]
pub struct HostPoses {
    names: Vec<String>,
    materials: Vec<String>,
    light_names: Vec<String>,
    environments: usize,
    nodes: Vec<DrivenNode>,
    driven: Vec<DrivenMaterial>,
    lights: Vec<DrivenLight>,
    lenses: Vec<Vec<Arc<Steps<Lens>>>>,
    start_us: i64,
    known_until_us: AtomicI64,
    known_from_us: AtomicI64,
}

impl HostPoses {
    /// Everything is known until `known_until_us`, where tracks begin.
    pub(crate) fn new(environments: usize, driven: Driven, known_until_us: i64) -> Self {
        let Driven { nodes, materials, lights, lenses } = driven;
        Self {
            names: nodes.iter().map(|node| node.name.clone()).collect(),
            light_names: lights.iter().map(|light| light.name.clone()).collect(),
            materials: materials.iter().map(|material| material.name.clone()).collect(),
            environments,
            nodes,
            driven: materials,
            lights,
            lenses,
            start_us: known_until_us,
            known_until_us: AtomicI64::new(known_until_us),
            known_from_us: AtomicI64::new(i64::MIN),
        }
    }

    /// Names of the nodes, as they were asked for.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Names of the materials, or of nodes that have theirs, as they were asked for.
    pub fn materials(&self) -> &[String] {
        &self.materials
    }

    /// Names of the lights, or of nodes that carry theirs, as they were asked for.
    pub fn lights(&self) -> &[String] {
        &self.light_names
    }

    /// Number of environments.
    pub const fn environments(&self) -> usize {
        self.environments
    }

    /// Scene time in microseconds until which the poses of all nodes are known. Nothing is sampled after it.
    pub fn known_until_us(&self) -> i64 {
        self.known_until_us.load(Ordering::Acquire)
    }

    /// Scene time in microseconds from which poses are still known: what is before it was forgotten.
    pub fn known_from_us(&self) -> i64 {
        self.known_from_us.load(Ordering::Acquire)
    }

    /// Whether no step was made: then nothing was seen of the scene.
    fn is_new(&self) -> bool {
        self.known_until_us() == self.start_us
    }

    /// `what` of `name`, with its environment where there are several.
    fn place(&self, what: &str, name: &str, environment: usize) -> String {
        if self.environments > 1 {
            format!("{what} of '{name}' of environment {environment}")
        } else {
            format!("{what} of '{name}'")
        }
    }

    /// The node `node`, and its track in `environment`.
    fn node(&self, what: &str, environment: usize, node: usize) -> Result<(&DrivenNode, &Track), SceneError> {
        let found = self.nodes.get(node).and_then(|node| Some((node, &**node.tracks.get(environment)?)));
        found.ok_or_else(|| {
            SceneError::Rule(format!(
                "{what} of node {node} in environment {environment}: a host moves {} node(s) in {} environment(s)",
                self.nodes.len(),
                self.environments
            ))
        })
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
        let (node, track) = self.node("pose", environment, node)?;
        let rule = |text: String| {
            Err(SceneError::Rule(format!("{}: {text}", self.place("pose", &node.name, environment))))
        };
        let known = track.last_us();
        let mut last = if track.is_new() { known - 1 } else { known };
        for pose in poses {
            if pose.t_us <= last {
                return rule(format!(
                    "its time is {} us; poses are known until {known} us, and must go on from there in order",
                    pose.t_us
                ));
            }
            let apart_s = (pose.t_us - last).max(0) as f64 * 1e-6;
            last = pose.t_us;
            let velocity = pose.velocity.unwrap_or(DVec3::ZERO);
            let angular = pose.angular_velocity.unwrap_or(DVec3::ZERO);
            if !(pose.position.is_finite()
                && pose.rotation.is_finite()
                && velocity.is_finite()
                && angular.is_finite())
            {
                return rule(format!("it holds a value that is not finite, at {} us", pose.t_us));
            }
            let turned = angular.length() * apart_s;
            if pose.angular_velocity.is_some() && turned > MOST_TURN {
                return rule(format!(
                    "it turns by {:.2} turns since the pose before, at {} us; give poses more often, at least once a turn",
                    turned / TAU,
                    pose.t_us
                ));
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

    fn check_visible(
        &self,
        environment: usize,
        node: usize,
        visible: &[(i64, bool)],
        until_us: i64,
    ) -> Result<(), SceneError> {
        let (node, _) = self.node("visible", environment, node)?;
        let rule = |text: String| {
            Err(SceneError::Rule(format!("{}: {text}", self.place("visible", &node.name, environment))))
        };
        if let Some(reason) = &node.always_seen {
            return rule(format!(
                "{reason}, so it cannot be hidden; name the nodes that draw what is to vanish"
            ));
        }
        let known = self.known_until_us();
        let mut last = if self.is_new() { known - 1 } else { known };
        for (t_us, _) in visible {
            if *t_us <= last {
                return rule(format!(
                    "a time is {t_us} us; everything is known until {known} us, and must go on from there in order"
                ));
            }
            last = *t_us;
        }
        match visible.last() {
            Some((t_us, _)) if *t_us != until_us => {
                rule(format!("the last time is {t_us} us; the step ends at {until_us} us"))
            }
            _ => Ok(()),
        }
    }

    fn check_material(
        &self,
        environment: usize,
        material: usize,
        change: &MaterialChange,
    ) -> Result<(), SceneError> {
        let Some(driven) = self.driven.get(material).filter(|_| environment < self.environments) else {
            return Err(SceneError::Rule(format!(
                "material {material} in environment {environment}: a host changes {} material(s) in {} environment(s)",
                self.driven.len(),
                self.environments
            )));
        };
        let rule = |text: String| {
            Err(SceneError::Rule(format!("{}: {text}", self.place("material", &driven.name, environment))))
        };
        for part in &driven.parts {
            if let Some((factor, seen)) = change.unseen(part.model) {
                return rule(format!(
                    "{factor} is not seen of the {} material '{}'; change {seen}",
                    part.model.name(),
                    part.name
                ));
            }
            let last = part.factors[environment].at(f64::INFINITY).unwrap_or_default();
            if let Err(error) = last.with(change).check() {
                return rule(reason(error));
            }
        }
        Ok(())
    }

    fn check_light(&self, environment: usize, light: usize, change: &LightChange) -> Result<(), SceneError> {
        let driven = self.lights.get(light).and_then(|light| Some((light, light.factors.get(environment)?)));
        let Some((light, factors)) = driven else {
            return Err(SceneError::Rule(format!(
                "light {light} in environment {environment}: a host changes {} light(s) in {} environment(s)",
                self.lights.len(),
                self.environments
            )));
        };
        let last = factors.at(f64::INFINITY).unwrap_or_default();
        let place = || self.place("light", &light.name, environment);
        last.with(change).check().map_err(|error| SceneError::Rule(format!("{}: {}", place(), reason(error))))
    }

    /// Gives camera `camera` of the scene (an index) in `environment` another lens, as if it had never had the old one.
    ///
    /// # Errors
    /// Cameras and environments that do not exist, lenses that cannot be. Then nothing has changed.
    pub fn set_lens(&self, environment: usize, camera: usize, lens: Lens) -> Result<(), SceneError> {
        let Some(steps) = self.lenses.get(camera).and_then(|each| each.get(environment)) else {
            return Err(SceneError::Rule(format!(
                "lens of camera {camera} in environment {environment}: there are {} camera(s) in {} environment(s)",
                self.lenses.len(),
                self.environments
            )));
        };
        lens.check()?;
        steps.replace(lens);
        Ok(())
    }

    /// Makes everything known until `until_us`, as `step` says. A node that has no pose in it stays where it is; what is not
    /// named in it stays as it is.
    ///
    /// # Errors
    /// As [`HostPoses::check`], of nodes and materials; nodes that cannot be hidden, factors that a material does not have or
    /// that are out of range. Then nothing has changed.
    pub fn advance(&self, step: &HostStep<'_>, until_us: i64) -> Result<(), SceneError> {
        for (environment, node, poses) in step.poses {
            self.check(*environment, *node, poses, until_us)?;
        }
        for (environment, node, visible) in step.visible {
            self.check_visible(*environment, *node, visible, until_us)?;
        }
        for (environment, material, change) in step.materials {
            self.check_material(*environment, *material, change)?;
        }
        for (environment, light, change) in step.lights {
            self.check_light(*environment, *light, change)?;
        }
        let twice = |what: &str, name: &str| {
            Err(SceneError::Rule(format!("{what} of '{name}' are given twice for one environment")))
        };
        if let Some(node) = repeated(step.poses.iter().map(|(e, n, _)| (*e, *n))) {
            return twice("poses", &self.names[node]);
        }
        if let Some(node) = repeated(step.visible.iter().map(|(e, n, _)| (*e, *n))) {
            return twice("values of visible", &self.names[node]);
        }
        if let Some(material) = repeated(step.materials.iter().map(|(e, m, _)| (*e, *m))) {
            return twice("changes of the material", &self.materials[material]);
        }
        if let Some(light) = repeated(step.lights.iter().map(|(e, l, _)| (*e, *l))) {
            return twice("changes of the light", &self.light_names[light]);
        }
        let (new, known_us) = (self.is_new(), self.known_until_us());
        for (environment, node, poses) in step.poses {
            let unit: Vec<HostPose> =
                poses.iter().map(|p| HostPose { rotation: p.rotation.normalize(), ..*p }).collect();
            self.nodes[*node].tracks[*environment].append(&unit);
        }
        for (environment, node, visible) in step.visible {
            let steps = &self.nodes[*node].tracks[*environment].visible;
            let mut from_us = known_us;
            for (number, (t_us, seen)) in visible.iter().enumerate() {
                if new && number == 0 {
                    steps.replace(*seen);
                } else {
                    steps.set(from_us, *seen);
                }
                from_us = *t_us;
            }
        }
        for (environment, material, change) in step.materials {
            for steps in self.factors(*environment, *material) {
                let changed = steps.at(f64::INFINITY).unwrap_or_default().with(change);
                if new {
                    steps.replace(changed);
                } else {
                    steps.set(known_us, changed);
                }
            }
        }
        for (environment, light, change) in step.lights {
            let steps = &self.lights[*light].factors[*environment];
            let changed = steps.at(f64::INFINITY).unwrap_or_default().with(change);
            if new {
                steps.replace(changed);
            } else {
                steps.set(known_us, changed);
            }
        }
        for track in self.tracks() {
            let last_us = track.last_us();
            if last_us < until_us {
                // It rests: without a pose here, the next one would move it from the last one on.
                let rest = track.last().map(|pose| HostPose {
                    t_us: until_us,
                    velocity: None,
                    angular_velocity: None,
                    ..pose
                });
                track.append(rest.as_slice());
            }
        }
        self.known_until_us.store(until_us, Ordering::Release);
        Ok(())
    }

    /// Lets things be otherwise, now: as `jump` says, and as if they had never been as they were. Poses are at
    /// [`HostPoses::known_until_us`], whatever their times.
    ///
    /// # Errors
    /// As [`HostPoses::advance`]; then nothing has changed.
    pub fn jump(&self, jump: &HostJump<'_>) -> Result<(), SceneError> {
        let now_us = self.known_until_us();
        // Any time that follows will do for the rules of the rest.
        let later_us = now_us + 1;
        for (environment, node, pose) in jump.poses {
            self.check(*environment, *node, &[HostPose { t_us: later_us, ..*pose }], later_us)?;
        }
        for (environment, node, seen) in jump.visible {
            self.check_visible(*environment, *node, &[(later_us, *seen)], later_us)?;
        }
        for (environment, material, change) in jump.materials {
            self.check_material(*environment, *material, change)?;
        }
        for (environment, light, change) in jump.lights {
            self.check_light(*environment, *light, change)?;
        }
        if jump.environments().next().is_some() {
            // What was before is no longer told.
            self.known_from_us.fetch_max(now_us, Ordering::AcqRel);
        }
        for (environment, node, pose) in jump.poses {
            let rotation = pose.rotation.normalize();
            let unit = HostPose { t_us: now_us, rotation, velocity: None, angular_velocity: None, ..*pose };
            self.nodes[*node].tracks[*environment].replace(&[HostPose { t_us: now_us - 1, ..unit }, unit]);
        }
        for (environment, node, seen) in jump.visible {
            self.nodes[*node].tracks[*environment].visible.replace(*seen);
        }
        for (environment, material, change) in jump.materials {
            for steps in self.factors(*environment, *material) {
                steps.replace(steps.at(f64::INFINITY).unwrap_or_default().with(change));
            }
        }
        for (environment, light, change) in jump.lights {
            let steps = &self.lights[*light].factors[*environment];
            steps.replace(steps.at(f64::INFINITY).unwrap_or_default().with(change));
        }
        Ok(())
    }

    /// The last pose of every node that is known: environment, node, pose.
    pub fn last_poses(&self) -> Vec<(usize, usize, HostPose)> {
        let of = |(index, node): (usize, &DrivenNode)| {
            let last = node.tracks.iter().enumerate();
            last.filter_map(|(environment, track)| Some((environment, index, track.last()?)))
                .collect::<Vec<_>>()
        };
        self.nodes.iter().enumerate().flat_map(of).collect()
    }

    /// Lets nodes be at these poses (environment, node, pose), and never anywhere else before, so that steps may follow from there.
    /// Those that do not exist are left out.
    pub fn restart(&self, poses: &[(usize, usize, HostPose)]) {
        for (environment, node, pose) in poses {
            let track = self.nodes.get(*node).and_then(|node| node.tracks.get(*environment));
            if let Some(track) = track {
                track.replace(&[*pose]);
            }
        }
    }

    /// Forgets what no time from `t_us` on needs.
    pub fn forget_before(&self, t_us: i64) {
        self.known_from_us.fetch_max(t_us, Ordering::AcqRel);
        self.tracks().for_each(|track| track.forget_before(t_us));
        let factors = self.driven.iter().flat_map(|driven| &driven.parts).flat_map(|part| &part.factors);
        factors.for_each(|steps| steps.forget_before(t_us));
        let lights = self.lights.iter().flat_map(|light| &light.factors);
        lights.for_each(|steps| steps.forget_before(t_us));
    }

    fn tracks(&self) -> impl Iterator<Item = &Arc<Track>> {
        self.nodes.iter().flat_map(|node| &node.tracks)
    }

    fn factors(&self, environment: usize, material: usize) -> impl Iterator<Item = &Steps<MaterialFactors>> {
        let parts = self.driven[material].parts.iter();
        parts.map(move |part| &*part.factors[environment])
    }
}

/// What is wrong, without what errors of scenes begin with.
fn reason(error: SceneError) -> String {
    if let SceneError::Rule(text) = error { text } else { error.to_string() }
}

/// The second one of a pair that comes twice.
fn repeated<T: Eq + Hash + Copy>(pairs: impl Iterator<Item = (usize, T)>) -> Option<T> {
    let mut seen = HashSet::new();
    pairs.into_iter().find(|pair| !seen.insert(*pair)).map(|(_, second)| second)
}
