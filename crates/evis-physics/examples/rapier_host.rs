//! A closed loop with a physics engine of your own: Rapier moves a ball, EVIS sees it. Every step of 10 ms takes five poses
//! from the engine, and its events are there before the next one.
//!
//! `cargo run --release --workspace --locked --example rapier_host`
//!
//! Scenes that only need bodies dropped and thrown say so in their file (`rigid_body`), without a loop.

use std::sync::Arc;

use evis_render::prelude::*;
use evis_scene::HostPose;
use rapier3d_f64::prelude as rapier;

const SCENE: &str = r#"
    background = [0.2, 0.2, 0.2]
    ambient = [1.0, 1.0, 1.0]
    textures = [{ name = "checker", pattern = "checker" }]
    materials = [{ name = "painted", texture = "checker" }]
    primitives = [
        { name = "ball", shape = "sphere", radius = 0.1, material = "painted", position = [0, 0.3, 0] },
        { name = "ground", shape = "box", size = [2, 0.1, 2], material = "painted", position = [0, -0.05, 0] },
    ]
    cameras = [{ name = "eye", size = [64, 48], position = [0, 0.3, 1.5], look_at = [0, 0.15, 0] }]
"#;

const STEP_US: i64 = 10_000;
const PHYSICS_US: i64 = 2_000;

/// Runs it.
pub fn main() -> Result<(), EngineError> {
    let mut scene = scene::toml_scene::parse(SCENE, ".")?;
    let host = scene.drive(&["ball".into()], 0)?;
    let gpu = Gpu::open(None)?;
    let config =
        RunConfig { rate_hz: 500.0, samples: 4, pose_step_us: Some(STEP_US), ..RunConfig::default() };
    let mut simulator = Simulator::new(&gpu, Arc::new(scene), config)?;

    let mut world =
        rapier::PhysicsWorld { gravity: rapier::Vector::from_array([0.0, -9.81, 0.0]), ..Default::default() };
    world.integration_parameters.dt = PHYSICS_US as f64 * 1e-6;
    let ground = rapier::RigidBodyBuilder::fixed().translation(rapier::Vector::from_array([0.0, -0.05, 0.0]));
    world.insert(ground, rapier::ColliderBuilder::cuboid(1.0, 0.05, 1.0).restitution(0.7));
    let ball = rapier::RigidBodyBuilder::dynamic()
        .translation(rapier::Vector::from_array([0.0, 0.3, 0.0]))
        .angvel(rapier::Vector::from_array([0.0, 0.0, -3.0]));
    let ball = world.insert(ball, rapier::ColliderBuilder::ball(0.1).restitution(0.7)).0;

    let index = host.names().iter().position(|name| name == "ball").unwrap_or(0);
    for step in 1..=30 {
        let poses: Vec<HostPose> = (1..=STEP_US / PHYSICS_US)
            .map(|part| {
                world.step();
                let body = &world.bodies[ball];
                HostPose::new(
                    (step - 1) * STEP_US + part * PHYSICS_US,
                    body.translation().to_array(),
                    body.rotation().to_array(),
                    None,
                )
            })
            .collect();
        let packet = simulator.step_with_poses(step * STEP_US, &[(0, index, poses)])?;
        let events = &packet.views[0].events;
        if step % 5 == 0 {
            let height = world.bodies[ball].translation().to_array()[1];
            println!("{} us: {} events, the ball is {height:.3} m high", packet.end_us, events.len());
        }
    }
    Ok(())
}
