//! Leaving nodes, materials and lights to a host.

use std::sync::Arc;

use crate::builder::both_sides;
use crate::error::SceneError;
use crate::host_poses::{Driven, DrivenLight, DrivenMaterial, DrivenNode, DrivenPart, HostPoses};
use crate::model::{Scene, Variant};
use crate::motion::Motion;
use crate::pose::SceneState;
use crate::steps::Steps;
use crate::track::Track;

/// What a host moves and changes, by name.
#[derive(Clone, Copy, Debug, Default)]
pub struct HostNames<'a> {
    /// Nodes or cameras, whose poses come through [`HostPoses::advance`].
    pub nodes: &'a [String],
    /// Materials; or nodes where no material has the name: what these draw gets materials of its own, which other nodes do not
    /// share.
    pub materials: &'a [String],
    /// Lights; or nodes where no light has the name, which get a light of their own.
    pub lights: &'a [String],
}

/// The value of item `index` in a list of an environment; `None` where the scene's own holds.
fn own_value<T: Copy + PartialEq>(list: &[(usize, Arc<Steps<T>>)], index: usize) -> Option<T> {
    list.iter().find(|(own, _)| *own == index)?.1.at(f64::NEG_INFINITY)
}

/// A list of an environment, shared with no other scene.
fn apart<T: Copy + PartialEq>(list: &mut [(usize, Arc<Steps<T>>)]) {
    for (_, steps) in list {
        if let Some(value) = steps.at(f64::NEG_INFINITY) {
            *steps = Arc::new(Steps::new(value));
        }
    }
}

/// Lets `steps` be what item `index` follows.
fn follow<T>(list: &mut Vec<(usize, Arc<Steps<T>>)>, index: usize, steps: &Arc<Steps<T>>) {
    list.retain(|(own, _)| *own != index);
    list.push((index, Arc::clone(steps)));
}

/// Where an environment has item `from` otherwise, item `to`, which was made from it, is so, too.
fn inherit<T>(list: &mut Vec<(usize, Arc<Steps<T>>)>, from: usize, to: usize) {
    let steps = list.iter().find(|(own, _)| *own == from).map(|(_, steps)| Arc::clone(steps));
    list.extend(steps.map(|steps| (to, steps)));
}

impl Scene {
    /// As [`Scene::drive_with`], with no material.
    ///
    /// # Errors
    /// As [`Scene::drive_with`].
    pub fn drive(&mut self, names: &[String], start_us: i64) -> Result<Arc<HostPoses>, SceneError> {
        self.drive_with(names, &[], start_us)
    }

    /// As [`Scene::leave_to_host`], with no light.
    ///
    /// # Errors
    /// As [`Scene::leave_to_host`].
    pub fn drive_with(
        &mut self,
        nodes: &[String],
        materials: &[String],
        start_us: i64,
    ) -> Result<Arc<HostPoses>, SceneError> {
        self.leave_to_host(&HostNames { nodes, materials, lights: &[] }, start_us)
    }

