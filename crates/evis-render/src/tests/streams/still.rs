//! Drawing only what changes gives the bytes of drawing everything.

use std::sync::Arc;

use evis_core::Event;
use evis_scene::{Scene, Variant};

use crate::config::RunConfig;

use crate::config::Shadows;
use crate::engine::Engine;
use crate::frame::changes::Change;
use crate::gpu::Gpu;
use crate::world::view;

/// How a test lets the engine draw.
#[derive(Clone, Copy, PartialEq)]
enum Drawing {
    All,
    Changes,
    /// A canary.
    ChangesWithoutShadows,
}

/// The events of each view, and how many steps' last instants were drawn whole, in part, and not at all.
fn run(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    drawing: Drawing,
    step_us: i64,
) -> (Vec<Vec<Event>>, [i64; 3]) {
    let mut config = config.clone();
    let (views, _) = view::views(scene, &config).unwrap();
    let mut events = vec![Vec::new(); views.len()];
    let mut engine = Engine::new(gpu, scene.clone(), views, &mut config).unwrap();
    let context = engine.parts().context;
    context.skips_still = drawing != Drawing::All;
    context.frame_data.watch.overlooks_shadows = drawing == Drawing::ChangesWithoutShadows;
    let mut counts = [0; 3];
    // Each step is a submission of its own, or several.
    for until_us in (1..=60_000 / step_us).map(|step| step * step_us) {
        let packet = engine.deliver(until_us, until_us).unwrap();
        events.iter_mut().zip(packet.views).for_each(|(all, view)| all.extend(view.events));
        // Of the step's last submission: how long those are depends on how busy the machine is.
        counts[match engine.parts().context.frame_data.changes.last() {
            None | Some(Change::All) => 0,
            Some(Change::Parts(_)) => 1,
            Some(Change::Nothing) => 2,
        }] += 1;
    }
    (events, counts)
}

fn desk(change: impl FnOnce(&mut Scene)) -> Arc<Scene> {
    let mut scene = evis_scene::builtin::load("desk", 0).unwrap();
    change(&mut scene);
    Arc::new(scene)
}

fn config() -> RunConfig {
    let reference_luminance = Some(1.0);
    RunConfig { size: Some((96, 72)), rate_hz: 1000.0, samples: 2, reference_luminance, ..Default::default() }
}

#[test]
fn what_is_still_is_not_drawn_again_and_no_byte_differs() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = desk(|_| ());
    for shadows in [Shadows::Maps, Shadows::Rays] {
        let config = RunConfig { shadows: Some(shadows), ..config() };
        let (expected, _) = run(&gpu, &scene, &config, Drawing::All, 4_000);
        assert!(expected[0].len() > 100);
        // Submissions of other lengths, of one instant too: what is kept comes from the one before.
        for step_us in [4_000, 10_000, 1_000] {
            let (events, [whole, parts, _]) = run(&gpu, &scene, &config, Drawing::Changes, step_us);
            assert!(events == expected, "{shadows:?}, steps of {step_us} us");
            assert!(
                whole <= 1 && parts >= 60_000 / step_us - 1,
                "{shadows:?}, steps of {step_us} us: {whole} whole, {parts} in part"
            );
        }
        let (events, _) = run(&gpu, &scene, &config, Drawing::ChangesWithoutShadows, 4_000);
        assert!(events != expected, "{shadows:?}: canary: the toy's shadow moves");
    }
}

#[test]
fn views_of_a_batch_are_still_each_for_itself() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = desk(|scene| {
        let variant = |time_offset_s| Variant { time_offset_s, ..Default::default() };
        scene.variants = vec![variant(0.0), variant(1.3)];
    });
    let (expected, _) = run(&gpu, &scene, &config(), Drawing::All, 6_000);
    let (events, [whole, parts, _]) = run(&gpu, &scene, &config(), Drawing::Changes, 6_000);
    assert!(events == expected && expected[0] != expected[1]);
    assert!(whole == 0 && parts == 10, "{whole} whole, {parts} in part");
}

#[test]
fn nothing_moves_and_nothing_is_drawn() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = desk(|scene| {
        scene.nodes.iter_mut().for_each(|node| {
            node.motion = match &node.motion {
                evis_scene::Motion::Fixed(pose) => evis_scene::Motion::Fixed(*pose),
                _ => evis_scene::Motion::Fixed(glam::DMat4::IDENTITY),
            }
        })
    });
    let (events, [whole, parts, nothing]) = run(&gpu, &scene, &config(), Drawing::Changes, 6_000);
    assert!(events[0].is_empty() && whole == 0 && parts == 0 && nothing == 10, "{whole}, {parts}, {nothing}");
}

#[test]
fn a_camera_or_a_light_that_moves_has_everything_drawn() {
    let Some(gpu) = crate::tests::device() else { return };
    let flicker = desk(|scene| {
        let waveform = evis_scene::motion::Waveform {
            shape: evis_scene::motion::WaveShape::Sine,
            frequency_hz: 30.0,
            phase: 0.0,
            low: 0.5,
            high: 1.0,
        };
        scene.lights[0].waveform = Some(waveform);
    });
    let spinner = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    for scene in [flicker, spinner] {
        let (expected, _) = run(&gpu, &scene, &config(), Drawing::All, 6_000);
        let (events, [_, parts, nothing]) = run(&gpu, &scene, &config(), Drawing::Changes, 6_000);
        assert!(events == expected && expected[0].len() > 100, "{}", scene.name);
        assert_eq!((parts, nothing), (0, 0), "{}", scene.name);
    }
}
