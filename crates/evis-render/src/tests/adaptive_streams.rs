//! Streams of built-in scenes in adaptive time, and what must not change a byte of them.

use std::sync::Arc;

use evis_core::Event;
use evis_scene::{Scene, Variant};

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

/// Gives every tile one pace, whatever moves.
pub(super) fn force(engine: &mut Engine, pace: u8) {
    let Sampling::Adaptive(room) = engine.parts().sampling else { panic!("not in adaptive time") };
    room.forced = Some(pace);
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

/// Packets of any length, and buffers that prove too small, give the `expected` events.
pub(super) fn assert_packets_and_reruns_change_no_byte(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    expected: &[Vec<Event>],
) {
    for (step_us, buffers) in [(4_000, None), (1_000, None), (64_000, Some((16, 1 << 20)))] {
        let mut engine = engine(gpu, scene, config);
        if let Some((capacity, most)) = buffers {
            engine.limit_buffers(capacity, most);
        }
        let stream = deliver(engine, step_us);
        assert!(stream.events == expected, "{}: steps of {step_us} us, {buffers:?}", scene.name);
    }
}

/// An environment that is as `scene` is gives the `expected` events beside ones in which it is another time, first among them
/// and in the middle. For sensors without noise, which environments have of their own.
pub(super) fn assert_neighbours_change_no_byte(
    gpu: &Gpu,
    scene: &Scene,
    config: &RunConfig,
    expected: &[Event],
) {
    for (offsets_s, step_us) in [(&[0.0, 0.7][..], 16_000), (&[0.02, 0.0, 0.05], 64_000)] {
        let variant = |&time_offset_s| Variant { time_offset_s, ..Default::default() };
        let batch = Scene { variants: offsets_s.iter().map(variant).collect(), ..scene.clone() };
        let events = run(gpu, &Arc::new(batch), config, step_us).events;
        let same: Vec<bool> = events.iter().map(|of_view| of_view == expected).collect();
        let own: Vec<bool> = offsets_s.iter().map(|offset| *offset == 0.0).collect();
        assert_eq!(same, own, "{}: beside {offsets_s:?}, and the canary", scene.name);
    }
}