    /// Leaves nodes, materials and lights to a host from scene time `start_us` on; until it says anything they are as the scene
    /// has them at `start_us`.
    ///
    /// # Errors
    /// Names that do not exist, that several have, or that are given twice; nodes that draw nothing, as materials, and nodes that
    /// carry no light, as lights.
    pub fn leave_to_host(
        &mut self,
        names: &HostNames<'_>,
        start_us: i64,
    ) -> Result<Arc<HostPoses>, SceneError> {
        let HostNames { nodes, materials, lights } = *names;
        let mut driven = Vec::with_capacity(nodes.len());
        for name in nodes {
            let node = self.driven_node(name)?;
            if driven.contains(&node) {
                return Err(SceneError::Rule(format!(
                    "'{name}' is named twice among the nodes that a host moves"
                )));
            }
            driven.push(node);
        }
        let parts = self.driven_materials(materials)?;
        let lamps = self.driven_lights(lights)?;
        if self.variants.is_empty() {
            self.variants.push(Variant::default());
        }
        let states: Vec<SceneState> = self
            .variants
            .iter()
            .map(|variant| {
                let mut state = SceneState::default();
                self.evaluate_variant(Some(variant), start_us as f64 * 1e-6, &mut state);
                state
            })
            .collect();
        for variant in &mut self.variants {
            variant.poses.clear();
            apart(&mut variant.factors);
            apart(&mut variant.lights);
        }
        let mut host_nodes = Vec::with_capacity(nodes.len());
        for (name, &node) in nodes.iter().zip(&driven) {
            let tracks: Vec<_> = states
                .iter()
                .map(|state| Arc::new(Track::new(start_us, &state.world_from_node[node])))
                .collect();
            for (variant, track) in self.variants.iter_mut().zip(&tracks) {
                variant.poses.push((node, Arc::clone(track)));
            }
            self.nodes[node].motion = Motion::Driven(Arc::clone(&tracks[0]));
            host_nodes.push(DrivenNode { name: name.clone(), always_seen: None, tracks });
        }
        for (host_node, &node) in host_nodes.iter_mut().zip(&driven) {
            host_node.always_seen = self.always_seen(node);
        }
        let mut host_materials = Vec::with_capacity(materials.len());
        for (name, parts) in materials.iter().zip(parts) {
            let parts = parts.into_iter().map(|index| {
                let material = &mut self.materials[index];
                material.driven = true;
                let own = |v: &Variant| own_value(&v.factors, index).unwrap_or_else(|| material.factors());
                let each: Vec<_> = self.variants.iter().map(|v| Arc::new(Steps::new(own(v)))).collect();
                for (variant, steps) in self.variants.iter_mut().zip(&each) {
                    follow(&mut variant.factors, index, steps);
                }
                DrivenPart { name: material.name.clone(), model: material.model, factors: each }
            });
            host_materials.push(DrivenMaterial { name: name.clone(), parts: parts.collect() });
        }
        let host_lights = lights.iter().zip(lamps).map(|(name, index)| {
            let light = &self.lights[index];
            let own = |v: &Variant| own_value(&v.lights, index).unwrap_or_else(|| light.factors());
            let each: Vec<_> = self.variants.iter().map(|v| Arc::new(Steps::new(own(v)))).collect();
            for (variant, steps) in self.variants.iter_mut().zip(&each) {
                follow(&mut variant.lights, index, steps);
            }
            DrivenLight { name: name.clone(), factors: each }
        });
        let host_lights: Vec<DrivenLight> = host_lights.collect();
        // A reset may give any camera another lens.
        let lenses = self.cameras.iter().enumerate().map(|(index, camera)| {
            let own = |v: &Variant| own_value(&v.lenses, index).unwrap_or(camera.lens);
            let each: Vec<_> = self.variants.iter().map(|v| Arc::new(Steps::new(own(v)))).collect();
            for (variant, steps) in self.variants.iter_mut().zip(&each) {
                follow(&mut variant.lenses, index, steps);
            }
            each
        });
        let driven = Driven {
            lenses: lenses.collect(),
            nodes: host_nodes,
            materials: host_materials,
            lights: host_lights,
        };
        let host = Arc::new(HostPoses::new(self.variants.len(), driven, start_us));
        self.host_poses = Some(Arc::clone(&host));
        Ok(host)
    }

