use super::*;
use crate::event::is_ordered;
use crate::sensor::{Refractory, RefractoryRule, Times};
use crate::trigger::{self, PixelState};

/// The scene that peers were measured on: I = 0.5 + 0.4 sin(0.3 + 2 pi (x / 41.7 - 9.7 t)).
fn drifting(width: u32, height: u32, t_us: i64) -> Vec<f32> {
    let row: Vec<f32> = (0..width)
        .map(|x| {
            let phase = 0.3 + std::f64::consts::TAU * (f64::from(x) / 41.7 - 9.7 * t_us as f64 * 1e-6);
            (0.5 + 0.4 * phase.sin()) as f32
        })
        .collect();
    row.repeat(height as usize)
}

fn emulator(config: EmulatorConfig) -> EventEmulator {
    EventEmulator::new(config).unwrap()
}

#[test]
fn the_ideal_kernel_is_the_trigger() {
    let (width, height) = (67, 5);
    let config = EmulatorConfig { width, height, ..Default::default() };
    let mut emulator = emulator(config.clone());
    let mut states: Vec<PixelState> = Vec::new();
    let mut before = 0;
    let mut count = 0;
    for t_us in [0, 1000, 2500, 2501, 40_000] {
        let frame = drifting(width, height, t_us);
        let got = emulator.push(&Frames::linear(&frame), t_us).unwrap().remove(0);
        let logs: Vec<f32> =
            frame.iter().map(|light| crate::simd::ln(light + config.sensor.log_eps)).collect();
        let mut expected = Vec::new();
        if states.is_empty() {
            states = logs.iter().map(|l| PixelState { reference_log: *l, log_luminance: *l }).collect();
        }
        let interval = (t_us - before) as u32;
        for (i, (state, log)) in states.iter_mut().zip(&logs).enumerate() {
            let decision = trigger::decide(&config.sensor, *state, *log);
            for k in 1..=decision.count {
                let offset = trigger::fire_time_us(&config.sensor, &decision, k, interval).max(1);
                let (x, y) = (i as u32 % width, i as u32 / width);
                expected.push(Event::new(before + i64::from(offset), x as u16, y as u16, decision.polarity));
            }
            *state = PixelState { reference_log: decision.reference_log, log_luminance: *log };
        }
        expected.sort_by_key(Event::order);
        assert_eq!(got, expected, "at {t_us}");
        assert!(is_ordered(&got) && got.iter().all(|e| e.t > before && e.t <= t_us || t_us == 0));
        count += got.len();
        before = t_us;
    }
    assert!(count > 500, "{count}");
}

/// Events of `logs`, frame by frame, by the trigger's own functions; `unknown` pixels stay as they are.
fn by_the_trigger(
    sensor: &SensorConfig,
    width: u32,
    frames: &[(i64, Vec<f32>)],
    tie: f32,
) -> Vec<Vec<Event>> {
    let mut states: Vec<Option<PixelState>> = vec![None; frames[0].1.len()];
    let mut before = frames[0].0;
    let mut all = Vec::new();
    for (t_us, logs) in frames {
        let mut expected = Vec::new();
        let interval = (t_us - before) as u32;
        for (i, (state, log)) in states.iter_mut().zip(logs).enumerate() {
            if log.is_nan() {
                continue;
            }
            let Some(state) = state else {
                *state = Some(PixelState { reference_log: *log, log_luminance: *log });
                continue;
            };
            let decision = trigger::decide_within(sensor, *state, *log, tie);
            for k in 1..=decision.count {
                let offset = trigger::fire_time_us(sensor, &decision, k, interval).clamp(1, interval);
                let (x, y) = (i as u32 % width, i as u32 / width);
                expected.push(Event::new(before + i64::from(offset), x as u16, y as u16, decision.polarity));
            }
            *state = PixelState { reference_log: decision.reference_log, log_luminance: *log };
        }
        expected.sort_by_key(Event::order);
        all.push(expected);
        before = *t_us;
    }
    all
}

