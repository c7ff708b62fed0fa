//! Objects and cameras by name, and where they are: exact poses, and velocities from them.

use std::collections::BTreeSet;
use std::sync::Arc;

use evis_core::format::hdf5::{BodyInfo, BodySample};
use evis_core::{ConfigError, TimeGrid};
use evis_scene::{HostPose, HostPoses, HostStep, Scene, SceneError, SceneState};
use glam::{DMat3, DMat4, DQuat, DVec3};

/// Seconds between the poses that velocities are taken from.
const STEP_S: f64 = 1e-3;

/// Weights of the differences to the poses 1, 2, 3 and 4 steps earlier, over 12 steps: a derivative of fourth order.
const ONE_SIDED: [f64; 4] = [-48.0, 36.0, -16.0, 3.0];

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
        let slope = |a: [DVec3; 4]| (8.0 * (a[2] - a[1]) - (a[3] - a[0])) / (12.0 * STEP_S);
        self.samples(2, slope)
    }

    /// The same, with velocities from poses on one side, at multiples of `step_s`: earlier ones where it is above 0.
    fn at_one_side(&mut self, scene: &Scene, t_us: i64, step_s: f64) -> Vec<BodySample> {
        let t_s = (self.start_us + t_us) as f64 * 1e-6;
        for (state, k) in self.states.iter_mut().zip([0.0, 1.0, 2.0, 3.0, 4.0]) {
            evaluate(scene, self.environment, t_s - k * step_s, state);
        }
        let slope = |a: [DVec3; 4]| {
            a.into_iter().zip(ONE_SIDED).map(|(a, weight)| a * weight).sum::<DVec3>() / (12.0 * step_s)
        };
        self.samples(0, slope)
    }

    /// Samples at state `middle`; `slope` makes a velocity of the differences of the four others to it.
    fn samples(&self, middle: usize, slope: impl Fn([DVec3; 4]) -> DVec3) -> Vec<BodySample> {
        let states = &self.states;
        let sample = |&node: &usize| {
            let poses =
                [0, 1, 2, 3, 4].map(|k| crate::world::transform::rigid(&states[k].world_from_node[node]));
            sample(&poses, middle, &slope)
        };
        self.nodes.iter().map(sample).collect()
    }
}

