//! Frames with depth and motion: what the light between them is, against patterns whose light is known at any time.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_core::emulator::Cut;
use evis_core::{
    EmulatorConfig, Event, EventEmulator, FrameData, Frames, Keyframes, SensorConfig, Transfer, Warp,
};

const WIDTH: usize = 96;
const HEIGHT: usize = 40;
const PIXELS: usize = WIDTH * HEIGHT;
const GAP_US: i64 = 10_000;

/// A picture of one time.
#[derive(Clone)]
struct Picture {
    light: Vec<f32>,
    depth: Vec<f32>,
    motion: Vec<f32>,
}

impl Picture {
    fn new(at: impl Fn(f64, f64) -> (f64, f32, [f32; 2])) -> Self {
        let mut out = Self { light: Vec::new(), depth: Vec::new(), motion: Vec::new() };
        for i in 0..PIXELS {
            let (light, depth, motion) = at((i % WIDTH) as f64 + 0.5, (i / WIDTH) as f64 + 0.5);
            out.light.push(light as f32);
            out.depth.push(depth);
            out.motion.extend(motion);
        }
        out
    }

    fn keyframes(&self) -> Keyframes<'_> {
        Keyframes {
            light: FrameData::Linear(&self.light),
            channels: 1,
            depth: &self.depth,
            motion: &self.motion,
            motion_steps: None,
            motion_forward: None,
            cut: &[],
        }
    }
}

fn wave(u: f64, v: f64) -> f64 {
    0.5 + 0.2 * (u / 2.9).sin() + 0.2 * (v / 3.7 + 0.3 * u).cos()
}

/// A wall that slides by `speed` pixels per gap, at time `t` in gaps.
fn sliding(speed: [f64; 2], t: f64) -> Picture {
    Picture::new(|x, y| (wave(x - speed[0] * t, y - speed[1] * t), 3.0, [-speed[0] as f32, -speed[1] as f32]))
}

fn emulator(threads: usize, batch: usize) -> EventEmulator {
    let (width, height) = (WIDTH as u32, HEIGHT as u32);
    EventEmulator::new(EmulatorConfig { width, height, threads, batch, ..Default::default() }).unwrap()
}

fn push(emulator: &mut EventEmulator, picture: &Picture, t_us: i64) -> Vec<Event> {
    emulator.push_keyframe(&picture.keyframes(), t_us, &Warp::default()).unwrap().remove(0)
}

/// Share of the events of `truth` that have one of the same pixel and polarity in `events` within `tolerance_us`; those of
/// the borders are left out.
fn found(events: &[Event], truth: &[Event], tolerance_us: i64, border: u16) -> f64 {
    let inner = |event: &&Event| {
        let (x, y) = (event.x, event.y);
        x >= border && y >= border && x + border < WIDTH as u16 && y + border < HEIGHT as u16
    };
    let mut by_pixel = std::collections::HashMap::<_, Vec<i64>>::new();
    for event in events {
        by_pixel.entry((event.x, event.y, event.p)).or_default().push(event.t);
    }
    let (mut all, mut hits) = (0, 0);
    for event in truth.iter().filter(inner) {
        all += 1;
        if let Some(times) = by_pixel.get_mut(&(event.x, event.y, event.p))
            && let Some(at) = times.iter().position(|t| (t - event.t).abs() <= tolerance_us)
        {
            times.remove(at);
            hits += 1;
        }
    }
    assert!(all > 200, "{all} events are too few to tell");
    f64::from(hits) / f64::from(all)
}

/// Events of `of` at a hundred times the rate of keyframes.
fn truth(of: impl Fn(f64) -> Picture, gaps: i64) -> Vec<Event> {
    let mut emulator = emulator(1, 1);
    let mut events = Vec::new();
    for k in 0..=gaps * 100 {
        let light = of(k as f64 / 100.0).light;
        events.extend(emulator.push(&Frames::linear(&light), k * GAP_US / 100).unwrap().remove(0));
    }
    events
}