#[test]
fn every_kind_of_frame_is_the_trigger_on_every_instruction_set() {
    let (width, height) = (131, 7);
    let pixels = (width * height) as usize;
    let times: Vec<i64> = (0..40).map(|k| k * 1300).collect();
    // Small steps around the ends of ranges, jumps, darkness, and the scale's ends.
    let value = |k: usize, i: usize| -> f64 {
        let slow = (0.37 * i as f64 + 0.02 * (i % 13) as f64 * k as f64).sin();
        match (i * 31 + k * k * 7) % 97 {
            0 => 0.0,
            1 => 1.0,
            _ => (0.5 + 0.499 * slow).powi(1 + (i % 5) as i32),
        }
    };
    let base = SensorConfig::default();
    let sensors = [
        base.clone(),
        SensorConfig { threshold_on: 0.04, threshold_off: 0.3, ..base.clone() },
        SensorConfig { threshold_on: 3.0, threshold_off: 0.9, log_eps: 0.02, ..base.clone() },
        SensorConfig { trigger: crate::sensor::TriggerRule::Latch, ..base },
    ];
    let inverse = 1.0 / 0.7_f32;
    for sensor in sensors {
        let eps = sensor.log_eps;
        let curve = |code: u32, most: f64| {
            crate::simd::ln(Transfer::Srgb.light(f64::from(code) / most) as f32 * inverse + eps)
        };
        for kind in ["float32", "uint8", "uint16", "log"] {
            // Integers are never NaN.
            let lost = |k: usize, i: usize| (i + k).is_multiple_of(41) && !kind.starts_with("uint");
            let floats = |k: usize| -> Vec<f32> {
                (0..pixels).map(|i| if lost(k, i) { f32::NAN } else { value(k, i) as f32 }).collect()
            };
            let eight = |k: usize| -> Vec<u8> { (0..pixels).map(|i| (value(k, i) * 255.0) as u8).collect() };
            let sixteen =
                |k: usize| -> Vec<u16> { (0..pixels).map(|i| (value(k, i) * 65_535.0) as u16).collect() };
            let log_of = |light: f32| crate::simd::ln(light * inverse + eps);
            let logs = |k: usize| -> Vec<f32> {
                match kind {
                    "uint8" => eight(k).iter().map(|code| curve((*code).into(), 255.0)).collect(),
                    "uint16" => sixteen(k).iter().map(|code| curve((*code).into(), 65_535.0)).collect(),
                    _ => floats(k)
                        .iter()
                        .map(|light| if light.is_nan() { f32::NAN } else { log_of(*light) })
                        .collect(),
                }
            };
            let frames: Vec<_> = times.iter().enumerate().map(|(k, t)| (*t, logs(k))).collect();
            let tie = if kind.starts_with("uint") { trigger::TIE } else { 0.0 };
            let expected = by_the_trigger(&sensor, width, &frames, tie);
            let count: usize = expected.iter().map(Vec::len).sum();
            assert!(count > 2000, "{kind}: {count}");
            for isa in Isa::supported() {
                let config = EmulatorConfig {
                    width,
                    height,
                    sensor: sensor.clone(),
                    reference_luminance: 0.7,
                    ..Default::default()
                };
                let mut emulator = EventEmulator { isa, ..emulator(config) };
                for (k, t_us) in times.iter().enumerate() {
                    let (light, bytes, words, log) = (floats(k), eight(k), sixteen(k), &frames[k].1);
                    let frame = match kind {
                        "uint8" => Frames::u8(&bytes, Transfer::Srgb),
                        "uint16" => Frames::u16(&words, Transfer::Srgb),
                        "log" => Frames::log(log),
                        _ => Frames::linear(&light),
                    };
                    let got = emulator.push(&frame, *t_us).unwrap().remove(0);
                    assert!(
                        got == expected[k],
                        "{kind} {isa:?} {sensor:?} at {t_us}: {} {}",
                        got.len(),
                        expected[k].len()
                    );
                }
            }
            // Canary: another threshold is another stream.
            let other = SensorConfig { threshold_on: sensor.threshold_on * 1.05, ..sensor.clone() };
            assert!(by_the_trigger(&other, width, &frames, tie) != expected);
        }
    }
}

