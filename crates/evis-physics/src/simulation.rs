//! Bodies of a scene in Rapier's world, step by step.

use evis_limits::Budget;
use evis_scene::motion::Motion;
use evis_scene::{BodyKind, BodyMass, BodyPose, Collider, RigidBody, Scene, SceneError, SceneState, Trs};
use glam::{DMat4, DQuat, DVec3};
use rapier3d_f64::prelude as rapier;

use crate::keys::Samples;
use crate::{ANGLE_BOUND_DEGREES, POSITION_BOUND_M};

/// Distance at which Rapier looks for contacts of the next step, in metres. Its own 2 cm are for steps of 1/60 s.
const PREDICTION_M: f64 = 0.002;

/// A body slower than this, in metres per second at its farthest point, for [`SLEEP_S`] is put to rest.
const SLEEP_M_PER_S: f64 = 0.005;
const SLEEP_S: f64 = 0.1;

/// A step that changes a velocity by so much, gravity aside, has a key on either side; in metres and radians per second.
const JUMP_M_PER_S: f64 = 0.1;
const JUMP_RAD_PER_S: f64 = 1.0;

/// A body that moves.
struct Moving {
    node: usize,
    name: String,
    /// Of the body in Rapier's world; none before a launch at time 0.
    handle: rapier::RigidBodyHandle,
    start: rapier::Pose,
    collider: rapier::ColliderBuilder,
    velocity: DVec3,
    /// Axis times radians per second.
    spin: DVec3,
    launch_step: usize,
    track: Track,
}

/// Poses of a body's node at the ends of steps.
#[derive(Default)]
struct Track {
    translations: Vec<[f64; 3]>,
    rotations: Vec<[f64; 4]>,
    /// Whether the velocity may jump at a pose.
    knots: Vec<bool>,
    velocity: [DVec3; 2],
    touching: bool,
}

/// Simulates the bodies of `scene` and moves their nodes.
pub(crate) fn run(scene: &mut Scene) -> Result<(), SceneError> {
    scene.check_rigid_bodies().map_err(SceneError::Rule)?;
    let step_s = 1.0 / scene.dynamics.rate_hz;
    let ahead_s = scene.variants.iter().map(|v| v.time_offset_s).fold(0.0, f64::max);
    let end_s = scene.duration_s.unwrap_or(0.0) * scene.speed.unwrap_or(1.0) + ahead_s;
    let steps = (end_s / step_s).ceil();
    let mut world = World::new(scene)?;
    // Poses, and rapier's own share of a step, are small; what a list of them takes is not.
    let rows = steps * world.moving.len() as f64;
    Budget::default().take_values::<([f64; 7], bool)>(rows as u64, "the poses of rigid bodies").map_err(
        |error| SceneError::Rule(format!("{error}; a shorter duration_s or a lower rate_hz takes less")),
    )?;
    for step in 0..steps as usize {
        world.step(step)?;
    }
    for moving in world.moving {
        let motion = moving.track.motion(scene, moving.node, step_s);
        scene.nodes[moving.node].motion = motion;
    }
    Ok(())
}

struct World {
    rapier: rapier::PhysicsWorld,
    moving: Vec<Moving>,
    gravity: DVec3,
    step_s: f64,
}