    /// Indices of the materials that each of `names` stands for; those of nodes are made.
    fn driven_materials(&mut self, names: &[String]) -> Result<Vec<Vec<usize>>, SceneError> {
        let mut found: Vec<Vec<usize>> = Vec::with_capacity(names.len());
        // Nodes add theirs behind them.
        let own = self.materials.len();
        for (number, name) in names.iter().enumerate() {
            if names[..number].contains(name) {
                return Err(SceneError::Rule(format!(
                    "'{name}' is named twice among the materials that a host changes"
                )));
            }
            let materials: Vec<usize> = (0..own).filter(|&i| self.materials[i].name == *name).collect();
            let nodes: Vec<usize> = (0..self.nodes.len()).filter(|&i| self.nodes[i].name == *name).collect();
            found.push(match (&materials[..], &nodes[..]) {
                // What the builder made of it for flat shapes is it, too.
                (&[material], _) => {
                    let both = both_sides(name);
                    let others = (0..own).filter(|&i| self.materials[i].name == both);
                    std::iter::once(material).chain(others).collect()
                }
                (&[], &[node]) => self.own_materials(node, name)?,
                (&[], &[]) => {
                    let all = self.materials.iter().map(|m| &m.name).chain(self.nodes.iter().map(|n| &n.name));
                    return Err(SceneError::Unknown {
                        what: "material or node",
                        name: name.clone(),
                        known: all.filter(|n| !n.is_empty()).cloned().collect(),
                    });
                }
                _ => {
                    return Err(SceneError::Rule(format!(
                        "{} material(s) and {} node(s) are named '{name}'; give what a host changes a name of its own",
                        materials.len(),
                        nodes.len()
                    )));
                }
            });
        }
        Ok(found)
    }

    /// Indices of the lights that each of `names` stands for; those of nodes that share theirs are made.
    fn driven_lights(&mut self, names: &[String]) -> Result<Vec<usize>, SceneError> {
        let mut found: Vec<usize> = Vec::with_capacity(names.len());
        let own = self.lights.len();
        for (number, name) in names.iter().enumerate() {
            if names[..number].contains(name) {
                return Err(SceneError::Rule(format!(
                    "'{name}' is named twice among the lights that a host changes"
                )));
            }
            let lights: Vec<usize> = (0..own).filter(|&i| self.lights[i].name == *name).collect();
            let nodes: Vec<usize> = (0..self.nodes.len()).filter(|&i| self.nodes[i].name == *name).collect();
            found.push(match (&lights[..], &nodes[..]) {
                (&[light], _) => light,
                (&[], &[node]) => self.own_light(node, name)?,
                (&[], &[]) => {
                    let lights = self.lights.iter().map(|light| &light.name);
                    let lit = self.nodes.iter().filter(|node| node.light.is_some()).map(|node| &node.name);
                    let mut known: Vec<String> = lights.chain(lit).filter(|n| !n.is_empty()).cloned().collect();
                    known.dedup();
                    return Err(SceneError::Unknown { what: "light", name: name.clone(), known });
                }
                _ => {
                    return Err(SceneError::Rule(format!(
                        "{} lights and {} node(s) are named '{name}'; give what a host changes a name of its own",
                        lights.len(),
                        nodes.len()
                    )));
                }
            });
        }
        Ok(found)
    }

    /// Gives `node` a light that no other node has, and returns its index.
    fn own_light(&mut self, node: usize, name: &str) -> Result<usize, SceneError> {
        let Some((index, light)) = self.nodes[node].light.and_then(|l| Some((l, self.lights.get(l)?))) else {
            return Err(SceneError::Rule(format!(
                "the node '{name}' carries no light that a host could change; name a light, or a node that carries one"
            )));
        };
        let own = self.lights.len();
        let light = light.clone();
        self.lights.push(light);
        self.nodes[node].light = Some(own);
        self.variants.iter_mut().for_each(|variant| inherit(&mut variant.lights, index, own));
        Ok(own)
    }