#[test]
fn integers_are_light_under_their_curve() {
    let (mut codes, mut floats, mut other) = (emulator(1, 1), emulator(1, 1), emulator(2, 1));
    let mut count = 0;
    for k in 0..4 {
        let picture = sliding([3.0, 0.0], f64::from(k));
        let integers: Vec<u16> =
            picture.light.iter().map(|light| (light.min(1.0) * 65_535.0) as u16).collect();
        let light =
            integers.iter().map(|code| Transfer::Rec709.light(f64::from(*code) / 65_535.0) as f32).collect();
        let warp = Warp::default();
        let t_us = i64::from(k) * GAP_US;
        let push = |emulator: &mut EventEmulator, transfer| {
            let keyframes = Keyframes { light: FrameData::U16(&integers, transfer), ..picture.keyframes() };
            emulator.push_keyframe(&keyframes, t_us, &warp).unwrap().remove(0)
        };
        let got = push(&mut codes, Transfer::Rec709);
        let wrong = push(&mut other, Transfer::Linear);
        let linear = Picture { light, depth: picture.depth.clone(), motion: picture.motion.clone() };
        let expected = floats.push_keyframe(&linear.keyframes(), t_us, &warp).unwrap().remove(0);
        assert!(got == expected && (k == 0 || wrong != expected), "canary: another curve is other light");
        count += got.len();
    }
    assert!(count > 500, "{count}");
}

#[test]
fn light_of_pushed_keyframes_has_no_limit() {
    // A lamp slides over a dark wall, by both warps.
    let wall = |lamp: f64, k: i64| {
        Picture::new(move |x, _| {
            let left = 30.0 + 6.0 * k as f64;
            if x > left && x < left + 20.0 { (lamp, 1.0, [-6.0, 0.0]) } else { (0.1, 3.0, [0.0; 2]) }
        })
    };
    let most = |lamp: f64, warp: &Warp| {
        let mut emulator = emulator(1, 1);
        let mut count = vec![0_u32; PIXELS];
        for k in 0..2 {
            let picture = wall(lamp, k);
            for event in emulator.push_keyframe(&picture.keyframes(), k * GAP_US, warp).unwrap().remove(0) {
                count[usize::from(event.y) * WIDTH + usize::from(event.x)] += u32::from(event.p == 1);
            }
        }
        count.into_iter().max().unwrap()
    };
    let sensor = SensorConfig::default();
    for warp in [Warp::default(), Warp { variant: evis_core::WarpVariant::EvisPaper, ..Warp::default() }] {
        for lamp in [10.0, 1e6, 1e12, 1e30] {
            let eps = f64::from(sensor.log_eps);
            let ladder = ((lamp + eps) / (0.1 + eps)).ln() / f64::from(sensor.threshold_on);
            let fired = f64::from(most(lamp, &warp));
            assert!(
                (fired - ladder).abs() <= 1.0,
                "{warp:?}: lamp {lamp}: {fired} events, {ladder} thresholds"
            );
        }
    }
}

#[test]
fn a_sliding_wall_fires_as_if_it_were_seen_all_the_time() {
    for speed in [[4.0, 0.0], [-2.6, 1.7], [0.0, -6.3]] {
        let truth = truth(|t| sliding(speed, t), 4);
        let run = |sign: f64| {
            let mut emulator = emulator(1, 1);
            let mut events = Vec::new();
            for k in 0..=4 {
                let light = sliding(speed, k as f64).light;
                let motion = sliding(speed.map(|v| v * sign), 0.0).motion;
                let picture = Picture { light, depth: vec![3.0; PIXELS], motion };
                events.extend(push(&mut emulator, &picture, k * GAP_US));
            }
            (events, emulator.keyframe_reports()[0])
        };
        let (events, report) = run(1.0);
        let share = found(&events, &truth, 300, 8);
        assert!(share > 0.95, "{speed:?}: {share}");
        assert!(report.steps >= 4 && report.cut == Cut::None, "{report:?}");
        // Canary: vectors of the other sign find far fewer.
        let (events, _) = run(-1.0);
        let share = found(&events, &truth, 300, 8);
        assert!(share < 0.6, "{speed:?}: {share} by wrong vectors");
    }
}