impl World {
    fn new(scene: &Scene) -> Result<Self, SceneError> {
        let dynamics = scene.dynamics;
        let step_s = 1.0 / dynamics.rate_hz;
        let mut world = rapier::PhysicsWorld { gravity: to_rapier(dynamics.gravity), ..Default::default() };
        let parameters = &mut world.integration_parameters;
        parameters.dt = step_s;
        parameters.min_ccd_dt = step_s / 100.0;
        parameters.num_solver_iterations = dynamics.substeps as usize;
        parameters.normalized_prediction_distance = PREDICTION_M;
        parameters.normalized_allowed_linear_error = PREDICTION_M / 4.0;
        // Contacts of a step are found in it.
        parameters.contact_recycling = false;
        let mut state = SceneState::default();
        scene.evaluate(0.0, &mut state);
        let mut moving = Vec::new();
        for (node, body) in &scene.rigid_bodies {
            let name = scene.nodes[*node].name.clone();
            let refused = |reason: String| SceneError::Rule(format!("'{name}': {reason}"));
            let pose = scene.body_pose(*node).map_err(SceneError::Rule)?;
            let shape = shape(scene, &state, *node, body, &pose).map_err(refused)?;
            let collider = rapier::ColliderBuilder::new(shape)
                .friction(body.friction)
                .restitution(body.restitution)
                .restitution_combine_rule(rapier::CoefficientCombineRule::Max);
            let at = rapier::Pose::from_parts(to_rapier(pose.translation), rotation_to_rapier(pose.rotation));
            let fixed = rapier::RigidBodyBuilder::fixed().pose(at);
            let BodyKind::Dynamic { mass, velocity, spin_axis, spin_rate, launch_s } = body.kind else {
                world.insert(fixed, collider);
                continue;
            };
            if spin_rate.abs() * step_s > std::f64::consts::FRAC_PI_2 {
                return Err(refused(format!(
                    "it spins by {:.1} degrees per second; up to {:.1}, a quarter turn per step, works: raise rate_hz",
                    spin_rate.to_degrees(),
                    90.0 * dynamics.rate_hz
                )));
            }
            let collider = match mass {
                BodyMass::Density(density) => collider.density(density),
                BodyMass::Kilograms(mass) => collider.mass(mass),
            };
            // A body that waits for its launch is a fixed one.
            let launch_step = (launch_s / step_s - 1e-9).ceil() as usize;
            let handle = match launch_step {
                0 => rapier::RigidBodyHandle::invalid(),
                _ => world.insert(fixed, collider.clone()).0,
            };
            // Directions are given in the parent's frame.
            let parent = scene.nodes[*node].parent.map_or(DMat4::IDENTITY, |p| state.world_from_node[p]);
            let turn = parent.to_scale_rotation_translation().1;
            let mut track = Track::default();
            track.push(pose.translation, pose.rotation);
            moving.push(Moving {
                node: *node,
                name,
                handle,
                start: at,
                collider,
                velocity: turn * velocity,
                spin: turn * spin_axis * spin_rate,
                launch_step,
                track,
            });
        }
        Ok(Self { rapier: world, moving, gravity: dynamics.gravity, step_s })
    }

    fn step(&mut self, step: usize) -> Result<(), SceneError> {
        for moving in self.moving.iter_mut().filter(|moving| moving.launch_step == step) {
            // Another body in its place: one that only changed its type would never sleep.
            self.rapier.remove_body(moving.handle);
            let body = rapier::RigidBodyBuilder::dynamic()
                .pose(moving.start)
                .linvel(to_rapier(moving.velocity))
                .angvel(to_rapier(moving.spin))
                .ccd_enabled(true);
            moving.handle = self.rapier.insert(body, moving.collider.clone()).0;
            let activation = self.rapier.bodies[moving.handle].activation_mut();
            activation.normalized_linear_threshold = SLEEP_M_PER_S;
            activation.time_until_sleep = SLEEP_S;
            moving.track.velocity = [moving.velocity, moving.spin];
            moving.track.bend();
        }
        self.rapier.step();
        let mut touching = vec![false; self.moving.len()];
        for pair in self.rapier.narrow_phase.contact_pairs().filter(|pair| pair.has_any_active_contact()) {
            for collider in [pair.collider1, pair.collider2] {
                let body = self.rapier.colliders.get(collider).and_then(|collider| collider.parent());
                let found = self.moving.iter().position(|moving| Some(moving.handle) == body);
                found.into_iter().for_each(|index| touching[index] = true);
            }
        }
        let thrown_out = self.rapier.physics_pipeline.quarantine().bodies();
        for (moving, touching) in self.moving.iter_mut().zip(touching) {
            let body = &self.rapier.bodies[moving.handle];
            let (at, turn) = (from_rapier(body.translation()), rotation_from_rapier(body.rotation()));
            if thrown_out.contains(&moving.handle) || !at.is_finite() || !turn.is_finite() {
                return Err(SceneError::Rule(format!(
                    "'{}': its simulation diverges at {:.4} s; keep bodies apart at the start, or raise rate_hz",
                    moving.name,
                    step as f64 * self.step_s
                )));
            }
            let velocity = [from_rapier(body.linvel()), from_rapier(body.angvel())];
            let [gained, turned] =
                [velocity[0] - moving.track.velocity[0], velocity[1] - moving.track.velocity[1]];
            let track = &mut moving.track;
            let jumped = step >= moving.launch_step
                && touching
                && ((gained - self.gravity * self.step_s).length() > JUMP_M_PER_S
                    || turned.length() > JUMP_RAD_PER_S);
            if jumped || touching != track.touching {
                track.bend();
            }
            track.push(at, turn);
            if jumped {
                track.bend();
            }
            (track.velocity, track.touching) = (velocity, touching);
        }
        Ok(())
    }
}

