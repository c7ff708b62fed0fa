//! Streams of built-in scenes in adaptive time.

use std::sync::Arc;

use evis_core::Event;
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::engine::Engine;
use crate::gpu::Gpu;
use crate::sampling::Sampling;
use crate::world::view;

/// A built-in one.
pub(super) fn scene(name: &str) -> Arc<Scene> {
    Arc::new(evis_scene::builtin::load(name, 0).unwrap())
}

/// What would deliver the stream.
pub(super) fn engine(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig) -> Engine {
    let mut config = config.clone();
    let (views, _) = view::views(scene, &config).unwrap();
    Engine::new(gpu, scene.clone(), views, &mut config).unwrap()
}

/// Gives every tile one rate, whatever moves.
pub(super) fn force(engine: &mut Engine, log2_stride: u8) {
    let Sampling::Adaptive(sampler) = engine.parts().sampling else { panic!("not in adaptive time") };
    sampler.forced = Some(log2_stride);
}

/// What was delivered.
#[derive(Default)]
pub(super) struct Stream {
    /// By view.
    pub events: Vec<Vec<Event>>,
    pub drawn_pixels: u64,
    pub keyframes: u64,
}

/// 64 ms in steps of `step_us`.
pub(super) fn deliver(mut engine: Engine, step_us: i64) -> Stream {
    let mut stream = Stream::default();
    for until_us in (1..=64_000 / step_us).map(|step| step * step_us) {
        let packet = engine.deliver(until_us, until_us).unwrap();
        stream.drawn_pixels += packet.report.drawn_pixels;
        stream.keyframes += packet.report.keyframes;
        stream.events.resize(packet.views.len(), Vec::new());
        stream.events.iter_mut().zip(packet.views).for_each(|(all, view)| all.extend(view.events));
    }
    stream
}

/// 64 ms of `scene` in steps of `step_us`.
pub(super) fn run(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig, step_us: i64) -> Stream {
    deliver(engine(gpu, scene, config), step_us)
}
