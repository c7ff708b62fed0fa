//! `evis-paper` between pushed keyframes against the rule that the paper publishes, in f64 and written down from its text.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_core::emulator::Cut;
use evis_core::{
    EmulatorConfig, Event, EventEmulator, FrameData, Keyframes, SensorConfig, TriggerRule, Warp,
};

const SIZE: [usize; 2] = [72, 48];
const GAP_US: i64 = 8000;
const STEPS: u32 = 8;

/// Uniform in [0, 1), in no order.
fn noise(i: u64) -> f64 {
    let h = (i ^ 0x5bd1_e995_9e37_79b9).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let h = (h ^ (h >> 31)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((h ^ (h >> 29)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// What a renderer says of one time.
#[derive(Clone, Default)]
struct Picture {
    light: Vec<f32>,
    depth: Vec<f32>,
    /// Pairs: to where it was, and to where it will be.
    back: Vec<f32>,
    forward: Vec<f32>,
}

impl Picture {
    fn keyframes(&self) -> Keyframes<'_> {
        Keyframes {
            light: FrameData::Linear(&self.light),
            channels: 1,
            depth: &self.depth,
            motion: &self.back,
            motion_steps: None,
            motion_forward: Some(&self.forward),
            cut: &[],
        }
    }
}

/// The paper's sensor without noise: latch, threshold 0.15, eps 1e-5.
fn emulator() -> EventEmulator {
    let sensor = SensorConfig {
        threshold_on: 0.15,
        threshold_off: 0.15,
        log_eps: 1e-5,
        trigger: TriggerRule::Latch,
        ..SensorConfig::default()
    };
    let [width, height] = SIZE.map(|n| n as u32);
    EventEmulator::new(EmulatorConfig { width, height, sensor, threads: 1, ..Default::default() }).unwrap()
}

fn warp(margin: u32) -> Warp {
    Warp { margin: (margin > 0).then_some(margin), ..Warp::evis_paper(STEPS) }
}

fn run(pictures: &[Picture], margin: u32) -> Vec<Event> {
    let mut emulator = emulator();
    let mut events = Vec::new();
    for (k, picture) in pictures.iter().enumerate() {
        let at = k as i64 * GAP_US;
        events.extend(emulator.push_keyframe(&picture.keyframes(), at, &warp(margin)).unwrap().remove(0));
    }
    events
}

/// One keyframe moved along `motion` times `part`: colours splatted over four pixels, weighted by e^(12 d / max d) with
/// d = 1 / (z + 1e-3); no value where the weight is below 1e-4.
fn splatted(picture: &Picture, motion: &[f32], part: f64, margin: usize) -> Vec<Option<f64>> {
    let canvas = SIZE[0] + 2 * margin;
    let disparity: Vec<f64> = if picture.depth.is_empty() {
        // In its place how far pixels move.
        motion.chunks_exact(2).map(|d| f64::from(d[0]).hypot(f64::from(d[1]))).collect()
    } else {
        picture.depth.iter().map(|z| 1.0 / (f64::from(*z) + 1e-3)).collect()
    };
    let seen = |i: usize| {
        let (x, y) = (i % canvas, i / canvas);
        (margin..margin + SIZE[0]).contains(&x) && (margin..margin + SIZE[1]).contains(&y)
    };
    let most = (0..disparity.len()).filter(|i| seen(*i)).map(|i| disparity[i]).fold(0.0, f64::max);
    let mut sums = vec![(0.0, 0.0); SIZE[0] * SIZE[1]];
    for (i, light) in picture.light.iter().enumerate() {
        let importance = (12.0 * disparity[i] / most).exp();
        let x = (i % canvas) as f64 + f64::from(motion[2 * i]) * part - margin as f64;
        let y = (i / canvas) as f64 + f64::from(motion[2 * i + 1]) * part - margin as f64;
        for (column, wx) in [(x.floor(), 1.0 - x.fract_above()), (x.floor() + 1.0, x.fract_above())] {
            for (row, wy) in [(y.floor(), 1.0 - y.fract_above()), (y.floor() + 1.0, y.fract_above())] {
                let inside = column >= 0.0 && row >= 0.0 && column < SIZE[0] as f64 && row < SIZE[1] as f64;
                if inside {
                    let sum = &mut sums[row as usize * SIZE[0] + column as usize];
                    sum.0 += importance * wx * wy;
                    sum.1 += importance * wx * wy * f64::from(*light);
                }
            }
        }
    }
    sums.iter().map(|(weight, light)| (*weight >= 1e-4).then(|| light / weight)).collect()
}

trait Fraction {
    /// What is above the next whole number below.
    fn fract_above(self) -> f64;
}

impl Fraction for f64 {
    fn fract_above(self) -> f64 {
        self - self.floor()
    }
}

/// The paper's events: the newer keyframe first, the older one in its holes, black where neither shows anything; a latch at
/// every fine step.
fn paper(pictures: &[Picture], margin: usize) -> Vec<Event> {
    let canvas = SIZE[0] + 2 * margin;
    let crop = |picture: &Picture| -> Vec<f64> {
        (0..SIZE[0] * SIZE[1])
            .map(|i| f64::from(picture.light[(i / SIZE[0] + margin) * canvas + i % SIZE[0] + margin]))
            .collect()
    };
    let mut reference: Vec<f64> = crop(&pictures[0]).iter().map(|light| (light + 1e-5).ln()).collect();
    let mut events = Vec::new();
    for (k, pair) in pictures.windows(2).enumerate() {
        for step in 1..=STEPS {
            let part = f64::from(step) / f64::from(STEPS);
            let frame = if step == STEPS {
                crop(&pair[1])
            } else {
                let newer = splatted(&pair[1], &pair[1].back, 1.0 - part, margin);
                let older = splatted(&pair[0], &pair[0].forward, part, margin);
                newer.iter().zip(older).map(|(newer, older)| newer.or(older).unwrap_or(0.0)).collect()
            };
            let t = k as i64 * GAP_US + i64::from(step) * GAP_US / i64::from(STEPS);
            for (i, light) in frame.iter().enumerate() {
                let change = (light + 1e-5).ln() - reference[i];
                if change.abs() >= f64::from(0.15_f32) {
                    let polarity =
                        if change > 0.0 { evis_core::Polarity::On } else { evis_core::Polarity::Off };
                    events.push(Event::new(t, (i % SIZE[0]) as u16, (i / SIZE[0]) as u16, polarity));
                    reference[i] += change;
                }
            }
        }
    }
    events
}

/// F1 of events that agree in everything; all of both are different.
fn f1(got: &[Event], expected: &[Event]) -> f64 {
    let key = |event: &Event| (event.t, event.y, event.x, event.p);
    let expected: std::collections::BTreeSet<_> = expected.iter().map(key).collect();
    let matched = got.iter().filter(|event| expected.contains(&key(event))).count();
    2.0 * matched as f64 / (got.len() + expected.len()) as f64
}

/// A textured square before a textured ground, both moving by fractions of pixels; light over six decades.
fn scene(keys: usize, margin: usize, decades: f64) -> Vec<Picture> {
    let canvas = SIZE.map(|n| n + 2 * margin);
    let speed =
        |near: bool, y: f64| -> [f64; 2] { if near { [3.37, -1.21] } else { [-1.63 + 0.011 * y, 0.47] } };
    let texture = |u: f64, v: f64, layer: u64| {
        let (i, j) = ((u / 1.7).floor(), (v / 1.7).floor());
        10_f64.powf(decades * (noise((i as i64 as u64) << 20 ^ (j as i64 as u64) << 2 ^ layer) - 0.5))
    };
    (0..keys)
        .map(|k| {
            let t = k as f64;
            let mut picture = Picture::default();
            for i in 0..canvas[0] * canvas[1] {
                let x = (i % canvas[0]) as f64 - margin as f64;
                let y = (i / canvas[0]) as f64 - margin as f64;
                let [dx, dy] = speed(true, 0.0);
                let (u, v) = (x - 20.0 - dx * t, y - 22.0 - dy * t);
                let near = (0.0..16.0).contains(&u) && (0.0..14.0).contains(&v);
                let motion = speed(near, y);
                let light = if near {
                    texture(u, v, 1)
                } else {
                    texture(x - motion[0] * t + 500.0, y - motion[1] * t + 500.0, 0)
                };
                picture.light.push(light as f32);
                picture.depth.push(if near { 1.0 + 0.01 * u as f32 } else { 4.0 + 0.02 * y as f32 });
                picture.back.extend(motion.map(|d| -d as f32));
                picture.forward.extend(motion.map(|d| d as f32));
            }
            picture
        })
        .collect()
}

#[test]
fn the_warp_between_pushed_keyframes_is_the_papers() {
    for (margin, decades) in [(0, 6.0), (0, 1.5), (7, 6.0)] {
        let pictures = scene(5, margin, decades);
        let expected = paper(&pictures, margin);
        let got = run(&pictures, margin as u32);
        assert!(expected.len() > 20_000, "{}", expected.len());
        let score = f1(&got, &expected);
        println!("margin {margin}, {decades} decades: F1 {score:.5} of {} events", expected.len());
        assert!(score >= 0.999, "margin {margin}, {decades} decades: {score}");
        // Canary: what splat makes of it is another stream.
        let mut splat = emulator();
        let warp = Warp { margin: Some(margin as u32), steps: Some(STEPS), ..Warp::default() };
        let mut other = Vec::new();
        for (k, picture) in pictures.iter().enumerate() {
            let keyframes = picture.keyframes();
            other.extend(splat.push_keyframe(&keyframes, k as i64 * GAP_US, &warp).unwrap().remove(0));
        }
        assert!(f1(&other, &expected) < 0.9);
    }
}

#[test]
fn displacement_takes_the_place_of_depth() {
    let pictures = scene(4, 0, 3.0);
    let flat: Vec<_> =
        pictures.iter().map(|picture| Picture { depth: Vec::new(), ..picture.clone() }).collect();
    let (expected, got) = (paper(&flat, 0), run(&flat, 0));
    assert!(expected.len() > 10_000, "{}", expected.len());
    let score = f1(&got, &expected);
    assert!(score >= 0.999, "{score}");
    // Canary: with depth it is another stream, if not a very different one: what is nearer moves farther here.
    let score = f1(&got, &run(&pictures, 0));
    assert!((0.9..0.999).contains(&score), "{score}");
    // So it is with the other method.
    let splat = |pictures: &[Picture]| {
        let mut emulator = emulator();
        let push = |(k, picture): (usize, &Picture)| {
            let warp = Warp { steps: Some(STEPS), ..Warp::default() };
            emulator.push_keyframe(&picture.keyframes(), k as i64 * GAP_US, &warp).unwrap().remove(0)
        };
        pictures.iter().enumerate().flat_map(push).collect::<Vec<_>>()
    };
    let score = f1(&splat(&flat), &splat(&pictures));
    assert!(score > 0.9, "{score}");
    // Not one way and then the other.
    let mut emulator = emulator();
    emulator.push_keyframe(&flat[0].keyframes(), 0, &warp(0)).unwrap();
    let error = emulator.push_keyframe(&pictures[1].keyframes(), GAP_US, &warp(0)).unwrap_err().to_string();
    assert!(error.contains("depth") && error.contains("reset"), "{error}");
}

/// A picture in which nothing moves.
fn still(light: impl Fn(u64) -> f64) -> Picture {
    let pixels = SIZE[0] * SIZE[1];
    Picture {
        light: (0..pixels as u64).map(|i| light(i) as f32).collect(),
        depth: (0..pixels as u64).map(|i| 1.0 + 5.0 * noise(i + 1_000_000) as f32).collect(),
        back: vec![0.0; 2 * pixels],
        forward: vec![0.0; 2 * pixels],
    }
}

#[test]
fn still_pictures_stay_silent_at_any_light() {
    let between = |low: f64, high: f64| move |i: u64| low * (high / low).powf(noise(i));
    let lamp = |i: u64| if i == 777 { 60.0 } else { between(1e-4, 0.1)(i) };
    let sun = |i: u64| if i == 777 { 1e9 } else { between(1e-6, 1e4)(i) };
    let pictures = [still(between(300.0, 5000.0)), still(lamp), still(sun), still(between(0.05, 1.0))];
    for (which, picture) in pictures.iter().enumerate() {
        let events = run(&vec![picture.clone(); 6], 0);
        assert_eq!(events.len(), 0, "picture {which}");
    }
    // Canary: one that becomes brighter.
    let brighter =
        Picture { light: pictures[0].light.iter().map(|y| 1.2 * y).collect(), ..pictures[0].clone() };
    assert_eq!(run(&[pictures[0].clone(), brighter], 0).len(), SIZE[0] * SIZE[1]);
}

#[test]
fn what_only_the_margin_shows_changes_no_weight() {
    let margin = 6;
    // Near the border nothing moves: nothing comes in.
    let calm = |mut picture: Picture, margin: usize| {
        let canvas = SIZE.map(|n| n + 2 * margin);
        for i in 0..canvas[0] * canvas[1] {
            let (x, y) = ((i % canvas[0]).wrapping_sub(margin), (i / canvas[0]).wrapping_sub(margin));
            let inside = (8..SIZE[0] - 8).contains(&x) && (8..SIZE[1] - 8).contains(&y);
            if !inside {
                for d in 0..2 {
                    (picture.back[2 * i + d], picture.forward[2 * i + d]) = (0.0, 0.0);
                }
            }
            if x >= SIZE[0] || y >= SIZE[1] {
                // Nearer than all that is in the picture.
                (picture.depth[i], picture.light[i]) = (0.05, 1e6);
            }
        }
        picture
    };
    let alone: Vec<_> = scene(3, 0, 3.0).into_iter().map(|picture| calm(picture, 0)).collect();
    let framed: Vec<_> = scene(3, margin, 3.0).into_iter().map(|picture| calm(picture, margin)).collect();
    let (alone, framed) = (run(&alone, 0), run(&framed, margin as u32));
    assert!(alone.len() > 5000);
    assert!(alone == framed, "{} and {} events", alone.len(), framed.len());
}

#[test]
fn the_paper_warps_across_what_nothing_links() {
    let first = still(|i| 0.1 + noise(i));
    let other = Picture { depth: vec![0.2; SIZE[0] * SIZE[1]], ..still(|i| 0.1 + noise(i + 5_000_000)) };
    let cut = |warp: Warp| {
        let mut emulator = emulator();
        emulator.push_keyframe(&first.keyframes(), 0, &warp).unwrap();
        emulator.push_keyframe(&other.keyframes(), GAP_US, &warp).unwrap();
        emulator.keyframe_reports()[0].cut
    };
    assert_eq!(cut(Warp::evis_paper(STEPS)), Cut::None);
    assert_eq!(cut(Warp { detect_cuts: Some(true), ..Warp::evis_paper(STEPS) }), Cut::Detected);
    // The other method looks for cuts unless it is told not to.
    assert_eq!(cut(Warp { steps: Some(STEPS), ..Warp::default() }), Cut::Detected);
}
