//! No tile is skipped wrongly: on random scenes, sampling only the tiles that change gives the bytes of rendering every instant
//! everywhere.

use std::collections::HashMap;
use std::sync::Arc;

use evis_core::{Event, SensorConfig};
use evis_scene::Scene;

use crate::config::{Quality, RunConfig};
use crate::engine::simulator::Simulator;
use crate::engine::{Engine, Parts};
use crate::gpu::Gpu;
use crate::sampling::Sampling;
use crate::sampling::tile_rate::Overlook;
use crate::world::view;

use crate::tests::random_scenes::{self, LENGTH_MS, RATE_HZ};

/// Scenes that every run tries; `EVIS_SCENES=FIRST..LAST` (`make check-long`) tries others.
const SEEDS: std::ops::Range<u64> = 0..24;
/// Scenes on which every run tries the presets.
const PRESET_SEEDS: std::ops::Range<u64> = 0..4;

pub(super) fn seeds(usual: std::ops::Range<u64>) -> std::ops::Range<u64> {
    let asked = std::env::var("EVIS_SCENES").ok();
    asked.map_or(usual, |range| {
        let (first, last) = range.split_once("..").expect("EVIS_SCENES=FIRST..LAST");
        first.parse().expect("a number")..last.parse().expect("a number")
    })
}

/// How a stream is rendered.
#[derive(Clone, Copy, PartialEq)]
enum Rendering {
    /// Every instant everywhere.
    Plain,
    /// What changes, `native`.
    Changes,
    /// What changes, tile by tile at its own rate, of which none is slower than all instants.
    Tiles(Option<Overlook>),
}