/// A camera in a painted sphere turns to the right: pictures go left, so vectors to the last keyframe point right.
#[test]
fn a_camera_that_turns_right_sees_vectors_that_point_right() {
    let (focal, turn) = (80.0_f64, 0.04_f64);
    let seen = |t: f64| {
        Picture::new(|x, y| {
            let (u, v) = ((x - WIDTH as f64 / 2.0) / focal, (y - HEIGHT as f64 / 2.0) / focal);
            // Azimuth and height of the ray, with the camera's yaw added.
            let azimuth = u.atan() + turn * t;
            let height = v / u.hypot(1.0);
            let before = (u.atan() + turn).tan();
            let v_before = height * before.hypot(1.0);
            let motion = [(before - u) * focal, (v_before - v) * focal];
            (wave(azimuth * 90.0, height * 90.0), f32::INFINITY, motion.map(|d| d as f32))
        })
    };
    assert!(seen(0.0).motion.iter().step_by(2).all(|x| *x > 3.0));
    let truth = truth(seen, 3);
    let mut emulator = emulator(1, 1);
    let mut events = Vec::new();
    for k in 0..=3 {
        events.extend(push(&mut emulator, &seen(k as f64), k * GAP_US));
    }
    let share = found(&events, &truth, 300, 8);
    assert!(share > 0.95, "{share}");
}

#[test]
fn nothing_depends_on_threads_or_on_the_batch() {
    let sensor = SensorConfig::preset("v2e-noisy").unwrap();
    let make = |threads, batch| {
        let (width, height) = (WIDTH as u32, HEIGHT as u32);
        let sensor = sensor.clone();
        EventEmulator::new(EmulatorConfig {
            width,
            height,
            threads,
            batch,
            seed: 3,
            sensor,
            ..Default::default()
        })
        .unwrap()
    };
    let (mut one, mut many, mut both) = (make(1, 1), make(3, 1), make(2, 2));
    let mut saved: Option<Vec<u8>> = None;
    let mut count = 0;
    for k in 0..4 {
        let slow = sliding([2.5, 0.3], k as f64);
        let fast = sliding([9.0, -2.0], k as f64);
        let expected = push(&mut one, &slow, k * GAP_US);
        assert_eq!(push(&mut many, &slow, k * GAP_US), expected);
        let join = |a: &[f32], b: &[f32]| [a, b].concat();
        let joined = Picture {
            light: join(&slow.light, &fast.light),
            depth: join(&slow.depth, &fast.depth),
            motion: join(&slow.motion, &fast.motion),
        };
        let lists = both.push_keyframe(&joined.keyframes(), k * GAP_US, &Warp::default()).unwrap();
        assert_eq!(lists[0], expected);
        if k > 0 {
            let reports = both.keyframe_reports();
            assert!(reports[1].steps > reports[0].steps, "canary: the two must differ");
            assert_ne!(lists[1], lists[0]);
        }
        // Saved and restored between keyframes.
        if let Some(state) = saved.take() {
            let mut again = make(2, 1);
            again.restore(&state).unwrap();
            assert_eq!(push(&mut again, &slow, k * GAP_US), expected);
        }
        saved = Some(one.state());
        count += expected.len();
    }
    assert!(count > 2000, "{count}");
    let mut broken = one.state();
    broken.truncate(broken.len() - 5);
    assert!(make(1, 1).restore(&broken).is_err());
}

#[test]
fn a_picture_that_stands_still_stays_silent() {
    let mut emulator = emulator(2, 1);
    let still = Picture { motion: vec![0.0; 2 * PIXELS], ..sliding([0.0, 0.0], 0.0) };
    for k in 0..4 {
        let warp = Warp { steps: Some(5), ..Warp::default() };
        let events = emulator.push_keyframe(&still.keyframes(), k * GAP_US, &warp).unwrap().remove(0);
        assert!(events.is_empty());
        assert_eq!(emulator.report().unknown, 0);
    }
}

