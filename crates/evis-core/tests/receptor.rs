//! Noise of the photoreceptor: its events at any cut of time, what it does to weak contrast, and what it refuses.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use evis_core::sensor::{
    Bandwidth, FilterRule, Noise, Pattern, Photoreceptor, Refractory, RefractoryRule, Sensor,
};
use evis_core::{EmulatorConfig, Event, EventEmulator, Frames, SensorConfig};

const WIDTH: u32 = 96;
const HEIGHT: u32 = 32;

fn sensor(order: u32, noise: f32) -> SensorConfig {
    SensorConfig {
        photoreceptor: Photoreceptor { cutoff_hz: 150.0, order, noise, ..Photoreceptor::default() },
        ..SensorConfig::default()
    }
}

/// Events of `light(pixel, seconds)` at `times`.
fn run(config: &EmulatorConfig, times: &[i64], light: impl Fn(usize, f64) -> f64) -> Vec<Event> {
    let mut emulator = EventEmulator::new(config.clone()).unwrap();
    let pixels = (config.width * config.height) as usize;
    let mut events = Vec::new();
    for t_us in times {
        let frame: Vec<f32> = (0..pixels).map(|i| light(i, *t_us as f64 * 1e-6) as f32).collect();
        events.extend(emulator.push(&Frames::linear(&frame), *t_us).unwrap().remove(0));
    }
    events
}

fn config(sensor: &SensorConfig) -> EmulatorConfig {
    EmulatorConfig { width: WIDTH, height: HEIGHT, sensor: sensor.clone(), threads: 1, ..Default::default() }
}

fn frames(hz: i64, end_us: i64) -> Vec<i64> {
    (0..=end_us * hz / 1_000_000).map(|k| (k * 1_000_000 + hz / 2) / hz).collect()
}

/// Steps from a hundred microseconds to a tenth of a second, in no order.
fn irregular(end_us: i64) -> Vec<i64> {
    common::irregular(end_us, 12_345, 13, 63)
}

/// Events that are in one list only, by pixel and polarity, if times may differ by a microsecond.
fn differing(a: &[Event], b: &[Event]) -> usize {
    let sorted = |events: &[Event]| {
        let mut events = events.to_vec();
        events.sort_by_key(|e| (e.y, e.x, e.t));
        events
    };
    let (a, b) = (sorted(a), sorted(b));
    let (mut i, mut j, mut count) = (0, 0, 0);
    while i < a.len() && j < b.len() {
        let (p, q) = (a[i], b[j]);
        if (p.y, p.x, p.p) == (q.y, q.x, q.p) && (p.t - q.t).abs() <= 1 {
            (i, j) = (i + 1, j + 1);
        } else {
            count += 1;
            if (p.y, p.x, p.t) < (q.y, q.x, q.t) { i += 1 } else { j += 1 }
        }
    }
    count + a.len() - i + b.len() - j
}

#[test]
fn the_same_events_at_any_cut_of_time() {
    let end_us = 300_000;
    let cuts = [frames(30, end_us), frames(300, end_us), frames(3000, end_us), irregular(end_us)];
    let leak = Noise { leak_hz: 2.0, shot_hz: 3.0, ..Noise::default() };
    let hold = Refractory { period_us: 700, rule: RefractoryRule::Hold };
    // Single precision between frames: a few noses just reach a threshold, or do not. A held pixel's reference is the
    // signal a period after a whole microsecond, which a rounding may choose.
    for (order, noise, refractory, few) in [
        (1, Noise::default(), Refractory::default(), 10_000),
        (2, Noise::default(), Refractory::default(), 10_000),
        (1, leak, Refractory { rule: RefractoryRule::Defer, ..hold }, 10_000),
        (2, leak, hold, 100),
    ] {
        let sensor = SensorConfig { noise, refractory, ..sensor(order, 0.08) };
        // Still light, and light that is straight in its logarithm.
        for slope in [0.0, 1.5] {
            // No offset, so that the logarithm is straight.
            let sensor = SensorConfig { log_eps: 1e-30, ..sensor.clone() };
            let light = |i: usize, t: f64| (0.2 + 0.001 * (i % 100) as f64) * (slope * t).exp();
            let streams: Vec<_> = cuts.iter().map(|cut| run(&config(&sensor), cut, light)).collect();
            assert!(streams[0].len() > 10_000, "{}", streams[0].len());
            for other in &streams[1..] {
                let count = differing(&streams[0], other);
                assert!(count * few <= other.len(), "{order} {slope}: {count} of {}", other.len());
            }
            // Canary: another seed's.
            let other = run(&EmulatorConfig { seed: 1, ..config(&sensor) }, &cuts[1], light);
            assert!(differing(&streams[0], &other) * 2 > other.len());
        }
    }
}

