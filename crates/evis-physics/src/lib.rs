//! Rigid bodies of EVIS scenes, simulated with [Rapier](https://rapier.rs).
//!
//! A scene file, a builder or a built-in scene describes bodies ([`evis_scene::RigidBody`]). [`simulate`] lets them fall,
//! fly and collide once, over the whole duration of the scene, and leaves ordinary animation curves on their nodes, so
//! that everything else reads them as any motion. [`load`] and [`open`] do so for whatever they load.
//!
//! The same scene gives the same bits on every machine: the step is fixed, there is one thread, and Rapier is built with
//! its own square roots and sines (`enhanced-determinism`).
//!
//! # Poses between steps
//!
//! Curves are cubic splines through poses of the integrator, which is symplectic Euler with the step
//! `1 / (rate_hz * substeps)`; poses are those at the ends of whole steps. Within a step that touches nothing the spline
//! is the parabola through such poses; a step in which a velocity jumps has a key on either side and is straight in
//! between. Keys are left out where the spline stays within [`POSITION_BOUND_M`] and [`ANGLE_BOUND_DEGREES`] of every
//! pose; a flight needs two keys of translation. What has come to rest keeps its bits.
//!
//! ```
//! use evis_scene::builder::{Placement, SceneBuilder};
//! use evis_scene::primitive::Shape;
//! use evis_scene::{Material, RigidBody, SceneState};
//!
//! # fn main() -> Result<(), evis_scene::SceneError> {
//! let mut scene = SceneBuilder::new("drop");
//! scene.duration_s(1.0)?;
//! let grey = scene.material(Material::diffuse("grey"))?;
//! let floor = Placement::default().as_body(RigidBody::fixed());
//! scene.shape("floor", Shape::Plane { size: [2.0; 2] }, grey, floor)?;
//! let ball = Placement::at([0.0, 1.0, 0.0]).as_body(RigidBody::dropped().surface(0.5, 0.7));
//! let ball = scene.shape("ball", Shape::Sphere { radius: 0.1 }, grey, ball)?;
//! let mut scene = scene.build()?;
//! # #[cfg(feature = "rapier")]
//! # {
//! evis_physics::simulate(&mut scene)?;
//! let mut state = SceneState::default();
//! scene.evaluate(0.3, &mut state);
//! assert!((state.world_from_node[ball].w_axis.y - (1.0 - 0.5 * 9.81 * 0.3 * 0.3)).abs() < 1e-3);
//! # }
//! # Ok(())
//! # }
//! ```

#[cfg(feature = "rapier")]
mod keys;
#[cfg(feature = "rapier")]
mod simulation;

use evis_scene::source::{self, Opening};
use evis_scene::{Scene, SceneError};

/// Distance, in metres, of curves from the poses that were simulated, at most.
pub const POSITION_BOUND_M: f64 = 1e-5;

/// Angle, in degrees, of curves from the poses that were simulated, at most.
pub const ANGLE_BOUND_DEGREES: f64 = 0.01;

/// Makes motion of the rigid bodies of `scene` ([`Scene::rigid_bodies`], empty afterwards), from time 0 to the end of the
/// scene, or of the environment that is farthest ahead. Before it they are at their start, after it they rest where they
/// were. A camera that was added to frame the scene frames the motion. A scene without bodies stays as it is.
///
/// # Errors
/// A hull without volume, a node without a mesh where a hull or mesh is asked for, a spin by more than a quarter turn per
/// step, a simulation that needs more memory than is allowed, or diverges. Without the feature `rapier`: every scene
/// with bodies that move.
pub fn simulate(scene: &mut Scene) -> Result<(), SceneError> {
    #[cfg(feature = "rapier")]
    {
        if scene.rigid_bodies.iter().any(|(_, body)| body.is_dynamic()) {
            simulation::run(scene)?;
            scene.frame_again();
        }
        scene.rigid_bodies.clear();
        Ok(())
    }
    #[cfg(not(feature = "rapier"))]
    match scene.rigid_bodies.iter().find(|(_, body)| body.is_dynamic()) {
        Some((node, _)) => Err(SceneError::Rule(format!(
            "'{}' is a rigid body, and this build simulates none; build it with the feature 'physics'",
            scene.nodes.get(*node).map_or("", |node| &node.name)
        ))),
        None => Ok(()),
    }
}

/// [`evis_scene::source::load_with_animation`], and [`simulate`].
///
/// # Errors
/// As both.
pub fn load(source: &str, seed: u64, animation: Option<&str>) -> Result<Scene, SceneError> {
    let mut scene = source::load_with_animation(source, seed, animation)?;
    simulate(&mut scene)?;
    Ok(scene)
}

/// [`evis_scene::source::open`], with [`simulate`] before anything else moves.
///
/// # Errors
/// As both.
pub fn open(source: &str, opening: &Opening) -> Result<Scene, SceneError> {
    source::open_with(source, opening, simulate)
}
