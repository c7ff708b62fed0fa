//! A stream's events are those of one run, whatever its steps.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use evis_core::emulator::{EmulatorConfig, Frames};
use evis_core::random::Key;
use evis_core::{Event, SensorConfig};
use evis_decoupled::{Settings, Stream, StreamSettings, View, simulate};
use evis_scene::{HostJump, HostPose, HostStep, Scene, Variant};

const SIZE: Option<(u32, u32)> = Some((40, 30));

fn spinner() -> Scene {
    evis_scene::builtin::load("spinner", 0).unwrap()
}

fn view(variant: Option<usize>, threshold: f32) -> View {
    let sensor =
        SensorConfig { threshold_on: threshold, threshold_off: threshold, ..SensorConfig::default() };
    View { camera: 0, variant, sensor, key: Key::new(0, 0, 0) }
}

/// Per view: everything before `end_us`, wanted up to each of `steps`.
fn streamed(scene: Scene, views: Vec<View>, start_us: i64, steps: &[i64]) -> (f32, Vec<Vec<Event>>) {
    let settings = StreamSettings { size: SIZE, start_us, ..StreamSettings::default() };
    streamed_with(scene, views, &settings, steps)
}

fn streamed_with(
    scene: Scene,
    views: Vec<View>,
    settings: &StreamSettings,
    steps: &[i64],
) -> (f32, Vec<Vec<Event>>) {
    let mut complete = vec![0; views.len()];
    let mut events = vec![Vec::new(); views.len()];
    let mut stream = Stream::new(Arc::new(scene), views, settings).unwrap();
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
fn events_of_some_tiles_are_those_of_the_whole_picture() {
    let (width, height) = SIZE.unwrap();
    let [columns, rows] = [width, height].map(|v| (v as usize).div_ceil(8));
    let only: Vec<bool> = (0..columns * rows).map(|tile| tile % 3 == 1 && tile / columns != 2).collect();
    let views = || vec![view(None, 0.2), view(None, 0.3)];
    let settings = StreamSettings { size: SIZE, only: vec![only.clone()], ..StreamSettings::default() };
    let (_, some) = streamed_with(spinner(), views(), &settings, &[60_000]);
    let (_, all) = streamed(spinner(), views(), 0, &[60_000]);
    let own = |e: &&Event| only[usize::from(e.y) / 8 * columns + usize::from(e.x) / 8];
    let expected: Vec<Event> = all[0].iter().filter(own).copied().collect();
    assert!(some[0] == expected && expected.len() > 20 && expected.len() < all[0].len());
    assert!(some[1] == all[1], "of a view of which nothing is said, everything");
}

#[test]
fn the_cost_is_known_with_the_first_usual_block() {
    let follow = |settings: StreamSettings| {
        let views = vec![view(None, 0.2), view(None, 0.3)];
        let mut stream = Stream::new(Arc::new(spinner()), views, &settings).unwrap();
        stream.want(3_000);
        let mut complete = [0; 2];
        while complete.iter().any(|t| *t < 3_000) {
            let piece = stream.next(&AtomicBool::new(false)).unwrap().unwrap();
            complete[piece.view] = piece.complete_us;
            assert!(piece.complete_us < 3_000 || !settings.only.is_empty() || stream.cost().get().is_some());
        }
        (complete, stream.cost().get())
    };
    let settings = StreamSettings { size: SIZE, ..StreamSettings::default() };
    let (complete, cost) = follow(settings.clone());
    let cost = cost.unwrap();
    assert!(cost > 0.0 && cost.is_finite(), "{cost}");
    assert!(complete.iter().all(|t| *t > 20_000), "{complete:?}");
    let only = vec![vec![true; 2 * 30], vec![true; 2 * 30]];
    assert_eq!(
        follow(StreamSettings { only, ..settings }).1,
        None,
        "some tiles do not say what a picture takes"
    );
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
        assert!((a.t - b.t).abs() <= 100 && (a.x, a.y, a.p) == (b.x, b.y, b.p), "{a:?} {b:?}");
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
    let dull = SensorConfig { threshold_on: 0.0, ..SensorConfig::default() };
    assert!(refused(spinner(), View { sensor: dull, ..view(None, 0.2) }).contains("threshold_on"));
    assert!(refused(spinner(), View { camera: 9, ..view(None, 0.2) }).contains("camera 9"));
    let mut crowded = spinner();
    crowded.lights =
        vec![evis_scene::Light { casts_shadow: true, ..evis_scene::Light::directional("sun", 1.0) }; 9];
    assert!(refused(crowded, view(None, 0.2)).contains("native sampling"));
}

/// `spinner` with its disc left to a host, and where the disc is at times of the scene itself.
fn driven() -> (Scene, Arc<evis_scene::HostPoses>, impl Fn(i64) -> HostPose) {
    let free = spinner();
    let disc = free.nodes.iter().position(|n| !n.motion.is_fixed()).unwrap();
    let name = free.nodes[disc].name.clone();
    let mut scene = free.clone();
    let host = scene.drive(&[name], 0).unwrap();
    let pose = move |t_us: i64| {
        let mut state = evis_scene::SceneState::default();
        free.evaluate(t_us as f64 * 1e-6, &mut state);
        let (_, rotation, position) = state.world_from_node[disc].to_scale_rotation_translation();
        HostPose { t_us, position, rotation, velocity: None, angular_velocity: None }
    };
    (scene, host, pose)
}

/// Events of the driven `spinner` up to 40 ms, in steps of `step_us` with a pose at each millisecond; its pixels begin anew
/// where `restart_us` ends a step, and its disc goes on from where it is `jump_us` later.
fn stepped(step_us: i64, restart_us: Option<i64>, jump_us: i64) -> Vec<Event> {
    let (scene, host, pose) = driven();
    let settings = StreamSettings {
        size: SIZE,
        reference_luminance: Some(0.5),
        pose_step_us: 5000,
        ..Default::default()
    };
    let mut stream = Stream::new(Arc::new(scene), vec![view(Some(0), 0.2)], &settings).unwrap();
    let go_on = AtomicBool::new(false);
    let (mut events, mut complete, mut ahead_us) = (Vec::new(), 0, 0);
    for until_us in (step_us..=40_000).step_by(step_us as usize) {
        let times = (until_us - step_us + 1000..=until_us).step_by(1000);
        let poses: Vec<_> = times.map(|t_us| HostPose { t_us, ..pose(t_us + ahead_us) }).collect();
        host.advance(&HostStep { poses: &[(0, 0, poses)], ..HostStep::default() }, until_us).unwrap();
        stream.want(until_us);
        while complete < until_us {
            let piece = stream.next(&go_on).unwrap().unwrap();
            complete = piece.complete_us;
            events.extend(piece.events);
        }
        assert_eq!(complete, until_us, "a step's events are all there, and none of what is not known");
        if restart_us == Some(until_us) {
            ahead_us = jump_us;
            host.jump(&HostJump { poses: &[(0, 0, pose(until_us + ahead_us))], ..HostJump::default() })
                .unwrap();
            stream.restart(vec![(0, Key::new(0, 0, 0))]);
        }
    }
    events.sort_by_key(Event::order);
    events
}

#[test]
fn what_a_host_moves_fires_as_the_same_motion_of_the_scene() {
    let wanted = at_once(&spinner(), 0.2, 0, 40_000, 0.5);
    let found = stepped(10_000, None, 0);
    assert_eq!(found, stepped(5000, None, 0), "steps change no event");
    assert_eq!(found, stepped(20_000, None, 0));
    // Blocks have other borders.
    let near = |found: &[Event]| {
        let has =
            |e: &Event| found.iter().any(|f| (f.x, f.y, f.p) == (e.x, e.y, e.p) && (f.t - e.t).abs() < 1000);
        wanted.iter().filter(|e| has(e)).count() as f64 / found.len().max(wanted.len()) as f64
    };
    let late = stepped(10_000, Some(10_000), -3000);
    let (found, late) = (near(&found), near(&late));
    println!("{found:.3} of {} events, {late:.3} where it is 3 ms late", wanted.len());
    assert!(found > 0.9 && wanted.len() > 100, "{found}");
    assert!(late < 0.75, "canary: {late}");
}

#[test]
fn pixels_that_begin_anew_fire_nothing_of_a_jump() {
    let (whole, again) = (stepped(10_000, None, 0), stepped(10_000, Some(20_000), 100_000));
    let before = |events: &[Event]| events.iter().filter(|e| e.t < 20_000).copied().collect::<Vec<_>>();
    assert_eq!(before(&whole), before(&again));
    let soon = again.iter().filter(|e| (20_000..20_100).contains(&e.t)).count();
    let usual = whole.iter().filter(|e| (20_000..20_100).contains(&e.t)).count();
    let later = again.iter().filter(|e| e.t >= 20_100).count();
    assert!(soon <= usual + 2 && later > 10, "{soon}, {usual} without a jump; {later} later");
}

/// Noise, bandwidth, a refractory period and a bus, often enough to be seen.
fn real() -> SensorConfig {
    let mut sensor = SensorConfig::preset("dvxplorer-like").unwrap();
    sensor.noise.shot_hz = 9.0;
    sensor.noise.shot_recovery_us = 20_000.0;
    sensor.noise.leak_hz = 1.0;
    sensor
}

#[test]
fn steps_change_nothing_of_a_sensor_with_more_stages() {
    let of = |number| View { sensor: real(), key: Key::new(number, 0, 0), ..view(None, 0.2) };
    let views = || vec![of(3), of(4)];
    let (_, whole) = streamed(spinner(), views(), 20_000, &[100_000]);
    let (_, stepped) = streamed(spinner(), views(), 20_000, &[1, 7_000, 30_000, 99_999, 100_000]);
    assert_eq!(whole, stepped);
    assert!(whole[0].len() > 1000 && whole[0] != whole[1], "{} events", whole[0].len());
    // On its own a view fires the same.
    let (_, alone) = streamed(spinner(), vec![of(3)], 20_000, &[100_000]);
    assert_eq!(alone[0], whole[0]);
}

/// F1 of two recordings, whose events of a pixel and a polarity match within `within_us`.
fn f1(found: &[Event], expected: &[Event], within_us: i64) -> f64 {
    let mut free = vec![true; expected.len()];
    let mut matched = 0;
    for event in found {
        let [from, until] =
            [-within_us, within_us + 1].map(|us| expected.partition_point(|e| e.t < event.t + us));
        let fits = |index: &usize| {
            let other = &expected[*index];
            free[*index] && (other.x, other.y, other.p) == (event.x, event.y, event.p)
        };
        if let Some(index) = (from..until).find(fits) {
            free[index] = false;
            matched += 1;
        }
    }
    2.0 * f64::from(matched) / (found.len() + expected.len()) as f64
}

#[test]
fn a_stage_that_does_nothing_changes_little() {
    // An ideal pixel is followed in another way than one with a refractory period, of 1 us here.
    let settings = Settings { size: Some((80, 60)), duration_us: 60_000, ..Settings::default() };
    let mut staged = settings.clone();
    staged.sensor.refractory.period_us = 1;
    for (name, least) in [("spinner", 0.95), ("warehouse", 0.95)] {
        let scene = evis_scene::builtin::load(name, 0).unwrap();
        let [ideal, staged] = [&settings, &staged].map(|s| simulate(&scene, s).unwrap().events);
        let mut late = staged.clone();
        late.iter_mut().for_each(|e| e.t += 3000);
        let [own, canary] = [&staged, &late].map(|events| f1(events, &ideal, 1500));
        println!("{name}: {} events, {}: F1 {own:.4}, late ones {canary:.4}", staged.len(), ideal.len());
        assert!(ideal.len() > 1000 && own > least && canary < own - 0.1, "{name}: {own}, {canary}");
    }
}

#[test]
fn a_sensor_fires_what_the_emulator_makes_of_pictures() {
    let (width, height) = SIZE.unwrap();
    let duration_us = 40_000;
    let mut grainy = SensorConfig::preset("gen4-like").unwrap();
    grainy.photoreceptor.noise = 0.03;
    let mut leaky = SensorConfig::default();
    (leaky.noise.leak_hz, leaky.noise.leak_jitter) = (20.0, 0.1);
    for (name, sensor) in [("grainy", grainy), ("leaky", leaky)] {
        let key = Key::new(7, 0, 0);
        let settings = Settings {
            sensor: sensor.clone(),
            key,
            size: SIZE,
            reference_luminance: Some(0.5),
            duration_us,
            ..Settings::default()
        };
        let found = simulate(&spinner(), &settings).unwrap().events;
        let config =
            EmulatorConfig { width, height, sensor, reference_luminance: 0.5, ..EmulatorConfig::default() };
        let mut emulator = evis_core::emulator::parts::emulator(config, key).unwrap();
        let mut expected = Vec::new();
        for t_us in (0..=duration_us).step_by(500) {
            let picture = evis_decoupled::luminance(&spinner(), &settings, t_us as f64).unwrap();
            let light: Vec<f32> = picture.iter().map(|v| *v as f32).collect();
            expected.extend(emulator.push(&Frames::linear(&light), t_us).unwrap().remove(0));
        }
        expected.retain(|e| e.t < duration_us);
        // A picture's means of textures are not those of tiles to the last part: slow light takes milliseconds to make up.
        let f1 = f1(&found, &expected, 2000);
        println!("{name}: {} events, {} expected, F1 {f1:.4}", found.len(), expected.len());
        assert!(found.len() > 400 && f1 > 0.96, "{name}: {f1}");
    }
}

#[test]
fn what_stands_still_fires_the_noise_of_the_emulator() {
    let mut scene = spinner();
    scene.nodes.iter_mut().for_each(|node| node.motion = evis_scene::Motion::Fixed(glam::DMat4::IDENTITY));
    let (width, height) = SIZE.unwrap();
    let (key, duration_us) = (Key::new(9, 0, 0), 150_000);
    // A ramp's times are rounded where blocks meet.
    let mut sensor = real();
    sensor.noise.leak_hz = 0.0;
    let reference_luminance = Some(0.5);
    let settings = Settings {
        sensor: sensor.clone(),
        key,
        size: SIZE,
        reference_luminance,
        duration_us,
        ..Settings::default()
    };
    let found = simulate(&scene, &settings).unwrap().events;
    let config =
        EmulatorConfig { width, height, sensor, reference_luminance: 0.5, ..EmulatorConfig::default() };
    let mut emulator = evis_core::emulator::parts::emulator(config, key).unwrap();
    let picture = evis_decoupled::luminance(&scene, &settings, 0.0).unwrap();
    let light: Vec<f32> = picture.iter().map(|v| *v as f32).collect();
    emulator.push(&Frames::linear(&light), 0).unwrap();
    let mut expected = emulator.push(&Frames::linear(&light), duration_us).unwrap().remove(0);
    expected.retain(|e| e.t < duration_us);
    assert!(found == expected && found.len() > 300, "{} events, {}", found.len(), expected.len());
}
