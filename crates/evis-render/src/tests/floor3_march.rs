//! Floor 3: light of tiles that are followed against light that is rendered, and bytes.

use std::sync::Arc;

use evis_core::{Event, SensorConfig};
use evis_scene::Scene;

use crate::config::{Method, RunConfig};
use crate::engine::Engine;
use crate::gpu::Gpu;
use crate::method::Sampling;
use crate::view;

fn scene(name: &str) -> Arc<Scene> {
    Arc::new(evis_scene::builtin::load(name, 0).unwrap())
}

fn config(method: Method) -> RunConfig {
    RunConfig {
        size: Some((160, 120)),
        rate_hz: 1000.0,
        adaptive_px: Some(0.3),
        samples: 16,
        reference_luminance: Some(1.0),
        method,
        ..Default::default()
    }
}

fn engine(gpu: &Gpu, scene: &Arc<Scene>, config: &RunConfig) -> Engine {
    let mut config = config.clone();
    let (views, _) = view::views(scene, &config).unwrap();
    Engine::new(gpu, scene.clone(), views, &mut config).unwrap()
}

/// 64 ms of `scene` in steps of `step_us`: the events of each view, and the pixels drawn.
fn run(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    config: &RunConfig,
    step_us: i64,
    buffers: Option<(u32, u32)>,
) -> (Vec<Vec<Event>>, u64) {
    let mut engine = engine(gpu, scene, config);
    if let Some((capacity, most)) = buffers {
        engine.limit_buffers(capacity, most);
    }
    let (mut events, mut drawn) = (Vec::new(), 0);
    for until_us in (1..=64_000 / step_us).map(|step| step * step_us) {
        let packet = engine.deliver(until_us, until_us).unwrap();
        drawn += packet.report.drawn_pixels;
        events.resize(packet.views.len(), Vec::new());
        events.iter_mut().zip(packet.views).for_each(|(all, view)| all.extend(view.events));
    }
    (events, drawn)
}

#[test]
fn light_that_is_followed_is_the_light_that_would_be_rendered() {
    let Some(gpu) = super::device() else { return };
    for (name, least) in [("spinner", 0.5), ("street", 0.15), ("warehouse", 0.05)] {
        let scene = scene(name);
        // The block that begins at instant 17; paces 0 and keys every 8 instants.
        let at = |method: Method| {
            let mut engine = engine(&gpu, &scene, &config(method));
            if let Sampling::Adaptive(room) = engine.parts().1 {
                room.forced = Some(0);
            }
            let light = engine.instants(17, 16).unwrap();
            let Sampling::Adaptive(room) = engine.parts().1 else { panic!("not in adaptive time") };
            (light, room.followed())
        };
        let ((rendered, _), (followed, told)) = (at(Method::Native), at(Method::March));
        let of_all = told[0] as f64 / (2.0 * 4.0 * 80.0);
        assert!(of_all > least && of_all < 1.0, "{name}: {of_all:.3} of quarters followed, {told:?}");
        let apart = |a: &[f32], b: &[f32]| {
            let mut all: Vec<f64> =
                a.iter().zip(b).map(|(a, b)| (f64::from(*a) / f64::from(*b)).ln().abs()).collect();
            all.sort_by(f64::total_cmp);
            [0.5, 0.99].map(|part| all[(part * all.len() as f64) as usize])
        };
        // Between the keys at numbers 0, 8 and 16.
        for (k, number) in [(3, 4), (11, 12)] {
            let [median, most] = apart(&followed[k], &rendered[k]);
            assert!(median < 0.004 && most < 0.05, "{name} {number}: {median:.5}, {most:.4}");
        }
        // Keys are rendered, not followed.
        assert!(followed[7] == rendered[7] && followed[15] == rendered[15], "{name}");
        let [far, _] = apart(&followed[3], &rendered[7]);
        assert!(far > 0.002, "{name}: canary {far:.5}");
    }
}

#[test]
fn packets_reruns_and_neighbours_change_no_byte() {
    let Some(gpu) = super::device() else { return };
    let variant = |time_offset_s| evis_scene::Variant { time_offset_s, ..Default::default() };
    for (name, preset) in [("spinner", "evis"), ("street", "ideal")] {
        let alone = scene(name);
        let sensor = SensorConfig::preset(preset).unwrap();
        let config = RunConfig { samples: 4, sensor, ..config(Method::March) };
        let (expected, drawn) = run(&gpu, &alone, &config, 64_000, None);
        let (_, all) =
            run(&gpu, &alone, &RunConfig { method: Method::Native, ..config.clone() }, 64_000, None);
        assert!(expected[0].len() > 100, "{name}");
        // In a picture as small as this, `street` is all edges.
        assert!(name == "street" || drawn < all, "{name}: {drawn} of {all} pixels");
        for (step_us, buffers) in [(4_000, None), (1_000, None), (64_000, Some((16, 1 << 20)))] {
            let (events, _) = run(&gpu, &alone, &config, step_us, buffers);
            assert!(events == expected, "{name}: steps of {step_us} us, {buffers:?}");
        }
        if preset != "ideal" {
            // Environments have noise of their own.
            continue;
        }
        let mut many = Scene::clone(&alone);
        many.variants = vec![variant(0.02), variant(0.0), variant(0.05)];
        let (events, _) = run(&gpu, &Arc::new(many), &config, 64_000, None);
        assert!(events[1] == expected[0], "{name}: neighbours");
        assert!(events[0] != expected[0] && events[2] != expected[0], "{name}: canary");
    }
}

#[test]
fn what_does_not_change_is_never_felt() {
    let Some(gpu) = super::device() else { return };
    // One moving thing before a still camera: where nothing comes by, nothing fires, keys or not.
    let desk = scene("desk");
    let fires = |method: Method| {
        let (events, _) = run(&gpu, &desk, &config(method), 64_000, None);
        let mut pixels: Vec<(u16, u16)> = events[0].iter().map(|e| (e.x, e.y)).collect();
        pixels.sort_unstable();
        pixels.dedup();
        pixels
    };
    let (rendered, followed) = (fires(Method::Native), fires(Method::March));
    let more = followed.iter().filter(|pixel| rendered.binary_search(pixel).is_err()).count();
    assert!(more * 50 <= rendered.len(), "{more} pixels more than {}", rendered.len());
}

#[test]
fn settings_that_cannot_be_are_named() {
    let refused = |config: RunConfig| config.check().unwrap_err().to_string();
    let text = refused(RunConfig { samples: 128, ..config(Method::March) });
    assert!(text.contains("samples is 128") && text.contains("64 at most, for march"), "{text}");
    let text = refused(RunConfig { adaptive_px: None, ..config(Method::March) });
    assert!(text.contains("for march"), "{text}");
}