#[test]
fn what_is_no_depth_or_motion_is_counted_and_poisons_nothing() {
    let speed = [3.0, 0.0];
    let mut emulator = emulator(1, 1);
    push(&mut emulator, &sliding(speed, 0.0), 0);
    let mut bad = sliding(speed, 1.0);
    let depths = [0.0, -2.0, f32::NAN, f32::NEG_INFINITY, 1e-30, f32::MAX, f32::INFINITY];
    let motions = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e6, -1e30, 16_384.0, 16_383.0];
    for (k, at) in (0..PIXELS).step_by(5).enumerate() {
        match k % 3 {
            0 => bad.depth[at] = depths[k / 3 % depths.len()],
            1 => bad.motion[2 * at + k / 3 % 2] = motions[k / 3 % motions.len()],
            _ => bad.light[at] = f32::NAN,
        }
    }
    let events = push(&mut emulator, &bad, GAP_US);
    assert!(events.iter().all(|event| event.t > 0 && event.t <= GAP_US));
    let report = emulator.keyframe_reports()[0];
    assert!(report.bad_depth > 100 && report.bad_motion > 150 && report.unknown > 200, "{report:?}");
    // The next gaps are as if it had not happened, but for what was missed.
    let mut after = push(&mut emulator, &sliding(speed, 2.0), 2 * GAP_US);
    after.extend(push(&mut emulator, &sliding(speed, 3.0), 3 * GAP_US));
    let truth: Vec<Event> =
        truth(|t| sliding(speed, t), 3).into_iter().filter(|event| event.t > 2 * GAP_US).collect();
    let share = found(&after, &truth, 300, 8);
    assert!(share > 0.9, "{share}");
    // Nothing but bad values.
    let nothing = Picture {
        light: vec![f32::NAN; PIXELS],
        depth: vec![f32::NAN; PIXELS],
        motion: vec![f32::NAN; 2 * PIXELS],
    };
    assert!(push(&mut emulator, &nothing, 4 * GAP_US).is_empty());
    assert!(!push(&mut emulator, &sliding(speed, 5.0), 5 * GAP_US).is_empty());
}

#[test]
fn holes_keep_their_memory_and_the_paper_paints_them_black() {
    // A wall to the right has no motion vectors: nothing between keyframes is known of it.
    let mut emulator = emulator(1, 1);
    let mut paper = fresh();
    let picture = |t: f64| {
        let mut picture = sliding([2.0, 0.0], t);
        for (i, pair) in picture.motion.chunks_exact_mut(2).enumerate() {
            if i % WIDTH > 60 {
                pair.fill(f32::NAN);
                picture.depth[i] = 6.0;
            }
        }
        picture
    };
    for k in 0..2 {
        let events = push(&mut emulator, &picture(k as f64), k * GAP_US);
        let inside = |event: &&Event| event.t < GAP_US / 2 - 1 && event.x > 66;
        assert_eq!(events.iter().filter(inside).count(), 0);
        let warp = Warp::evis_paper(4);
        let events =
            paper.push_keyframe(&picture(k as f64).keyframes(), k * GAP_US, &warp).unwrap().remove(0);
        assert_eq!(events.iter().filter(inside).count() > 0, k == 1, "black must fire");
    }
    assert!(emulator.keyframe_reports()[0].unknown > 0);
    assert_eq!(paper.keyframe_reports()[0].unknown, 0);
}

fn fresh() -> EventEmulator {
    emulator(1, 1)
}

