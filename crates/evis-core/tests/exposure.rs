//! Pixels that see frames of light: against closed forms, and against themselves under other circumstances.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::f64::consts::TAU;

use evis_core::event::is_ordered;
use evis_core::sensor::{Noise, Pattern, Readout, Refractory};
use evis_core::{
    EmulatorConfig, Event, EventEmulator, Exposure, FrameData, Frames, Keyframes, Sensor, SensorConfig,
    Times, Transfer, TriggerRule, Warp,
};

fn with(exposure: &Exposure, base: SensorConfig) -> SensorConfig {
    SensorConfig { exposure: exposure.clone(), ..base }
}

fn emulator(width: u32, height: u32, sensor: &SensorConfig) -> EventEmulator {
    let sensor = sensor.clone();
    EventEmulator::new(EmulatorConfig { width, height, sensor, threads: 1, ..Default::default() }).unwrap()
}

/// Events of pixels in a row that see `light(x, t)`, t in seconds, at `times`.
fn run(sensor: &SensorConfig, width: u32, times: &[i64], light: impl Fn(u32, f64) -> f64) -> Vec<Event> {
    let mut emulator = emulator(width, 1, sensor);
    let mut events = Vec::new();
    for t_us in times {
        let frame: Vec<f32> = (0..width).map(|x| light(x, *t_us as f64 * 1e-6) as f32).collect();
        emulator.push_into(&Frames::linear(&frame), *t_us, std::slice::from_mut(&mut events)).unwrap();
    }
    assert!(is_ordered(&events));
    events
}

/// Steps from ten microseconds to some milliseconds, in no order.
fn irregular(end_us: i64) -> Vec<i64> {
    common::irregular(end_us, 99, 10, 7)
}

/// Greatest difference of two streams' times; none where they differ in anything else.
fn apart(a: &[Event], b: &[Event]) -> Option<i64> {
    let by_pixel = |events: &[Event]| {
        let mut events = events.to_vec();
        events.sort_by_key(|event| (event.x, event.y, event.t));
        events
    };
    let (a, b) = (by_pixel(a), by_pixel(b));
    let same = a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a.x, a.y, a.p) == (b.x, b.y, b.p));
    same.then(|| a.iter().zip(&b).map(|(a, b)| (a.t - b.t).abs()).max().unwrap_or(0))
}

#[test]
fn of_a_ramp_each_frame_is_the_light_at_its_exposures_centre() {
    let ramp = |x: u32, t: f64| 0.05 + 0.01 * f64::from(x) + 7.0 * t;
    for (time_us, period_us) in [(4_000, 0), (4_000, 6_500), (1_111, 1_200), (9_000, 9_000)] {
        let exposure = Exposure { time_us, period_us };
        let period = i64::from(if period_us == 0 { time_us } else { period_us });
        let middles: Vec<i64> = (0..100)
            .map(|k| k * period)
            .filter(|start| start + i64::from(time_us) <= 100_000)
            .map(|start| start + i64::from(time_us / 2))
            .collect();
        // From a frame's sample back to the light that it shows.
        let lead = (0.5 * f64::from(time_us) - f64::from(time_us / 2)) * 1e-6;
        let ideal = SensorConfig::default();
        let expected = run(&ideal, 30, &middles, |x, t| ramp(x, t + lead));
        let sharp = run(&ideal, 30, &middles, |x, t| ramp(x, t + lead + 2e-3));
        assert!(expected.len() > 100 && apart(&expected, &sharp) != Some(0), "canary: other light");
        for times in [irregular(100_000), vec![0, 33, 50_000, 100_000]] {
            let got = run(&with(&exposure, ideal.clone()), 30, &times, ramp);
            let error = apart(&got, &expected);
            assert!(error.is_some_and(|us| us <= 1), "{exposure:?}: {error:?}");
        }
    }
}

