//! The state of a scene at one time: its own motion, and what a host said ([`crate::HostPoses`]).

use std::sync::Arc;

use glam::DMat4;

use crate::error::SceneError;
use crate::factors::{LightFactors, MaterialFactors};
use crate::model::{Camera, Light, Material, Scene, Variant};
use crate::motion::Motion;
use crate::steps::Steps;
use crate::track::Track;

/// Speeds of a scene, as factors on its own: beyond them its times and rates leave those that are simulated.
const SPEEDS: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

/// Where everything is, and how bright, at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneState {
    /// Per node.
    pub world_from_node: Vec<DMat4>,
    /// Per node: morph weights, empty where the node has no morph targets.
    pub morph_weights: Vec<Vec<f32>>,
    /// Per light: the factor of its waveform.
    pub light_factor: Vec<f32>,
    /// Per light: what the waveform multiplies.
    pub lights: Vec<LightFactors>,
    /// Per material: the factor of its waveform.
    pub emission_factor: Vec<f32>,
    /// Per material: what textures multiply.
    pub factors: Vec<MaterialFactors>,
}

impl Scene {
    /// Writes poses, morph weights and light factors at `t_s` seconds into `state`, reusing its memory.
    pub fn evaluate(&self, t_s: f64, state: &mut SceneState) {
        self.evaluate_variant(None, t_s, state);
    }

    /// As [`Scene::evaluate`], for one variant: on its clock, with its nodes offset.
    pub fn evaluate_variant(&self, variant: Option<&Variant>, t_s: f64, state: &mut SceneState) {
        // Hosts keep the stream's own time.
        let host_us = t_s * 1e6;
        let t_s = t_s * self.speed.unwrap_or(1.0) + variant.map_or(0.0, |v| v.time_offset_s);
        let offsets = variant.map_or(&[][..], |v| &v.node_offsets);

        state.world_from_node.clear();
        for (index, node) in self.nodes.iter().enumerate() {
            if let Some(track) = self.track_of(variant, index) {
                state.world_from_node.push(track.world_from_node(host_us));
                continue;
            }
            let motion = node.motion.matrix(t_s);
            let own = offsets.iter().filter(|(n, _)| *n == index).fold(motion, |m, (_, offset)| *offset * m);
            let parent = node.parent.and_then(|p| state.world_from_node.get(p));
            let world = parent.map_or(own, |parent| *parent * own);
            state.world_from_node.push(world);
        }

        state.morph_weights.resize_with(self.nodes.len(), Vec::new);
        for (node, weights) in self.nodes.iter().zip(&mut state.morph_weights) {
            weights.clear();
            let Some(mesh) = node.mesh.and_then(|m| self.meshes.get(m)) else { continue };
            weights.extend_from_slice(&mesh.morph_weights);
            if let Some(curve) = &node.morph {
                weights.resize(curve.width, 0.0);
                curve.visit(t_s, |i, v| weights[i] = v as f32);
            }
        }

        let factor = |w: &Option<crate::motion::Waveform>| w.map_or(1.0, |w| w.factor(t_s) as f32);
        state.light_factor.clear();
        state.light_factor.extend(self.lights.iter().map(|l| factor(&l.waveform)));
        state.emission_factor.clear();
        state.emission_factor.extend(self.materials.iter().map(|m| factor(&m.emission_waveform)));
        state.factors.clear();
        state.factors.extend(self.materials.iter().map(Material::factors));
        for (material, steps) in self.driven_factors(variant) {
            if let (Some(slot), Some(now)) = (state.factors.get_mut(*material), steps.at(host_us)) {
                *slot = now;
            }
        }
        state.lights.clear();
        state.lights.extend(self.lights.iter().map(Light::factors));
        for (light, steps) in self.own_lights(variant) {
            if let (Some(slot), Some(now)) = (state.lights.get_mut(*light), steps.at(host_us)) {
                *slot = now;
            }
        }
    }

    /// Camera `camera` (an index) with the lens that it has in `variant` at scene time `t_us`; of the last change where that is
    /// infinite. `None` where there is no such camera.
    pub fn camera_in(&self, variant: Option<&Variant>, camera: usize, t_us: f64) -> Option<Camera> {
        let mut own = self.cameras.get(camera)?.clone();
        let found = variant.and_then(|v| v.lenses.iter().find(|(index, _)| *index == camera));
        if let Some(lens) = found.and_then(|(_, steps)| steps.at(t_us)) {
            own.lens = lens;
        }
        Some(own)
    }

    /// What a host says of node `node` in `variant`; `None` where no host moves it.
    pub fn track_of<'a>(&'a self, variant: Option<&'a Variant>, node: usize) -> Option<&'a Track> {
        let Motion::Driven(track) = &self.nodes.get(node)?.motion else { return None };
        let own = variant.and_then(|v| v.poses.iter().find(|(n, _)| *n == node));
        Some(own.map_or(track, |(_, own)| own))
    }

    /// Lights that are otherwise in `variant`; in the first one where none is chosen.
    fn own_lights<'a>(&'a self, variant: Option<&'a Variant>) -> &'a [(usize, Arc<Steps<LightFactors>>)] {
        variant.or_else(|| self.variants.first()).map_or(&[], |variant| &variant.lights)
    }