#[test]
fn cuts_do_not_warp() {
    let other = Picture { depth: vec![0.5; PIXELS], ..sliding([0.0, 2.0], 50.0) };
    // Declared: the environment restarts.
    let mut emulator = emulator(1, 2);
    let joined = |a: &Picture, b: &Picture| Picture {
        light: [&a.light[..], &b.light].concat(),
        depth: [&a.depth[..], &b.depth].concat(),
        motion: [&a.motion[..], &b.motion].concat(),
    };
    let first = sliding([3.0, 0.0], 0.0);
    let second = sliding([3.0, 0.0], 1.0);
    let warp = Warp::default();
    emulator.push_keyframe(&joined(&first, &first).keyframes(), 0, &warp).unwrap();
    let pictures = joined(&second, &other);
    let keyframes = Keyframes { cut: &[false, true], ..pictures.keyframes() };
    let lists = emulator.push_keyframe(&keyframes, GAP_US, &warp).unwrap();
    assert!(!lists[0].is_empty() && lists[1].is_empty());
    assert_eq!(emulator.keyframe_reports()[1].cut, Cut::Declared);
    // Detected: light goes straight from one to the other, as if frames were pushed.
    let mut undeclared = fresh();
    let mut plain = fresh();
    push(&mut undeclared, &first, 0);
    plain.push(&Frames::linear(&first.light), 0).unwrap();
    let events = push(&mut undeclared, &other, GAP_US);
    assert_eq!(events, plain.push(&Frames::linear(&other.light), GAP_US).unwrap().remove(0));
    let report = undeclared.keyframe_reports()[0];
    assert_eq!(report.cut, Cut::Detected);
    assert!(report.warnings()[0].contains("cut that was not declared"), "{:?}", report.warnings());
    // Canary: the next keyframe of the new scene is linked to it.
    push(&mut undeclared, &Picture { depth: vec![0.5; PIXELS], ..sliding([0.0, 2.0], 51.0) }, 2 * GAP_US);
    assert_eq!(undeclared.keyframe_reports()[0].cut, Cut::None);
}

#[test]
fn resets_and_plain_frames_break_the_chain_of_keyframes() {
    let mut emulator = emulator(1, 1);
    push(&mut emulator, &sliding([3.0, 0.0], 0.0), 0);
    emulator.reset(Some(&[0])).unwrap();
    assert!(push(&mut emulator, &sliding([3.0, 0.0], 7.0), GAP_US).is_empty());
    assert_eq!(emulator.keyframe_reports()[0].cut, Cut::Start);
    let light = sliding([3.0, 0.0], 8.0).light;
    emulator.push(&Frames::linear(&light), 2 * GAP_US).unwrap();
    assert!(emulator.keyframe_reports().is_empty());
    push(&mut emulator, &sliding([3.0, 0.0], 9.0), 3 * GAP_US);
    assert_eq!((emulator.keyframe_reports()[0].cut, emulator.keyframe_reports()[0].steps), (Cut::Start, 1));
    push(&mut emulator, &sliding([3.0, 0.0], 10.0), 4 * GAP_US);
    assert_eq!(emulator.keyframe_reports()[0].cut, Cut::None);
}