#[test]
fn flicker_is_weakened_by_the_exposures_transform() {
    // Equal thresholds, and a signal that returns, would be decided by rounding.
    let (f, time_us) = (121.7, 4_000_u32);
    let x = std::f64::consts::PI * f * f64::from(time_us) * 1e-6;
    let ideal = SensorConfig { threshold_on: 0.05, threshold_off: 0.0571, ..Default::default() };
    let light = |part: f64| move |p: u32, t: f64| 0.5 + 0.3 * part * (TAU * f * t + 0.7 * f64::from(p)).sin();
    let fine: Vec<i64> = (0..=20_000).map(|k| 10 * k).collect();
    let exposure = Exposure { time_us, period_us: 0 };
    let got = run(&with(&exposure, ideal.clone()), 9, &fine, light(1.0));
    let middles: Vec<i64> = (0..50).map(|k| 4_000 * k + 2_000).collect();
    let expected = run(&ideal, 9, &middles, light(x.sin() / x));
    assert!(expected.len() > 1_000, "{}", expected.len());
    let error = apart(&got, &expected);
    assert!(error.is_some_and(|us| us <= 4), "{error:?}");
    assert_eq!(apart(&expected, &run(&ideal, 9, &middles, light(1.0))), None, "canary: weakened by nothing");
}

#[test]
fn flicker_of_whole_periods_per_exposure_is_not_seen() {
    let light = |x: u32, t: f64| 0.5 + 0.4 * (TAU * 100.0 * t + f64::from(x)).sin();
    let times: Vec<i64> = (0..=1_000).map(|k| 500 * k).collect();
    let ideal = SensorConfig::default();
    let of = |time_us, period_us| {
        let exposure = Exposure { time_us, period_us };
        run(&with(&exposure, ideal.clone()), 5, &times, light).len()
    };
    assert_eq!((of(20_000, 0), of(10_000, 33_333)), (0, 0));
    assert!(of(4_000, 0) > 200, "canary: {} of less than a period", of(4_000, 0));
    assert!(run(&ideal, 5, &times, light).len() > 1_000, "canary: pixels that see light itself");
}

#[test]
fn a_latch_fires_with_frames_alone() {
    let exposure = Exposure { time_us: 5_000, period_us: 8_000 };
    let base = SensorConfig { trigger: TriggerRule::Latch, ..Default::default() };
    let sample = SensorConfig { times: Times::Sample, ..Default::default() };
    for base in [base, sample] {
        let times: Vec<i64> = (0..=300).map(|k| 333 * k).collect();
        let got = run(&with(&exposure, base), 4, &times, |x, t| 0.1 + 4.0 * t + 0.1 * f64::from(x));
        assert!(got.len() > 10 && got.iter().all(|event| event.t % 8_000 == 2_500), "{got:?}");
    }
}

const SIZE: (u32, u32) = (200, 100);

/// Light that drifts, in codes of 8 bits.
fn codes(environment: usize, t_us: i64) -> Vec<u8> {
    let t = t_us as f64 * 1e-6;
    let code = |i: u32| {
        let (x, y) = (f64::from(i % SIZE.0), f64::from(i / SIZE.0));
        let phase = TAU * (x / 41.7 - 9.7 * t) + 0.05 * y + environment as f64;
        (127.0 + 100.0 * phase.sin()).round() as u8
    };
    (0..SIZE.0 * SIZE.1).map(code).collect()
}

fn linear(codes: &[u8]) -> Vec<f32> {
    codes.iter().map(|code| Transfer::Linear.light(f64::from(*code) / 255.0) as f32).collect()
}

fn sensors() -> Vec<SensorConfig> {
    let exposure = Exposure { time_us: 4_000, period_us: 5_500 };
    let noisy = SensorConfig {
        noise: Noise { shot_hz: 5.0, leak_hz: 1.0, ..Default::default() },
        pattern: Pattern { sigma: 0.03, ..Default::default() },
        refractory: Refractory { period_us: 700, ..Default::default() },
        readout: Readout { latency_us: 900.0, jitter_us: 50.0, ..Default::default() },
        ..Default::default()
    };
    let bases = [SensorConfig::default(), noisy, SensorConfig::preset("davis346").unwrap()];
    bases.into_iter().map(|base| with(&exposure, base)).collect()
}