    /// Materials that are otherwise in `variant`; in the first one where none is chosen.
    fn driven_factors<'a>(
        &'a self,
        variant: Option<&'a Variant>,
    ) -> &'a [(usize, Arc<Steps<MaterialFactors>>)] {
        variant.or_else(|| self.variants.first()).map_or(&[], |variant| &variant.factors)
    }

    /// Times in (start, end), in microseconds of scene time and ascending, at which a host shows or hides nodes of `variant`, or changes its
    /// materials or lights.
    pub fn host_step_times(&self, variant: Option<&Variant>, start_us: f64, end_us: f64) -> Vec<f64> {
        let mut times = Vec::new();
        for index in 0..self.nodes.len() {
            if let Some(track) = self.track_of(variant, index) {
                times.extend(track.visible.times(start_us, end_us));
            }
        }
        for (_, steps) in self.driven_factors(variant) {
            times.extend(steps.times(start_us, end_us));
        }
        for (_, steps) in self.own_lights(variant) {
            times.extend(steps.times(start_us, end_us));
        }
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    /// Times in (start, end), in microseconds of scene time and ascending, at which a motion or a light bends or jumps: keys of
    /// curves and paths, launches, edges of square and pulsed light, and [`Scene::host_step_times`]. A host's poses are not among
    /// them.
    pub fn break_times(&self, variant: Option<&Variant>, start_us: f64, end_us: f64) -> Vec<f64> {
        let speed = self.speed.unwrap_or(1.0);
        let offset_s = variant.map_or(0.0, |v| v.time_offset_s);
        let range_s = [start_us, end_us].map(|t| t * 1e-6 * speed + offset_s);
        let mut times = Vec::new();
        for node in &self.nodes {
            match &node.motion {
                // What a host moves bends where its poses are, and jumps where it is shown or hidden.
                Motion::Fixed(_) | Motion::Driven(_) => {}
                Motion::Animated { translation, rotation, scale, .. } => {
                    for curve in [translation, rotation, scale].into_iter().flatten() {
                        times.extend_from_slice(&curve.times);
                    }
                }
                Motion::Path(path) => path.break_times(&mut times),
            }
            node.morph.iter().for_each(|curve| times.extend_from_slice(&curve.times));
        }
        let waves = self.lights.iter().filter_map(|l| l.waveform);
        for wave in waves.chain(self.materials.iter().filter_map(|m| m.emission_waveform)) {
            wave.edge_times(range_s, &mut times);
        }
        times.retain(|t| *t > range_s[0] && *t < range_s[1]);
        times.sort_by(f64::total_cmp);
        times.dedup();
        let mut times: Vec<f64> = times.into_iter().map(|t| (t - offset_s) / speed * 1e6).collect();
        times.extend(self.host_step_times(variant, start_us, end_us));
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    /// The scene with everything that moves, deforms or changes its light `speed` times as fast as now. Offsets of
    /// variants stay seconds of its own clock.
    ///
    /// # Errors
    /// A speed, or one that comes of several, that is not a number from 1e-6 to 1e6.
    pub fn at_speed(mut self, speed: f64) -> Result<Self, SceneError> {
        let total = self.speed.unwrap_or(1.0) * speed;
        if !(SPEEDS.contains(&speed) && SPEEDS.contains(&total)) {
            let at_once = self.speed.map_or_else(String::new, |own| format!(" of a scene at {own}"));
            return Err(SceneError::Rule(format!(
                "speed is {speed}{at_once}; it must be from {} to {} times the scene's own, such as 0.25",
                SPEEDS.start(),
                SPEEDS.end()
            )));
        }
        self.speed = (speed != 1.0 || self.speed.is_some()).then_some(total);
        self.duration_s = self.duration_s.map(|s| s / speed);
        Ok(self)
    }

    /// `world_from_bind` per joint of skin `skin` (`world_from_joint * inverse_bind`), in place of what `out` held.
    /// A skinned mesh ignores its node's own pose (glTF 2.0, 3.7.3.3): these matrices lead to the world directly.
    /// Empty where there is no such skin.
    pub fn joint_matrices(&self, skin: usize, state: &SceneState, out: &mut Vec<DMat4>) {
        out.clear();
        let Some(skin) = self.skins.get(skin) else { return };
        out.extend(skin.joints.iter().enumerate().map(|(i, &joint)| {
            let world = state.world_from_node.get(joint).copied().unwrap_or(DMat4::IDENTITY);
            world * skin.inverse_bind.get(i).copied().unwrap_or(DMat4::IDENTITY)
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin;

    #[test]
    fn a_faster_scene_is_where_it_would_be_later() {
        let scene = builtin::load("street", 0).unwrap();
        let fast = scene.clone().at_speed(8.0).unwrap().at_speed(0.5).unwrap();
        let state = |scene: &Scene, t_s| {
            let mut state = SceneState::default();
            scene.evaluate(t_s, &mut state);
            (state.world_from_node, state.light_factor)
        };
        assert_eq!(state(&fast, 0.1), state(&scene, 0.4));
        assert_ne!(state(&fast, 0.1), state(&scene, 0.1), "canary");
        assert_eq!(fast.duration_s, scene.duration_s.map(|s| s / 4.0));
        assert!(scene.clone().at_speed(1.0).unwrap().speed.is_none());
        for bad in [0.0, -1.0, 1e-7, 1.1e6, 1e30, f64::NAN, f64::INFINITY] {
            assert!(scene.clone().at_speed(bad).unwrap_err().to_string().contains(&bad.to_string()));
        }
        let told = scene.at_speed(1000.0).unwrap().at_speed(2000.0).unwrap_err().to_string();
        assert!(
            told.contains("speed is 2000 of a scene at 1000; it must be from 0.000001 to 1000000"),
            "{told}"
        );
    }
}