impl Track {
    fn push(&mut self, at: DVec3, turn: DQuat) {
        self.translations.push(at.to_array());
        // Both signs are one rotation; a spline takes the way between numbers.
        let turn = match self.rotations.last() {
            Some(last) if DQuat::from_array(*last).dot(turn) < 0.0 => -turn,
            _ => turn,
        };
        self.rotations.push(turn.to_array());
        self.knots.push(false);
    }

    /// The velocity may jump at the last pose.
    fn bend(&mut self) {
        self.knots.last_mut().into_iter().for_each(|knot| *knot = true);
    }

    /// The motion of `node`, in its parent's frame.
    fn motion(mut self, scene: &Scene, node: usize, step_s: f64) -> Motion {
        let (scale, ..) = scene.nodes[node].motion.matrix(0.0).to_scale_rotation_translation();
        let mut tolerance_m = POSITION_BOUND_M;
        if let Some(parent) = scene.nodes[node].parent {
            let mut state = SceneState::default();
            scene.evaluate(0.0, &mut state);
            let parent_from_world = state.world_from_node[parent].inverse();
            // A parent above a body is scaled the same along all axes.
            tolerance_m *= parent_from_world.x_axis.length();
            let turn = parent_from_world.to_scale_rotation_translation().1;
            for at in &mut self.translations {
                *at = parent_from_world.transform_point3(DVec3::from_array(*at)).to_array();
            }
            for rotation in &mut self.rotations {
                *rotation = (turn * DQuat::from_array(*rotation)).to_array();
            }
        }
        let (values, knots) = (&self.translations, &self.knots);
        let distance = |a: &[f64; 3], b: &[f64; 3]| DVec3::from_array(*a).distance(DVec3::from_array(*b));
        let translation = Samples { values, knots, step_s, distance, tolerance: tolerance_m }.curve();
        let tolerance = ANGLE_BOUND_DEGREES.to_radians();
        let rotation = Samples { values: &self.rotations, knots, step_s, distance: angle, tolerance }.curve();
        Motion::Animated {
            rest: Trs { scale, ..Trs::default() },
            translation: Some(translation),
            rotation: Some(rotation),
            scale: None,
        }
    }
}

/// Angle, in radians, between the rotation that a spline leads to, of any length, and a unit quaternion.
fn angle(spline: &[f64; 4], given: &[f64; 4]) -> f64 {
    let (spline, given) = (DQuat::from_array(*spline).normalize(), DQuat::from_array(*given));
    4.0 * (0.5 * (spline - given).length()).min(1.0).asin()
}

/// The shape of a body, its scale in it.
fn shape(
    scene: &Scene,
    state: &SceneState,
    node: usize,
    body: &RigidBody,
    pose: &BodyPose,
) -> Result<rapier::SharedShape, String> {
    let scale = pose.scale.abs();
    Ok(match body.collider.unwrap_or(Collider::Hull) {
        Collider::Box { size } => {
            let half = DVec3::from_array(size) * scale * 0.5;
            rapier::SharedShape::cuboid(half.x, half.y, half.z)
        }
        Collider::Sphere { radius } => rapier::SharedShape::ball(radius * scale.x),
        Collider::Cylinder { radius, height } => {
            rapier::SharedShape::cylinder(0.5 * height * scale.y, radius * scale.x)
        }
        Collider::Capsule { radius, height } => {
            rapier::SharedShape::capsule_y(0.5 * height * scale.y, radius * scale.x)
        }
        Collider::HalfSpace => rapier::SharedShape::halfspace(rapier::Vector::Y),
        Collider::Hull => {
            let (points, _) = triangles(scene, state, node, pose)?;
            let flat =
                || "the hull of its meshes has no volume; give it another shape, such as a box".to_owned();
            check_volume(&points).ok_or_else(flat)?;
            rapier::SharedShape::convex_hull(&points).ok_or_else(flat)?
        }
        Collider::Mesh => {
            let (points, indices) = triangles(scene, state, node, pose)?;
            // Edges inside a flat surface would trip what slides over it.
            let flags = rapier::TriMeshFlags::FIX_INTERNAL_EDGES;
            rapier::SharedShape::trimesh_with_flags(points, indices, flags)
                .map_err(|error| format!("its meshes make no collider ({error}); give it another shape"))?
        }
    })
}

