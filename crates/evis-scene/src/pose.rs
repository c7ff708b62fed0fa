//! The state of a scene at one time, and the trait through which poses reach the engine.

use glam::DMat4;

use crate::model::Scene;

/// Where everything is, and how bright, at one time.
#[derive(Clone, Debug, Default)]
pub struct SceneState {
    /// Per node.
    pub world_from_node: Vec<DMat4>,
    /// Per node: morph weights, empty where the node has no morph targets.
    pub morph_weights: Vec<Vec<f32>>,
    /// Per light: the factor of its waveform.
    pub light_factor: Vec<f32>,
    /// Per material: the factor of its waveform.
    pub emission_factor: Vec<f32>,
}

/// Poses over time: a scene's own motion, or poses fed by a host.
pub trait PoseSource: Send + Sync {
    /// Writes the state at `time_s` seconds into `state`, reusing its memory.
    fn evaluate(&self, scene: &Scene, time_s: f64, state: &mut SceneState);
}