#[test]
fn bad_pushes_are_named_and_change_nothing() {
    let good = sliding([3.0, 0.0], 0.0);
    let mut emulator = emulator(1, 1);
    push(&mut emulator, &good, 10);
    let state = emulator.state();
    let short = &good.depth[1..];
    let keyframes = good.keyframes();
    let codes = vec![1_u8; PIXELS];
    let negative: Vec<f32> = good.light.iter().map(|light| light - 2.0).collect();
    let warp = Warp::default();
    let cases = [
        (keyframes, 10, warp, "t_us"),
        (keyframes, 9, warp, "t_us"),
        (Keyframes { depth: short, ..keyframes }, 20, warp, "number of depths"),
        (Keyframes { motion: short, ..keyframes }, 20, warp, "number of values of motion"),
        (Keyframes { motion: &[], ..keyframes }, 20, warp, "number of values of motion is 0"),
        (
            Keyframes { motion_steps: Some(&[]), ..keyframes },
            20,
            warp,
            "values of motion_steps is 0; it must",
        ),
        (Keyframes { motion_steps: Some(short), ..keyframes }, 20, warp, "number of values of motion_steps"),
        (Keyframes { motion_forward: Some(short), ..keyframes }, 20, warp, "motion_forward"),
        (Keyframes { light: FrameData::Linear(short), ..keyframes }, 20, warp, "number of values"),
        (Keyframes { channels: 2, ..keyframes }, 20, warp, "channels"),
        (Keyframes { light: FrameData::Linear(&negative), ..keyframes }, 20, warp, "light of pixel (0, 0)"),
        (Keyframes { light: FrameData::Log(&good.light), ..keyframes }, 20, warp, "logarithms"),
        (
            Keyframes { light: FrameData::U8(&[1, 2], Transfer::Srgb), ..keyframes },
            20,
            warp,
            "number of values",
        ),
        (Keyframes { light: FrameData::U8(&codes, Transfer::Gamma(0.0)), ..keyframes }, 20, warp, "gamma"),
        (Keyframes { cut: &[false, false], ..keyframes }, 20, warp, "number of cuts"),
        (keyframes, 20, Warp { steps: Some(0), ..warp }, "steps"),
        (keyframes, 20, Warp { step_px: Some(f32::NAN), ..warp }, "step_px"),
        (keyframes, 20, Warp { margin: Some(4), ..warp }, "number of values"),
        (keyframes, 20, Warp { margin: Some(513), ..warp }, "margin"),
        (keyframes, 20, warp.at(30.0, 8), "keyframe_hz is 30"),
    ];
    for (keyframes, t_us, warp, said) in cases {
        let error = emulator.push_keyframe(&keyframes, t_us, &warp).unwrap_err().to_string();
        assert!(error.contains(said), "{said}: {error}");
        assert_eq!(emulator.state(), state);
    }
    push(&mut emulator, &good, 20);
}

#[test]
fn a_margin_is_seen_before_it_comes_in() {
    // The wall slides to the right by 6 pixels: what comes in from the left is known with a margin only.
    const MARGIN: usize = 8;
    let (width, height) = (WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN);
    let config = EmulatorConfig { width: width as u32, height: height as u32, ..Default::default() };
    let mut emulator = EventEmulator::new(config).unwrap();
    let warp = Warp { margin: Some(MARGIN as u32), ..Default::default() };
    let mut events = Vec::new();
    for k in 0..4 {
        let picture = sliding([6.0, 0.0], k as f64);
        events.extend(emulator.push_keyframe(&picture.keyframes(), k * GAP_US, &warp).unwrap().remove(0));
        assert_eq!(emulator.report().unknown, 0);
    }
    let shifted: Vec<Event> = truth(|t| sliding([6.0, 0.0], t), 3);
    let mut moved = events;
    for event in &mut moved {
        event.x += MARGIN as u16;
        event.y += MARGIN as u16;
    }
    let share = found(&moved, &shifted, 300, MARGIN as u16);
    assert!(share > 0.95, "{share}");
    let small = Warp { margin: Some(0), ..warp };
    let crop = vec![0.5; width * height];
    let keyframes = Keyframes {
        light: FrameData::Linear(&crop),
        channels: 1,
        depth: &crop,
        motion: &vec![0.0; 2 * crop.len()],
        motion_steps: None,
        motion_forward: None,
        cut: &[],
    };
    let error = emulator.push_keyframe(&keyframes, 4 * GAP_US, &small).unwrap_err().to_string();
    assert!(error.contains("margin is 0; it must be 8"), "{error}");
}

/// Motion fields per gap of [`turning`].
const FIELDS: usize = 8;

/// A painted picture that turns about its middle by 0.4 radians per gap, fast in its first half and slowly in its second, at
/// time `t` in gaps; its motion is since the time `since`.
fn turning(t: f64, since: f64) -> Picture {
    let angle = |t: f64| 0.4 * (t + 0.12 * (1.0 - (std::f64::consts::TAU * t).cos()));
    Picture::new(|x, y| {
        let (u, v) = (x - WIDTH as f64 / 2.0, y - HEIGHT as f64 / 2.0);
        let turned = |angle: f64| (u * angle.cos() - v * angle.sin(), u * angle.sin() + v * angle.cos());
        let (a, b) = turned(-angle(t));
        let before = turned(angle(since) - angle(t));
        (wave(a, b), 2.0, [(before.0 - u) as f32, (before.1 - v) as f32])
    })
}