fn many(sensor: &SensorConfig, batch: usize, threads: usize) -> EventEmulator {
    EventEmulator::new(EmulatorConfig {
        width: SIZE.0,
        height: SIZE.1,
        batch,
        threads,
        seed: 4,
        sensor: sensor.clone(),
        ..Default::default()
    })
    .unwrap()
}

const STEPS: std::ops::Range<i64> = 0..40;

fn at(k: i64) -> i64 {
    700 * k + k * k % 5
}

/// All that `emulator` makes of codes, from step to step.
fn push_steps(emulator: &mut EventEmulator, steps: std::ops::Range<i64>) -> Vec<Vec<Event>> {
    let batch = emulator.config().batch;
    let mut all = vec![Vec::new(); batch];
    for k in steps {
        let frames: Vec<u8> = (0..batch).flat_map(|environment| codes(environment, at(k))).collect();
        emulator.push_into(&Frames::u8(&frames, Transfer::Linear), at(k), &mut all).unwrap();
    }
    all
}

#[test]
fn batches_threads_and_kinds_of_frames_change_no_byte() {
    for sensor in sensors() {
        let expected = push_steps(&mut many(&sensor, 3, 1), STEPS);
        assert!(expected.iter().all(|events| events.len() > 10_000 && is_ordered(events)));
        for threads in [2, 3] {
            assert!(push_steps(&mut many(&sensor, 3, threads), STEPS) == expected, "{threads} threads");
            assert!(
                push_steps(&mut many(&sensor, 1, threads), STEPS)[0] == expected[0],
                "alone, {threads} threads"
            );
        }
        let (mut floats, mut wide, mut rgb) = (Vec::new(), Vec::new(), Vec::new());
        let [mut of_floats, mut of_wide, mut of_rgb] = [0; 3].map(|_| many(&sensor, 1, 1));
        for k in STEPS {
            let codes = codes(0, at(k));
            let light = linear(&codes);
            of_floats.push_into(&Frames::linear(&light), at(k), std::slice::from_mut(&mut floats)).unwrap();
            let words: Vec<u16> = codes.iter().map(|code| u16::from(*code) * 257).collect();
            let frames = Frames::u16(&words, Transfer::Linear);
            of_wide.push_into(&frames, at(k), std::slice::from_mut(&mut wide)).unwrap();
            let triples: Vec<f32> = light.iter().flat_map(|light| [0.0, *light / 0.7152, 0.0]).collect();
            let frames = Frames::linear(&triples).rgb();
            of_rgb.push_into(&frames, at(k), std::slice::from_mut(&mut rgb)).unwrap();
        }
        assert!(floats == expected[0] && wide == expected[0]);
        // What is multiplied and divided is rounded.
        let share = rgb.len() as f64 / floats.len() as f64;
        assert!((share - 1.0).abs() < 1e-3, "{share}");
        let sharp =
            push_steps(&mut many(&SensorConfig { exposure: Exposure::default(), ..sensor }, 1, 1), STEPS);
        assert!(sharp[0] != expected[0], "canary: no exposure");
    }
}

#[test]
fn a_state_within_an_exposure_goes_on_where_it_was() {
    for sensor in sensors() {
        let expected = push_steps(&mut many(&sensor, 2, 1), STEPS);
        // Before the first frame, within an exposure, and between two.
        for cut in [1, 4, 22, 23] {
            let mut first = many(&sensor, 2, 1);
            let mut all = push_steps(&mut first, 0..cut);
            let state = first.state();
            let mut second = many(&sensor, 2, 2);
            // What it knew is forgotten.
            push_steps(&mut second, 0..9);
            second.restore(&state).unwrap();
            assert_eq!(second.total_report(), first.total_report());
            for (all, later) in all.iter_mut().zip(push_steps(&mut second, cut..STEPS.end)) {
                all.extend(later);
            }
            assert!(all == expected, "cut at {cut}");
            // Canary: one whose exposure is not the state's.
            let mut other = many(&sensor, 2, 1);
            let mut later = push_steps(&mut other, 0..1);
            for (later, events) in later.iter_mut().zip(push_steps(&mut other, cut..STEPS.end)) {
                later.extend(events);
            }
            assert!(later != expected || cut == 1);
            assert!(many(&SensorConfig::default(), 2, 1).restore(&state).is_err());
        }
    }
}