#[test]
fn light_that_cannot_be_is_seen_even_where_pixels_are_silent() {
    for reference_luminance in [1.0, 1e-30] {
        for bad in [f32::INFINITY, f32::NEG_INFINITY, -1e-9, -0.5] {
            let config = EmulatorConfig { width: 70, height: 2, reference_luminance, ..Default::default() };
            let mut emulator = emulator(config);
            let mut frame = vec![1e7_f32; 140];
            for t_us in [0, 1000] {
                assert!(emulator.push(&Frames::linear(&frame), t_us).is_ok(), "canary");
            }
            frame[3] = bad;
            let error = emulator.push(&Frames::linear(&frame), 2000).unwrap_err().to_string();
            assert!(error.contains("(3, 0)"), "{error}");
        }
    }
}

#[test]
fn instruction_sets_agree_bit_for_bit() {
    let (width, height) = (67, 41);
    let pixels = (width * height) as usize;
    let times: Vec<i64> = (0..12).map(|k| k * 1300).collect();
    // All values at once, 0 and NaN among them.
    let light = |k: usize, i: usize| match (i * 31 + k * k * 7) % 97 {
        0 => f32::NAN,
        1 => 0.0,
        n => (n as f32 / 96.0).powi(3),
    };
    for name in ["ideal", "v2e-noisy", "openeb", "evis"] {
        let mut streams = Vec::new();
        for isa in Isa::supported() {
            let sensor = SensorConfig::preset(name).unwrap();
            let config = EmulatorConfig { width, height, sensor, seed: 2, ..Default::default() };
            let make = || EventEmulator { isa, ..emulator(config.clone()) };
            let (mut floats, mut bytes, mut words, mut logs) = (make(), make(), make(), make());
            let mut events = Vec::new();
            for (k, t_us) in times.iter().enumerate() {
                let frame: Vec<f32> = (0..pixels).map(|i| light(k, i)).collect();
                let eight: Vec<u8> = frame.iter().map(|light| (light * 255.0) as u8).collect();
                let sixteen: Vec<u16> = frame.iter().map(|light| (light * 65535.0) as u16).collect();
                let log: Vec<f32> = frame.iter().map(|light| (light + 1e-3).ln()).collect();
                events.extend(floats.push(&Frames::linear(&frame), *t_us).unwrap().remove(0));
                events.extend(bytes.push(&Frames::u8(&eight, Transfer::Srgb), *t_us).unwrap().remove(0));
                events.extend(words.push(&Frames::u16(&sixteen, Transfer::Linear), *t_us).unwrap().remove(0));
                events.extend(logs.push(&Frames::log(&log), *t_us).unwrap().remove(0));
            }
            assert!(events.len() > 10_000, "{name} {isa:?}: {}", events.len());
            streams.push((events, floats.state(), bytes.state(), words.state(), logs.state()));
        }
        assert!(streams.windows(2).all(|pair| pair[0] == pair[1]), "{name}");
        // Canary: one pixel more makes another stream.
        assert!(streams[0].0 != streams[0].0[1..]);
    }
}

/// Silent blocks of such frames are copied past the caches, where there is AVX-512.
#[test]
fn large_frames_are_kept_alike_on_every_instruction_set() {
    let (width, height) = (1024, 521);
    let pixels = (width * height) as usize;
    // One block in three leaves its range with each frame, and some pixels of others are unknown; the rest is silent, and fires
    // later from where it was.
    let light = |k: usize, i: usize| match (i / 64 + k) % 3 {
        0 => 0.2 + (i % 7 + k) as f32 * 0.1,
        1 if i.is_multiple_of(1009) => f32::NAN,
        _ => 0.5 + (i % 5 + k) as f32 * 1e-3,
    };
    let frames: Vec<Vec<f32>> = (0..5).map(|k| (0..pixels).map(|i| light(k, i)).collect()).collect();
    let mut streams = Vec::new();
    for isa in Isa::supported() {
        for threads in [1, 2] {
            let config = EmulatorConfig { width, height, threads, ..Default::default() };
            let mut emulator = EventEmulator { isa, ..emulator(config) };
            let mut events = Vec::new();
            for (frame, t_us) in frames.iter().zip([0, 1000, 2000, 3000, 4000]) {
                events.extend(emulator.push(&Frames::linear(frame), t_us).unwrap().remove(0));
            }
            assert!(events.len() > pixels, "{isa:?}: {}", events.len());
            streams.push((events, emulator.state()));
        }
    }
    assert!(streams.windows(2).all(|pair| pair[0] == pair[1]));
    // Canary: one pixel more makes another stream.
    assert!(streams[0].0 != streams[0].0[1..]);
}