/// The `count` motion fields of the gap that ends with keyframe `k`.
fn fields(k: i64, count: usize) -> Vec<f32> {
    let at = |step: usize| k as f64 - 1.0 + step as f64 / count as f64;
    (1..=count).flat_map(|step| turning(at(step), at(step - 1)).motion).collect()
}

/// Pushes keyframe `k` with these fields; with motion vectors of the gap, or without.
fn push_turned(
    emulator: &mut EventEmulator,
    k: i64,
    motion_steps: Option<&[f32]>,
    with_motion: bool,
    warp: &Warp,
) -> Vec<Event> {
    let picture = turning(k as f64, k as f64 - 1.0);
    let motion: &[f32] = if with_motion { &picture.motion } else { &[] };
    let keyframes = Keyframes { motion, motion_steps, ..picture.keyframes() };
    emulator.push_keyframe(&keyframes, k * GAP_US, warp).unwrap().remove(0)
}

#[test]
fn motion_in_fine_steps_bends_paths() {
    let inner = |mut events: Vec<Event>| {
        events.retain(|event| {
            (f64::from(event.x) + 0.5 - WIDTH as f64 / 2.0)
                .hypot(f64::from(event.y) + 0.5 - HEIGHT as f64 / 2.0)
                < 16.0
        });
        events
    };
    let truth = inner(truth(|t| turning(t, t), 4));
    let run = |shape: fn(Vec<f32>) -> Option<Vec<f32>>, with_motion: bool| {
        let mut emulator = emulator(1, 1);
        let warp = Warp { steps: Some(FIELDS as u32), ..Warp::default() };
        let mut events = Vec::new();
        for k in 0..=4 {
            let steps = shape(fields(k, FIELDS));
            events.extend(push_turned(&mut emulator, k, steps.as_deref(), with_motion, &warp));
        }
        found(&inner(events), &truth, 300, 0)
    };
    let dense = run(Some, true);
    let alone = run(Some, false);
    let straight = run(|_| None, true);
    // Canary: the newest field first.
    let reversed = run(|steps| Some(steps.chunks_exact(2 * PIXELS).rev().flatten().copied().collect()), true);
    assert!(dense > 0.9 && alone > 0.9, "{dense} {alone}");
    assert!(straight < 0.6 && reversed < 0.6, "{straight} {reversed}");
}

#[test]
fn one_field_is_the_motion_of_the_gap() {
    for steps in [1, 6] {
        let warp = Warp { steps: Some(steps), ..Warp::default() };
        let [mut plain, mut dense, mut alone, mut two] = [(); 4].map(|()| emulator(1, 1));
        let mut count = 0;
        for k in 0..4 {
            let (one, halves) = (fields(k, 1), fields(k, 2));
            let expected = push_turned(&mut plain, k, None, true, &warp);
            assert!(push_turned(&mut dense, k, Some(&one), true, &warp) == expected);
            assert!(push_turned(&mut alone, k, Some(&one), false, &warp) == expected);
            let other = push_turned(&mut two, k, Some(&halves), true, &warp);
            assert!((other == expected) == (k == 0 || steps == 1), "canary: {steps} instants by two fields");
            count += expected.len();
        }
        assert!(count > 2000, "{count}");
    }
}

