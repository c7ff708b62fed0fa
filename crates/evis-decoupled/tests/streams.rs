//! A stream's events are those of one run, whatever its steps.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use evis_core::sensor::TriggerRule;
use evis_core::{Event, SensorConfig};
use evis_decoupled::{Settings, Stream, StreamSettings, View, simulate};
use evis_scene::{Scene, Variant};

const SIZE: Option<(u32, u32)> = Some((40, 30));

fn spinner() -> Scene {
    evis_scene::builtin::load("spinner", 0).unwrap()
}

fn view(variant: Option<usize>, threshold: f32) -> View {
    let sensor =
        SensorConfig { threshold_on: threshold, threshold_off: threshold, ..SensorConfig::default() };
    View { camera: 0, variant, sensor }
}

/// Per view: everything before `end_us`, wanted up to each of `steps`.
fn streamed(scene: Scene, views: Vec<View>, start_us: i64, steps: &[i64]) -> (f32, Vec<Vec<Event>>) {
    let settings = StreamSettings { size: SIZE, start_us, ..StreamSettings::default() };
    let mut complete = vec![0; views.len()];
    let mut events = vec![Vec::new(); views.len()];
    let mut stream = Stream::new(Arc::new(scene), views, &settings).unwrap();
    let go_on = AtomicBool::new(false);
    for until_us in steps {
        stream.want(*until_us);
        while complete.iter().any(|t| t < until_us) {
            let piece = stream.next(&go_on).unwrap().unwrap();
            assert!(piece.complete_us > complete[piece.view]);
            complete[piece.view] = piece.complete_us;
            events[piece.view].extend(piece.events);
        }
    }
    let end_us = steps.last().copied().unwrap();
    for of in &mut events {
        of.sort_by_key(Event::order);
        of.retain(|e| e.t < end_us);
    }
    (stream.reference_luminance(), events)
}

fn at_once(scene: &Scene, threshold: f32, start_us: i64, duration_us: i64, reference: f32) -> Vec<Event> {
    let sensor = view(None, threshold).sensor;
    let reference_luminance = Some(f64::from(reference));
    let settings =
        Settings { sensor, size: SIZE, start_us, duration_us, reference_luminance, ..Settings::default() };
    simulate(scene, &settings).unwrap().events
}

#[test]
fn steps_and_neighbours_change_no_event() {
    for start_us in [0, 50_001] {
        let (reference, whole) = streamed(spinner(), vec![view(None, 0.2)], start_us, &[100_000]);
        let wanted = at_once(&spinner(), 0.2, start_us, 100_000, reference);
        assert!(wanted.len() > 100, "{}", wanted.len());
        assert_eq!(whole[0], wanted);
        let views = vec![view(None, 0.2), view(None, 0.3)];
        let (_, steps) = streamed(spinner(), views, start_us, &[1, 999, 40_000, 41_000, 100_000]);
        assert_eq!(steps[0], wanted);
        assert_eq!(steps[1], at_once(&spinner(), 0.3, start_us, 100_000, reference));
        assert_ne!(steps[1], wanted, "canary: another threshold fires otherwise");
    }
}

#[test]
fn environments_run_on_their_own_clocks() {
    let mut scene = spinner();
    scene.variants = vec![Variant::default(), Variant { time_offset_s: 0.032_768, ..Variant::default() }];
    let (reference, events) = streamed(scene, vec![view(Some(0), 0.2), view(Some(1), 0.2)], 0, &[65_536]);
    assert_eq!(events[0], at_once(&spinner(), 0.2, 0, 65_536, reference));
    // A block's length ahead: the events of the scene a block later, but for rounding, which may halve an interval more.
    let later = at_once(&spinner(), 0.2, 32_768, 65_536, reference);
    let differ = events[1].iter().zip(&later).filter(|(a, b)| a != b).count();
    assert!(differ * 20 <= later.len() && events[1].len() == later.len(), "{differ} of {}", later.len());
    let by_pixel = |events: &[Event]| {
        let mut events = events.to_vec();
        events.sort_by_key(|e| (e.y, e.x, e.t));
        events
    };
    for (a, b) in by_pixel(&events[1]).iter().zip(&by_pixel(&later)) {
        assert!((a.t - b.t).abs() <= 50 && (a.x, a.y, a.p) == (b.x, b.y, b.p), "{a:?} {b:?}");
    }
    assert_ne!(events[0], events[1]);
}

#[test]
fn a_reader_that_stops_misses_nothing_and_one_that_goes_ends_the_thread() {
    let settings = StreamSettings { size: SIZE, reference_luminance: Some(0.5), ..StreamSettings::default() };
    let mut stream = Stream::new(Arc::new(spinner()), vec![view(None, 0.2)], &settings).unwrap();
    // Nothing was requested: nothing comes, and waiting ends.
    assert!(stream.next(&AtomicBool::new(true)).unwrap().is_none());
    stream.want(1);
    let piece = stream.next(&AtomicBool::new(false)).unwrap().unwrap();
    let end_us = piece.complete_us;
    assert_eq!(piece.events, at_once(&spinner(), 0.2, 0, end_us, 0.5));
    stream.want(3_600_000_000);
    drop(stream);
}

#[test]
fn what_cannot_be_used_is_refused() {
    let settings = StreamSettings { size: SIZE, ..StreamSettings::default() };
    let refused = |scene: Scene, view: View| match Stream::new(Arc::new(scene), vec![view], &settings) {
        Ok(_) => panic!("nothing is refused"),
        Err(error) => error.to_string(),
    };
    let latch = SensorConfig { trigger: TriggerRule::Latch, ..SensorConfig::default() };
    assert!(refused(spinner(), View { sensor: latch, ..view(None, 0.2) }).contains("latch"));
    let mut slow = SensorConfig::default();
    slow.photoreceptor.cutoff_hz = 100.0;
    assert!(refused(spinner(), View { sensor: slow, ..view(None, 0.2) }).contains("decoupled"));
    assert!(refused(spinner(), View { camera: 9, ..view(None, 0.2) }).contains("camera 9"));
    let mut masked = spinner();
    masked.materials.iter_mut().for_each(|m| m.alpha = evis_scene::AlphaMode::Mask(0.5));
    assert!(refused(masked, view(None, 0.2)).contains("native sampling"));
}