#[test]
fn an_environment_that_is_reset_begins_with_its_next_whole_exposure() {
    // Within an exposure, and with the first light after one has begun.
    for (sensor, from) in sensors().into_iter().flat_map(|sensor| [8, 13].map(|from| (sensor.clone(), from)))
    {
        let mut emulator = many(&sensor, 2, 1);
        push_steps(&mut emulator, 0..from);
        emulator.reset(Some(&[1])).unwrap();
        let got = push_steps(&mut emulator, from..STEPS.end);
        let fresh = push_steps(&mut many(&sensor, 2, 1), from..STEPS.end);
        assert!(got[1] == fresh[1] && got[1].len() > 5_000);
        assert!(got[0] != fresh[0], "canary: the other one goes on");
        // Exposures that begin before the first light are not made.
        let first = got[1].iter().map(|event| event.t).min().unwrap();
        assert!(first > (at(from) / 5_500 + 1) * 5_500 + 2_000, "{first}");
        // Light that has made no frame yet counts: time cannot go back before all is reset.
        let mut emulator = many(&sensor, 2, 1);
        push_steps(&mut emulator, 0..1);
        emulator.reset(Some(&[0])).unwrap();
        assert_eq!(emulator.now_us(), Some(0));
        emulator.reset(None).unwrap();
        assert_eq!(emulator.now_us(), None);
    }
}

#[test]
fn unknown_light_makes_an_unknown_frame() {
    let exposure = Exposure { time_us: 2_000, ..Default::default() };
    let light = |x: u32, k: i64| 0.1 + 0.02 * k as f64 + 0.1 * f64::from(x);
    // The second pixel is not known at 5 ms, within an exposure, and at 8 ms, between two.
    let unlit = |x: u32, k: i64| x == 1 && matches!(k, 5 | 8);
    let no_frame = |x: u32, k: i64| x == 1 && matches!(k, 5 | 7 | 9);
    for log in [false, true] {
        let mut blurred = emulator(3, 1, &with(&exposure, SensorConfig::default()));
        let mut expected = emulator(3, 1, &SensorConfig::default());
        let (mut got, mut want) = (Vec::new(), Vec::new());
        for k in 0..=40_i64 {
            let value = |x: u32, unknown: bool| if unknown { f32::NAN } else { light(x, k) as f32 };
            let frame: Vec<f32> = (0..3).map(|x| value(x, unlit(x, k))).collect();
            let logs: Vec<f32> = frame.iter().map(|light| (light + 1e-3).ln()).collect();
            let frames = if log { Frames::log(&logs) } else { Frames::linear(&frame) };
            blurred.push_into(&frames, 1_000 * k, std::slice::from_mut(&mut got)).unwrap();
            if k % 2 == 1 && k < 40 {
                let frame: Vec<f32> = (0..3).map(|x| value(x, no_frame(x, k))).collect();
                let frames = Frames::linear(&frame);
                expected.push_into(&frames, 1_000 * k, std::slice::from_mut(&mut want)).unwrap();
            }
        }
        let error = apart(&got, &want);
        assert!(want.len() > 10 && error.is_some_and(|us| us <= 2), "{error:?} {got:?} {want:?}");
        assert_eq!(blurred.total_report().unknown, 3, "log: {log}");
    }
}