#[test]
fn fields_of_motion_depend_on_no_threads_batch_or_state() {
    let warp = Warp::default();
    let (mut one, mut many, mut both) = (emulator(1, 1), emulator(2, 1), emulator(2, 2));
    let mut count = 0;
    for k in 0..4 {
        let (picture, steps) = (turning(k as f64, k as f64 - 1.0), fields(k, FIELDS));
        let state = one.state();
        let expected = push_turned(&mut one, k, Some(&steps), true, &warp);
        assert!(push_turned(&mut many, k, Some(&steps), true, &warp) == expected);
        if k > 0 {
            let mut again = emulator(2, 1);
            again.restore(&state).unwrap();
            assert!(push_turned(&mut again, k, Some(&steps), true, &warp) == expected);
            assert_eq!(one.keyframe_reports()[0].steps, FIELDS as u32);
        }
        let slid = sliding([3.0, 0.0], k as f64);
        let slid_steps: Vec<f32> = slid.motion.iter().map(|d| d / FIELDS as f32).collect();
        let slid_steps = slid_steps.repeat(FIELDS);
        let join = |a: &[f32], b: &[f32]| [a, b].concat();
        let joined = Picture {
            light: join(&slid.light, &picture.light),
            depth: join(&slid.depth, &picture.depth),
            motion: join(&slid.motion, &picture.motion),
        };
        let steps = join(&slid_steps, &steps);
        let keyframes = Keyframes { motion_steps: Some(&steps), ..joined.keyframes() };
        let lists = both.push_keyframe(&keyframes, k * GAP_US, &warp).unwrap();
        assert!(lists[1] == expected && (k == 0 || lists[0] != expected));
        count += expected.len();
    }
    assert!(count > 2000, "{count}");
    // No more instants than microseconds.
    let steps = fields(3, FIELDS);
    let picture = turning(3.0, 2.0);
    let keyframes = Keyframes { motion_steps: Some(&steps), ..picture.keyframes() };
    one.push_keyframe(&keyframes, 3 * GAP_US + 5, &warp).unwrap();
    assert_eq!(one.keyframe_reports()[0].steps, 5);
}

#[test]
fn bad_fields_of_motion_are_counted_and_told() {
    let (first, second) = (sliding([4.0, 0.0], 0.0), sliding([4.0, 0.0], 1.0));
    let even: Vec<f32> = second.motion.iter().map(|d| d / 4.0).collect();
    let run = |steps: Option<&[f32]>, with_motion: bool| {
        let mut emulator = fresh();
        push(&mut emulator, &first, 0);
        let motion: &[f32] = if with_motion { &second.motion } else { &[] };
        let keyframes = Keyframes { motion, motion_steps: steps, ..second.keyframes() };
        let warp = Warp { steps: Some(8), ..Warp::default() };
        let events = emulator.push_keyframe(&keyframes, GAP_US, &warp).unwrap().remove(0);
        (events, emulator.keyframe_reports()[0])
    };
    let (expected, _) = run(None, true);
    let (events, report) = run(Some(&even.repeat(4)), true);
    // Steps of a pixel leave the picture from its three leftmost columns.
    assert!(events == expected && report.strayed == 0.0);
    assert_eq!(report.bad_motion, 3 * HEIGHT as u64);
    // Nothing but none: straight, where the whole is known.
    let nothing = vec![f32::NAN; 8 * PIXELS];
    let (events, report) = run(Some(&nothing), true);
    assert!(events == expected && report.bad_motion == PIXELS as u64);
    let (_, report) = run(Some(&nothing), false);
    assert_eq!((report.bad_motion, report.linked), (PIXELS as u64, 0.0));
    // One hole in one field, which four pixels of the newer keyframe come upon at most.
    let mut hole = even.repeat(4);
    hole[2 * PIXELS + 2 * (20 * WIDTH + 50)] = f32::INFINITY;
    let (events, report) = run(Some(&hole), true);
    assert!(events == expected && report.bad_motion == 3 * HEIGHT as u64 + 1, "{report:?}");
    // Another convention than that of the motion vectors.
    let away: Vec<f32> = even.iter().map(|d| -d).collect();
    let (events, report) = run(Some(&away.repeat(4)), true);
    assert!(events == expected && report.strayed > 0.9, "{report:?}");
    let warnings = report.warnings();
    assert!(warnings.iter().any(|text| text.starts_with("motion_steps lead elsewhere")), "{warnings:?}");
}