/// The sample at `middle` of five rigid poses.
fn sample(poses: &[DMat4; 5], middle: usize, slope: impl Fn([DVec3; 4]) -> DVec3) -> BodySample {
    let p = poses.map(|pose| pose.w_axis.truncate());
    let rotation = poses.map(|pose| DQuat::from_mat3(&DMat3::from_mat4(pose)).normalize());
    let turn = |k: usize| {
        let turn = rotation[k] * rotation[middle].inverse();
        // The shorter way round.
        (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis()
    };
    let others = if middle == 0 { [1, 2, 3, 4] } else { [0, 1, 3, 4] };
    BodySample {
        position: p[middle].into(),
        rotation: rotation[middle].into(),
        linear_velocity: slope(others.map(|k| p[k] - p[middle])).into(),
        angular_velocity: slope(others.map(turn)).into(),
    }
}

fn evaluate(scene: &Scene, environment: usize, t_s: f64, state: &mut SceneState) {
    scene.evaluate_variant(scene.variants.get(environment), t_s, state);
}

/// What a host said of the time of a packet: where its nodes were before it, and where they were then.
#[derive(Clone, Debug)]
pub struct HostSpan {
    /// Environment, node, and its pose at the start, in scene time.
    pub(crate) before: Vec<(usize, usize, HostPose)>,
    /// By step: its end and the poses in it, in scene time.
    pub(crate) steps: Vec<StepPoses>,
}

/// End of a step; environment, node and poses.
pub(crate) type StepPoses = (i64, Vec<(usize, usize, Vec<HostPose>)>);

impl HostSpan {
    /// Before anything is said.
    pub(crate) fn new(host: &HostPoses) -> Self {
        Self { before: host.last_poses(), steps: Vec::new() }
    }

    /// Scene time up to which something was said.
    pub(crate) fn until_us(&self) -> Option<i64> {
        self.steps.last().map(|(until_us, _)| *until_us)
    }
}

/// The bodies of a scene that a host moves, as packets say how.
pub struct HostBodies {
    /// Moved by `host`, and by nothing else.
    scene: Scene,
    host: Arc<HostPoses>,
    /// By environment.
    bodies: Vec<Bodies>,
    start_us: i64,
    /// Where nodes were when the last span ended.
    last: Vec<(usize, usize, HostPose)>,
}

/// A stream time, and where all bodies are then.
pub type BodyRow = (i64, Vec<BodySample>);

impl HostBodies {
    /// As [`Bodies::new`], in all environments of `scene`, whose `nodes` a host moves, named as [`Scene::drive`] takes them.
    ///
    /// # Errors
    /// As [`Scene::drive`].
    pub fn new(
        scene: &Scene,
        nodes: &[String],
        cameras: &[String],
        start_us: i64,
    ) -> Result<Self, SceneError> {
        let names = || cameras.iter().map(String::as_str);
        let bodies: Vec<Bodies> = (0..scene.variants.len().max(1))
            .map(|environment| Bodies::new(scene, names(), environment, start_us))
            .collect::<Result<_, _>>()
            .map_err(|error| SceneError::Rule(error.to_string()))?;
        let mut scene = scene.clone();
        // Poses need no shapes.
        scene.meshes.clear();
        scene.images.clear();
        let host = scene.drive(nodes, start_us)?;
        Ok(Self { scene, host, bodies, start_us, last: Vec::new() })
    }

    /// Names, ids and boxes, by environment.
    pub fn infos(&self) -> impl Iterator<Item = &[BodyInfo]> {
        self.bodies.iter().map(Bodies::infos)
    }

    /// Follows what the host said of a packet, and tells where all bodies were by environment: at the times that the host gave
    /// poses of any node of the environment, a microsecond after a reset that moved one, and at `times_us` of stream time.
    ///
    /// Velocities are one-sided differences of fourth order, over up to 4 ms after the time before at which the host gave a pose:
    /// they are the velocities that the host gave, or the mean ones since then.
    ///
    /// # Errors
    /// A span of another scene.
    pub fn follow(&mut self, span: &HostSpan, times_us: &[i64]) -> Result<Vec<Vec<BodyRow>>, SceneError> {
        let jumped = |environment: usize, node: usize, pose: &HostPose| {
            let same = |(e, n, p): &&(usize, usize, HostPose)| {
                (*e, *n) == (environment, node) && !same_place(p, pose)
            };
            self.last.iter().find(same).map(|_| (environment, pose.t_us + 1))
        };
        let jumps: Vec<(usize, i64)> =
            span.before.iter().filter_map(|(e, n, pose)| jumped(*e, *n, pose)).collect();
        self.host.restart(&span.before);
        for (until_us, poses) in &span.steps {
            self.host.advance(&HostStep { poses, ..HostStep::default() }, *until_us)?;
        }
        self.last = self.host.last_poses();
        let mut rows = Vec::with_capacity(self.bodies.len());
        for (environment, bodies) in self.bodies.iter_mut().enumerate() {
            let begin = span.before.iter().filter(|(e, ..)| *e == environment).map(|(.., pose)| pose.t_us);
            let steps = span.steps.iter().flat_map(|(_, poses)| poses);
            let given: BTreeSet<i64> = steps
                .filter(|(e, ..)| *e == environment)
                .flat_map(|(.., poses)| poses.iter().map(|pose| pose.t_us))
                .collect();
            let knots: BTreeSet<i64> = begin.chain(given.iter().copied()).collect();
            let mut times = given;
            times.extend(jumps.iter().filter(|(e, _)| *e == environment).map(|(_, t_us)| *t_us));
            times.extend(times_us.iter().map(|t_us| self.start_us + t_us));
            let row = |t_us: i64| {
                let earlier = knots.range(..t_us).next_back().map(|knot| t_us - knot);
                let later = knots.range(t_us + 1..).next().map(|knot| t_us - knot);
                // Four steps fit between the knots.
                let room_s = earlier.or(later).map_or(f64::INFINITY, |room_us| room_us as f64 * 0.25e-6);
                let stream_us = t_us - self.start_us;
                (stream_us, bodies.at_one_side(&self.scene, stream_us, room_s.clamp(-STEP_S, STEP_S)))
            };
            rows.push(times.into_iter().map(row).collect());
        }
        Ok(rows)
    }
}

fn same_place(a: &HostPose, b: &HostPose) -> bool {
    (a.position, a.rotation) == (b.position, b.rotation)
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
    fn what_a_host_moves_is_where_it_said() {
        let scene = scene();
        let names = ["card".to_owned()];
        let mut driven = scene.clone();
        let host = driven.drive(&names, 500_000).unwrap();
        let mut bodies = HostBodies::new(&scene, &names, &["eye".into()], 500_000).unwrap();
        let turn = |angle: f64| [0.0, (0.5 * angle).sin(), 0.0, (0.5 * angle).cos()];
        // One metre per second squared, and 3 rad/s.
        let pose = |t_us: i64| {
            let t = (t_us - 500_000) as f64 * 1e-6;
            let fall = HostPose::new(t_us, [0.0, 0.5 * t * t, 1.0], turn(3.0 * t), Some([0.0, t, 0.0]));
            fall.turning(Some([0.0, 3.0, 0.0]))
        };
        let mut step = |times: &[i64], until_us: i64| {
            let mut span = HostSpan::new(&host);
            let poses = vec![(0, 0, times.iter().map(|t| pose(*t)).collect::<Vec<_>>())];
            host.advance(&HostStep { poses: &poses, ..HostStep::default() }, until_us).unwrap();
            span.steps.push((until_us, poses));
            bodies.follow(&span, &[until_us - 500_000]).unwrap().remove(0)
        };
        let close = |a: [f64; 3], b: [f64; 3], by: f64| a.iter().zip(b).all(|(a, b)| (a - b).abs() < by);
        let mut rows = step(&[500_000, 504_000, 510_000], 510_000);
        host.forget_before(510_000);
        rows.extend(step(&[512_000, 520_000], 520_000));
        let times: Vec<i64> = rows.iter().map(|(t_us, _)| *t_us).collect();
        assert_eq!(times, [0, 4_000, 10_000, 12_000, 20_000]);
        for (t_us, samples) in &rows {
            let (card, given) = (samples[0], pose(500_000 + t_us));
            assert!(close(card.position, given.position.into(), 1e-12), "{t_us}: {card:?}");
            let rotation = DQuat::from_array(card.rotation);
            assert!(rotation.dot(given.rotation).abs() > 1.0 - 1e-12, "{t_us}: {card:?}");
            assert!(close(card.linear_velocity, given.velocity.unwrap().into(), 1e-8), "{t_us}: {card:?}");
            assert!(close(card.angular_velocity, [0.0, 3.0, 0.0], 1e-8), "{t_us}: {card:?}");
        }
        assert!(!close(rows[4].1[0].position, pose(510_000).position.into(), 1e-12), "canary");
        // A reset moves it, and a node without a pose rests.
        let jump = [(0, 0, HostPose::new(0, [5.0, 0.0, 0.0], turn(1.0), None))];
        host.jump(&evis_scene::HostJump { poses: &jump, ..Default::default() }).unwrap();
        let mut span = HostSpan::new(&host);
        host.advance(&HostStep::default(), 530_000).unwrap();
        span.steps.push((530_000, Vec::new()));
        let rows = bodies.follow(&span, &[30_000]).unwrap().remove(0);
        let at: Vec<_> = rows.iter().map(|(t_us, samples)| (*t_us, samples[0].position[0])).collect();
        assert_eq!(at, [(20_001, 5.0), (30_000, 5.0)]);
        assert!(close(rows[1].1[0].linear_velocity, [0.0; 3], 1e-9));
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