#[test]
fn impossible_light_is_refused_and_changes_nothing() {
    for sensor in sensors() {
        let mut emulator = many(&sensor, 1, 2);
        let mut all = push_steps(&mut emulator, 0..5);
        let mut light = linear(&codes(0, 0));
        for bad in [-0.5, f32::INFINITY] {
            light[205] = bad;
            let error = emulator.push(&Frames::linear(&light), at(5)).unwrap_err().to_string();
            assert!(error.contains("(5, 1)") && error.contains(&bad.to_string()), "{error}");
        }
        all[0].extend(push_steps(&mut emulator, 5..STEPS.end).remove(0));
        assert!(all == push_steps(&mut many(&sensor, 1, 1), STEPS));
    }
}

#[test]
fn keyframes_are_exposed_instant_by_instant() {
    let pixels = (SIZE.0 * SIZE.1) as usize;
    let (depth, motion) = (vec![2.0_f32; pixels], vec![0.0_f32; 2 * pixels]);
    for sensor in sensors() {
        // What does not move is not divided: the light is what frames alone would be.
        let (mut warped, mut plain) = (many(&sensor, 1, 2), many(&sensor, 1, 1));
        let (mut got, mut want) = (Vec::new(), Vec::new());
        for k in STEPS {
            let light = linear(&codes(0, at(k)));
            let keyframes = Keyframes {
                light: FrameData::Linear(&light),
                channels: 1,
                depth: &depth,
                motion: &motion,
                motion_steps: None,
                motion_forward: None,
                cut: &[],
            };
            let warp = Warp { steps: Some(1), detect_cuts: Some(false), ..Default::default() };
            let events = warped.push_keyframe(&keyframes, at(k), &warp).unwrap().remove(0);
            let cut = warped.keyframe_reports()[0].cut;
            assert_eq!(
                cut == evis_core::emulator::Cut::Start,
                k == 0,
                "keyframes are linked from the first on"
            );
            got.extend(events);
            plain.push_into(&Frames::linear(&light), at(k), std::slice::from_mut(&mut want)).unwrap();
            if k == 17 {
                let state = warped.state();
                warped = many(&sensor, 1, 1);
                warped.restore(&state).unwrap();
            }
        }
        assert!(want.len() > 10_000 && got == want);
        assert_eq!(warped.total_report(), plain.total_report());
    }
}

#[test]
fn exposures_that_cannot_be_are_named() {
    let refused =
        |exposure: Exposure| Sensor::new(with(&exposure, SensorConfig::default())).unwrap_err().to_string();
    let of = |time_us, period_us| Exposure { time_us, period_us };
    for (exposure, told) in [
        (of(0, 5), ["exposure.time_us", "0", "above 0"]),
        (of(20_000, 19_999), ["exposure.period_us", "19999", "20000"]),
        (of(10_000_001, 0), ["exposure.time_us", "10000001", "10000000"]),
        (of(5, 10_000_001), ["exposure.period_us", "10000001", "10000000"]),
    ] {
        let error = refused(exposure);
        assert!(told.iter().all(|told| error.contains(told)), "{error}");
    }
    for fine in [of(1, 0), of(10_000_000, 10_000_000), of(20_000, 33_333)] {
        assert!(Sensor::new(with(&fine, SensorConfig::default())).is_ok(), "canary: {fine:?}");
    }
}

#[test]
fn a_file_has_the_exposure_as_a_table() {
    let text = "[exposure]\ntime_us = 20000\nperiod_us = 33333\n";
    let sensor = SensorConfig::from_toml(text).unwrap();
    let exposure = Exposure { time_us: 20_000, period_us: 33_333 };
    assert_eq!(sensor.exposure, exposure);
    assert_eq!(SensorConfig::from_toml(&sensor.to_toml()).unwrap(), sensor);
    assert_eq!(sensor.stages(), ["exposure"]);
    assert!(sensor.walks_on_host() && !sensor.is_ideal() && sensor.warnings().is_empty());
    let both = format!("{text}[photoreceptor]\ncutoff_hz = 300\n");
    let warnings = SensorConfig::from_toml(&both).unwrap().warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("exposure.time_us"), "{warnings:?}");
    for preset in evis_core::sensor::PRESETS {
        assert!(preset.sensor().exposure.is_off(), "{}", preset.name);
    }
}