#[test]
fn rates_do_not_depend_on_the_frame_rate_where_light_sets_the_bandwidth() {
    let receptor = Photoreceptor { bandwidth: Bandwidth::Light, ..sensor(2, 0.07).photoreceptor };
    let sensor = SensorConfig { photoreceptor: receptor, ..SensorConfig::default() };
    // Slow light, which no threshold would notice.
    let light = |i: usize, t: f64| 0.1 * (1 + i % 7) as f64 * (1.0 + 0.05 * (7.0 * t + i as f64).sin());
    let end_us = 1_000_000;
    let count = |times: &[i64]| run(&config(&sensor), times, light).len() as f64;
    let counts = [frames(30, end_us), frames(300, end_us), frames(3000, end_us), irregular(end_us)];
    let counts = counts.map(|times| count(&times));
    assert!(counts[0] > 10_000.0, "{counts:?}");
    for other in &counts[1..] {
        // Noise is the same, so that counts differ by less than the root of two independent ones.
        assert!((other - counts[0]).abs() < 4.5 * (2.0 * counts[0]).sqrt(), "{counts:?}");
    }
    // Canary: a tenth more noise is seen.
    let louder =
        SensorConfig { photoreceptor: Photoreceptor { noise: 0.077, ..receptor }, ..SensorConfig::default() };
    let louder = run(&config(&louder), &frames(300, end_us), light).len() as f64;
    assert!(louder - counts[0] > 4.5 * (2.0 * counts[0]).sqrt(), "{louder}");
    // Bright pixels have more bandwidth, and more noise events: as much as their light, nearly.
    let mut by_light = [0.0; 7];
    for event in run(&config(&sensor), &frames(300, end_us), light) {
        by_light[(u32::from(event.y) * WIDTH + u32::from(event.x)) as usize % 7] += 1.0;
    }
    let ratio: f64 = by_light[6] / by_light[0];
    assert!((ratio / 7.0 - 1.0).abs() < 0.15, "{by_light:?}");
}

#[test]
fn weak_contrast_fires_by_noise_and_in_phase() {
    let hz = 10.0;
    let light = |_: usize, t: f64| 0.5 * (0.08 * (std::f64::consts::TAU * hz * t).sin()).exp();
    let times = frames(1000, 1_000_000);
    let phase = |events: &[Event]| {
        // Mean direction of ON less OFF events over the period.
        let sum = events.iter().fold((0.0, 0.0), |(c, s), event| {
            let angle = std::f64::consts::TAU * hz * event.t as f64 * 1e-6;
            let sign = f64::from(2 * event.p - 1);
            (c + sign * angle.cos(), s + sign * angle.sin())
        });
        (sum.0 / events.len() as f64, sum.1 / events.len() as f64)
    };
    for order in [1, 2] {
        // 0.16 from crest to trough, below a threshold of 0.2.
        assert!(run(&config(&sensor(order, 0.0)), &times, light).is_empty());
        let noisy = run(&config(&sensor(order, 0.05)), &times, light);
        assert!(noisy.len() > 2000, "{}", noisy.len());
        let (c, s) = phase(&noisy);
        // ON while it rises towards its crest, at most the low-pass's delay later.
        assert!(c.hypot(s) > 8.0 / (noisy.len() as f64).sqrt() && s.atan2(c).abs() < 1.0, "{order}: {c} {s}");
        // Canary: without the signal there is no phase.
        let alone = run(&config(&sensor(order, 0.065)), &times, |_, _| 0.5);
        let (c, s) = phase(&alone);
        assert!(c.hypot(s) < 5.0 / (alone.len() as f64).sqrt(), "{order}: {c} {s} of {}", alone.len());
    }
}

#[test]
fn what_is_off_goes_where_it_went_and_threads_agree() {
    assert!(SensorConfig::default().is_ideal());
    assert_eq!(sensor(1, 0.05).stages(), ["photoreceptor"]);
    let sensor = SensorConfig {
        pattern: Pattern { sigma: 0.03, dead_share: 0.1, ..Pattern::default() },
        ..sensor(2, 0.07)
    };
    assert_eq!(SensorConfig::from_toml(&sensor.to_toml()).unwrap(), sensor);
    let times = frames(500, 100_000);
    let light = |i: usize, t: f64| 0.5 + 0.4 * (0.05 * i as f64 + 20.0 * t).sin();
    // Large enough for tiles to be shared out.
    let large = |threads| EmulatorConfig { width: 200, height: 170, threads, ..config(&sensor) };
    let one = run(&large(1), &times, light);
    assert!(one.len() > 10_000 && run(&large(2), &times, light) == one);
    assert!(run(&EmulatorConfig { seed: 7, ..large(1) }, &times, light) != one);
    // An emulator that takes up another's state, within a cell between two knots, goes on as it would have.
    let mut first = EventEmulator::new(config(&sensor)).unwrap();
    let mut second = EventEmulator::new(config(&sensor)).unwrap();
    let frame = |t_us: i64| -> Vec<f32> {
        (0..WIDTH * HEIGHT).map(|i| light(i as usize, t_us as f64 * 1e-6) as f32).collect()
    };
    for t_us in [0, 777, 1501, 9000] {
        first.push(&Frames::linear(&frame(t_us)), t_us).unwrap();
    }
    second.restore(&first.state()).unwrap();
    for t_us in [9021, 15_000, 40_000] {
        let frame = frame(t_us);
        let events = first.push(&Frames::linear(&frame), t_us).unwrap();
        assert_eq!(second.push(&Frames::linear(&frame), t_us).unwrap(), events);
    }
    assert!(first.total_report().events > 100);
}

#[test]
fn what_cannot_be_is_named() {
    let refused = |photoreceptor: Photoreceptor| {
        let config = SensorConfig { photoreceptor, ..SensorConfig::default() };
        Sensor::new(config).unwrap_err().to_string()
    };
    let good = sensor(1, 0.05).photoreceptor;
    assert!(Sensor::new(sensor(1, 0.05)).is_ok());
    for noise in [f32::NAN, f32::INFINITY, -0.1, 11.0] {
        let error = refused(Photoreceptor { noise, ..good });
        assert!(error.contains("photoreceptor.noise") && error.contains(&noise.to_string()), "{error}");
    }
    let error = refused(Photoreceptor { cutoff_hz: 0.0, ..good });
    assert!(error.contains("photoreceptor.noise is 0.05") && error.contains("cutoff_hz"), "{error}");
    let error = refused(Photoreceptor { filter: FilterRule::Euler, ..good });
    assert!(error.contains("photoreceptor.noise is 0.05") && error.contains("exact"), "{error}");
}
