//! Objects and cameras by name, and where they are: exact poses, and velocities from them.

use evis_core::format::hdf5::{BodyInfo, BodySample};
use evis_core::{ConfigError, TimeGrid};
use evis_scene::{Scene, SceneState};
use glam::{DMat3, DMat4, DQuat, DVec3};

/// Seconds between the poses that velocities are taken from.
const STEP_S: f64 = 1e-3;

/// Every node that draws something, and cameras, of one environment.
pub struct Bodies {
    infos: Vec<BodyInfo>,
    /// Nodes.
    nodes: Vec<usize>,
    environment: usize,
    start_us: i64,
    states: [SceneState; 5],
}

impl Bodies {
    /// The objects of `scene`, and those of its cameras that `cameras` names. Stream time begins at scene time `start_us`.
    ///
    /// # Errors
    /// An environment that does not exist.
    pub fn new<'a>(
        scene: &Scene,
        cameras: impl IntoIterator<Item = &'a str>,
        environment: usize,
        start_us: i64,
    ) -> Result<Self, ConfigError> {
        let environments = scene.variants.len().max(1);
        if environment >= environments {
            return Err(ConfigError::new("environment", environment, format!("below {environments}")));
        }
        let mut state = SceneState::default();
        evaluate(scene, environment, start_us as f64 * 1e-6, &mut state);
        let (mut infos, mut nodes) = (Vec::new(), Vec::new());
        for (index, node) in scene.nodes.iter().enumerate() {
            let Some(mesh) = node.mesh.and_then(|mesh| scene.meshes.get(mesh)) else { continue };
            let world = state.world_from_node[index];
            // The pose is rigid: the scale is in the box.
            let body_from_node = crate::world::transform::rigid(&world).inverse() * world;
            let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
            for position in mesh.primitives.iter().flat_map(|primitive| &primitive.positions) {
                let corner = body_from_node.transform_point3(DVec3::from(position.map(f64::from)));
                for axis in 0..3 {
                    bounds[0][axis] = bounds[0][axis].min(corner[axis]);
                    bounds[1][axis] = bounds[1][axis].max(corner[axis]);
                }
            }
            infos.push(BodyInfo {
                name: node.name.clone(),
                instance_id: node.instance_id,
                semantic_id: node.semantic_id,
                semantic_name: scene.class_names.get(&node.semantic_id).cloned().unwrap_or_default(),
                bounds,
            });
            nodes.push(index);
        }
        for name in cameras {
            let Some(camera) = scene.cameras.iter().find(|camera| camera.name == name) else { continue };
            let bounds = [[f64::NAN; 3]; 2];
            infos.push(BodyInfo {
                name: name.into(),
                instance_id: 0,
                semantic_id: 0,
                semantic_name: String::new(),
                bounds,
            });
            nodes.push(camera.node);
        }
        Ok(Self { infos, nodes, environment, start_us, states: Default::default() })
    }

    /// Names, ids and boxes.
    pub fn infos(&self) -> &[BodyInfo] {
        &self.infos
    }

    /// Where all of them are at stream time `t_us`. Velocities are central differences of fourth order over steps of 1 ms; at
    /// a jump or a kink they are the mean over it.
    pub fn at(&mut self, scene: &Scene, t_us: i64) -> Vec<BodySample> {
        let t_s = (self.start_us + t_us) as f64 * 1e-6;
        for (state, k) in self.states.iter_mut().zip([-2.0, -1.0, 0.0, 1.0, 2.0]) {
            evaluate(scene, self.environment, t_s + k * STEP_S, state);
        }
        let states = &self.states;
        let sample = |&node: &usize| {
            let poses =
                [0, 1, 2, 3, 4].map(|k| crate::world::transform::rigid(&states[k].world_from_node[node]));
            sample(&poses)
        };
        self.nodes.iter().map(sample).collect()
    }
}