    /// Gives what `node` draws materials that no other node has, and returns their indices.
    fn own_materials(&mut self, node: usize, name: &str) -> Result<Vec<usize>, SceneError> {
        let Some(mut mesh) = self.nodes[node].mesh.and_then(|mesh| self.meshes.get(mesh)).cloned() else {
            return Err(SceneError::Rule(format!(
                "the node '{name}' draws nothing, so it has no material that a host could change; name a node with \
                 a mesh, or a material"
            )));
        };
        // (theirs, own)
        let mut pairs: Vec<(usize, usize)> = Vec::new();
        for primitive in &mut mesh.primitives {
            let theirs = primitive.material;
            let known = pairs.iter().find(|(material, _)| *material == theirs);
            primitive.material = match known {
                Some((_, own)) => *own,
                None => {
                    self.materials.push(self.materials[theirs].clone());
                    let own = self.materials.len() - 1;
                    self.variants.iter_mut().for_each(|variant| inherit(&mut variant.factors, theirs, own));
                    pairs.push((theirs, own));
                    self.materials.len() - 1
                }
            };
        }
        self.meshes.push(mesh);
        self.nodes[node].mesh = Some(self.meshes.len() - 1);
        Ok(pairs.into_iter().map(|(_, own)| own).collect())
    }

    /// Why node `node`, which a host moves, cannot be hidden, with what hangs on it; `None` where it can.
    fn always_seen(&self, node: usize) -> Option<String> {
        let mut within = vec![false; self.nodes.len()];
        for (index, other) in self.nodes.iter().enumerate() {
            let moves = matches!(other.motion, Motion::Driven(_));
            within[index] = index == node || !moves && other.parent.is_some_and(|parent| within[parent]);
        }
        let camera = self.cameras.iter().find(|camera| within[camera.node]);
        let light = || self.nodes.iter().zip(&within).find_map(|(n, within)| n.light.filter(|_| *within));
        // What a skin deforms is where its joints are.
        let skinned = || {
            let outside = |skin: usize| self.skins[skin].joints.iter().any(|joint| !within[*joint]);
            self.nodes.iter().zip(&within).find(|(n, within)| **within && n.skin.is_some_and(outside))
        };
        if let Some(camera) = camera {
            return Some(format!("it carries the camera '{}'", camera.name));
        }
        if let Some(light) = light() {
            return Some(format!("it carries the light '{}'", self.lights[light].name));
        }
        skinned().map(|(node, _)| format!("joints that deform '{}' do not hang on it", node.name))
    }