/// Part of the largest extent that a hull must have in every direction.
const THINNEST: f64 = 1e-6;

/// `None` where all points lie in a plane, for which Rapier has no hull.
fn check_volume(points: &[rapier::Vector]) -> Option<()> {
    let points: Vec<DVec3> = points.iter().map(|p| from_rapier(*p)).collect();
    let first = points.first()?;
    let farthest = |of: &dyn Fn(&DVec3) -> f64| points.iter().max_by(|a, b| of(a).total_cmp(&of(b))).copied();
    let along = farthest(&|p| p.distance(*first))? - *first;
    let unit = along.try_normalize()?;
    let across = farthest(&|p| (*p - *first).reject_from_normalized(unit).length())? - *first;
    let normal = unit.cross(across).try_normalize()?;
    let least = THINNEST * along.length();
    let wide = across.reject_from_normalized(unit).length() > least;
    let thick = points.iter().any(|p| (*p - *first).dot(normal).abs() > least);
    (wide && thick).then_some(())
}

/// Corners and triangles of all that is drawn on `node` and on what hangs on it, but for other bodies, as it is at the
/// start; in metres along the axes of the body.
fn triangles(
    scene: &Scene,
    state: &SceneState,
    node: usize,
    pose: &BodyPose,
) -> Result<(Vec<rapier::Vector>, Vec<[u32; 3]>), String> {
    let body_from_world = DMat4::from_rotation_translation(pose.rotation, pose.translation).inverse();
    let bodies = scene.rigid_bodies.iter().map(|(other, _)| *other);
    let others: Vec<usize> = bodies.filter(|other| *other != node && scene.carries(node, *other)).collect();
    let (mut points, mut indices) = (Vec::new(), Vec::new());
    for (index, drawn) in scene.nodes.iter().enumerate() {
        let own = scene.carries(node, index) && !others.iter().any(|other| scene.carries(*other, index));
        let Some(mesh) = drawn.mesh.and_then(|m| scene.meshes.get(m)).filter(|_| own && drawn.skin.is_none())
        else {
            continue;
        };
        let body_from_mesh = body_from_world * state.world_from_node[index];
        for primitive in &mesh.primitives {
            let first = points.len() as u32;
            points.extend(
                primitive
                    .positions
                    .iter()
                    .map(|p| to_rapier(body_from_mesh.transform_point3(DVec3::from_array(p.map(f64::from))))),
            );
            let corners = primitive.indices.as_chunks::<3>().0.iter();
            indices.extend(corners.map(|corners| corners.map(|corner| first + corner)));
        }
    }
    if indices.is_empty() {
        return Err(
            "there is no mesh on its node that its collider could be made of; give it a shape, such as a box"
                .into(),
        );
    }
    Ok((points, indices))
}

// Rapier has its own version of glam.

fn to_rapier(v: DVec3) -> rapier::Vector {
    rapier::Vector::from_array(v.to_array())
}

fn from_rapier(v: rapier::Vector) -> DVec3 {
    DVec3::from_array(v.to_array())
}

fn rotation_to_rapier(q: DQuat) -> rapier::Rotation {
    rapier::Rotation::from_array(q.to_array())
}

fn rotation_from_rapier(q: &rapier::Rotation) -> DQuat {
    DQuat::from_array(q.to_array())
}