/// The sample in the middle of five rigid poses.
fn sample(poses: &[DMat4; 5]) -> BodySample {
    let p = poses.map(|pose| pose.w_axis.truncate());
    let rotation = poses.map(|pose| DQuat::from_mat3(&DMat3::from_mat4(pose)).normalize());
    let turn = |k: usize| {
        let turn = rotation[k] * rotation[2].inverse();
        // The shorter way round.
        (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis()
    };
    let slope = |a: [DVec3; 4]| (8.0 * (a[2] - a[1]) - (a[3] - a[0])) / (12.0 * STEP_S);
    BodySample {
        position: p[2].into(),
        rotation: rotation[2].into(),
        linear_velocity: slope([p[0], p[1], p[3], p[4]]).into(),
        angular_velocity: slope([turn(0), turn(1), turn(3), turn(4)]).into(),
    }
}

fn evaluate(scene: &Scene, environment: usize, t_s: f64, state: &mut SceneState) {
    scene.evaluate_variant(scene.variants.get(environment), t_s, state);
}

/// Times at which bodies of a stream are sampled: a grid of a rate, from 0 to the stream's end.
pub struct BodyTimes {
    grid: TimeGrid,
    next: i64,
}

impl BodyTimes {
    /// `rate_hz` times per second.
    ///
    /// # Errors
    /// A rate that cannot be used.
    pub fn new(rate_hz: f64) -> Result<Self, ConfigError> {
        let grid = TimeGrid::new(rate_hz).map_err(|e| ConfigError { what: "pose_rate_hz".into(), ..e })?;
        Ok(Self { grid, next: 0 })
    }

    /// The times up to `until_us`, it included, that were not given yet.
    pub fn advance(&mut self, until_us: i64) -> Vec<i64> {
        let mut times = Vec::new();
        while self.grid.instant_us(self.next) <= until_us {
            times.push(self.grid.instant_us(self.next));
            self.next += 1;
        }
        times
    }
}

#[cfg(test)]
mod tests {
    use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
    use evis_scene::motion::Path;
    use evis_scene::{Material, Trs};

    use super::*;

    /// A card, 2 m wide by scale, that moves on at (0.3, -0.1, 0.2) m/s and spins at 2 rad/s about +Y.
    fn scene() -> Scene {
        let mut s = SceneBuilder::new("bodies");
        let white = s.material(Material::unlit("white")).unwrap();
        let path = Path::Chain(vec![
            Path::ConstantVelocity { start: Trs::default(), velocity: DVec3::new(0.3, -0.1, 0.2) },
            Path::Spin { start: Trs::default(), axis: DVec3::Y, rate: 2.0 },
            Path::ConstantVelocity {
                start: Trs { scale: DVec3::new(4.0, 1.0, 1.0), ..Trs::default() },
                velocity: DVec3::ZERO,
            },
        ]);
        let placed = Placement::along(path);
        s.shape("card", evis_scene::primitive::Shape::Card { size: [0.5, 1.0] }, white, placed).unwrap();
        s.camera(EventCamera::new("eye"), Placement::default()).unwrap();
        s.build().unwrap()
    }

    #[test]
    fn bodies_have_names_boxes_poses_and_velocities() {
        let scene = scene();
        let mut bodies = Bodies::new(&scene, ["eye"], 0, 500_000).unwrap();
        let [card, eye] = bodies.infos() else { panic!("an object and a camera") };
        assert_eq!((card.name.as_str(), card.instance_id > 0), ("card", true));
        assert_eq!((eye.name.as_str(), eye.instance_id), ("eye", 0));
        let [low, high] = card.bounds;
        assert!((high[0] - 1.0).abs() < 1e-6 && (low[0] + 1.0).abs() < 1e-6, "scaled by 4: {low:?} {high:?}");
        let samples = bodies.at(&scene, 250_000);
        let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(close(samples[0].position, [0.225, -0.075, 0.15]), "0.75 s of motion: {:?}", samples[0]);
        assert!(close(samples[0].linear_velocity, [0.3, -0.1, 0.2]), "{:?}", samples[0]);
        assert!(close(samples[0].angular_velocity, [0.0, 2.0, 0.0]), "{:?}", samples[0]);
        assert!(!close(samples[0].angular_velocity, [0.0, -2.0, 0.0]), "canary: the sign counts");
        let [_, y, _, w] = samples[0].rotation;
        assert!((2.0 * y.atan2(w) - 1.5).abs() < 1e-9, "turned by 2 rad/s * 0.75 s");
        assert!(close(samples[1].linear_velocity, [0.0; 3]));
        assert!(Bodies::new(&scene, [], 1, 0).is_err(), "there is one environment");
    }

    #[test]
    fn times_reach_the_end() {
        let mut times = BodyTimes::new(400.0).unwrap();
        assert_eq!(times.advance(5_000), [0, 2_500, 5_000]);
        assert_eq!(times.advance(7_499), [] as [i64; 0]);
        assert_eq!(times.advance(10_000), [7_500, 10_000]);
        assert!(BodyTimes::new(0.0).is_err());
    }
}