    fn driven_node(&self, name: &str) -> Result<usize, SceneError> {
        let mut found = (0..self.nodes.len()).filter(|&i| self.nodes[i].name == name);
        match (found.next(), found.next()) {
            (Some(node), None) => Ok(node),
            (Some(_), Some(_)) => Err(SceneError::Rule(format!(
                "several nodes are named '{name}'; give each that a host moves a name of its own"
            ))),
            _ => match self.cameras.iter().find(|camera| camera.name == name) {
                Some(camera) => Ok(camera.node),
                None => Err(SceneError::Unknown {
                    what: "node or camera",
                    name: name.into(),
                    known: self.nodes.iter().map(|n| n.name.clone()).filter(|n| !n.is_empty()).collect(),
                }),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::builtin;
    use crate::factors::{LightChange, LightFactors, MaterialChange};
    use crate::host_poses::{HostJump, HostStep};
    use crate::model::{Lens, Material, Node, ShadingModel};
    use crate::track::HostPose;

    fn poses(poses: &[(usize, usize, Vec<HostPose>)]) -> HostStep<'_> {
        HostStep { poses, ..HostStep::default() }
    }

    fn at(t_us: i64, x: f64) -> HostPose {
        HostPose::new(t_us, [x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None)
    }

    #[test]
    fn a_driven_node_is_where_the_host_says_and_others_are_not() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.mesh.is_some() && n.parent.is_none()).unwrap();
        let (name, other) = (scene.nodes[node].name.clone(), scene.clone());
        let host = scene.drive(std::slice::from_ref(&name), 0).unwrap();
        let state = |scene: &Scene, t_s| {
            let mut state = SceneState::default();
            scene.evaluate_variant(scene.variants.first(), t_s, &mut state);
            state.world_from_node
        };
        assert_eq!(host.known_until_us(), 0);
        let rest = state(&scene, 0.0)[node];
        assert!((rest.w_axis - state(&other, 0.0)[node].w_axis).length() < 1e-12, "it begins where it was");
        host.advance(&poses(&[(0, 0, vec![at(10_000, 7.0)])]), 10_000).unwrap();
        assert_eq!(host.known_until_us(), 10_000);
        assert_eq!(state(&scene, 0.01)[node].w_axis.x, 7.0);
        // A step without a pose: it rests where it is, and leaves from there.
        host.advance(&HostStep::default(), 20_000).unwrap();
        host.advance(&poses(&[(0, 0, vec![at(30_000, 9.0)])]), 30_000).unwrap();
        assert_eq!(state(&scene, 0.02)[node].w_axis.x, 7.0);
        assert!((state(&scene, 0.025)[node].w_axis.x - 8.0).abs() < 1e-12);
        host.forget_before(25_000);
        assert!((state(&scene, 0.025)[node].w_axis.x - 8.0).abs() < 1e-12);
        for (i, (a, b)) in state(&scene, 0.02).iter().zip(&state(&other, 0.02)).enumerate() {
            assert!(i == node || scene.nodes[i].parent == Some(node) || a == b, "node {i}");
        }
    }

    #[test]
    fn a_node_that_jumps_was_never_elsewhere() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.mesh.is_some() && n.parent.is_none()).unwrap();
        let host = scene.drive(&[scene.nodes[node].name.clone()], 0).unwrap();
        let x = |t_s| {
            let mut state = SceneState::default();
            scene.evaluate_variant(scene.variants.first(), t_s, &mut state);
            state.world_from_node[node].w_axis.x
        };
        host.advance(&poses(&[(0, 0, vec![at(10_000, 1.0)])]), 10_000).unwrap();
        assert!(
            host.jump(&HostJump { poses: &[(0, 0, at(0, f64::NAN))], ..Default::default() })
                .unwrap_err()
                .to_string()
                .contains("not finite")
        );
        assert!(host.jump(&HostJump { poses: &[(1, 0, at(0, 0.0))], ..Default::default() }).is_err());
        assert_eq!(x(0.01), 1.0);
        host.jump(&HostJump { poses: &[(0, 0, at(0, 5.0))], ..Default::default() }).unwrap();
        assert_eq!((x(0.005), x(0.01)), (5.0, 5.0));
        // It goes on from there.
        host.advance(&poses(&[(0, 0, vec![at(20_000, 6.0)])]), 20_000).unwrap();
        assert!((x(0.015) - 5.5).abs() < 1e-12);
    }

    #[test]
    fn poses_that_cannot_be_are_refused_and_change_nothing() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let name = scene.nodes.iter().find(|n| n.mesh.is_some()).unwrap().name.clone();
        let host = scene.drive(std::slice::from_ref(&name), 0).unwrap();
        host.advance(&poses(&[(0, 0, vec![at(10_000, 1.0)])]), 10_000).unwrap();
        let bad = [
            (vec![at(10_000, 1.0)], "known until 10000 us"),
            (vec![at(15_000, 1.0)], "the step ends at 20000 us"),
            (vec![at(18_000, 1.0), at(17_000, 1.0)], "in order"),
            (vec![at(20_000, f64::NAN)], "not finite"),
            (
                vec![HostPose { rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..at(20_000, 1.0) }],
                "unit quaternion",
            ),
        ];
        for (of, message) in bad {
            let error = host.advance(&poses(&[(0, 0, of)]), 20_000).unwrap_err().to_string();
            assert!(error.contains(message) && error.contains(&name), "{error}");
            assert_eq!(host.known_until_us(), 10_000);
        }
        let twice = [(0, 0, vec![at(20_000, 1.0)]), (0, 0, vec![at(20_000, 2.0)])];
        assert!(host.advance(&poses(&twice), 20_000).unwrap_err().to_string().contains("twice"));
        for (environment, node) in [(1, 0), (0, 1)] {
            let error =
                host.advance(&poses(&[(environment, node, vec![at(20_000, 1.0)])]), 20_000).unwrap_err();
            assert!(error.to_string().contains("1 node(s) in 1 environment(s)"), "{error}");
        }
        assert!(scene.drive(&["nobody".into()], 0).unwrap_err().to_string().contains("nobody"));
        assert!(scene.drive(&[name.clone(), name], 0).unwrap_err().to_string().contains("twice"));
    }

    /// `desk` with a node that a host moves and hides; the index of the node.
    fn hidden() -> (Scene, Arc<HostPoses>, usize) {
        let mut scene = builtin::load("desk", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.mesh.is_some() && n.parent.is_none()).unwrap();
        let host = scene.drive(&[scene.nodes[node].name.clone()], 0).unwrap();
        (scene, host, node)
    }

    fn state(scene: &Scene, t_us: f64) -> SceneState {
        let mut state = SceneState::default();
        scene.evaluate_variant(scene.variants.first(), t_us * 1e-6, &mut state);
        state
    }

    #[test]
    fn a_node_vanishes_and_appears_all_at_once_where_it_is() {
        let (scene, host, node) = hidden();
        let size = |t_us| state(&scene, t_us).world_from_node[node].x_axis.length();
        let whole = size(0.0);
        host.advance(&poses(&[(0, 0, vec![at(10_000, 1.0)])]), 10_000).unwrap();
        let step = [(0, 0, vec![(20_000, false)])];
        host.advance(&HostStep { visible: &step, ..HostStep::default() }, 20_000).unwrap();
        let again = [(0, 0, vec![(25_000, false), (30_000, true)])];
        host.advance(&HostStep { visible: &again, ..HostStep::default() }, 30_000).unwrap();
        assert!(whole > 0.0);
        assert_eq!([10_000.0, 10_000.01, 20_000.0, 25_000.0].map(size), [whole, 0.0, 0.0, 0.0]);
        assert!((size(25_000.01) - whole).abs() < 1e-12 && (size(1e9) - whole).abs() < 1e-12);
        assert_eq!(state(&scene, 15_000.0).world_from_node[node].w_axis.x, 1.0, "it is where it is");
        assert_eq!(scene.host_step_times(scene.variants.first(), 0.0, 1e9), [10_000.0, 25_000.0]);
        host.forget_before(26_000);
        assert!((size(26_000.0) - whole).abs() < 1e-12);
        // As of a reset: it was never otherwise.
        host.jump(&HostJump { visible: &[(0, 0, false)], ..HostJump::default() }).unwrap();
        assert_eq!([0.0, 30_000.0, 1e9].map(size), [0.0; 3]);
    }

    #[test]
    fn what_is_hidden_in_the_first_step_was_never_seen() {
        let first = |visible: Vec<(i64, bool)>| {
            let (scene, host, node) = hidden();
            host.advance(&HostStep { visible: &[(0, 0, visible)], ..HostStep::default() }, 10_000).unwrap();
            [0.0, 0.01].map(|t_us| state(&scene, t_us).world_from_node[node].x_axis.length() > 0.0)
        };
        assert_eq!(first(vec![(10_000, false)]), [false, false]);
        assert_eq!(first(vec![(0, false), (10_000, true)]), [false, true]);
    }

    #[test]
    fn a_material_changes_for_its_surfaces_and_a_nodes_own_for_it_alone() {
        let mut scene = builtin::load("spinner", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.mesh.is_some()).unwrap();
        let twin = Node { name: "twin".into(), ..scene.nodes[node].clone() };
        scene.nodes.push(twin);
        let (node, name) = (scene.nodes.len() - 1, "twin".to_owned());
        let before = scene.clone();
        let theirs = scene.meshes[scene.nodes[node].mesh.unwrap()].primitives[0].material;
        // A card is drawn from both sides, so the builder gave it a material of its own. `spinner` has a node of this name, too.
        let whole = "plane".to_owned();
        assert_eq!(scene.materials[theirs].name, "plane (both sides)");
        let host = scene.drive_with(&[], &[name.clone(), whole.clone()], 0).unwrap();
        assert_eq!((host.materials(), host.names().len()), (&[name, whole.clone()][..], 0));
        let own = scene.meshes[scene.nodes[node].mesh.unwrap()].primitives[0].material;
        assert_ne!(own, theirs);
        let color =
            |scene: &Scene, material: usize, t_us: f64| state(scene, t_us).factors[material].base_color;
        let old = color(&before, theirs, 0.0);
        host.advance(&HostStep::default(), 10_000).unwrap();
        let red = MaterialChange { base_color: Some([1.0, 0.0, 0.0]), ..MaterialChange::default() };
        host.advance(&HostStep { materials: &[(0, 0, red)], ..HostStep::default() }, 20_000).unwrap();
        assert_eq!([10_000.0, 10_000.01].map(|t| color(&scene, own, t)), [old, [1.0, 0.0, 0.0]]);
        assert_eq!(color(&scene, theirs, 15_000.0), old);
        host.advance(&HostStep { materials: &[(0, 1, red)], ..HostStep::default() }, 30_000).unwrap();
        assert_eq!([20_000.0, 20_000.01].map(|t| color(&scene, theirs, t)), [old, [1.0, 0.0, 0.0]]);
        assert_eq!(scene.host_step_times(None, 0.0, 1e9), [10_000.0, 20_000.0]);
        host.advance(&HostStep { materials: &[(0, 1, red)], ..HostStep::default() }, 40_000).unwrap();
        assert_eq!(scene.host_step_times(None, 0.0, 1e9).len(), 2, "the same again is no change");
    }

    #[test]
    fn a_light_changes_for_its_environment_and_a_nodes_own_for_it_alone() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.light.is_some()).unwrap();
        let theirs = scene.nodes[node].light.unwrap();
        let lamp = scene.lights[theirs].name.clone();
        let twin = Node { name: "twin".into(), ..scene.nodes[node].clone() };
        scene.nodes.push(twin);
        let dim = LightFactors { intensity: 0.25, ..scene.lights[theirs].factors() };
        scene.variants = vec![Variant::default(), Variant::default().with_light(theirs, dim)];
        let before = scene.clone();
        let lights = [lamp.clone(), "twin".to_owned()];
        let host = scene.leave_to_host(&HostNames { lights: &lights, ..HostNames::default() }, 0).unwrap();
        let own = scene.nodes.last().unwrap().light.unwrap();
        assert!(own != theirs && host.lights() == lights);
        let of = |scene: &Scene, environment: usize, light: usize, t_us: f64| {
            let mut state = SceneState::default();
            scene.evaluate_variant(scene.variants.get(environment), t_us * 1e-6, &mut state);
            state.lights[light]
        };
        let begins = |light: usize| [0, 1].map(|e| of(&scene, e, light, 0.0));
        assert_eq!(begins(theirs), [before.lights[theirs].factors(), dim], "an environment's own stays");
        assert_eq!(begins(own), begins(theirs), "what it was made of is so, too");
        host.advance(&HostStep::default(), 10_000).unwrap();
        let off = LightChange { on: Some(false), ..LightChange::default() };
        host.advance(&HostStep { lights: &[(1, 1, off)], ..HostStep::default() }, 20_000).unwrap();
        assert_eq!([10_000.0, 10_001.0].map(|t| of(&scene, 1, own, t).shining()), [0.25, 0.0]);
        assert_eq!(of(&scene, 1, theirs, 15_000.0), dim);
        assert!(of(&scene, 0, own, 15_000.0).on);
        assert_eq!(scene.host_step_times(scene.variants.get(1), 0.0, 1e9), [10_000.0]);
        assert!(scene.host_step_times(scene.variants.first(), 0.0, 1e9).is_empty());
        // Another simulator of the same scene knows nothing of it.
        host.set_lens(1, 0, Lens::FieldOfView { fov_y: 0.3 }).unwrap();
        assert_eq!(before.camera_in(before.variants.get(1), 0, 0.0).unwrap().lens, before.cameras[0].lens);
        let lens =
            |environment: usize| scene.camera_in(scene.variants.get(environment), 0, 0.0).unwrap().lens;
        assert_eq!([lens(0), lens(1)], [before.cameras[0].lens, Lens::FieldOfView { fov_y: 0.3 }]);
        for (lights, message) in [
            (vec!["nobody".to_owned()], "no light named 'nobody'"),
            (vec![lamp.clone(), lamp], "twice"),
            (vec![scene.cameras[0].name.clone()], "carries no light"),
        ] {
            let names = HostNames { lights: &lights, ..HostNames::default() };
            let error = before.clone().leave_to_host(&names, 0).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let twice = [(0, 0, off), (0, 0, off)];
        let error = host.advance(&HostStep { lights: &twice, ..HostStep::default() }, 30_000).unwrap_err();
        assert!(error.to_string().contains("given twice"), "{error}");
    }

    #[test]
    fn steps_that_cannot_be_are_refused_and_change_nothing() {
        let mut scene = builtin::load("spinner", 0).unwrap();
        let disc = scene.nodes.iter().find(|n| n.mesh.is_some()).unwrap().name.clone();
        scene.materials.push(Material {
            name: "matt".into(),
            model: ShadingModel::Diffuse,
            ..Material::default()
        });
        let camera = scene.cameras[0].name.clone();
        let host = scene.drive_with(&[disc.clone(), camera.clone()], &["matt".into()], 0).unwrap();
        let refused = |step: HostStep<'_>, message: &str| {
            let error = host.advance(&step, 10_000).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
            assert_eq!(host.known_until_us(), 0);
        };
        let hide = |node: usize, times: Vec<(i64, bool)>| vec![(0, node, times)];
        for (visible, message) in [
            (hide(1, vec![(10_000, false)]), format!("it carries the camera '{camera}'")),
            (hide(0, vec![(9000, false)]), "the step ends at 10000 us".into()),
            (hide(0, vec![(-1, false), (10_000, true)]), "known until 0 us".into()),
            (hide(2, vec![(10_000, false)]), "2 node(s) in 1 environment(s)".into()),
            ([hide(0, vec![(10_000, false)]), hide(0, vec![(10_000, true)])].concat(), "twice".into()),
        ] {
            refused(HostStep { visible: &visible, ..HostStep::default() }, &message);
        }
        let none = MaterialChange::default();
        for (change, message) in [
            (
                MaterialChange { roughness: Some(0.5), ..none },
                "roughness is not seen of the diffuse material 'matt'",
            ),
            (MaterialChange { base_color: Some([-1.0, 0.0, 0.0]), ..none }, "base_color"),
            (MaterialChange { emissive: Some([f32::NAN; 3]), ..none }, "emissive"),
        ] {
            refused(HostStep { materials: &[(0, 0, change)], ..HostStep::default() }, message);
        }
        refused(
            HostStep { materials: &[(1, 0, none)], ..HostStep::default() },
            "1 material(s) in 1 environment(s)",
        );
        for (materials, message) in [
            (vec!["mat".to_owned()], "did you mean 'matt'?"),
            (vec!["matt".to_owned(), "matt".to_owned()], "twice"),
            (vec![camera], "draws nothing"),
        ] {
            let error = scene.clone().drive_with(&[], &materials, 0).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