/// Events, causes and losses of a stream of `sensor` in which some pixels are unknown at times; `plain` as the plan has it, or
/// pixel by pixel.
fn by_blocks_or_pixels(sensor: &SensorConfig, plain: bool) -> (Vec<Event>, Vec<u8>, EmulatorReport, bool) {
    let (width, height) = (83, 31);
    let config =
        EmulatorConfig { width, height, sensor: sensor.clone(), seed: 3, causes: true, ..Default::default() };
    let mut emulator = emulator(config);
    let Kernel::Chain(plan) = &mut emulator.kernel else { panic!("the sensor is ideal") };
    let has_plain = plan.plain.is_some();
    if !plain {
        plan.plain = None;
    }
    let (mut events, mut causes) = (Vec::new(), Vec::new());
    for k in 0..60_i64 {
        let t_us = 900 * k + 37 * (k % 5);
        let mut frame = drifting(width, height, t_us);
        for (i, light) in frame.iter_mut().enumerate() {
            // Steep rises, so that pixels reach the most events.
            *light *= if (i + k as usize).is_multiple_of(97) { 300.0 } else { 1.0 };
            if (i + 7 * k as usize).is_multiple_of(211) {
                *light = f32::NAN;
            }
        }
        events.extend(emulator.push(&Frames::linear(&frame), t_us).unwrap().remove(0));
        causes.extend_from_slice(&emulator.causes()[0]);
    }
    (events, causes, *emulator.total_report(), has_plain)
}

#[test]
fn blocks_fire_what_their_pixels_fire() {
    let preset = |name| SensorConfig::preset(name).unwrap();
    let mut even = SensorConfig { times: Times::Even, most_events: 4, ..preset("v2e-noisy") };
    even.refractory = Refractory { period_us: 300, rule: RefractoryRule::Suppress };
    even.noise.alternation = 0.4;
    even.noise.leak_hz = 60.0;
    even.readout.latency_us = 200.0;
    let sampled = SensorConfig { times: Times::Sample, threshold_on: 0.03, ..SensorConfig::default() };
    let few = SensorConfig { most_events: 3, ..preset("openeb") };
    let mut spread = SensorConfig::default();
    spread.pattern.sigma = 0.03;
    let sensors = [preset("v2e"), preset("v2e-clean"), preset("openeb"), even, sampled, few, spread];
    let mut seen = EmulatorReport::default();
    for (number, sensor) in sensors.iter().enumerate() {
        let (blocks, pixels) = (by_blocks_or_pixels(sensor, true), by_blocks_or_pixels(sensor, false));
        assert!(blocks.3, "sensor {number} goes pixel by pixel");
        assert!(blocks.0.len() > 5000, "sensor {number}: {} events", blocks.0.len());
        assert!(blocks == pixels, "sensor {number}: {:?} and {:?}", blocks.2, pixels.2);
        seen.add(&blocks.2);
    }
    assert!(seen.clamped > 100 && seen.suppressed > 100 && seen.unknown > 100, "{seen:?}");
    // Canary: another threshold is another stream.
    let other = SensorConfig { threshold_on: 0.21, ..preset("v2e") };
    assert!(by_blocks_or_pixels(&other, true).0 != by_blocks_or_pixels(&sensors[0], true).0);
}