fn config(rendering: Rendering) -> RunConfig {
    RunConfig {
        rate_hz: RATE_HZ,
        samples: 2,
        // So fine a step samples whatever moves at every instant.
        adaptive_px: matches!(rendering, Rendering::Tiles(_)).then_some(f64::MIN_POSITIVE),
        // A change of light by 1 % fires.
        sensor: SensorConfig { threshold_on: 0.01, threshold_off: 0.01, ..SensorConfig::default() },
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

/// The events of each view, and the pixels that were drawn.
fn run(gpu: &Gpu, scene: &Arc<Scene>, rendering: Rendering) -> (Vec<Vec<Event>>, u64) {
    let mut config = config(rendering);
    let (views, _) = view::views(scene, &config).unwrap();
    let mut events = vec![Vec::new(); views.len()];
    let mut engine = Engine::new(gpu, scene.clone(), views, &mut config).unwrap();
    let Parts { context, sampling, .. } = engine.parts();
    context.skips_still = rendering != Rendering::Plain;
    if let (Sampling::Adaptive(sampler), Rendering::Tiles(overlooks)) = (sampling, rendering) {
        sampler.estimator().overlooks = overlooks;
    }
    let mut drawn = 0;
    for until_us in [7, 31, LENGTH_MS].map(|ms| i64::from(ms) * 1000) {
        let packet = engine.deliver(until_us, until_us).unwrap();
        drawn += packet.report.drawn_pixels;
        events.iter_mut().zip(packet.views).for_each(|(all, view)| all.extend(view.events));
    }
    (events, drawn)
}

#[test]
fn audits_find_what_was_skipped_wrongly_and_change_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let report = |scene: &Arc<Scene>, audit: f64, overlooks: Option<Overlook>| {
        let mut config = RunConfig { audit, ..config(Rendering::Tiles(None)) };
        // Samples are at the finest rate of whatever changes: what audits find is skipped.
        config.sensor = SensorConfig::default();
        let (views, _) = view::views(scene, &config).unwrap();
        let mut engine = Engine::new(&gpu, scene.clone(), views, &mut config).unwrap();
        if let Sampling::Adaptive(sampler) = engine.parts().sampling {
            sampler.estimator().overlooks = overlooks;
        }
        let packet = engine.deliver(48_000, 48_000).unwrap();
        let events: Vec<Vec<Event>> = packet.views.into_iter().map(|view| view.events).collect();
        (packet.report, events)
    };
    let (mut audited, mut found) = (0, 0);
    for seed in 0..12 {
        let scene = Arc::new(random_scenes::scene(seed));
        let (right, events) = report(&scene, 1.0, None);
        assert_eq!((right.changed, right.findings.len()), (0, 0), "seed {seed}: {:?}", right.findings);
        audited += right.audited;
        let (none, unaudited) = report(&scene, 0.0, None);
        assert_eq!(none.audited, 0);
        assert!(unaudited == events && none.drawn_pixels == right.drawn_pixels, "seed {seed}");
        assert!(256 * right.audited <= right.drawn_pixels / 40, "seed {seed}: {right:?}");
        let (wrong, _) = report(&scene, 1.0, Some(Overlook::Paused));
        for finding in &wrong.findings {
            assert!(finding.skipped && finding.change > 0.1, "{finding:?}");
            assert!(finding.warning().contains("camera 'camera'"), "{}", finding.warning());
        }
        found += wrong.findings.len();
    }
    assert!(audited > 20 && found > 0, "{audited} tiles audited, {found} wrong ones found");
}

#[test]
fn random_scenes_fire_the_same_bytes_whatever_is_skipped() {
    let Some(gpu) = crate::tests::device() else { return };
    let (mut fired, mut all_pixels, mut drawn_pixels) = (0, 0, 0);
    let mut found = [0; 4];
    let canaries = [Overlook::Paused, Overlook::Vibrating, Overlook::Shadows, Overlook::Deformation];
    for seed in seeds(SEEDS) {
        let scene = Arc::new(random_scenes::scene(seed));
        let (expected, all) = run(&gpu, &scene, Rendering::Plain);
        for rendering in [Rendering::Changes, Rendering::Tiles(None)] {
            let (events, drawn) = run(&gpu, &scene, rendering);
            let name = if rendering == Rendering::Changes { "native" } else { "tiles" };
            let first = expected.iter().flatten().zip(events.iter().flatten()).find(|(a, b)| a != b);
            let counts = [&expected, &events].map(|of| of.iter().map(Vec::len).sum::<usize>());
            assert!(events == expected, "seed {seed}, {name}: {counts:?} events, {first:?}");
            if rendering != Rendering::Changes {
                drawn_pixels += drawn;
            }
        }
        fired += expected.iter().map(Vec::len).sum::<usize>();
        all_pixels += all;
        for (canary, found) in canaries.into_iter().zip(&mut found) {
            // Until it was found once.
            if *found < 1 {
                *found += usize::from(run(&gpu, &scene, Rendering::Tiles(Some(canary))).0 != expected);
            }
        }
    }
    assert!(fired > 10_000, "{fired} events");
    assert!(drawn_pixels < all_pixels, "{drawn_pixels} of {all_pixels} pixels were drawn");
    assert!(found.iter().all(|found| *found > 0), "canaries were found {found:?} times");
}

/// F1 of two lists of events: one to one in order, per pixel and polarity, within 1 ms.
fn matched(a: &[Event], b: &[Event]) -> usize {
    let by_pixel = |events: &[Event]| {
        let mut of: HashMap<(u16, u16, i16), Vec<i64>> = HashMap::new();
        for e in events {
            of.entry((e.x, e.y, e.p)).or_default().push(e.t);
        }
        of
    };
    let (a, b) = (by_pixel(a), by_pixel(b));
    let mut count = 0;
    for (key, times) in &a {
        let (mut i, mut j) = (0, 0);
        let others = b.get(key).map_or(&[][..], Vec::as_slice);
        while i < times.len() && j < others.len() {
            match times[i] - others[j] {
                -1000..=1000 => (count, i, j) = (count + 1, i + 1, j + 1),
                ..-1000 => i += 1,
                _ => j += 1,
            }
        }
    }
    count
}

#[test]
fn presets_agree_with_every_instant_rendered_everywhere_on_random_scenes() {
    let Some(gpu) = crate::tests::device() else { return };
    // The expensive presets run one scene.
    for (quality, least, most) in [
        (Quality::Draft, 0.80, usize::MAX),
        (Quality::Standard, 0.92, usize::MAX),
        (Quality::High, 0.95, 1),
        (Quality::Reference, 0.95, 1),
    ] {
        let (mut both, mut all) = (0, 0);
        for seed in seeds(PRESET_SEEDS).take(most) {
            let scene = Arc::new(random_scenes::scene(seed));
            let mut config =
                RunConfig { quality: Some(quality), reference_luminance: Some(0.5), ..RunConfig::default() };
            // By rendering: decoupled sampling has tests of its own.
            quality.sampling().rendered().apply(Some(&gpu), &scene, &mut config).unwrap();
            let fired = |every_instant: bool| {
                let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
                simulator.restart(0, Vec::new(), every_instant).unwrap();
                let packet = simulator.step(i64::from(LENGTH_MS) * 1000).unwrap();
                packet.views.into_iter().map(|view| view.events).collect::<Vec<_>>()
            };
            let (own, every) = (fired(false), fired(true));
            for (own, every) in own.iter().zip(&every) {
                both += 2 * matched(own, every);
                all += own.len() + every.len();
            }
        }
        let f1 = both as f64 / all.max(1) as f64;
        eprintln!("{}: F1 (1 ms) {f1:.4} of {} events", quality.name(), all / 2);
        assert!(all > 2_000 && f1 >= least, "{}: F1 {f1} of {} events", quality.name(), all / 2);
    }
}
